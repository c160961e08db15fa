# Mesh to accuracy report. `make report` is the main job, `make test` the tests; each sets up what it needs.
SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
MAKEFLAGS += --no-builtin-rules --no-builtin-variables --jobs=$(shell nproc 2>/dev/null || echo 2)
.DELETE_ON_ERROR:
.SECONDARY:
.SUFFIXES:

# The programs have threads of their own; those of the BLAS under NumPy would only spin beside them.
export OPENBLAS_NUM_THREADS ?= 1

BUILD := build
VENV := .venv
PY := $(VENV)/bin/python
READY := $(VENV)/.ready

# The first Python that the wheels exist for.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' 2>/dev/null && echo $$p && break; done)

# ---- what is made ----------------------------------------------------------------------------------------------------
SHAPES := torus mirror
MESHES := bunny $(SHAPES) sphere
TEXTURES := page checker zone
FIGURES := figure-4-linear figure-4-cubic figure-5 figure-6-linear figure-6-cubic \
	figure-7-linear figure-7-cubic figure-7-bspline figure-8
OPTICS := glass environment lights
RENDERS := $(FIGURES) $(FIGURES:%=%-baked) figure-4-reference reference torus bunny $(OPTICS)
OBJECTS := bunny torus mirror
# On whose atlases the representations of texture coordinates are compared.
CHARTED := bunny torus
SUITES := $(OBJECTS:%=footprints-%) $(CHARTED:%=representations-%) figures pictures inspector scores opinion misses \
	shapes meshes matrix bounces faults truths convergence stress
TIMED := frontier engines representations-clock cost derivatives filtering savings levels

GRIDS := $(foreach name,$(OBJECTS),$(name)@64 $(name)@512) $(foreach name,$(CHARTED),$(name)@128 $(name)@256) sphere@16
EXACT_GRIDS := exact-mirror@64 exact-mirror@512 exact-torus@64 exact-torus@512 exact-sphere@16 exact-sphere@64 \
	exact-sheet@128

# Of the benchmark against other bakers, which the report shows where it was run.
BAKED := bunny bunny-900k box-12

mesh = $(BUILD)/meshes/$(1).ply
grid = $(BUILD)/grids/$(1).zarr.zip
render = $(BUILD)/renders/$(1).exr
runs = $(BUILD)/runs/$(1).jsonl

MESH_FILES := $(foreach m,$(MESHES),$(call mesh,$(m)))
GRID_FILES := $(foreach g,$(GRIDS) $(EXACT_GRIDS),$(call grid,$(g)))
RENDER_FILES := $(foreach r,$(RENDERS),$(call render,$(r)))
TEXTURE_FILES := $(TEXTURES:%=$(BUILD)/textures/%.png) $(BUILD)/textures/sky.exr
RUN_FILES := $(foreach s,$(SUITES) $(TIMED),$(call runs,$(s)))

# The code that each stage rests on: a change there makes its products anew.
SHARED_CODE := $(addprefix sdfbake/,atomic.py commandline.py complaint.py mesh.py meshfile.py objfile.py charts.py)
MESH_CODE := $(SHARED_CODE) $(wildcard datasets_synthetic/*.py) \
	$(addprefix sdfbake/,diagnosis.py repair.py unwrap.py topology.py triangle.py)
BAKE_CODE := $(wildcard sdfbake/*.py)
RENDER_CODE := $(wildcard sdfrender/*.py sdfbake/engine/*.py) $(addprefix sdfbake/,grid.py gridfile.py gridreading.py foretelling.py gridchunks.py gridlayout.py bricks.py lattice.py)
CHECK_CODE := $(wildcard validate/*.py validate/suites/*.py validate/stress/*.py)

# Other programs, in an environment of their own.
CONSUMERS := $(BUILD)/consumers
CONSUMERS_READY := $(CONSUMERS)/.ready

# Pythons in which other programs are looked for, beside the system's and ours; separated as in PATH.
export PEER_PYTHONS ?= $(BUILD)/trueform/bin/python:$(CONSUMERS)/bin/python

.PHONY: help setup report test format-check lint types imports pytest bench bench-bake bench-render trueform mitsuba \
	consumers openvdb clean meshes grids renders
.DEFAULT_GOAL := help

help:  ## say what can be made
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1|\2/' | column -t -s '|'

# ---- setting up ------------------------------------------------------------------------------------------------------
setup: $(READY)  ## install everything into .venv

$(READY): pyproject.toml
	@if [ -z "$(PYTHON)" ]; then \
		echo "error: no Python from 3.11 to 3.13 was found: install one, or name it with make PYTHON=/path/to/python" >&2; \
		exit 2; fi
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' || { \
		echo "error: $(PYTHON) is not a Python from 3.11 to 3.13: name one with make PYTHON=/path/to/python" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
		echo "error: $(PYTHON) cannot make environments: install its venv package (Debian: apt install python3-venv)" >&2; \
		exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --editable '.[jit,test]'
	@touch $@

# ---- meshes, textures, scenes ----------------------------------------------------------------------------------------
meshes: $(MESH_FILES)  ## make, repair and unwrap the meshes

$(BUILD)/raw/%.ply: $(MESH_CODE) | $(READY)
	$(PY) -m datasets_synthetic make $* -o $@

$(BUILD)/meshes/%.ply: $(BUILD)/raw/%.ply $(MESH_CODE) | $(READY)
	$(PY) -m sdfbake unwrap $< -o $@

# Meshes to compare bakers on, without texture coordinates.
$(call mesh,bunny-900k): $(MESH_CODE) | $(READY)
	$(PY) -m datasets_synthetic make bunny-900k -o $@

$(call mesh,box-12): $(MESH_CODE) | $(READY)
	$(PY) -m datasets_synthetic make box --edge 2 -o $@

$(BUILD)/textures/%.png: datasets_synthetic/texture.py datasets_synthetic/__main__.py | $(READY)
	$(PY) -m datasets_synthetic texture $* -o $@

$(BUILD)/textures/sky.exr: datasets_synthetic/sky.py datasets_synthetic/__main__.py | $(READY)
	$(PY) -m datasets_synthetic texture sky -o $@

$(RENDERS:%=$(BUILD)/scenes/%.toml) &: datasets_synthetic/scenes.py datasets_synthetic/__main__.py | $(READY)
	$(PY) -m datasets_synthetic scenes -o $(BUILD)/scenes

# ---- grids -----------------------------------------------------------------------------------------------------------
grids: $(GRID_FILES)  ## bake the grids, and sample those of exact shapes

# With coarser levels of itself.
$(call grid,levels-bunny@512): $(call mesh,bunny) $(BAKE_CODE) | $(READY)
	$(PY) -m sdfbake bake $< -n 512 --levels 3 --uv-mode faces -o $@ > /dev/null

# One rule per resolution: exact-NAME@N is sampled from the shape, NAME@N baked from the mesh.
define grid_rules
$(BUILD)/grids/exact-%@$(1).zarr.zip: $(BAKE_CODE) $(MESH_CODE) | $(READY)
	$(PY) -m datasets_synthetic sample $$* -n $(1) -o $$@

$(BUILD)/grids/%@$(1).zarr.zip: $(BUILD)/meshes/%.ply $(BAKE_CODE) | $(READY)
	$(PY) -m sdfbake bake $$< -n $(1) --uv-mode faces,layers,grid -o $$@ > /dev/null
endef
$(foreach n,16 32 64 128 256 512 1024,$(eval $(call grid_rules,$(n))))

# ---- renders ---------------------------------------------------------------------------------------------------------
renders: $(RENDER_FILES)  ## render all scenes

$(BUILD)/renders/%.exr: $(BUILD)/scenes/%.toml $(RENDER_CODE) | $(READY)
	$(PY) -m sdfrender render $< -o $@ --png $(@:.exr=.png)

# The references are traced against the exact shapes themselves, 64 samples per pixel.
$(call render,reference): EXACT := mirror
$(call render,figure-4-reference): EXACT := sphere
$(call render,reference) $(call render,figure-4-reference): $(BUILD)/renders/%.exr: \
		$(BUILD)/scenes/%.toml $(RENDER_CODE) validate/exact.py validate/__main__.py | $(READY)
	$(PY) -m validate reference $< --shape $(EXACT) -o $@

uses = $(call render,$(1)): $(call grid,$(2)) $(3)
$(foreach f,figure-4-linear figure-4-cubic,$(eval $(call uses,$(f),exact-sphere@16)))
$(foreach f,figure-4-linear figure-4-cubic,$(eval $(call uses,$(f)-baked,sphere@16)))
PAGE := $(BUILD)/textures/page.png
CHECKER := $(BUILD)/textures/checker.png
$(foreach f,figure-5 figure-6-linear figure-6-cubic figure-8,$(eval $(call uses,$(f),exact-mirror@512,$(PAGE))))
$(foreach f,figure-5 figure-6-linear figure-6-cubic figure-8,$(eval $(call uses,$(f)-baked,mirror@512,$(PAGE))))
$(foreach f,figure-7-linear figure-7-cubic figure-7-bspline,$(eval $(call uses,$(f),exact-mirror@64,$(PAGE))))
$(foreach f,figure-7-linear figure-7-cubic figure-7-bspline,$(eval $(call uses,$(f)-baked,mirror@64,$(PAGE))))
$(call render,reference): $(PAGE)
$(foreach s,torus bunny,$(eval $(call uses,$(s),$(s)@512,$(CHECKER))))
SKY := $(BUILD)/textures/sky.exr
$(eval $(call uses,glass,exact-sphere@64,$(call grid,exact-sheet@128) $(PAGE) $(SKY)))
$(eval $(call uses,environment,exact-torus@64,$(SKY)))
$(eval $(call uses,lights,bunny@512,$(call grid,exact-sheet@128) $(PAGE)))

# ---- experiments and report ------------------------------------------------------------------------------------------
report: $(BUILD)/report/index.html  ## the main job: build/report/index.html
	@echo "the report is $<"

# What was measured against other programs is shown where it lies, and never run for the report.
OTHERS := $(foreach s,baking rendering consumers,$(call runs,$(s)))
SHOWN := $(RUN_FILES) $(wildcard $(OTHERS))
$(OTHERS): ;

$(BUILD)/report/index.html: $(SHOWN) $(wildcard validate/*.py validate/peers/*.py validate/sections/*.py validate/templates/*) | $(READY)
	$(PY) -m validate report $(SHOWN) -o $(@D)

$(BUILD)/runs/%.jsonl: $(CHECK_CODE) $(RENDER_CODE) | $(READY)
	$(PY) -m validate run $* -o $@ --build $(BUILD)

$(call runs,figures): $(filter-out $(foreach r,torus bunny $(OPTICS),$(call render,$(r))),$(RENDER_FILES))
$(call runs,inspector): $(foreach m,bunny torus,$(call mesh,$(m)) $(call grid,$(m)@512)) $(call mesh,mirror) \
	$(call grid,exact-mirror@512) $(TEXTURE_FILES) $(RENDERS:%=$(BUILD)/scenes/%.toml)
$(call runs,scores): $(foreach m,bunny torus,$(call mesh,$(m)) $(call render,$(m)))
$(call runs,pictures): $(foreach r,$(OPTICS),$(call render,$(r)))
# One file of runs per object, so that they are made side by side.
$(BUILD)/runs/footprints-%.jsonl: $(BUILD)/meshes/%.ply $(BUILD)/grids/%@64.zarr.zip $(BUILD)/grids/%@512.zarr.zip \
		$(CHECK_CODE) $(RENDER_CODE) | $(READY)
	$(PY) -m validate run footprints --only $* -o $@ --build $(BUILD)
$(foreach m,torus mirror,$(eval $(call runs,footprints-$(m)): $(call grid,exact-$(m)@64) $(call grid,exact-$(m)@512)))
$(BUILD)/runs/representations-%.jsonl: $(CHECK_CODE) $(RENDER_CODE) | $(READY)
	$(PY) -m validate run representations --only $* -o $@ --build $(BUILD)
$(foreach m,$(CHARTED),$(eval $(call runs,representations-$(m)): \
	$(call mesh,$(m)) $(foreach n,64 128 256,$(call grid,$(m)@$(n)))))
$(call runs,representations-bunny): $(CHECKER)
$(call runs,representations-clock): $(call mesh,bunny) $(call grid,bunny@64) $(call grid,bunny@256)
$(call runs,opinion): $(foreach m,$(OBJECTS),$(call mesh,$(m)) $(call grid,$(m)@64) $(call grid,$(m)@512))

# Timed steps share the machine with nothing: they wait for everything else, and for each other.
$(call runs,frontier): | $(foreach s,$(SUITES),$(call runs,$(s))) $(RENDER_FILES)
$(call runs,engines): | $(call runs,frontier)
$(call runs,representations-clock): | $(call runs,engines)
$(call runs,derivatives): | $(call runs,representations-clock)
$(call runs,filtering): $(call grid,torus@128) $(call grid,exact-mirror@64) $(call grid,exact-sheet@128) | $(call runs,derivatives)
$(call runs,cost): $(foreach m,$(CHARTED),$(call mesh,$(m)) $(foreach n,64 128 256,$(call grid,$(m)@$(n)))) \
	| $(call runs,filtering)
$(call runs,savings): $(call grid,bunny@64) $(call grid,bunny@512) | $(call runs,cost)
$(call runs,levels): $(call grid,levels-bunny@512) | $(call runs,savings)

# ---- tests -----------------------------------------------------------------------------------------------------------
test: format-check lint types imports pytest  ## format, lint, types, room rules and all tests

format-check: $(READY)
	$(PY) -m ruff format --check .

lint: $(READY)  ## ruff
	$(PY) -m ruff check .

types: $(READY)  ## mypy, strict
	$(PY) -m mypy

imports: $(READY)  ## which room may import what
	$(VENV)/bin/lint-imports

pytest: $(READY) $(CONSUMERS_READY)  ## the tests alone, some files side by side
	$(PY) -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile

bench: $(READY)  ## the timed experiments alone, anew
	rm -f $(foreach s,$(TIMED),$(call runs,$(s)))
	$(MAKE) $(foreach s,$(TIMED),$(call runs,$(s)))

bench-bake: $(foreach m,$(BAKED),$(call mesh,$(m))) | $(READY)  ## ours against OpenVDB, trueform, Open3D, where they are
	$(PY) -m validate run baking -o $(call runs,baking) --build $(BUILD)

bench-render: | $(READY)  ## ours against Mitsuba's sdfgrid, where it is
	$(PY) -m validate run rendering -o $(call runs,rendering) --build $(BUILD)

consumers: $(CONSUMERS_READY) openvdb $(foreach n,256 512,$(call grid,bunny@$(n))) | $(READY)  ## exported grids in the programs they are for
	$(PY) -m validate run consumers -o $(call runs,consumers) --build $(BUILD)

# What cannot be installed is not checked, and the report says so.
$(CONSUMERS_READY): | $(READY)
	$(PYTHON) -m venv $(CONSUMERS)
	@for package in mitsuba pyvista tinyvdb; do \
		$(CONSUMERS)/bin/python -m pip install --quiet --no-compile --disable-pip-version-check numpy $$package \
			|| echo "note: $$package cannot be installed here, and is not checked" >&2; done
	@touch $@

openvdb:
	@if command -v nanovdb_convert > /dev/null && /usr/bin/python3 -c 'import pyopenvdb' 2> /dev/null; then exit; fi; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get > /dev/null; then \
		apt-get install --quiet --yes python3-openvdb libnanovdb-tools > /dev/null && exit; fi; \
	echo "note: OpenVDB and NanoVDB are not here, and are not checked (Debian: apt install python3-openvdb libnanovdb-tools)" >&2

mitsuba: $(CONSUMERS_READY)  ## install Mitsuba 3 for bench-render, in an environment of its own

trueform:  ## install trueform for bench-bake; PolyForm Noncommercial: yours to accept
	$(PYTHON) -m venv $(BUILD)/trueform
	$(BUILD)/trueform/bin/python -m pip install --quiet --disable-pip-version-check numpy trueform

clean:  ## remove build/ (and nothing else)
	rm -rf $(BUILD)

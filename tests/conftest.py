"""Shared fixtures: one seeded generator, the engines, the exact sphere; array shapes are checked while tests run."""

from pathlib import Path

from jaxtyping import install_import_hook

ROOMS = ("sdfbake", "sdfrender", "datasets_synthetic", "validate")
# What runs once per step of a loop: checking every call would be most of the tests' time.
UNCHECKED = {f"sdfrender.{name}" for name in ("march", "stride", "tables", "cell", "vector", "anisotropic", "texels")}
ROOT = Path(__file__).parent.parent
MODULES = {f"{room}.{path.stem}" for room in ROOMS for path in (ROOT / room).glob("*.py")} - UNCHECKED

install_import_hook(sorted(MODULES), "typecheck.check")  # before the first import of a room

import numpy as np
import pytest

import datasets_synthetic
from sdfbake.engine import choose
from sdfbake.engine.choose import _jit_problem

ENGINES = [("numpy", 64), ("numpy", 32)] + ([("drjit", 64), ("drjit", 32)] if _jit_problem() is None else [])


@pytest.fixture
def rng():
    """The one source of randomness."""
    return np.random.default_rng(20180412)


@pytest.fixture(params=ENGINES, ids=[f"{name}{bits}" for name, bits in ENGINES])
def choice(request):
    """Every engine in every precision that can run here."""
    return choose(*request.param)


@pytest.fixture
def sphere():
    """The exact sphere of radius 0.8."""
    return datasets_synthetic.shape("sphere")


@pytest.fixture
def undrawn(monkeypatch):
    """Diagrams take a second each: a section's words need none."""
    monkeypatch.setattr("validate.plots.work_precision", lambda panels: "data:,")


@pytest.fixture
def directions(rng):
    """1000 random unit vectors."""
    d = rng.normal(size=(1000, 3))
    return d / np.linalg.norm(d, axis=-1, keepdims=True)

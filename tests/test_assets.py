"""The recipes of docs/assets.md, line by line, where the programs that they are for are here."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

from datasets_synthetic import mesh
from sdfbake import meshfile
from sdfbake.__main__ import cli
from sdfbake.export import FORMATS
from validate.peers.catalogue import find
from validate.peers.consumers import CONSUMERS

PAGE = (ROOT / "docs" / "assets.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = [line for language, text in BLOCKS if language == "bash" for line in text.splitlines()]
SNIPPETS = [text for language, text in BLOCKS if language == "python"]
# Whose Python runs a snippet: the module that it imports, and the program.
NEEDS = {"mitsuba": "Mitsuba", "pyvista": "PyVista", "pyopenvdb": "OpenVDB", "drjit": "Dr.Jit"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder in which all commands were run, on a small mesh."""
    made = tmp_path_factory.mktemp("assets")
    meshfile.save(mesh("box", 0.4), made / "bunny.ply")
    before = Path.cwd()
    os.chdir(made)
    try:
        for line in COMMANDS:
            words = shlex.split(line.replace("-n 256", "-n 24").replace("bunny.obj", "bunny.ply"))
            assert words[:3] == ["python", "-m", "sdfbake"]
            if "nvdb" not in words or shutil.which("nanovdb_convert"):
                cli.main(words[3:], standalone_mode=False)
    finally:
        os.chdir(before)
    return made


def test_every_format_has_a_command_and_a_row():
    exports = [shlex.split(line) for line in COMMANDS if " export " in line]
    assert {words[words.index("--to") + 1] for words in exports} == set(FORMATS)
    assert re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE) == list(FORMATS)


def _python(text):
    """The Python for a snippet; skips where none has the program."""
    program = next(
        (name for module, name in NEEDS.items() if f"import {module}" in text or f"from {module}" in text), None
    )
    if program is None:
        return sys.executable
    found = find(next(one.peer for one in CONSUMERS if one.peer.name == program))
    if not found.here:
        pytest.skip(f"{program} is not here: {found.problem}")
    return found.python


@pytest.mark.parametrize("text", SNIPPETS, ids=[re.search(r"bunny[\w.-]*", text)[0] for text in SNIPPETS])
def test_snippets_run(text, folder):
    quick = text.replace("side=256, spp=16", "side=64, spp=2")
    done = subprocess.run([_python(text), "-c", quick], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for picture in re.findall(r"bunny-\w+\.png", text):
        assert (folder / picture).stat().st_size > 1000


@pytest.mark.skipif(shutil.which("node") is None, reason="Node.js is not here")
def test_javascript_runs(folder):
    (text,) = [text for language, text in BLOCKS if language == "javascript"]
    done = subprocess.run(["node", "-e", text], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

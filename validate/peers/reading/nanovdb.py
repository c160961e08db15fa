"""NanoVDB: its validator judges the file, its converter turns it into OpenVDB's, which is read there.

In: a .nvdb file. Out: whether every grid in it is valid, and what OpenVDB reads after the conversion.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from validate.peers.reading.openvdb import look_at, module
from validate.peers.reading.question import Arrays, Question, Reader, Words, serve

VALIDATOR, CONVERTER = TOOLS = ("nanovdb_validate", "nanovdb_convert")


def _reader() -> Reader:
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        raise FileNotFoundError(f"{', '.join(missing)} are not on the path")
    vdb = module()

    def look(path: str, asked: Question) -> "tuple[Arrays, Words]":
        verdicts = [line for line in _said(VALIDATOR, "--verbose", path).splitlines() if line.startswith("Grid named")]
        invalid = np.array([not line.endswith(": passed") for line in verdicts])
        with tempfile.TemporaryDirectory() as folder:
            converted = str(Path(folder) / "converted.vdb")
            _said(CONVERTER, path, converted)
            arrays, words = look_at(vdb, converted, asked)
        return arrays | {"invalid": invalid}, words

    return Reader(_said(VALIDATOR, "--version").split()[-1], str, look)


def _said(*command: str) -> str:
    """Run a tool; return what it says, raise what it complains about."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    if done.returncode:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {(done.stderr or done.stdout).strip()}")
    return done.stdout


if __name__ == "__main__":
    serve(_reader)

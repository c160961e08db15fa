"""Which engine runs, and why.

In: a wish (`auto`, `numpy`, `drjit`) and a precision. Out: an engine and one line that says why it was taken. Whether
Dr.Jit can run is found out without loading it: an LLVM that is too old ends the process, and no exception can stop it.
"""

import ctypes.util
import importlib.util
import os
import re
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from sdfbake.complaint import BadInput
from sdfbake.engine.numpy import NumpyEngine
from sdfbake.engine.protocol import Engine

OLDEST_LLVM = 16  # 14 and 15 abort with "Cannot select"
NAMES = ("auto", "numpy", "drjit")


@dataclass(frozen=True, slots=True)
class Choice:
    """An engine and the reason for it, in words."""

    engine: Engine
    reason: str


def choose(name: str = "auto", precision: int | None = None) -> Choice:
    """Choose the engine for a run.

    Parameters
    ----------
    name
        `auto` (Dr.Jit where it is usable), `numpy` or `drjit`.
    precision
        Bits of a float, 32 or 64; by default 64 on NumPy, 32 on Dr.Jit.

    Returns
    -------
    Choice
        The engine, and why.

    Raises
    ------
    BadInput
        For an unknown name or precision, or when `drjit` is asked for and cannot run here.
    """
    if name not in NAMES:
        raise BadInput(f"there is no engine '{name}': choose one of {', '.join(NAMES)}")
    if precision not in (None, 32, 64):
        raise BadInput(f"there is no precision of {precision} bits: choose 32 or 64")
    if name == "numpy":
        return Choice(NumpyEngine(precision or 64), "asked for")
    problem = _jit_problem()
    if problem is None:
        from sdfbake.engine.drjit import DrjitEngine

        return Choice(DrjitEngine(precision or 32), "asked for" if name == "drjit" else "usable here, and faster")
    if name == "drjit":
        raise BadInput(f"the engine drjit cannot run here: {problem}; install the extra 'jit' or use --engine numpy")
    return Choice(NumpyEngine(precision or 64), f"drjit cannot run here: {problem}")


@cache
def _jit_problem() -> str | None:
    """Say why Dr.Jit cannot run, or point it to an LLVM library and return None."""
    if importlib.util.find_spec("drjit") is None:
        return "the package drjit is not installed"
    if "drjit" in sys.modules or Path("/proc/driver/nvidia/version").exists():
        return None  # somebody else has it running already, or a GPU needs no LLVM
    wished = os.environ.get("DRJIT_LIBLLVM_PATH")
    candidates = [Path(wished)] if wished else _llvm_libraries()
    versions = {path: _version(path) for path in candidates}
    usable = [path for path in candidates if versions[path] >= OLDEST_LLVM]
    if not usable:
        found = ", ".join(f"{path.name} (version {versions[path] or 'unknown'})" for path in candidates) or "none"
        return f"it needs an LLVM library of version {OLDEST_LLVM} or later, found {found}"
    os.environ["DRJIT_LIBLLVM_PATH"] = str(usable[0])
    return None


def _llvm_libraries() -> list[Path]:
    """List LLVM libraries, those of this Python environment first, the newest first."""
    pattern = "libLLVM*.dylib" if sys.platform == "darwin" else "libLLVM*.so*"
    ours = sorted((Path(sys.prefix) / "lib").glob(pattern), key=_version, reverse=True)
    system = [path for folder in _system_folders() for path in folder.glob(pattern)]
    named = ctypes.util.find_library("LLVM") if sys.platform == "win32" else None
    return ours + sorted(set(system), key=_version, reverse=True) + ([Path(named)] if named else [])


def _system_folders() -> list[Path]:
    if sys.platform == "darwin":
        return [Path("/opt/homebrew/opt/llvm/lib"), Path("/usr/local/opt/llvm/lib")]
    names = ("lib", "lib64", "lib/x86_64-linux-gnu", "lib/aarch64-linux-gnu")
    return [root for name in names if (root := Path("/usr") / name).is_dir()]


def _version(library: Path) -> int:
    """Read the major version off a library's real name; 0 where it does not tell."""
    match = re.search(r"LLVM[-.]?(?:so\.|dylib\.|C\.)?(\d+)", library.resolve().name)
    return int(match.group(1)) if match else 0

"""The tools that are compared, bakers (`PEERS`) and renderers (`RENDERERS`), and which of them can run here.

In: nothing; the environment variable PEER_PYTHONS may name more Pythons to look into. Out: `Found`, per tool.
"""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from sdfbake.engine import choose
from validate.peers.process import Process


@dataclass(frozen=True, slots=True)
class Peer:
    """A tool.

    Attributes
    ----------
    name
        As the report writes it.
    module
        Of `validate.peers`.
    growth
        Exponent of a bake's cost in the number of samples per axis, at most: 3 where it fills the whole box.
    about
        What it was asked for.
    install
        What to do where it is missing.
    """

    name: str
    module: str
    growth: int
    about: str
    install: str


OURS = "ours"
PEERS = (
    Peer(
        OURS,
        "ours",
        2,
        "sparse bricks, at least 5.2 voxels to either side; checks, signs, far bounds and error estimate included",
        "make setup",
    ),
    Peer("OpenVDB", "openvdb", 2, "narrow band of half width 3, no faces", "Debian: apt install python3-openvdb"),
    Peer(
        "trueform",
        "trueform",
        3,
        'mode "banded", 3 voxels measured and the rest of a dense grid swept, no faces',
        "make trueform (its licence, PolyForm Noncommercial, is yours to accept)",
    ),
    Peer(
        "Open3D",
        "open3d",
        2,
        "RaycastingScene: closest face and occupancy at the samples of our exact band, which it is told",
        "make setup",
    ),
)


MITSUBA = "Mitsuba"
RENDERERS = (
    Peer(OURS, "tracer", 2, "certified first hits on sparse bricks", "make setup"),
    Peer(
        MITSUBA,
        "mitsuba",
        3,
        "shape `sdfgrid`, trilinear, smooth normals, on the dense cube; variant llvm_ad_rgb, float32",
        "make mitsuba",
    ),
)


@dataclass(frozen=True, slots=True)
class Found:
    """Whether a tool runs here.

    Attributes
    ----------
    peer
        The tool.
    python
        The Python that has it; empty where none does.
    version
        Of the tool; empty where none has it.
    problem
        Why it does not run, per Python; empty where it does.
    """

    peer: Peer
    python: str = ""
    version: str = ""
    problem: str = ""

    @property
    def here(self) -> bool:
        """True where the tool runs."""
        return bool(self.python)

    def start(self, environment: Mapping[str, str] | None = None) -> Process:
        """Start it, with more environment variables where they are given."""
        return Process(self.python, f"validate.peers.{self.peer.module}", environment)


def pythons() -> tuple[str, ...]:
    """Pythons to look into: this one, those of PEER_PYTHONS that exist, the system's."""
    named = [path for path in os.environ.get("PEER_PYTHONS", "").split(os.pathsep) if Path(path).is_file()]
    return tuple(dict.fromkeys([sys.executable, *map(os.path.abspath, named), "/usr/bin/python3"]))


@cache
def find(peer: Peer) -> Found:
    """Start the tool in one Python after another until one has it."""
    choose()  # it names the LLVM library that Dr.Jit needs, to the processes of other tools as well
    problems = []
    for python in pythons() if peer.name != OURS else (sys.executable,):
        try:
            with Process(python, f"validate.peers.{peer.module}") as process:
                return Found(peer, python, process.hello())
        except (RuntimeError, OSError) as error:
            problems.append(f"{python}: {error}")
    return Found(peer, problem="; ".join(problems))

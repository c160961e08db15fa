"""The programs that exported grids are for, format by format.

In: nothing. Out: `CONSUMERS`, to be looked for by `catalogue.find`, and `UNTRIED`, which no process here can start.
"""

from dataclasses import dataclass

from validate.peers.catalogue import Peer

_PIP = "make consumers"
_APT = "make consumers (Debian: apt install python3-openvdb)"


@dataclass(frozen=True, slots=True)
class Consumer:
    """A program that reads a format.

    Attributes
    ----------
    format
        As `export --to` names it.
    peer
        The program; its growth is of no concern here.
    """

    format: str
    peer: Peer


def _reads(format_: str, name: str, module: str, about: str, install: str) -> Consumer:
    return Consumer(format_, Peer(name, f"reading.{module}", 1, about, install))


CONSUMERS = (
    _reads("vdb", "OpenVDB", "openvdb", "dense copy, accessor, transform, the quads that it extracts itself", _APT),
    _reads("vdb", "tinyvdb", "tinyvdb", "its list of active voxels, its trilinear samples", _PIP),
    _reads(
        "nvdb",
        "NanoVDB",
        "nanovdb",
        "nanovdb_validate; nanovdb_convert to OpenVDB, then as there",
        f"{_APT[:-1]} libnanovdb-tools)",
    ),
    _reads("vol", "Mitsuba", "mitsuba", "the scene file beside it: rays that its sdfgrid meets; its UV volume", _PIP),
    _reads("vti", "PyVista", "pyvista", "VTK's reader: point data, probe between samples, contour", _PIP),
    _reads("raw", "NumPy", "raw", "blocks read by the JSON description alone", "make setup"),
    _reads("npy", "NumPy", "npy", "the array, and the JSON description beside it", "make setup"),
    _reads("coefficients", "SciPy", "scipy", "map_coordinates, order 3, prefilter=False", "make setup"),
    _reads("coefficients", "Dr.Jit", "drjit", "a texture's eval_cubic, float32", "make setup"),
)

#: Format, program, and why it is not among those above.
UNTRIED = (
    ("vdb", "Blender", "it is no small package and has a licence of its own; it reads by the OpenVDB that is above"),
    ("vdb", "Houdini", "it cannot be had without a licence; it reads by the OpenVDB that is above"),
)

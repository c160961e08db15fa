"""Texture coordinates for meshes that have none, by xatlas in a process of its own.

In: a mesh. Out: the same faces with texture coordinates per corner in the unit square and a chart per face. xatlas can
crash or hang on bad meshes, and knows no time limit: a child process does the work and is ended when it takes too long.
"""

import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

from sdfbake.atlas import quality
from sdfbake.complaint import BadInput
from sdfbake.lattice import Lattice
from sdfbake.mesh import Mesh
from sdfbake.topology import twice_areas

TIMEOUT = 300.0
PADDING = 2  # texels between charts; xatlas's own default of 0 lets them bleed into each other
RESOLUTION = 1024
GUTTER = 0.5  # voxels, about as well as a field on a grid knows where a chart ends
# xatlas widens charts texel by texel: more padding is slow, and a coarser packing gives the same layout.
_WIDEST = 64
_TRIES = 3


def unwrap(
    mesh: Mesh,
    *,
    timeout: float = TIMEOUT,
    padding: int = PADDING,
    resolution: int = RESOLUTION,
    for_resolution: int | None = None,
) -> Mesh:
    """Lay a mesh out in an atlas; the same result for the same mesh.

    Parameters
    ----------
    mesh
        With finite vertices and faces that have an area.
    timeout
        Seconds after which the work is given up.
    padding
        Texels between charts, at least 2.
    resolution
        Texels along the atlas, about; it sets what the padding is worth.
    for_resolution
        Samples along the longest axis of the grid that the mesh will be baked into. The padding is then at least half a
        voxel of that grid, and is measured.

    Returns
    -------
    Mesh
        With `uv` (both axes on one scale, the larger side of the atlas is 1) and `chart`; faces in their order.

    Raises
    ------
    BadInput
        If the options make no sense, xatlas fails, or it takes too long.

    Warns
    -----
    UserWarning
        If the charts are too many for such a gutter.
    """
    if padding < PADDING or resolution < 16 or not timeout > 0:
        raise BadInput(f"unwrapping wants padding >= {PADDING}, resolution >= 16 and a timeout above 0")
    if for_resolution is None:
        return _packed(mesh, timeout, padding, resolution)
    return _padded(mesh, timeout, padding, resolution, Lattice.around(mesh.bounds, for_resolution).spacing)


def _padded(mesh: Mesh, timeout: float, padding: int, resolution: int, spacing: float) -> Mesh:
    """Pack at a density chosen beforehand, which says what half a voxel is in texels; again if that falls short."""
    area = twice_areas(mesh.vertices, mesh.faces).sum() / 2
    # Three quarters of the atlas covered, which is what xatlas itself expects; the size that comes out is free.
    density = min(resolution * np.sqrt(0.75 / max(area, 1e-300)), _WIDEST / (GUTTER * spacing))
    padding = max(padding, int(np.ceil(GUTTER * spacing * density)))
    for _ in range(_TRIES):
        atlas = _packed(mesh, timeout, padding, resolution, density)
        found = quality(atlas, resolution)
        voxels = found.gutter_voxels(spacing)
        if found.gutter is None or (found.gutter >= PADDING and voxels is not None and voxels >= GUTTER):
            return atlas
        padding *= 2
    warnings.warn(
        f"the charts are {found.gutter} texels of {resolution} and {voxels or 0:.2g} voxels apart, and should be "
        f"{PADDING} texels and {GUTTER} voxels: give a larger --resolution or a finer grid",
        UserWarning,
        stacklevel=3,
    )
    return atlas


def _packed(mesh: Mesh, timeout: float, padding: int, resolution: int, density: float = 0.0) -> Mesh:
    """Unwrap at a resolution or, if it is given, at a density in texels per world unit."""
    low, high = mesh.bounds
    scale = 2.0 ** np.ceil(np.log2(max((high - low).max(), 1e-300)))
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "mesh.npz"), Path(folder, "atlas.npz")
        positions = ((mesh.vertices - (low + high) / 2) / scale).astype(np.float32)
        options = [padding, resolution, density * scale]
        np.savez(given, positions=positions, faces=mesh.faces.astype(np.uint32), options=options)
        _run_child(given, made, timeout)
        with np.load(made) as atlas:
            uv, chart = atlas["uv"], atlas["chart"]
    if uv.shape != (len(mesh.faces), 3, 2) or not np.isfinite(uv).all():
        raise BadInput("the mesh could not be unwrapped: xatlas returned no usable atlas; repair the mesh first")
    return mesh.with_(uv=uv, chart=chart)


def _run_child(given: Path, made: Path, timeout: float) -> None:
    """Run this file as a program, and turn its ends into one sentence each."""
    try:
        child = subprocess.run(
            [sys.executable, "-m", "sdfbake.unwrap", str(given), str(made)],
            timeout=timeout,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise BadInput(
            f"unwrapping took longer than {timeout:g} s and was stopped: give a larger --timeout or a simpler mesh"
        ) from None
    if child.returncode or not made.is_file():
        reason = (child.stderr.strip().splitlines() or [f"exit code {child.returncode}"])[-1]
        raise BadInput(f"the mesh could not be unwrapped ({reason}): repair it with 'sdfbake check' as a guide")


def _parametrize(given: Path, made: Path) -> None:
    """Unwrap what `given` holds; runs in the child process."""
    import xatlas

    with np.load(given) as mesh:
        positions, faces, (padding, resolution, density) = mesh["positions"], mesh["faces"], mesh["options"].tolist()
    atlas = xatlas.Atlas()
    atlas.add_mesh(positions, faces)
    packing = xatlas.PackOptions()
    # Given both a density and a resolution, xatlas would cut the atlas into several.
    packing.padding, packing.texels_per_unit = int(padding), density
    packing.resolution = 0 if density else int(resolution)
    atlas.generate(pack_options=packing)
    vertex, indices, uv = atlas.get_mesh(0)
    if not np.array_equal(vertex[indices], faces):
        raise RuntimeError("xatlas changed the order of the faces")
    chart = np.zeros(len(faces), np.int32)
    for c in range(atlas.get_mesh_chart_count(0)):
        chart[np.asarray(atlas.get_mesh_chart(0, c).faces, np.int64)] = c
    # xatlas divides u by the atlas's width and v by its height; one scale for both keeps the charts' shapes.
    size = np.array([atlas.width, atlas.height], np.float64)
    np.savez(made, uv=uv[indices].astype(np.float64) * (size / size.max()), chart=chart)


if __name__ == "__main__":
    _parametrize(Path(sys.argv[1]), Path(sys.argv[2]))

"""Imports: every encoding that writers use, distances where they are claimed, one sentence for everything else."""

import base64
import json
import lzma
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numcodecs import blosc, lz4
from scipy.interpolate import CubicSpline

from sdfbake import BadInput, Grid
from sdfbake.__main__ import cli
from sdfbake.export import export
from sdfbake.imports import Said, distances, field, import_grid, resample
from sdfbake.imports.vdbstream import ACTIVE_MASK, BLOSC, ZIP, Coding, Cursor
from sdfrender import GridField, Rays, transfer
from sdfrender.flags import Flag

FILES = Path(__file__).parent / "files"
DEBIAN = "/usr/bin/python3"
H, ORIGIN, SHAPE = 0.125, np.array([-1.0, 2.0, 0.5]), (22, 20, 18)  # no two axes alike, and exact in float32
CENTRE, RADIUS = ORIGIN + H * np.array([10.0, 9.0, 8.0]), 0.6


def points(shape=SHAPE, spacing=H, origin=ORIGIN):
    return np.moveaxis(np.indices(shape), 0, -1) * spacing + origin


def ball(p):
    return np.linalg.norm(p - CENTRE, axis=-1) - RADIUS


@pytest.fixture(scope="module")
def values():
    return ball(points()).astype(np.float32)


def vol(values, origin=ORIGIN, spacing=H, head=(b"VOL", 3, 1), channels=1):
    high = np.asarray(origin) + np.asarray(spacing) * (np.array(values.shape) - 1)
    return struct.pack("<3sB5i6f", *head, *values.shape, channels, *origin, *high) + values.tobytes("F")


CODECS = {
    "": None,
    "vtkZLibDataCompressor": zlib.compress,
    "vtkLZMADataCompressor": lzma.compress,
    "vtkLZ4DataCompressor": lambda block: lz4.compress(block)[4:],  # without this encoder's own size
}


def vti(values, form="raw", codec="", header="UInt64", order="LittleEndian", name="sdf", block=1000, more=("", "", "")):
    """Write as the manual of the format says: lengths, then blocks; in base64 the lengths of packed ones apart."""
    sign = "<" if order == "LittleEndian" else ">"
    n, kind = np.dtype(sign + header.replace("UInt32", "u4").replace("UInt64", "u8")), values.dtype.str[1:]
    data = values.astype(sign + kind).tobytes("F")
    encode = bytes if form == "raw" else base64.b64encode
    if codec:
        blocks = [data[at : at + block] for at in range(0, len(data), block)]
        packed = [CODECS[codec](one) for one in blocks]
        lengths = np.array([len(blocks), block, len(data) % block, *map(len, packed)], n).tobytes()
        written = encode(lengths) + encode(b"".join(packed))
    else:
        written = encode(np.array([len(data)], n).tobytes() + data)
    extent = " ".join(f"0 {count - 1}" for count in values.shape)
    text = " ".join(map(repr, values.ravel("F").tolist())) if form == "ascii" else ""
    text, written = (written.decode(), b"") if form == "binary" else (text, written)
    where, attributes, cells = more
    head = f"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="{order}" header_type="{header}" compressor="{codec}">
<!-- made for a test --><ImageData WholeExtent="{extent}" Origin="-1 2 0.5" Spacing="{H} {H} {H}" {attributes}>
<Piece Extent="{where or extent}"><PointData{cells}>
<DataArray type="{"Float32" if kind == "f4" else "Float64" if kind == "f8" else "UInt8"}" Name="{name}"
 format="{form if form in ("ascii", "binary") else "appended"}" offset="0"><Information key="none"/>{text}</DataArray>
</PointData{cells}></Piece></ImageData>
"""
    head = head.replace("PointDataCell", "CellData").replace(' compressor=""', "")
    if form in ("ascii", "binary"):
        return head.encode() + b"</VTKFile>"
    tail = f'<AppendedData encoding="{"raw" if form == "raw" else "base64"}">_'
    return head.encode() + tail.encode() + written + b"</AppendedData></VTKFile>"


def put(path, data):
    path.write_bytes(data)
    return path


def assert_field(grid, values, atol=0.0):
    """Raise unless a grid has these values wherever it has a brick, at these places."""
    assert grid.lattice.shape == values.shape
    np.testing.assert_allclose(grid.lattice.origin, ORIGIN, atol=1e-9)
    assert grid.lattice.spacing == pytest.approx(H, rel=1e-9)
    near = np.abs(values) < 3 * H
    np.testing.assert_allclose(grid.to_dense()[near], values[near], rtol=0, atol=atol)


def test_check_can_fail(values):
    grid = Grid.from_dense(values, origin=ORIGIN, spacing=H)
    assert_field(grid, values)
    for wrong in (values[::-1], values[:, ::-1], values[..., ::-1]):
        with pytest.raises(AssertionError):
            assert_field(grid, wrong)


# ---- readers ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", "<f2"])
@pytest.mark.parametrize("layout", ["C", "F"])
def test_npy(values, tmp_path, kind, layout):
    np.save(tmp_path / "a.npy", np.asarray(values.astype(kind), order=layout))
    found = import_grid(tmp_path / "a.npy", Said(spacing=H, origin=tuple(ORIGIN)))
    # Halves have 11 bits: values below 2 are rounded by up to 2^-11.
    assert_field(found.grid, values, 2**-11 if kind == "<f2" else 0)
    assert found.notes == () and not found.resampled and found.grid.metadata.band >= 5.2


def test_npy_that_does_not_say_where(values, tmp_path):
    np.save(tmp_path / "a.npy", values)
    found = import_grid(tmp_path / "a.npy")
    assert found.grid.lattice.spacing == 1 and "spacing is taken as 1" in found.notes[0]
    # The mean of cells' gradients of a ball is a little short, by curvature: 0.125 becomes 0.124.
    assert f"--spacing {H * found.steepness.median * 8:.3g}" in found.notes[1]
    assert found.grid.metadata.band == 0


def test_coefficients_are_no_distances(sphere, tmp_path):
    export(Grid.from_function(sphere, 24), tmp_path / "c.npy", "coefficients")
    with pytest.raises(BadInput, match="c.npy holds B-spline coefficients, no distances"):
        import_grid(tmp_path / "c.npy")


def test_npy_beside_a_description_of_another(values, tmp_path):
    np.save(tmp_path / "a.npy", values)
    lattice = {"origin": [0, 0, 0], "spacing": 1.0, "shape": [3, 3, 3]}
    (tmp_path / "a.npy.json").write_text(json.dumps({"lattice": lattice, "band": None}))
    with pytest.raises(BadInput, match="describes"):
        import_grid(tmp_path / "a.npy")
    assert_field(import_grid(tmp_path / "a.npy", Said(spacing=H, origin=tuple(ORIGIN))).grid, values)
    (tmp_path / "a.npy.json").write_text("{}")
    with pytest.raises(BadInput, match="describes no lattice"):
        import_grid(tmp_path / "a.npy")


def test_vol(values, tmp_path):
    assert_field(import_grid(put(tmp_path / "a.vol", vol(values))).grid, values)


@pytest.mark.parametrize("form", ["raw", "base64", "binary", "ascii"])
@pytest.mark.parametrize("codec", CODECS, ids=lambda name: name[3:].removesuffix("DataCompressor") or "plain")
def test_vti(values, tmp_path, form, codec):
    for header, order in (("UInt32", "LittleEndian"), ("UInt64", "BigEndian")):
        path = put(tmp_path / "a.vti", vti(values, form, codec, header, order))
        found = import_grid(path)
        assert_field(found.grid, values)
        assert found.grid.metadata.options["array"] == "sdf"


def test_vti_in_blocks_that_come_out_even(values, tmp_path):
    block = values.nbytes // 10
    assert values.nbytes % block == 0
    data = vti(values.astype("<f8"), "raw", "vtkZLibDataCompressor", block=2 * block, name="distance")
    assert_field(import_grid(put(tmp_path / "a.vti", data)).grid, values)


def test_vti_whose_indices_do_not_begin_at_zero(values, tmp_path):
    """Origin is where index 0 would be."""
    moved = vti(values).replace(b"0 21 0 19 0 17", b"5 26 -3 16 2 19").replace(b'"-1 2 0.5"', b'"-1.625 2.375 0.25"')
    assert_field(import_grid(put(tmp_path / "a.vti", moved)).grid, values)


def test_vti_by_vtk(values, tmp_path):
    """Its own writer, in pieces of several arrays."""
    xml, model = (pytest.importorskip(f"vtkmodules.{name}") for name in ("vtkIOXML", "vtkCommonDataModel"))
    convert = pytest.importorskip("vtkmodules.util.numpy_support").numpy_to_vtk
    image = model.vtkImageData()
    image.SetExtent(5, 26, -3, 16, 0, 17)
    image.SetSpacing(H, H, H)
    image.SetOrigin(*(ORIGIN - H * np.array([5, -3, 0])))
    for name, array in (("uv", np.zeros((values.size, 2))), ("other", -values.ravel("F")), ("sdf", values.ravel("F"))):
        data = convert(array, deep=True)
        data.SetName(name)
        image.GetPointData().AddArray(data)
    writer = xml.vtkXMLImageDataWriter()
    writer.SetInputData(image)
    writer.SetFileName(str(tmp_path / "a.vti"))
    for mode in ("Ascii", "Binary", "Appended"):
        for codec in ("None", "ZLib", "LZ4", "LZMA"):
            getattr(writer, f"SetDataModeTo{mode}")()
            getattr(writer, f"SetCompressorTypeTo{codec}")()
            assert writer.Write()
            assert_field(import_grid(tmp_path / "a.vti").grid, values)
    assert_field(import_grid(tmp_path / "a.vti", Said(grid="other", flip=True)).grid, values)


def test_vti_in_pieces(values, tmp_path):
    """Two that share a layer of points, as VTK cuts them."""
    low, high = (vti(part, "ascii") for part in (values[:12], values[11:]))
    piece = high[high.index(b"<Piece") : high.index(b"</ImageData>")].replace(b"0 10 0 19", b"11 21 0 19")
    whole = low.replace(b'WholeExtent="0 11', b'WholeExtent="0 21').replace(b"</ImageData>", piece + b"</ImageData>")
    assert_field(import_grid(put(tmp_path / "a.vti", whole)).grid, values)
    with pytest.raises(BadInput, match="NaN"):  # what no piece covers is not made up
        import_grid(put(tmp_path / "b.vti", whole.replace(piece, b"")))


def sphere(shape, origin):
    """The ball in tests/files, as OpenVDB 10 made it: voxels of a quarter, a band of three of them."""
    return np.linalg.norm(points(shape, 0.25, origin) - [2.0, 2.1, 2.2], axis=-1) - 0.9


@pytest.mark.parametrize("name, atol", [("ball", 1e-6), ("ball-half", 2**-11)], ids=["float", "half"])
def test_vdb_by_openvdb(name, atol):
    """Packed by Blosc, with a mask of active samples. Float32 has 24 bits; halves 11, and these lie below 1."""
    found = import_grid(FILES / f"{name}.vdb")
    lattice, dense = found.grid.lattice, found.grid.to_dense()
    np.testing.assert_allclose(lattice.origin / 0.25, np.array([2, 2, 3]) - 3, atol=1e-9)
    assert lattice.shape == (19, 19, 19) and lattice.spacing == 0.25
    truth = sphere(lattice.shape, lattice.origin)
    np.testing.assert_allclose(dense, truth.clip(-0.75, 0.75), rtol=0, atol=atol)
    assert found.grid.metadata.band == pytest.approx(3) and found.steepness.off == 0
    assert [("16 bits" in note) for note in found.notes] == [True] * (name == "ball-half")


MANY = """
import sys, numpy, pyopenvdb as v
def level(name, h, matrix=None):
    made = v.createLevelSetSphere(radius=1.0, center=(0.1, 0.2, 0.3), voxelSize=h, halfWidth=3.0)
    made.name = name
    if matrix:
        made.transform = v.createLinearTransform(matrix)
    return made
fog, mask, uv, whole = v.FloatGrid(), v.BoolGrid(), v.Vec3SGrid(), v.FloatGrid()
fog.name, mask.name, uv.name, whole.name = "density", "mask", "uv", "whole"
fog.gridClass = v.GridClass.FOG_VOLUME
fog.fill((0, 0, 0), (3, 3, 3), 0.5), mask.fill((0, 0, 0), (3, 3, 3), True), uv.fill((0, 0, 0), (3, 3, 3), (1, 2, 3))
x, y, z = numpy.indices((20, 30, 40)).astype(numpy.float32)
whole.copyFromArray(numpy.sqrt((x - 9) ** 2 + (y - 14) ** 2 + (z - 20) ** 2) - 5)
turned = [[0, 0.1, 0, 0], [-0.1, 0, 0, 0], [0, 0, 0.1, 0], [0, 0, 0, 1]]
long = [[0.1, 0, 0, 0], [0, 0.2, 0, 0], [0, 0, 0.1, 0], [1, 2, 3, 1]]
empty = v.FloatGrid()
empty.name = "empty"
v.write(sys.argv[1], [fog, level("turned", 0.1, turned), level("long", 0.1, long), mask, uv, empty, whole,
                      level("fine", 0.02), level("sdf", 0.1)])
"""


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """A file with many grids, by the OpenVDB of the system's Python."""
    path = tmp_path_factory.mktemp("vdb") / "many.vdb"
    if not Path(DEBIAN).exists() or subprocess.run([DEBIAN, "-c", "import pyopenvdb"], capture_output=True).returncode:
        pytest.skip("needs Debian's python3-openvdb")
    subprocess.run([DEBIAN, "-c", MANY, path], check=True)
    return path


@pytest.mark.parametrize("name", [None, "fine"])
def test_vdb_with_many_grids(many, name):
    """`fine` has nodes of over 63 leaves, and tiles inside that are -background."""
    found = import_grid(many, Said(grid=name))
    h = 0.1 if name is None else 0.02
    assert found.grid.metadata.options["array"] == (name or "sdf") and found.notes == ()
    p = points(found.grid.lattice.shape, found.grid.lattice.spacing, found.grid.lattice.origin)
    truth = np.linalg.norm(p - [0.1, 0.2, 0.3], axis=-1) - 1
    dense = found.grid.to_dense()
    near = np.abs(truth) < 2.99 * h
    assert np.count_nonzero(near) > (150_000 if name else 5_000)
    np.testing.assert_allclose(dense[near], truth[near], rtol=0, atol=1e-6)  # the centre in float32
    assert (np.sign(dense) == np.sign(truth))[~near].all()


def test_vdb_without_a_class_is_taken_whole(many):
    """Every sample of its box is active: nothing is clamped, nothing is added around it."""
    found = import_grid(many, Said(grid="whole"))
    assert found.grid.lattice.shape == (20, 30, 40) and found.grid.metadata.band == 5.2
    x, y, z = np.indices((20, 30, 40))
    truth = np.sqrt((x - 9.0) ** 2 + (y - 14.0) ** 2 + (z - 20.0) ** 2) - 5
    near = np.abs(truth) < 3
    np.testing.assert_allclose(found.grid.to_dense()[near], truth[near], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "name, sentence",
    [
        ("density", "fog volume"),
        ("turned", "turned or sheared"),
        ("mask", "no distances"),
        ("uv", "no distances"),
        ("empty", "no active sample"),
        ("nothing", "has no grid 'nothing'"),
    ],
)
def test_vdb_grids_that_are_refused(many, name, sentence):
    with pytest.raises(BadInput, match=sentence):
        import_grid(many, Said(grid=name))


SCHEMES = {
    # Scheme: what stands before the values, and inactive values of samples 0..7 if 0 and 1 are chosen; background 3
    0: (b"", [3] * 8),
    1: (b"", [-3] * 8),
    2: (struct.pack("<f", 7), [7] * 8),
    3: (b"\x03" + bytes(63), [3, 3, -3, -3, -3, -3, -3, -3]),
    4: (struct.pack("<f", 7) + b"\x03" + bytes(63), [3, 3, 7, 7, 7, 7, 7, 7]),
    5: (struct.pack("<2f", 7, 8) + b"\x03" + bytes(63), [8, 8, 7, 7, 7, 7, 7, 7]),
    6: (b"", None),
}
PACKERS = {
    "plain": (0, None),
    "zip": (ZIP, zlib.compress),
    "blosc": (BLOSC, lambda data: blosc.compress(data, b"lz4", 9, 1)),
    "zip, not packed": (ZIP, bytes),
}


@pytest.mark.parametrize("packer", PACKERS)
@pytest.mark.parametrize("kind", ["<f4", "<f2"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_vdb_values(rng, scheme, kind, packer):
    """The seven schemes of inactive values, written here as `io/Compression.h` describes them."""
    before, inactive = SCHEMES[scheme]
    active = np.zeros(512, bool)
    active[8:] = rng.integers(0, 2, 504)
    values = rng.normal(size=512).astype(kind)
    payload = values[active].tobytes() if scheme < 6 else values.tobytes()
    flag, pack = PACKERS[packer]
    if pack is not None:
        packed = pack(payload)
        payload = struct.pack("<q", -len(packed) if packed == payload else len(packed)) + packed
    cursor = Cursor(memoryview(bytes([scheme]) + before + payload), "a.vdb")
    coding = Coding(flag | ACTIVE_MASK, np.dtype("<f4"), np.dtype(kind), 3.0)
    found = coding.run(cursor, active)
    assert cursor.at == len(cursor.data)
    if inactive is None:
        np.testing.assert_array_equal(found, values)
    else:
        np.testing.assert_array_equal(found[active], values[active])
        np.testing.assert_array_equal(found[:8], inactive)


@pytest.mark.parametrize("to", ["vdb", "vti", "vol", "npy"])
def test_round_trip_of_exports(sphere, tmp_path, to):
    """Equal in the band on the same lattice; a level set is cut off at three voxels, and on fewer samples."""
    grid = Grid.from_function(sphere, 40)
    export(grid, tmp_path / f"a.{to}", to)
    back = import_grid(tmp_path / f"a.{to}").grid
    h = grid.lattice.spacing
    # The box of a .vol is float32, of unit size: 2^-24 over the spacing, 1/15, is 1e-6 voxels.
    offset = (back.lattice.origin - grid.lattice.origin) / h
    first = np.rint(offset).astype(int)
    np.testing.assert_allclose(offset, first, atol=2e-6 if to == "vol" else 1e-9)
    assert back.lattice.spacing == pytest.approx(h, rel=1e-7 if to == "vol" else 1e-12)
    mine, theirs = grid.to_dense(), back.to_dense()
    theirs = np.pad(theirs, [(f, n - f - m) for f, n, m in zip(first, mine.shape, theirs.shape, strict=True)])
    near = np.abs(mine) < (2.999 if to == "vdb" else 5.2) * h
    np.testing.assert_array_equal(theirs[near], mine[near])
    assert back.metadata.band == (pytest.approx(3) if to == "vdb" else 5.2)


# ---- what is found out -----------------------------------------------------------------------------------------------
def flagged(grid, kernel):
    """Share of hits with BAND, over a beam that covers the ball."""
    at = np.linspace(-0.4, 0.4, 9)
    x, y = np.meshgrid(at, at)
    p = np.stack([CENTRE[0] + x.ravel(), CENTRE[1] + y.ravel(), np.full(x.size, ORIGIN[2] - 1)], axis=-1)
    still = np.zeros(p.shape)
    rays = Rays(p, np.tile([0.0, 0, 1], (len(p), 1)), still, still, still, still)
    hits, _ = transfer(GridField(grid, kernel=kernel, engine="numpy"), rays)
    assert hits.hit.all()
    # The ball on a lattice of 1/8: linear interpolation is off by up to 3/8 h^2 |curvature| = 0.01.
    np.testing.assert_allclose(ball(hits.p), 0, atol=0.01)
    return float(np.mean((hits.flags & Flag.BAND) != 0))


@pytest.mark.parametrize("kernel", ["linear", "bspline"])
@pytest.mark.parametrize("cut, said, share", [(None, {}, 0), (2.0, {}, None), (None, {"band": 1e-3}, 1)])
def test_hits_are_flagged_where_values_are_not_exact(values, tmp_path, kernel, cut, said, share):
    """Within 2 voxels: enough for a linear cell of diagonal 1.74, never for 5.2."""
    limit = np.inf if cut is None else cut * H
    found = import_grid(put(tmp_path / "a.vol", vol(values.clip(-limit, limit))), Said(**said))
    if cut is not None:
        assert found.grid.metadata.band == pytest.approx(cut) and "the values end at 0.25, 2 voxels" in found.notes[0]
    assert flagged(found.grid, kernel) == (share if cut is None else float(kernel == "bspline"))


def test_a_slope_is_no_plateau():
    """The distance of a plane is greatest on a whole face of the box, and not cut off there."""
    plane = np.broadcast_to(np.arange(16.0) - 7.5, (16, 16, 16))
    assert distances.cut_off(plane) is None
    assert distances.cut_off(plane.clip(-9, 3)) == 3
    assert distances.cut_off(plane.clip(-2, 3)) == 2


@pytest.mark.parametrize("scale", [0.5, 1000.0])
def test_scaled_values_are_noticed(values, tmp_path, scale):
    path = put(tmp_path / "a.vol", vol(values * np.float32(scale)))
    found = import_grid(path)
    note = next(note for note in found.notes if "--scale" in note)
    assert found.steepness.median == pytest.approx(scale, rel=0.02) and found.steepness.off == 1
    assert found.grid.metadata.band == 0 and flagged(found.grid, "linear") == 1
    said = float(note.split("--scale ")[1].split()[0])
    assert said == pytest.approx(1 / scale, rel=0.02)
    mended = import_grid(path, Said(scale=1 / scale))
    assert mended.notes == () and mended.grid.metadata.options["scale"] == 1 / scale
    assert_field(mended.grid, values, 1e-7)  # rounded to float32 when it was scaled, both times


def test_values_that_no_scale_makes_distances(tmp_path):
    """The equation of an ellipsoid: its gradient is 2 over the semi-axis at the three ends, 2.2 to 4.4."""
    ellipsoid = (((points() - CENTRE) / [0.9, 0.7, 0.45]) ** 2).sum(axis=-1) - 1
    found = import_grid(put(tmp_path / "a.vol", vol(ellipsoid.astype(np.float32))))
    assert "no scale would mend" in found.notes[0] and found.grid.metadata.band == 0


def test_inside_that_is_positive_is_told_not_guessed(values, tmp_path):
    path = put(tmp_path / "a.vol", vol(-values))
    found = import_grid(path)
    assert any("--flip" in note for note in found.notes)
    assert_field(found.grid, -values)
    mended = import_grid(path, Said(flip=True))
    assert mended.notes == () and mended.grid.metadata.options["flip"] is True
    assert_field(mended.grid, values)


def test_steepness_is_that_of_a_slope():
    """A plane of slope 3 has no other, however it lies."""
    for direction in ([1.0, 0, 0], [0, 0, 1], [0.6, 0, 0.8], [1 / 3, 2 / 3, 2 / 3]):
        found = distances.steepness(3 * (points((17, 18, 19), 0.1, [-0.8, -0.85, -0.87]) @ direction), 0.1)
        assert found.median == pytest.approx(3, rel=1e-12) and found.off == 1 and found.off_scaled == 0
        assert found.cells >= 16 * 17


# ---- voxels that are no cubes ----------------------------------------------------------------------------------------
def test_resampling_keeps_cubics(rng):
    """Not-a-knot splines are exact for them, border included; only float32 rounds."""
    coefficient = rng.normal(size=(4, 4, 4))

    def cubic(x, y, z):
        return np.polynomial.polynomial.polyval3d(x / 4, y / 4, z / 4, coefficient)

    x, y, z = np.indices((9, 6, 12)).astype(float)
    found = resample.evened(cubic(x, 2.5 * y, 0.5 * z), np.array([1.0, 2.5, 0.5]))
    assert found.shape == (17, 26, 12) == resample.even_shape((9, 6, 12), np.array([1.0, 2.5, 0.5]))
    truth = cubic(*np.indices(found.shape) * 0.5)
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-6 * np.abs(truth).max())


def test_resampling_is_said_and_flagged(tmp_path):
    spacing = np.array([H, 2 * H, 1.5 * H])
    long = ball(points((22, 11, 13), spacing)).astype(np.float32)
    found = import_grid(put(tmp_path / "a.vol", vol(long, spacing=spacing)))
    assert found.resampled and found.grid.metadata.options["resampled"] is True
    assert "resampled to cubes of 0.125" in found.notes[0] and len(found.notes) == 1
    assert found.grid.lattice.shape == (22, 21, 19) and found.grid.lattice.spacing == H
    truth = ball(points((22, 21, 19)))
    # At the surface the ball's fourth derivative is 3 / r^3 at most, 14: splines along y and z are off by 5/384 of it
    # times 0.25^4 and 0.1875^4, 1e-3 together.
    near = np.abs(truth) < 0.5 * H
    np.testing.assert_allclose(found.grid.to_dense()[near], truth[near], rtol=0, atol=1e-3)
    along = CubicSpline(np.arange(11) * 2, long.astype(float), axis=1)(np.arange(21))
    splined = CubicSpline(np.arange(13) * 1.5, along, axis=2)(np.arange(19))
    np.testing.assert_allclose(found.grid.to_dense()[near], splined[near], rtol=0, atol=1e-6)
    assert flagged(found.grid, "linear") == 1


def test_rounded_spacings_are_even():
    low, high = np.float32([0.1, 0.2, 0.3]), np.float32([0.1 + 51.1, 0.2 + 30.0, 0.3 + 0.7])
    shape = (512, 301, 8)
    assert resample.is_even((high.astype(float) - low) / (np.array(shape) - 1), shape)
    assert not resample.is_even(np.array([0.1, 0.1, 0.1001]), (16, 16, 16))


# ---- what is refused -------------------------------------------------------------------------------------------------
def solid(kind="<f4", shape=SHAPE):
    return np.ones(shape, kind)


def spoilt(values, value):
    wrong = values.copy()
    wrong[3, 4, 5] = value
    return wrong


def swap(path, *pairs):
    data = path.read_bytes()
    for a, b in pairs:
        assert a in data
        data = data.replace(a, b, 1)
    return data


BAD = {
    "no such kind": ("a.obj", lambda v: b"v 0 0 0", "none of the files"),
    "empty vol": ("a.vol", lambda v: b"", "does not begin"),
    "old vol": ("a.vol", lambda v: vol(v, head=(b"VOL", 2, 1)), "version 2"),
    "vol of bytes": ("a.vol", lambda v: vol(v, head=(b"VOL", 3, 3)), "uint8"),
    "vol of colours": ("a.vol", lambda v: vol(v, channels=3), "3 channels"),
    "short vol": ("a.vol", lambda v: vol(v)[:-1], "bytes and there are"),
    "flat vol": ("a.vol", lambda v: vol(v[:1]), "1 x 20 x 18"),
    "vol turned inside out": ("a.vol", lambda v: vol(v, spacing=-H), "positive spacing"),
    "vol of needles": ("a.vol", lambda v: vol(v, spacing=(H, H, 1e-5)), "elongated"),
    "NaN": ("a.vol", lambda v: vol(spoilt(v, np.nan)), "1 of the 7920 values"),
    "infinity": ("a.vol", lambda v: vol(spoilt(v, np.inf)), "infinite"),
    "no surface": ("a.vol", lambda v: vol(np.abs(v) + 1), "one sign"),
    "unsigned": ("a.vol", lambda v: vol(np.abs(v).clip(0.1) - np.float32(0.1)), "one sign"),
    "empty npy": ("a.npy", lambda v: b"", "NumPy array"),
    "picture": ("a.npy", lambda v: npy(v[0]), "no grid"),
    "complex": ("a.npy", lambda v: npy(v.astype(complex)), "complex128"),
    "objects": ("a.npy", lambda v: npy(np.array([[[None, "x"]]], dtype=object)), "NumPy array"),
    "slice": ("a.npy", lambda v: npy(v[:1]), "no cell"),
    "beyond float32": ("a.npy", lambda v: npy(spoilt(v.astype("<f8"), 1e300)), "beyond float32"),
    "short npy": ("a.npy", lambda v: npy(v)[:-1], "NumPy array"),
    "empty vti": ("a.vti", lambda v: b"", "XML"),
    "mesh": ("a.vti", lambda v: vti(v, "ascii").replace(b"ImageData", b"PolyData"), "no ImageData"),
    "cells": ("a.vti", lambda v: vti(v, "ascii", more=("", "", "Cell")), "CellDataToPointData"),
    "flat vti": ("a.vti", lambda v: vti(v[:, :1], "ascii"), "2 or more along"),
    "bytes": ("a.vti", lambda v: vti(solid("u1")), "no array of one float"),
    "turned": ("a.vti", lambda v: vti(v, more=("", 'Direction="0 1 0 -1 0 0 0 0 1"', "")), "turned"),
    "letters": ("a.vti", lambda v: vti(v, "ascii").replace(b"</DataArray>", b"x</DataArray>"), "other things"),
    "entities": ("a.vti", lambda v: b'<!DOCTYPE a [<!ENTITY b "c">]>' + vti(v), "declares"),
    "unknown codec": ("a.vti", lambda v: vti(v).replace(b"UInt64", b'UInt64" compressor="x'), "not known"),
    "short vti": ("a.vti", lambda v: vti(v)[:-2000], "beyond its end"),
    "piece outside": ("a.vti", lambda v: vti(v, more=("9 30 0 19 0 17", "", "")), "outside the whole"),
    "huge vti": ("a.vti", lambda v: vti(v).replace(b"0 21 0 19 0 17", b"0 99999 0 99999 0 99999"), "GB of memory"),
    "empty vdb": ("a.vdb", lambda v: b"", "OpenVDB"),
    "future vdb": ("a.vdb", lambda v: swap(FILES / "ball.vdb", (b"\xe0\0\0\0", b"\xff\0\0\0")), "version 255"),
    "fog": (
        "a.vdb",
        lambda v: swap(FILES / "ball.vdb", (b"\x09\0\0\0level set", b"\x0a\0\0\0fog volume")),
        "fog volume",
    ),
    "points": (
        "a.vdb",
        lambda v: swap(FILES / "ball.vdb", (b"Tree_float_5_4_3", b"Tree_ptidx_5_4_3")),
        "no grid of floating",
    ),
    "frustum": ("a.vdb", lambda v: swap(FILES / "ball.vdb", (b"UniformScaleMap", b"NonlinFrustaMap")), "linear"),
    "short vdb": ("a.vdb", lambda v: (FILES / "ball.vdb").read_bytes()[:-1], "corrupt"),
}


def npy(values):
    from io import BytesIO

    file = BytesIO()
    np.save(file, values, allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize("case", BAD)
def test_bad_files_get_one_sentence(values, tmp_path, case):
    name, make, sentence = BAD[case]
    path = put(tmp_path / name, make(values))
    result = CliRunner().invoke(cli, ["import", str(path), "-o", str(tmp_path / "out.zarr.zip")])
    assert isinstance(result.exception, BadInput), result.exception
    assert sentence in str(result.exception), str(result.exception)
    assert "\n" not in str(result.exception) and not (tmp_path / "out.zarr.zip").exists()


@pytest.mark.parametrize(
    "name, said, sentence",
    [
        ("a.vol", {"spacing": 1.0}, "leave out --spacing"),
        ("a.vol", {"grid": "sdf"}, "leave out --grid"),
        ("a.vol", {"band": -1.0}, "positive"),
        ("a.vol", {"scale": 0.0}, "positive"),
        ("a.vol", {"scale": -1.0}, "--flip"),
        ("a.vti", {"grid": "uv"}, "'sdf'"),
        ("nothing.vol", {}, "cannot read"),
    ],
)
def test_bad_options(values, tmp_path, name, said, sentence):
    put(tmp_path / "a.vol", vol(values))
    put(tmp_path / "a.vti", vti(values))
    with pytest.raises(BadInput, match=sentence):
        import_grid(tmp_path / name, Said(**said))


@pytest.mark.parametrize("name", ["a.vol", "a.vti", "ball.vdb"])
def test_memory_is_asked_for_first(values, tmp_path, monkeypatch, name):
    monkeypatch.setattr(field, "available", lambda: 1e5)
    put(tmp_path / "a.vol", vol(values))
    put(tmp_path / "a.vti", vti(values, "raw", "vtkZLibDataCompressor"))
    put(tmp_path / "ball.vdb", (FILES / "ball.vdb").read_bytes())
    with pytest.raises(BadInput, match="GB of memory"):
        import_grid(tmp_path / name)


@pytest.mark.parametrize("name", ["vol", "npy", "raw", "ascii", "binary", "lz4", "vdb"])
def test_hostile_bytes(values, tmp_path, rng, name):
    """Whatever is cut off or altered: a grid, or one sentence."""
    data = {
        "vol": lambda: vol(values),
        "npy": lambda: npy(values),
        "raw": lambda: vti(values),
        "ascii": lambda: vti(values[:, :10, :9], "ascii"),
        "binary": lambda: vti(values, "binary", "vtkLZMADataCompressor"),
        "lz4": lambda: vti(values, "base64", "vtkLZ4DataCompressor"),
        "vdb": (FILES / "ball.vdb").read_bytes,
    }[name]()
    path = tmp_path / f"a.{name if name in ('vol', 'npy', 'vdb') else 'vti'}"
    refused = 0
    for attempt in range(60):
        wrong = np.frombuffer(data, np.uint8).copy()
        if attempt % 3 == 0:
            wrong = wrong[: rng.integers(len(wrong))]
        elif attempt % 3 == 1:
            wrong[rng.integers(min(len(wrong), 1200))] = rng.integers(256)
        else:
            wrong[rng.integers(len(wrong), size=10)] ^= (1 << rng.integers(8, size=10)).astype(np.uint8)
        try:
            import_grid(put(path, wrong.tobytes()))
        except BadInput:
            refused += 1
    assert refused >= 20  # all that were cut short


# ---- the command -----------------------------------------------------------------------------------------------------
def test_command(values, tmp_path):
    put(tmp_path / "a.vol", vol(-values))
    out = tmp_path / "a.zarr.zip"
    done = subprocess.run(
        [sys.executable, "-m", "sdfbake", "import", tmp_path / "a.vol", "-o", out, "--json"], capture_output=True
    )
    assert done.returncode == 0
    record = json.loads(done.stdout)
    assert record["source"] == "dense" and record["band"] == 5.2 and not record["resampled"]
    assert record["options"]["file"] == "a.vol" and record["options"]["format"] == "vol"
    assert record["gradient"]["off_share"] == 0 and record["gradient"]["cells"] > 100
    assert len(record["notes"]) == 1 and b"warning: " in done.stderr and b"--flip" in done.stderr
    assert_field(Grid.load(out), -values)
    again = CliRunner().invoke(cli, ["import", str(tmp_path / "a.vol"), "-o", str(out), "--flip"])
    assert again.exit_code == 0 and "median length" in again.output
    assert_field(Grid.load(out), values)


def test_command_places_an_array(values, tmp_path):
    np.save(tmp_path / "a.npy", values)
    arguments = ["import", str(tmp_path / "a.npy"), "-o", str(tmp_path / "a.zarr.zip"), "--spacing", str(H)]
    assert CliRunner().invoke(cli, [*arguments, "--origin", "-1,2,0.5"]).exit_code == 0
    assert_field(Grid.load(tmp_path / "a.zarr.zip"), values)
    assert isinstance(CliRunner().invoke(cli, [*arguments, "--origin", "1,2"]).exception, BadInput)

"""Rays from files: the camera's own give the camera's picture, and files that are wrong cost one line."""

import json

import numpy as np
import pytest
from scenery import furnish, mirror_scene, sdfrender_caller, sphere_scene

from sdfbake.complaint import BadInput
from sdfrender import render
from sdfrender.image import read_exr
from sdfrender.rayfile import read_rays
from sdfrender.rays import COLUMNS
from sdfrender.render import shoot
from sdfrender.stage import prepare
from sdfrender.viewing import GivenView


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return furnish(tmp_path_factory.mktemp("scenes"))


@pytest.fixture
def call(monkeypatch, capsys):
    """Run the command line in this process: exit code, standard output, standard error."""
    return sdfrender_caller(monkeypatch, capsys)


ALL = ("rgb", "Z", "P", "N", "uv", "duv_dx", "duv_dy", "lod", "flags", "part")


def write(path, rays, size=None, names=COLUMNS):
    """Write rays as a file of either kind."""
    shape = (-1, 3) if size is None else (size[1], size[0], 3)
    columns = {name: getattr(rays, name).reshape(shape) for name in names}
    if path.suffix == ".npz":
        np.savez(path, **columns)
    else:
        header = ", ".join(f"{name}.{axis}" for name in names for axis in "XYZ")
        numbers = np.concatenate([columns[name].reshape(-1, 3) for name in names], axis=1)
        lines = [", ".join(repr(float(number)) for number in row) for row in numbers]
        path.write_text("\n".join([header, *lines]) + "\n")
    return path


@pytest.fixture(scope="module")
def own_rays(folder):
    """A scene, its camera's rays, its picture."""
    path = mirror_scene(folder, outputs=ALL, size=(16, 12))
    stage = prepare(path, engine="numpy")
    return path, stage.scene.camera.camera((16, 12)).rays(), shoot(stage)


@pytest.mark.parametrize("kind", ["picture.npz", "list.npz", "list.csv"])
def test_the_cameras_own_rays(call, own_rays, tmp_path, kind):
    """The same rays brought to the box in place of the sphere: roundings of places, some 1e-15, and float32 files."""
    path, own, theirs = own_rays
    file = write(tmp_path / kind, own, (16, 12) if "picture" in kind else None)
    code, out, err = call("render", path, "-o", tmp_path / "b.exr", "--engine", "numpy", "--rays", file, "--json")
    assert (code, err) == (0, "") and json.loads(out)["plan"]["outputs"] == list(ALL)
    ours = read_exr(tmp_path / "b.exr")
    for name, array in theirs.items():
        expected = array if "picture" in kind else array.reshape(1, 192, -1)
        assert ours[name].shape == expected.shape
        assert ours[name] == pytest.approx(expected, rel=3e-7, abs=1e-6), name
    assert np.ptp(theirs["duv_dx"]) > 0 and set(np.unique(theirs["part"])) == {-1, 0}


def test_given_rays_in_python(own_rays):
    path, own, theirs = own_rays
    direct = render(path, engine="numpy", view=GivenView(own, (16, 12)))
    for name, array in theirs.items():
        assert direct[name] == pytest.approx(array, rel=1e-9, abs=1e-10), name


def test_derivatives_are_asked_for_where_they_are_needed(call, folder, tmp_path):
    """Places and directions alone do for depth, not for a level of detail; directions may then have any length."""
    path = sphere_scene(folder, outputs=("Z", "N"), size=(16, 12))
    rays = prepare(path, engine="numpy").scene.camera.camera((16, 12)).rays()
    long = type(rays)(rays.p, 7.5 * rays.d, *(getattr(rays, name) for name in COLUMNS[2:]))
    bare = write(tmp_path / "bare.npz", long, (16, 12), ("p", "d"))
    assert call("render", path, "-o", tmp_path / "a.exr", "--engine", "numpy", "--rays", bare)[0] == 0
    ours, theirs = read_exr(tmp_path / "a.exr"), render(path, engine="numpy")
    assert ours["Z"] == pytest.approx(theirs["Z"], rel=1e-6) and np.abs(ours["N"] - theirs["N"]).max() < 1e-6
    code, _, err = call("render", path, "-o", tmp_path / "b.exr", "--outputs", "lod", "--rays", bare)
    assert code == 2 and "dp_dx, dp_dy, dd_dx, dd_dy" in err and not (tmp_path / "b.exr").exists()
    some = write(tmp_path / "some.npz", rays, None, ("p", "d", "dp_dx", "dd_dx"))
    with pytest.raises(BadInput, match="no dp_dy, dd_dy,"):
        read_rays(some, differentials=True)
    assert read_rays(some, differentials=False).size == (192, 1)


def test_directions_of_any_length(tmp_path):
    """As long or short as a float is; a byte order mark before the header does no harm."""
    d = np.array([[3.0, 0, 4.0], [3e-200, 0, 4e-200], [3e300, 0, 4e300]])
    np.savez(tmp_path / "a.npz", p=np.zeros((3, 3)), d=d)
    assert read_rays(tmp_path / "a.npz", differentials=False).rays.d == pytest.approx(np.tile([0.6, 0, 0.8], (3, 1)))
    text = "p.X,p.Y,p.Z,d.X,d.Y,d.Z\n\n0,0,0,0,0,2\n"
    (tmp_path / "b.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert read_rays(tmp_path / "b.csv", differentials=False).rays.d.tolist() == [[0, 0, 1]]


def bad_files(folder):
    """Write files that are wrong, and what is said of them."""
    p, d = np.zeros((4, 3)), np.tile([0.0, 0.0, 1.0], (4, 1))
    arrays = {
        "no directions": ({"p": p}, "no d"),
        "nothing": ({}, "no p and no d"),
        "two columns": ({"p": p[:, :2], "d": d[:, :2]}, "(4, 2)"),
        "no rays": ({"p": p[:0], "d": d[:0]}, "(0, 3)"),
        "unlike shapes": ({"p": p, "d": d[:3]}, "make them alike"),
        "not finite": ({"p": p, "d": d * [1, 1, np.nan]}, "finite"),
        "no length": ({"p": p, "d": d * [[0], [1], [1], [0]]}, "2 directions of no length"),
        "not of unit length": ({"p": p, "d": 2 * d, **dict.fromkeys(COLUMNS[2:], p)}, "unit length"),
        "pickled": ({"p": np.array([{}], object), "d": d}, "cannot be read"),
        "words": ({"p": np.array([["a", "b", "c"]]), "d": d[:1]}, "cannot be read"),
    }
    for name, (columns, says) in arrays.items():
        np.savez(folder / f"{name}.npz", **columns)
        yield f"{name}.npz", says
    header = "p.X,p.Y,p.Z,d.X,d.Y,d.Z\n"
    texts = {
        "empty.csv": (b"", "no p"),
        "header.csv": (header.encode(), "(0, 3)"),
        "ragged.csv": (f"{header}1,2,3,4,5,6\n1,2,3\n".encode(), "cannot be read"),
        "word.csv": (f"{header}1,2,3,4,5,six\n".encode(), "cannot be read"),
        "names.csv": (b"x,y,z\n1,2,3\n", "no p and no d"),
        "bytes.csv": (b"\xff\xfe\x00\x81", "cannot be read"),
        "long.csv": (header.encode() + b"1" * 200_000 + b",2,3,4,5,6\n", "cannot be read"),
        "text.npz": (b"not an archive", "cannot be read"),
        "none.npz": (b"", "cannot be read"),
        "cut.npz": ((folder / "no length.npz").read_bytes()[:-40], "cannot be read"),
    }
    for name, (text, says) in texts.items():
        (folder / name).write_bytes(text)
        yield name, says
    np.save(folder / "array.npy", p)
    (folder / "array.npy").rename(folder / "array.npz")
    yield "array.npz", "cannot be read"
    broken = bytearray((folder / "no length.npz").read_bytes())
    broken[150:160] = b"\x00\xff" * 5
    (folder / "broken.npz").write_bytes(bytes(broken))
    yield "broken.npz", ""
    yield "missing.npz", "there are no rays"
    yield ".", "cannot be read"


def test_files_that_are_no_rays(call, folder, tmp_path):
    """Every one: exit code 2, one line that names it, no picture."""
    path = sphere_scene(folder, outputs=("Z",), size=(4, 4))
    seen = 0
    for name, says in bad_files(tmp_path):
        code, out, err = call("render", path, "-o", tmp_path / "a.exr", "--engine", "numpy", "--rays", tmp_path / name)
        assert (code, out) == (2, "") and err.startswith("error: ") and err.count("\n") == 1, (name, err)
        assert says in err and len(err) < 600, (name, err)
        assert str(tmp_path / name) in err and not (tmp_path / "a.exr").exists()
        seen += 1
    assert seen >= 20


def test_a_size_and_rays_are_too_much(call, folder, tmp_path):
    code, _, err = call("render", sphere_scene(folder), "-o", tmp_path / "a.exr", "--size", "3x3", "--rays", "x.npz")
    assert code == 2 and "--size" in err and "--rays" in err

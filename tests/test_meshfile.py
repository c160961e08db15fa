"""Mesh files: our PLY bit for bit, foreign formats welded, and what is no mesh."""

import base64
import json

import numpy as np
import pytest
import trimesh

from datasets_synthetic import real
from sdfbake import BadInput, Mesh
from sdfbake.diagnosis import diagnose
from sdfbake.meshfile import save, weld

TETRA_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.fixture
def mesh():
    rng = np.random.default_rng(0)
    return Mesh(
        rng.normal(size=(4, 3)) / 3 + 1e3,  # digits that float32 does not have
        TETRA_FACES,
        rng.uniform(size=(4, 3, 2)),
        np.array([0, 2, 1, 0]),
        np.array([0, 0, 1, 1]),
        ("glass ball", "täble\nleg"),
        "mm",
    )


def assert_same(one, other):
    """Raise unless two meshes hold the same bits."""
    for name in ("vertices", "faces", "uv", "chart", "part"):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_array_equal(a, b)
    assert one.units == other.units and one.texture == other.texture


def test_ply_round_trip(mesh, tmp_path):
    save(mesh, tmp_path / "a.ply")
    loaded = Mesh.load(tmp_path / "a.ply")
    assert_same(mesh, loaded)
    assert loaded.part_names == ("glass ball", "t?ble leg")  # a PLY header is ASCII
    save(loaded, tmp_path / "b.ply")
    save(loaded, tmp_path / "c.ply")
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "c.ply").read_bytes()
    with pytest.raises(AssertionError):
        assert_same(mesh, mesh.with_(vertices=mesh.vertices + 1e-10))


def test_ply_without_uv(mesh, tmp_path):
    save(mesh.with_(uv=None), tmp_path / "a.ply")
    loaded = Mesh.load(tmp_path / "a.ply")
    assert loaded.uv is None
    np.testing.assert_array_equal(loaded.chart, mesh.chart)


def test_foreign_ply_with_polygons(tmp_path):
    (tmp_path / "quad.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        "property float s\nproperty float t\nelement face 2\nproperty list uchar int vertex_index\nend_header\n"
        "0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n0 0 1 0.5 0.5\n4 0 1 2 3\n3 0 1 4\n"
    )
    loaded = Mesh.load(tmp_path / "quad.ply")
    assert loaded.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
    assert loaded.uv.tolist()[1] == [[0, 0], [1, 1], [0, 1]]


OBJ = """# a cube's worth of trouble: seams, counting backwards, quads, groups
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
g bottom
f 1/1 4/2 3/3 2/4
g rest
f 5/1 6/2 7/3 8/4
f 1/1/1 2/2/1 6/3/1 5/4/1
f -6/-4 -5/-3 -1/-2 -2/-1
f 2/1 3/2 7/3 6/4
f 4/1 1/2 5/3 8/4
"""


def test_obj_with_uv_is_closed(tmp_path):
    (tmp_path / "cube.obj").write_text(OBJ)
    loaded = Mesh.load(tmp_path / "cube.obj")
    assert loaded.vertices.shape == (8, 3) and loaded.faces.shape == (12, 3)
    assert loaded.part_names == ("bottom", "rest") and loaded.part.tolist() == [0] * 2 + [1] * 10
    assert loaded.uv[1].tolist() == [[0, 0], [1, 1], [0, 1]]
    assert len(np.unique(loaded.chart)) == 6  # every side has its own square: they share no edge in the atlas
    assert not diagnose(loaded).findings[1:] and not diagnose(loaded).has("open")


def test_obj_backwards_indices(tmp_path):
    (tmp_path / "cube.obj").write_text(OBJ)
    loaded = Mesh.load(tmp_path / "cube.obj")
    assert loaded.faces[6].tolist() == [2, 3, 7]  # -6, -5, -1 of eight


def test_obj_materials_beat_groups(tmp_path):
    text = OBJ.replace("g rest", "usemtl red\ng rest").replace("f 2/1", "usemtl blue\nf 2/1")
    (tmp_path / "cube.obj").write_text(text)
    assert Mesh.load(tmp_path / "cube.obj").part_names == ("unnamed", "red", "blue")


@pytest.mark.parametrize("suffix", ["stl", "off", "obj", "ply", "glb"])
def test_foreign_formats_are_welded(tmp_path, suffix):
    ball = trimesh.creation.icosphere(2)
    ball.export(tmp_path / f"ball.{suffix}")
    loaded = Mesh.load(tmp_path / f"ball.{suffix}")
    assert loaded.vertices.shape == (162, 3) and loaded.faces.shape == (320, 3)
    # float32 formats round at 6e-8; OBJ and OFF print eight digits or more
    assert np.abs(np.linalg.norm(loaded.vertices, axis=1) - 1).max() < 2e-7
    assert diagnose(loaded).findings == ()


def test_scene_has_parts_and_places(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), geom_name="box")
    scene.add_geometry(
        trimesh.creation.icosphere(1), geom_name="ball", transform=trimesh.transformations.translation_matrix([5, 0, 0])
    )
    scene.export(tmp_path / "two.glb")
    loaded = Mesh.load(tmp_path / "two.glb")
    assert sorted(loaded.part_names) == ["ball", "box"]
    ball = loaded.part == loaded.part_names.index("ball")
    assert ball.sum() == 80
    np.testing.assert_allclose(loaded.vertices[loaded.faces[ball]].mean(axis=(0, 1)), [5, 0, 0], atol=1e-6)


def test_weld_keeps_the_order_of_first_appearance():
    vertices = np.array([[3.0, 0, 0], [1, 0, 0], [3, 0, 0], [-0.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    kept, place = weld(vertices)
    assert kept.tolist() == [[3, 0, 0], [1, 0, 0], [0, 0, 0]]
    assert place.tolist() == [0, 1, 0, 2, 2, 1]


BAD = {
    "text.obj": b"hello\n",
    "noise.ply": bytes(range(256)),
    "empty.ply": b"",
    "empty.stl": b"",
    "noise.glb": bytes(range(256)),
    "image.png": b"\x89PNG\r\n",
    "lines.obj": b"v 0 0 0\nv 1 0 0\nl 1 2\n",
    "beyond.obj": b"v 0 0 0\nf 1 2 3\n",
    "zero.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n",
    "words.obj": b"v a b c\nf 1 1 1\n",
    "huge.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\n"
    b"property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n",
}


@pytest.mark.parametrize("name", BAD)
def test_not_a_mesh(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(BAD[name])
    with pytest.raises(BadInput) as caught:
        Mesh.load(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_truncated_ply(mesh, tmp_path):
    save(mesh, tmp_path / "a.ply")
    whole = (tmp_path / "a.ply").read_bytes()
    for length in (10, 200, len(whole) - 1):
        (tmp_path / "cut.ply").write_bytes(whole[:length])
        with pytest.raises(BadInput):
            Mesh.load(tmp_path / "cut.ply")


def test_missing(tmp_path):
    with pytest.raises(BadInput, match="no mesh file"):
        Mesh.load(tmp_path / "none.ply")


def test_unwritable(mesh, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot write"):
        save(mesh, tmp_path / "file" / "a.ply")
    with pytest.raises(BadInput, match=r"\.ply"):
        save(mesh, tmp_path / "a.obj")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def textured_obj(folder, library, head="mtllib a.mtl"):
    """A cube of two materials, red first, beside a library; return what is recorded."""
    (folder / "cube.obj").write_text(
        OBJ.replace("v 0 0 0\n", f"{head}\nv 0 0 0\nusemtl red\n", 1) + "usemtl blue\nf 1 2 3\n"
    )
    (folder / "a.mtl").write_text(library)
    return Mesh.load(folder / "cube.obj").texture


SPELLINGS = {
    "plain": "map_Kd wood.png",
    "indented, other case": "\t map_kd   wood.png  ",
    "options": "map_Kd -s 1 1.5 -2e0 -o 0 -blendu on -mm 0 1 -clamp off wood.png",
    "quoted": 'map_Kd "wood.png"',
    "another machine's path": "map_Kd C:\\art\\wood.png",
    "spaces": "map_Kd -bm 2 fine old wood.png",
    "folder": "map_Kd img/2.png",
    "backslashes": "map_Kd -t 1 2 3 img\\2.png",
}


@pytest.mark.parametrize("name", SPELLINGS)
def test_mtl_texture(tmp_path, name):
    (tmp_path / "img").mkdir()
    for image in ("wood.png", "fine old wood.png", "img/2.png"):
        (tmp_path / image).touch()
    line = SPELLINGS[name]
    expected = "fine old wood.png" if "old" in line else "img/2.png" if "2.png" in line else "wood.png"
    assert textured_obj(tmp_path, f"newmtl green\nmap_Kd no.png\nnewmtl blue\n{line}\n") == str(tmp_path / expected)


@pytest.mark.parametrize("head", ["mtllib none.mtl a.mtl", "mtllib my a.mtl", "mtllib none.mtl\nmtllib ./a.mtl"])
def test_mtl_names(tmp_path, head):
    (tmp_path / "my a.mtl").write_text("newmtl red\nmap_Kd a.png\n")
    (tmp_path / "a.png").touch()
    assert textured_obj(tmp_path, "newmtl red\nmap_Kd a.png\n", head) == str(tmp_path / "a.png")


def test_no_texture(tmp_path):
    assert textured_obj(tmp_path, "newmtl red\nmap_Kd\nmap_Ka wood.png\nnewmtl blue") is None
    assert textured_obj(tmp_path, "newmtl red\nmap_Kd a.png\n", "mtllib none.mtl") is None


def test_missing_texture_keeps_its_name(tmp_path):
    with pytest.warns(UserWarning, match="names the texture lost.png, which is missing"):
        assert textured_obj(tmp_path, "newmtl red\nmap_Kd lost.png\n") == "lost.png"


def test_several_textures(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.png").touch()
    library = "newmtl blue\nmap_Kd b.png\nnewmtl red\nmap_Kd a.png\n"
    with pytest.warns(UserWarning, match=r"a\.png is recorded, not .*b\.png"):
        assert textured_obj(tmp_path, library) == str(tmp_path / "a.png")
    with pytest.warns(UserWarning, match=r"b\.png is recorded, not lost\.png"):
        assert textured_obj(tmp_path, library.replace("a.png", "lost.png")) == str(tmp_path / "b.png")


def test_texture_of_the_bunny():
    mesh = real.load("bunny_textured")
    assert mesh.uv is not None and mesh.texture == str(real.path_of("bunny_textured").parent / "TextureDouble_A.png")


def gltf(folder, image, texture=None, binary=False, name="a.gltf"):
    """A triangle whose material has an image, as a glTF file."""
    data = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.zeros((3, 2), "<f4").tobytes()
    buffer = {"byteLength": len(data)}
    if not binary:
        buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
        {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
    ]
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "buffers": [buffer],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 24},
        ],
        "accessors": accessors,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 1}]}],
        "materials": [{}, {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [texture or {"source": 0}],
        "images": [image],
    }
    text = json.dumps(tree).encode()
    if binary:
        text += b" " * (-len(text) % 4)
        chunks = [len(text).to_bytes(4, "little") + b"JSON" + text, len(data).to_bytes(4, "little") + b"BIN\0" + data]
        size = 12 + sum(map(len, chunks))
        text = b"glTF" + (2).to_bytes(4, "little") + size.to_bytes(4, "little") + b"".join(chunks)
    (folder / name).write_bytes(text)
    return Mesh.load(folder / name).texture


# The smallest PNG: one pixel.
PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA60e6kgAAAABJRU5ErkJggg=="
)


@pytest.mark.parametrize("binary", [False, True], ids=["gltf", "glb"])
def test_gltf_texture(tmp_path, binary):
    (tmp_path / "old wood.png").write_bytes(PIXEL)
    name = "a.glb" if binary else "a.gltf"
    for texture in ({"source": 0}, {"extensions": {"EXT_texture_webp": {"source": 0}}}):
        told = gltf(tmp_path, {"uri": "old%20wood.png"}, texture, binary, name)
        assert told == str(tmp_path / "old wood.png")
    inside = {"uri": "data:image/png;base64," + base64.b64encode(PIXEL).decode()}
    assert gltf(tmp_path, inside, None, binary, name) == f"{tmp_path / name}#image 0"
    assert gltf(tmp_path, {**inside, "name": "bark"}, None, binary, name) == f"{tmp_path / name}#image bark"
    assert gltf(tmp_path, inside, {"sampler": 0}, binary, name) is None


def test_gltf_missing_texture(tmp_path):
    with pytest.warns(UserWarning, match=r"lost\.png, which is missing"):
        assert gltf(tmp_path, {"uri": "lost.png"}) == "lost.png"


def test_embedded_texture_as_exported(tmp_path):
    from PIL import Image

    box = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (4, 4)))
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=material)
    box.export(tmp_path / "box.glb")
    loaded = Mesh.load(tmp_path / "box.glb")
    assert loaded.texture == f"{tmp_path / 'box.glb'}#image 0" and loaded.uv is not None


@pytest.mark.parametrize("name", ["wood.png", "a b/ täxtur  100%.png", "A.glb#image bark", "two\nlines"])
def test_texture_survives_our_ply(mesh, tmp_path, name):
    save(mesh.with_(texture=name), tmp_path / "a.ply")
    assert Mesh.load(tmp_path / "a.ply").texture == name


def test_texture_of_a_meshlab_ply(tmp_path):
    (tmp_path / "a.png").touch()
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    assert Mesh.load(tmp_path / "a.ply").texture == str(tmp_path / "a.png")

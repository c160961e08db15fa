"""The web page of a grid: what is packed is the grid, no cell with surface is skipped, and its picture is ours."""

import base64
import json
import zlib
from html.parser import HTMLParser
from itertools import product

import numpy as np
import pytest
from click.testing import CliRunner
from exported import pile
from PIL import Image

import datasets_synthetic
import sdfbake.bricks
import sdfbake.view.packing
from sdfbake import Grid
from sdfbake.__main__ import cli
from sdfbake.bricks import SIDE
from sdfbake.complaint import BadInput
from sdfbake.view import view
from sdfbake.view.cells import brick_gaps, gaps
from sdfbake.view.packing import FULL, PRESENT, pack
from sdfrender import GridField, trace
from validate.browser import Browser, found
from validate.viewer import compare_in

KERNELS = ("linear", "catmull-rom", "bspline")
needs_chromium = pytest.mark.skipif(found() is None, reason="there is no Chromium here: the page was not opened")


@pytest.fixture(scope="module")
def grid():
    return pile(41)


@pytest.fixture(scope="module")
def noise():
    """Numbers that are no distances: every cell may hold surface, some in several sheets."""
    rng = np.random.default_rng(7)
    coarse = rng.normal(size=(6, 5, 7)).repeat(4, 0).repeat(4, 1).repeat(4, 2)
    return Grid.from_dense(coarse + 0.3 * rng.normal(size=coarse.shape))


@pytest.fixture(scope="module")
def saved(grid, tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "pile.zarr.zip"
    grid.save(path)
    return path


def unpacked(text, kind):
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), kind)


def joined(text):
    low, high = unpacked(text, np.uint8).reshape(2, -1).astype(np.uint16)
    return low | (high << 8)


def test_distances_are_float16_of_the_samples_in_voxels(grid):
    kept = joined(pack(grid).arrays["distance"]).view(np.float16).reshape(grid.distance.shape).astype(float)
    voxels = grid.distance.astype(float) / grid.lattice.spacing
    # Half a unit in the last place of eleven bits; below 2^-14 the absolute half step of subnormal numbers.
    assert (np.abs(kept - voxels) <= np.maximum(np.abs(voxels) * 2.0**-11, 2.0**-25)).all()


def test_numbers_that_are_no_distances_keep_their_signs_and_digits(noise):
    kept = joined(pack(noise).arrays["distance"]).view(np.float16).reshape(noise.distance.shape).astype(float)
    ratio = kept[noise.distance != 0] / noise.distance[noise.distance != 0]
    assert ratio.min() > 0 and ratio.max() / ratio.min() < 1 + 2.0**-9


def test_texture_coordinates_are_those_of_the_samples_to_half_a_code(grid):
    packed = pack(grid)
    head = packed.head
    near = np.abs(grid.distance) <= 2 * np.float32(grid.lattice.spacing)
    code = np.moveaxis(joined(packed.arrays["uv"]).reshape(2, *grid.distance.shape), 0, -1)
    uv = np.array(head["offset"]) + np.array(head["scale"]) * code / FULL
    chart = joined(packed.arrays["chart"]).reshape(grid.distance.shape).astype(int) - 1
    inside = sdfbake.bricks.in_lattice(grid.bricks.index, grid.lattice.shape)
    assert np.array_equal(chart >= 0, near & inside)
    assert np.array_equal(chart[chart >= 0], grid.chart[chart >= 0])
    # Half a code, and the rounding of the float32 that was coded.
    assert np.abs(uv - grid.uv)[chart >= 0].max() <= 0.5001 * max(head["scale"]) / FULL + 1e-7


def test_the_table_names_slots_and_empty_cubes(grid):
    table = unpacked(pack(grid).arrays["table"], "<i4").reshape(grid.bricks.slot.shape)
    assert np.array_equal(table - PRESENT, np.where(grid.bricks.slot >= 0, grid.bricks.slot, table - PRESENT))
    absent = grid.bricks.slot < 0
    for index in np.argwhere(absent):
        low, high = index - table[tuple(index)] + 1, index + table[tuple(index)]
        assert (low >= 0).all() and (high <= absent.shape).all()
        assert absent[tuple(slice(a, b) for a, b in zip(low, high, strict=True))].all()


@pytest.mark.parametrize("which", ["grid", "noise"])
def test_no_kernel_has_a_root_in_a_cell_that_is_skipped(which, request):
    given = request.getfixturevalue(which)
    gap = gaps(given.bricks, given.distance, given.lattice.shape)
    slot, *inner = np.nonzero(gap == 1)  # the others lie among those
    cell = given.bricks.index[slot] * SIDE + np.stack(inner, axis=-1)
    cell = cell[(cell < np.array(given.lattice.shape) - 1).all(axis=1)][::3]
    place = np.array(list(product((0.0, 0.5, 1.0), repeat=3)))
    points = given.lattice.to_world(cell[:, None] + place)
    for kernel in KERNELS:
        field = GridField(given, kernel=kernel, engine="numpy")
        (value,) = field.jet(points.reshape(-1, 3), 0)
        value = value.reshape(points.shape[:2])
        assert ((value > 0).all(axis=1) | (value < 0).all(axis=1)).all(), kernel


def test_most_cells_are_skipped(grid):
    gap = gaps(grid.bricks, grid.distance, grid.lattice.shape)
    # Surface passes through about as many cells as there are samples within half a voxel of it, and a half more by
    # its slant; the nets of three kernels are wider than the surface by less than that again.
    assert 0 < (gap == 0).sum() < 3 * (np.abs(grid.distance) < 0.5 * grid.lattice.spacing).sum()


def test_cubes_of_cells_stay_in_their_brick_and_are_empty(grid):
    gap = gaps(grid.bricks, grid.distance, grid.lattice.shape)
    for slot, i, j, k in np.argwhere(gap > 1):
        g = gap[slot, i, j, k]
        assert min(i, j, k) - g + 1 >= 0 and max(i, j, k) + g <= SIDE
        assert gap[slot, i - g + 1 : i + g, j - g + 1 : j + g, k - g + 1 : k + g].all()


def test_gaps_of_bricks_reach_the_border_of_the_lattice_at_most(grid):
    gap = brick_gaps(grid.bricks)
    assert np.array_equal(gap == 0, grid.bricks.slot >= 0)
    assert (gap[0] <= 1).all() and (gap[:, :, -1] <= 1).all()


class _Elements(HTMLParser):
    """What a page would fetch: sources and links."""

    def __init__(self):
        super().__init__()
        self.fetched = []

    def handle_starttag(self, tag, attributes):
        self.fetched += [(tag, name) for name, _ in attributes if name in ("src", "href", "srcset", "action")]


def test_the_page_stands_alone_and_escapes_its_title(grid, tmp_path):
    done = view(grid, tmp_path / "page.html", title="<b>&")
    text = done.file.read_text(encoding="utf-8")
    elements = _Elements()
    elements.feed(text)
    assert elements.fetched == [] and "default-src 'none'" in text
    assert "<b>" not in text and "<title>&lt;b&gt;&amp;</title>" in text
    assert done.size == len(text.encode()) and done.textured


def test_a_texture_is_embedded_as_it_is(grid, tmp_path):
    Image.new("RGB", (4, 4), "red").save(tmp_path / "red.png")
    text = view(grid, tmp_path / "page.html", texture=tmp_path / "red.png").file.read_text(encoding="utf-8")
    inside = text.split('data-type="image/png">')[1].split("</script>")[0]
    assert base64.b64decode(inside) == (tmp_path / "red.png").read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("sky.exr", b"\x76\x2f\x31\x01", "of the kind OpenEXR, which a page cannot show"),
        ("text.png", b"no image", "of the kind unknown"),
        ("none.png", None, "there is no texture"),
    ],
    ids=["exr", "text", "missing"],
)
def test_what_is_no_texture_is_refused(grid, tmp_path, name, content, said):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=said):
        view(grid, tmp_path / "page.html", texture=tmp_path / name)
    assert not (tmp_path / "page.html").exists()


def test_grids_too_large_are_refused_with_the_number(grid, tmp_path, monkeypatch):
    monkeypatch.setattr(sdfbake.view.packing, "MOST_BRICKS", 10)
    with pytest.raises(BadInput, match=f"has {len(grid.bricks)} bricks .* can hold 10: bake it at a resolution of"):
        view(grid, tmp_path / "page.html")


def test_a_texture_needs_coordinates_and_a_page_needs_surface(noise, tmp_path):
    Image.new("RGB", (4, 4)).save(tmp_path / "black.png")
    with pytest.raises(BadInput, match="no texture coordinates"):
        view(noise, tmp_path / "page.html", texture=tmp_path / "black.png")
    with pytest.raises(BadInput, match="no surface"):
        view(Grid.from_dense(np.ones((20, 20, 20))), tmp_path / "page.html")


def test_the_command_writes_the_page_and_says_so(saved, tmp_path):
    result = CliRunner().invoke(cli, ["view", str(saved), "-o", str(tmp_path / "pile.html"), "--json"])
    record = json.loads(result.stdout)
    assert record["bytes"] == (tmp_path / "pile.html").stat().st_size and record["textured"]
    assert "<title>pile</title>" in (tmp_path / "pile.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def browser():
    with Browser(found()) as running:
        yield running


@needs_chromium
@pytest.mark.parametrize("kernel", KERNELS)
def test_the_picture_agrees_with_the_renderers(browser, saved, kernel):
    figures = compare_in(browser, saved, kernel, (80, 80))
    assert figures["complaints"] == figures["requests"] == 0
    assert figures["hits"] > 1000 and figures["missed_share"] < 0.002
    # Taps within 2.6 voxels are rounded by 2^-11 of their size, 6e-4 voxels on average; the mean of a stencil's errors
    # is a third of that, and a hit seen at 78 degrees moves by five times as much. Gradients' weights are larger by 2.
    assert figures["t_mean"] < 2e-4 and figures["t_max"] < 0.03
    assert figures["normal_mean"] < 0.02 and figures["normal_p99"] < 0.1
    # Where all corners are of one chart both interpolate the same numbers, to 16 bits here: 1/64 of a texel; elsewhere
    # the page's map is constant along the normal and this shape's is not: a fiftieth of the hits, by some texels.
    assert figures["uv_mean"] < 0.3 and figures["lod_mean"] < 0.01 and figures["chart_share"] < 0.01
    # Colours: two units of rounding, and the card's own way to filter at the edges of squares.
    assert figures["inner_mean"] < 2


class _Uncharted:
    """The torus as one chart, which meets itself along its cuts."""

    def __init__(self):
        self.of = datasets_synthetic.shape("torus")
        self.bounds, self.distance, self.uv = self.of.bounds, self.of.distance, self.of.uv

    def chart(self, p):
        return np.zeros(len(p), int)


@needs_chromium
@pytest.mark.parametrize("cut", ["charts", "itself"])
def test_texture_coordinates_are_those_of_the_shape_across_its_cuts(browser, tmp_path, cut):
    shape = datasets_synthetic.shape("torus") if cut == "charts" else _Uncharted()
    grid = Grid.from_function(shape, 48)
    assert (grid.chart is None) == (cut == "itself")
    page = view(grid, tmp_path / "page.html").file
    uv, chart, points, _, _ = probed(browser, page)
    alike = shape.chart(points) == chart
    assert (~alike).mean() < 0.02
    off = np.abs(uv - shape.uv(points))[alike]
    off = np.minimum(off, 1 - off).max(axis=1)  # the torus' coordinates come round
    # A voxel is 0.028 of the tube's way round; closest points bend the map by a share of that, and no cut is smeared.
    assert off.max() < 0.003


@needs_chromium
def test_surface_is_seen_up_to_the_border_of_the_lattice(browser, tmp_path):
    x, y, z = np.indices((21, 19, 26)) * 0.55
    grid = Grid.from_dense(np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x), spacing=0.1)
    _, _, _, origin, (d, t) = probed(browser, view(grid, tmp_path / "page.html").file)
    hits = trace(GridField(grid, engine="numpy"), np.broadcast_to(origin, d.shape), d)
    there = np.isfinite(hits.t)
    # Along silhouettes a ray may pass one way or the other.
    assert ((t > 0) != there).mean() < 0.003
    both = there & (t > 0)
    off = np.abs(t - np.where(there, hits.t, 0))[both] / grid.lattice.spacing
    # Numbers up to 2.6 over slopes of 0.8 a voxel and more, to 11 bits: 1e-3 voxel, and more where rays graze.
    assert np.median(off) < 1e-3 and (off < 0.02).mean() > 0.99


def probed(browser, page):
    """Return uv, chart and position of all hits of a page; where the camera is, and all rays with their distances."""
    browser.open(page, (200, 150))
    head = browser.evaluate("viewer.ready.then((ready) => ready.head)")
    camera = {
        "origin": (np.array(head["centre"]) + 3 * head["radius"] * np.array([0.3, 0.4, 0.9])).tolist(),
        "target": head["centre"],
        "up": [0, 1, 0],
        "fov": 40,
        "size": [96, 80],
    }
    answer = browser.evaluate(f"viewer.probe({json.dumps(camera)})")
    width, height = answer["size"]
    normal, uv = (np.frombuffer(base64.b64decode(answer[name]), "<f4").reshape(-1, 4) for name in ("normal", "uv"))
    hit = normal[:, 3] > 0
    d, t = directions(camera, width, height), normal[:, 3].astype(float) * head["spacing"]
    points = np.array(camera["origin"]) + (t[:, None] * d)[hit]
    return uv[hit, :2].astype(float), uv[hit, 3].astype(int), points, np.array(camera["origin"]), (d, t)


def directions(camera, width, height):
    """Return the pixels' rays by the plainest way: through points of a plane at unit distance."""
    view_ = np.subtract(camera["target"], camera["origin"])
    view_ = view_ / np.linalg.norm(view_)
    right = np.cross(view_, camera["up"])
    right /= np.linalg.norm(right)
    up = np.cross(right, view_)
    half = np.tan(np.radians(camera["fov"]) / 2)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    a, b = (x - width / 2) * 2 * half / height, (height / 2 - y) * 2 * half / height
    d = (view_ + a[..., None] * right + b[..., None] * up).reshape(-1, 3)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@needs_chromium
def test_controls_and_keys_change_what_is_asked_for(browser, grid, tmp_path):
    browser.open(view(grid, tmp_path / "page.html").file, (200, 150))
    browser.evaluate("viewer.ready.then(() => 1)")
    press = "document.dispatchEvent(new KeyboardEvent('keydown', {key: '%s', bubbles: true}))"
    chosen = "document.querySelector('input[name=%s]:checked').value"
    for key, name, value in (("4", "shading", "footprint"), ("k", "kernel", "linear"), ("1", "shading", "shaded")):
        browser.evaluate(press % key)
        assert browser.evaluate(chosen % name) == value
    browser.evaluate(press % "m")
    assert browser.evaluate("document.getElementById('mipmaps').checked") is False


def looks_from(browser):
    """Return where the page's camera is, relative to its target, and the target."""
    camera = browser.evaluate("viewer.ready.then((ready) => ready.camera())")
    return np.subtract(camera["origin"], camera["target"]), np.array(camera["target"])


def drag(browser, kind, by, **more):
    """Press in the middle of the canvas, move and let go."""
    x, y = browser.evaluate("[canvas.clientWidth / 2, canvas.clientHeight / 2]")
    browser.ask("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button=kind, clickCount=1, **more)
    held = {"left": 1, "right": 2}[kind]
    browser.ask("Input.dispatchMouseEvent", type="mouseMoved", x=x + by[0], y=y + by[1], buttons=held, **more)
    browser.ask("Input.dispatchMouseEvent", type="mouseReleased", x=x + by[0], y=y + by[1], button=kind, clickCount=1)


@needs_chromium
def test_mouse_fingers_and_keys_move_the_camera(browser, grid, tmp_path):
    browser.open(view(grid, tmp_path / "page.html").file, (800, 200))
    arm, target = looks_from(browser)
    drag(browser, "left", (30, 0))
    turned, same = looks_from(browser)
    # To the right: the object's front goes along, so the camera goes to the left, on its circle.
    angle = np.arctan2(turned[0], turned[2]) - np.arctan2(arm[0], arm[2])
    assert angle == pytest.approx(-4 * 30 / 200) and np.array_equal(same, target)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(arm)) and turned[1] == pytest.approx(arm[1])
    drag(browser, "right", (30, 0))
    after, moved = looks_from(browser)
    assert np.allclose(after, turned) and np.linalg.norm(moved - target) > 0.01
    browser.ask("Input.dispatchMouseEvent", type="mouseWheel", x=100, y=100, deltaX=0, deltaY=-200)
    browser.evaluate("new Promise(requestAnimationFrame)")
    assert np.linalg.norm(looks_from(browser)[0]) == pytest.approx(np.exp(-0.3) * np.linalg.norm(arm))
    fingers = [[{"x": 100 - a, "y": 100, "id": 0}, {"x": 100 + a, "y": 100, "id": 1}] for a in (20, 40)]
    browser.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=fingers[0])
    browser.ask("Input.dispatchTouchEvent", type="touchMove", touchPoints=fingers[1])
    browser.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    assert np.linalg.norm(looks_from(browser)[0]) == pytest.approx(np.exp(-0.3) * np.linalg.norm(arm) / 2)
    browser.evaluate("canvas.dispatchEvent(new KeyboardEvent('keydown', {key: '0'}))")
    home, back = looks_from(browser)
    assert np.allclose(home, arm) and np.allclose(back, target)


@needs_chromium
def test_a_browser_without_webgl2_gets_a_sentence(browser, grid, tmp_path):
    page = view(grid, tmp_path / "page.html").file
    text = page.read_text(encoding="utf-8").replace('canvas.getContext("webgl2"', 'canvas.getContext("webgl9"')
    page.write_text(text, encoding="utf-8")
    browser.open(page, (200, 150))
    browser.evaluate("viewer.ready.catch(() => 1)")
    assert browser.evaluate("document.getElementById('message').textContent").startswith("This browser shows no WebGL2")


@needs_chromium
def test_complaints_and_requests_of_a_page_are_heard(browser, tmp_path):
    page = tmp_path / "bad.html"
    page.write_text("<script>console.error('no'); setTimeout(() => { throw Error('late') })</script><img src='x.png'>")
    before = len(browser.complaints), len(browser.requests)
    browser.open(page)
    browser.evaluate("new Promise((resolve) => setTimeout(resolve, 50))")
    assert any("no" in said for said in browser.complaints[before[0] :])
    assert any("late" in said for said in browser.complaints[before[0] :])
    assert [url.rsplit("/", 1)[1] for url in browser.requests[before[1] :]] == ["x.png"]
    with pytest.raises(RuntimeError, match="the page says: Error: thrown"):
        browser.evaluate("Promise.reject(Error('thrown'))")

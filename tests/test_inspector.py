"""The inspector: what the page is given is what was seen; sentences follow the numbers."""

import base64
import json
import re

import numpy as np
import pytest

from validate.experiment import Bench, Run
from validate.report import render
from validate.sections import inspector

SIZE = 32


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A picture whose right half is hit; the mesh sees footprints twice as large as the grid, turned by nothing."""
    folder = tmp_path_factory.mktemp("inspector")
    hit = (np.arange(SIZE * SIZE) % SIZE) >= SIZE // 2
    count = int(hit.sum())
    rng = np.random.default_rng(2)
    uv = rng.uniform(0, 1, (count, 2)).astype(np.float32)
    jacobian = np.tile(np.array([2.0, 0.5, -0.5, 1.0], np.float32), (count, 1))
    arrays = {
        "image": np.full((SIZE, SIZE, 3), 90, np.uint8),
        "texture": np.full((64, 64, 3), 200, np.uint8),
        "hit": hit,
    }
    for route, scale in (("grid", 1), ("mesh", 2)):
        arrays |= {
            f"{route}_uv": uv,
            f"{route}_jacobian": scale * jacobian,
            f"{route}_chart": np.zeros(count, np.int32),
        }
    artefact = str(folder / Bench(folder, folder).store("bunny", **arrays))
    values = {f"grid.{metric}.{key}": 0.25 for metric in ("lod", "jacobian") for key in ("p50", "p95", "p99")}
    return Run("inspector", "bunny", {"truth": "mesh"}, {}, "error", values | {"pixels": count}, artefact=artefact)


def data(run):
    return json.loads(inspector.section([run]).inspectors[0].data)


def test_the_page_is_given_what_was_seen(run):
    given = data(run)
    hit = np.frombuffer(base64.b64decode(given["hit"]), np.uint8).reshape(SIZE, SIZE)
    assert hit[:, SIZE // 2 :].all() and not hit[:, : SIZE // 2].any()
    grid, mesh = (np.frombuffer(base64.b64decode(route["jacobian"]), "<f4") for route in given["routes"])
    assert np.array_equal(mesh, 2 * grid) and grid[:4].tolist() == [2.0, 0.5, -0.5, 1.0]
    x, y = given["start"]
    assert hit[y, x] == 1


def test_the_page_has_canvases_data_and_no_tag_in_the_data(run):
    page = render([run])
    assert page.count("<canvas") == 2 and 'id="inspector-bunny"' in page
    (inside,) = re.findall(r'<script type="application/json">(.*?)</script>', page, re.S)
    assert "<" not in inside and json.loads(inside)["size"] == SIZE


def test_the_finding_follows_the_numbers(run):
    (sentence,) = inspector.section([run]).finding
    assert "off by 0.25 mip levels in the median" in sentence and "all 512 pixels" in sentence


def test_every_few_pixels_have_an_ellipse():
    hit = np.ones(SIZE * SIZE, bool)
    chosen = inspector._sparse(hit, SIZE)
    assert len(chosen) == 2**2  # 6 and 19 of 32, along both axes

"""The command `export`: what it prints, and what it refuses in one sentence."""

import json

import pytest
from click.testing import CliRunner

from datasets_synthetic import mesh
from sdfbake import BadInput, bake
from sdfbake.__main__ import cli
from sdfbake.export import FORMATS


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "box.zarr.zip"
    bake(mesh("box"), 20, uv_mode="faces").save(path)
    return path


def run(*arguments):
    return CliRunner().invoke(cli, ["export", *map(str, arguments)], catch_exceptions=False)


def test_json_is_one_object_of_what_was_written(file, tmp_path):
    out = tmp_path / "box.vdb"
    done = run(file, "--to", "vdb", "-o", out, "--json")
    record = json.loads(done.stdout)
    assert done.exit_code == 0 and record["files"] == [str(out)] and record["format"] == "vdb"
    assert record["bytes"] == out.stat().st_size
    assert any("texture coordinates by face" in sentence for sentence in record["dropped"])
    assert str(out) in "".join(run(file, "--to", "vdb", "-o", out).stdout.split())  # however the table breaks it


@pytest.mark.parametrize(
    "to, name, options, said",
    [
        ("obj", "box.obj", (), "there is no format 'obj': choose from vdb, "),
        ("vdb", "box.vti", (), r"written to a file \*\.vdb, not box\.vti"),
        ("vdb", "nowhere/box.vdb", (), "there is no folder .*nowhere"),
        ("vdb", "box.vdb", ("--precision", "16"), r"no option --precision \(only raw does\)"),
        ("vdb", "box.vdb", ("--exact",), "no option --exact"),
    ],
    ids=["format", "suffix", "folder", "precision", "exact"],
)
def test_what_does_not_fit_is_refused(file, tmp_path, to, name, options, said):
    with pytest.raises(BadInput, match=said):
        run(file, "--to", to, "-o", tmp_path / name, *options)
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_grid(tmp_path):
    (tmp_path / "x.zarr.zip").write_bytes(b"PK")
    for name, said in (("x.zarr.zip", "not a grid file"), ("y.zarr.zip", "there is no grid file")):
        with pytest.raises(BadInput, match=said):
            run(tmp_path / name, "--to", "vdb", "-o", tmp_path / "x.vdb")


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_has_its_writer(name):
    assert FORMATS[name].name == name and callable(FORMATS[name].write)

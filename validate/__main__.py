"""The command line of `python -m validate`: run experiments, write the report, list the tools to compare with."""

import importlib
import sys
import time
from pathlib import Path

import click
from rich.console import Console
from rich.progress import Progress

from sdfbake.commandline import print_json, run
from validate.experiment import Bench, Run, read_runs, write_runs
from validate.suites import SUITES


@click.group()
def cli() -> None:
    """Truth, experiments and the report."""


@cli.command("run")
@click.argument("suites", nargs=-1, required=True, type=click.Choice(SUITES))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="JSON lines, one run each.")
@click.option("--build", default="build", show_default=True, type=click.Path(path_type=Path), help="Meshes and grids.")
@click.option("--only", help="The one object to look at, for suites that look at several.")
@click.option("--quick", is_flag=True, help="Small sizes only, for suites that have large ones.")
@click.option("--json", "as_json", is_flag=True, help="Print a summary as one JSON object.")
def run_suites(
    suites: tuple[str, ...], output: Path, build: Path, only: str | None, *, quick: bool, as_json: bool
) -> None:
    """Run experiments and keep every result; arrays go beside OUTPUT as .npz files."""
    console = Console(stderr=True)
    begin = time.perf_counter()

    def progress(line: str) -> None:
        console.print(f"[dim]{time.perf_counter() - begin:6.1f} s[/dim]  {line}", highlight=False)

    bench = Bench(build, output.parent, progress, only, quick)
    runs: list[Run] = []
    for suite in suites:
        runs.extend(importlib.import_module(f"validate.suites.{suite}").run(bench))
    write_runs(output, runs)
    failed = [found for found in runs if not found.ok]
    for found in failed:
        console.print(f"{found.suite}, {found.problem}: {found.status}", style="red", highlight=False, markup=False)
    if as_json:
        print_json({"output": str(output), "runs": len(runs), "failed": len(failed)})
    else:
        console.print(f"{len(runs)} runs ({len(failed)} failed) in {output}", highlight=False, markup=False)


@cli.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder for index.html.")
@click.option("--json", "as_json", is_flag=True, help="Print a summary as one JSON object.")
def report(runs: tuple[Path, ...], output: Path, as_json: bool) -> None:
    """Write one self-contained page from JSON lines of runs."""
    from validate.report import write_report  # the plotting library takes a second to load

    found = read_runs(runs)
    path = write_report(found, output)
    if as_json:
        print_json({"output": str(path), "runs": len(found), "failed": sum(not one.ok for one in found)})
    else:
        print(f"the report of {len(found)} runs is in {path}", file=sys.stderr)


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def peers(as_json: bool) -> None:
    """Say which other bakers and renderers can run here, and how to have the rest."""
    from validate.peers.catalogue import OURS, PEERS, RENDERERS, find

    found = [find(peer) for peer in (*PEERS, *(peer for peer in RENDERERS if peer.name != OURS))]
    if as_json:
        keys = ("python", "version", "problem")
        record = [{key: getattr(one, key) for key in keys} | {"install": one.peer.install} for one in found]
        print_json({"peers": dict(zip([one.peer.name for one in found], record, strict=True))})
        return
    for one in found:
        print(f"{one.peer.name:10}{one.version or 'not here':12}{one.python or one.peer.install}")


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--shape", "name", required=True, help="Exact shape that takes the place of the scene's grid.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="The picture, OpenEXR.")
def reference(scene: Path, name: str, output: Path) -> None:
    """Render SCENE against an exact shape in float64: the truth for pictures."""
    from datasets_synthetic import shape
    from sdfrender import render
    from sdfrender.image import write_exr, write_png
    from validate.exact import ShapeField

    with Progress(console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True) as bar:
        task = bar.add_task("reference", total=None)
        arrays = render(
            scene,
            field=ShapeField(shape(name)),
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    write_exr(output, arrays)
    write_png(output.with_suffix(".png"), arrays["rgb"])


if __name__ == "__main__":
    run(cli, "python -m validate")

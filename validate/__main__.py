"""The command line of `python -m validate`: run experiments, write the report, list the tools to compare with."""

import importlib
import sys
import time
from pathlib import Path

import click
from rich.console import Console
from rich.progress import Progress

from sdfbake.atomic import check_writable
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
@click.option("--only", help="The one case to run.")
@click.option("--replay", help="The case whose worst ray is traced alone, every step printed.")
@click.option(
    "--check", help="With --replay: the check whose worst ray is meant; the nearest to its limit if left out."
)
@click.option(
    "--runs",
    default="build/runs/stress.jsonl",
    show_default=True,
    type=click.Path(path_type=Path),
    help="With --replay: where the worst rays are stored; the case is run now if they are not.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="JSON lines, one run per check.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def stress(
    only: str | None, replay: str | None, check: str | None, runs: Path, output: Path | None, *, as_json: bool
) -> None:
    """Run the stiff and extreme cases; exits with 1 if a check fails that is no known limit."""
    from validate.stress import terminal

    if replay is not None:
        terminal.replay(replay, check, runs)
    elif not terminal.table(only, output, as_json=as_json):
        sys.exit(1)


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
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--scene", required=True, type=click.Path(path_type=Path), help="The scene that FILE is of.")
@click.option("--shape", "shapes", multiple=True, help="Truth: an exact shape, once for each asset of the scene.")
@click.option("--mesh", "meshes", multiple=True, type=click.Path(path_type=Path), help="Truth: a mesh, once for each.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="JSON lines, for the report.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def score(
    file: Path, scene: Path, shapes: tuple[str, ...], meshes: tuple[Path, ...], output: Path | None, *, as_json: bool
) -> None:
    """Score the footprints in FILE, OpenEXR or CSV, that any renderer wrote; see docs/validation.md."""
    from validate.score import score as scored
    from validate.score import show

    if output is not None:
        check_writable(output)
    found = scored(file, scene, shapes, meshes)
    if output is not None:
        write_runs(output, [found])
    if as_json:
        print_json({"file": str(file), "scene": str(scene), "truth": found.setup["truth"], "values": found.values})
    else:
        show(found, Console())


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

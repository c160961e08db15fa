"""Command line of the renderer: `render` a scene, print its `plan`."""

import sys
import time
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from sdfbake.atomic import check_writable
from sdfbake.commandline import print_json, run
from sdfbake.complaint import BadInput
from sdfrender.forecast import forecast
from sdfrender.image import CHANNELS, write_exr, write_png
from sdfrender.plan import make_plan
from sdfrender.plantable import capabilities, totals
from sdfrender.rayfile import read_rays
from sdfrender.render import shoot
from sdfrender.scene import LEVELS, load_scene
from sdfrender.stage import Stage, prepare


@click.group()
def cli() -> None:
    """Signed distance grids to footprints and images."""


def _size(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, x, height = text.partition("x")
    if not (x and width.isdecimal() and height.isdecimal()):
        raise BadInput(f"--size {text} is not a size: write width x height, such as 512x512")
    return int(width), int(height)


def _outputs(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[str, ...] | None:
    if text is None:
        return None
    names = tuple(name.strip() for name in text.split(","))
    for name in names:
        if name not in CHANNELS:
            raise BadInput(f"there is no output '{name}': choose from {', '.join(CHANNELS)}")
    return names


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="The picture, OpenEXR.")
@click.option("--png", type=click.Path(path_type=Path), help="The picture for eyes, too.")
@click.option("--size", callback=_size, help="WxH in pixels, in place of the scene's.")
@click.option("--outputs", callback=_outputs, help="Comma-separated outputs, in place of the scene's.")
@click.option("--kernel", help="linear, catmull-rom or bspline, in place of the scene's.")
@click.option("--levels", type=click.Choice(LEVELS), help="Which level of a grid rays meet, in place of the scene's.")
@click.option("--engine", default="auto", show_default=True, help="auto, numpy or drjit.")
@click.option("--precision", type=int, help="32 or 64 bits; 64 on numpy, 32 on drjit by default.")
@click.option("--rays", type=click.Path(path_type=Path), help="Rays to trace, .npz or .csv, in place of the camera's.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object about the run.")
def render(
    scene: Path,
    output: Path,
    png: Path | None,
    size: tuple[int, int] | None,
    outputs: tuple[str, ...] | None,
    kernel: str | None,
    levels: str | None,
    engine: str,
    precision: int | None,
    rays: Path | None,
    as_json: bool,
) -> None:
    """Render SCENE, a TOML file."""
    start = time.perf_counter()
    chosen = load_scene(scene).with_(size=size, outputs=outputs, kernel=kernel, levels=levels)
    if png is not None and "rgb" not in chosen.film.outputs:
        raise BadInput("--png shows the output rgb, which is not asked for: add rgb to --outputs")
    if rays is not None and size is not None:
        raise BadInput("--size is of a camera's picture, and --rays gives rays instead: leave one of them out")
    for path in (output, png):
        if path is not None:
            check_writable(path)
    view = None if rays is None else read_rays(rays, differentials=make_plan(chosen).differentials)
    stage = prepare(chosen, engine=engine, precision=precision, view=view)
    choice = stage.choice
    ready = time.perf_counter()
    with _progress() as progress:
        task = progress.add_task("tracing")
        arrays = shoot(stage, lambda done, total: progress.update(task, completed=done, total=total))
    done = time.perf_counter()
    graze = stage.graze()
    said = f"{choice.engine.name}, {choice.engine.precision} bits"
    write_exr(output, arrays, {"engine": said, "grazes missed": f"at most {graze:.3g} world units deep"})
    if png is not None:
        write_png(png, arrays["rgb"])
    record = {
        "output": str(output),
        "engine": choice.engine.name,
        "precision": choice.engine.precision,
        "engine_reason": choice.reason,
        "grazes_missed": graze,
        "uv_mode": next((asset.uv_mode for asset in stage.plan.assets if asset.uv_mode), None),
        "seconds": {"prepare": ready - start, "trace": done - ready, "total": time.perf_counter() - start},
        "read": [{"grid": grid, **asdict(reading)} for grid, reading in stage.read],
        "plan": stage.plan.record(),
    }
    if as_json:
        print_json(record)
    else:
        took = f"{output}: {said} ({choice.reason}), {done - ready:.2f} s, no graze deeper than {graze:.2g} missed"
        left_out = ", ".join(omission.what for omission in stage.plan.left_out) or "nothing"
        click.echo(f"{took}; left out: {left_out}; {_read(stage)}", err=True)


def _read(stage: Stage) -> str:
    """Say how much of the grids was read."""
    readings = [reading for _, reading in stage.read]
    bricks, there = (sum(part) for part in zip(*((r.bricks, r.of_bricks or 0) for r in readings), strict=True))
    size, whole = (sum(part) / 1e6 for part in zip(*((r.bytes, r.of_bytes) for r in readings), strict=True))
    closed = sum(reading.of_bricks is None for reading in readings)
    unseen = f", {closed} of {len(readings)} grids out of sight" if closed else ""
    return f"read {bricks} of {there} bricks, {size:.1f} of {whole:.1f} MB{unseen}"


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("--needs", type=click.Path(path_type=Path), help="Write what bakes of its grids must have, JSON.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def plan(scene: Path, needs: Path | None, as_json: bool) -> None:
    """Say what SCENE needs, and what is left out and why."""
    loaded = load_scene(scene)
    if needs is not None:  # before the grids are asked: they may lack what the file says
        from sdfrender.needs import needs_of

        check_writable(needs)
        needs_of(loaded).save(needs)
    made = make_plan(loaded, unbaked=needs is not None)
    found = forecast(loaded, made) if needs is None else None
    if as_json:
        print_json((found or made).record())
    else:
        Console().print(capabilities(found.plan if found else made), *([totals(found)] if found else []))


def _progress() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True)


if __name__ == "__main__":
    run(cli, "python -m sdfrender")

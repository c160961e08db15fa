"""What the report says about error against run time."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.frontier import pareto
from validate.metrics import fitted_order
from validate.plots import Panel, Series
from validate.section import Picture, Section, Table, number, percent, pick

TITLE = "Error against run time"
ASKED = (
    "What does an error cost? A camera looks at an exact shape, from outside at a sphere, or from within its hole at a "
    "torus, and every ray is traced, mirrored with its differentials, and traced on. On x the median error of the beam "
    "after the last mirror (its footprint on a distant environment), on y microseconds per camera ray; points of one "
    "curve are grids of 16 to 128 samples per axis, or meshes of finer and finer triangles with interpolated normals. "
    "Errors and times come from separate runs, and the black line joins what nothing else beats."
)
NOTES = (
    "The mesh is traced by Embree in float32, hits and differentials are computed anew by NumPy in float64; its clock "
    "has both, and it stands in every diagram of a problem for comparison.",
    "Work is counted while the same program runs, per camera ray and over all bounces. A cube is one step of the walk: "
    "empty cells or absent bricks passed at once, or one cell that may hold surface; its slab settles the cell or "
    "leaves it to the polynomial. Counts are the same on every engine.",
)
MESH = "mesh"
WORK = (
    ("cubes", "work.cubes"),
    ("of absent bricks", "work.absent"),
    ("slabs", "work.slabs"),
    ("polynomials", "work.polynomials"),
    ("stencils", "work.stencils"),
    ("values", "work.values"),
    ("gradients", "work.gradients"),
    ("Hessians", "work.hessians"),
)

Pair = tuple[Run, Run]
Sweeps = dict[str, list[Pair]]  # by kernel


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    problems = {problem: _sweeps(runs, problem) for problem in dict.fromkeys(run.problem for run in runs)}
    problems = {problem: engines for problem, engines in problems.items() if engines}
    if not problems:
        return Section("frontier", TITLE, ASKED, ("No setup has both an error run and a timed run that succeeded.",))
    pictures = []
    for problem, engines in problems.items():
        panels = [_panel(engine, sweeps) for engine, sweeps in engines.items()]
        text = f"{problem.capitalize()}: labels are samples per axis, or edges of the mesh."
        pictures.append(Picture(plots.work_precision(panels), text))
    counted = [run for run in pick(runs) if "work.cubes" in run.values]
    finding = [
        s for problem, engines in problems.items() for s in (*_fronts(problem, engines), *_mesh(problem, engines))
    ]
    return Section(
        name="frontier",
        title=TITLE,
        asked=ASKED,
        finding=(*finding, *_work(counted)),
        pictures=tuple(pictures),
        tables=(_table(problems), *([_counts(counted)] if counted else [])),
        notes=NOTES,
    )


def _engine(run: Run) -> str:
    bits = run.setup.get("precision")
    return f"{run.setup['engine']}, float{bits}" if bits else run.setup["engine"]


def _key(run: Run) -> tuple[str, str, str, str]:
    return run.problem, run.setup["kernel"], _engine(run), str(sorted(run.knob.items()))


def _sweeps(runs: Sequence[Run], problem: str) -> dict[str, Sweeps]:
    """Error and timed runs of a problem by engine and kernel, by resolution; the meshes beside every engine."""
    times = {_key(run): run for run in pick(runs, "timing")}
    engines: dict[str, Sweeps] = {}
    meshes = []
    for run in pick(runs):
        timing = times.get(_key(run))
        if run.problem != problem or timing is None or "beam.p50" not in run.values:
            continue
        if run.setup["kernel"] == MESH:
            meshes.append((run, timing))
        else:
            engines.setdefault(_engine(run), {}).setdefault(run.setup["kernel"], []).append((run, timing))
    ordered = {engine: dict(sorted(sweeps.items())) for engine, sweeps in sorted(engines.items())}
    return {engine: sweeps | ({MESH: meshes} if meshes else {}) for engine, sweeps in ordered.items()}


def _panel(engine: str, sweeps: Sweeps) -> Panel:
    series = []
    for kernel, pairs in sweeps.items():
        error, cost = _points(pairs)
        order = _order(pairs)
        name = kernel if order is None else f"{kernel}: order {order:.1f}"
        series.append(Series(name, error, cost, tuple(f"{_knob(run):g}" for run, _ in pairs)))
    return Panel(engine, tuple(series), "median error of the reflected beam", "µs per ray")


def _points(pairs: Sequence[Pair]) -> tuple[np.ndarray, np.ndarray]:
    error = np.array([run.values["beam.p50"] for run, _ in pairs])
    return error, np.array([timing.values["us_per_ray"] for _, timing in pairs])


def _knob(run: Run) -> float:
    return next(iter(run.knob.values()))


def _order(pairs: Sequence[Pair]) -> float | None:
    """The fitted order of the error in the spacing or the edge; None of a single point."""
    spacing = np.array([run.values["spacing"] for run, _ in pairs])
    return fitted_order(spacing, _points(pairs)[0]) if len(set(spacing)) > 1 else None


def _fronts(problem: str, engines: dict[str, Sweeps]) -> list[str]:
    sentences = []
    for engine, sweeps in engines.items():
        points = [(kernel, *pair) for kernel, pairs in sweeps.items() for pair in pairs]
        error, cost = _points([(run, timing) for _, run, timing in points])
        front = [points[i] for i in pareto(error, cost)]
        kernels = [kernel for kernel, _, _ in front]
        shares = ", ".join(f"{kernels.count(kernel)} {kernel}" for kernel in dict.fromkeys(kernels))
        best = front[-1]
        sentences.append(
            f"{problem.capitalize()}, {engine}: the front holds {len(front)} of {len(points)} setups ({shares}); its "
            f"most exact end, {_name(best[1])}, has an error of {number(error.min())} for "
            f"{number(best[2].values['us_per_ray'])} µs per ray."
        )
    return sentences


def _name(run: Run) -> str:
    kernel = run.setup["kernel"]
    return f"mesh of edge {_knob(run):g}" if kernel == MESH else f"{kernel} at {_knob(run):g}³"


def _mesh(problem: str, engines: dict[str, Sweeps]) -> list[str]:
    """Which grid is the coarsest that is nearer to the truth than the finest mesh, and what it costs on each engine."""
    meshes = next(iter(engines.values())).get(MESH, [])
    if not meshes:
        return []
    finest, clock = min(meshes, key=lambda pair: pair[0].values["beam.p50"])
    limit = finest.values["beam.p50"]
    said = f"{problem.capitalize()}: the finest mesh (edge {_knob(finest):g}) errs by {number(limit)} for "
    said += f"{number(clock.values['us_per_ray'])} µs per ray"
    grids = [pair[0] for sweeps in engines.values() for k, pairs in sweeps.items() if k != MESH for pair in pairs]
    better = [run for run in grids if run.values["beam.p50"] <= limit]
    if not better:
        return [f"{said}; no grid is as exact."]
    coarsest = min(better, key=lambda run: (_knob(run), run.values["beam.p50"]))
    costs = ", ".join(
        f"{number(timing.values['us_per_ray'])} µs on {engine}"
        for engine, sweeps in engines.items()
        for run, timing in sweeps.get(coarsest.setup["kernel"], [])
        if run.knob == coarsest.knob
    )
    said += f"; the coarsest grid that is as exact, {_name(coarsest)}, errs by {number(coarsest.values['beam.p50'])} "
    return [f"{said}for {costs}.", *_halving(problem, engines)]


def _halving(problem: str, engines: dict[str, Sweeps]) -> list[str]:
    """What twice the resolution buys, on the engine that rounds least."""
    sweeps = next((sweeps for engine, sweeps in engines.items() if "64" in engine), next(iter(engines.values())))
    orders = {kernel: order for kernel, pairs in sweeps.items() if (order := _order(pairs)) is not None}
    words = ", ".join(f"{2**order:.1f} ({kernel})" for kernel, order in orders.items())
    return (
        [f"{problem.capitalize()}: half the spacing, or half the edge, divides the error by {words}."] if words else []
    )


def _work(counted: Sequence[Run]) -> tuple[str, ...]:
    """How the work grows with the resolution, under the kernel that is the default."""
    sentences = []
    for problem in dict.fromkeys(run.problem for run in counted):
        sweep = [run for run in counted if run.problem == problem and run.setup["kernel"] == "bspline"]
        if len(sweep) < 2:
            continue
        first, last = sweep[0], sweep[-1]
        cubes, slabs, polynomials = (
            f"{number(first.values[name])} to {number(last.values[name])}"
            for name in ("work.cubes", "work.slabs", "work.polynomials")
        )
        settled = 1 - last.values["work.polynomials"] / last.values["work.slabs"]
        sentences.append(
            f"{problem.capitalize()}, work per ray from {_knob(first):g}³ to {_knob(last):g}³: {cubes} cubes, {slabs} "
            f"slabs, {polynomials} polynomials (slabs settle {percent(settled)} of the cells at {_knob(last):g}³)."
        )
    return tuple(sentences)


def _table(problems: dict[str, dict[str, Sweeps]]) -> Table:
    """One line per point of the diagrams; the meshes once."""
    rows: dict[str, tuple[str, ...]] = {}
    for problem, engines in problems.items():
        for engine, sweeps in engines.items():
            for kernel, pairs in sweeps.items():
                for run, timing in pairs:
                    values = run.values
                    cells = (values["beam.p50"], values["beam.p95"], values["missed"], timing.values["us_per_ray"])
                    place = "" if kernel == MESH else f"{engine}, "
                    name = f"{problem}, {place}{_name(run)}"
                    rows[name] = (name, *(number(cell) for cell in cells))
    header = ("Setup", "beam error p50", "p95", "other way taken", "µs per ray")
    return Table("Every point of the diagrams; times are medians.", header, tuple(rows.values()))


def _counts(counted: Sequence[Run]) -> Table:
    rows = tuple(
        (f"{run.problem}, {_name(run)}", *(number(run.values[key]) for _, key in WORK))
        for run in sorted(counted, key=lambda run: (run.problem, run.setup["kernel"], _knob(run)))
    )
    return Table("Work per camera ray.", ("Setup", *(title for title, _ in WORK)), rows)

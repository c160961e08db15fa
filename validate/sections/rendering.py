"""What the report says about the renderers: error against run time, ratios to Mitsuba, first frames, the limits."""

from collections.abc import Sequence

import numpy as np

from validate import plots
from validate.experiment import Run
from validate.peers import limit
from validate.peers.catalogue import MITSUBA, RENDERERS
from validate.peers.frames import EVERYTHING, JOBS, MIRROR, PRIMARY
from validate.peers.limits import Points, figure
from validate.peers.limits import sizes as sizes_of
from validate.peers.paces import LABELS, LIMITS, cold, extra, ours, paired, ratio, sizes, start
from validate.plots import Panel, Series
from validate.section import Picture, Section, Table, number

TITLE = "Rendering against Mitsuba"
ASKED = (
    "What does a certified tracer with curvatures and footprints cost beside a renderer's trilinear grid? Ours and "
    "Mitsuba's sdfgrid trace the same 512 x 512 rays against the same samples of a sphere, in turns, each in a process "
    "of its own: first hits; a mirror (first hit, normal, mirrored ray; ours with the Hessian); and everything "
    "(differentials all the way, texture coordinates, a trilinear look-up), which only ours has. The clock covers the "
    "program until its arrays are computed, not their copy to NumPy. Hits are held against the closed form."
)
WORDS = {PRIMARY: "first hits", MIRROR: "the mirror", EVERYTHING: "everything"}


def section(runs: Sequence[Run]) -> Section:
    """Write the section."""
    points = paired(runs)
    if not any(point.timing and point.error for point in points.values()):
        return Section(
            "rendering", TITLE, ASKED, ("No renderer has both a timed run and an error run that succeeded.",)
        )
    figures = limit.figures(LIMITS, points)
    return Section(
        name="rendering",
        title=TITLE,
        asked=ASKED,
        finding=(*_against_mitsuba(points), *_quicker(points), *_wrong(points), *_first(points), limit.met(figures)),
        headlines=limit.headlines(figures),
        pictures=(
            Picture(plots.work_precision(_panels(points)), "Labels are samples per axis, N; NumPy is left out."),
        ),
        tables=(limit.table(figures), *(_table(points, job) for job in JOBS), _cold(points)),
        notes=_notes(),
    )


# ---- sentences -------------------------------------------------------------------------------------------------------
def _against_mitsuba(points: Points) -> tuple[str, ...]:
    """Like for like, and ours with the cubic kernel."""
    sentences = []
    for job, label, what in (
        (PRIMARY, ours("linear"), "first hits of the linear kernel, like for like,"),
        (MIRROR, ours("linear"), "the mirror with the linear kernel"),
        (MIRROR, ours(), "the mirror with the B-spline and its Hessian"),
    ):
        found = [(n, ratio(points, job, label, n)) for n in sizes(points)]
        said = [f"{number(value)} at {n}³" for n, value in found if value is not None]
        if said:
            sentences.append(f"In float32 on Dr.Jit {what} takes this share of Mitsuba's time: {', '.join(said)}.")
    return tuple(sentences)


def _quicker(points: Points) -> tuple[str, ...]:
    """Where Mitsuba takes less time than a compiled setup of ours."""
    lost = []
    for job, label, n in points:
        share = ratio(points, job, label, n) if job in JOBS else None
        if label.startswith("Dr.Jit") and share is not None and share > 1:
            lost.append(f"{label} at {n}³ ({WORDS[job]}, {number(share)} times Mitsuba's)")
    if any(label == MITSUBA for _, label, _ in points):
        return (f"Mitsuba is quicker than {'; '.join(lost)}." if lost else "Mitsuba is nowhere quicker on Dr.Jit.",)
    return ("Mitsuba was not here: no ratio to it could be measured.",)


def _wrong(points: Points) -> tuple[str, ...]:
    """Wrong pixels by label, over the sizes."""
    sentences = []
    for label in (*(ours(kernel) for kernel in ("bspline", "catmull-rom", "linear")), MITSUBA):
        found = [(n, figure(points, PRIMARY, label, n, "wrong_pixels")) for n in sizes(points)]
        said = [f"{value:.0f} at {n}³" for n, value in found if value is not None]
        if said:
            sentences.append(f"{label}: {', '.join(said)}")
    return (f"Pixels whose hit or miss is wrong - {'; '.join(sentences)}.",) if sentences else ()


def _first(points: Points) -> tuple[str, ...]:
    label = ours()
    more, disk = (extra(points, EVERYTHING, label, name) for name in ("cold_seconds", "disk_seconds"))
    if more is None or disk is None:
        return ()
    return (
        f"A first frame of everything takes {number(more)} s more than a warm one where nothing was ever compiled, and "
        f"{number(disk)} s more in a fresh process that finds its programs on the disk.",
        *_again(points),
    )


def _again(points: Points) -> tuple[str, ...]:
    """What another size of the grid compiles."""
    found = [(label, start(points, MIRROR, label)) for label in (ours(), MITSUBA)]
    said = [f"{number(point.value('programs_again'))} for {label}" for label, point in found if point is not None]
    return (f"A second grid of another size makes Dr.Jit compile so many programs: {', '.join(said)}.",) if said else ()


# ---- picture and tables ----------------------------------------------------------------------------------------------
def _panels(points: Points) -> list[Panel]:
    axes = ("median |t - t*|, world units (the sphere's radius is 0.8)", "µs per ray")
    compiled = [label for label in LABELS if not label.startswith("NumPy")]
    present = [label for label in compiled if any(key[1] == label for key in points)]
    panels = []
    for job in JOBS:
        # A renderer without this job keeps its place, and so its colour and marker.
        series = tuple(_series(points, job, label) for label in present)
        if any(len(one.x) for one in series):
            panels.append(Panel(WORDS[job], series, *axes))
    return panels


def _series(points: Points, job: str, label: str) -> Series:
    both = [points[job, label, n] for n in sizes_of(points, job, label)]
    good = [point for point in both if point.timing and point.error and (point.value("t.p50_world") or 0) > 0]
    error = np.array([point.value("t.p50_world") for point in good], np.float64)
    cost = np.array([point.value("us_per_ray") for point in good], np.float64)
    return Series(label if good else f"{label}: no run", error, cost, tuple(f"{p.resolution}" for p in good))


COLUMNS = (
    ("seconds", "s"),
    ("us_per_ray", "µs per ray"),
    ("prepare_seconds", "field, s"),
    ("wrong_pixels", "wrong pixels"),
    ("missed_pixels", "of them missed"),
    ("t.max", "|t - t*|, voxel max"),
    ("t.p99", "p99"),
    ("t.p50", "p50"),
    ("met_again", "met again"),
)


def _order(key: tuple[str, str, int]) -> tuple[int, int]:
    return key[2], LABELS.index(key[1]) if key[1] in LABELS else len(LABELS)


def _table(points: Points, job: str) -> Table:
    columns = COLUMNS[:-1] if job == PRIMARY else COLUMNS
    rows = []
    for key in sorted((key for key in points if key[0] == job), key=_order):
        cells = [number(points[key].value(name)) for name, _ in columns]
        if points[key].timing is None:
            cells[0] = "failed"
        _, label, n = key
        over = ratio(points, job, label, n, other_job=MIRROR if job == EVERYTHING else job)
        rows.append((f"{n}³, {label}", *cells, number(over)))
    against = "Mitsuba's mirror" if job == EVERYTHING else "Mitsuba's"
    header = ("Setup", *(title for _, title in columns), f"time over {against}")
    return Table(f"{WORDS[job].capitalize()}: medians of the frames after the first.", header, tuple(rows))


def _cold(points: Points) -> Table:
    rows = []
    for job in JOBS:
        for label in LABELS:
            point = start(points, job, label)
            if point is None:
                continue
            named = ("cold_frame", "disk_frame", "warm_frame", "again_frame", "programs", "programs_again")
            more = (extra(points, job, label, name) for name in ("cold_seconds", "disk_seconds"))
            rows.append((f"{WORDS[job]}, {label}", *(number(value) for value in (*map(point.value, named), *more))))
    found = [n for problem, _, n in points if problem in map(cold, JOBS)]
    header = (
        "Job and setup",
        "frame, nothing compiled: s",
        "programs on disk",
        "warm",
        "first of another size",
        "programs",
        "more for another size",
        "field and frame over warm, nothing compiled: s",
        "programs on disk",
    )  # fmt: skip
    return Table(f"First frames of a process, at {found[0] if found else '-'}³.", header, tuple(rows))


def _notes() -> tuple[str, ...]:
    asked = " ".join(f"{peer.name}: {peer.about}." for peer in RENDERERS)
    how = (
        "Ratios are medians over the rounds, of two times of the same round. 'Field' is what is prepared from samples "
        "in memory before the first frame. 'Met again' are mirrored rays that hit the sphere they left, which no "
        "convex mirror allows. The float32 of Mitsuba shows in its errors, too."
    )
    return (asked, how)

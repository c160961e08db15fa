"""Pictures of the report: work-precision diagrams, convergence, error maps, renders.

In: numbers. Out: data URIs (SVG for curves, PNG for maps and renders), the same bytes for the same numbers.
"""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from sdfrender.footprint import ellipse
from validate.frontier import pareto

matplotlib.use("Agg")

import matplotlib.collections
from matplotlib.axes import Axes
from matplotlib.figure import Figure

STYLE = {
    "svg.hashsalt": "footprints",
    "svg.fonttype": "path",
    "font.size": 9,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5c6670",
    "axes.labelcolor": "#2b333b",
    "xtick.color": "#5c6670",
    "ytick.color": "#5c6670",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "image.interpolation": "nearest",
}
# Okabe and Ito's palette: told apart by every kind of colour vision, and in print by the markers.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#332288")
MARKERS = "osD^vP*X"


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One curve: its name for the legend (with its fitted order), and its points in the order of the knob."""

    name: str
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    labels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One set of axes."""

    title: str
    series: tuple[Series, ...]
    x: str
    y: str


@dataclass(frozen=True, slots=True, eq=False)
class Map:
    """One error map; NaN where there is nothing to compare."""

    title: str
    values: Float[np.ndarray, "h w"]


@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """Footprints on a texture: middles in texture coordinates, [d/dx d/dy] in texels per pixel."""

    title: str
    texture: UInt8[np.ndarray, "h w 3"]
    uv: Float[np.ndarray, "n 2"]
    jacobian: Float[np.ndarray, "n 2 2"]
    colour: str


def work_precision(panels: Sequence[Panel]) -> str:
    """Error on x, cost on y, both logarithmic: raw points faded, the Pareto front bold."""
    with matplotlib.rc_context(STYLE):
        figure, axes = _axes(panels, min(5.2, 11.4 / len(panels)), 3.8)
        for panel, ax in zip(panels, axes, strict=True):
            for index, series in enumerate(panel.series):
                _curve(ax, series, index, alpha=0.45)
                _annotate(ax, series)
            error = np.concatenate([series.x for series in panel.series])
            cost = np.concatenate([series.y for series in panel.series])
            front = pareto(error, cost)
            ax.plot(error[front], cost[front], color="#111111", lw=2.4, zorder=5, label="Pareto front")
            _logarithmic(ax, panel)
        return _svg(figure)


def convergence(panels: Sequence[Panel]) -> str:
    """Error over spacing, both logarithmic: a straight line has an order, its slope."""
    with matplotlib.rc_context(STYLE):
        figure, axes = _axes(panels, 3.7, 3.5)
        for panel, ax in zip(panels, axes, strict=True):
            for index, series in enumerate(panel.series):
                _curve(ax, series, index)
            _annotate(ax, panel.series[-1])
            _logarithmic(ax, panel)
        return _svg(figure)


def shares(rows: Sequence[Series], label: str, names: Sequence[str]) -> str:
    """Shares of limits, one row per name from the top, one colour per series; beyond 1 a limit is not met.

    Parameters
    ----------
    rows
        Of every series x the shares, y the number of the row.
    label
        What the shares are of.
    names
        Of the rows.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 1.5 + 0.19 * len(names)), layout="constrained")
        ax = figure.subplots()
        ax.axvspan(1.0, 1e4, color="#f6e3de", lw=0)
        for index, series in enumerate(rows):
            x = np.clip(series.x, 1e-8, 1e4)
            y = series.y + 0.66 / len(rows) * (index - (len(rows) - 1) / 2)
            ax.scatter(x, y, s=11, color=COLOURS[index], marker=MARKERS[index], alpha=0.75, lw=0, label=series.name)
        ax.set(xscale="log", xlim=(5e-9, 1e4), ylim=(len(names) - 0.4, -0.6), xlabel=label)
        ax.set_yticks(range(len(names)), names, fontsize=7.5)
        ax.grid(axis="y", color="#eef1f4", lw=0.8)
        ax.set_axisbelow(True)
        figure.legend(loc="outside upper center", ncols=4)
        return _svg(figure)


def maps(panels: Sequence[Map], label: str, limits: tuple[float, float], columns: int = 4) -> str:
    """Error maps in a row or more, with one colour scale (logarithmic) for all."""
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    with matplotlib.rc_context(STYLE):
        height, width = panels[0].values.shape
        across = 10.4 / columns
        figure = Figure(figsize=(11.2, rows * (across * min(height / width, 1.4) + 0.3)), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        scale = matplotlib.colors.LogNorm(*limits, clip=True)
        palette = matplotlib.colormaps["inferno"].with_extremes(bad="#eef1f4")
        for ax in grid.flat:
            ax.set_axis_off()
        for ax, panel in zip(grid.flat, panels, strict=False):
            ax.imshow(np.maximum(panel.values, limits[0]), norm=scale, cmap=palette)
            ax.set_title(panel.title, fontsize=8.5, fontweight="normal")
        shown = matplotlib.cm.ScalarMappable(scale, palette)
        figure.colorbar(shown, ax=grid, label=label, shrink=0.85, pad=0.015, extend="both")
        return _png(figure)


def ellipses(panels: Sequence[Ellipses], magnified: float) -> str:
    """What the circles of diameter one pixel become on the texture, panels beside each other."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.7 * len(panels), 3.9), layout="constrained")
        for panel, ax in zip(panels, figure.subplots(1, len(panels), squeeze=False)[0], strict=True):
            faded = 255 - (255 - panel.texture[::2, ::2].astype(np.float64)) * 0.35
            ax.imshow(faded.astype(np.uint8), extent=(0, 1, 0, 1), interpolation="antialiased")
            # Half axes of a circle of radius 1 are the axes of one of diameter 1.
            dx, dy = np.moveaxis(panel.jacobian.astype(np.float64), 2, 0)
            axes = ellipse(dx, dy, (1, 1))
            major, minor = (magnified * axis / panel.texture.shape[0] for axis in axes[:2])
            drawn = matplotlib.collections.EllipseCollection(
                major, minor, np.degrees(axes[2]), units="xy", offsets=panel.uv, transOffset=ax.transData
            )
            drawn.set(facecolor=panel.colour, edgecolor=panel.colour, alpha=0.55, linewidth=0.6)
            ax.add_collection(drawn)
            ax.set(xlim=(0, 1), ylim=(0, 1), title=panel.title, xlabel="u", ylabel="v", aspect="equal")
        return _png(figure)


def picture(pixels: UInt8[np.ndarray, "h w 3"]) -> str:
    """A render, as it is."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, "PNG", optimize=True)
    return _uri(buffer.getvalue(), "image/png")


def _axes(panels: Sequence[Panel], width: float, height: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width * len(panels), height), layout="constrained")
    return figure, list(figure.subplots(1, len(panels), squeeze=False)[0])


def _curve(ax: Axes, series: Series, index: int, alpha: float = 1.0) -> None:
    colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
    ax.plot(series.x, series.y, lw=1.4, ms=4.5, label=series.name, color=colour, marker=marker, alpha=alpha)


def _annotate(ax: Axes, series: Series) -> None:
    for x, y, label in zip(series.x, series.y, series.labels, strict=False):
        ax.annotate(label, (x, y), (3, 3), textcoords="offset points", fontsize=6, color="#7a848e")


def _logarithmic(ax: Axes, panel: Panel) -> None:
    ax.set(xscale="log", yscale="log", xlabel=panel.x, ylabel=panel.y, title=panel.title)
    ax.grid(which="major", color="#dde3e8", lw=0.6)
    ax.set_axisbelow(True)
    ax.legend()


def _svg(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _uri(buffer.getvalue(), "image/svg+xml")


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, metadata={"Software": None})
    return _uri(buffer.getvalue(), "image/png")


def _uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"

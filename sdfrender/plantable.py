"""A plan and its forecast as tables for a terminal.

In: a `Forecast`. Out: tables of `rich`: what is read and how long it takes, against everything on; and everything that
the renderer can do, needed or left out, and why.
"""

from collections.abc import Iterator
from pathlib import Path

from rich.table import Table

from sdfrender.forecast import Forecast, GridForecast, Total
from sdfrender.planned import Capability, Plan

Row = tuple[str, str, str, str, str]


def totals(found: Forecast) -> Table:
    """Return what is read of every grid, and in total."""
    table = Table("what", "as planned", "everything on", "share", "", title="what is read, and how long it takes")
    for column in table.columns[1:4]:
        column.justify = "right"
    for grid in found.grids:
        for row in _of_grid(grid):
            table.add_row(*row)
        table.add_section()
    for row in _of_total(found.total):
        table.add_row(*row)
    table.caption = "seconds: estimated, of tracing alone, for paths that hit something at every turn"
    return table


def _of_grid(grid: GridForecast) -> Iterator[Row]:
    name = Path(grid.grid).name
    if grid.of_bricks is None:
        yield name, "", "", "", "does not exist yet"
    elif not grid.opened:
        yield name, "not opened", f"{grid.of_bricks:,} bricks", "", "no ray can meet it"
        yield "  bytes of its head", *_of(grid.bytes, grid.of_bytes), ""
    else:
        unseen = f"; {grid.unseen} of its {grid.places} places out of sight" if grid.unseen else ""
        shared = f"; once for {grid.places} places" if grid.places > 1 else ""
        yield name, "", "", "", f"reads {', '.join(grid.channels)}{shared}{unseen}"
        yield "  bricks that rays can reach", *_of(grid.reachable or 0, grid.of_bricks), ""
        around = "those around too, and what shares a chunk with them" if grid.bricks != grid.reachable else ""
        yield "  bricks read", *_of(grid.bricks or 0, grid.of_bricks), around
        yield "  bytes read", *_of(grid.bytes, grid.of_bytes), ""


def _of(part: float, whole: float) -> tuple[str, str, str]:
    return _number(part), _number(whole), _percent(part / whole) if whole else ""


def _number(value: float) -> str:
    """Return a count, or an estimate to two digits."""
    return f"{value:.2g}" if isinstance(value, float) and value < 10 else f"{value:,.0f}"


def _percent(share: float) -> str:
    """Return a percentage in which nothing and everything are those alone."""
    return "<1%" if 0 < share < 0.01 else ">99%" if 0.99 < share < 1 else f"{share:.0%}"


def _of_total(total: Total) -> Iterator[Row]:
    yield "TOTAL bytes", *_of(total.bytes, total.of_bytes), "of grids and pictures that exist"
    for engine in ("drjit", "numpy"):
        seconds = (getattr(known, engine) for known in (total.seconds, total.of_seconds))
        yield f"TOTAL seconds on {engine}", *_of(*seconds), ""


def capabilities(made: Plan) -> Table:
    """Return everything that the renderer can do, needed or left out."""
    table = Table("what", "", "why", "bytes unread", "time saved", title="what is done, and what is left out")
    orders = ["nothing" if order is None else ("value", "gradient", "Hessian")[order] for order in made.orders]
    same = len(orders) > 1 and len(set(orders)) == 1
    table.add_row("jets", f"{orders[0]}, {len(orders)} times" if same else ", ".join(orders), "per hit of a path")
    table.add_row("outputs", ", ".join(made.outputs), "asked for")
    for known in made.capabilities:
        size = f"{known.bytes:,}" if known.bytes else ""
        table.add_row(known.what, known.how or "left out", known.reason, size, _saved(known))
    table.caption = "time saved: estimated, as a share of the tracing time of this plan, on Dr.Jit and on NumPy"
    return table


def _saved(known: Capability) -> str:
    if known.saving is None:
        return ""
    drjit, numpy = (
        _percent(share) if share < 1 else f"{share:.0%}" for share in (known.saving.drjit, known.saving.numpy)
    )
    return drjit if drjit == numpy else f"{drjit}, {numpy}"

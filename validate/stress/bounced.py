"""A long way between mirrors as one program, where a thousand calls of `transfer` and `reflect` would take ten seconds.

In: a grid's surface that is all mirror, rays. Out: the rays after many bounces, at several marks on the way.
"""

import numpy as np

from sdfbake.engine import Array, Engine
from sdfrender import GridField, Rays
from sdfrender.rays import beam, components, rays
from sdfrender.trace import mirrored, transferred


def bounced(field: GridField, start: Rays, bounces: int, marks: int) -> list[tuple[int, Rays]]:
    """Mirror rays time and again: what `transfer` and `reflect` do, in a loop of the engine.

    Parameters
    ----------
    field
        The mirrors.
    start
        Rays; those that meet nothing stay where they are from then on, and their bounces are not those of the others.
    bounces, marks
        How often, and how many times rays are looked at on the way, at equal shares of it.

    Returns
    -------
    list
        The number of bounces and the rays after them, mark by mark.
    """

    def program(xp: Engine, *columns: Array) -> dict[str, Array]:
        def bounce(state: tuple[Array, ...], _: object) -> tuple[Array, ...]:
            left, *entries = state
            incoming = beam(tuple(entries))
            everybody = xp.full(left, True)
            spot = field.first_hit(xp, incoming.p, incoming.d, everybody, field.locate(xp, incoming.p, everybody))
            at = transferred(xp, incoming, field.jet_at(xp, spot, 1), spot, xp.full(incoming.p[0], 0.0))
            jet = field.jet_at(xp, field.locate(xp, at.p, spot.hit), 2)
            out = mirrored(xp, at, jet, spot.hit)
            return (left - 1, *(entry for vector in out for entry in vector))

        ended = xp.while_loop(lambda state: state[0] > 0, bounce, (columns[18], *columns[:18]))
        return components(beam(tuple(ended[1:])))

    found, now, each = [], start, bounces // marks
    for mark in range(1, marks + 1):
        columns = now.columns()
        columns[:3] = (now.p - field.anchor).T
        out = rays(field.engine.run(program, [*columns, np.full(len(now), each)]))
        now = Rays(out.p + field.anchor, out.d, out.dp_dx, out.dp_dy, out.dd_dx, out.dd_dy)
        found.append((mark * each, now))
    return found

"""Whether derivatives are those of what is traced: the remainder T(x + e) - T(x) - e J must shrink as e^2.

In: what displaced rays see, and J. Out: the remainder's fitted slope, pixel by pixel. It needs no truth, and proves
that J is the derivative of the route's own answers: with a wrong J the slope is 1.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from validate.beam import Beam, MeshRays, displace
from validate.metrics import fitted_order

# Pixels: short enough that few rays leave their cell of the grid, where an interpolant may bend.
STEPS = (1 / 8, 1 / 16, 1 / 32, 1 / 64)
RIGHT = 1.5  # between the slope of a wrong derivative, 1, and that of a right one, 2
# Roundings that T may be off by: of a place found to a few units in the last place of its distance, over the slope of
# the ray, times the texture's gradient. Remainders below this say nothing.
FLOOR = 1e-11

Look = Callable[[Beam], Float[np.ndarray, "m k"]]


def displaced_rays(rays: Beam) -> MeshRays:
    """The rays themselves, then displaced by each of `STEPS` to the right, then down, one after the other."""
    moved = [displace(rays, 0.0, 0.0)]
    moved += [displace(rays, *offset) for e in STEPS for offset in ((e, 0.0), (0.0, e))]
    names = ("p", "d", "dp_dx", "dp_dy", "dd_dx", "dd_dy")
    return MeshRays(*(np.concatenate([getattr(one, name) for one in moved]) for name in names))


def slopes(look: Look, rays: Beam, jacobian: Float[np.ndarray, "n k 2"]) -> dict[str, float]:
    """Fit the slope of the remainder over e.

    Parameters
    ----------
    look
        From rays to outputs T, not finite where there is none (a miss, another chart); asked once, for all rays.
    rays
        Some pixels' rays with differentials.
    jacobian
        [dT/dx dT/dy] per pixel, in the unit of T.

    Returns
    -------
    dict
        "taylor.pixels" that have a remainder at every step; "taylor.exact", the share of those whose remainder is
        rounding; over the others "taylor.slope", of the median remainder, and "taylor.right", the share of pixels
        whose own slope is above 1.5.
    """
    seen = look(displaced_rays(rays)).reshape(1 + 2 * len(STEPS), len(rays.p), -1)
    steps = np.repeat(STEPS, 2).reshape(-1, 2)
    linear = steps[:, :, None, None] * np.moveaxis(jacobian, 2, 0)
    moved = seen[1:].reshape(len(STEPS), 2, *seen.shape[1:])
    good = np.isfinite(seen).all(axis=(0, 2))
    remainder = np.linalg.norm((moved - seen[0] - linear)[:, :, good], axis=(1, 3))
    floor = FLOOR * np.linalg.norm(jacobian[good], axis=(1, 2))
    above = remainder[-1] > floor
    found = {"taylor.pixels": float(good.sum()), "taylor.exact": float((~above).mean()) if good.any() else 0.0}
    if not above.any():
        return found
    steep = np.polyfit(np.log(STEPS), np.log(remainder[:, above]), 1)[0]
    median = np.median(remainder[:, above], axis=1)
    found["taylor.slope"] = fitted_order(np.array(STEPS), median)
    return found | {"taylor.right": float((steep > RIGHT).mean())}

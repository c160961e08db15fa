"""The paper of Galim 2018, given a thickness so that it has an inside.

In: size and place. Out: a `Box` whose front face is exactly the texture's [0, 1]^2. The other faces continue past the
border by the same net, so that texture coordinates are continuous over the front's four edges and leave [0, 1] on the
sides and the back: a texture that clamps or repeats shows it there.
"""

import numpy as np

from datasets_synthetic.box import Box
from datasets_synthetic.net import Net

#: Axes (rows: box x, y, z in the world) of a front that faces +z or -z, text upright when y is up.
FACING = {
    "+z": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "-z": np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
}


def sheet(
    size: tuple[float, float] = (2.0, 2.0),
    thickness: float = 0.2,
    front: tuple[float, float, float] = (0.0, 0.0, 0.0),
    facing: str = "+z",
    name: str = "sheet",
) -> Box:
    """Place a sheet whose text reads left to right for an eye outside its front, with y up.

    Parameters
    ----------
    size
        Width and height of the front.
    thickness
        Depth behind the front.
    front
        Middle of the front face, world frame.
    facing
        Outward direction of the front: "+z" or "-z".
    name
        Name of its part.
    """
    half = (size[0] / 2, size[1] / 2, thickness / 2)
    frame = FACING[facing]
    x, y, z = np.asarray(front) - half[2] * frame[2]
    return Box(Net.front(half), (float(x), float(y), float(z)), frame, (name,))

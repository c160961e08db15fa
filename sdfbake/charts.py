"""Charts of an atlas, found from texture coordinates alone.

In: welded faces and texture coordinates per corner. Out: a chart id per face: two faces share a chart if they share an
edge and both its ends have the same texture coordinates on either side.
"""

import numpy as np
from jaxtyping import Float, Int


def charts_of(faces: Int[np.ndarray, "f 3"], uv: Float[np.ndarray, "f 3 2"]) -> Int[np.ndarray, " f"]:
    """Return the chart of every face, int32, numbered by the charts' lowest faces."""
    from scipy.sparse import coo_array  # here, so that `import sdfbake` is light
    from scipy.sparse.csgraph import connected_components

    corners = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    ends = np.stack([uv, np.roll(uv, -1, axis=1)], axis=2).reshape(-1, 2, 2) + 0.0  # no -0.0: bits are compared
    order = np.argsort(corners, axis=1, kind="stable")
    ends = np.take_along_axis(ends, order[:, :, None], axis=1)
    edge = np.column_stack([np.sort(corners, axis=1), ends.reshape(-1, 4).view(np.int64)])
    _, group = np.unique(edge, axis=0, return_inverse=True)
    face = np.repeat(np.arange(len(faces)), 3)
    group = group.reshape(-1)
    nodes = len(faces) + len(edge)
    links = coo_array((np.ones(len(face), np.int8), (face, len(faces) + group)), shape=(nodes, nodes))
    _, label = connected_components(links, directed=False)
    _, first, chart = np.unique(label[: len(faces)], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first)).astype(np.int32)[chart.reshape(-1)]

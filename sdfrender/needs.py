"""What a scene needs of its grids, for the baker.

In: a scene; its grids need not exist. Out: `sdfbake.needs.Needs`, one entry per grid, with the cameras brought to the
frame of its mesh.
"""

import numpy as np
from jaxtyping import Float

from sdfbake.needs import Camera, GridNeeds, Needs, Orthographic, Pinhole, Vector3
from sdfrender.facts import Facts
from sdfrender.offer import BANDS
from sdfrender.plan import make_plan, uv_required
from sdfrender.planned import AssetPlan
from sdfrender.scene import Asset, Scene


def needs_of(scene: Scene) -> Needs:
    """Say what the grids of a scene must have.

    Parameters
    ----------
    scene
        The scene. Its files are not opened: texture coordinates that it leaves open are taken as faces.

    Returns
    -------
    Needs
        Several places of one grid are one entry, with a camera for each.
    """
    bare = scene.plain()
    plan, facts = make_plan(bare, unbaked=True), Facts.of(bare)
    places: dict[str, list[tuple[Asset, AssetPlan]]] = {}
    for asset, read in zip(bare.assets, plan.assets, strict=True):
        places.setdefault(str(asset.grid), []).append((asset, read))
    return Needs(
        grids=tuple(
            GridNeeds(
                grid=grid,
                uv_modes=tuple(sorted({read.uv_mode for _, read in group if read.uv_mode})),
                uv_required=any(uv_required(asset, facts) for asset, _ in group),
                charts=plan.uv and bool({"chart", "nonlinearity"} & set(plan.outputs)),
                parts=any("part" in read.channels for _, read in group),
                kernel=scene.trace.kernel,
                band=BANDS[scene.trace.kernel],
                primary_only=len(plan.orders) == 1,
                cameras=tuple(_seen_from(scene, asset) for asset, _ in group),
            )
            for grid, group in places.items()
        )
    )


def _seen_from(scene: Scene, asset: Asset) -> Camera:
    """Bring the camera to the frame of an asset's grid."""
    camera, placed = scene.camera.camera(scene.film.size), asset.placed()
    view, right, down = camera.frame()
    pixel = float(np.linalg.norm(right))  # at unit distance, or of the picture
    axes = [_three(placed.rotation.T @ (vector / np.linalg.norm(vector))) for vector in (view, right, down)]
    if scene.camera.type == "orthographic":
        return Orthographic(view=axes[0], units_per_pixel=pixel / placed.scale)
    width, height = (0.5 * count * pixel for count in scene.film.size)
    return Pinhole(
        position=_three(placed.rotation.T @ (np.array(camera.position) - placed.translation) / placed.scale),
        view=axes[0],
        right=axes[1],
        down=axes[2],
        tangents=(width, height),
        radians_per_pixel=pixel,
    )


def _three(vector: Float[np.ndarray, " 3"]) -> Vector3:
    x, y, z = vector.tolist()
    return x, y, z

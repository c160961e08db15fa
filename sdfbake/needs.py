"""What a picture needs of the grids that it shows: written where scenes are known, read where grids are baked.

In: a JSON file, such as `python -m sdfrender plan SCENE --needs FILE` writes. Out: checked records. The baker never
reads a scene: cameras are given in the frame of the mesh, and only as far as a resolution depends on them.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from sdfbake.atomic import replacing
from sdfbake.complaint import BadInput

BOUND = "the resolution follows from primary rays: what mirrors and glass enlarge may need more"

Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Pinhole(_Strict):
    """A camera whose rays come from one point, in the frame of the mesh.

    Attributes
    ----------
    position
        The pinhole, the mesh's units.
    view, right, down
        Unit vectors: into the picture, and along its rows and columns.
    tangents
        Of half the field of view, across and down.
    radians_per_pixel
        In the middle of the picture: what a pixel covers of a plane across the view, per distance.
    """

    type: Literal["pinhole"] = "pinhole"
    position: Vector3
    view: Vector3
    right: Vector3
    down: Vector3
    tangents: tuple[Positive, Positive]
    radians_per_pixel: Positive


class Orthographic(_Strict):
    """A camera whose rays are parallel, in the frame of the mesh: their direction, and a pixel's side in its units."""

    type: Literal["orthographic"] = "orthographic"
    view: Vector3
    units_per_pixel: Positive


Camera = Annotated[Pinhole | Orthographic, Field(discriminator="type")]


class GridNeeds(_Strict):
    """What is needed of one grid, wherever it stands.

    Attributes
    ----------
    grid
        Its path, as the scene has it.
    uv_modes
        Representations of texture coordinates that are read.
    uv_required
        Whether the picture cannot be made without them; if not, a mesh that has none will do.
    charts, parts
        Whether the charts of texture coordinates and the parts of the surface matter.
    kernel
        How samples are interpolated.
    band
        Voxels from the surface within which the kernel reads samples at a hit.
    primary_only
        Whether rays come to it straight from the camera only; else the cameras say nothing of the others.
    cameras
        Who looks, once for every place.
    """

    grid: str
    uv_modes: tuple[Literal["faces", "layers", "grid"], ...] = ()
    uv_required: bool = False
    charts: bool = False
    parts: bool = False
    kernel: Literal["linear", "catmull-rom", "bspline"]
    band: Positive
    primary_only: bool
    cameras: tuple[Camera, ...] = ()


class Needs(_Strict):
    """What is needed of all grids of a scene; `note` says how far the cameras bound a resolution."""

    format: Literal["sdf-ray-differentials needs"] = "sdf-ray-differentials needs"
    version: Literal[1] = 1
    note: str = BOUND
    grids: tuple[GridNeeds, ...] = Field(min_length=1)

    def of(self, output: Path) -> GridNeeds:
        """Return what is needed of the grid that a bake makes: the one with that file name, or the only one.

        Raises
        ------
        BadInput
            If there are several, and not one of them has that name.
        """
        named = [needs for needs in self.grids if Path(needs.grid).name == output.name]
        if len(named) == 1 or len(self.grids) == 1:
            return (named or list(self.grids))[0]
        names = ", ".join(needs.grid for needs in self.grids)
        which = f"{len(named)} grids are called {output.name}" if named else f"no grid is called {output.name}"
        raise BadInput(f"{which} in the needs, which are of {names}: name the output as the scene does")

    def save(self, path: str | Path) -> None:
        """Write the file; an old one is replaced once the new one is whole."""
        with replacing(path) as temporary:
            temporary.write_text(self.model_dump_json(indent=2) + "\n", encoding="utf-8")


def load_needs(path: str | Path) -> Needs:
    """Read a file of needs.

    Raises
    ------
    BadInput
        If there is no such file, it holds no needs, those of another version, or an entry that cannot be.
    """
    path = Path(path)
    try:
        return Needs.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        raise BadInput(f"there is no file of needs {path}: write one with 'python -m sdfrender plan'") from None
    except OSError as error:
        raise BadInput(f"the needs {path} cannot be read ({error.strerror}): give a JSON file") from None
    except ValidationError as error:
        mistake = error.errors()[0]
        key = ".".join(map(str, mistake["loc"]))
        where = f" at '{key}'" if key else ""
        said = mistake["msg"]
        raise BadInput(
            f"the needs {path} are wrong{where} ({said}): write them anew with 'python -m sdfrender plan'"
        ) from None

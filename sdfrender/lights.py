"""Where light comes from, as a scene says it.

In: tables of a scene's file. Out: checked records; `sdfrender.lighting` computes with them.
"""

from math import hypot
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from sdfrender.strict import Colour, Strict, Vector3


class PointLight(Strict):
    """A point that shines everywhere alike; `intensity` is power per solid angle, so 1 / r^2 falls on a surface."""

    type: Literal["point"]
    position: Vector3
    intensity: Colour = (1.0, 1.0, 1.0)
    shadows: bool = True


class DirectionalLight(Strict):
    """Parallel light along `direction`; `irradiance` is what falls on a surface across it."""

    type: Literal["directional"]
    direction: Vector3
    irradiance: Colour = (1.0, 1.0, 1.0)
    shadows: bool = True

    @field_validator("direction")
    @classmethod
    def _has_length(cls, direction: Vector3) -> Vector3:
        if not hypot(*direction) > 0:
            raise ValueError("a direction needs a length")
        return direction


Light = Annotated[PointLight | DirectionalLight, Field(discriminator="type")]


class EnvironmentLight(Strict):
    """A latitude-longitude picture around the scene: what is seen where nothing is hit, and what lights the matt."""

    image: Path
    filter: Literal["bilinear", "anisotropic"] = "anisotropic"
    intensity: float = Field(1.0, ge=0, allow_inf_nan=False)

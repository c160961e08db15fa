"""What records read from a file have in common: a key that does not exist is an error, and nothing changes later."""

from pydantic import BaseModel, ConfigDict, FiniteFloat

Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Colour = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class Strict(BaseModel):
    """A frozen record."""

    model_config = ConfigDict(extra="forbid", frozen=True)

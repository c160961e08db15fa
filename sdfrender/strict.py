"""What records read from a file have in common: a key that does not exist is an error, and nothing changes later."""

from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, FiniteFloat

Vector3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Colour = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class Strict(BaseModel):
    """A frozen record."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def kind_or(usual: str) -> Callable[[Any], str]:
    """Return what tells the kind of a table by its `type`: the usual one where it does not say."""

    def kind(data: Any) -> str:
        return str(data.get("type", usual) if isinstance(data, Mapping) else getattr(data, "type", usual))

    return kind

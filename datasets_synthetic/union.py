"""Several solids as one shape, a part for each.

In: exact shapes that do not touch. Out: an exact shape. For disjoint solids the least of the signed distances is the
distance of the union, inside too: a point within one is at least as far from the others as from its own surface.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from datasets_synthetic.shape import ExactShape
from sdfbake.mesh import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Union:
    """Disjoint solids of one part each; charts are numbered through in the members' order. The first wins ties."""

    members: tuple[ExactShape, ...]
    part_names: tuple[str, ...]

    def __post_init__(self) -> None:
        if len(self.part_names) != len(self.members):
            raise ValueError(f"{len(self.members)} members need as many part names, not {len(self.part_names)}")

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Box around all members."""
        every = np.stack([member.bounds for member in self.members])
        return np.stack([every[:, 0].min(axis=0), every[:, 1].max(axis=0)])

    @property
    def charts(self) -> int:
        """Charts of all members."""
        return sum(member.charts for member in self.members)

    @property
    def area(self) -> float:
        """Sum of the members' areas."""
        return sum(member.area for member in self.members)

    @property
    def volume(self) -> float:
        """Sum of the members' volumes."""
        return sum(member.volume for member in self.members)

    def distance(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Least of the members' distances."""
        distance: Float[np.ndarray, " n"] = np.min([member.distance(p) for member in self.members], axis=0)
        return distance

    def normal(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The nearest member's."""
        return self._of_nearest(p, lambda member, near: member.normal(near))

    def hessian(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
        """The nearest member's."""
        return self._of_nearest(p, lambda member, near: member.hessian(near))

    def uv(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """The nearest member's."""
        return self._of_nearest(p, lambda member, near: member.uv(near))

    def uv_gradient(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
        """The nearest member's."""
        return self._of_nearest(p, lambda member, near: member.uv_gradient(near))

    def chart(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """The nearest member's, after the charts of the members before it."""
        own = self._of_nearest(p, lambda member, near: member.chart(near))
        chart: Int[np.ndarray, " n"] = own + self._first_chart[self.part(p)]
        return chart

    def part(self, p: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
        """Index of the nearest member."""
        part: Int[np.ndarray, " n"] = np.argmin([member.distance(p) for member in self.members], axis=0)
        return part

    def intersect(self, o: Float[np.ndarray, "n 3"], d: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """First of the members' hits."""
        t: Float[np.ndarray, " n"] = np.min([member.intersect(o, d) for member in self.members], axis=0)
        return t

    def mesh(self, edge: float) -> Mesh:
        """The members' meshes side by side."""
        meshes = [member.mesh(edge) for member in self.members]
        sizes = np.array([len(mesh.vertices) for mesh in meshes])
        starts = np.cumsum(sizes) - sizes
        return Mesh(
            np.concatenate([mesh.vertices for mesh in meshes]),
            np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]),
            np.concatenate([mesh.uv for mesh in meshes if mesh.uv is not None]),
            np.concatenate([mesh.chart + first for mesh, first in zip(meshes, self._first_chart, strict=True)]),
            np.concatenate([mesh.part + index for index, mesh in enumerate(meshes)]),
            self.part_names,
        )

    @property
    def _first_chart(self) -> Int[np.ndarray, " m"]:
        counts = np.array([member.charts for member in self.members])
        first: Int[np.ndarray, " m"] = np.cumsum(counts) - counts
        return first

    def _of_nearest(
        self, p: Float[np.ndarray, "n 3"], answer: Callable[[ExactShape, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Ask each member about the points nearest to it; answers (n, ...) in the order of the points."""
        part = self.part(p)
        places = [np.flatnonzero(part == index) for index in range(len(self.members))]
        answers = np.concatenate([answer(member, p[place]) for member, place in zip(self.members, places, strict=True)])
        ordered: np.ndarray = answers[np.argsort(np.concatenate(places))]
        return ordered

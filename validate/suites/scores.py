"""Our own renders, scored as if another renderer had written them.

In: build/renders/{torus,bunny}.exr, their scenes and meshes. Out: one error run per file and truth, as
`python -m validate score` makes them of anybody's.
"""

from collections.abc import Iterator
from functools import partial

from validate.experiment import Bench, Run, guarded
from validate.score import score

NAMES = ("torus", "bunny")
EXACT = ("torus",)


def run(bench: Bench) -> Iterator[Run]:
    """Every render against its mesh, and against its exact shape where it has one."""
    for name in NAMES:
        bench.progress(f"score of the render {name}")
        file, scene = bench.render(name), bench.build / "scenes" / f"{name}.toml"
        blank = Run("scores", name, {"file": file.name, "truth": f"{name}.ply"}, {}, "error")
        yield guarded(blank, partial(score, file, scene, meshes=[bench.mesh(name)]))
        if name in EXACT:
            blank = Run("scores", name, {"file": file.name, "truth": f"exact {name}"}, {}, "error")
            yield guarded(blank, partial(score, file, scene, shapes=[name]))

"""The experiments, one file each; `SUITES` names them in the order of the report.

Each file has `run(bench) -> Iterator[Run]` and is imported only when it is asked for.
"""

SUITES = (
    "figures",
    "pictures",
    "inspector",
    "footprints",
    "shapes",
    "meshes",
    "matrix",
    "bounces",
    "representations",
    "convergence",
    "derivatives",
    "misses",
    "stress",
    "frontier",
    "cost",
    "engines",
    "faults",
    "filtering",
    "scores",
    "opinion",
    "baking",
    "rendering",
)

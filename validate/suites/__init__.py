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
    "bounces",
    "matrix",
    "representations",
    "filtering",
    "convergence",
    "derivatives",
    "misses",
    "stress",
    "truths",
    "faults",
    "frontier",
    "cost",
    "engines",
    "savings",
    "levels",
    "opinion",
    "scores",
    "baking",
    "rendering",
    "consumers",
)

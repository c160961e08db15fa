"""Stiff and extreme cases, by theme; `THEMES` names the files in the order of the report.

Each file has `CASES`, a tuple of `validate.stress.case.Case`, and is imported only when it is asked for.
"""

THEMES = ("grazing", "resonance", "glass", "geometry", "lattices", "samples", "charts", "meshes")

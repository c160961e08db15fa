"""Other tools that bake or render, each in a process of its own: `catalogue` lists them, `process` talks to them.

`worker`, `frames`, `openvdb`, `trueform` and `mitsuba` run in whatever Python has the tool: they import NumPy and
nothing of ours.
"""

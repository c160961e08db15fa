"""Other tools that bake, each in a process of its own: `catalogue` lists them, `process` talks to them.

`worker`, `openvdb` and `trueform` run in whatever Python has the tool: they import NumPy and nothing of ours.
"""

"""The array engine under bake and trace: one program, two engines.

A program is written over one-dimensional arrays with operators and the functions of `Engine`. `choose` says which
engine runs it: `numpy` (always there, float64) or `drjit` (compiled, float32 by default).
"""

from sdfbake.engine.choose import Choice, choose
from sdfbake.engine.protocol import Array, Engine, Program

__all__ = ["Array", "Choice", "Engine", "Program", "choose"]

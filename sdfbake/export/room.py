"""Whether an export fits, asked before anything is written.

In: the bytes that it takes on the disk and in memory. Out: a refusal with the number.
"""

import shutil
from pathlib import Path

from sdfbake.complaint import BadInput
from sdfbake.memory import GIB, available


def check_room(path: Path, on_disk: int, in_memory: int) -> None:
    """Refuse an export that does not fit.

    Parameters
    ----------
    path
        The file; others may be put beside it.
    on_disk
        Bytes of all files. What they replace is still there while they are written.
    in_memory
        Bytes that are needed beside the grid.

    Raises
    ------
    BadInput
        With both numbers.
    """
    free = shutil.disk_usage(path.absolute().parent).free
    if on_disk > free:
        raise BadInput(
            f"{path} needs {size(on_disk)} of disk space and {size(free)} are free there: choose another disk, or bake "
            "at a lower resolution"
        )
    left = available()
    if in_memory > left:
        raise BadInput(
            f"writing {path} needs {size(in_memory)} of memory and {size(left)} are available: bake at a lower "
            "resolution"
        )


def size(count: float) -> str:
    """Return bytes as people read them, in units of 2^20 or 2^30."""
    return f"{count / GIB:.2f} GB" if count >= GIB else f"{count / (1 << 20):.1f} MB"

"""How much memory a bake may take.

In: bytes needed. Out: nothing, or a refusal with the number, before anything is allocated.
"""

import os
from pathlib import Path

from sdfbake.complaint import BadInput

GIB = 1 << 30


def available() -> float:
    """Return the bytes that can be had now without swapping; infinity where the system does not say."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (OSError, ValueError, AttributeError):  # no /proc and no sysconf: Windows
        return float("inf")


def require(needed: float, limit: float | None, resolution: int) -> None:
    """Refuse what would not fit.

    Parameters
    ----------
    needed
        Bytes.
    limit
        Gigabytes (2^30 bytes) allowed; None for what the machine has.
    resolution
        Named in the refusal.

    Raises
    ------
    BadInput
        If more is needed.
    """
    most = available() if limit is None else limit * GIB
    if needed > most:
        raise BadInput(
            f"resolution {resolution} needs about {needed / GIB:.2f} GB of memory and {most / GIB:.2f} GB are "
            f"{'available' if limit is None else 'allowed'}: choose a lower resolution or raise --max-memory"
        )

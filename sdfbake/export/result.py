"""What every export takes and gives back.

In: nothing. Out: `Exported`, the record of what was written, and the type of a progress report.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

# Called with a stage and the share of it that is done, 0 to 1.
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Exported:
    """What an export wrote.

    Attributes
    ----------
    files
        All files that were written, the one that was asked for first.
    dropped
        A sentence for everything that the grid has and the format cannot carry.
    notes
        A sentence for everything that a reader has to know.
    """

    files: tuple[Path, ...]
    dropped: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Bytes of all files together."""
        return sum(path.stat().st_size for path in self.files)


def silent(stage: str, share: float) -> None:
    """Report no progress."""

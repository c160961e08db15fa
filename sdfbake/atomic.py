"""Files that appear whole or not at all.

In: a final path. Out: a temporary path beside it to write to, renamed when the block ends without error.
"""

import secrets
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from sdfbake.complaint import BadInput


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary sibling of `path` that takes its place when the block succeeds.

    Parameters
    ----------
    path
        Where the file is to be. Missing folders are made.

    Yields
    ------
    Path
        The temporary file, with the same suffix (some writers choose their format by it).

    Raises
    ------
    BadInput
        If the folder cannot be made or written to.
    """
    path = Path(path)
    check_writable(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot make the folder {path.parent} ({error.strerror}): choose another output") from None
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise BadInput(f"cannot write {path} ({error.strerror}): free some space or choose another output") from None
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def replacing_all(paths: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Yield a temporary sibling of every path, as `replacing` does; all take their places when the block succeeds.

    The first takes its place last: whoever sees it sees all.
    """
    with ExitStack() as stack:
        yield tuple([stack.enter_context(replacing(path)) for path in paths])


def check_writable(path: str | Path) -> None:
    """Raise BadInput if a file could not be put there; for asking before hours of work, leaves nothing behind."""
    path = Path(path).absolute()
    folder = next(parent for parent in path.parents if parent.exists())
    if path.is_dir():
        raise BadInput(f"cannot write {path}: it is a folder; name a file in it")
    try:
        with tempfile.TemporaryFile(dir=folder):  # permissions alone do not tell: the folder may take no files
            pass
    except OSError:
        reason = f"{folder} is not a folder that can be written to"
        raise BadInput(f"cannot write {path}: {reason}; choose another output") from None

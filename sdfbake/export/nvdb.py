"""Grids as NanoVDB, by the converter of the NanoVDB tools.

In: a grid. Out: the grids of the OpenVDB export in one file, as the tools' own validator accepts them. There is no
library to install with pip whose files it accepts, so that these tools are asked for.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

from sdfbake.atomic import replacing
from sdfbake.complaint import BadInput
from sdfbake.export import vdb
from sdfbake.export.result import Exported, Progress, silent
from sdfbake.grid import Grid

CONVERTER, VALIDATOR = "nanovdb_convert", "nanovdb_validate"


def write(grid: Grid, path: Path, *, progress: Progress = silent) -> Exported:
    """Write what `sdfbake.export.vdb.write` writes, converted and validated.

    Parameters
    ----------
    grid
        Any grid, whole.
    path
        The file.
    progress
        Called with a stage and the share of it that is done, 0 to 1.

    Raises
    ------
    BadInput
        If a tool is not installed or fails, or the file cannot be written.
    """
    converter, validator = (_tool(name) for name in (CONVERTER, VALIDATOR))
    # Beside the output: what is converted is of its size, and may not fit elsewhere.
    with tempfile.TemporaryDirectory(dir=path.absolute().parent, prefix=f".{path.stem}.") as folder:
        source = Path(folder) / "grid.vdb"
        made = vdb.write(grid, source, progress=progress)
        with replacing(path) as temporary:
            progress("nanovdb", 0)
            _run([converter, "-f", "-c", "full", str(source), str(temporary)], path)
            progress("nanovdb", 0.5)
            _run([validator, str(temporary)], path)
            progress("nanovdb", 1)
    dropped = (*made.dropped, "names of parts and of the unit: the format has names of grids only")
    return Exported((path,), dropped, made.notes)


def _tool(name: str) -> str:
    """Return where a tool is."""
    found = shutil.which(name)
    if found is None:
        raise BadInput(
            f"NanoVDB files are made by {name}, which is not installed: install it (on Debian and Ubuntu the package "
            "libnanovdb-tools), or export vdb and convert that where it is"
        )
    return found


def _run(command: list[str], path: Path) -> None:
    """Run a tool that has to succeed."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    if done.returncode or "failed" in said.lower():
        last = (said.strip().splitlines() or ["no word"])[-1]
        raise BadInput(f"{Path(command[0]).name} did not make {path} ({last}): check its version, or export vdb")

"""Command line of the baker.

In: mesh and grid files. Out: files, a table or one JSON object on standard output, progress on standard error.
"""

import click

from sdfbake import commandline
from sdfbake.commands.bake import bake
from sdfbake.commands.check import check
from sdfbake.commands.diff import diff
from sdfbake.commands.export import export_
from sdfbake.commands.import_ import import_
from sdfbake.commands.info import info
from sdfbake.commands.mesh import mesh
from sdfbake.commands.unwrap import unwrap
from sdfbake.commands.view import view


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def cli() -> None:
    """Meshes to signed distance grids with texture coordinates."""


for command in (check, unwrap, bake, info, mesh, diff, export_, import_, view):
    cli.add_command(command)

if __name__ == "__main__":
    commandline.run(cli, "python -m sdfbake")

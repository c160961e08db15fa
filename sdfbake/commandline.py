"""One behaviour for the four command lines: exit codes, one-line complaints, JSON.

Exit codes: 0 done, 1 a defect of ours or a failed check, 2 bad input, 130 interrupted.
"""

import json
import sys
from typing import Any, NoReturn

import click

from sdfbake.complaint import BadInput


def run(command: click.Command, program: str) -> NoReturn:
    """Run a click command and leave the process with the exit code of the contract above."""
    try:
        code = command.main(prog_name=program, standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except BadInput as complaint:
        _leave(str(complaint))
    except click.exceptions.NoArgsIsHelpError as help_page:
        click.echo(help_page.format_message())
        sys.exit(2)
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else program
        _leave(f"{error.format_message()} (try '{where} --help')")
    except click.ClickException as error:
        _leave(error.format_message())
    except (KeyboardInterrupt, click.Abort):
        print("interrupted: nothing was written", file=sys.stderr)
        sys.exit(130)


def _leave(sentence: str) -> NoReturn:
    print("error: " + " ".join(sentence.split()), file=sys.stderr)
    sys.exit(2)


def print_json(record: Any) -> None:
    """Print one JSON object on standard output."""
    print(json.dumps(record, indent=2, sort_keys=True, allow_nan=False))

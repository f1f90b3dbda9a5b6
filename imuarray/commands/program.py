"""How every program of this project ends: the exit code, and one line for bad input."""

from __future__ import annotations

from collections.abc import Sequence

import click

from imuarray.errors import ImuArrayError
from imuarray.printable import printable


def run(command: click.Command, name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command as the program `name` (with `arguments`, else those of this process): what it returns is the exit
    code, that of the error with one line (2 for bad input), 130 if it was interrupted.
    """
    try:
        given = None if arguments is None else list(arguments)
        result = command.main(args=given, prog_name=name, standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo(f"{name}: interrupted", err=True)
        return 130
    except (click.ClickException, ImuArrayError) as error:
        text = error.format_message() if isinstance(error, click.ClickException) else str(error)
        click.echo(printable(f"{name}: {' '.join(text.split())}"), err=True)
        return error.exit_code if isinstance(error, ImuArrayError) else 2
    return result if isinstance(result, int) else 0

"""`imuarray verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.commands.options import json_option, log_argument, print_json, progress
from imuarray.errors import LogError
from imuarray.printable import counted

if TYPE_CHECKING:
    from imuarray.log.reader import LogVerification


@click.command("verify")
@log_argument
@json_option
def command(run: Path, as_json: bool) -> None:
    """Read a whole log and check every block: exit code 0 if it is intact, 2 if rows are damaged.

    The log is not changed. A log that is being written, or that was interrupted, can be checked as well.

    \b
    imuarray verify run.h5
    """
    from imuarray.log import Log
    from imuarray.log.reader import verify

    with Log(run) as log:
        rows = sum(len(sensor) for sensor in log.sensors.values())
    with progress(rows, str(run)) as set_progress:
        verdict = verify(run, set_progress)
    if as_json:
        print_json({"log": str(run), "good": not verdict.problems, **verdict._asdict()})
    else:
        _print(run, verdict)
    if verdict.problems:
        others_text = f" (and {len(verdict.problems) - 1} more)" if len(verdict.problems) > 1 else ""
        raise LogError(f"{run}: {verdict.problems[0]}{others_text}")


def _print(run: Path, verdict: LogVerification) -> None:
    for text in (*verdict.problems, *verdict.remarks):
        click.echo(f"  {text}")
    finding = counted(len(verdict.problems), "problem") if verdict.problems else "every block is good"
    size = f"{sum(verdict.rows.values())} rows of {counted(len(verdict.rows), 'sensor')}"
    click.echo(f"{run}: {verdict.state}, {size}: {finding}")

"""`imuarray recover`."""

from __future__ import annotations

from pathlib import Path

import click

from imuarray.commands.options import PathName, json_option, log_argument, print_json, progress, refuse_existing


@click.command("recover")
@log_argument
@click.option(
    "-o",
    "--output",
    type=PathName(),
    metavar="FILE.h5",
    help="write the finished log here and leave RUN.h5 unchanged (useful if its disk is full)",
)
@click.option("--force", is_flag=True, help="overwrite the output if it exists; finish a log even without its journal")
@json_option
def command(run: Path, output: Path | None, force: bool, as_json: bool) -> None:
    """Finish an interrupted log in place; every acknowledged row is kept, compressed and checked.

    Other commands can read an interrupted log directly. Recovering turns the log and its journal into one small file.

    \b
    imuarray recover run.h5
    """
    from imuarray.log import Log
    from imuarray.log.writer import recover

    if output is not None:
        refuse_existing(output, force, run)
    with Log(run) as log:
        rows = sum(len(sensor) for sensor in log.sensors.values())
    with progress(rows, str(run)) as set_progress:
        recovered = recover(run, output, set_progress, force=force)
    if as_json:
        print_json({"log": str(output or run), **recovered._asdict()})
    elif recovered.changed:
        click.echo(f"{output or run}: recovered {sum(recovered.rows.values())} rows of {len(recovered.rows)} sensors")
    elif output is not None:
        click.echo(f"{run}: was finished already; {output} is a copy of it")
    else:
        click.echo(f"{run}: was finished already; nothing to recover")
    if recovered.kept is not None and not as_json:
        click.echo(f"{run}: its journal has unreadable data or belongs to another log; kept as {recovered.kept}")

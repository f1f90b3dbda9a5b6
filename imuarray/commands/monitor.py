"""`imuarray monitor`."""

from __future__ import annotations

import shutil
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.monitor import Snapshot, Watch

_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[J"
"""Where to write, and what to clear: what is written over does not flicker."""


@click.command("monitor")
@click.argument("run", metavar="RUN.h5", type=click.Path(path_type=Path))
@click.option("--text", "as_text", is_flag=True, help="show it here, as text, instead of serving a page")
@click.option("--json", "as_json", is_flag=True, help="print one JSON object a line for every look, instead of a page")
@click.option("--once", is_flag=True, help="look once and end (with --text or --json)")
@click.option(
    "--every",
    "every_s",
    type=click.FloatRange(0.2, 3600),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="between two looks; the logger writes once a second",
)
@click.option(
    "--calibration",
    type=click.Path(path_type=Path),
    metavar="CAL.toml",
    help="fuse with this calibration (default: the data sheets' values)",
)
@click.option("--port", type=click.IntRange(0, 65535), default=8765, show_default=True, help="0: any that is free")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="address to serve on; on another than this machine's own the page wants the token that is printed",
)
@click.option("--parent", type=int, hidden=True, help="end with this process")
def command(
    run: Path,
    as_text: bool,
    as_json: bool,
    once: bool,
    every_s: float,
    calibration: Path | None,
    port: int,
    host: str,
    parent: int | None,
) -> None:
    """Watch a log while it is written: rates, gaps, events, disk, every sensor, the fused output.

    Serves a page to this machine's browser; with --text the same in the terminal. It only reads, at low priority, and
    follows a log that is cut into parts.

    \b
    imuarray monitor night.h5 --text
    """
    known = _calibration(calibration)
    if once and not (as_text or as_json):
        raise click.UsageError("--once is one look: say --text or --json with it")
    if once and not (run.exists() or run.with_name(f"{run.stem}_001{run.suffix}").exists()):
        raise click.UsageError(f"{run}: no such file")
    if as_text or as_json:
        _look_on(run, known, every_s, as_json=as_json, once=once)
    else:
        from imuarray.monitor.server import serve

        serve(run, host=host, port=port, calibration=known, every_s=every_s, announce=click.echo, parent=parent)


def _calibration(path: Path | None) -> Calibration | None:
    from imuarray.calibrate import load_calibration

    return None if path is None else load_calibration(path)


def _look_on(run: Path, calibration: Calibration | None, every_s: float, *, as_json: bool, once: bool) -> None:
    """Look and show, again and again until the log has ended."""
    from imuarray.monitor import Watch
    from imuarray.monitor.priority import step_back

    step_back()
    with Watch(run, calibration=calibration) as watch:
        while True:
            snapshot = _counted(watch) if once else watch.refresh(time.monotonic())
            _show_json(snapshot) if as_json else _show_text(snapshot, once)
            if once or (snapshot.state in ("finished", "interrupted") and snapshot.counted == 1.0):
                return
            time.sleep(every_s)


def _counted(watch: Watch) -> Snapshot:
    """The first look in which all of the log was counted."""
    while True:
        snapshot = watch.refresh(time.monotonic())
        if snapshot.counted == 1.0:
            return snapshot


def _show_json(snapshot: Snapshot) -> None:
    import json

    from imuarray.monitor.payload import described

    click.echo(json.dumps(described(snapshot), ensure_ascii=False, allow_nan=False))
    with suppress(OSError):
        sys.stdout.flush()


def _show_text(snapshot: Snapshot, once: bool) -> None:
    """On a terminal over what was there before, as much as there is room for."""
    from imuarray.monitor.text import lines_of

    lines = lines_of(snapshot)
    if once or not sys.stdout.isatty():
        click.echo("\n".join(lines))
        return
    room = shutil.get_terminal_size()
    shown = [line[: room.columns] + _REST_OF_LINE for line in lines[: room.lines - 1]]
    click.echo(_HOME + "\n".join(shown) + "\n" + _REST_OF_SCREEN, nl=False, color=True)

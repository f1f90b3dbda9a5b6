"""`imuarray monitor`.

With `--text`, each screen overwrites the previous one in a single write, so that the terminal does not flicker.
"""

from __future__ import annotations

import json
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import click

from imuarray.commands.options import Duration, argument, option, takes
from imuarray.spelling import guess_file

if TYPE_CHECKING:
    from imuarray.monitor import LogMonitor, Snapshot

_HOME, _REST_OF_LINE, _REST_OF_SCREEN = "\x1b[H", "\x1b[K", "\x1b[J"
_NAP_S = 0.1


class MonitorScreen:
    """Standard output; a context manager that notices changes of the terminal's size."""

    def __init__(self) -> None:
        self.is_terminal = sys.stdout.isatty()
        self.resized = False
        self._attributes: Any = None

    @property
    def columns(self) -> int:
        """Return the usable columns: the last one stays free, because some terminals would wrap."""
        return shutil.get_terminal_size().columns - 1 if self.is_terminal else 80

    def show(self, lines: Sequence[str]) -> None:
        """Overwrite the previous screen with as many lines as fit."""
        if not self.is_terminal:
            click.echo("\n".join(lines))
            return
        room = shutil.get_terminal_size()
        visible = [line[: room.columns - 1] + _REST_OF_LINE + "\n" for line in lines[: room.lines - 1]]
        click.echo(_HOME + "".join(visible) + _REST_OF_SCREEN, nl=False, color=True)

    def rest(self, seconds: float) -> None:
        """Wait, at most until the size changes."""
        end_s = time.monotonic() + seconds
        while not self.resized and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(_NAP_S, left_s))
        self.resized = False

    def __enter__(self) -> Self:
        if self.is_terminal and hasattr(signal, "SIGWINCH"):
            self._attributes = signal.signal(signal.SIGWINCH, self._resize)
        return self

    def _resize(self, number: int, frame: Any) -> None:
        self.resized = True

    def __exit__(self, *error: object) -> None:
        if self._attributes is not None:
            signal.signal(signal.SIGWINCH, self._attributes)


@dataclass(frozen=True)
class MonitorOptions:
    """The options of `imuarray monitor`."""

    run: Path = argument(metavar="RUN.h5")
    as_text: bool = option("--text", help="show the log in this terminal instead of serving a page")
    as_json: bool = option("--json", help="print one JSON object per line and update, instead of serving a page")
    once: bool = option(help="show the current state and exit (with --text or --json)")
    every_s: float = option(
        "--every",
        type=Duration(minimum_s=0.2, maximum_s=3600),
        default="1s",
        show_default=True,
        metavar="1s",
        help="time between updates, 0.2s to 1h; the logger writes once a second",
    )
    calibration: Path | None = option(
        metavar="CAL.toml", help="calibration for the fused output (default: data-sheet values)"
    )
    port: int = option(
        type=click.IntRange(0, 65535), default=8765, show_default=True, help="the port; 0 for any free one"
    )
    host: str = option(
        default="127.0.0.1",
        show_default=True,
        metavar="ADDRESS",
        help="address to serve on; if other machines can reach it, the page requires the printed token",
    )
    result: Path | None = option(
        "--fused",
        metavar="FUSED.h5",
        help="the fused result to show  [default: RUN_fused.h5, else the average of all sensors]",
    )
    parent: int | None = option(type=int, hidden=True, help="end with this process")


@click.command("monitor")
@takes(MonitorOptions)
def command(options: MonitorOptions) -> None:
    """Monitor a log while it is written: rates, gaps, events, disk, every sensor, the fused output.

    Serves a page to this machine's browser; with --text, shows the same in the terminal. It only reads, at low
    priority, and follows a log that is split into parts.

    \b
    imuarray monitor night.h5 --text
    """
    if options.run.is_file() and options.run.suffix not in (".h5", ".hdf5"):
        raise click.UsageError(f"{options.run}: is not a log; allowed is an HDF5 file (.h5) that is written or will be")
    if options.run.is_dir():
        raise click.UsageError(f"{options.run}: is a folder; a log is a file")
    calibration = None
    if options.calibration is not None:
        from imuarray.calibrate import load_calibration

        calibration = load_calibration(options.calibration)
    if options.once and not (options.as_text or options.as_json):
        raise click.UsageError("--once needs --text or --json")
    run = options.run
    is_begun = run.exists() or run.with_name(f"{run.stem}_001{run.suffix}").exists()
    if options.once and not is_begun:
        raise click.UsageError(f"{run}: no such file{guess_file(run)}")
    if not is_begun and options.parent is None:
        click.echo(f"imuarray: waiting for {run}, which does not exist yet{guess_file(run)}", err=True)
    if options.as_text or options.as_json:
        from imuarray.monitor import LogMonitor
        from imuarray.monitor.log_monitor import lower_priority

        lower_priority()
        with LogMonitor(options.run, calibration=calibration, result=options.result) as monitor:
            _show(monitor, options.every_s, as_json=options.as_json, once=options.once)
    else:
        from imuarray.monitor.server import PageOptions, serve

        page = PageOptions(
            host=options.host,
            port=options.port,
            calibration=calibration,
            result=options.result,
            every_s=options.every_s,
            announce=click.echo,
            parent=options.parent,
        )
        serve(options.run, page)


def _show(monitor: LogMonitor, every_s: float, *, as_json: bool, once: bool) -> None:
    from imuarray.monitor.text import text_lines

    ends = nullcontext() if once else suppress(KeyboardInterrupt)  # the usual way to end
    with ends, MonitorScreen() as screen:
        while True:
            snapshot = _complete(monitor) if once else monitor.refresh(time.monotonic())
            if as_json:
                _show_json(snapshot)
            elif once:
                click.echo("\n".join(text_lines(snapshot, screen.columns)))
            else:
                screen.show(text_lines(snapshot, screen.columns))
            if once or (snapshot.state in ("finished", "interrupted") and snapshot.counted == 1.0):
                return
            screen.rest(every_s)


def _complete(monitor: LogMonitor) -> Snapshot:
    """Return the first snapshot in which the whole log is counted."""
    while True:
        snapshot = monitor.refresh(time.monotonic())
        if snapshot.counted == 1.0:
            return snapshot


def _show_json(snapshot: Snapshot) -> None:
    from imuarray.monitor.payload import described

    click.echo(json.dumps(described(snapshot), ensure_ascii=False, allow_nan=False))
    with suppress(OSError):
        sys.stdout.flush()

"""Monitors a log from outside: `LogMonitor(path).refresh(now_s)` returns a snapshot of it, at bounded cost.

It only reads, follows a log that is split into parts from each part to the next, and starts again if another log takes
the name.

All pages share snapshots, which are taken on request and at most once per interval. Bokeh draws the figures in the
browser: axes and colours are defined here, the data are in the snapshots. The page labels the curves next to the
numbers above, in the same colours.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import count, takewhile
from pathlib import Path
from typing import Any, NamedTuple

from imuarray.calibrate import Calibration
from imuarray.errors import ImuArrayError, MissingExtraError, reason_of
from imuarray.log.journal import JournalReader, is_running
from imuarray.log.rotate import part_of
from imuarray.log.untrusted_input import DAMAGE
from imuarray.monitor.composition import snapshot_of
from imuarray.monitor.log_source import Growing, LogSource, ReadRows, Whole, look
from imuarray.monitor.payload import drawn
from imuarray.monitor.snapshot import WAITING, WRITTEN, Snapshot
from imuarray.units import READABLE, READABLE_SI

SPAN_S = 10.0
"""Duration in s of the end of the log that is shown."""


class LogMonitor:
    """The monitor of the last `span_s` of the log at `path`, which need not exist yet, or of the parts into which it is
    split. A context manager. `result` is the file of its fused output (None: `RUN_fused.h5` beside it).
    """

    def __init__(
        self,
        path: Path,
        *,
        span_s: float = SPAN_S,
        calibration: Calibration | None = None,
        result: Path | None = None,
        stopwatch: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.path = path
        self._span_ns = round(span_s * 1e9)
        self._calibration, self._result = calibration or Calibration(), result
        self._stopwatch = stopwatch
        self._files: tuple[object, ...] = ()
        self._source: LogSource | None = None
        self._fresh_s = 0.0
        self._remark = ""

    def refresh(self, now_s: float) -> Snapshot:
        """Return the snapshot at `now_s`, a monotonic time. Errors of the log are not raised but are its remark."""
        start_s = self._stopwatch()
        try:
            self._look(now_s)
            if self._source is not None:
                quiet_s = now_s - self._fresh_s
                snapshot = snapshot_of(self._source, self._calibration, self._remark, quiet_s, self._result)
                return replace(snapshot, took_s=self._stopwatch() - start_s)
        except ImuArrayError as error:
            self._remark = str(error)
            self.close()
        except DAMAGE as error:  # the file changes while it is read: the next refresh opens it again
            self._remark = f"{self.path}: {reason_of(error)}"
            self.close()
        return Snapshot(self.path, WAITING, self._remark)

    def _look(self, now_s: float) -> None:
        """Open the log if it exists, read new rows, continue with the next part."""
        source = self._source
        if source is None or (source.state != WRITTEN and look(source.path) != self._files):
            source = self._open(self._find_log() if source is None else source.path, now_s)
            if source is None:
                return
        is_written = source.state == WRITTEN
        rows = source.read()
        if not rows or source.state != WRITTEN:
            if is_written and source.state != WRITTEN and not is_running(source.path):
                self._files = look(source.path)
            source = self._next_part(source, is_written)
        self._fresh_s = now_s if rows else self._fresh_s
        source.backlog.step({name: window.usual_ns for name, window in source.read_rows.windows.items()})

    def _find_log(self) -> Path:
        """Return the log, or if there is none of that name its newest part that has rows."""
        if self.path.exists() or not self.path.parent.is_dir():
            return self.path
        pattern = re.compile(rf"{re.escape(self.path.stem)}_(\d{{3,}}){re.escape(self.path.suffix)}")
        names = (pattern.fullmatch(entry.name) for entry in self.path.parent.iterdir())
        numbers = sorted(int(name[1]) for name in names if name)
        parts = [part_of(self.path, number) for number in numbers]
        return next((part for part in reversed(parts) if _has_begun(part)), parts[-1] if parts else self.path)

    def _open(self, path: Path, now_s: float) -> LogSource | None:
        """Open a log and start again; None if it does not exist yet."""
        self.close()
        self._fresh_s = now_s
        if not path.exists():
            self._remark = f"{path}: does not exist yet"
            return None
        self._files, self._remark = look(path), ""
        self._source = _source(path, ReadRows(self._span_ns))
        return self._source

    def _next_part(self, source: LogSource, followed: bool) -> LogSource:
        """Return the part in which the log continues. A part that was `followed` while it was written is succeeded by
        the next part even if that is finished; the rows that were read are kept unless a part is skipped.
        """
        parts = _parts_behind(source.path)
        if not parts or not (followed or is_running(parts[-1])):
            return source
        parts = [part for part in parts if _has_begun(part) and _epoch(part) == source.epoch]
        if not parts:
            return source
        goes_on = followed and is_running(parts[0])
        part = parts[0] if goes_on else parts[-1]
        self._files = look(part)
        for name, window in source.read_rows.windows.items():
            window.gaps += source.backlog.gaps(name)
        source.read()  # the rows that were written before the next part began
        turned = _source(part, source.read_rows if goes_on else ReadRows(self._span_ns))
        source.close()
        self._source, self._remark = turned, f"continues in {part.name}"
        turned.read()
        return turned

    def close(self) -> None:
        """Close the files."""
        if self._source is not None:
            self._source.close()
        self._source = None

    def __enter__(self) -> LogMonitor:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _source(path: Path, read_rows: ReadRows) -> LogSource:
    return Growing(path, read_rows) if is_running(path) else Whole(path, read_rows)


def _parts_behind(path: Path) -> list[Path]:
    """Return the existing parts after this one, in order; none if `path` is not a part."""
    match = re.fullmatch(r"(.+)_(\d{3,})", path.stem)
    if match is None:
        return []
    named = (part_of(path.with_stem(match[1]), number) for number in count(int(match[2]) + 1))
    return list(takewhile(Path.exists, named))


def _has_begun(path: Path) -> bool:
    """Return whether a log exists and has rows: the next part is created some seconds before it is needed."""
    if not path.exists():
        return False
    if not is_running(path):
        return True
    with JournalReader(path) as journal:
        return any(journal.groups[record.group].path.startswith("sensors/") for record in journal.records())


def _epoch(path: Path) -> str:
    if is_running(path):
        with JournalReader(path) as journal:
            return journal.preamble.epoch
    whole = Whole(path, ReadRows(0))
    whole.close()
    return whole.epoch


COLOURS: Mapping[str, tuple[str, ...]] = {
    "light": ("#0072B2", "#B94E00", "#007F5C"),
    "dark": ("#56B4E9", "#F0A03C", "#2BD1A0"),
}
"""Colours of x, y and z by theme, after Okabe and Ito's palette for all kinds of colour vision."""

_HEIGHT, _RIGHT = 150, 12
"""Height of a figure and its right margin, in pixels."""


class Theme(NamedTuple):
    """Colours of the figure around the curves."""

    text: str
    grid: str


THEMES: Mapping[str, Theme] = {"light": Theme("#3d4653", "#dfe3e8"), "dark": Theme("#b9c2cf", "#333c48")}


class FigureKind(NamedTuple):
    """The kind of figures that differ only by their data: "trace" over time or "density" over frequency, the names of
    the columns, and the unit.
    """

    plot: str
    columns: tuple[str, ...]
    unit: str

    @property
    def key(self) -> str:
        """The key by which the page requests it."""
        return "|".join((self.plot, ",".join(self.columns), self.unit))


def figures(kinds: Iterable[FigureKind], theme: str, span_s: float) -> dict[str, Any]:
    """Return every kind as a JSON object for BokehJS's `embed_item`, by its key; MissingExtraError without Bokeh."""
    try:
        from bokeh.embed import json_item
    except ModuleNotFoundError:
        raise MissingExtraError("bokeh", "monitor") from None
    return {kind.key: json_item(_figure(kind, theme, span_s)) for kind in kinds}


def _figure(kind: FigureKind, theme: str, span_s: float) -> Any:
    """Return an empty figure; its data source is called "source"."""
    from bokeh.models import BasicTickFormatter, ColumnDataSource, FixedTicker, Range1d
    from bokeh.plotting import figure

    over_time = kind.plot == "trace"
    axis = "t" if over_time else "f"
    axes: dict[str, Any] = {"x_range": Range1d(start=-span_s, end=0)}
    if not over_time:  # the page sets them to whole decades
        axes = {name: Range1d(start=0.1, end=10, name=name[0]) for name in ("x_range", "y_range")}
        axes |= {"x_axis_type": "log", "y_axis_type": "log"}
    plot = figure(height=_HEIGHT, sizing_mode="stretch_width", tools="", toolbar_location=None, **axes)
    plot.min_border_right = _RIGHT
    if not over_time:
        plot.xaxis.ticker = plot.xgrid.ticker = FixedTicker(ticks=_ticks((1, 2, 5)))
        plot.axis.formatter = BasicTickFormatter(use_scientific=False)
        plot.yaxis.ticker = plot.ygrid.ticker = FixedTicker(ticks=_ticks((1, 3)))
    source = ColumnDataSource({name: [] for name in (axis, *kind.columns)}, name="source")
    for name, colour in zip(kind.columns, COLOURS[theme], strict=False):
        plot.line(axis, name, source=source, color=colour, line_width=1.4)
    plot.xaxis.axis_label = "s before the newest row" if over_time else "Hz"
    plot.yaxis.axis_label = kind.unit if over_time else f"{kind.unit}/√Hz"
    _dress(plot, THEMES[theme])
    return plot


def _ticks(steps: tuple[int, ...]) -> list[float]:
    return [step * 10.0**decade for decade in range(-6, 7) for step in steps]


def _dress(plot: Any, theme: Theme) -> None:
    """Draw the surroundings of the curves unobtrusively in the colours of the page."""
    plot.background_fill_alpha = plot.border_fill_alpha = 0.0
    plot.outline_line_color = None
    plot.grid.grid_line_color = theme.grid
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_label_text_color = axis.major_label_text_color = theme.text
        axis.axis_line_color = axis.major_tick_line_color = theme.grid
        axis.minor_tick_line_color = None
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = axis.major_label_text_font_size = "11px"


_XYZ = ("x", "y", "z")


_NICENESS = 10
"""Increase of this process's niceness: if both need the processor, the logger gets ten times this process's share."""


def lower_priority() -> None:
    """Lower the priority of this process, because recording is more important."""
    if hasattr(os, "nice"):  # Windows has none
        with contextlib.suppress(OSError):
            os.nice(_NICENESS)


class SharedSnapshots:
    """Snapshots of one log, shared by all clients; taken in a separate thread, one at a time."""

    def __init__(self, monitor: LogMonitor, every_s: float) -> None:
        self.every_s = every_s
        self._monitor = monitor
        self._thread = ThreadPoolExecutor(1, "snapshot")
        self._lock = asyncio.Lock()
        self._snapshot: Snapshot | None = None
        self._text = b"{}"
        self._is_closed = False
        self._refreshed_s = self.asked_s = float("-inf")

    async def text(self) -> bytes:
        """Return the last snapshot as JSON; a new one if it is older than `every_s` and this is not closed."""
        self.asked_s = time.monotonic()
        async with self._lock:
            if not self._is_closed and time.monotonic() - self._refreshed_s > 0.8 * self.every_s:
                self._refreshed_s = time.monotonic()
                await asyncio.get_running_loop().run_in_executor(self._thread, self._refresh)
        return self._text

    def _refresh(self) -> None:
        self._snapshot = self._monitor.refresh(time.monotonic())
        self._text = json.dumps(drawn(self._snapshot), allow_nan=False, separators=(",", ":")).encode()

    async def figures(self, theme: str) -> dict[str, Any]:
        """Return the figures that this log needs."""
        await self.text()
        views = self._snapshot.sensors if self._snapshot else ()
        shown = {(view.columns, view.unit) for view in views}
        kinds = {FigureKind("trace", columns, unit) for columns, unit in shown}
        kinds |= {
            FigureKind("density", _XYZ, READABLE.get(unit, (1.0, unit))[1])
            for columns, unit in shown
            if columns == _XYZ
        }
        kinds |= {FigureKind("trace", _XYZ, unit) for _, unit in READABLE_SI.values()}
        make = partial(figures, sorted(kinds), theme if theme in THEMES else "light", SPAN_S)
        if self._is_closed:
            return make()
        return await asyncio.get_running_loop().run_in_executor(self._thread, make)

    def close(self) -> None:
        """Take no more snapshots; further requests get the last one."""
        self._is_closed = True
        self._thread.shutdown()
        self._monitor.close()

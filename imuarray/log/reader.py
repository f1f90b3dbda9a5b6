"""Reads a log, finished or not: the file is validated first, then its rows are read lazily, a slice at a time.

A file from an unknown source is checked before anything in it is trusted: it must be a log of a known format, nothing
in it may lead outside it (links, external storage, virtual datasets), and its columns must exist with the right type
and length.

`verify` reads and checks every block: checksums of chunks and commits, chunks that were never written, times.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self
from weakref import WeakValueDictionary

import h5py
import numpy as np

from imuarray.axes import UP_AXES
from imuarray.errors import LogError, LogWarning
from imuarray.log.columns import TRACK_BYTES, ClockTrack, RowCache, Track, clocks_of, track_of
from imuarray.log.format import FORMAT, FORMAT_VERSION, FUSED, SOURCES, Event, Phase, Preamble
from imuarray.log.hdf5_writer import changed_parts
from imuarray.log.import_report import IMPORT_REPORT, ImportReport
from imuarray.log.inspection import UnclosedFile, inspect, is_marked_open
from imuarray.log.interrupted import LiveView, RebuiltFile, is_unfinished, may_be_unfinished, open_interrupted
from imuarray.log.journal import is_running
from imuarray.log.sensor_log import SensorLog
from imuarray.log.untrusted_input import DAMAGE, open_file, plain_value, positive, read_texts
from imuarray.printable import counted
from imuarray.spelling import as_names, guess

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from imuarray.calibrate import Calibration


_OLDEST_NS = 10 * 365 * 86_400 * 1_000_000_000
"""The end of 1979 in ns since 1970: earlier times of an import are not dates, because there were no MEMS sensors."""


class Log:
    """An open log; a context manager. `log["Gyro1"].counts[1000:2000]` reads a thousand rows and no more.

    A log can be pickled; it is stored as its path. The receiving process opens the file for reading once, and all
    copies of the log in that process share the open file: closing one closes them all.
    """

    _cache: RowCache | None = None
    _track_cache: RowCache | None = None

    def __init__(self, path: str | PathLike[str], *, thorough: bool = False, journal_fd: int | None = None) -> None:
        """Open and check `path`; LogError states what is missing or wrong. `thorough` reads the whole of an unfinished
        log and checks every block; `journal_fd` is the open journal of a log that its writer is finishing.
        """
        self.path = Path(path)
        if self.path.is_dir():
            raise LogError(f"{path}: is a folder")
        try:
            self._opened, self._damaged = _open(self.path, thorough, journal_fd)
        except DAMAGE as error:
            raise LogError(f"{path}: damaged or malformed: {' '.join(str(error).split())}") from None
        except LogError as error:  # errors of its parts do not name the log
            if str(error).startswith(str(path)):
                raise
            raise LogError(f"{path}: {error}") from None
        self._cache, self._track_cache = RowCache(), RowCache(TRACK_BYTES)
        try:
            self._check()
            names = [name for name in self._file["sensors"] if not self._is_damaged(f"/sensors/{name}")]
            if not names:
                raise LogError(f"{path}: every sensor in it is damaged")
            self.sensors: Mapping[str, SensorLog] = {
                name: SensorLog(self._file["sensors"][name], f"{path}, sensor {name}", self, _open_shared, self._cache)
                for name in names
            }
            is_plain = isinstance(self._file, h5py.File) and not self._damaged
            self._changed = changed_parts(self._file) if is_plain else []
        except BaseException as error:
            self._opened.close()
            if isinstance(error, DAMAGE):
                raise LogError(f"{path}: damaged or malformed: {' '.join(str(error).split())}") from None
            raise

    def _check(self) -> None:
        attributes = self._file.attrs
        kind = str(plain_value(attributes.get("format")))
        if kind == FUSED:
            raise LogError(f"{self.path}: is a fused result, not a log")
        if kind != FORMAT:
            raise LogError(f"{self.path}: an HDF5 file, but not a log: attribute format is not {FORMAT!r}")
        version = plain_value(attributes.get("format_version"))
        is_same = isinstance(version, np.floating) and version == FORMAT_VERSION  # MATLAB's numbers are floats
        if not is_same and str(version) != str(FORMAT_VERSION):
            raise LogError(f"{self.path}: log format {version}; this software reads format {FORMAT_VERSION}")
        if plain_value(attributes.get("source")) not in SOURCES:
            raise LogError(
                f"{self.path}: attribute source is {attributes.get('source')!r}; allowed are {', '.join(SOURCES)}"
            )
        if not isinstance(self._file.get("sensors"), Mapping | h5py.Group) or len(self._file["sensors"]) == 0:
            raise LogError(f"{self.path}: group sensors is missing or empty")

    @property
    def _file(self) -> h5py.File | LiveView:
        """The open file; LogError if it was closed."""
        if not self.is_open:
            raise LogError(f"{self.path}: the log is closed; read it while it is open")
        return self._opened

    @property
    def preamble(self) -> Preamble | None:
        """The preamble of an unfinished log; None for a finished one."""
        return self._file.preamble if isinstance(self._file, LiveView | RebuiltFile) else None

    @property
    def state(self) -> str:
        """The state "finished", "being written" or "interrupted"; acknowledged rows of unfinished logs can be read."""
        if self.preamble is None:
            return "finished"
        return "being written" if is_running(self.path) else "interrupted"

    @property
    def losses(self) -> tuple[str, ...]:
        """The acknowledged rows of an unfinished log that can no longer be read, and the parts of a finished log that
        were changed, one line each. Reading a damaged row of a finished log raises LogError.
        """
        if isinstance(self._file, LiveView | RebuiltFile):
            return self._file.losses
        if self._damaged:
            return tuple(f"{path} is damaged, and omitted" for path in self._damaged)
        return tuple(f"its {part} differ from what was written: damaged, or changed since" for part in self._changed)

    @property
    def has_journal(self) -> bool:
        """True for an unfinished log with its journal, and for a finished log."""
        return not isinstance(self._file, LiveView) or self._file.has_journal

    @property
    def damaged_commits(self) -> int:
        """The number of damaged commits in the HDF5 file of an unfinished log; their rows come from the journal."""
        return self._file.damaged_commits if isinstance(self._file, LiveView) else 0

    @property
    def is_rebuilt(self) -> bool:
        """True if the HDF5 file of an unfinished log is unusable, and everything comes from its journal."""
        return isinstance(self._file, RebuiltFile)

    @property
    def epoch(self) -> str:
        """ISO 8601 UTC of time 0."""
        return _text(self._file.attrs.get("epoch", ""))

    @property
    def is_dated(self) -> bool:
        """False for an imported log whose source states no wall time: its times count from an unknown instant."""
        if self.source != "imported" or not self.epoch.startswith("1970-01-01T00:00:00"):
            return True
        first_ns = min((int(sensor.time[0]) for sensor in self.sensors.values() if len(sensor)), default=0)
        return first_ns >= _OLDEST_NS

    @property
    def source(self) -> str:
        """The origin of the counts: one of `imuarray.log.format.SOURCES`."""
        return _text(self._file.attrs["source"])

    @property
    def config(self) -> str:
        """The array's TOML text, "" if the log has none."""
        return _text(self._file.attrs.get("config", ""))

    @property
    def software(self) -> str:
        """The software that wrote the log."""
        return _text(self._file.attrs.get("software", ""))

    @property
    def import_report(self) -> ImportReport | None:
        """The report on the import of this log; None if the log has none, or no valid one."""
        return ImportReport.from_json(plain_value(self._file.attrs.get(IMPORT_REPORT)))

    @property
    def import_doubts(self) -> str:
        """A sentence with the number of doubts that the import of this log raised; "" without doubts."""
        report = self.import_report
        if report is None or not report.doubts:
            return ""
        return f"its import raised {counted(len(report.doubts), 'doubt')}: `imuarray info {self.path}` lists them"

    @property
    def frame_rate_hz(self) -> float:
        """The requested frames per second; 0 if the log does not state a valid number."""
        return positive(self._file.attrs.get("frame_rate_hz"))

    def __getitem__(self, name: str) -> SensorLog:
        """Return the sensor of this name; the LogError for an unknown name lists the names that exist."""
        if self._is_damaged(f"/sensors/{name}"):
            raise LogError(f"{self.path}: sensor {name} is damaged; intact are {', '.join(self.sensors)}")
        if name not in self.sensors:
            raise LogError(
                f"{self.path}: no sensor {name!r}; it has {', '.join(self.sensors)}{guess(str(name), self.sensors)}"
            )
        return self.sensors[name]

    def __iter__(self) -> Iterator[str]:
        """The names of the sensors, as a mapping has them: `name in log`, `list(log)`."""
        return iter(self.sensors)

    def of(self, quantity: str, only: Collection[str] = ()) -> list[SensorLog]:
        """Return the sensors that measure `quantity`, `only` these (empty: all)."""
        sensors = [sensor for sensor in self.sensors.values() if sensor.quantity == quantity]
        return [sensor for sensor in sensors if not only or sensor.name in only]

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """Named stretches, in file order."""
        columns = self._columns("phases", ("start", "end", "name", "up"), numbers=2)
        return tuple(Phase(start, end, name, up) for start, end, name, up in zip(*columns, strict=True))

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """The events, in file order."""
        columns = self._columns("events", ("time", "sensor", "kind", "message"), numbers=1)
        return tuple(Event(*row) for row in zip(*columns, strict=True))

    def _columns(self, name: str, columns: tuple[str, ...], numbers: int) -> list[list[Any]]:
        """Return equally long columns: the first `numbers` of them whole numbers, the others text."""
        group = self._group(name)
        if group is None:
            return [[] for _ in columns]
        try:
            values = [[plain_value(value) for value in read_texts(group[column])] for column in columns]
        except DAMAGE:
            raise LogError(f"{self.path}: group {name} is missing one of the columns {', '.join(columns)}") from None
        if len({len(column) for column in values}) != 1:
            raise LogError(f"{self.path}: group {name} has columns of different lengths")
        for index, column in enumerate(values):
            if not all(isinstance(value, int if index < numbers else str) for value in column):
                kind = "whole numbers" if index < numbers else "text"
                raise LogError(f"{self.path}: group {name}: column {columns[index]} does not hold {kind}")
        return values

    def _group(self, name: str) -> Any:
        """Return a group of the file; None if it does not exist; LogError if it is damaged."""
        if self._is_damaged(f"/{name}"):
            raise LogError(f"{self.path}: group {name} is damaged")
        return self._file.get(name)

    def _is_damaged(self, path: str) -> bool:
        """Return whether the object at this path, or one below it, is damaged."""
        return any(bad == path or bad.startswith(f"{path}/") for bad in self._damaged)

    @property
    def truth(self) -> Track | None:
        """The true motion of the box, in a simulated or emulated log."""
        return self._track("truth")

    @property
    def reference(self) -> Track | None:
        """The measurements of a reference instrument, if the log has any."""
        return self._track("reference")

    @property
    def motion_track(self) -> Track | None:
        """The track that describes the motion of the box: the truth, else the reference; None if it has neither a force
        nor a rate, for example a reference of the temperature alone.
        """
        tracks = (track for track in (self.truth, self.reference) if track is not None)
        moving = (track for track in tracks if (track.specific_force, track.angular_rate) != (None, None))
        return next(moving, None)

    @property
    def clocks(self) -> ClockTrack | None:
        """The readings of the machine's clocks."""
        group = self._group("clocks")
        return None if group is None else clocks_of(group, f"{self.path}: group clocks")

    def _track(self, name: str) -> Track | None:
        group = self._group(name)
        return None if group is None else track_of(group, f"{self.path}: group {name}", self._track_cache)

    def keep_rows(self) -> None:
        """Keep the rows that are read from now on in memory, for analyses that read a log several times: all rows of a
        log of up to 64 MB, the last 16 MB of a longer one, none of a log that is being written.
        """
        if self._cache is not None and self._track_cache is not None:
            self._track_cache.use(0)
            columns = [(sensor.time, sensor.counts, sensor.status) for sensor in self.sensors.values()]
            self._cache.use(sum(math.prod(column.shape) * column.dtype.itemsize for part in columns for column in part))

    def to_xarray(self, calibration: Calibration | None = None) -> Any:
        """Return an `xarray.DataTree`: a Dataset for each sensor (`SensorLog.to_xarray`), `truth` and `reference` where
        the log has them. All of it is read. MissingExtraError without xarray (extra "analysis").

        >>> with open_log("run.h5") as log:
        ...     rate = log.to_xarray()["Gyro1"]["angular_rate"]
        >>> rate.dims, rate.attrs["units"], str(rate.time.dtype)
        (('time', 'box_axis'), 'rad s-1', 'datetime64[ns]')
        """
        from imuarray.log.datasets import log_tree

        return log_tree(self, calibration)

    def to_pandas(self, calibration: Calibration | None = None, *, phase: str = "") -> dict[str, Any]:
        """Return a `pandas.DataFrame` for each sensor, by name (`SensorLog.to_pandas`), of all rows or of those of the
        phases named `phase`. MissingExtraError without xarray and pandas (extra "analysis").

        >>> with open_log("run.h5") as log:
        ...     tables = log.to_pandas()
        >>> list(tables["BMA1"].columns)[:4]
        ['specific_force_X', 'specific_force_Y', 'specific_force_Z', 'counts_x']
        """
        return {name: sensor.to_pandas(calibration, phase=phase) for name, sensor in self.sensors.items()}

    def plot(self, sensors: str | Sequence[str] = (), calibration: Calibration | None = None) -> Figure:
        """Return the recording over time, in SI in the box frame: a panel for each sensor, or for those of `sensors`, a
        name or several names. MissingExtraError without matplotlib (extra "report").
        """
        from imuarray.log.datasets import log_figure

        return log_figure([self[name] for name in as_names(sensors) or self.sensors], calibration)

    def __repr__(self) -> str:
        if not self.is_open:
            return f"<Log {self.path}: closed>"
        rows = sum(map(len, self.sensors.values()))
        return f"<Log {self.path}: {self.source}, {self.state}, {len(self.sensors)} sensors, {rows} rows>"

    def _repr_html_(self) -> str:
        """Return a table of the sensors, for notebooks."""
        from imuarray.html_table import html_table

        sensors = self.sensors.values() if self.is_open else ()
        rows = [
            (s.name, s.chip, s.quantity, f"±{s.range:g} {s.unit}" if s.range else "–", s.axes, len(s)) for s in sensors
        ]
        return html_table(repr(self), ("sensor", "chip", "quantity", "range", "axes", "rows"), rows)

    def __reduce__(self) -> tuple[Callable[[Path], Log], tuple[Path]]:
        return _open_shared, (self.path.absolute(),)

    @property
    def is_open(self) -> bool:
        """True if it can be read."""
        return bool(self._opened)

    def close(self) -> None:
        """Close the file; LogError if anything in it is read afterwards."""
        self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _open(path: Path, thorough: bool, journal_fd: int | None) -> tuple[h5py.File | LiveView, list[str]]:
    """Open the file, or the view of a log that is being written or was never finished; also return the paths of what is
    damaged in a finished log.
    """
    if journal_fd is not None or may_be_unfinished(path):
        unfinished = open_interrupted(path, thorough=thorough, journal_fd=journal_fd)
        if unfinished is not None:
            return unfinished, []
    try:
        file = open_file(path)
    except LogError:
        if _is_unclosed_result(path):
            raise LogError(f"{path}: is a fused result, not a log") from None
        raise
    try:
        if not is_unfinished(file):
            return file, inspect(path, file)
    except BaseException:
        file.close()
        raise
    file.close()
    unfinished = open_interrupted(path, thorough=thorough)  # closed properly but not finished, and without a journal
    if unfinished is None:  # it was finished meanwhile
        raise LogError(f"{path}: changed while it was opened; open it again")
    return unfinished, []


def _is_unclosed_result(path: Path) -> bool:
    """Return whether a file is a fused result whose writer is running or was killed."""
    try:
        if not is_marked_open(path):
            return False
        with h5py.File(UnclosedFile(path, check_heaps=False), "r") as file:
            return str(plain_value(file.attrs.get("format"))) == FUSED
    except (*DAMAGE, LogError):
        return False


def open_log(path: str | PathLike[str]) -> Log:
    """Open a log for reading; LogError if it is missing, truncated, of another format, malformed or hostile.

    A log that is being written or was interrupted is read up to the rows that were acknowledged when it was opened
    (`Log.state`); nothing on the disk is changed. A LogWarning states what is damaged or lost (`Log.losses`).

    >>> with open_log("run.h5") as log:
    ...     gyro = log["Gyro1"]
    ...     gyro.counts[:100].shape, str(gyro.counts[:100].dtype), gyro.unit
    ((100, 3), 'int16', 'dps')
    """
    log = Log(path)
    for loss in log.losses:
        warnings.warn(f"{path}: {loss}", LogWarning, stacklevel=2)
    return log


def require_logs(logs: Any, call: str, *, or_paths: bool = False) -> None:
    """Raise LogError if `logs` is not a list or tuple of at least one open log (with `or_paths`, of open logs or
    paths); the message names the `call`, such as `calibrate_tumble(*logs)`.
    """
    if not isinstance(logs, Sequence) or isinstance(logs, str):
        raise LogError(f"{call}: {type(logs).__name__} given; allowed is a list of logs")
    if not logs:
        raise LogError("no log is given; at least one is required")
    for log in logs:
        if not isinstance(log, (Log, str, PathLike) if or_paths else Log):
            allowed = "a path or an open log" if or_paths else "an open log"
            raise LogError(f"{call}: {type(log).__name__} given as a log; allowed is {allowed}")


def require_distinct(logs: Iterable[Log]) -> None:
    """Raise LogError if two of the logs are one file: an analysis would count its readings as independent ones."""
    paths: set[Path] = set()
    for log in logs:
        if (path := log.path.resolve()) in paths:
            raise LogError(f"{log.path}: is given more than once; each log is allowed once")
        paths.add(path)


_SHARED: WeakValueDictionary[Path, Log] = WeakValueDictionary()
"""Logs that were unpickled in this process, by path."""


def _open_shared(path: Path) -> Log:
    """Return the log at a path that was unpickled before, if it is still open; else open it. LogError as `open_log`."""
    log = _SHARED.get(path)
    if log is None or not log.is_open:
        log = _SHARED[path] = open_log(path)
    return log


def _text(value: Any) -> str:
    """Return an attribute as text."""
    return str(plain_value(value))


_ROWS = 1 << 16


class LogVerification(NamedTuple):
    """The result of a verification: `problems` are rows that can't be read or are inconsistent, `remarks` are defects
    that reading corrects.
    """

    state: str
    rows: Mapping[str, int]
    problems: tuple[str, ...]
    remarks: tuple[str, ...]


def verify(path: Path, progress: Callable[[int], None] = lambda rows: None) -> LogVerification:
    """Read all of the log at `path`; `progress` gets the number of rows read. LogError if it can't be opened."""
    with Log(path, thorough=True) as log:
        problems = list(log.losses)
        count = 0
        for sensor in log.sensors.values():
            for block_rows, complaints in _sensor(sensor):
                problems += complaints
                progress(count + block_rows)
            count += len(sensor)
        for name in ("truth", "reference"):
            problems += _stimulus(log, name)
        for name in ("phases", "events", "clocks"):
            try:
                getattr(log, name)
            except LogError as error:
                problems.append(_within(log, error))
        problems += _dates(log)
        rows = {name: len(sensor) for name, sensor in log.sensors.items()}
        return LogVerification(log.state, rows, tuple(problems), tuple(_remarks(log)))


def _sensor(sensor: SensorLog) -> Iterator[tuple[int, list[str]]]:
    """Read all rows of a sensor; yield the number of rows so far and the problems of the last block."""
    columns = {"time": sensor.time, "counts": sensor.counts, "status": sensor.status}
    if sensor.temperature_counts is not None:
        columns["temperature_counts"] = sensor.temperature_counts
    for name in ("temperature", "pressure") if sensor.quantity == "pressure" else ():
        if sensor.has_compensated(name) or sensor.counts.shape[1:] == (2,):  # an imported sensor may lack the column
            columns[name] = sensor.compensated(name)
    place = f"sensor {sensor.name}"
    yield 0, [problem for name, column in columns.items() for problem in _holes(place, name, column)]
    last_ns = None
    for block in sensor.blocks(_ROWS):
        values, problems = _read_block(place, columns, block)
        if "time" in values:
            time = values["time"].astype(np.int64)
            previous = time[:0] if last_ns is None else np.array([last_ns])
            late = np.flatnonzero(np.diff(np.concatenate([previous, time])) <= 0)
            if len(late):
                problems.append(f"{place}: time does not increase after row {block.start + late[0] - len(previous)}")
            last_ns = int(time[-1])
        yield block.stop, problems


def _within(log: Log, error: LogError) -> str:
    """Return the text of an error without the path of the log, which precedes every problem."""
    return str(error).removeprefix(f"{log.path}: ")


def _dates(log: Log) -> Iterator[str]:
    """Yield a problem for an epoch that is not a date, and for each phase that is empty or names no box axis."""
    try:
        datetime.fromisoformat(log.epoch)
    except ValueError:
        yield f"attribute epoch is {log.epoch!r}; a date in ISO 8601 is required, such as 2026-01-31T12:00:00Z"
    with suppress(LogError):  # reported with the columns
        for phase in log.phases:
            place = f"phase {phase.name!r}"
            if phase.end_ns <= phase.start_ns:
                yield f"{place}: its end, {phase.end_ns} ns, is not after its start, {phase.start_ns} ns"
            if phase.up not in ("", *UP_AXES):
                yield f"{place}: up is {phase.up!r}; allowed are {', '.join(UP_AXES)} and an empty text"


def _stimulus(log: Log, name: str) -> list[str]:
    try:
        track = log.truth if name == "truth" else log.reference
    except LogError as error:
        return [_within(log, error)]
    if track is None:
        return []
    columns = {column: dataset for column, dataset in track._asdict().items() if dataset is not None}
    problems = [problem for column, dataset in columns.items() for problem in _holes(name, column, dataset)]
    for start in range(0, len(track.time), _ROWS):
        problems += _read_block(name, columns, slice(start, min(start + _ROWS, len(track.time))))[1]
    return problems


def _read_block(place: str, columns: Mapping[str, Any], block: slice) -> tuple[dict[str, Any], list[str]]:
    """Read a block of all columns that can be read, and return complaints about the others."""
    values, problems = {}, []
    for name, column in columns.items():
        try:
            values[name] = np.asarray(column[block])
        except (LogError, *DAMAGE):
            problems.append(f"{place}: column {name}: rows {block.start} to {block.stop - 1} are damaged")
    return values, problems


def _holes(place: str, name: str, column: Any) -> list[str]:
    """Return a complaint if chunks are missing: HDF5 would return zeros for them without an error."""
    if not hasattr(column, "id") or column.chunks is None:  # not stored, or of a log that is being written
        return []
    try:
        expected = int(
            np.prod([-(-length // chunk) for length, chunk in zip(column.shape, column.chunks, strict=True)])
        )
        missing = expected - int(column.id.get_num_chunks())
    except DAMAGE:
        return [f"{place}: column {name}: its index of chunks is damaged"]
    return [f"{place}: column {name}: {missing} of {expected} chunks were never written"] if missing > 0 else []


def _remarks(log: Log) -> Iterator[str]:
    if log.state == "interrupted":
        complete = "" if log.losses else "; all acknowledged rows are present"
        yield f"it was not finished{complete}: `imuarray recover {log.path}` finishes it"
    if log.damaged_commits:
        yield f"{counted(log.damaged_commits, 'commit')} of its HDF5 file damaged: those rows are read from its journal"
    if log.is_rebuilt:
        yield f"its HDF5 file is {'damaged' if log.path.exists() else 'missing'}: all rows are read from its journal"
    if log.import_doubts:
        yield log.import_doubts

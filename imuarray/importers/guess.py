"""Propose a map of a recording, with doubts as comments, for a person to edit.

The layout is inferred from the text; the meaning of columns from their names and, if these do not help, from their
values: time increases, three columns whose names differ in x, y and z are a triad, gravity is 1 g. The proposal is then
tested by an import (`imuarray.importers.table`), and the doubts in its report become comments.
"""

from __future__ import annotations

import csv
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, takewhile
from math import log as ln
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.errors import ImuArrayError, SourceError
from imuarray.importers import decompress, open_source
from imuarray.importers.cells import WINDOWS_1252
from imuarray.importers.mapping import ISO, NS_PER_UNIT, parse_map
from imuarray.importers.plausibility import report_of, turns_of
from imuarray.importers.resolution import SENSITIVITIES
from imuarray.importers.sources import open_rows, reader_of, texts_in
from imuarray.importers.table import import_table
from imuarray.log import open_log
from imuarray.printable import counted, printable
from imuarray.units import STANDARD_GRAVITY, UNITS_OF

LOOKED_AT_ROWS = 20_000
"""Number of rows from which the columns are inferred."""

_WIDTH = 110
_HEAD_BYTES = 1 << 18
_DELIMITERS = (",", ";", "\t", "|", " ")
_COMMENTS = ("#", "%", "//")
_UNIT_IN_NAME = re.compile(
    r"[\[(]\s*([^\])]*?)\s*[\])]"
    r"|_(ms|us|ns|s|g|mg|m_?s2|mps2|m?dps|deg_?s|m?rad_?s|radps|m?gauss|[mun]T|degC|C|K)$"
)
_SPELLINGS: Mapping[str, str] = {
    "m/s^2": "m/s2", "m/s²": "m/s2", "ms-2": "m/s2", "m.s-2": "m/s2", "mps2": "m/s2", "m s^-2": "m/s2",
    "°/s": "dps", "deg/s": "dps", "º/s": "dps", "rad/sec": "rad/s", "radps": "rad/s", "rad s^-1": "rad/s",
    "ms2": "m/s2", "m_s2": "m/s2", "deg_s": "dps", "degs": "dps", "rad_s": "rad/s", "rads": "rad/s",
    "mrad_s": "mrad/s", "mrads": "mrad/s",
    "µt": "uT", "μt": "uT", "ut": "uT", "mgauss": "mgauss",
    "g": "g", "gs": "gauss", "°c": "degC", "c": "degC", "degc": "degC", "sec": "s", "seconds": "s", "msec": "ms",
    "µs": "us", "usec": "us",
}  # fmt: skip
_QUANTITIES: Sequence[tuple[str, re.Pattern[str]]] = (
    ("magnetic_field", re.compile(r"mag|compass|field|^[mih]\*|^b\*", re.IGNORECASE)),
    ("angular_rate", re.compile(r"gyr|rot|omega|ang|rate|^[gwpr]\*|^r?g\*", re.IGNORECASE)),
    ("specific_force", re.compile(r"acc|force|^l?a\*|^f\*|gravity|lin", re.IGNORECASE)),
)
_QUANTITY_OF_UNIT: Mapping[str, str] = {unit: quantity for quantity, units in UNITS_OF.items() for unit in units}
"""Every unit belongs to one quantity."""
_GRAVITIES = (1.0, STANDARD_GRAVITY, 1000.0, *(2.0**power for power in range(8, 15)))
"""1 g in g, m/s2, mg, and in counts of the usual ranges."""
_NEAR_GRAVITY = 0.15
_NAMES = {"specific_force": "Acc", "angular_rate": "Gyro", "magnetic_field": "Mag"}
_TIME = re.compile(r"time|stamp|millis|micros|elapsed|^t$|^t[_ \[(]|^(ms|us|sec|seconds)$", re.IGNORECASE)
_TEMPERATURE = re.compile(r"temp|^t_?(die|chip|c)$|degc", re.IGNORECASE)
_PRESSURE = re.compile(r"press|baro|^p$", re.IGNORECASE)
_PRESSURES = {"Pa": 1e5, "hPa": 1e3, "kPa": 1e2, "bar": 1.0}
"""Air pressure at sea level in each unit."""
_COUNTS_OF_MAGNETOMETER = 1090.0
"""Counts per gauss of an HMC5883L after power-up (HMC-21), the most common magnetometer."""
_COUNTS_OF_GYROSCOPE = 131.0
_CODES_16 = 1 << 16
_LEAST_MIDDLE = 128.0
_NEAR_MIDDLE = 0.3
"""Least middle of the range of an unsigned converter (8 bits), and the distance of the axes' medians from it: 1 g on an
axis is at most a fourth of the range.
"""
_SAME_SCALE = 0.25
"""Log ratio of these rotations that quick motion can make."""
_NEAR_UNIT = 0.3
"""Greatest log ratio between the rotation of gravity and that by a gyroscope at which a unit explains it."""
_PLAIN = 0.95
"""Share of rows of one width that begin with a number, from which on a text is one table."""

_PART = re.compile(r"(.*)\[\d+\]")
_TRIAD_AND_TIME = 4
"""Maximum number of columns of an array that is one triad, perhaps with its time."""
_COMPUTED = re.compile(r"lin|user|free|grav", re.IGNORECASE)
_QUATERNION = re.compile(r"q(uat)?[._ ]?\*|.*quat.*", re.IGNORECASE)
_WRAPS = (2.0**32, 2.0**24, 2.0**16)


@dataclass
class _Layout:
    """The way in which a text is split into cells."""

    delimiter: str = ","
    decimal: str = "."
    skip_rows: int = 0
    comment: str = "#"
    named: bool = True
    kind_column: int | None = None

    def lines(self) -> list[str]:
        """Return the lines of `[file]`."""
        said = []
        if self.delimiter != ",":
            said.append(f"delimiter = {_quoted(self.delimiter)}")
        if self.decimal != ".":
            said.append('decimal = ","')
        if self.skip_rows:
            said.append(f"skip_rows = {self.skip_rows}")
        if self.comment != "#":
            said.append(f"comment = {_quoted(self.comment)}")
        if self.kind_column is not None:
            said.append(f"kind_column = {self.kind_column}")
        return ["[file]", *said, ""] if said else []


@dataclass
class _Proposal:
    """A map under construction: its lines, remarks and doubts, and the units of columns that are known."""

    layout: _Layout
    time: list[str] = field(default_factory=list)
    items: list[list[str]] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    units: Mapping[str, str] = field(default_factory=dict)

    def text(self, head: Sequence[str]) -> str:
        """Return the map as TOML."""
        comments = [f"# {line}" for line in head]
        for mark, sentences in (("~", self.remarks), ("?", self.doubts)):
            for text in sentences:
                comments += textwrap.wrap(
                    printable(text), _WIDTH, initial_indent=f"# {mark} ", subsequent_indent="#   "
                )
        parts = [*comments, "", *self.layout.lines(), "[time]", *self.time]
        for item in self.items:
            parts += ["", *item]
        return "\n".join(parts) + "\n"


def guess_map(source: str | Path) -> str:
    """Return a map of the recording `source` as TOML text; SourceError if it contains nothing that a map
    can describe.
    """
    path = Path(source)
    proposal = _propose_map(path)
    head = [f"Proposed map of {path.name}: check and correct it, and enter chips, axes and ranges."]
    trial = _try_import(proposal.text([]), path)
    if _correct_scale(proposal, trial.factor) if trial.factor is not None else _correct_quiet_unit(proposal, trial):
        trial = _try_import(proposal.text([]), path)
    proposal.remarks += [text for text in trial.remarks if text not in proposal.remarks]
    proposal.doubts += [text for text in trial.doubts if text not in proposal.doubts]
    return proposal.text(head)


class _Trial(NamedTuple):
    """An import with a proposed map: its remarks, its doubts, and the error factor of the gyroscope's scale (None if
    unknown).
    """

    remarks: list[str]
    doubts: list[str]
    factor: float | None


def _try_import(text: str, path: Path) -> _Trial:
    """Import with this map and return what is said of the recording."""
    with TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "map.toml").write_text(text, encoding="utf-8")
        try:
            summary = import_table(path, place / "map.toml", place / "run.h5")
            with open_log(place / "run.h5") as log:
                report = report_of(log)
                return _Trial([*summary.remarks, *report.quirks], list(report.doubts), turns_of(log))
        except ImuArrayError as error:
            return _Trial([], [f"cannot be imported as it is: {str(error).replace(folder, '').lstrip('/')}"], None)


def _correct_scale(proposal: _Proposal, factor: float) -> bool:
    """Replace the guessed sensitivity of a gyroscope by that of a data sheet, if a known one fits."""
    for item in proposal.items:
        if _is_gyroscope(item) and factor > 0 and _correct_unit(item, factor):
            return True
        line = next((line for line in item if line.startswith("sensitivity") and "# ?" in line), None)
        if line is None or not _is_gyroscope(item) or factor <= 0 or abs(ln(factor)) < _SAME_SCALE:
            continue
        wanted = _COUNTS_OF_GYROSCOPE / factor
        nearest = min(SENSITIVITIES["angular_rate"], key=lambda scale: abs(ln(scale / wanted)))
        if nearest == _COUNTS_OF_GYROSCOPE:
            return False
        item[item.index(line)] = f"sensitivity = {nearest:.6g}   # ? from the rotation of gravity in the accelerometer"
        at = next(number for number, text in enumerate(item) if text.startswith("range"))
        item[at] = f"range = {round(32768 / nearest / 5) * 5}   # ? of 16 bits"
        return True
    return False


def _is_gyroscope(item: Sequence[str]) -> bool:
    return any(line.startswith('quantity = "angular_rate"') for line in item)


def _correct_quiet_unit(proposal: _Proposal, trial: _Trial) -> bool:
    """Replace dps by rad/s, of gyroscopes that would be quieter than any in dps; and the reverse."""
    changed = False
    for item in filter(_is_gyroscope, proposal.items):
        name = item[1].split('"')[1]
        place = next((at for at, line in enumerate(item) if line.startswith("unit") and "# ?" in line), None)
        if place is None or any(line.startswith("sensitivity") for line in item):
            continue
        for wanted, other in (("rad/s", "dps"), ("dps", "rad/s")):
            said = f"the columns may be in {wanted}, not {other}"
            if f'"{other}"' in item[place] and any(
                text.startswith(f"{name}: ") and text.endswith(said) for text in trial.doubts
            ):
                item[place] = f'unit = "{wanted}"   # ? from the noise at rest'
                changed = True
                break
    return changed


def _correct_unit(item: list[str], factor: float) -> bool:
    """Replace the guessed unit of a gyroscope whose values are in a unit by the one that the factor says, if any."""
    place = next((at for at, line in enumerate(item) if line.startswith("unit") and "# ?" in line), None)
    if place is None or any(line.startswith("sensitivity") for line in item):
        return False
    units = UNITS_OF["angular_rate"]
    guessed = item[place].split('"')[1]
    wanted = factor * units[guessed]
    nearest = min(units, key=lambda unit: abs(ln(units[unit] / wanted)))
    if nearest == guessed or units[nearest] == units[guessed] or abs(ln(units[nearest] / wanted)) > _NEAR_UNIT:
        return False
    item[place] = f'unit = "{nearest}"   # ? from the rotation of gravity in the accelerometer'
    return True


def _propose_map(path: Path) -> _Proposal:
    """Propose a map from names and numbers."""
    if path.is_dir() and reader_of(path) is None:
        return _propose_folder(path)
    if reader_of(path) is None:
        layout, names, rows = _read_text(path)
        if layout.kind_column is not None:
            kinds = sorted({row[layout.kind_column] for row in rows})
            proposal = _Proposal(layout, ["column = 1   # ?", 'unit = "ms"   # ?'])
            proposal.doubts.append(
                f"rows of several kinds: {', '.join(kinds)[:100]}; each sensor needs kind and columns"
            )
            force_unit = ""
            described = _formats(path)
            for kind in kinds:
                if kind in described:
                    _propose_described(proposal, kind, described[kind], rows)
                    continue
                of_kind = [row for row in rows if row[layout.kind_column] == kind and len(row) >= 5]
                if of_kind:
                    cells = _columns([row[: len(of_kind[0])] for row in of_kind], layout)
                    if _increases(cells[1]) and not proposal.items:
                        proposal.time = _time_lines([], cells, 1, {}, proposal)
                    force_unit = _propose_kind(proposal, kind, cells, force_unit)
            return proposal
        return _propose_table(_Text(layout, names, rows, path.name.partition(".")[0]))
    map_ = parse_map(_PROBE, "guess")
    source = open_rows(path, path.with_suffix(".guess"), map_, lambda done: None)
    proposal = _Proposal(_Layout())
    for kind, listed in source.names().items():
        columns = []
        for name in listed:
            block = next(
                (block.column(at[0], name) for block, at in source.blocks([name], kind or None, LOOKED_AT_ROWS)), None
            )
            columns.append(np.zeros(0) if block is None else _finite(block.values))
        if reader_of(path) == "bags":
            listed, columns = _with_values(listed, columns)
            partial = _propose(_Layout(), list(listed), columns, {}, units=_ROS_UNITS)
        else:
            partial = _propose(_Layout(), list(listed), columns, {})
        if kind and len(partial.items) == 1:
            _name_by_topic(partial.items[0], kind)
        _add_kind(proposal, kind, partial)
    return proposal


def _add_kind(proposal: _Proposal, kind: str, partial: _Proposal) -> None:
    """Add what is proposed for the rows of a kind ("" if there is one kind)."""
    for item in partial.items:
        if kind:
            item.insert(2, f"kind = {_quoted(kind)}")
        if any(item[1] == other[1] for other in proposal.items):
            alike = sum(other[1].rstrip('"0123456789') == item[1][:-1] for other in proposal.items)
            item[1] = item[1][:-1] + f'{alike + 1}"'
    proposal.time = proposal.time or partial.time
    proposal.items += partial.items
    proposal.doubts += [f"{kind}: {text}" if kind else text for text in partial.doubts]


class _Text(NamedTuple):
    """The layout, the columns' names and some rows of a text, and the name of its file without suffix."""

    layout: _Layout
    names: list[str]
    rows: list[list[str]]
    stem: str


def _propose_table(text: _Text) -> _Proposal:
    """Propose a map of a text with one table, whose rows may be of several instances of a sensor."""
    columns, dates = _columns(text.rows, text.layout), _dates(text.rows)
    instance = _instance_column(text.names, columns)
    if instance is None:
        proposal = _propose(text.layout, text.names, columns, dates, text.stem)
        date = next(iter(dates), None)
        if date is not None and len({row[date] for row in text.rows}) < len(text.rows):
            proposal.time.append("ties = true   # rows with equal times")
        return proposal
    text.layout.kind_column = instance
    proposal = _Proposal(text.layout)
    kinds = [row[instance].strip() for row in text.rows]
    for kind in sorted(set(kinds)):
        chosen = np.array([other == kind for other in kinds])
        partial = _propose(text.layout, text.names, [column[chosen] for column in columns], dates, text.stem)
        _add_kind(proposal, kind, partial)
    return proposal


_INSTANCE = re.compile(r"i|id|imu|instance|(sensor|device|imu|unit)[ _]?(id|no|nr|number|index)?", re.IGNORECASE)
_MOST_INSTANCES = 16
_ALTERNATES = 0.3


def _instance_column(names: Sequence[str], columns: Sequence[Floats]) -> int | None:
    """Return the column that numbers the sensors whose rows alternate; None without one."""
    for index, name in enumerate(names[: len(columns)]):
        values = columns[index]
        if not _INSTANCE.fullmatch(name.strip()) or not len(values) or not np.isfinite(values).all():
            continue
        if 1 < len(np.unique(values)) <= _MOST_INSTANCES and np.mean(np.diff(values) != 0) > _ALTERNATES:
            return index
    return None


def _propose_folder(folder: Path) -> _Proposal:
    """Propose a map of a folder with a text for each sensor."""
    proposal: _Proposal | None = None
    doubts: list[str] = []
    for name, path in texts_in(folder).items():
        try:
            layout, names, rows = _read_text(path)
        except SourceError as error:
            doubts.append(f"left out: {error}")
            continue
        partial = _propose(layout, names, _columns(rows, layout), _dates(rows), name)
        if not partial.items:
            doubts.append(f"left out: {path.name} has no triad, temperature or pressure that is known by its name")
            continue
        proposal = proposal or _Proposal(layout)
        if layout.lines() != proposal.layout.lines():
            doubts.append(f"left out: {path.name} is not split into cells as the other files are")
            continue
        if proposal.time and partial.time[0] != proposal.time[0] and partial.time[0].startswith("column"):
            for item in partial.items:
                item.append("time_" + partial.time[0])
        for item in partial.items:
            if len(partial.items) == 1 and _NAME.fullmatch(name):
                item[1] = f'name = "{name}"'
        _add_kind(proposal, name, partial)
    if proposal is None:
        raise SourceError(f"{folder}: no file in this folder contains readings: {'; '.join(doubts)}")
    proposal.doubts += doubts
    return proposal


def _with_values(names: Sequence[str], columns: Sequence[Floats]) -> tuple[list[str], list[Floats]]:
    """Return the columns that hold a number: an Imu of a gyroscope alone has no acceleration."""
    kept = [(name, values) for name, values in zip(names, columns, strict=True) if np.isfinite(values).any()]
    return [name for name, _ in kept], [values for _, values in kept]


def _name_by_topic(item: list[str], topic: str) -> None:
    """Enter the name that the topic of one sensor of an array says."""
    name = topic.removeprefix(_SENSOR_TOPICS).replace("/", "_")
    if topic.startswith(_SENSOR_TOPICS) and _NAME.fullmatch(name):
        item[1] = f'name = "{name}"'


_SENSOR_TOPICS = "/sensors/"
"""Beginning of the topics that `imuarray export --tool ros2` writes."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
_ROS_UNITS: Mapping[str, str] = {
    "linear_acceleration.x": "m/s2", "angular_velocity.x": "rad/s", "magnetic_field.x": "T",
    "fluid_pressure": "Pa", "temperature": "degC",
}  # fmt: skip
"""Units of the columns of `sensor_msgs` (REP 103), of triads that of their first."""

_PROBE = """
time = { rate_hz = 1 }
sensor = [{ name = "A", chip = "a", quantity = "angular_rate", columns = [0, 1, 2], unit = "dps" }]
"""
"""A dummy map with which binary files are opened."""


def _finite(values: npt.NDArray[np.number] | None) -> Floats:
    return np.zeros(0) if values is None else np.asarray(values, np.float64)


def _read_text(path: Path) -> tuple[_Layout, list[str], list[list[str]]]:
    """Return the layout of a text, its columns' names ([] of a table without a header), and some rows; SourceError."""
    with open_source(path, path.with_suffix(".guess")) as file:
        data = decompress(file).read(_HEAD_BYTES)
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    whole = data.decode(encoding, WINDOWS_1252).split("\n")
    whole = whole[:-1] if len(data) == _HEAD_BYTES else whole
    lines = [(number, line.strip("\r\0 ")) for number, line in enumerate(whole)]
    lines = [(number, line) for number, line in lines if line and "\0" not in line]
    comment = next((mark for mark in _COMMENTS if any(line.startswith(mark) for _, line in lines)), "#")
    remarks = [(number, line.removeprefix(comment)) for number, line in lines if line.startswith(comment)]
    lines = [(number, line) for number, line in lines if not line.startswith(comment)]
    if not lines:
        raise SourceError(f"{path}: contains no line of text that could be a row")
    layout = _Layout(comment=comment)
    tail = [line for _, line in lines[len(lines) // 2 :]][:200]
    layout.delimiter = max(_DELIMITERS, key=lambda mark: _fitness(tail, mark))
    rows = [(number, _cells(line, layout.delimiter)) for number, line in lines]
    if layout.delimiter != "," and sum(cell.count(",") for _, row in rows[-20:] for cell in row) >= len(rows[-20:]):
        layout.decimal = ","
    numeric = [sum(_is_number(cell, layout) for cell in row) >= max(1, len(row) // 2) for _, row in rows]
    if not any(numeric):
        raise SourceError(f"{path}: no row of numbers in its first {len(whole)} lines")
    first = _first_of_table(rows, numeric, layout)
    is_plain = first is not None
    first = numeric.index(True) if first is None else first
    widths = {len(row) for _, row in rows[first:]}
    starts = {row[0] for _, row in rows[first:] if row and not _is_number(row[0], layout)}
    heads = [row[0] for _, row in rows[first:] if row]
    worded = sum(head in starts for head in heads)
    changes = sum(a != b for a, b in pairwise(heads))
    alternate = worded > 0.9 * len(heads) and changes > 0.1 * len(heads)
    if not is_plain and (len(widths) > 1 or alternate) and 1 < len(starts) < 20:
        layout.kind_column, layout.named = 0, False
        return layout, [], [row for _, row in rows[first:]]
    width = len(rows[first][1])
    before = [(number, _cells(line, layout.delimiter)) for number, line in remarks if number < rows[first][0]]
    commented = before[-1] if before and len(before[-1][1]) == width else None
    header = rows[first - 1] if first else commented
    layout.named = header is not None and abs(len(header[1]) - width) <= 1
    begin = header[0] if header is not None and layout.named else rows[first][0]
    layout.skip_rows = begin if any(line and not line.startswith(comment) for line in whole[:begin]) else 0
    names = [name.strip() for name in header[1]] if header is not None and layout.named else []
    body = [row for _, row in rows[first:] if len(row) >= min(width, len(names) or width)]
    return layout, names, body[:LOOKED_AT_ROWS]


def _first_of_table(rows: Sequence[tuple[int, list[str]]], numeric: Sequence[bool], layout: _Layout) -> int | None:
    """Return the first row of a table of numbers below a preamble of other widths; None if the rows below are of
    several widths or begin with words, so that they may be of several kinds.
    """
    tail = [row for _, row in rows[len(rows) // 2 :]]
    widths = [len(row) for row in tail]
    usual = max(set(widths), key=widths.count)
    if widths.count(usual) < _PLAIN * len(tail):
        return None
    if sum(_is_number(row[0], layout) for row in tail if row) < _PLAIN * len(tail):
        return None
    return next((at for at, (_, row) in enumerate(rows) if numeric[at] and len(row) == usual), None)


def _fitness(lines: Sequence[str], delimiter: str) -> float:
    """Rate how well a delimiter splits the lines into equal numbers of numeric cells."""
    rows = [_cells(line, delimiter) for line in lines]
    widths = [len(row) for row in rows]
    usual = max(set(widths), key=widths.count)
    layout = _Layout(delimiter, "," if delimiter != "," else ".")
    good = sum(_is_number(cell, layout) or _is_number(cell, _Layout(delimiter)) for row in rows for cell in row)
    return (widths.count(usual) / len(rows)) * (usual > 1) * good / max(1, sum(widths)) * min(usual, 20)


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; [] of one that is no text."""
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []


def _is_number(cell: str, layout: _Layout) -> bool:
    text = cell.strip().replace(",", ".") if layout.decimal == "," else cell.strip()
    try:
        float(text)
    except ValueError:
        return not text
    return True


def _columns(rows: Sequence[Sequence[str]], layout: _Layout) -> list[Floats]:
    """Return the numbers of each column, nan for other cells."""
    width = min(len(row) for row in rows)
    columns = []
    for index in range(width):
        texts = (row[index].strip() for row in rows)
        texts = (text.replace(",", ".") for text in texts) if layout.decimal == "," else texts
        columns.append(np.array([float(text) if _is_number(text, _Layout()) and text else np.nan for text in texts]))
    return columns


_DATES: Sequence[tuple[str, str]] = (
    (r"\d{4}-\d\d-\d\d[T ]\d\d:", ISO),
    (r"\d{1,2}\.\d{1,2}\.\d{4} \d\d?:\d\d:\d\d", "%d.%m.%Y %H:%M:%S.%f"),
    (r"\d{4}/\d\d?/\d\d? \d\d?:\d\d:\d\d", "%Y/%m/%d %H:%M:%S.%f"),
    (r"(1[3-9]|2\d|3[01])/\d\d?/\d{4} \d\d?:\d\d:\d\d", "%d/%m/%Y %H:%M:%S.%f"),
    (r"\d\d?/\d\d?/\d{4} \d\d?:\d\d:\d\d", "%m/%d/%Y %H:%M:%S.%f"),
    (r"\d{8}T\d{6}", "%Y%m%dT%H%M%S.%f"),
    (r"\d\d?:\d\d:\d\d", "%H:%M:%S.%f"),
)
"""How dates and times are written, and the unit that a map states for them."""


def _dates(rows: Sequence[Sequence[str]]) -> dict[int, str]:
    """Return the columns of dates and times, and the unit of each."""
    dates = {}
    for index, cell in enumerate(rows[0]):
        text = cell.strip()
        unit = next((unit for pattern, unit in _DATES if re.match(pattern, text)), None)
        if unit is not None:
            twelve = text[-2:].upper() in ("AM", "PM")
            dates[index] = unit.replace("%H", "%I").replace(".%f", " %p") if twelve else unit
    return dates


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t") + '"'


def _unit_in(name: str) -> str:
    """Return the unit in a column's name; "" without one."""
    texts = [match[1] or match[2] or "" for match in _UNIT_IN_NAME.finditer(name)]
    units = [_SPELLINGS.get(text.lower(), text) for text in texts]
    return next((unit for unit in units if unit and not unit.isdigit()), "")


def _without_padding(columns: Sequence[Floats]) -> list[Floats]:
    """Remove the rows of zeros at the end, which a program reserved and did not fill."""
    if not columns or len({len(column) for column in columns}) > 1 or not len(columns[0]):
        return list(columns)
    filled = np.flatnonzero(np.any([column != 0 for column in columns], axis=0))
    return [column[: int(filled[-1]) + 1] if len(filled) else column for column in columns]


def _propose(
    layout: _Layout,
    names: list[str],
    columns: Sequence[Floats],
    dates: Mapping[int, str],
    stem: str = "",
    units: Mapping[str, str] = MappingProxyType({}),
) -> _Proposal:
    """Propose a map of a table whose columns may have names; `units` of those whose unit is known."""
    proposal = _Proposal(layout, units=units)
    if names and any(names.count(name) > 1 for name in names):
        proposal.doubts.append("some columns have the same name and cannot be distinguished by it")
    columns = _without_padding(columns)
    time = _time_index(names, columns, dates)
    taken = set() if time is None else {time}
    triads = _with_quantity(list(_triads(names, columns, taken, stem)), names, proposal)
    triads.sort(key=lambda triad: triad[0] != "specific_force")
    if time is None:
        proposal.time.append("rate_hz = 100   # ? no column increases like time")
        proposal.doubts.append("no column increases like time: 100 rows a second are assumed")
    else:
        proposal.time += _time_lines(names, columns, time, dates, proposal)
    force_unit = ""
    for quantity, indices in triads:
        item, unit = _sensor(quantity, names, columns, indices, force_unit, proposal)
        force_unit = unit if quantity == "specific_force" else force_unit
        _add_own_time(item, names, columns, indices[0], (time, dates), proposal)
        proposal.items.append(item)
        taken |= set(indices)
    others = any(_TEMPERATURE.search(name) or _PRESSURE.search(name) for name in names)
    if not triads and not others:
        proposal.doubts.append(
            "no three columns whose names differ only in x, y and z, or in 0, 1 and 2: which form a triad?"
        )
    for index, name in enumerate(names):
        if index in taken or index >= len(columns):
            continue
        if _TEMPERATURE.search(name):
            _propose_thermometer(proposal, name, columns[index])
        elif _PRESSURE.search(name):
            _propose_barometer(proposal, name, columns[index])
    return proposal


def _add_own_time(
    item: list[str],
    names: Sequence[str],
    columns: Sequence[Floats],
    first: int,
    time: tuple[int | None, Mapping[int, str]],
    proposal: _Proposal,
) -> None:
    """Add the time column of a sensor to its lines, if it is not that of the table, `time`, which may be a date."""
    own = _own_time(names[first], names, columns, time[0]) if names else None
    if own is None:
        return
    label = _quoted(names[own])
    units = [
        _unit_of_time(_unit_in(names[index]), columns[index][np.isfinite(columns[index])])[0]
        for index in (own, time[0])
        if index is not None and index not in time[1]
    ]
    if len(units) == 2 and units[0] == units[1]:
        item.append(f"time_column = {label}   # ? by its name")
    else:
        whose = item[1].split('"')[1]
        proposal.doubts.append(
            f"column {label} seems to be the time of {whose}; as time_column it needs the unit of [time]"
        )


def _formats(path: Path) -> dict[str, list[str]]:
    """Return the columns' names of each kind of rows, as the FMT rows of an ArduPilot log say them."""
    with open_source(path, path.with_suffix(".guess")) as file:
        lines = decompress(file).read(_HEAD_BYTES).decode("utf-8", WINDOWS_1252).splitlines()
    rows = [_cells(line, ",") for line in lines if line.startswith("FMT,")]
    return {row[3]: row[5:] for row in rows if len(row) > 5 and row[3] != "FMT"}


def _propose_described(proposal: _Proposal, kind: str, names: list[str], rows: Sequence[Sequence[str]]) -> None:
    """Propose the sensors of a kind of rows whose columns after that of the kind have names."""
    layout = proposal.layout
    cells = _columns([row[1 : len(names) + 1] for row in rows if row[0] == kind and len(row) > len(names)], layout)
    if not cells or len(cells[0]) < 2:
        return
    partial = _propose(layout, names, cells, {})
    if not partial.items:
        return
    for lines in (*partial.items, partial.time):
        for place, line in enumerate(lines):
            if re.match(r"\w*columns? = ", line):
                lines[place] = re.sub(r'"([^"]*)"', lambda name: str(names.index(name[1]) + 1), line)
    if (instance := _instance_column(names, cells)) is not None:
        proposal.doubts.append(
            f"rows {kind} are of several sensors, which column {names[instance]} numbers: keep those of one in a file"
        )
    if not proposal.items:
        proposal.time = partial.time
    _add_kind(proposal, kind, partial)


def _propose_kind(proposal: _Proposal, kind: str, columns: Sequence[Floats], force_unit: str) -> str:
    """Propose the sensor of a kind of rows: time, and the three columns after it. Return "m/s2" once a sensor of this
    table has that unit, else "".
    """
    quantity = next((what for what, words in _QUANTITIES if words.search(kind)), "specific_force")
    item, unit = _sensor(quantity, [], columns, (2, 3, 4), force_unit, proposal)
    number = sum(other[1].startswith(f'name = "{_NAMES[quantity]}') for other in proposal.items)
    item[1] = f'name = "{_NAMES[quantity]}{number + 1 if number else ""}"'
    item.insert(2, f"kind = {_quoted(kind)}")
    proposal.items.append(item)
    return "m/s2" if unit == "m/s2" else force_unit


def _time_index(names: Sequence[str], columns: Sequence[Floats], dates: Mapping[int, str]) -> int | None:
    """Return the column of time: named so, and increasing (a counter may wrap, rows may be out of order)."""
    if dates:
        return min(dates)
    increasing = [index for index, values in enumerate(columns) if _increases(values)]
    called = [index for index in range(min(len(names), len(columns))) if _TIME.search(names[index])]
    ordered = [index for index in called if index in increasing]
    shuffled = [index for index in called if len(np.unique(columns[index])) > len(columns[index]) / 2]
    return next(iter([*ordered, *shuffled, *increasing]), None)


def _own_time(name: str, names: Sequence[str], columns: Sequence[Floats], time: int | None) -> int | None:
    """Return the time column that has the beginning of its name in common with a sensor's column; None if that of the
    whole table, `time`, fits as well or there is none.
    """

    def common(index: int) -> int:
        same = takewhile(lambda pair: pair[0] == pair[1], zip(names[index].lower(), name.lower(), strict=False))
        return sum(1 for _ in same)

    fitting = [
        index
        for index in range(min(len(names), len(columns)))
        if index != time
        and _TIME.search(names[index])
        and common(index) >= _OWN_PREFIX
        and _increases(columns[index][np.isfinite(columns[index])])
    ]
    best = max(fitting, key=common, default=None)
    return None if best is None or (time is not None and common(time) >= common(best)) else best


_OWN_PREFIX = 2


def _increases(values: Floats) -> bool:
    steps = np.diff(values)
    return len(steps) > 1 and bool(np.isfinite(steps).all()) and float(np.mean(steps < 0)) < 1e-2 and steps.max() > 0


def _time_lines(
    names: Sequence[str],
    columns: Sequence[Floats],
    index: int,
    dates: Mapping[int, str],
    proposal: _Proposal,
) -> list[str]:
    label = names[index] if names else index
    lines = [f"column = {_quoted(names[index]) if names else index}"]
    if index in dates:
        month = "   # ? the month may come after the day: %d/%m" if dates[index].startswith("%m/") else ""
        return [*lines, f"unit = {_quoted(dates[index])}{month}"]
    if index < len(names) and names[index].lower() == "sampletimefine":
        return [*lines, 'unit = "us"', "ticks = 100   # of Xsens: a clock of 10 kHz", "wraps_at = 4294967296"]
    steps = np.diff(columns[index])
    said = _unit_in(names[index]) if index < len(names) else ""
    unit, step = _unit_of_time(said, columns[index])
    factor = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    mark = "" if said == unit else "   # ?"
    lines.append(f'unit = "{unit}"{mark or "   #"} {1 / max(step * factor, 1e-12):.4g} rows a second, if so')
    if (steps < 0).any():
        most = float(columns[index].max())
        wraps = [period for period in _WRAPS if 0.9 * period < most <= period]
        if wraps:
            lines.append(f"wraps_at = {wraps[0]:.0f}")
        else:
            times = counted(int(np.count_nonzero(steps < 0)), "time")
            proposal.doubts.append(
                f"column {label!r} decreases {times}: rows out of order, which must be sorted; a wrapping counter"
                " (wraps_at); or several recordings, which must be imported separately"
            )
    if (steps == 0).any():
        lines.append("ties = true   # rows with equal times")
    return lines


def _unit_of_time(said: str, values: Floats) -> tuple[str, float]:
    """Return the unit of times, as their column's name says it or by their step, and the step."""
    steps = np.diff(values)
    step = float((values[-1] - values[0]) / len(steps))
    if (steps < 0).any():
        step = float(np.median(np.diff(np.unique(values))))
    if said in NS_PER_UNIT:
        return said, step
    return next((unit for unit, most in (("s", 0.2), ("ms", 200.0), ("us", 2e5)) if step < most), "ns"), step


def _triads(
    names: Sequence[str], columns: Sequence[Floats], taken: set[int], stem_of_file: str
) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield quantity ("" if neither name nor unit says it) and columns of each triad."""
    if not names:
        free = [index for index in range(len(columns)) if index not in taken]
        yield from _nameless(columns, free)
        return
    used: set[int] = set()
    for prefix in dict.fromkeys(match[1] for name in names if (match := _PART.fullmatch(name))):
        parts = [index for index, name in enumerate(names) if (match := _PART.fullmatch(name)) and match[1] == prefix]
        if len(parts) > _TRIAD_AND_TIME:
            yield from _nameless(columns, [index for index in parts if index not in taken])
            used.update(parts)
    for axes in ("xyz", "XYZ", "012", "123"):
        for index, name in enumerate(names):
            for place in (at for at, letter in enumerate(name) if letter == axes[0]):
                stems = [name[:place] + letter + name[place + 1 :] for letter in axes]
                if index in used or not all(stem in names for stem in stems):
                    continue
                indices = (names.index(stems[0]), names.index(stems[1]), names.index(stems[2]))
                if used.intersection(indices) or taken.intersection(indices):
                    continue
                used.update(indices)
                stem = name[:place] + "*" + name[place + 1 :]
                if _QUATERNION.fullmatch(stem):
                    continue
                called = stem if stem.strip("*_.- []()") else stem_of_file
                by_name = next((what for what, words in _QUANTITIES if words.search(called)), "")
                yield _QUANTITY_OF_UNIT.get(_unit_in(name), by_name), indices


def _with_quantity(
    triads: list[tuple[str, tuple[int, int, int]]], names: Sequence[str], proposal: _Proposal
) -> list[tuple[str, tuple[int, int, int]]]:
    """Return the triads whose quantity is known; if none is, all are taken for specific forces."""

    def first_name(triad: tuple[str, tuple[int, int, int]]) -> str:
        return names[triad[1][0]] if names else f"column {triad[1][0] + 1}"

    computed = [triad for triad in triads if triad[0] == "specific_force" and _COMPUTED.search(first_name(triad))]
    if computed and any(triad[0] == "specific_force" and triad not in computed for triad in triads):
        listed = ", ".join(map(first_name, computed))
        proposal.doubts.append(
            f"left out, by their names software computed them (acceleration without gravity, or gravity): {listed}, and"
            " the next two of each"
        )
        triads = [triad for triad in triads if triad not in computed]
    known = [triad for triad in triads if triad[0]]
    if not known:
        return [("specific_force", indices) for _, indices in triads]
    others = [first_name(triad) for triad in triads if not triad[0]]
    if others:
        proposal.doubts.append(f"left out, their names say no quantity: {', '.join(others)}, and the next two of each")
    return known


def _nameless(columns: Sequence[Floats], free: Sequence[int]) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield consecutive threes of columns; the magnitude of specific force is constant under rotation, so the first is
    taken for a force.
    """
    triads = [(free[start], free[start + 1], free[start + 2]) for start in range(0, len(free) - 2, 3)][:3]
    order = ["specific_force", "angular_rate", "magnetic_field"]
    if len(triads) > 1 and [_is_gravity(columns, triad) for triad in triads[:2]] == [False, True]:
        order[:2] = ["angular_rate", "specific_force"]
    yield from zip(order, triads, strict=False)


def _is_gravity(columns: Sequence[Floats], triad: tuple[int, int, int]) -> bool:
    """Return whether the median length of a triad is 1 g in some unit."""
    length = float(np.nanmedian(np.sqrt(sum(columns[index] ** 2 for index in triad))))
    return any(abs(length / gravity - 1) < _NEAR_GRAVITY for gravity in _GRAVITIES)


def _sensor(
    quantity: str,
    names: Sequence[str],
    columns: Sequence[Floats],
    indices: tuple[int, int, int],
    force_unit: str,
    proposal: _Proposal,
) -> tuple[list[str], str]:
    """Return the lines of a sensor, and the chosen unit."""
    values = np.stack([columns[index][: min(map(len, columns))] for index in indices], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    length = float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0
    said = proposal.units.get(names[indices[0]]) or _unit_in(names[indices[0]]) if names else ""
    whole = bool(len(values)) and bool((values == np.rint(values)).all()) and length > 5
    codes: list[str] = []
    largest = _CODES_16 / 2
    if whole:
        values, codes, largest = _signed(values)
        length = float(np.median(np.linalg.norm(values, axis=1)))
    listed = ", ".join(_quoted(names[index]) if names else str(index) for index in indices)
    name = _NAMES[quantity]
    number = sum(item[1].startswith(f'name = "{name}') for item in proposal.items)
    item = [
        "[[sensor]]",
        f'name = "{name}{number + 1 if number else ""}"',
        'chip = "unknown"   # ?',
        f'quantity = "{quantity}"' if names else f'quantity = "{quantity}"   # ? the columns have no names',
        f"columns = [{listed}]",
    ]
    if said in UNITS_OF[quantity]:  # type: ignore[index]
        return [*item, f'unit = "{said}"'], said
    unit, lines = _counted(quantity, length, largest) if whole else _measured(quantity, length, force_unit)
    return [*item, *codes, *lines], unit


def _signed(values: Floats) -> tuple[Floats, list[str], float]:
    """Return codes (n, 3) as signed ones, the lines that say how, and the largest code that is then possible."""
    if values.min() < 0 or values.max() >= _CODES_16:
        return values, [], _CODES_16 / 2
    medians = np.median(values, axis=0)
    middle = 2.0 ** np.rint(np.log2(max(float(np.median(medians)), 1.0)))
    if _LEAST_MIDDLE <= middle < _CODES_16 / 2 and (np.abs(medians / middle - 1) < _NEAR_MIDDLE).all():
        return values - middle, [f"offset = {middle:g}   # ? no code is negative, and all axes are near it"], middle
    if values.max() < _CODES_16 / 2:
        return values, [], _CODES_16 / 2
    outer = (values < _CODES_16 / 4) | (values >= _CODES_16 * 3 / 4)
    if float(np.mean(outer)) > 0.5:
        return (
            np.where(values >= _CODES_16 / 2, values - _CODES_16, values),
            ["bits = 16   # ? none is negative"],
            _CODES_16 / 2,
        )
    return values - _CODES_16 / 2, [f"offset = {_CODES_16 // 2}   # ? none is negative"], _CODES_16 / 2


def _counted(quantity: str, length: float, largest: float) -> tuple[str, list[str]]:
    """Return unit and scale of columns of integers up to `largest`."""
    bits = f"of {round(ln(2 * largest) / ln(2))} bits"
    if quantity == "specific_force":
        per_g = 2.0 ** round(ln(length) / ln(2))
        if abs(ln(length / per_g)) > _NEAR_GRAVITY:
            per_g = float(f"{length:.2g}")
        return "g", [
            'unit = "g"',
            f"range = {largest / per_g:g}   # ? {bits}",
            f"sensitivity = {per_g:g}   # ? from gravity: {length:.5g} counts",
        ]
    if quantity == "angular_rate":
        known = ", ".join(f"{131 / (1 << power):.4g} ({250 << power} dps)" for power in range(4))
        return "dps", [
            'unit = "dps"',
            "range = 250   # ?",
            f"sensitivity = {_COUNTS_OF_GYROSCOPE:g}   # ? not determined at rest; common are {known}",
        ]
    return "gauss", [
        'unit = "gauss"',
        "range = 1.3   # ?",
        f"sensitivity = {_COUNTS_OF_MAGNETOMETER:g}   # ? {length:.4g} counts for the earth's 0.2 to 0.7 gauss",
    ]


def _measured(quantity: str, length: float, force_unit: str) -> tuple[str, list[str]]:
    """Return the unit of columns of physical values."""
    if quantity == "angular_rate":
        unit = "rad/s" if force_unit == "m/s2" else "dps"
        return unit, [f'unit = "{unit}"   # ? dps or rad/s: the import report compares rotations, if there are any']
    if quantity == "specific_force":
        sizes = {"g": 1.0, "m/s2": STANDARD_GRAVITY, "mg": 1000.0}
    else:
        sizes = {"gauss": 0.45, "uT": 45.0, "mgauss": 450.0, "T": 4.5e-5, "nT": 4.5e4}
    unit = min(sizes, key=lambda scale: abs(ln(max(length, 1e-12) / sizes[scale])))
    return unit, [f'unit = "{unit}"   # ? from the size of the values: {length:.4g}']


def _propose_thermometer(proposal: _Proposal, name: str, values: Floats) -> None:
    """Propose a column of temperatures: in degrees, or as counts with unknown scale."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return
    unit = proposal.units.get(name)
    if not unit and known.min() > 200 and known.max() < 420 and (known != np.rint(known)).any():
        unit = "K"
    if unit or (known.min() > -60 and known.max() < 150 and (known != np.rint(known)).any()):
        number = sum(item[0] == "[[thermometer]]" for item in proposal.items)
        called = f"Thermometer{number + 1 if number else ''}"
        proposal.items.append(
            [
                "[[thermometer]]",
                f'name = "{called}"',
                f"column = {_quoted(name)}",
                f'unit = "{unit}"' if unit else 'unit = "degC"   # ? from the size of the values',
            ]
        )
        return
    span = f"{known.min():g} to {known.max():g}"
    proposal.doubts.append(
        f"column {name!r} may be a chip's thermometer ({span} counts): set temperature_column ="
        f" {_quoted(name)} and thermometer = {{ zero_degc, lsb_per_degc }} of its sensor from its data sheet"
    )


def _propose_barometer(proposal: _Proposal, name: str, values: Floats) -> None:
    """Propose a column of air pressures, if they are such in some unit."""
    known = values[np.isfinite(values)]
    middle = float(np.median(known)) if len(known) else 0.0
    near = next((unit for unit, sea_level in _PRESSURES.items() if 0.2 < middle / sea_level < 1.2), None)
    unit = proposal.units.get(name, near)
    if unit is None:
        proposal.doubts.append(
            f"column {name!r}: no air pressure in {', '.join(_PRESSURES)} has its size, {middle:.4g}"
        )
        return
    number = sum(item[0] == "[[barometer]]" for item in proposal.items)
    proposal.items.append(
        [
            "[[barometer]]",
            f'name = "Barometer{number + 1 if number else ""}"',
            f"column = {_quoted(name)}",
            f'unit = "{unit}"'
            + ("" if name in proposal.units else f"   # ? from the size of the values: {middle:.6g}"),
        ]
    )

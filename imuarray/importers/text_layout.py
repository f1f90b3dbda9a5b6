"""Layout of a recording's text, by which it is split into cells: delimiter, decimal mark, header, comments, kinds of
rows, dates.

Everything is inferred from the first rows of the text.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import SourceError
from imuarray.importers import decompress, open_source
from imuarray.importers.cells import (
    WINDOWS_1252,
    header_text,
    is_rule,
    is_unit_row,
    is_utf16,
    number_of,
    plain_line,
    plain_sentence,
    split_labels,
)
from imuarray.importers.mapping import ISO
from imuarray.importers.plausibility import RATES_HZ
from imuarray.printable import counted

LOOKED_AT_ROWS = 20_000
"""Number of rows from which the columns are inferred."""
_HEAD_BYTES = 1 << 20
_DELIMITERS = (",", ";", "\t", "|", " ")
_COMMENTS = ("#", "%", "//")
_PLAIN = 0.95
"""Least share of rows that have one width and begin with a number in a text with a single table."""


@dataclass
class TextLayout:
    """The layout of a text: the settings by which it is split into cells."""

    delimiter: str = ","
    decimal: str = "."
    skip_rows: int = 0
    comment: str = "#"
    named: bool = True
    kind_column: int | list[int] | None = None
    labels: bool = False
    parts: list[list[str]] = field(default_factory=list)
    """Names of files that are parts of one recording."""
    unit_cells: tuple[str, ...] = ()
    """Cells of a row of units below the header."""
    rate_hz: float | None = None
    """The rate of the rows as stated in the lines above the table."""
    rate_source: str = ""
    """The line that states it."""
    day_column: int | None = None
    """The column of dates without a time of day, if there is one."""
    day_format: str = ""
    """Its format, in the notation of `datetime.strptime`."""

    def lines(self) -> list[str]:
        """Return the lines of `[file]`."""
        groups = (f"[{', '.join(map(quote, group))}]" for group in self.parts)
        entries = (
            (self.delimiter != ",", f"delimiter = {quote(self.delimiter)}"),
            (self.decimal != ".", 'decimal = ","'),
            (self.skip_rows > 0, f"skip_rows = {self.skip_rows}"),
            (self.comment != "#", f"comment = {quote(self.comment)}"),
            (self.kind_column is not None, f"kind_column = {self.kind_column}"),
            (self.labels, "labels = true"),
            (bool(self.parts), f"parts = [{', '.join(groups)}]"),
        )
        lines = [line for is_stated, line in entries if is_stated]
        return ["[file]", *lines, ""] if lines else []


_Row = tuple[int, list[str]]
"""The number of a line, counted from 0, and its cells."""


def read_text(path: Path) -> tuple[TextLayout, list[str], list[list[str]]]:
    """Return the layout of a text, its columns' names ([] for a table without a header), and some rows; SourceError."""
    whole = _first_lines(path)
    lines = [(number, plain_sentence(line.strip("\r\0 "))) for number, line in enumerate(whole)]
    lines = [(number, line) for number, line in lines if line and "\0" not in line and not is_rule(line)]
    comment = next((mark for mark in _COMMENTS if any(line.startswith(mark) for _, line in lines)), "#")
    remarks = [(number, line.removeprefix(comment)) for number, line in lines if line.startswith(comment)]
    lines = [(number, line) for number, line in lines if not line.startswith(comment)]
    if not lines:
        raise SourceError(f"{path}: contains no line of text that could be a row")
    layout = TextLayout(comment=comment)
    tail = [plain_line(line, "\0").split("\0")[-1] for _, line in lines[len(lines) // 2 :]][:200]
    mark = max(_DELIMITERS, key=lambda mark: _labelled_share(tail, mark))
    if _labelled_share(tail, mark) > _MOSTLY:
        layout.delimiter, layout.labels, layout.kind_column, layout.named = mark, True, 0, False
        cells = [split_labels(split_cells(plain_line(line, mark), mark)) for _, line in lines]
        return layout, [], [row for row in cells if row]
    layout.delimiter = mark = max(_DELIMITERS, key=lambda mark: _fitness(tail, mark))
    rows = _pad([(number, split_cells(plain_line(line, mark), mark)) for number, line in lines])
    if mark != "," and sum(cell.count(",") for _, row in rows[-20:] for cell in row) >= len(rows[-20:]):
        layout.decimal = ","
    numeric = [_is_of_numbers(row, layout) for _, row in rows]
    if not any(numeric):
        raise SourceError(f"{path}: no row of numbers in its first {counted(len(whole), 'line')}")
    first = _first_of_table(rows, numeric, layout)
    begin = numeric.index(True) if first is None else first
    is_described = any(line.startswith("FMT,") for _, line in lines)
    if is_described or (first is None and _are_of_kinds([row for _, row in rows[begin:]], layout)):
        layout.kind_column, layout.named = 0, False
        return layout, [], [row for _, row in rows[begin:]]
    if (stated := _rate_in_cells(rows)) is not None:
        layout.skip_rows, layout.rate_hz, layout.rate_source = stated
        layout.named = False
        return layout, [], [row for _, row in rows[2:]][:LOOKED_AT_ROWS]
    before = [(number, split_cells(header_text(line), mark)) for number, line in remarks if number < rows[begin][0]]
    names = _header(layout, before, rows, begin, whole)
    least = min(len(rows[begin][1]), len(names) or len(rows[begin][1]))
    return layout, names, [row for _, row in rows[begin:] if len(row) >= least][:LOOKED_AT_ROWS]


def _first_lines(path: Path) -> list[str]:
    """Return the first complete lines of a text; SourceError."""
    with open_source(path, path.with_suffix(".guess")) as file:
        data = decompress(file).read(_HEAD_BYTES)
    text = data.decode("utf-16" if is_utf16(data) else "utf-8-sig", WINDOWS_1252)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if len(data) == _HEAD_BYTES else lines


def _is_of_numbers(row: Sequence[str], layout: TextLayout) -> bool:
    """Return whether at least half of a row's cells are numbers or empty, and at least one is a number."""
    numbers = [cell for cell in row if is_number(cell, layout)]
    return 2 * len(numbers) >= len(row) and any(cell.strip() for cell in numbers)


def _are_of_kinds(rows: Sequence[Sequence[str]], layout: TextLayout) -> bool:
    """Return whether rows begin with alternating words, have several widths, or are sentences."""
    heads = [row[0] for row in rows if row]
    words = {head for head in heads if not is_number(head, layout)}
    worded = sum(head in words for head in heads) > 0.9 * len(heads)
    if worded and words and all(word.startswith("$") or word in SENTENCES for word in words):
        return True
    changes = sum(a != b for a, b in pairwise(heads))
    are_several = len({len(row) for row in rows}) > 1 or (worded and changes > 0.1 * len(heads))
    return are_several and 1 < len(words) < _MOST_KINDS


_MOST_KINDS = 20


def _header(
    layout: TextLayout, remarks: Sequence[_Row], rows: Sequence[_Row], first: int, whole: Sequence[str]
) -> list[str]:
    """Return the names of the columns of a table whose first row of numbers is `rows[first]`: the row above, ignoring
    rows of units, or else the last of the `remarks` above; [] if there are none. Information in the lines above is
    stored in the layout.
    """
    number, cells = rows[first]
    header = rows[first - 1] if first else next((r for r in remarks[-1:] if len(r[1]) == len(cells)), None)
    above = first - 2
    while header is not None and above >= 0 and len(rows[above][1]) == len(header[1]) and is_unit_row(header[1]):
        layout.unit_cells = layout.unit_cells or tuple(header[1])
        header, above = rows[above], above - 1
    layout.named = header is not None and abs(len(header[1]) - len(cells)) <= 1
    layout.rate_hz, layout.rate_source = _stated_rate(whole[:number])
    begin = header[0] if header is not None and layout.named else number
    layout.skip_rows = begin if any(line and not line.startswith(layout.comment) for line in whole[:begin]) else 0
    return [name.strip() for name in header[1]] if header is not None and layout.named else []


def _pad(rows: list[_Row]) -> list[_Row]:
    """Return rows of several widths, below a header as wide as the widest row, extended to the width of the header:
    readings of several kinds have different numbers of values.
    """
    width = len(rows[0][1])
    widths = [len(row) for _, row in rows[1:]]
    plain = TextLayout()
    if len(set(widths)) < 2 or max(widths) != width or any(is_number(cell, plain) for cell in rows[0][1]):
        return rows
    is_narrow = max(set(widths), key=widths.count) < width
    if not is_narrow or max(widths.count(each) for each in set(widths)) > _PLAIN * len(widths):
        return rows
    return [(number, [*row, *[""] * (width - len(row))]) for number, row in rows]


def _first_of_table(rows: Sequence[_Row], numeric: Sequence[bool], layout: TextLayout) -> int | None:
    """Return the first row of a table of numbers below a preamble of other widths; None if the rows below are of
    several widths or begin with words, so that they may be of several kinds.
    """
    tail = [row for _, row in rows[len(rows) // 2 :]]
    widths = [len(row) for row in tail]
    usual = max(set(widths), key=widths.count)
    if widths.count(usual) < _PLAIN * len(tail):
        return None
    if sum(is_number(row[0], layout) or _is_date(row[0]) for row in tail if row) < _PLAIN * len(tail):
        return None
    return next((at for at, (_, row) in enumerate(rows) if numeric[at] and len(row) == usual), None)


_RATE = re.compile(
    r"(?:rate|freq\w*|sampl\w*)[^\d\n]{0,30}?(?P<named>\d+(?:\.\d+)?)|\bat (?P<hertz>\d+(?:\.\d+)?) ?Hz", re.IGNORECASE
)


def _stated_rate(lines: Sequence[str]) -> tuple[float | None, str]:
    """Return the rate of the rows as stated in the lines above a table, and the line; None, "" without one."""
    for line in lines:
        if (match := _RATE.search(line)) is not None:
            rate_hz = float(match["named"] or match["hertz"])
            if RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
                return rate_hz, line.strip("\r\0 -#%/,")
    return None, ""


_UNIX_S = (3e8, 4e9)
"""Range of plausible times of a recording in seconds since 1970."""


def _rate_in_cells(rows: Sequence[_Row]) -> tuple[int, float, str] | None:
    """Return the number of rows to skip, the rate and its source for a table that begins with a row of its start time
    and a row of its rate, repeated in each column (Empatica's wristbands); None for other tables.
    """
    if len(rows) < 4 or not all(is_number(cell, TextLayout()) and cell.strip() for _, row in rows[:2] for cell in row):
        return None
    begins, rates = ({float(cell) for cell in row} for _, row in rows[:2])
    if len(begins) != 1 or len(rates) != 1 or len(rows[0][1]) != len(rows[2][1]):
        return None
    begin_s, rate_hz = begins.pop(), rates.pop()
    if not (_UNIX_S[0] <= begin_s <= _UNIX_S[1] and RATES_HZ[0] <= rate_hz <= RATES_HZ[1]):
        return None
    return rows[2][0], rate_hz, f"the second row; the first is the time of beginning, {begin_s:.0f} s after 1970"


_MOSTLY = 0.9
"""Least share of lines with labelled values in a text of labelled values."""


def _labelled_share(lines: Sequence[str], delimiter: str) -> float:
    """Return the share of lines with only labelled values, plus a small amount for the number of cells."""
    rows = [split_labels(split_cells(line, delimiter)) for line in lines]
    rows = [row if row and 2 * row[0].split(",").count("") < len(row) else [] for row in rows]
    return sum(bool(row) for row in rows) / len(rows) + 1e-4 * min(sum(map(len, rows)) / len(rows), 100)


def _fitness(lines: Sequence[str], delimiter: str) -> float:
    """Rate how well a delimiter splits the lines into equal numbers of numeric cells."""
    rows = [split_cells(line, delimiter) for line in lines]
    widths = [len(row) for row in rows]
    usual = max(set(widths), key=widths.count)
    layout = TextLayout(delimiter, "," if delimiter != "," else ".")
    good = sum(is_number(cell, layout) or is_number(cell, TextLayout(delimiter)) for row in rows for cell in row)
    return (widths.count(usual) / len(rows)) * (usual > 1) * good / max(1, sum(widths)) * min(usual, 20)


def split_cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; [] for a line that is not text."""
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []


def is_number(cell: str, layout: TextLayout) -> bool:
    """Return whether a cell is a number or empty."""
    text = cell.strip().replace(",", ".") if layout.decimal == "," else cell.strip()
    try:
        number_of(text)
    except ValueError:
        return not text
    return True


def columns_of(rows: Sequence[Sequence[str]], layout: TextLayout) -> list[Floats]:
    """Return the numbers of each column, nan for other cells."""
    width = min(len(row) for row in rows)
    columns = []
    for index in range(width):
        texts = (row[index].strip() for row in rows)
        texts = (text.replace(",", ".") for text in texts) if layout.decimal == "," else texts
        columns.append(np.array([_number_or_nan(text) for text in texts]))
    return columns


def _number_or_nan(text: str) -> float:
    try:
        return number_of(text)
    except ValueError:
        return np.nan


_DATES: Sequence[tuple[str, str]] = (
    (r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d:\d+$", "%Y-%m-%d %H:%M:%S:%f"),
    (r"\d{4}-\d\d-\d\d[T ]\d\d:", ISO),
    (r"\d{1,2}\.\d{1,2}\.\d{4} \d\d?:\d\d:\d\d", "%d.%m.%Y %H:%M:%S.%f"),
    (r"\d{4}/\d\d?/\d\d? \d\d?:\d\d:\d\d", "%Y/%m/%d %H:%M:%S.%f"),
    (r"(1[3-9]|2\d|3[01])/\d\d?/\d{4} \d\d?:\d\d:\d\d", "%d/%m/%Y %H:%M:%S.%f"),
    (r"\d\d?/\d\d?/\d{4} \d\d?:\d\d:\d\d", "%m/%d/%Y %H:%M:%S.%f"),
    (r"\d{8}T\d{6}", "%Y%m%dT%H%M%S.%f"),
    (r"[A-Z][a-z]{2} [A-Z][a-z]{2} [ \d]\d \d\d:\d\d:\d\d \d{4}$", "%a %b %d %H:%M:%S %Y"),
    (r"\d\d?:\d\d:\d\d", "%H:%M:%S.%f"),
    (r"\d\d?:\d\d\.\d+$", "%M:%S.%f"),
)
"""Patterns of dates and times, and the unit that a map states for them."""


def _is_date(cell: str) -> bool:
    return any(re.match(pattern, cell.strip()) for pattern, _ in _DATES)


def dates_of(rows: Sequence[Sequence[str]]) -> dict[int, str]:
    """Return the columns of dates and times, and the unit of each."""
    dates = {}
    for index, cell in enumerate(rows[0]):
        text = cell.strip()
        unit = next((unit for pattern, unit in _DATES if re.match(pattern, text)), None)
        if unit is not None:
            if text[-2:].upper() in ("AM", "PM"):
                fraction = ".%f" if "." in text.rpartition(":")[2] else ""
                unit = unit.replace("%H", "%I").replace(".%f", f"{fraction} %p")
            dates[index] = unit
        elif _CLOCK.fullmatch(text) and _is_clock([row[index].strip() for row in rows if len(row) > index]):
            dates[index] = "%H%M%S.%f"
    return dates


def note_days(layout: TextLayout, rows: Sequence[Sequence[str]]) -> None:
    """Note the first column of dates without a time of day, and their format, in the layout."""
    for index in range(min(map(len, rows))):
        cells = {row[index].strip() for row in rows}
        for pattern, unit in _DAYS:
            if all(re.fullmatch(pattern, cell) for cell in cells):
                is_day_first = unit == "%m/%d/%Y" and any(int(cell.partition("/")[0]) > 12 for cell in cells)
                layout.day_column, layout.day_format = index, "%d/%m/%Y" if is_day_first else unit
                return


_DAYS: Sequence[tuple[str, str]] = (
    (r"\d{4}-\d\d?-\d\d?", "%Y-%m-%d"),
    (r"\d{4}/\d\d?/\d\d?", "%Y/%m/%d"),
    (r"\d\d?\.\d\d?\.\d{4}", "%d.%m.%Y"),
    (r"\d\d?/\d\d?/\d{4}", "%m/%d/%Y"),
)
"""Patterns of dates without a time of day, and the format that a map states for them."""


_CLOCK = re.compile(r"([01]\d|2[0-3])[0-5]\d[0-5]\d\.\d+")
"""Pattern of a time of day as written by GPS receivers (NMEA 0183): 235959.98."""


def _is_clock(cells: Sequence[str]) -> bool:
    """Return whether numbers are times of day (hhmmss): all have the digits of one, and after second 59 they step by 40
    more than the interval, which numbers of seconds do not.
    """
    if not all(map(_CLOCK.fullmatch, cells)):
        return False
    values = np.array([float(cell) for cell in cells])
    full = np.flatnonzero(np.diff(np.floor(values / 100)) != 0)
    return len(full) > 0 and bool((np.diff(values)[full] % 100 > 40).all())


def quote(text: str) -> str:
    """Return a text as a string of TOML."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t") + '"'


def names_by_kind(path: Path) -> dict[str, list[str]]:
    """Return the columns' names of each kind of rows, from the FMT rows of an ArduPilot log or of known sentences."""
    with open_source(path, path.with_suffix(".guess")) as file:
        lines = decompress(file).read(_HEAD_BYTES).decode("utf-8", WINDOWS_1252).splitlines()
    rows = [split_cells(line, ",") for line in lines if line.startswith("FMT,")]
    return dict(SENTENCES) | {row[3]: row[5:] for row in rows if len(row) > 5 and row[3] != "FMT"}


_IMU = ["mag_x [gauss]", "mag_y [gauss]", "mag_z [gauss]", "acc_x [m/s2]", "acc_y [m/s2]", "acc_z [m/s2]"]
_IMU += ["gyro_x [rad/s]", "gyro_y [rad/s]", "gyro_z [rad/s]"]
_INCREMENTS = ["week", "time [s]", "status", "acc_z", "acc_y", "acc_x", "gyro_z", "gyro_y", "gyro_x"]
_HEAD = [f"head{number}" for number in range(1, 10)]
SENTENCES: Mapping[str, list[str]] = {
    "$VNYMR": ["yaw [deg]", "pitch [deg]", "roll [deg]", *_IMU],
    "$VNQMR": ["q0", "q1", "q2", "q3", *_IMU],
    "$VNIMU": [*_IMU, "temperature [degC]", "pressure [kPa]"],
    "$VNMAR": _IMU,
    "RAWIMUA": [*_HEAD, *_INCREMENTS],
    "RAWIMUSA": [*_HEAD[:2], *_INCREMENTS],
    "RAWIMUXA": [*_HEAD, "info", "type", *_INCREMENTS],
    "RAWIMUSXA": [*_HEAD[:2], "info", "type", *_INCREMENTS],
    **{f"{letter}-{form}": [f"{quantity}_{axis}" for axis in "xyz"]
       for letter, quantity in (("A", "acc"), ("M", "mag"), ("G", "gyro")) for form in "RC"},
    "YPRAG": ["yaw", "pitch", "roll", "acc_x", "acc_y", "acc_z", "gyro_x [rad/s]", "gyro_y [rad/s]", "gyro_z [rad/s]"],
}  # fmt: skip
"""Columns of sentences after their names: VectorNav's sensors (VN-100 user manual, ASCII messages), NovAtel's RAWIMU
(OEM7 commands and logs reference manual), which has increments in the order z, -y, x, and Razor's boards (Razor AHRS
firmware).
"""

INVERTED_Y = frozenset({"RAWIMUA", "RAWIMUSA", "RAWIMUXA", "RAWIMUSXA"})
"""Sentences with the opposite sign of the y axis."""

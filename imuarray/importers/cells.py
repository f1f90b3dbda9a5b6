"""A text table, read in blocks of rows and converted to integers; errors name line, column and text.

Damage by recorders and power cuts that cannot be a reading is omitted and counted (`TextTable.remarks`): lines with NUL
bytes, a repeated header, lines of text, an incomplete last line, a separator at the end of a line.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from gzip import BadGzipFile
from itertools import chain, islice
from typing import BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.errors import SourceError
from imuarray.importers.mapping import ISO, NS_PER_UNIT, FileTable, has_no_day, has_no_hour, is_date_format
from imuarray.printable import counted
from imuarray.wall_time import unix_ns

ROWS = 4096
"""Rows per block."""

_HEADER_WITHIN = 50
"""Number of first rows in which a header is searched for that is not the first row."""

MOST_RESTARTS = 1000
"""Largest number of backward steps of the time in a recording. A column with more does not contain times, or the rows
are out of order.
"""

FEWEST_WHOLE_ROWS = 100
_FEW_SUMMARIES = 16
MOST_TORN = 0.01
"""Largest share of the rows so far that are omitted because they have another number of cells; at least
`FEWEST_WHOLE_ROWS` complete rows must precede them.
"""

LINE_CHARACTERS = 65536
"""Maximum length of a line of a table."""

INT16 = (-32768, 32767)
INT32 = (-(2**31), 2**31 - 1)

MISSING = frozenset({"", "nan", "na", "n/a", "null", "none"})
"""Cells without a value, in lower case, as written by pandas, R, SQL and Python."""

_LAST_NS = 2**62
DAY_NS, HOUR_NS = 86_400_000_000_000, 3_600_000_000_000
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]")
_OTHER_DATE = re.compile(r"\d\d?:\d\d:\d\d")
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


_DIGITS = frozenset("0123456789")
"""The last characters of most numbers, which distinguish them quickly from `MISSING` cells."""


class CellColumn(NamedTuple):
    """The cells of one column in one block with their line numbers: texts, or numbers of a binary file (`values`, with
    rows in the place of lines).
    """

    source: str
    label: str
    lines: Sequence[int]
    texts: Sequence[str]
    values: npt.NDArray[np.number] | None = None

    def refuse(self, row: int, complaint: str) -> SourceError:
        """Return the error about one cell."""
        place = "line" if self.values is None else "row"
        return SourceError(f"{self.source}: {place} {self.lines[row]}, column {self.label}: {complaint}")

    def text(self, row: int) -> str:
        """Return the text of a cell, shortened for messages."""
        return _shortened(self.texts[row] if self.values is None else str(self.values[row]))

    @property
    def rows(self) -> int:
        """The number of cells."""
        return len(self.lines)

    def blank(self) -> npt.NDArray[np.bool_]:
        """Return (n,) which cells are empty."""
        if self.values is not None:
            return np.isnan(self.values) if self.values.dtype.kind == "f" else np.zeros(len(self.values), bool)
        return np.array([text[-1:] not in _DIGITS and text.strip().lower() in MISSING for text in self.texts], bool)

    def torn(self) -> npt.NDArray[np.bool_]:
        """Return (n,) which cells are text in the place of a number, as a damaged line has it; none unless they are
        rare, because a column of words is not one of readings.
        """
        nothing = np.zeros(self.rows, bool)
        is_excerpt = self.rows < FEWEST_WHOLE_ROWS and (not self.rows or self.lines[0] <= FEWEST_WHOLE_ROWS)
        if self.values is not None or is_excerpt:
            return nothing
        try:
            list(map(float, self.texts))
        except ValueError:
            blank = self.blank()
            is_torn = ~blank & np.array([not _is_number(text) for text in self.texts], bool)
            return is_torn if np.count_nonzero(is_torn) <= max(1.0, MOST_TORN * self.rows) else nothing
        return nothing

    def where(self, kept: npt.NDArray[np.bool_]) -> CellColumn:
        """Return the selected cells."""
        if kept.all():
            return self
        rows = np.flatnonzero(kept).tolist()
        lines = [self.lines[row] for row in rows]
        if self.values is not None:
            return self._replace(lines=lines, values=self.values[kept])
        return self._replace(lines=lines, texts=[self.texts[row] for row in rows])


class TextTable:
    """The rows of an open file with `[file]` applied. With `named` the first row holds the columns' names.

    `remarks` lists the omitted lines.
    """

    def __init__(self, file: BinaryIO, source: str, layout: FileTable, named: bool) -> None:
        self._text = io.TextIOWrapper(file, encoding=_encoding(file), errors=WINDOWS_1252)
        self._layout = layout
        self._reader = csv.reader(self._lines(), delimiter=layout.delimiter, skipinitialspace=True)
        self._is_damaged = self._is_last = False
        self.source = source
        self.line = 0
        self.left_out: Counter[str] = Counter()
        self.width = 0
        self._comment = ""
        self._first_row: list[str] = []
        self.header: list[str] = self._names() if named else []
        self.names: list[str] = [name.strip() for name in self.header]
        self.width = len(self.names)
        self._blank_end = bool(self.names) and (not self.names[-1] or bool(_REMARKS.fullmatch(self.names[-1])))
        self._has_data = self._begins_with_number = False

    def _lines(self) -> Iterator[str]:
        comment = self._layout.comment
        while line := self._read_line():
            self.line += 1
            if len(line) > LINE_CHARACTERS and line.strip("\0"):
                raise SourceError(
                    f"{self.source}: line {self.line}: longer than {LINE_CHARACTERS} characters; is this a table?"
                )
            self._is_last = not line.endswith("\n")
            self._is_damaged = "\0" in line
            line = plain_line(line.rstrip("\0 \r\n").lstrip(" "), self._layout.delimiter)
            if "\0" in line or (self._is_damaged and not line):
                self.left_out["nul"] += 1
                continue
            if is_rule(line):
                continue
            if comment and line.startswith(comment):
                self._comment = line.removeprefix(comment)
            elif self.line > self._layout.skip_rows and line:
                if not self.width and _is_binary(line):
                    raise SourceError(
                        f"{self.source}: line {self.line} is not text; allowed are tables of text (also .gz), .npz,"
                        " .npy, .mat, .parquet and ROS bags"
                    )
                yield line

    def _read_line(self) -> str:
        """Return the next line, or its beginning if it is too long for a table; "" at the end of the file."""
        try:
            return self._text.readline(LINE_CHARACTERS + 1)
        except (BadGzipFile, EOFError, zlib.error) as error:
            raise SourceError(f"{self.source}: after line {self.line}: damaged gzip data: {error}") from None

    def _names(self) -> list[str]:
        """Return the cells of the header; the first row of numbers is kept for `_row` if the header is a comment. Some
        cells of that row may be words, for example the `frame_id` of a ROS message.
        """
        row = self._row()
        text = header_text(self._comment)
        header = next(csv.reader([text], delimiter=self._layout.delimiter, skipinitialspace=True), [])
        kinds = self._layout.kind_columns
        numbers_ = [_is_number(cell) for at, cell in enumerate(row) if at not in kinds]
        if len(header) != len(row) or 2 * sum(numbers_) < len(numbers_) or any(map(_is_number, header)):
            return row
        self._first_row = row
        return header

    def _row(self) -> list[str]:
        """Return the next row; [] at the end of the file."""
        if self._first_row:
            row, self._first_row = self._first_row, []
            return row
        try:
            row = next(self._reader, [])
            while self._layout.labels and row:
                if cells := split_labels(row):
                    return cells
                row = next(self._reader, [])
            return row
        except csv.Error as error:
            raise SourceError(f"{self.source}: line {self.line}: {error}") from None

    def _rows(self, kind: str | None) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of every row of a kind. All rows must have the same number of cells, because
        cells would otherwise silently change their column; a few rows that a serial line tore are omitted.
        """
        kinds, width_of_kind, rows_read = self._layout.kind_columns, 0, 0
        while row := self._row():
            if kinds and (len(row) <= max(kinds) or " ".join(row[at].strip() for at in kinds) != kind):
                continue
            if row == self.header:
                self.left_out["header"] += 1
                continue
            if kinds and self.header and len(row) < self.width:
                # Readings may have fewer values than the header has names, but the same number for each kind.
                width_of_kind = width_of_kind or len(row)
                row = [*row, *[""] * (self.width - len(row))] if len(row) == width_of_kind else row
            if not self.width:
                self.width, self._blank_end = len(row), not row[-1].strip()
            if len(row) == self.width + 1 and not row[-1].strip():
                row = row[:-1]
            elif len(row) == self.width - 1 and self._blank_end:
                row = [*row, ""]
            if not kinds and rows_read >= FEWEST_WHOLE_ROWS and self._is_summary(row, rows_read):
                self.left_out["summary"] += 1
                continue
            if len(row) != self.width:
                if len(row) < self.width and (self._is_last or self._is_damaged):
                    self.left_out["nul" if self._is_damaged else "cut"] += 1
                    continue
                if row[0].strip()[:1].isalpha() and not any(map(_is_number, row)):
                    self.left_out["text"] += 1
                    continue
                if rows_read >= FEWEST_WHOLE_ROWS and self.left_out["torn"] < MOST_TORN * rows_read:
                    self.left_out["torn"] += 1
                    continue
                raise SourceError(
                    f"{self.source}: line {self.line}: {counted(len(row), 'cell')}, the first row has {self.width}"
                )
            if not self._has_data and self.header and not kinds and is_unit_row(row):
                self.left_out["units"] += 1
                continue
            self._has_data = True
            self._begins_with_number = _is_number(row[0])
            rows_read += 1
            yield self.line, row

    def _is_summary(self, row: Sequence[str], rows_read: int) -> bool:
        """Return whether a row after the readings summarises them: its first cell is a word, for example "Mean", where
        readings have a number, and another cell is a number. A table has few of these rows.
        """
        first = row[0].strip()
        is_worded = first[:1].isalpha() and first.lower() not in MISSING and not _is_number(first)
        is_rare = self.left_out["summary"] < max(_FEW_SUMMARIES, MOST_TORN * rows_read)
        return is_worded and self._begins_with_number and is_rare and any(map(_is_number, row[1:]))

    def index(self, column: str | int) -> int:
        """Return the index of a column; SourceError if the header does not have it, or has it twice."""
        if isinstance(column, int):
            return column
        if self.names.count(column) != 1:
            problem = "several columns are called" if column in self.names else "no column"
            header = _shortened(", ".join(self.names), 200)
            raise SourceError(
                f"{self.source}: line {self.line}: {problem} {column!r}; the header has {header}"
                + self._header_hint(column)
            )
        return self.names.index(column)

    def _header_hint(self, column: str) -> str:
        """Return why the header may not have a column: another delimiter, or lines above it."""
        if len(self.header) == 1:
            mark = next((mark for mark in ("\t", ";", "|", ",", " ") if mark in self.header[0].strip()), None)
            if mark is not None and column in self.header[0].split(mark):
                return f"; if the delimiter is {mark!r}, set it in [file] of the map"
        for row in islice(iter(self._row, []), _HEADER_WITHIN):
            if column in map(str.strip, row):
                return f"; line {self.line} has it: for lines above a header, set skip_rows = {self.line - 1}"
        return ""

    def blocks(self, rows: int = ROWS, kind: str | None = None) -> Iterator[CellBlock]:
        """Yield all rows (of a kind, if the map distinguishes kinds), `rows` at a time."""
        remaining = self._rows(kind)
        while block := list(islice(remaining, rows)):
            lines, cells = zip(*block, strict=True)
            columns = list(zip(*cells, strict=True))
            if self._layout.decimal == ",":
                columns = [tuple(text.replace(",", ".") for text in column) for column in columns]
            yield CellBlock(self.source, lines, columns)

    def remarks(self) -> list[str]:
        """Return what was omitted, as sentences."""
        sentences = {
            "nul": "{} with NUL bytes left out, as a power cut leaves them",
            "header": "{} that repeat the header left out",
            "units": "{} of units below the header left out",
            "cut": "{} at the end of the file left out: it is cut off",
            "text": "{} of text without a number left out",
            "summary": "{} that begin with a word in the place of a number left out, as summaries of the readings do",
            "torn": "{} with another number of cells left out: torn, or two that run into each other",
        }
        return [
            text.format(counted(self.left_out[cause], "line"))
            for cause, text in sentences.items()
            if self.left_out[cause]
        ]


def header_text(comment: str) -> str:
    """Return the names of columns in a comment: the part in quotes if a remark precedes it, 'Format: "a,b,c"'."""
    head, quote, rest = comment.partition('"')
    is_quoted = quote and rest.rstrip().endswith('"') and rest.count('"') == 1 and "," not in head
    return rest.rstrip().removesuffix('"') if is_quoted else comment


_PREFIX = re.compile(r"(?P<word>[A-Za-z_]\w{0,15})\s*[:>]\s*(?=[-+.\d])(?P<rest>[^:=]*)")
_MONITOR_STAMP = re.compile(r"(\d\d:\d\d:\d\d[.,]\d+) -> ")
_CHECKSUM = re.compile(r"(\$.*)\*[0-9A-Fa-f]{2}")
_RAZOR = re.compile(r"#([AMG]-[RC]|YPRA?G?|YPRAMG)=([-+.\d]+(?:,[-+.\deE]+){2,})")
_NOVATEL = re.compile(r"[#%]([A-Z0-9]+A,[^;]*);(.*)\*[0-9A-Fa-f]{8}")


def plain_line(line: str, delimiter: str) -> str:
    """Return a line without the additions of terminals and instruments. The Arduino IDE's "12:34:56.789 -> " becomes a
    separate cell, and so does a word before numbers, "IMU: 1,2,3". The checksum of a sentence "$VNYMR,...*5C" (NMEA
    0183) or "%RAWIMUSA,...;...*5aa97065" (NovAtel) is removed. A semicolon after the last of cells separated by commas
    ends the row.
    """
    line = plain_sentence(line)
    if line.startswith("|") and line.rstrip().endswith("|"):
        line = line.strip("| ")
    if line.endswith(";") and delimiter == "," and ";" not in line[:-1]:
        line = line[:-1]
    if line[2:3] == ":" and (stamp := _MONITOR_STAMP.match(line)) is not None:
        line = stamp[1].replace(",", ".") + delimiter + line[stamp.end() :]
    prefix = None if line[:1].isdigit() else _PREFIX.fullmatch(line)
    if prefix is not None and prefix["rest"].count(delimiter) >= _FEWEST_BEHIND_WORD - 1:
        return prefix["word"] + delimiter + prefix["rest"]
    if line.startswith("$") and (sentence := _CHECKSUM.fullmatch(line)) is not None:
        return sentence[1]
    return line


_FEWEST_BEHIND_WORD = 3
"""Fewest cells after a word and a colon that are a row of numbers, and not a remark or a labelled value."""


def is_rule(line: str) -> bool:
    """Return whether a line only separates the header of a table from its rows, as Markdown and SQL write it."""
    return len(line) > 2 and not line.strip("|-:+= ") and "--" in line


def plain_sentence(line: str) -> str:
    """Return a sentence that begins like a comment, of NovAtel's receivers or Razor's boards ("#A-R=1.5,2,255"), as
    cells that commas separate.
    """
    sentence = _NOVATEL.fullmatch(line) or _RAZOR.fullmatch(line)
    return line if sentence is None else f"{sentence[1]},{sentence[2]}"


_LABELLED = re.compile(
    r"(?P<label>[A-Za-z_][\w /.()\[\]%^\u00b2\u00b0-]*?)\s*[:=]\s*(?P<value>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    r"\s*(?P<unit>[A-Za-z\u00b5\u00b0%][A-Za-z/^*\u00b2\u00b0 0-9-]*)?"
)


def split_labels(cells: Sequence[str]) -> list[str]:
    """Return a row of labelled values ("ax: 0.02, ay: -0.98 g") as the labels, joined by commas, and the values; [] for
    a row without a label. The labels are the kind of the row, because text between the readings has other labels. A
    time stamp in brackets, "[1234] ax: 0.02", and values separated by a bar are separate values.
    """
    labels, values = [], []
    for cell in map(str.strip, chain.from_iterable(map(_labelled_parts, cells))):
        if (match := _LABELLED.fullmatch(cell)) is not None:
            unit = f" [{match['unit'].strip()}]" if match["unit"] else ""
            labels.append(match["label"].strip() + unit)
            values.append(match["value"])
        elif _is_number(cell):
            labels.append("")
            values.append(cell)
        elif cell and not cell.endswith(":"):
            return []
    return [",".join(labels), *values] if any(labels) else []


def _labelled_parts(cell: str) -> list[str]:
    """Return the labelled values in a cell: those that bars separate, or only spaces, "t=120 ax=0.02"."""
    parts = _SEPARATED.split(cell)
    return [pair[0] for part in parts for pair in (_PAIR.finditer(part) if _PAIRS.fullmatch(part) else [[part]])]


_PAIR = re.compile(r"[A-Za-z_]\w*\s*[:=]\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?!\S)")
_PAIRS = re.compile(rf"\s*(?:{_PAIR.pattern}\s*){{2,}}")

_SEPARATED = re.compile(r"\||(?<=\d)\](?=\s*[A-Za-z])|^\s*\[(?=\d)")
"""Bars between labelled values, and the brackets around a stamp before them."""

_REMARKS = re.compile(r"(comment|remark|note|annotation)s?|kommentar|bemerkung(en)?", re.IGNORECASE)
"""Names of a last column for remarks. Programs omit its cell in rows without a remark."""


_UNIT_CELL = re.compile(
    r"[\[(].*[\])]|-|[mun\u00b5\u03bc]?(s|sec|g|G|T|gauss|V)|[cm]?m/s[/^*]*(s|2|\u00b2)|gal|m?(\u00b0|\u00ba|deg|rad)(/s(ec)?)?|m?dps"
    r"|[hkm]?(Pa|bar)|(\u00b0|deg)? ?[CK]|counts?|LSB|m/\(s\^2\)|local_flux|no[_ ]units|(un)?cal|raw|",
    re.IGNORECASE,
)


def is_unit_row(cells: Sequence[str]) -> bool:
    """Return whether the cells of a row are units, as in a second row below the names."""
    return any(cell.strip() for cell in cells) and all(_UNIT_CELL.fullmatch(cell.strip()) for cell in cells)


def _is_binary(line: str) -> bool:
    """Return whether a line has control characters and undecodable bytes that do not occur in texts."""
    strange = sum(letter == "\ufffd" or (letter < " " and letter not in "\t\x0b\x0c") for letter in line)
    return strange > 0.1 * len(line)


def _western(error: UnicodeError) -> tuple[str, int]:
    """Decode bytes that are not UTF-8 as Windows-1252, in which spreadsheets write units, if they are letters or signs
    of units. Other bytes become U+FFFD, so that a file that is not a text is recognised (small negative numbers of 16
    bits begin with FF or FE).
    """
    if not isinstance(error, UnicodeDecodeError):
        raise error
    text = error.object[error.start : error.end].decode("latin-1")
    return "".join(sign if sign in _UNIT_SIGNS or "À" <= sign < "þ" else "\ufffd" for sign in text), error.end


_UNIT_SIGNS = "°²³µ·º"

WINDOWS_1252 = "imuarray-windows-1252"
"""How texts that are not UTF-8 throughout are decoded, as the `errors` of a codec."""

codecs.register_error(WINDOWS_1252, _western)


def _encoding(file: BinaryIO) -> str:
    """Return the encoding of a text from its byte order mark."""
    peek = getattr(file, "peek", None)
    return "utf-16" if peek is not None and is_utf16(peek(_LOOKED_AT)) else "utf-8-sig"


_LOOKED_AT = 64


def is_utf16(data: bytes) -> bool:
    """Return whether a text begins with a byte order mark of UTF-16 and has zero bytes as UTF-16 does; the bytes from a
    serial port while a board starts may be equal to the mark.
    """
    return data[:2] in _UTF16 and (len(data) < _LOOKED_AT or data[2:_LOOKED_AT].count(0) > _LOOKED_AT // 4)


class CellBlock(NamedTuple):
    """Some rows by column; `columns` are arrays if the file holds numbers."""

    source: str
    lines: Sequence[int]
    columns: Sequence[Sequence[str] | npt.NDArray[np.number]]

    def column(self, index: int, label: str) -> CellColumn:
        """Return one column; SourceError if the rows are too short."""
        if index >= len(self.columns):
            cells = f"{counted(len(self.columns), 'cell')}, so there is no column {label} (counted from 0)"
            cells += "; do they have another delimiter?" if len(self.columns) == 1 else ""
            raise SourceError(f"{self.source}: line {self.lines[0]}: {cells}")
        cells_ = self.columns[index]
        if isinstance(cells_, np.ndarray):
            return CellColumn(self.source, label, self.lines, (), cells_)
        return CellColumn(self.source, label, self.lines, cells_)


Blocks = Iterator[tuple[CellBlock, list[int]]]
"""Blocks of rows, each with the indices of the requested columns in it."""


class CodeConversion(NamedTuple):
    """The conversion of cells into counts of `count_bits`: codes in two's complement of `bits` (None: signed codes),
    minus `offset`. With a `sensitivity` (counts per unit) the cells are in a unit.
    """

    sensitivity: float | None = None
    offset: int = 0
    bits: int | None = None
    count_bits: int = 16

    @property
    def span(self) -> tuple[int, int]:
        """The lowest and the highest count."""
        return -(1 << self.count_bits - 1), (1 << self.count_bits - 1) - 1


CODES = CodeConversion()
"""Cells that are counts."""


def counts(column: CellColumn, codes: CodeConversion = CODES) -> npt.NDArray[np.signedinteger]:
    """Return (n,) counts, int32 if `codes.count_bits` is more than 16. SourceError for a cell that is not a number, is
    a fraction of a count (without a sensitivity), or is not a code of `codes.bits` or a count of `codes.count_bits`.
    """
    values = numbers(column)
    whole = np.rint(values if codes.sensitivity is None else values * codes.sensitivity)
    if codes.sensitivity is None and (whole != values).any():
        row = int(np.argmax(whole != values))
        hint = "if the column has a unit, set values = 'physical' in the map"
        raise column.refuse(row, f"{column.text(row)} is not a whole number of counts; {hint}")
    if codes.bits is not None:
        span = 1 << codes.bits
        odd = (whole < -span / 2) | (whole >= span)
        if odd.any():
            row = int(np.argmax(odd))
            raise column.refuse(row, f"{column.text(row)}; codes of {codes.bits} bits are allowed")
        whole = np.where(whole >= span / 2, whole - span, whole)
    whole = whole - codes.offset
    low, high = codes.span
    outside = (whole < low) | (whole > high)
    if outside.any():
        row = int(np.argmax(outside))
        as_counts = "" if codes.sensitivity is None and not codes.offset else f" is {whole[row]:.6g} counts"
        raise column.refuse(row, f"{column.text(row)}{as_counts}; allowed are {low} to {high}" + _hint(codes))
    return whole.astype(np.int16) if codes.count_bits <= 16 else whole.astype(np.int32)


def _hint(codes: CodeConversion) -> str:
    """Return a likely reason for a count that is too large."""
    if codes.sensitivity is not None:
        return "; are unit and sensitivity those of the column?"
    if codes.offset or codes.bits:
        return ""
    return "; for unsigned codes, set offset or bits in the map, and for codes of more than 16 bits, bits"


class TimeColumn:
    """Converts the cells of a time column to ns across blocks: exactly, and across the wraps of a counter."""

    def __init__(
        self,
        unit: str,
        ticks: float = 1.0,
        wraps_at: float | None = None,
        ties: bool = False,
        last_ns: int | None = None,
        *,
        restarts: bool = False,
    ) -> None:
        """`last_ns` is the time of the row before the first one; None without one."""
        self._restarts, self._restart_ns, self._usual_ns = restarts, 0, 1
        self.restarted: npt.NDArray[np.bool_] = np.zeros(0, bool)
        """Rows (n,) of the last block at which the time stepped back."""
        self.set_back_ns: list[int] = []
        """Size in ns of each backward step of the time; more than `MOST_RESTARTS` steps are refused."""
        self._iso = unit == ISO
        self._format = unit if is_date_format(unit) else ""
        tick_ns = Fraction(ticks).limit_denominator(10**9) * NS_PER_UNIT.get(unit, 1)
        self._tick_ns: int | Fraction = tick_ns.numerator if tick_ns.denominator == 1 else tick_ns
        self._span_ns = 0 if wraps_at is None else round(wraps_at * tick_ns)
        if self._format and has_no_day(self._format):
            self._span_ns = HOUR_NS if has_no_hour(self._format) else DAY_NS
        self._ties = ties
        self._turns_ns = self._tie_place = 0
        self._untied_ns: int | None = None
        self.last_ns = last_ns
        self.tied = self.wrapped = 0
        self.tied_rows: npt.NDArray[np.bool_] = np.zeros(0, bool)
        """Rows (n,) of the last block with the time of the row before."""

    def nanoseconds(self, column: CellColumn) -> npt.NDArray[np.int64]:
        """Return (n,) int64 ns; SourceError unless each is later than the previous one."""
        times = self.stamps(column)
        first = -_LAST_NS * 2 if self.last_ns is None else self.last_ns
        if self._span_ns:
            before = np.concatenate([[times[0] if self.last_ns is None else first - self._turns_ns], times[:-1]])
            turns = np.cumsum(before - times > self._span_ns // 2) * self._span_ns
            self.wrapped += int(turns[-1]) // self._span_ns if len(turns) else 0
            times = times + self._turns_ns + turns
            self._turns_ns += int(turns[-1]) if len(turns) else 0
        if self._restarts:
            times = self._joined(column, times)
        if self._ties:
            times = self._apart(times)
        before = np.concatenate([[first], times[:-1]])
        if (times <= before).any():
            row = int(np.argmax(times <= before))
            same = times[row] == before[row]
            hint = "; for a coarse clock, set ties = true in the map" if same else self._later_hint()
            earlier = f", {column.text(row - 1)}" if row else ""
            raise column.refuse(
                row, f"{column.text(row)} is not later than the row before{earlier}; allowed are increasing times{hint}"
            )
        self.last_ns = int(times[-1]) if len(times) else self.last_ns
        return times

    def stamps(self, column: CellColumn) -> npt.NDArray[np.int64]:
        """Return the times (n,) in ns as the cells state them, in any order; SourceError for a cell without a time."""
        if column.values is not None:
            return self._of_numbers(column)
        return np.array([self._of_text(column, row) for row in range(column.rows)], np.int64)

    def _later_hint(self) -> str:
        if self._span_ns:
            return ""
        return (
            "; for a counter that wraps, set wraps_at in the map; for rows out of order, sort = true; for a clock that"
            " was set back, restarts = true; import several recordings one by one"
        )

    def _joined(self, column: CellColumn, times: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Continue times that step back from the row before at the usual interval; SourceError if they step back more
        than `MOST_RESTARTS` times.
        """
        if not len(times):
            return times
        steps = np.diff(times, prepend=times[0] if self.last_ns is None else self.last_ns - self._restart_ns)
        self.restarted = steps < 0
        if (steps > 0).any():
            self._usual_ns = round(float(np.median(steps[steps > 0])))
        self.set_back_ns += (-steps[self.restarted]).tolist()
        if len(self.set_back_ns) > MOST_RESTARTS:
            row = int(np.flatnonzero(self.restarted)[-1])
            raise column.refuse(row, f"the times fall for the {MOST_RESTARTS + 1}th time; is this the column of time?")
        shifts = self._restart_ns + np.cumsum(np.where(self.restarted, self._usual_ns - steps, 0))
        self._restart_ns = int(shifts[-1])
        return np.asarray(times + shifts)

    def _apart(self, times: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Separate equal times by 1 ns."""
        if len(times) == 0:
            return times
        before = int(times[0]) - 1 if self._untied_ns is None else self._untied_ns
        rows = np.arange(len(times))
        first = np.maximum.accumulate(np.where(np.diff(times, prepend=before) == 0, -1 - self._tie_place, rows))
        place = rows - first
        self._tie_place, self._untied_ns = int(place[-1]), int(times[-1])
        self.tied_rows = place > 0
        self.tied += int(np.count_nonzero(place))
        return np.asarray(times + place)

    def _of_numbers(self, column: CellColumn) -> npt.NDArray[np.int64]:
        """Return the times of a file of binary numbers: integers exactly, others to their precision."""
        values = column.values
        assert values is not None  # noqa: S101, its caller asked
        if values.dtype.kind == "f":
            wrong = ~np.isfinite(values) | (np.abs(values) > float(_LAST_NS / self._tick_ns))
        else:
            wrong = np.abs(values.astype(np.float64)) > float(_LAST_NS / self._tick_ns)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise column.refuse(row, f"{column.text(row)} is not a time; allowed are {self._allowed}")
        if values.dtype.kind == "f":
            whole = np.floor(values)
            part = np.rint((values - whole) * float(self._tick_ns)).astype(np.int64)
        else:
            whole, part = values, np.zeros(len(values), np.int64)
        if isinstance(self._tick_ns, int):
            times: npt.NDArray[np.int64] = whole.astype(np.int64) * self._tick_ns + part
        else:
            times = np.array([round(int(value) * self._tick_ns) for value in whole.tolist()], np.int64) + part
        return times

    @property
    def _allowed(self) -> str:
        return f"numbers up to {_LAST_NS // self._tick_ns}"

    def _of_text(self, column: CellColumn, row: int) -> int:
        """Return one time, in decimal arithmetic, because floats of seconds since 1970 do not resolve nanoseconds."""
        text = column.texts[row].strip()
        if self._iso:
            return _date_ns(column, row, text)
        if self._format:
            return _formatted_ns(column, row, text, self._format)
        try:
            value = Decimal(text)
        except InvalidOperation:
            hint = _number_hint(column, row)
            if _DATE.match(text):
                hint = "; for dates, set unit = 'iso8601'"
            elif _OTHER_DATE.search(text):
                hint = "; for dates, give their format in the map, such as unit = '%d.%m.%Y %H:%M:%S.%f'"
            raise column.refuse(row, f"{column.text(row)!r} is not a number" + hint) from None
        if not value.is_finite() or value.copy_abs() > _LAST_NS // self._tick_ns:
            raise column.refuse(row, f"{column.text(row)} is not a time; allowed are {self._allowed}")
        if isinstance(self._tick_ns, int):
            return int((value * self._tick_ns).to_integral_value())
        return round(Fraction(value) * self._tick_ns)


def _date_ns(column: CellColumn, row: int, text: str) -> int:
    """Return a date and time as ns since 1970; without a zone it is UTC."""
    text, leap_ns = _without_leap_second(text)
    whole, point, rest = text.partition(".")
    digits = rest[: len(rest) - len(rest.lstrip("0123456789"))]
    passed_ns = unix_ns(whole + rest[len(digits) :])
    if passed_ns is None:
        raise column.refuse(row, f"{column.text(row)!r} is not a date and time such as 2013-09-16T08:30:00.5Z")
    return passed_ns + int(f"{digits[:9]:0<9}" if point else 0) + leap_ns


def _without_leap_second(text: str) -> tuple[str, int]:
    """Return a time in second 60 as a time in second 59, and the difference of 1 s in ns; 0 ns for other times. The sum
    is second 0 of the next minute, which then occurs twice (`restarts` in the map).
    """
    if _LEAP_SECOND.search(text):
        return text.replace(":59:60", ":59:59", 1), 1_000_000_000
    return text, 0


_LEAP_SECOND = re.compile(r":59:60(?!\d)")


def _formatted_ns(column: CellColumn, row: int, text: str, layout: str) -> int:
    """Return a date and time of a `strptime` format as ns since 1970, or ns since midnight if it has no day; without a
    zone it is UTC. A fraction at the end may have nine digits, or be absent.
    """
    text, nanos = _without_leap_second(text.strip())
    if layout.endswith(".%f"):
        layout = layout.removesuffix(".%f")
        head, point, digits = text.replace(",", ".").rpartition(".")
        if point and digits.isdigit():
            text, nanos = head, nanos + int(f"{digits[:9]:0<9}")
    try:
        moment = datetime.strptime(text, layout)
    except ValueError:
        raise column.refuse(
            row, f"{column.text(row)!r} is not a date and time in the format that the map states"
        ) from None
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
    if has_no_day(layout):
        moment = moment.replace(year=1970, month=1, day=1)
    passed = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (passed.days * 86400 + passed.seconds) * 1_000_000_000 + passed.microseconds * 1000 + nanos


def numbers(column: CellColumn) -> npt.NDArray[np.float64]:
    """Return (n,) finite numbers; SourceError."""
    if column.values is not None:
        values = column.values.astype(np.float64)
        row = int(np.argmin(np.isfinite(values))) if not np.isfinite(values).all() else None
    else:
        try:
            try:
                values = np.array(list(map(float, column.texts)))
            except ValueError:  # some may be hexadecimal
                values = np.array(list(map(number_of, column.texts)))
            row = None if np.isfinite(values).all() else int(np.argmin(np.isfinite(values)))
        except ValueError:
            values, row = np.array([]), next(at for at, text in enumerate(column.texts) if not _is_number(text))
    if row is not None:
        raise column.refuse(row, f"{column.text(row)!r} is not a number" + _number_hint(column, row))
    return values


def _number_hint(column: CellColumn, row: int) -> str:
    """Return a likely reason for a cell that is not a number."""
    text = "" if column.values is not None else column.texts[row].strip()
    if text.count(",") == 1 and _is_number(text.replace(",", ".")):
        return "; for decimal commas, set decimal = ',' in the map"
    if column.lines[row] == 1 and text[:1].isalpha() and text.lower() not in ("nan", "inf"):
        return "; for a header, name the columns in the map, or set skip_rows = 1"
    if text[:1].isalpha():
        return "; if another table begins there, give each table a file of its own, and import their folder"
    return ""


def number_of(text: str) -> float:
    """Return the number in a cell, decimal or hexadecimal (0x1F4A); ValueError."""
    try:
        return float(text)
    except ValueError:
        if _HEXADECIMAL.fullmatch(text.strip()) is None:
            raise
        return float(int(text.strip(), 16))


_HEXADECIMAL = re.compile(r"[+-]?0[xX][0-9a-fA-F]{1,8}")


def _is_number(text: str) -> bool:
    try:
        number_of(text)
    except ValueError:
        return False
    return True


def _shortened(text: str, length: int = 40) -> str:
    return text if len(text) <= length else text[:length] + "..."

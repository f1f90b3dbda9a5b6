"""Texts with a name for each value in a row: JSON (a document, or an object on each line), InfluxDB's line protocol,
and frames of a CAN bus as written by candump.

Objects are flattened: `{"imu": {"acc": [0, 0, 1]}}` has the columns `imu.acc[0]`, `imu.acc[1]` and `imu.acc[2]`. Lists
of objects are separate tables, and their kind is the path to them. Words that distinguish a few kinds of objects
("sensor": "gyro") are also part of the kind. Numbers keep all their digits.
"""

from __future__ import annotations

import json
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from gzip import BadGzipFile
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from imuarray.errors import SourceError
from imuarray.importers import decompress
from imuarray.importers.cells import WINDOWS_1252, Blocks, CellBlock
from imuarray.printable import counted, printable

LOOKED_AT_RECORDS = 20_000
"""Number of records from which kinds and columns are inferred."""

MOST_KINDS = 16
"""Largest number of different values of a field that distinguishes kinds of records; a field with more values contains
remarks or numbers.
"""

MOST_BYTES = 1 << 29
"""Largest JSON document that is read as a whole; lines of objects have no limit."""

MOST_CHARACTERS = 1 << 24
"""Longest line of a record."""

MOST_COLUMNS = 64
"""Longest list of numbers with a column for each element; a longer list is a single column."""

_BEGIN_BYTES = 1 << 16

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:|\d\d?[./-]\d\d?[./-]\d\d")
_INFLUX = re.compile(
    r"(?P<measurement>[^\s,=]+)(?P<tags>(,[^\s,=]+=[^\s,]+)*)"
    r" (?P<fields>[^\s,=]+=[^\s,]+(,[^\s,=]+=[^\s,]+)*) (?P<time>\d{9,20})"
)
_CAN = re.compile(
    r"\((?P<time>\d+\.\d+)\)\s+\S+\s+(?P<id>[0-9A-Fa-f]{3,8})"
    r"(#(?P<hex>[0-9A-Fa-f]*)|\s+\[\d\]\s+(?P<bytes>[0-9A-Fa-f ]*))\s*([RT]|'.*')?"
)

WORD_ORDERS = ("le", "be")
"""Names of the words of 16 bits of a frame, little and big endian: `le[0]`, `be[0]`."""
FIRST_WORDS = frozenset({"le[0]", "le[2]", "be[0]", "be[2]"})

Record = tuple[str, dict[str, str]]
"""The path to a record ("" for the outermost), and its values by name as texts."""


def is_of_records(path: Path) -> bool:
    """Return whether a file is a text of records."""
    try:
        with path.open("rb") as file:
            begin = decompress(file).read(_BEGIN_BYTES)
    except (OSError, EOFError, zlib.error):
        return False
    text = begin.decode("utf-8-sig", WINDOWS_1252).lstrip()
    lines = [line for line in text.split("\n") if line.strip() and not line.startswith("#")]
    if not lines:
        return False
    if text[0] in "{[":
        return _parses(lines[0]) or bool(_OPENS_DOCUMENT.match(text))
    whole = lines[:-1] or lines
    return any(sum(form.fullmatch(line.strip()) is not None for line in whole) > 0.9 * len(whole) for form in _LINES)


_LINES = (_INFLUX, _CAN)
_OPENS_DOCUMENT = re.compile(r'\{\s*"|\[\s*(\{\s*"|\[\s*-?[\d"])|\[\s*-?\d+(\.\d+)?\s*,')


def _parses(line: str) -> bool:
    try:
        return isinstance(json.loads(line), dict | list)
    except (ValueError, RecursionError):
        return False


def open_rows(path: Path, progress: Callable[[int], None]) -> RecordRows:
    """Open the records of a text; SourceError."""
    return RecordRows(path, progress)


class RecordRows:
    """The records of a text as tables, one for each kind."""

    def __init__(self, path: Path, progress: Callable[[int], None]) -> None:
        self._path, self._progress = path, progress
        self._left_out: Counter[str] = Counter()
        first = list(islice(self._records(), LOOKED_AT_RECORDS))
        if not first:
            raise SourceError(f"{path}: contains no object with a number")
        self._fields = _kind_fields(first)
        self._has_paths = len({record[0] for _, record in first}) > 1
        self._columns: dict[str, dict[str, None]] = {}
        for _, record in first:
            kind = self._kind(*record)
            self._columns.setdefault(kind, {}).update(dict.fromkeys(record[1]))

    @property
    def remarks(self) -> list[str]:
        """Sentences on the lines that were omitted."""
        count = self._left_out["lines"]
        return [f"{counted(count, 'line')} left out that cannot be read as the others"] if count else []

    def names(self) -> Mapping[str, Sequence[str]]:
        """Return the names of the values by kind of record."""
        return {kind: list(names) for kind, names in self._columns.items()}

    def _kind(self, path: str, values: Mapping[str, str]) -> str:
        words = [values[name] for name in self._fields if name in values]
        return " ".join([*([path] if path and self._has_paths else []), *words])

    def blocks(self, columns: Sequence[str | int], kind: str | None, rows: int) -> Blocks:
        """Yield the records of a kind; a value that a record lacks is a blank cell. SourceError."""
        known = self._columns.get(kind or "")
        if known is None:
            listed = ", ".join(self._columns)
            raise SourceError(f"{self._path}: no records of kind {kind!r}; it has {printable(listed)[:200]}")
        for column in columns:
            if column not in known:
                raise SourceError(
                    f"{self._path}: no value {column!r}; records have {printable(', '.join(known))[:200]}"
                )
        self._left_out.clear()
        names = [str(column) for column in columns]
        lines: list[int] = []
        cells: list[list[str]] = []
        for line, record in self._records():
            if self._kind(*record) != (kind or ""):
                continue
            lines.append(line)
            cells.append([record[1].get(name, "") for name in names])
            if len(lines) == rows:
                yield self._block(lines, cells)
                lines, cells = [], []
        if lines:
            yield self._block(lines, cells)

    def _block(self, lines: Sequence[int], cells: Sequence[Sequence[str]]) -> tuple[CellBlock, list[int]]:
        columns = list(zip(*cells, strict=True))
        return CellBlock(str(self._path), lines, columns), list(range(len(columns)))

    def _records(self) -> Iterator[tuple[int, Record]]:
        """Yield the number of the line (of a document: of the object) and each record."""
        with self._path.open("rb") as raw:
            file = decompress(raw)
            try:
                begin = file.read(_BEGIN_BYTES)
                file.seek(0)
                text = begin.decode("utf-8-sig", WINDOWS_1252).lstrip()
                lines = [line for line in text.split("\n") if line.strip()][:2]
                if text[:1] in ("{", "[") and not (len(lines) > 1 and all(map(_parses, lines))):
                    yield from self._read_document(file)
                    return
                yield from self._read_lines(file, raw)
            except (BadGzipFile, EOFError, zlib.error) as error:
                raise SourceError(f"{self._path}: damaged gzip data: {error}") from None

    def _read_document(self, file: BinaryIO) -> Iterator[tuple[int, Record]]:
        data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise SourceError(
                f"{self._path}: a JSON document of more than {MOST_BYTES} bytes; write an object per line"
            )
        try:
            document = json.loads(data.decode("utf-8-sig", WINDOWS_1252), parse_float=_Number, parse_int=_Number)
        except (ValueError, RecursionError) as error:
            raise SourceError(f"{self._path}: damaged JSON: {printable(str(error))[:120]}") from None
        try:
            yield from enumerate(_flatten(document), start=1)
        except RecursionError:
            raise SourceError(f"{self._path}: JSON that is nested too deeply") from None

    def _read_lines(self, file: BinaryIO, raw: BinaryIO) -> Iterator[tuple[int, Record]]:
        number = 0
        while line := file.readline(MOST_CHARACTERS):
            number += 1
            text = line.decode("utf-8-sig" if number == 1 else "utf-8", WINDOWS_1252).strip("\r\n\0 \x1e,")
            if not text or text.startswith("#"):
                continue
            records = list(_parse_line(text))
            if not records:
                self._left_out["lines"] += 1
            yield from ((number, record) for record in records)
            if number % 4096 == 0:
                self._progress(raw.tell())


class _Number(str):
    """A number of JSON with all its digits."""


def _parse_line(text: str) -> Iterator[Record]:
    """Yield the records of a line; none for a damaged line."""
    if text[0] in "{[":
        try:
            value = json.loads(text, parse_float=_Number, parse_int=_Number)
            yield from _flatten({_ELEMENT: value} if isinstance(value, list) else value)
        except (ValueError, RecursionError):
            return
    elif (point := _INFLUX.fullmatch(text)) is not None:
        tags = dict(tag.split("=", 1) for tag in point["tags"].split(",")[1:])
        fields = dict(field.split("=", 1) for field in point["fields"].split(","))
        values = {name: value.rstrip("iu") for name, value in fields.items() if _NUMBER.fullmatch(value.rstrip("iu"))}
        yield point["measurement"], {**tags, **values, "time": point["time"]}
    elif (frame := _CAN.fullmatch(text)) is not None:
        data = bytes.fromhex(frame["hex"] if frame["hex"] is not None else frame["bytes"])
        words = len(data) // 2
        values = {"time": frame["time"]}
        for order, kind in zip(WORD_ORDERS, ("<i2", ">i2"), strict=True):
            codes = np.frombuffer(data[: 2 * words], kind)
            values |= {f"{order}[{at}]": str(code) for at, code in enumerate(codes.tolist())}
        yield frame["id"].upper(), values


def _flatten(value: Any) -> Iterator[Record]:
    """Yield the records of JSON's objects and lists."""
    yield from _records_of("", value, {})


def _records_of(path: str, value: Any, outer: dict[str, str]) -> Iterator[Record]:
    """Yield the records of a value: an object's own numbers and words, and each element of lists of objects; `outer`
    are the values of the objects around it.
    """
    if isinstance(value, list):
        for element in value:
            if isinstance(element, dict | list):
                yield from _records_of(path, element if isinstance(element, dict) else {_ELEMENT: element}, outer)
        return
    texts: dict[str, str] = {}
    tables: list[tuple[str, Any]] = []
    series: dict[str, list[str]] = {}
    _collect("", value, texts, tables, series)
    all_texts = {**outer, **texts}
    for name, rows in tables:
        yield from _records_of(f"{path}.{name}" if path else name, rows, all_texts)
    by_length: dict[int, dict[str, list[str]]] = {}
    for name, numbers in series.items():
        by_length.setdefault(len(numbers), {})[name] = numbers
    for columns in by_length.values():
        for row in zip(*columns.values(), strict=True):
            yield path, {**outer, **texts, **dict(zip(columns, row, strict=True))}
    if not tables and not series and any(map(_NUMBER.fullmatch, texts.values())):
        yield path, all_texts


_ELEMENT = "value"
"""Name of the elements of lists of lists."""


def _collect(
    name: str, value: Any, texts: dict[str, str], tables: list[tuple[str, Any]], series: dict[str, list[str]]
) -> None:
    """Sort a value into scalars (`texts`), lists of objects (`tables`) and long lists of numbers (`series`)."""
    if isinstance(value, dict):
        for key, item in value.items():
            _collect(f"{name}.{key}" if name else str(key), item, texts, tables, series)
    elif isinstance(value, list):
        if any(isinstance(item, dict) for item in value) or (value and all(isinstance(item, list) for item in value)):
            tables.append((name, value))
        elif len(value) > MOST_COLUMNS:
            series[name] = [item if isinstance(item, str) else "" for item in value]
        else:
            texts.update({f"{name}[{at}]": item for at, item in enumerate(value) if isinstance(item, str)})
    elif isinstance(value, str):
        texts[name] = value


def _kind_fields(records: Sequence[tuple[int, Record]]) -> list[str]:
    """Return the fields with few different values, which distinguish kinds of records."""
    words: dict[str, set[str]] = {}
    numeric: set[str] = set()
    for _, (_, values) in records:
        for name, value in values.items():
            if _NUMBER.fullmatch(value):
                numeric.add(name)
            elif len(words.setdefault(name, set())) <= MOST_KINDS:
                words[name].add(value)
    return [
        name
        for name, different in words.items()
        if name not in numeric and 1 < len(different) <= MOST_KINDS and not any(_DATE.match(word) for word in different)
    ]

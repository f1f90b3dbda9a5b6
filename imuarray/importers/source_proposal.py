"""Propose a map of a recording of any kind, by its names and numbers.

A recording is one table, a table with rows of several kinds, a folder of tables, or a file of several tables; each is
split into tables of one kind (`imuarray.importers.text_layout`), and the meaning of their columns is inferred
(`imuarray.importers.column_meaning`).
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import SourceError
from imuarray.importers.column_meaning import (
    MOST_INSTANCES,
    QUATERNION,
    instance_column,
    kind_column,
    propose_columns,
    propose_kind,
    words_of_kind,
)
from imuarray.importers.column_names import TIME, is_of_a_quantity, quantity_of, units_below_header
from imuarray.importers.mapping import parse_map
from imuarray.importers.proposal import Item, Proposal, increases, is_time_of_rows, time_lines
from imuarray.importers.records import FIRST_WORDS, WORD_ORDERS
from imuarray.importers.sources import ZIP, RecordingRows, open_rows, reader_of, stem_of, texts_in, unpack_texts
from imuarray.importers.text_layout import (
    INVERTED_Y,
    LOOKED_AT_ROWS,
    TextLayout,
    columns_of,
    dates_of,
    names_by_kind,
    note_days,
    quote,
    read_text,
)
from imuarray.importers.triad_behaviour import is_gravity
from imuarray.printable import listed as listed_names


def propose_map(path: Path, *, join_parts: bool = True) -> Proposal:
    """Propose a map of a recording; SourceError if nothing in it is recognised. With `join_parts`, files of a folder
    that have the same columns and begin one after the other are assumed to be parts of one recording.
    """
    reader = reader_of(path)
    if reader == ZIP:
        return _propose_zip(path, join_parts)
    if reader is not None:
        return _propose_tables(path, is_text=reader in ("records", "row_files"), is_bag=reader == "bags")
    if path.is_dir():
        return _propose_folder(path, join_parts)
    layout, names, rows = read_text(path)
    if layout.kind_column is not None:
        return _propose_kinds(layout, rows, path)
    return _propose_table(_Text(layout, names, rows, stem_of(path)))


def _propose_zip(path: Path, join_parts: bool) -> Proposal:
    folder = unpack_texts(path)
    try:
        proposal = _propose_folder(folder, join_parts)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    proposal.doubts = [text.replace(f"{folder}/", "") for text in proposal.doubts]
    return proposal


def _propose_kinds(layout: TextLayout, rows: Sequence[Sequence[str]], path: Path) -> Proposal:
    """Propose a map of a text with the kind at the beginning of each row."""
    kinds = sorted({row[0] for row in rows})
    proposal = Proposal(layout, ["column = 1   # ?", 'unit = "ms"   # ?'])
    if len(kinds) > 1:
        proposal.doubts.append(f"rows of several kinds: {', '.join(kinds)[:100]}; each sensor needs kind and columns")
    force_unit = ""
    described = {kind: _full_labels(kind) for kind in kinds} if layout.labels else names_by_kind(path)
    for kind in _number_kinds(proposal, kinds, described, rows):
        if kind in described:
            _propose_described(proposal, kind, described[kind], rows)
            continue
        of_kind = [row for row in rows if row[0] == kind and len(row) >= _KIND_TIME_AND_TRIAD]
        if not of_kind:
            continue
        cells = columns_of([row[: len(of_kind[0])] for row in of_kind], layout)
        if len(cells) >= _KIND_TIME_AND_TRIAD + 3 and increases(cells[1]):
            _propose_described(proposal, kind, [""] * (len(of_kind[0]) - 1), of_kind)
            continue
        if increases(cells[1]) and not proposal.items:
            proposal.time = time_lines([], cells, 1, {}, proposal)
        force_unit = propose_kind(proposal, kind, cells, force_unit)
    return proposal


_KIND_TIME_AND_TRIAD = 5
"""Columns of rows with their kind, their time, and a triad."""


def _propose_tables(path: Path, is_text: bool, is_bag: bool) -> Proposal:
    """Propose a map of a recording of several tables with names: arrays, messages of a bag, records of a text."""
    source = open_rows(path, path.with_suffix(".guess"), parse_map(_PROBE, "guess"), lambda done: None)
    proposal = Proposal(TextLayout())
    for kind, names in source.names().items():
        if is_text:
            _propose_records(proposal, source, kind, names)
            continue
        columns = [_first_values(source, name, kind) for name in names]
        if is_bag:
            filled_names, columns = _drop_empty(names, columns)
            partial = propose_columns(TextLayout(), filled_names, columns, {}, units=_ROS_UNITS)
        else:
            partial = propose_columns(TextLayout(), list(names), columns, {})
        if kind and len(partial.items) == 1:
            _name_by_topic(partial.items[0], kind)
        _add_kind(proposal, kind, partial)
    if is_text and not proposal.items:
        raise SourceError(f"{path}: no readings of a sensor are recognised: {'; '.join(proposal.doubts)}")
    return proposal


def _propose_records(proposal: Proposal, source: RecordingRows, kind: str, names: Sequence[str]) -> None:
    columns_of_kind, stem = _words_of_frames(source, kind, names) if FIRST_WORDS.issubset(names) else (names, kind)
    rows = _first_rows(source, kind, columns_of_kind)
    if len(rows) < 2:
        proposal.doubts.append(f"left out: the only row of kind {kind!r}")
        return
    columns = columns_of(rows, TextLayout())
    partial = propose_columns(
        TextLayout(), list(columns_of_kind), columns, _dates_of_rows(rows, columns_of_kind, columns), stem
    )
    if not partial.items:
        proposal.doubts.append(f"left out: rows of kind {kind!r}, which have no triad that is known by its name")
        return
    _add_kind(proposal, kind, partial)


def _first_values(source: RecordingRows, name: str, kind: str) -> Floats:
    """Return the first values of a column of numbers; an empty array for another column."""
    for block, places in source.blocks([name], kind or None, LOOKED_AT_ROWS):
        values = block.column(places[0], name).values
        return np.zeros(0) if values is None else np.asarray(values, np.float64)
    return np.zeros(0)


def _words_of_frames(source: RecordingRows, kind: str, listed: Sequence[str]) -> tuple[list[str], str]:
    """Return the columns of frames of a CAN bus in the byte order that gives the smoother values, and the quantity
    inferred from their length.
    """
    numbers = {}
    for order in WORD_ORDERS:
        names = [name for name in listed if name.startswith(order)][:3]
        numbers[order] = columns_of(_first_rows(source, kind, names), TextLayout())
    rough = {order: sum(float(np.abs(np.diff(each)).sum()) for each in columns) for order, columns in numbers.items()}
    best = min(rough, key=lambda order: rough[order])
    quantity = "acceleration" if len(numbers[best]) == 3 and is_gravity(numbers[best], (0, 1, 2)) else "angular rate"
    return [*[name for name in listed if name.startswith(best)][:3], "time"], quantity


def _first_rows(source: RecordingRows, kind: str, names: Sequence[str]) -> list[list[str]]:
    for block, places in source.blocks(list(names), kind or None, LOOKED_AT_ROWS):
        return [list(row) for row in zip(*(block.column(at, "").texts for at in places), strict=True)]
    return []


def _add_kind(proposal: Proposal, kind: str, partial: Proposal) -> None:
    """Add the proposal for the rows of a kind ("" for a single kind)."""
    for item in partial.items:
        if kind:
            item.insert(2, f"kind = {quote(kind)}")
        names = {other.name for other in proposal.items}
        numbered = (f"{item.name.rstrip('0123456789')}{number}" for number in range(2, len(names) + 3))
        item.call(next(name for name in (item.name, *numbered) if name not in names))
        if proposal.time and partial.time[:1] != proposal.time[:1] and partial.time[0].startswith("column"):
            item += [] if item.line("time_column") else ["time_" + partial.time[0]]
        proposal.items.append(item)
    proposal.time = proposal.time or partial.time
    proposal.doubts += [f"{kind}: {text}" if kind else text for text in partial.doubts]


class _Text(NamedTuple):
    """The layout, the columns' names and some rows of a text, and the name of its file without suffix."""

    layout: TextLayout
    names: list[str]
    rows: list[list[str]]
    stem: str


def _propose_table(text: _Text) -> Proposal:
    """Propose a map of a text with one table. Its rows may belong to several instances of a sensor."""
    columns = columns_of(text.rows, text.layout)
    note_days(text.layout, text.rows)
    dates = _dates_of_rows(text.rows, text.names, columns)
    units = units_below_header(text.layout, text.names)
    words = kind_column(text.names, text.rows)
    instance = instance_column(text.names, columns) if words is None else words
    if instance is None:
        proposal = propose_columns(text.layout, text.names, columns, dates, text.stem, units)
        date = next(iter(dates), None)
        if date is not None and len({row[date] for row in text.rows}) < len(text.rows):
            proposal.time.append("ties = true   # rows with equal times")
        return proposal
    text.layout.kind_column = instance
    proposal = Proposal(text.layout)
    kinds = [row[instance].strip() for row in text.rows]
    called = {kind: words_of_kind(kind, text.names[instance]) for kind in sorted(set(kinds))}
    is_named = any(map(is_of_a_quantity, called.values()))
    for kind, name in called.items():
        if is_named and not is_of_a_quantity(name):
            proposal.doubts.append(f"left out: rows of kind {kind!r}, whose name states no quantity")
            continue
        chosen = np.array([other == kind for other in kinds])
        stem = name if is_named else text.stem
        of_kind = [column[chosen] for column in columns]
        partial = propose_columns(text.layout, text.names, of_kind, dates, stem, units)
        if partial.attitudes and not partial.items:
            proposal.doubts.append(f"left out: rows of kind {kind!r}: {QUATERNION}")
            continue
        _add_kind(proposal, kind, partial)
    return proposal


def _dates_of_rows(rows: Sequence[Sequence[str]], names: Sequence[str], columns: Sequence[Floats]) -> dict[int, str]:
    """Return the columns of dates and the unit of each; empty if the dates are those of packets and another column has
    the time of each row.
    """
    dates = dates_of(rows)
    different = len({row[min(dates)] for row in rows}) if dates else 0
    if not dates or different == len(rows):
        return dates
    named = list(zip(names, columns, strict=False))
    if different >= _FEW_DATES * len(rows):  # rounded dates, unless another column has times of its own for all rows
        is_timed = any(TIME.search(name) and len(np.unique(values)) > different for name, values in named)
    else:
        is_timed = any(is_time_of_rows(name, values) for name, values in named)
    return {} if is_timed else dates


_FEW_DATES = 0.5
"""Number of different dates, as a share of the rows, below which a column of numbers is preferred as the time."""


class _FolderFile(NamedTuple):
    """A text of a folder: its name without suffix, its path, the names of its columns, its proposal, and the times of
    its first rows (empty if they are not known).
    """

    name: str
    path: Path
    names: list[str]
    partial: Proposal
    times: Floats


def _propose_folder(folder: Path, join_parts: bool) -> Proposal:
    """Propose a map of a folder with a text for each sensor, or with texts that are parts of one recording."""
    doubts: list[str] = []
    files = list(_files_with_readings(folder, doubts))
    if not files:
        raise SourceError(f"{folder}: no file in this folder contains readings: {'; '.join(doubts)}")
    proposal = Proposal(files[0].partial.layout)
    parts = list(_successive_parts(files))
    if join_parts:
        proposal.layout.parts = [[file.name for file in group] for group in parts]
    continued = {name for group in proposal.layout.parts for name in group[1:]}
    begun = {group[0] for group in proposal.layout.parts}
    for file in files:
        if file.name in continued:
            continue
        for item in file.partial.items:
            if len(file.partial.items) == 1 and _NAME.fullmatch(file.name) and file.name not in begun:
                item.call(file.name)
        _add_kind(proposal, file.name, file.partial)
    proposal.doubts += doubts
    if not join_parts:
        proposal.doubts += [
            f"{listed_names([file.path.name for file in group])} have the same columns and begin one after the other:"
            " if they are parts of one recording, enter them as parts; here they are different sensors"
            for group in parts
        ]
    return proposal


def _files_with_readings(folder: Path, doubts: list[str]) -> Iterator[_FolderFile]:
    """Yield the texts of a folder from which sensors can be proposed, all with the layout of the first one; add a doubt
    for each other file.
    """
    layout_lines: list[str] | None = None
    is_named = sum(bool(quantity_of(name)) for name in texts_in(folder)) > 1
    for name, path in texts_in(folder).items():
        try:
            layout, names, rows = read_text(path)
        except SourceError as error:
            doubts.append(f"left out: {error}")
            continue
        if is_named and not names and not quantity_of(name):
            doubts.append(f"left out: {path.name}: neither its name nor its columns state a quantity")
            continue
        units = units_below_header(layout, names)
        columns = columns_of(rows, layout)
        note_days(layout, rows)
        partial = propose_columns(layout, names, columns, _dates_of_rows(rows, names, columns), name, units)
        if not partial.items and partial.attitudes:
            doubts.append(f"left out: {path.name}: {QUATERNION}")
            continue
        if not partial.items:
            doubts.append(f"left out: {path.name} has no triad, temperature or pressure that is known by its name")
            continue
        layout_lines = layout_lines or ["", *layout.lines()]
        if ["", *layout.lines()] != layout_lines:
            doubts.append(f"left out: {path.name} has another layout than the other files")
            continue
        timed = (values for each, values in zip(names, columns, strict=False) if is_time_of_rows(each, values))
        yield _FolderFile(name, path, names, partial, next(timed, np.zeros(0)))


def _successive_parts(files: Iterable[_FolderFile]) -> Iterator[list[_FolderFile]]:
    """Yield groups of files of equal columns, in the order in which they begin: they may be parts of one recording."""
    by_columns: dict[tuple[str, ...], list[_FolderFile]] = {}
    for file in files:
        if len(file.times):
            by_columns.setdefault(tuple(file.names), []).append(file)
    for group in by_columns.values():
        group.sort(key=lambda file: float(file.times[0]))
        spans = [float(file.times[-1] - file.times[0]) for file in group]
        begins = [float(file.times[0]) for file in group]
        if len(group) > 1 and all(b - a > _LATER * span for a, b, span in zip(begins, begins[1:], spans, strict=False)):
            yield group


_LATER = 0.1
"""Difference between the first times of two files, as a share of the duration of the first file, above which they are
parts and not files of different sensors of one recorder.
"""


def _drop_empty(names: Sequence[str], columns: Sequence[Floats]) -> tuple[list[str], list[Floats]]:
    """Return the columns with at least one number: an Imu message from a gyroscope alone has no acceleration."""
    filled = [(name, values) for name, values in zip(names, columns, strict=True) if np.isfinite(values).any()]
    return [name for name, _ in filled], [values for _, values in filled]


def _name_by_topic(item: Item, topic: str) -> None:
    """Set the name of an item from the topic of one sensor of an array."""
    name = topic.removeprefix(_SENSOR_TOPICS).replace("/", "_")
    if topic.startswith(_SENSOR_TOPICS) and _NAME.fullmatch(name):
        item.call(name)


_SENSOR_TOPICS = "/sensors/"
"""Beginning of the topics that `imuarray export --tool ros2` writes."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
_ROS_UNITS: Mapping[str, str] = {
    "linear_acceleration.x": "m/s2", "angular_velocity.x": "rad/s", "magnetic_field.x": "T",
    "fluid_pressure": "Pa", "temperature": "degC",
}  # fmt: skip
"""Units of the columns of `sensor_msgs` (REP 103); for triads, keyed by the first column."""
_PROBE = """
time = { rate_hz = 1 }
sensor = [{ name = "A", chip = "a", quantity = "angular_rate", columns = [0, 1, 2], unit = "dps" }]
"""
"""A dummy map with which binary files are opened."""


def _full_labels(kind: str) -> list[str]:
    """Return the labels of a row, completed with the words and the unit that several labels share but programs write
    once: "Acceleration X", "Y", "Z [m/s^2]", "Rotation X", "Y", "Z [rad/s]".
    """
    names: list[str] = []
    stem, first = "", 0
    for label in kind.split(","):
        if not re.fullmatch(r"[A-Za-z]( \[[^]]*\])?", label):
            stem, first = label.rstrip("xX"), len(names)
            stem = "" if stem == label else stem
        names.append(stem + label if stem and len(names) > first else label)
        unit = re.search(r" \[[^]]*\]$", label)
        if unit and stem:
            names[first:] = [name if name.endswith("]") else name + unit[0] for name in names[first:]]
    return names


def _number_kinds(
    proposal: Proposal, kinds: list[str], described: dict[str, list[str]], rows: Sequence[Sequence[str]]
) -> list[str]:
    """Return the kinds of rows; if a column numbers the sensors of a kind (an ArduPilot log has several IMU), return
    the kinds with these numbers and add that column to the map's `kind_column`. Kinds without a number in that column
    are omitted.
    """
    places = set()
    for kind in kinds:
        names = described.get(kind, [])
        of_kind = [row[1 : len(names) + 1] for row in rows if row[0] == kind and len(row) > len(names)]
        if names and len(of_kind) > 1:
            place = instance_column(names, columns_of(of_kind, proposal.layout))
            places |= set() if place is None else {place + 1}
    if len(places) != 1:
        return kinds
    (place,) = places
    numbered = []
    for kind in kinds:
        numbers = {row[place].strip() for row in rows if row[0] == kind and len(row) > place}
        if len(numbers) <= MOST_INSTANCES:
            for number in sorted(numbers):
                described[f"{kind} {number}"] = described.get(kind, [])
                numbered.append(f"{kind} {number}")
    proposal.layout.kind_column = [0, place]
    return [kind for kind in numbered if described[kind]]


def _propose_described(proposal: Proposal, kind: str, names: list[str], rows: Sequence[Sequence[str]]) -> None:
    """Propose the sensors of a kind of rows with named columns after that of the kind."""
    layout = proposal.layout
    named = [name or f"#{number}" for number, name in enumerate(names)]  # for example time stamps have no label
    places = layout.kind_column if isinstance(layout.kind_column, list) else [0]
    of_kind = (row for row in rows if len(row) > len(names) and " ".join(row[at].strip() for at in places) == kind)
    cells = columns_of([row[1 : len(names) + 1] for row in of_kind], layout)
    if not cells or len(cells[0]) < 2:
        return
    partial = propose_columns(layout, named if any(names) else [], cells, {})
    if not partial.items:
        return

    def place_in_row(column: re.Match[str]) -> str:
        return str(1 + (int(column[2]) if column[1] is None else named.index(column[1])))

    for lines in (*partial.items, partial.time):
        for place, line in enumerate(lines):
            if re.match(r"\w*columns? = ", line):
                lines[place] = re.sub(r'"([^"]*)"|\b(\d+)\b', place_in_row, line)
    if kind in INVERTED_Y:
        for item in partial.items:
            item.append('signs = "+-+"   # the y axis of this sentence is inverted')
    if not proposal.items:
        proposal.time = partial.time
    _add_kind(proposal, kind, partial)

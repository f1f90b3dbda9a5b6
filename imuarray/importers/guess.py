"""Propose a map of a recording, with doubts as comments, for a person to edit.

A recording is one table, a table with rows of several kinds, a folder of tables, or a binary file of several topics;
each is split into tables of one kind (`imuarray.importers.text_layout`), whose columns get a meaning
(`imuarray.importers.column_meaning`). The proposal is then tested by an import (`imuarray.importers.table`): the doubts
in its report become comments, and a unit or scale that the recording contradicts is corrected.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice, pairwise
from math import log as ln
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.errors import ImuArrayError, SourceError
from imuarray.importers.column_meaning import (
    COMPUTED,
    COUNTS_OF_GYROSCOPE,
    UNIT_MG,
    UNKNOWN_RATE,
    Proposal,
    increases,
    instance_column,
    is_gravity,
    is_in_mg,
    is_of_a_quantity,
    is_time_of_rows,
    kind_column,
    propose_columns,
    propose_kind,
    quantity_of,
    time_lines,
    units_below_header,
    words_of_kind,
)
from imuarray.importers.mapping import parse_map
from imuarray.importers.mimu4444 import is_recording
from imuarray.importers.plausibility import radii_of, report_of, turns_of
from imuarray.importers.records import FIRST_WORDS, WORD_ORDERS
from imuarray.importers.resolution import MOST_BITS, SENSITIVITIES, WIDE_SENSITIVITIES
from imuarray.importers.sources import ZIP, RecordingRows, open_rows, reader_of, stem_of, texts_in, unpack_texts
from imuarray.importers.table import import_table
from imuarray.importers.text_layout import (
    INVERTED_Y,
    LOOKED_AT_ROWS,
    TextLayout,
    columns_of,
    dates_of,
    names_by_kind,
    quoted,
    read_text,
)
from imuarray.log import Log, open_log
from imuarray.printable import listed as listed_names
from imuarray.units import UNITS_OF

_MIMU4444 = 'file = { format = "mimu4444" }'

_SAME_SCALE = 0.25
"""Log ratio of these rotations that quick motion can make."""
_NEAR_UNIT = 0.3
"""Greatest log ratio between the rotation of gravity and that by a gyroscope at which a unit explains it."""


def guess_map(source: str | Path) -> str:
    """Return a map of the recording `source` as TOML text; SourceError if it contains nothing that a map
    can describe.
    """
    path = Path(source)
    if path.is_file() and is_recording(path):
        return f"# Map of {path.name}: packets of a MIMU4444 board, which say the rest.\n{_MIMU4444}\n"
    proposal = _propose_map(path)
    _leave_out_computed(proposal)
    head = [f"Proposed map of {path.name}: check and correct it, and enter chips, axes and ranges."]
    trial = _try_import(proposal.text([]), path)
    if trial.is_refused and not any(line.startswith(("rate_hz", "wraps_at")) for line in proposal.time):
        trial = _try_sorted(proposal, path) or _try_restarts(proposal, path) or trial
    if _leave_out_weightless(proposal, trial.doubts):
        trial = _try_import(proposal.text([]), path)
    if _correct_milli(proposal, trial.radii):
        trial = _try_import(proposal.text([]), path)
    is_corrected = trial.factor is not None and _correct_scale(proposal, trial.factor)
    if is_corrected or _correct_quiet_unit(proposal, trial):
        trial = _try_import(proposal.text([]), path)
    if trial.factor is not None and _correct_rate(proposal, trial.factor):
        trial = _try_import(proposal.text([]), path)
    proposal.remarks += [text for text in trial.remarks if text not in proposal.remarks]
    proposal.doubts += [text for text in trial.doubts if text not in proposal.doubts]
    return proposal.text(head)


class _Trial(NamedTuple):
    """An import with a proposed map: its remarks, its doubts, the error factor of the gyroscope's scale (None if
    unknown), the least interval of rows as a share of the usual one, and the longest as a share of the recording;
    the `radii` of gravity in all directions by accelerometer, in g.
    """

    remarks: list[str]
    doubts: list[str]
    factor: float | None = None
    least_interval: float = 0.0
    longest_gap: float = 0.0
    is_refused: bool = False
    radii: Mapping[str, float] = MappingProxyType({})


_FITTING = 0.5
"""Least interval of rows that were sorted, as a share of the usual one, at which all of them fit between the others: a
clock that was set back, or stamps of arrival that are early, put rows closer together.
"""


def _try_sorted(proposal: Proposal, path: Path) -> _Trial | None:
    """Add `sort = true` to the proposal if rows come late and fit between the others; None if that is no remedy."""
    line = "sort = true   # rows are out of order, and fit between the others"
    proposal.time.append(line)
    trial = _try_import(proposal.text([]), path)
    if trial.is_refused or trial.least_interval < _FITTING or trial.longest_gap > _OPENED:
        proposal.time.remove(line)
        return None
    return trial


def _try_restarts(proposal: Proposal, path: Path) -> _Trial | None:
    """Add `restarts = true` to the proposal, if the recording can be imported then."""
    line = "restarts = true   # ? the clock was set back, or started again"
    proposal.time.append(line)
    trial = _try_import(proposal.text([]), path)
    if trial.is_refused:
        proposal.time.remove(line)
        return None
    proposal.doubts.append(
        "the times fall: a clock that was set back, or a recorder that started again. If the file holds several"
        " recordings, import them one by one"
    )
    return trial


_OPENED = 0.25
"""Longest interval of rows that were sorted, as a share of the recording, above which they are not late: a clock that
was set back puts the rest of the recording before its beginning.
"""


def _extreme_intervals(log: Log) -> tuple[float, float]:
    """Return the least interval of the rows of any sensor, as a share of its median, and the longest, as a share of
    the time of all its rows.
    """
    least, longest = [], []
    for sensor in log.sensors.values():
        intervals = [np.diff(np.asarray(sensor.time[block.start : block.stop + 1])) for block in sensor.blocks()]
        steps = np.concatenate([np.zeros(0), *intervals])
        if len(steps):
            least.append(float(steps.min() / max(np.median(steps), 1.0)))
            longest.append(float(steps.max() / max(steps.sum(), 1.0)))
    return min(least, default=1.0), max(longest, default=0.0)


def _try_import(text: str, path: Path) -> _Trial:
    """Import with this map and return what is said of the recording."""
    with TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "map.toml").write_text(text, encoding="utf-8")
        try:
            summary = import_table(path, place / "map.toml", place / "run.h5")
            with open_log(place / "run.h5") as log:
                report = report_of(log)
                remarks = [*summary.remarks, *report.quirks]
                trial = _Trial(remarks, list(report.doubts), turns_of(log), *_extreme_intervals(log))
                return trial._replace(radii=radii_of(log))
        except ImuArrayError as error:
            return _Trial(
                [], [f"cannot be imported as it is: {str(error).replace(folder, '').lstrip('/')}"], is_refused=True
            )


def _label(item: Sequence[str]) -> str:
    """Return what the rows of a sensor are called: their kind, else the name that the map gives it."""
    lines = [line for line in item if line.startswith("kind = ")]
    return (lines or [item[1]])[0].split('"')[1]


def _leave_out(proposal: Proposal, items: Sequence[list[str]], why: str) -> bool:
    """Remove sensors from a proposal and say so; return whether there were any."""
    if items:
        proposal.doubts.append(f"left out: {', '.join(map(_label, items))}: {why}")
        proposal.items = [item for item in proposal.items if not any(item is other for other in items)]
    return bool(items)


def _leave_out_computed(proposal: Proposal) -> None:
    """Leave out triads that software computed from others of the recording: gravity, accelerations without gravity, and
    readings less an estimated bias where those of the chip are there too. They would count as further sensors.
    """
    triads = [item for item in proposal.items if item[0] == "[[sensor]]"]
    forces = [item for item in triads if any(line.startswith('quantity = "specific_force"') for line in item)]
    computed = [item for item in forces if COMPUTED.search(_label(item))]
    if len(computed) < len(forces):
        _leave_out(proposal, computed, "computed by software, according to their names")
    labels = {_label(item).lower() for item in triads}
    corrected = [
        item for item in triads if any(f"{_label(item)}{mark}uncalibrated".lower() in labels for mark in ("", "_", " "))
    ]
    _leave_out(proposal, corrected, "the same chip's uncalibrated readings are kept, whose bias does not jump")


def _leave_out_weightless(proposal: Proposal, doubts: Sequence[str]) -> bool:
    """Leave out accelerometers that do not measure 1 g where others do: a program subtracted gravity."""
    forces = [item for item in proposal.items if any(line.startswith('quantity = "specific_force"') for line in item)]
    names = [item[1].split('"')[1] for item in forces]
    doubted = [
        any(text.startswith(f"{name}: measures ") and "instead of 1 g" in text for text in doubts) for name in names
    ]
    if all(doubted):
        return False
    weightless = [item for item, is_doubted in zip(forces, doubted, strict=True) if is_doubted]
    return _leave_out(proposal, weightless, "no gravity in it, while another accelerometer of the recording has it")


def _correct_milli(proposal: Proposal, radii: Mapping[str, float]) -> bool:
    """Replace 1024 counts per g, guessed from a single direction of gravity, by mg, if all directions say so."""
    changed = False
    for item in proposal.items:
        name = item[1].split('"')[1]
        if not any(line.startswith("sensitivity = 1024 ") for line in item) or name not in radii:
            continue
        length = 1024 * radii[name]
        if is_in_mg(length):
            item[:] = [line for line in item if not line.startswith(("range", "sensitivity", "unit"))]
            item.append(UNIT_MG.format(length))
            changed = True
    return changed


def _correct_scale(proposal: Proposal, factor: float) -> bool:
    """Replace the guessed sensitivity of a gyroscope by that of a data sheet, if a known one fits."""
    for item in proposal.items:
        if _is_gyroscope(item) and factor > 0 and _correct_unit(item, factor):
            return True
        line = next((line for line in item if line.startswith("sensitivity") and "# ?" in line), None)
        if line is None or not _is_gyroscope(item) or factor <= 0 or abs(ln(factor)) < _SAME_SCALE:
            continue
        wanted = COUNTS_OF_GYROSCOPE / factor
        units = {1 / size: unit for unit, size in UNITS_OF["angular_rate"].items() if unit.startswith("m")}
        nearest = min([*SENSITIVITIES["angular_rate"], *units], key=lambda scale: abs(ln(scale / wanted)))
        if nearest == COUNTS_OF_GYROSCOPE:
            return False
        if nearest in units:  # whole numbers of a small unit
            item[:] = [line for line in item if not line.startswith(("range", "sensitivity"))]
            place = next(number for number, text in enumerate(item) if text.startswith("unit"))
            item[place] = f'unit = "{units[nearest]}"   # ? from the rotation of gravity in the accelerometer'
            return True
        item[item.index(line)] = f"sensitivity = {nearest:.6g}   # ? from the rotation of gravity in the accelerometer"
        at = next(number for number, text in enumerate(item) if text.startswith("range"))
        item[at] = f"range = {round(32768 / nearest / 5) * 5}   # ? of 16 bits"
        return True
    return False


_RATES_HZ = (
    10, 12.5, 20, 25, 26, 30, 32, 40, 50, 52, 60, 64, 75, 100, 104, 120, 125, 128, 200, 208, 250, 256, 400, 416, 500,
    512, 800, 1000,
)  # fmt: skip
"""Usual rates of recordings."""
_NEAR_RATE = 0.05
_KNOWN_RATE = 0.1
"""Log ratios up to which a rate is a usual one, and is not doubted."""


def _correct_rate(proposal: Proposal, factor: float) -> bool:
    """Replace a rate of rows that was assumed by the one at which the gyroscope turns as gravity does."""
    line = next((line for line in proposal.time if line == UNKNOWN_RATE), None)
    if line is None or factor <= 0 or abs(ln(factor)) < _KNOWN_RATE:
        return False
    rate_hz = turning_hz = 100 / factor
    nearest = min(_RATES_HZ, key=lambda usual: abs(ln(usual / rate_hz)))
    rate_hz = nearest if abs(ln(nearest / rate_hz)) < _NEAR_RATE else float(f"{rate_hz:.3g}")
    proposal.time[proposal.time.index(line)] = (
        f"rate_hz = {rate_hz:g}   # ? at {turning_hz:.4g} rows a second the gyroscope turns as gravity does"
    )
    proposal.doubts = [
        text.replace("100 rows a second are assumed", "the rate is that at which the gyroscope turns as gravity does")
        for text in proposal.doubts
    ]
    return True


def _is_gyroscope(item: Sequence[str]) -> bool:
    return any(line.startswith('quantity = "angular_rate"') for line in item)


def _correct_quiet_unit(proposal: Proposal, trial: _Trial) -> bool:
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
    if abs(ln(units[nearest] / wanted)) > _NEAR_UNIT:
        return _correct_wide_codes(item, place, 1 / wanted)
    if nearest == guessed or units[nearest] == units[guessed]:
        return False
    item[place] = f'unit = "{nearest}"   # ? from the rotation of gravity in the accelerometer'
    return True


def _correct_wide_codes(item: list[str], place: int, per_dps: float) -> bool:
    """Replace the guessed unit of a gyroscope, the line `place`, by the scale of codes of more than 16 bits, if that
    of a data sheet fits.
    """
    known = min(WIDE_SENSITIVITIES["angular_rate"], key=lambda known: abs(ln(known / per_dps)))
    if abs(ln(known / per_dps)) > _NEAR_UNIT:
        return False
    item[place] = 'unit = "dps"'
    item.append(f"range = {(1 << MOST_BITS - 1) / known:.6g}   # ? of {MOST_BITS} bits")
    item.append(f"sensitivity = {known:.9g}   # ? from the rotation of gravity in the accelerometer")
    return True


def _propose_map(path: Path) -> Proposal:
    """Propose a map from names and numbers."""
    if reader_of(path) == ZIP:
        folder = unpack_texts(path)
        try:
            proposal = _propose_folder(folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        proposal.doubts = [text.replace(f"{folder}/", "") for text in proposal.doubts]
        return proposal
    if path.is_dir() and reader_of(path) is None:
        return _propose_folder(path)
    if reader_of(path) is None:
        layout, names, rows = read_text(path)
        if layout.kind_column is not None:
            kinds = sorted({row[0] for row in rows})
            proposal = Proposal(layout, ["column = 1   # ?", 'unit = "ms"   # ?'])
            if len(kinds) > 1:
                proposal.doubts.append(
                    f"rows of several kinds: {', '.join(kinds)[:100]}; each sensor needs kind and columns"
                )
            force_unit = ""
            described = {kind: _full_labels(kind) for kind in kinds} if layout.labels else names_by_kind(path)
            kinds = _numbered_kinds(proposal, kinds, described, rows)
            for kind in kinds:
                if kind in described:
                    _propose_described(proposal, kind, described[kind], rows)
                    continue
                of_kind = [row for row in rows if row[0] == kind and len(row) >= 5]
                if of_kind:
                    cells = columns_of([row[: len(of_kind[0])] for row in of_kind], layout)
                    if len(cells) >= _KIND_TIME_AND_TRIADS and increases(cells[1]):
                        _propose_described(proposal, kind, [""] * (len(of_kind[0]) - 1), of_kind)
                        continue
                    if increases(cells[1]) and not proposal.items:
                        proposal.time = time_lines([], cells, 1, {}, proposal)
                    force_unit = propose_kind(proposal, kind, cells, force_unit)
            return proposal
        return _propose_table(_Text(layout, names, rows, stem_of(path)))
    map_ = parse_map(_PROBE, "guess")
    source = open_rows(path, path.with_suffix(".guess"), map_, lambda done: None)
    proposal = Proposal(TextLayout())
    for kind, listed in source.names().items():
        if reader_of(path) in ("records", "row_files"):
            chosen, stem = _words_of_frames(source, kind, listed) if FIRST_WORDS.issubset(listed) else (listed, kind)
            rows = _first_rows(source, kind, chosen)
            if len(rows) < 2:
                proposal.doubts.append(f"left out: the only row of kind {kind!r}")
                continue
            columns = columns_of(rows, TextLayout())
            dates = _dates_of_rows(rows, chosen, columns)
            partial = propose_columns(TextLayout(), list(chosen), columns, dates, stem)
            if not partial.items:
                proposal.doubts.append(
                    f"left out: rows of kind {kind!r}, which have no triad that is known by its name"
                )
                continue
            _add_kind(proposal, kind, partial)
            continue
        columns = []
        for name in listed:
            block = next(
                (block.column(at[0], name) for block, at in source.blocks([name], kind or None, LOOKED_AT_ROWS)), None
            )
            columns.append(np.zeros(0) if block is None else _finite(block.values))
        if reader_of(path) == "bags":
            listed, columns = _with_values(listed, columns)
            partial = propose_columns(TextLayout(), list(listed), columns, {}, units=_ROS_UNITS)
        else:
            partial = propose_columns(TextLayout(), list(listed), columns, {})
        if kind and len(partial.items) == 1:
            _name_by_topic(partial.items[0], kind)
        _add_kind(proposal, kind, partial)
    if not proposal.items and reader_of(path) in ("records", "row_files"):
        raise SourceError(f"{path}: no readings of a sensor are recognised: {'; '.join(proposal.doubts)}")
    return proposal


def _words_of_frames(source: RecordingRows, kind: str, listed: Sequence[str]) -> tuple[list[str], str]:
    """Return the columns of frames of a CAN bus in the byte order in which they are smoother, and the quantity that
    their length suggests.
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
    """Return the cells of the first rows of a kind."""
    for block, where in source.blocks(list(names), kind or None, LOOKED_AT_ROWS):
        return [list(row) for row in zip(*(block.column(at, "").texts for at in where), strict=True)]
    return []


def _add_kind(proposal: Proposal, kind: str, partial: Proposal) -> None:
    """Add what is proposed for the rows of a kind ("" if there is one kind)."""
    for item in partial.items:
        if kind:
            item.insert(2, f"kind = {quoted(kind)}")
        names = {other[1] for other in proposal.items}
        stem = item[1].rstrip('"0123456789')
        numbers = (f'{stem}{number}"' for number in range(2, len(names) + 3))
        item[1] = next(name for name in (item[1], *numbers) if name not in names)
        if proposal.time and partial.time[:1] != proposal.time[:1] and partial.time[0].startswith("column"):
            item += [] if any(line.startswith("time_column") for line in item) else ["time_" + partial.time[0]]
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
    """Propose a map of a text with one table, whose rows may be of several instances of a sensor."""
    columns = columns_of(text.rows, text.layout)
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
        _add_kind(proposal, kind, partial)
    return proposal


def _dates_of_rows(rows: Sequence[Sequence[str]], names: Sequence[str], columns: Sequence[Floats]) -> dict[int, str]:
    """Return the columns of dates and the unit of each; none if they are those of packets, while another column has the
    time of each row.
    """
    dates = dates_of(rows)
    if not dates or len({row[min(dates)] for row in rows}) >= _FEW_DATES * len(rows):
        return dates
    named = list(zip(names, columns, strict=False))
    is_timed = any(is_time_of_rows(name, values) for name, values in named)
    return {} if is_timed else dates


_FEW_DATES = 0.5
"""Share of the rows that have a date of their own, below which a column of numbers is the better time."""


def _propose_folder(folder: Path) -> Proposal:
    """Propose a map of a folder with a text for each sensor."""
    proposal: Proposal | None = None
    doubts: list[str] = []
    parts: dict[tuple[str, ...], list[tuple[str, Floats]]] = {}
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
        partial = propose_columns(layout, names, columns, _dates_of_rows(rows, names, columns), name, units)
        if not partial.items:
            doubts.append(f"left out: {path.name} has no triad, temperature or pressure that is known by its name")
            continue
        proposal = proposal or Proposal(layout)
        if layout.lines() != proposal.layout.lines():
            doubts.append(f"left out: {path.name} has another layout than the other files")
            continue
        timed = (values for each, values in zip(names, columns, strict=False) if is_time_of_rows(each, values))
        parts.setdefault(tuple(names), []).extend((path.name, values) for values in islice(timed, 1))
        for item in partial.items:
            if len(partial.items) == 1 and _NAME.fullmatch(name):
                item[1] = f'name = "{name}"'
        _add_kind(proposal, name, partial)
    if proposal is None:
        raise SourceError(f"{folder}: no file in this folder contains readings: {'; '.join(doubts)}")
    proposal.doubts += [*doubts, *_doubted_parts(parts.values())]
    return proposal


def _doubted_parts(files: Iterable[Sequence[tuple[str, Floats]]]) -> Iterator[str]:
    """Yield doubts about files of equal columns, with the times of their first rows, that begin one after the other:
    they may be parts of one recording.
    """
    for same in files:
        begins = sorted((float(times[0]), float(times[-1] - times[0]), name) for name, times in same)
        later = [a[2] for a, b in pairwise(begins) if b[0] - a[0] > _LATER * a[1]]
        if later:
            names = listed_names([name for _, _, name in begins])
            yield (
                f"{names} have the same columns and begin one after the other: if they are parts of one recording, join"
                " them into one file (sort = true puts rows in order); here they are different sensors"
            )


_LATER = 0.1
"""Difference between the beginnings of two files, as a share of the first one's time, that sensors of one recorder do
not have.
"""


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


def _full_labels(kind: str) -> list[str]:
    """Return the labels of a row with the words and the unit that several share, which programs write once:
    "Acceleration X", "Y", "Z [m/s^2]", "Rotation X", "Y", "Z [rad/s]".
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


def _numbered_kinds(
    proposal: Proposal, kinds: list[str], described: dict[str, list[str]], rows: Sequence[Sequence[str]]
) -> list[str]:
    """Return the kinds of rows; if a column numbers the sensors of one (an ArduPilot log has several IMU), those with
    their numbers, which the map's `kind_column` then has, too. Kinds without a number in that column are left out.
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
        if len(numbers) <= _MOST_INSTANCES:
            for number in sorted(numbers):
                described[f"{kind} {number}"] = described.get(kind, [])
                numbered.append(f"{kind} {number}")
    proposal.layout.kind_column = [0, place]
    return [kind for kind in numbered if described[kind]]


_MOST_INSTANCES = 16
_KIND_TIME_AND_TRIADS = 8
"""Columns of rows of a kind, of their time, and of two triads."""


def _propose_described(proposal: Proposal, kind: str, names: list[str], rows: Sequence[Sequence[str]]) -> None:
    """Propose the sensors of a kind of rows whose columns after that of the kind have names."""
    layout = proposal.layout
    named = [name or f"#{number}" for number, name in enumerate(names)]  # values without a label, as stamps are
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

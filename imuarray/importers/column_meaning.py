"""Meaning of the columns of a recording, inferred from their names and, if these do not determine it, from their
values. Time increases; three columns with names that differ in x, y and z are a triad; gravity is 1 g. The result is a
proposed map with its doubts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats
from imuarray.importers.column_names import (
    COMPUTED,
    PRESSURE,
    QUANTITIES,
    TEMPERATURE,
    TIME,
    column_label,
    quantity_of,
    unit_in,
)
from imuarray.importers.mapping import ZERO_OF_UNIT
from imuarray.importers.proposal import (
    Proposal,
    add_own_time,
    increases,
    is_clock,
    propose_barometer,
    propose_sensor,
    propose_thermometer,
    rate_line,
    time_index,
    time_lines,
)
from imuarray.importers.text_layout import TextLayout, quote
from imuarray.importers.triad_behaviour import (
    NamedTriad,
    has_unit_length,
    is_computed_gravity,
    is_gravity,
    is_label,
    is_steady_gravity,
    keeps_its_length,
    triads_by_values,
)
from imuarray.printable import counted, listed
from imuarray.units import UNITS_OF

_QUANTITY_OF_UNIT: Mapping[str, str] = {unit: quantity for quantity, units in UNITS_OF.items() for unit in units}
"""The quantity of each unit; every unit belongs to one quantity."""
_PART = re.compile(r"(.*)\[\d+\]")
_FOURTH: Mapping[str, str] = {"xyz": "w", "XYZ": "W", "012": "3", "123": "0", "ENZ": "\0"}
"""Name of the fourth of four columns, by the names of three that look like a triad; column 0 may be their time.
Seismometers have east, north and up, and no fourth column.
"""
_COMPASS: Mapping[str, str] = {"EW": "E", "NS": "N", "UD": "Z"}
"""Names of east, north and up in the files of K-NET's seismometers, with the letters used here."""
_TRIAD_AND_TIME = 4
"""Maximum number of columns of an array that is one triad, perhaps with its time."""
_ESTIMATE = re.compile(r"bias|drift|offset", re.IGNORECASE)
_VALUES = re.compile(r"v(al(ue)?s?)?[._ ]?\[?\*\]?|[bl]e\[\*\]|\*[._ -]?axis( ?[\[(].*[\])])?", re.IGNORECASE)
"""Names of columns that only state that they contain values or axes, for example those of Android's SensorEvent."""
_QUATERNION = re.compile(r"q(uat)?[._ ]?\*|.*quat.*", re.IGNORECASE)
_INSTANCE = re.compile(
    r"i|id|imu|instance|type|(event\.)?(sensor|device|imu|unit)[ _.]?(id|no|nr|number|index|type)?", re.IGNORECASE
)
_ANDROID_TYPES: Mapping[str, str] = {
    "1": "accelerometer", "2": "magnetic field", "4": "gyroscope", "6": "pressure", "9": "gravity",
    "10": "linear acceleration", "11": "rotation vector", "13": "ambient temperature",
    "14": "magnetic field uncalibrated", "15": "game rotation vector", "16": "gyroscope uncalibrated",
    "20": "geomagnetic rotation vector", "35": "accelerometer uncalibrated",
}  # fmt: skip
"""Constants `TYPE_...` of Android's class Sensor."""


def words_of_kind(kind: str, column: str) -> str:
    """Return the name of a kind of rows: the kind, or the name of a number in Android's column of sensor types."""
    return _ANDROID_TYPES.get(kind, kind) if "type" in column.lower() else kind


QUATERNION = "an attitude that a program computed (a unit quaternion), not a measurement"

MOST_INSTANCES = 16
_ALTERNATES = 0.3


def instance_column(names: Sequence[str], columns: Sequence[Floats]) -> int | None:
    """Return the column with the numbers of the sensors that rows alternate between; None without one."""
    for index, name in enumerate(names[: len(columns)]):
        values = columns[index]
        if not _INSTANCE.fullmatch(name.strip()) or not len(values) or not np.isfinite(values).all():
            continue
        if 1 < len(np.unique(values)) <= MOST_INSTANCES and np.mean(np.diff(values) != 0) > _ALTERNATES:
            return index
    return None


def kind_column(names: Sequence[str], rows: Sequence[Sequence[str]]) -> int | None:
    """Return the column with the names of the sensors that share the other columns; None without one."""
    for index in range(min(len(names), len(rows[0]))):
        words = [row[index].strip() for row in rows]
        kinds = set(words)
        if not 1 < len(kinds) <= MOST_INSTANCES or not all(kind[:1].isalpha() for kind in kinds):
            continue
        if sum(any(pattern.search(kind) for _, pattern in QUANTITIES) for kind in kinds) > 1:
            return index
    return None


def _drop_padding(columns: Sequence[Floats]) -> list[Floats]:
    """Remove the rows of zeros at the end, which a program reserved and did not fill."""
    if not columns or len({len(column) for column in columns}) > 1 or not len(columns[0]):
        return list(columns)
    filled = np.flatnonzero(np.any([column != 0 for column in columns], axis=0))
    return [column[: int(filled[-1]) + 1] if len(filled) else column for column in columns]


def propose_columns(
    layout: TextLayout,
    names: list[str],
    columns: Sequence[Floats],
    dates: Mapping[int, str],
    stem: str = "",
    units: Mapping[str, str] = MappingProxyType({}),
) -> Proposal:
    """Propose a map of a table with or without names of columns; `units` are the known units by column."""
    proposal = Proposal(layout, units=units)
    if names and any(names.count(name) > 1 for name in names):
        proposal.doubts.append("some columns have the same name; they are selected by their indices")
    columns = _drop_padding(columns)
    time = time_index(names, columns, dates)
    if time is not None and time not in dates:
        timed = np.isfinite(columns[time])
        columns = columns if timed.all() else [column[timed[: len(column)]] for column in columns]
    taken = set() if time is None else {time}
    if not names:
        taken |= {index for index, values in enumerate(columns) if is_clock(values)}
    for quaternion in _find_attitudes(names, columns):
        proposal.attitudes.append([column_label(names, index) for index in quaternion])
        quaternion_columns = ", ".join(proposal.attitudes[-1])
        proposal.doubts.append(f"left out: {quaternion_columns}: {QUATERNION}")
        taken |= set(quaternion)
    triads = list(_find_triads(*_tell_apart(names, units), columns, taken, stem))
    triads = _choose_triads(triads, names, columns, proposal)
    triads.sort(key=lambda triad: triad[0] != "specific_force")
    if time is None:
        proposal.time.append(rate_line(proposal))
        if layout.rate_hz is None:
            proposal.doubts.append(f"{_no_time(names, columns)}: 100 rows a second are assumed")
    else:
        proposal.time += time_lines(names, columns, time, dates, proposal)
    force_unit = ""
    for quantity, indices in triads:
        item = propose_sensor(quantity, names, columns, indices, force_unit, proposal)
        force_unit = item.text("unit") if quantity == "specific_force" else force_unit
        add_own_time(item, names, columns, indices[0], (time, dates), proposal)
        proposal.items.append(item)
        taken |= set(indices)
    has_other_quantity = any(_is_temperature(name, units) or PRESSURE.search(name) for name in names)
    if not triads and not has_other_quantity:
        proposal.doubts.append(
            "no three columns whose names differ only in x, y and z, or in 0, 1 and 2: which form a triad?"
        )
    for index, name in enumerate(names[: len(columns)]):
        if index in taken or (TIME.search(re.split(r"[./]", name)[-1]) and increases(columns[index])):
            continue
        known = len(proposal.items)
        if _is_temperature(name, units):
            propose_thermometer(proposal, name, columns[index])
        elif PRESSURE.search(name):
            propose_barometer(proposal, name, columns[index])
        for item in proposal.items[known:]:
            add_own_time(item, names, columns, index, (time, dates), proposal)
    triad_columns = {index for _, indices in triads for index in indices}
    proposal.doubts += _find_incomplete(names[: len(columns)], taken | triad_columns)
    return proposal


def _no_time(names: Sequence[str], columns: Sequence[Floats]) -> str:
    """Return the message that no column is the time, or the fault of a column that is named as a time."""
    for name, values in zip(names, columns, strict=False):
        finite = values[np.isfinite(values)]
        if TIME.search(name) and len(finite):
            different = counted(len(np.unique(finite)), "value")
            return (
                f"column {name!r} has {different} in {counted(len(finite), 'row')}, the first {finite[0]:.9g}, and no"
                " row has a time of its own; if a spreadsheet or single precision rounded it, export it again"
            )
    return "no column increases like time"


_AXIS = re.compile(r"(?<![A-Za-z])[A-Za-z]?[xyz](?![A-Za-z])|(?<![A-Z])[XYZ](?![A-Za-z])")
"""An axis letter in a column's name, with or without a quantity's letter before it: gx_dps, acc_x, AccX."""


def _find_incomplete(names: Sequence[str], taken: set[int]) -> Iterator[str]:
    """Yield a doubt for each quantity with columns of only one or two axes."""
    axes: dict[str, dict[str, str]] = {}
    for index, name in enumerate(names):
        if index in taken or (match := _AXIS.search(name)) is None:
            continue
        place = match.end() - 1
        stem = f"{name[:place]}*{name[place + 1 :]}"
        if _QUANTITY_OF_UNIT.get(unit_in(name)) or quantity_of(stem):
            axes.setdefault(stem, {})[name[place].lower()] = name
    for present in axes.values():
        if len(present) < len("xyz"):
            missing = listed([axis for axis in "xyz" if axis not in present])
            yield (
                f"left out: {', '.join(map(quote, present.values()))}: no column of axis {missing}; a sensor needs"
                " three axes"
            )


def _is_temperature(name: str, units: Mapping[str, str]) -> bool:
    """Return whether a column is named a temperature or has a unit of temperature."""
    return bool(TEMPERATURE.search(name)) or (units.get(name) or unit_in(name)) in ZERO_OF_UNIT


def propose_kind(proposal: Proposal, kind: str, columns: Sequence[Floats], force_unit: str) -> str:
    """Propose the sensor of a kind of rows: time, and the three columns after it. Return "m/s2" once a sensor of this
    table has that unit, else "".
    """
    quantity = next((what for what, words in QUANTITIES if words.search(kind)), "specific_force")
    item = propose_sensor(quantity, [], columns, (2, 3, 4), force_unit, proposal)
    item.insert(2, f"kind = {quote(kind)}")
    proposal.items.append(item)
    return "m/s2" if item.text("unit") == "m/s2" else force_unit


def _tell_apart(names: Sequence[str], units: Mapping[str, str]) -> tuple[list[str], Mapping[str, str]]:
    """Return names of which none occurs twice, and the units by these names: the second column of a name, which belongs
    to another sensor, is called "2.name". Numbers are no names: a GoPro calls the columns after the first "1" and "2".
    """
    times: Counter[str] = Counter()
    apart = []
    for name in names:
        times[name] += bool(name.strip()) and not name.strip().isdigit()
        apart.append(f"{times[name]}.{name}" if times[name] > 1 else name)
    known = {new: units[name] for new, name in zip(apart, names, strict=True) if name in units}
    return apart, {**units, **known}


def _find_triads(
    names: Sequence[str],
    units: Mapping[str, str],
    columns: Sequence[Floats],
    taken: set[int],
    stem_of_file: str,
) -> Iterator[NamedTriad]:
    """Yield the quantity ("" if neither name nor unit states it) and the columns of each triad."""
    if not names:
        free = [index for index in range(len(columns)) if index not in taken and np.isfinite(columns[index]).any()]
        stem_quantity = quantity_of(stem_of_file)
        if stem_quantity and 3 <= len(free) <= _MOST_OF_ONE_SENSOR:
            yield stem_quantity, (free[0], free[1], free[2])
        else:
            yield from _find_nameless_triads(columns, free)
        return
    used: set[int] = set()
    for prefix in dict.fromkeys(match[1] for name in names if (match := _PART.fullmatch(name))):
        parts = [index for index, name in enumerate(names) if (match := _PART.fullmatch(name)) and match[1] == prefix]
        if len(parts) > _TRIAD_AND_TIME:
            yield from _find_nameless_triads(columns, [index for index in parts if index not in taken])
            used.update(parts)
    for index, name in enumerate(names[:-2]):
        if names[index + 1 : index + 3] == ["1", "2"]:
            used.update(range(index, index + 3))
            yield (
                _QUANTITY_OF_UNIT.get(units.get(name) or unit_in(name), quantity_of(name)),
                (index, index + 1, index + 2),
            )
    unit_of = {index: units.get(name) or unit_in(name) for index, name in enumerate(names)}
    names = [re.sub(r"\b(EW|NS|UD)\b", lambda match: _COMPASS[match[0]], name) for name in names]
    for axes in _FOURTH:
        for index, name in enumerate(names):
            for place in (at for at, letter in enumerate(name) if letter == axes[0]):
                stems = [name[:place] + letter + name[place + 1 :] for letter in axes]
                if index in used or not all(stem in names for stem in stems):
                    continue
                fourth, fifth = (f"{name[:place]}{letter}{name[place + 1 :]}" for letter in (_FOURTH[axes], "4"))
                if fourth in names and not np.isfinite(columns[names.index(fourth)]).any():
                    fourth = ""  # this column belongs to rows of other kinds
                is_time = _FOURTH[axes] == "0" and fourth in names and increases(columns[names.index(fourth)])
                if fourth in names and fifth not in names and not is_time:
                    continue  # four numbers are a quaternion, motors or channels
                indices = (names.index(stems[0]), names.index(stems[1]), names.index(stems[2]))
                if used.intersection(indices) or taken.intersection(indices):
                    continue
                used.update(indices)
                stem = name[:place] + "*" + name[place + 1 :]
                if _QUATERNION.fullmatch(stem):
                    continue
                called = stem if stem.strip("*_.- []()") and not _VALUES.fullmatch(stem) else stem_of_file
                yield _QUANTITY_OF_UNIT.get(unit_of[index], quantity_of(called)), indices


def _find_attitudes(names: Sequence[str], columns: Sequence[Floats]) -> Iterator[tuple[int, int, int, int]]:
    """Yield the columns of each unit quaternion, w first, by names that differ in w, x, y, z or in 0 to 3."""
    used: set[int] = set()
    for letters in ("wxyz", "WXYZ", "0123"):
        for index, name in enumerate(names[: len(columns)]):
            for place in (at for at, letter in enumerate(name) if letter == letters[0]):
                stems = [name[:place] + letter + name[place + 1 :] for letter in letters]
                if index in used or not all(stem in names[: len(columns)] for stem in stems):
                    continue
                w, x, y, z = map(names.index, stems)
                if has_unit_length(columns, [w, x, y, z]):
                    used |= {w, x, y, z}
                    yield w, x, y, z


def _add_gravity_again(
    triads: list[NamedTriad], names: Sequence[str], columns: Sequence[Floats], proposal: Proposal
) -> list[NamedTriad]:
    """Return the triads with gravity and the acceleration without gravity combined into one, if the table has no
    readings of an accelerometer.
    """
    forces = [indices for quantity, indices in triads if quantity == "specific_force"]
    if names:
        pulls = [indices for indices in forces if _GRAVITY.search(names[indices[0]])]
        rests = [indices for indices in forces if _FREE.search(names[indices[0]])]
    else:
        pulls = [indices for indices in forces if is_computed_gravity(columns, indices)]
        rests = [(last + 1, last + 2, last + 3) for *_, last in pulls if last + 3 < len(columns)]
        rests = [indices for indices in rests if not any(set(indices) & set(used) for _, used in triads)]
    if len(pulls) != 1 or len(rests) != 1 or len(forces) > len(pulls) + (len(rests) if names else 0):
        return triads
    proposal.gravity[rests[0]] = pulls[0]
    proposal.doubts.append(
        "gravity and acceleration are separate: a program estimated and subtracted it, and it is added again"
        " (gravity_columns); noise and biases are those after its filters"
    )
    return [("specific_force", rests[0]), *(triad for triad in triads if triad[1] not in (*pulls, *rests))]


_GRAVITY = re.compile("grav", re.IGNORECASE)
_FREE = re.compile("user|lin|free", re.IGNORECASE)


def _choose_triads(
    triads: list[NamedTriad], names: Sequence[str], columns: Sequence[Floats], proposal: Proposal
) -> list[NamedTriad]:
    """Return the triads of known quantity; if no quantity is known, all triads are assumed to be specific forces."""

    def first_name(triad: NamedTriad) -> str:
        return names[triad[1][0]] if names else f"column {triad[1][0] + 1}"

    def leave_out(some: Sequence[NamedTriad], why: str) -> None:
        proposal.doubts.append(
            f"left out: {why}: {', '.join(map(first_name, some))}, and the two columns after each of them"
        )

    computed = [triad for triad in triads if triad[0] == "specific_force" and COMPUTED.search(first_name(triad))]
    if computed and any(triad[0] == "specific_force" and triad not in computed for triad in triads):
        leave_out(
            computed,
            "computed by software, according to their names (acceleration without gravity, or gravity)",
        )
        triads = [triad for triad in triads if triad not in computed]
    estimates = [triad for triad in triads if _ESTIMATE.search(first_name(triad))]
    if estimates and len(estimates) < len(triads):
        leave_out(estimates, "estimates of biases, according to their names")
        triads = [triad for triad in triads if triad not in estimates]
    if any(names[second] == "1" for _, (_, second, _) in triads if names):
        proposal.doubts.append(
            "columns that are called 1 and 2 do not say which axes they hold: GoPro writes z, x, y, for example"
        )
    triads = _add_gravity_again(triads, names, columns, proposal)
    identified = [triad for triad in triads if triad[0]]
    if not identified:
        return [("specific_force", indices) for _, indices in triads]
    if not any(quantity == "specific_force" for quantity, _ in identified):
        by_gravity = [triad for triad in triads if not triad[0] and is_steady_gravity(columns, triad[1])]
        triads = [("specific_force", triad[1]) if triad in by_gravity[:1] else triad for triad in triads]
        identified = [triad for triad in triads if triad[0]]
    if unclear := [triad for triad in triads if not triad[0]]:
        leave_out(unclear, "their names state no quantity")
    return identified


_MOST_OF_ONE_SENSOR = 5
"""Largest number of columns besides time in a table of one sensor: axes, possibly an accuracy or a magnitude."""

_PLAIN_COLUMNS = 9
"""Largest number of columns without names that are assumed to be force, rate and field in this order."""


def _find_nameless_triads(columns: Sequence[Floats], free: Sequence[int]) -> Iterator[NamedTriad]:
    """Yield the triads of columns without names: consecutive threes, or among many others those that behave like it.
    The magnitude of specific force is constant under rotation; the first triad is assumed to be a force unless the
    second one behaves like it.
    """
    if len(free) > _PLAIN_COLUMNS or len(free) % 3:
        if triads_by_behaviour := list(triads_by_values(columns, free)):
            yield from triads_by_behaviour
            return
        free = [index for index in free if not is_label(columns[index])]
    triads = [(free[start], free[start + 1], free[start + 2]) for start in range(0, len(free) - 2, 3)][:3]
    triads = [triad for triad in triads if sum(float(np.nanstd(columns[index])) == 0 for index in triad) < 2]
    order = ["specific_force", "angular_rate", "magnetic_field"]
    if len(triads) > 1 and [is_gravity(columns, triad) for triad in triads[:2]] == [False, True]:
        order[:2] = ["angular_rate", "specific_force"]
    elif len(triads) > 1 and is_gravity(columns, triads[1]) and keeps_its_length(columns, triads[1]):
        order[1] = "specific_force"
    yield from zip(order, triads, strict=False)

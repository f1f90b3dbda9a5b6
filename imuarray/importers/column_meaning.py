"""What the columns of a recording mean, by their names and, if these do not help, by their values.

Time increases, three columns whose names differ in x, y and z are a triad, gravity is 1 g. The result is a proposed map
with its doubts.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from math import log as ln
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats
from imuarray.importers.mapping import NS_PER_UNIT
from imuarray.importers.plausibility import RATES_HZ, USUAL_RATES_HZ
from imuarray.importers.resolution import WIDE_SENSITIVITIES, usual_bits
from imuarray.importers.sphere import fit_sphere
from imuarray.importers.text_layout import TextLayout, quoted
from imuarray.printable import printable
from imuarray.units import STANDARD_GRAVITY, UNITS_OF

_WIDTH = 110
_UNIT_IN_NAME = re.compile(
    r"[\[(]\s*([^\])]*?)\s*[\])]"
    r"|_(ms|us|ns|s|g|mg|m_?s2|mps2|m?dps|deg_?s|m?rad_?s|radps|m?gauss|[mun]T|degC|C|K)$"
)
_SPELLINGS: Mapping[str, str] = {
    "m/s^2": "m/s2", "m/s²": "m/s2", "ms-2": "m/s2", "m.s-2": "m/s2", "mps2": "m/s2", "m s^-2": "m/s2",
    "°/s": "dps", "deg/s": "dps", "º/s": "dps", "rad/sec": "rad/s", "radps": "rad/s", "rad s^-1": "rad/s",
    "m/(s^2)": "m/s2", "ms2": "m/s2", "m_s2": "m/s2", "deg_s": "dps", "degs": "dps", "rad_s": "rad/s", "rads": "rad/s",
    "mrad_s": "mrad/s", "mrads": "mrad/s",
    "µt": "uT", "μt": "uT", "ut": "uT", "mgauss": "mgauss",
    "g": "g", "gs": "gauss", "°c": "degC", "c": "degC", "degc": "degC", "sec": "s", "seconds": "s", "msec": "ms",
    "µs": "us", "usec": "us",
}  # fmt: skip
_BEGIN = r"(?<![a-z])"
"""Before a letter that names a quantity: the beginning of the name, or of its last part (`imu0_gx`)."""
_QUANTITIES: Sequence[tuple[str, re.Pattern[str]]] = (
    ("magnetic_field", re.compile(rf"mag|compass|field|{_BEGIN}[mihb]\*", re.IGNORECASE)),
    ("angular_rate", re.compile(rf"gyr|rot|omega|{_BEGIN}ang(?!le)|rate(?!d)|{_BEGIN}(?:[gwpr]|rg)\*", re.IGNORECASE)),
    ("specific_force", re.compile(rf"acc|beschl|force|{_BEGIN}(?:l?a|g?_?f)\*|gravity|lin", re.IGNORECASE)),
)
_QUANTITY_OF_UNIT: Mapping[str, str] = {unit: quantity for quantity, units in UNITS_OF.items() for unit in units}
"""Every unit belongs to one quantity."""
_GRAVITIES = (1.0, STANDARD_GRAVITY, 1000.0, *(2.0**power for power in range(8, 15)))
"""1 g in g, m/s2, mg, and in counts of the usual ranges."""
_NEAR_GRAVITY = 0.15
_NAMES = {"specific_force": "Acc", "angular_rate": "Gyro", "magnetic_field": "Mag"}
_TIME = re.compile(r"time|zeit|stamp|millis|micros|elapsed|^t$|^t[_ \[(]|^(ms|us|sec|seconds)$", re.IGNORECASE)
_TEMPERATURE = re.compile(r"temp|^t_?(die|chip|c)$|degc", re.IGNORECASE)
_PRESSURE = re.compile(r"press|baro|^p$", re.IGNORECASE)
_PRESSURES = {"Pa": 1e5, "hPa": 1e3, "kPa": 1e2, "bar": 1.0}
"""Air pressure at sea level in each unit."""
_COUNTS_OF_MAGNETOMETER = 1090.0
"""Counts per gauss of an HMC5883L after power-up (HMC-21), the most common magnetometer."""
COUNTS_OF_GYROSCOPE = 131.0
_CODES_16 = 1 << 16
_LEAST_MIDDLE = 128.0
_NEAR_MIDDLE = 0.15
_GRAVITY_FROM_MIDDLE = 0.55
"""Least middle of the range of an unsigned converter (8 bits), and the relative distances of the axes' medians from it:
of two axes, and of the one along gravity, which is half of the middle at +-2 g.
"""
_PART = re.compile(r"(.*)\[\d+\]")
_FOURTH: Mapping[str, str] = {"012": "3", "123": "0", "xyz": "w", "XYZ": "W"}
"""What the fourth of four numbers is called, of which three look like a triad; 0 may be their time."""
_TRIAD_AND_TIME = 4
"""Maximum number of columns of an array that is one triad, perhaps with its time."""
COMPUTED = re.compile(r"lin|user|free|grav", re.IGNORECASE)
_ESTIMATE = re.compile(r"bias|drift|offset", re.IGNORECASE)
_VALUES = re.compile(r"v(al(ue)?s?)?[._ ]?\[?\*\]?|[bl]e\[\*\]", re.IGNORECASE)
"""Names of columns that say nothing but that they hold values, as those of Android's SensorEvent."""
_QUATERNION = re.compile(r"q(uat)?[._ ]?\*|.*quat.*", re.IGNORECASE)
_WRAPS = (2.0**32, 2.0**24, 2.0**16)
_INDEX = re.compile(
    r"(sample|row|index|count(er)?|cnt|no|nr|n|i|seq(uence)?|packet|frame)s?[ _]?(no|nr|number|index|count(er)?)?",
    re.IGNORECASE,
)
"""Names of columns that number the rows."""


@dataclass
class Proposal:
    """A map under construction: its lines, remarks and doubts, and the units of columns that are known."""

    layout: TextLayout
    time: list[str] = field(default_factory=list)
    items: list[list[str]] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    units: Mapping[str, str] = field(default_factory=dict)
    gravity: dict[tuple[int, int, int], tuple[int, int, int]] = field(default_factory=dict)
    """Columns of accelerations without gravity, and those of the gravity that was subtracted."""

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


_INSTANCE = re.compile(
    r"i|id|imu|instance|type|(event\.)?(sensor|device|imu|unit)[ _.]?(id|no|nr|number|index|type)?", re.IGNORECASE
)
_ANDROID_TYPES: Mapping[str, str] = {
    "1": "accelerometer", "2": "magnetic field", "4": "gyroscope", "6": "pressure", "9": "gravity",
    "10": "linear acceleration", "13": "ambient temperature", "14": "magnetic field uncalibrated",
    "16": "gyroscope uncalibrated", "35": "accelerometer uncalibrated",
}  # fmt: skip
"""Constants `TYPE_...` of Android's class Sensor."""


def words_of_kind(kind: str, column: str) -> str:
    """Return what a kind of rows is called: itself, or the name of a number in Android's column of sensor types."""
    return _ANDROID_TYPES.get(kind, kind) if "type" in column.lower() else kind


def is_of_a_quantity(words: str) -> bool:
    """Return whether words name a quantity that a map can describe."""
    patterns = [*(pattern for _, pattern in _QUANTITIES), _TEMPERATURE, _PRESSURE]
    return any(pattern.search(words) for pattern in patterns)


MOST_INSTANCES = 16
_ALTERNATES = 0.3


def instance_column(names: Sequence[str], columns: Sequence[Floats]) -> int | None:
    """Return the column that numbers the sensors whose rows alternate; None without one."""
    for index, name in enumerate(names[: len(columns)]):
        values = columns[index]
        if not _INSTANCE.fullmatch(name.strip()) or not len(values) or not np.isfinite(values).all():
            continue
        if 1 < len(np.unique(values)) <= MOST_INSTANCES and np.mean(np.diff(values) != 0) > _ALTERNATES:
            return index
    return None


def is_time_of_rows(name: str, values: Floats) -> bool:
    """Return whether a column has an increasing time for each row: it is called a time, or grows without being called
    a number of the rows.
    """
    if not increases(values):
        return False
    return bool(_TIME.search(name)) or (bool((np.diff(values) > 0).all()) and not _INDEX.fullmatch(name.strip()))


def column_label(names: Sequence[str], index: int) -> str:
    """Return a column as a map names it: by its name, or by its index if it has none of its own."""
    if index >= len(names) or not names[index] or names.count(names[index]) > 1:
        return str(index)
    return quoted(names[index])


def quantity_of(name: str) -> str:
    """Return the quantity that a name states, its last part ("imu.gyro") before the whole; "" if it states none."""
    for part in dict.fromkeys((re.split(r"[./](?!\*)", name)[-1], name)):
        if by_name := next((what for what, words in _QUANTITIES if words.search(part)), ""):
            return by_name
    return ""


def _unit_in(name: str) -> str:
    """Return the unit in a column's name; "" without one."""
    texts = [match[1] or match[2] or "" for match in _UNIT_IN_NAME.finditer(name)]
    units = [_SPELLINGS.get(text.lower(), text) for text in texts]
    return next((unit for unit in units if unit and not unit.isdigit()), "")


def units_below_header(layout: TextLayout, names: Sequence[str]) -> dict[str, str]:
    """Return the units of columns by name, as a row below the header has them."""
    units = {
        name: _unit_in(f"[{cell.strip().strip('[]()')}]") for name, cell in zip(names, layout.unit_cells, strict=False)
    }
    return {name: unit for name, unit in units.items() if unit}


def kind_column(names: Sequence[str], rows: Sequence[Sequence[str]]) -> int | None:
    """Return the column whose words name the sensors that share the other columns; None without one."""
    for index in range(min(len(names), len(rows[0]))):
        words = [row[index].strip() for row in rows]
        kinds = set(words)
        if not 1 < len(kinds) <= MOST_INSTANCES or not all(kind[:1].isalpha() for kind in kinds):
            continue
        if sum(any(spelt.search(kind) for _, spelt in _QUANTITIES) for kind in kinds) > 1:
            return index
    return None


def _without_padding(columns: Sequence[Floats]) -> list[Floats]:
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
    """Propose a map of a table whose columns may have names; `units` of those whose unit is known."""
    proposal = Proposal(layout, units=units)
    if names and any(names.count(name) > 1 for name in names):
        proposal.doubts.append("some columns have the same name; they are selected by their indices")
    columns = _without_padding(columns)
    time = _time_index(names, columns, dates)
    if time is not None and time not in dates:
        timed = np.isfinite(columns[time])
        columns = columns if timed.all() else [column[timed[: len(column)]] for column in columns]
    taken = set() if time is None else {time}
    triads = _with_quantity(list(_triads(names, columns, taken, stem, units)), names, columns, proposal)
    triads.sort(key=lambda triad: triad[0] != "specific_force")
    if time is None:
        proposal.time.append(rate_line(proposal))
        if layout.rate_hz is None:
            proposal.doubts.append("no column increases like time: 100 rows a second are assumed")
    else:
        proposal.time += time_lines(names, columns, time, dates, proposal)
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


UNKNOWN_RATE = "rate_hz = 100   # ? enter the true rate"
"""The line of `[time]` for rows of unknown rate."""


def rate_line(proposal: Proposal) -> str:
    """Return the line of `[time]` for rows without times: the rate that the recording states, or a guess."""
    layout = proposal.layout
    if layout.rate_hz is None:
        return UNKNOWN_RATE
    return f"rate_hz = {layout.rate_hz:g}   # stated by {printable(layout.rate_source)[:80]}"


def _add_own_time(
    item: list[str],
    names: Sequence[str],
    columns: Sequence[Floats],
    first: int,
    time: tuple[int | None, Mapping[int, str]],
    proposal: Proposal,
) -> None:
    """Add the time column of a sensor to its lines, if it is not that of the table, `time`, which may be a date."""
    own = _own_time(names[first], names, columns, time[0]) if names else None
    if own is None:
        return
    label = column_label(names, own)
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


def propose_kind(proposal: Proposal, kind: str, columns: Sequence[Floats], force_unit: str) -> str:
    """Propose the sensor of a kind of rows: time, and the three columns after it. Return "m/s2" once a sensor of this
    table has that unit, else "".
    """
    quantity = next((what for what, words in _QUANTITIES if words.search(kind)), "specific_force")
    item, unit = _sensor(quantity, [], columns, (2, 3, 4), force_unit, proposal)
    number = sum(other[1].startswith(f'name = "{_NAMES[quantity]}') for other in proposal.items)
    item[1] = f'name = "{_NAMES[quantity]}{number + 1 if number else ""}"'
    item.insert(2, f"kind = {quoted(kind)}")
    proposal.items.append(item)
    return "m/s2" if unit == "m/s2" else force_unit


def _time_index(names: Sequence[str], columns: Sequence[Floats], dates: Mapping[int, str]) -> int | None:
    """Return the column of time: named so, and increasing (a counter may wrap, rows may be out of order)."""
    if dates:
        return min(dates)
    increasing = [index for index, values in enumerate(columns) if increases(values)]
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
        and increases(columns[index][np.isfinite(columns[index])])
    ]
    best = max(fitting, key=common, default=None)
    return None if best is None or (time is not None and common(time) >= common(best)) else best


_OWN_PREFIX = 2


def increases(values: Floats) -> bool:
    """Return whether values (n,) increase like time: all but a hundredth of the steps, as a counter may wrap."""
    known = values[np.isfinite(values)]
    if len(known) < _MOSTLY_KNOWN * len(values):
        return False
    steps = np.diff(known)
    return len(steps) > 1 and float(np.mean(steps < 0)) < 1e-2 and steps.max() > 0


_MOSTLY_KNOWN = 0.5
"""Least share of rows that have a time: events between readings may have none."""


def time_lines(
    names: Sequence[str],
    columns: Sequence[Floats],
    index: int,
    dates: Mapping[int, str],
    proposal: Proposal,
) -> list[str]:
    """Return the lines of `[time]` for the column `index`; adds doubts to the proposal."""
    name = names[index] if index < len(names) else ""
    lines = [f"column = {column_label(names, index)}"]
    if index in dates:
        month = "   # ? the month may come after the day: %d/%m" if dates[index].startswith("%m/") else ""
        return [*lines, f"unit = {quoted(dates[index])}{month}"]
    values = columns[index]
    steps = np.diff(values)
    if name.lower() == "sampletimefine":
        is_coarse = 1e4 / max(_unit_of_time("us", values)[1], 1e-9) >= USUAL_RATES_HZ[0]
        ticks_line = ["ticks = 100   # of Xsens: a clock of 10 kHz"] if is_coarse else []
        return [*lines, 'unit = "us"', *ticks_line, "wraps_at = 4294967296"]
    said = proposal.units.get(name) or _unit_in(name) or _unit_called(name)
    if ticks := _TICKS.fullmatch(said):
        tick_s = float(ticks[1]) * NS_PER_UNIT[_SPELLINGS.get(ticks[2], ticks[2])] * 1e-9
        rate_hz = 1 / max(_unit_of_time("s", values)[1] * tick_s, 1e-12)
        lines += [
            f'unit = "{_SPELLINGS.get(ticks[2], ticks[2])}"   # {rate_hz:.4g} rows a second, if so',
            f"ticks = {ticks[1]}",
        ]
        return lines + _restarts(values)
    is_number = names and (not name.strip() or _INDEX.fullmatch(name.strip()))
    if said not in NS_PER_UNIT and is_number and (steps == 1).all():
        what = f"column {name!r}" if name.strip() else f"the first column without a name, {index},"
        if proposal.layout.rate_hz is None:
            proposal.doubts.append(
                f"{what} counts the rows and says nothing about time: 100 rows a second are assumed; enter the rate in"
                " rate_hz"
            )
        return [rate_line(proposal)]
    unit, step = _unit_of_time(said, values)
    rate_hz = _rate_hz(unit, step)
    inferred, _ = _unit_of_time("", values)
    other_hz = _rate_hz(inferred, step)
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1] and USUAL_RATES_HZ[0] <= other_hz <= USUAL_RATES_HZ[1]:
        proposal.doubts.append(
            f"column {name!r} says {unit}, which would be {rate_hz:.3g} rows a second; {inferred} is assumed"
        )
        unit, rate_hz = inferred, other_hz
    mark = "" if said == unit else "   # ?"
    lines.append(f'unit = "{unit}"{mark or "   #"} {rate_hz:.4g} rows a second, if so')
    return lines + _restarts(values)


def _rate_hz(unit: str, step: float) -> float:
    """Return the rate of rows that are `step` units of time apart."""
    return 1e9 / max(step * NS_PER_UNIT[unit], 1e-3)


_CALLED: Mapping[str, re.Pattern[str]] = {
    "us": re.compile(r"(?:^|[_ .])(?:us|usec|micros|microseconds)$|[a-z]US$", re.ASCII),
    "ms": re.compile(r"(?:^|[_ .])(?:ms|msec|millis|milliseconds)$|[a-z]MS$", re.ASCII),
    "ns": re.compile(r"(?:^|[_ .])(?:ns|nsec|nanos|nanoseconds)$|[a-z]NS$", re.ASCII),
    "s": re.compile(r"(?:^|[_ .])(?:sec|secs|seconds)$", re.ASCII),
}
"""Names of times that say their unit without brackets, by unit."""


def _unit_called(name: str) -> str:
    """Return the unit of time that a name without brackets says; "" if it says none."""
    return next((unit for unit, spelt in _CALLED.items() if spelt.search(name.strip())), "")


_TICKS = re.compile(r"(\d+\.?\d*) ?([mun\u00b5\u03bc]?s)")
"""A unit of times that is so many of another: "39.0625us"."""


def _restarts(values: Floats) -> list[str]:
    """Return the lines of `[time]` for a counter that wraps, and for times that repeat."""
    steps, lines = np.diff(values), []
    if (steps < 0).any() and (wraps_at := _wrap_of(values)):
        lines.append(f"wraps_at = {wraps_at:.0f}")
    if (steps == 0).any():
        lines.append("ties = true   # rows with equal times")
    return lines


def _wrap_of(values: Floats) -> float:
    """Return the usual period that a counter (n,) with falls has; 0 without one."""
    least, most = float(values.min()), float(values.max())
    if least < 0:  # a signed counter
        return next((period for period in _WRAPS if 0.9 * period < 2 * min(most, -least) <= period), 0.0)
    return next((period for period in _WRAPS if 0.9 * period < most <= period), 0.0)


def _unit_of_time(said: str, values: Floats) -> tuple[str, float]:
    """Return the unit of times, as their column's name says it or by their step, and the step."""
    steps = np.diff(values)
    step = float((values[-1] - values[0]) / len(steps))
    if (steps < 0).any():
        step = float(np.median(steps[steps > 0]))
    if said in NS_PER_UNIT:
        return said, step
    return next((unit for unit, most in (("s", 0.2), ("ms", 200.0), ("us", 2e5)) if step < most), "ns"), step


def _triads(
    names: Sequence[str],
    columns: Sequence[Floats],
    taken: set[int],
    stem_of_file: str,
    units: Mapping[str, str],
) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield quantity ("" if neither name nor unit says it) and columns of each triad."""
    if not names:
        free = [index for index in range(len(columns)) if index not in taken and np.isfinite(columns[index]).any()]
        said = quantity_of(stem_of_file)
        if said and 3 <= len(free) <= _MOST_OF_ONE_SENSOR:
            yield said, (free[0], free[1], free[2])
        else:
            yield from _nameless(columns, free)
        return
    used: set[int] = set()
    for prefix in dict.fromkeys(match[1] for name in names if (match := _PART.fullmatch(name))):
        parts = [index for index, name in enumerate(names) if (match := _PART.fullmatch(name)) and match[1] == prefix]
        if len(parts) > _TRIAD_AND_TIME:
            yield from _nameless(columns, [index for index in parts if index not in taken])
            used.update(parts)
    for index, name in enumerate(names[:-2]):
        if names[index + 1 : index + 3] == ["1", "2"]:
            used.update(range(index, index + 3))
            yield (
                _QUANTITY_OF_UNIT.get(units.get(name) or _unit_in(name), quantity_of(name)),
                (index, index + 1, index + 2),
            )
    for axes in ("xyz", "XYZ", "012", "123"):
        for index, name in enumerate(names):
            for place in (at for at, letter in enumerate(name) if letter == axes[0]):
                stems = [name[:place] + letter + name[place + 1 :] for letter in axes]
                if index in used or not all(stem in names for stem in stems):
                    continue
                fourth, fifth = (f"{name[:place]}{letter}{name[place + 1 :]}" for letter in (_FOURTH[axes], "4"))
                is_time = _FOURTH[axes] == "0" and fourth in names and increases(columns[names.index(fourth)])
                if fourth in names and fifth not in names and not is_time:
                    continue  # four numbers: a quaternion, motors, channels
                indices = (names.index(stems[0]), names.index(stems[1]), names.index(stems[2]))
                if used.intersection(indices) or taken.intersection(indices):
                    continue
                used.update(indices)
                stem = name[:place] + "*" + name[place + 1 :]
                if _QUATERNION.fullmatch(stem):
                    continue
                called = stem if stem.strip("*_.- []()") and not _VALUES.fullmatch(stem) else stem_of_file
                yield _QUANTITY_OF_UNIT.get(units.get(name) or _unit_in(name), quantity_of(called)), indices


def _with_gravity_again(
    triads: list[tuple[str, tuple[int, int, int]]],
    names: Sequence[str],
    columns: Sequence[Floats],
    proposal: Proposal,
) -> list[tuple[str, tuple[int, int, int]]]:
    """Return the triads with gravity and the acceleration without it as one, if there is no accelerometer's reading."""
    forces = [indices for quantity, indices in triads if quantity == "specific_force"]
    if names:
        pulls = [indices for indices in forces if _GRAVITY.search(names[indices[0]])]
        rests = [indices for indices in forces if _FREE.search(names[indices[0]])]
    else:
        pulls = [indices for indices in forces if _is_computed_gravity(columns, indices)]
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
_APPLE = re.compile(
    r"user_?acceleration|accelerometerAcceleration|motionGravity|DeviceMotion|CMAcceleration", re.IGNORECASE
)
"""Names of Apple's CoreMotion, in which a device that lies on its back reads -1 g along z."""


def _is_computed_gravity(columns: Sequence[Floats], indices: tuple[int, int, int]) -> bool:
    """Return whether a triad is gravity from a filter: its length is 1, or g, to a thousandth while it turns."""
    lengths = _lengths(columns, indices)
    if not len(lengths) or not _keeps_its_length(columns, indices):
        return False
    low, middle, high = np.quantile(lengths, (0.05, 0.5, 0.95))
    return bool(high - low < 2 * _UNIT_LENGTH * middle)


def _with_quantity(
    triads: list[tuple[str, tuple[int, int, int]]],
    names: Sequence[str],
    columns: Sequence[Floats],
    proposal: Proposal,
) -> list[tuple[str, tuple[int, int, int]]]:
    """Return the triads whose quantity is known; if none is, all are taken for specific forces."""

    def first_name(triad: tuple[str, tuple[int, int, int]]) -> str:
        return names[triad[1][0]] if names else f"column {triad[1][0] + 1}"

    computed = [triad for triad in triads if triad[0] == "specific_force" and COMPUTED.search(first_name(triad))]
    if computed and any(triad[0] == "specific_force" and triad not in computed for triad in triads):
        listed = ", ".join(map(first_name, computed))
        proposal.doubts.append(
            "left out: computed by software, according to their names (acceleration without gravity, or gravity):"
            f" {listed}, and the two columns after each of them"
        )
        triads = [triad for triad in triads if triad not in computed]
    estimates = [triad for triad in triads if _ESTIMATE.search(first_name(triad))]
    if estimates and len(estimates) < len(triads):
        proposal.doubts.append(
            "left out: estimates of biases, according to their names:"
            f" {', '.join(map(first_name, estimates))}, and the two columns after each of them"
        )
        triads = [triad for triad in triads if triad not in estimates]
    if any(names[second] == "1" for _, (_, second, _) in triads if names):
        proposal.doubts.append(
            "columns that are called 1 and 2 do not say which axes they hold: GoPro writes z, x, y, for example"
        )
    triads = _with_gravity_again(triads, names, columns, proposal)
    known = [triad for triad in triads if triad[0]]
    if not known:
        return [("specific_force", indices) for _, indices in triads]
    if not any(quantity == "specific_force" for quantity, _ in known):
        felt = [triad for triad in triads if not triad[0] and _is_steady_gravity(columns, triad[1])]
        triads = [("specific_force", triad[1]) if triad in felt[:1] else triad for triad in triads]
        known = [triad for triad in triads if triad[0]]
    others = [first_name(triad) for triad in triads if not triad[0]]
    if others:
        proposal.doubts.append(
            f"left out: their names state no quantity: {', '.join(others)}, and the two columns after each of them"
        )
    return known


_MOST_OF_ONE_SENSOR = 5
"""Most columns besides time of a table of one sensor: its axes, and perhaps an accuracy or a magnitude."""

_PLAIN_COLUMNS = 9
"""Most columns without names that are read as force, rate and field in this order."""

_MOST_LABELS = 64
_KNOWN_SHARE = 0.5
_UNIT_LENGTH = 2e-3
"""Scatter of the length of a quaternion, or of gravity from a filter, relative to it: no sensor scatters so little."""

_FOLLOWS_GRAVITY = 0.35
"""Correlation between the change of gravity and that by a rate from which on the rate is that of a gyroscope."""

_SMOOTHED_ROWS = 5


def _nameless(columns: Sequence[Floats], free: Sequence[int]) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield the triads of columns without names: consecutive threes, or among many others those that behave like it.
    The magnitude of specific force is constant under rotation, so the first is taken for a force.
    """
    if len(free) > _PLAIN_COLUMNS or len(free) % 3:
        if triads_by_behaviour := list(_behaving(columns, free)):
            yield from triads_by_behaviour
            return
        free = [index for index in free if not _is_label(columns[index])]
    triads = [(free[start], free[start + 1], free[start + 2]) for start in range(0, len(free) - 2, 3)][:3]
    triads = [triad for triad in triads if sum(float(np.nanstd(columns[index])) == 0 for index in triad) < 2]
    order = ["specific_force", "angular_rate", "magnetic_field"]
    if len(triads) > 1 and [is_gravity(columns, triad) for triad in triads[:2]] == [False, True]:
        order[:2] = ["angular_rate", "specific_force"]
    elif len(triads) > 1 and is_gravity(columns, triads[1]) and _keeps_its_length(columns, triads[1]):
        order[1] = "specific_force"
    yield from zip(order, triads, strict=False)


def _behaving(columns: Sequence[Floats], free: Sequence[int]) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield the triads that behave like gravity, and like the rates and fields of sensors beside them."""
    kept = [index for index in free if not _is_label(columns[index])]
    forces: list[tuple[int, int, int]] = []
    runs: list[list[int]] = [[]]
    at = 0
    while at < len(kept):
        if at + 4 <= len(kept) and _has_unit_length(columns, kept[at : at + 4]):
            runs.append([])
            at += 4
        elif at + 3 <= len(kept) and _is_steady_gravity(columns, kept[at : at + 3]):
            forces.append((kept[at], kept[at + 1], kept[at + 2]))
            runs.append([])
            at += 3
        else:
            runs[-1].append(kept[at])
            at += 1
    if not forces:
        return
    yield from (("specific_force", force) for force in forces)
    others = [
        (run[at], run[at + 1], run[at + 2])
        for number, run in enumerate(runs)
        for at in range(0 if number else len(run) % 3, len(run) - 2, 3)
    ]
    rates = [triad for triad in others if any(_turns_gravity(columns, triad, force) for force in forces)]
    if not rates:  # at rest, the first triad after a force is taken for a rate, and the second for a field
        firsts = {run[0] for run in runs[1:] if len(run) >= 3}
        seconds = {run[3] for run in runs[1:] if len(run) >= 6}
        yield from (("angular_rate", triad) for triad in others if triad[0] in firsts)
        yield from (("magnetic_field", triad) for triad in others if triad[0] in seconds)
        return
    yield from (("angular_rate", triad) for triad in rates)
    fields = (triad for triad in others if triad not in rates and _keeps_its_length(columns, triad))
    yield from (("magnetic_field", triad) for triad in fields)


def _is_label(values: Floats) -> bool:
    """Return whether a column is constant, mostly empty, or has few whole numbers, as labels of activities are."""
    known = values[np.isfinite(values)]
    if len(known) < _KNOWN_SHARE * len(values):
        return True
    few = len(np.unique(known)) <= _MOST_LABELS and bool((known == np.rint(known)).all())
    return float(np.ptp(known)) == 0 or (few and float(np.mean(np.diff(known) == 0)) > 1 - _KNOWN_SHARE)


def _lengths(columns: Sequence[Floats], indices: Sequence[int]) -> Floats:
    """Return the lengths (n,) of the rows that are known."""
    values = np.stack([columns[index] for index in indices], axis=1)
    return np.asarray(np.linalg.norm(values[np.isfinite(values).all(axis=1)], axis=1))


def _has_unit_length(columns: Sequence[Floats], indices: Sequence[int]) -> bool:
    """Return whether vectors have length 1 to a thousandth, as quaternions have."""
    lengths = _lengths(columns, indices)
    return len(lengths) > 0 and bool(np.quantile(np.abs(lengths - 1), 0.95) < _UNIT_LENGTH)


def _is_steady_gravity(columns: Sequence[Floats], indices: Sequence[int]) -> bool:
    """Return whether a triad has the length of gravity in most rows."""
    triad = (indices[0], indices[1], indices[2])
    if not is_gravity(columns, triad) or min(float(np.nanstd(columns[index])) for index in triad) == 0:
        return False
    low, middle, high = np.quantile(_lengths(columns, triad), (0.1, 0.5, 0.9))
    return bool(high - low < 0.6 * middle)


def _turns_gravity(columns: Sequence[Floats], rate: tuple[int, int, int], force: tuple[int, int, int]) -> bool:
    """Return whether gravity turns as a rate says, df/dt = -omega x f, in any unit of both."""
    w, f = (np.stack([columns[index] for index in triad], axis=1) for triad in (rate, force))
    known = np.isfinite(w).all(axis=1) & np.isfinite(f).all(axis=1)
    kernel = np.ones(_SMOOTHED_ROWS) / _SMOOTHED_ROWS
    if known.sum() < 10 * _SMOOTHED_ROWS:
        return False
    w, f = (np.stack([np.convolve(axis, kernel, "valid") for axis in values[known].T], axis=1) for values in (w, f))
    change = (f[2 * _SMOOTHED_ROWS :] - f[: -2 * _SMOOTHED_ROWS]).ravel()
    middle = slice(_SMOOTHED_ROWS, -_SMOOTHED_ROWS)
    turned = -np.cross(w[middle], f[middle]).ravel()
    size = float(np.linalg.norm(change) * np.linalg.norm(turned))
    return size > 0 and float(change @ turned) / size > _FOLLOWS_GRAVITY


def _keeps_its_length(columns: Sequence[Floats], triad: tuple[int, int, int]) -> bool:
    """Return whether a triad turns without getting longer, as gravity does in a sensor that is turned."""
    values = np.stack([columns[index] for index in triad], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return False
    length = np.linalg.norm(values, axis=1)
    low, middle, high = np.quantile(length, (0.1, 0.5, 0.9))
    turned = np.linalg.norm(np.quantile(values, 0.9, axis=0) - np.quantile(values, 0.1, axis=0))
    return bool(high - low < _NEAR_GRAVITY * middle and turned > 0.5 * middle)


def is_gravity(columns: Sequence[Floats], triad: tuple[int, int, int]) -> bool:
    """Return whether the median length of a triad is 1 g in some unit."""
    lengths = np.sqrt(sum(columns[index] ** 2 for index in triad))
    if np.isnan(lengths).all():
        return False
    length = float(np.nanmedian(lengths))
    return any(abs(length / gravity - 1) < _NEAR_GRAVITY for gravity in _GRAVITIES)


def _sensor(
    quantity: str,
    names: Sequence[str],
    columns: Sequence[Floats],
    indices: tuple[int, int, int],
    force_unit: str,
    proposal: Proposal,
) -> tuple[list[str], str]:
    """Return the lines of a sensor, and the chosen unit."""
    values = np.stack([columns[index][: min(map(len, columns))] for index in indices], axis=1)
    gravity = proposal.gravity.get(indices)
    if gravity is not None:
        values = values + np.stack([columns[index][: len(values)] for index in gravity], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    length = float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0
    said = proposal.units.get(names[indices[0]]) or _unit_in(names[indices[0]]) if names else ""
    whole = bool(len(values)) and float(np.mean(values == np.rint(values))) > _WHOLE and length > 5
    beyond = float(np.abs(values).max(initial=0.0))
    is_wide = (
        quantity == "specific_force"
        and whole
        and (beyond >= _CODES_16 or (beyond >= _CODES_16 / 2 and float(values.min()) < 0))
    )
    whole = whole and float(np.ptp(values)) < _CODES_16
    codes: list[str] = []
    largest = _CODES_16 / 2
    if whole:
        values, codes, largest = _signed(values)
        length = float(np.median(np.linalg.norm(values, axis=1)))
    listed = ", ".join(column_label(names, index) for index in indices)
    name = _NAMES[quantity]
    number = sum(item[1].startswith(f'name = "{name}') for item in proposal.items)
    item = [
        "[[sensor]]",
        f'name = "{name}{number + 1 if number else ""}"',
        'chip = "unknown"   # ?',
        f'quantity = "{quantity}"' if names else f'quantity = "{quantity}"   # ? the columns have no names',
        f"columns = [{listed}]",
    ]
    if gravity is not None:
        item.append(f"gravity_columns = [{', '.join(column_label(names, index) for index in gravity)}]")
    if quantity == "specific_force" and names and _APPLE.search(names[indices[0]]):
        item.append('signs = "---"   # ? Apple\'s CoreMotion has the opposite sign: -1 g along the axis that points up')
    if said in UNITS_OF[quantity]:  # type: ignore[index]
        return [*item, f'unit = "{said}"'], said
    if is_wide:
        sphere = fit_sphere(values)
        return [*item, *_wide_codes(length if sphere is None else sphere.radius, beyond)], "g"
    if not whole:
        unit, lines = _measured(quantity, values, force_unit)
        return [*item, *lines], unit
    sphere = fit_sphere(values) if quantity == "specific_force" else None
    unit, lines = _counted(quantity, length if sphere is None else sphere.radius, largest)
    if sphere is not None and not codes and is_in_mg(sphere.radius):
        unit, lines = "mg", [UNIT_MG.format(sphere.radius)]
    return [*item, *codes, *lines], unit


_WHOLE = 0.999
"""Share of whole numbers of a column of codes: a torn row may hold others."""

UNIT_MG = 'unit = "mg"   # ? from gravity in all directions: {:.5g}'


def is_in_mg(length: float) -> bool:
    """Return whether gravity's length in all directions says that whole numbers are in mg, not 1024 counts per g."""
    return abs(ln(length / 1000)) < abs(ln(length / 1024)) and abs(ln(length / 1000)) < _EXACT


_EXACT = 0.012
"""Greatest log ratio of gravity's length in all directions to the counts per g."""


def _signed(values: Floats) -> tuple[Floats, list[str], float]:
    """Return codes (n, 3) as signed ones, the lines that say how, and the largest code that is then possible."""
    if values.min() < 0 or values.max() >= _CODES_16:
        return values, [], _CODES_16 / 2
    medians = np.median(values, axis=0)
    middle = 2.0 ** np.rint(np.log2(max(float(np.median(medians)), 1.0)))
    _, second, largest = np.sort(np.abs(medians / middle - 1)).tolist()
    if _LEAST_MIDDLE <= middle < _CODES_16 / 2 and second < _NEAR_MIDDLE and largest < _GRAVITY_FROM_MIDDLE:
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


def _wide_codes(length: float, beyond: float) -> list[str]:
    """Return the scale of an accelerometer's codes of more than 16 bits, up to `beyond`."""
    per_g = min(WIDE_SENSITIVITIES["specific_force"], key=lambda known: abs(ln(length / known)))
    if abs(ln(length / per_g)) > _NEAR_GRAVITY:
        per_g = 2.0 ** round(ln(length) / ln(2))
    if abs(ln(length / per_g)) > _NEAR_GRAVITY:
        per_g = float(f"{length:.3g}")
    bits = usual_bits(beyond)
    return [
        'unit = "g"',
        f"range = {(1 << bits - 1) / per_g:.6g}   # ? of {bits} bits",
        f"sensitivity = {per_g:.9g}   # ? from gravity: {length:.6g} counts",
    ]


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
            f"sensitivity = {COUNTS_OF_GYROSCOPE:g}   # ? not determined at rest; common are {known}",
        ]
    return "gauss", [
        'unit = "gauss"',
        "range = 1.3   # ?",
        f"sensitivity = {_COUNTS_OF_MAGNETOMETER:g}   # ? {length:.4g} counts for the earth's 0.2 to 0.7 gauss",
    ]


def _measured(quantity: str, values: Floats, force_unit: str) -> tuple[str, list[str]]:
    """Return the unit of columns of physical values (n, 3)."""
    length = float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0
    if quantity == "angular_rate":
        largest = float(np.abs(values).max(initial=0.0))
        if largest > _MOST_DPS:
            return "mdps", [f'unit = "mdps"   # ? from the size of the values: up to {largest:.4g}']
        unit = "rad/s" if force_unit == "m/s2" else "dps"
        return unit, [f'unit = "{unit}"   # ? dps or rad/s: the import report compares rotations, if there are any']
    if quantity == "specific_force":
        sizes = {"g": 1.0, "m/s2": STANDARD_GRAVITY, "mg": 1000.0}
    else:
        sizes = {"gauss": 0.45, "uT": 45.0, "mgauss": 450.0, "T": 4.5e-5, "nT": 4.5e4}
    unit = min(sizes, key=lambda scale: abs(ln(max(length, 1e-12) / sizes[scale])))
    return unit, [f'unit = "{unit}"   # ? from the size of the values: {length:.4g}']


_MOST_DPS = 6000.0
"""Readings beyond those of every gyroscope in dps: the values are in thousandths."""


def _propose_thermometer(proposal: Proposal, name: str, values: Floats) -> None:
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
                f"column = {quoted(name)}",
                f'unit = "{unit}"' if unit else 'unit = "degC"   # ? from the size of the values',
            ]
        )
        return
    span = f"{known.min():g} to {known.max():g}"
    proposal.doubts.append(
        f"column {name!r} may be a chip's thermometer ({span} counts): set temperature_column ="
        f" {quoted(name)} and thermometer = {{ zero_degc, lsb_per_degc }} of its sensor from its data sheet"
    )


def _propose_barometer(proposal: Proposal, name: str, values: Floats) -> None:
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
            f"column = {quoted(name)}",
            f'unit = "{unit}"'
            + ("" if name in proposal.units else f"   # ? from the size of the values: {middle:.6g}"),
        ]
    )

"""A proposed map under construction: its tables, and the lines that describe the time and each sensor.

The column of time, its unit, and the unit of a sensor or the scale of its codes are inferred from names and from the
size of the values.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from math import log as ln

import numpy as np

from imuarray.arrays import Floats
from imuarray.importers.column_names import COMPUTED, INDEX, SPELLINGS, TIME, column_label, unit_in
from imuarray.importers.mapping import NS_PER_UNIT, SCALE_UNKNOWN, UNIT_UNKNOWN, ZERO_OF_UNIT, has_no_day
from imuarray.importers.plausibility import FEWEST_ROWS, RATES_HZ, USUAL_RATES_HZ
from imuarray.importers.resolution import (
    RATE_SENSITIVITIES,
    SAMPLE_ROWS,
    WIDE_SENSITIVITIES,
    common_step,
    named_step,
    usual_bits,
)
from imuarray.importers.text_layout import TextLayout, quote
from imuarray.importers.triad_behaviour import NEAR_GRAVITY, TriadIndices, fit_sphere
from imuarray.printable import printable
from imuarray.units import STANDARD_GRAVITY, UNITS_OF

_WIDTH = 110


class Item(list[str]):
    """The lines of a table of a map, such as `[[sensor]]`: its head, its name, and its other entries."""

    @property
    def name(self) -> str:
        """The name of the sensor."""
        return self.text("name")

    def call(self, name: str) -> None:
        """Replace the name of the sensor."""
        self.replace("name", f'name = "{name}"')

    def line(self, key: str) -> str:
        """Return the line of an entry; "" without it."""
        return next((line for line in self if line.startswith(f"{key} = ")), "")

    def text(self, key: str) -> str:
        """Return the text of an entry; "" without it."""
        return self.line(key).partition('"')[2].partition('"')[0]

    def is_guess(self, key: str) -> bool:
        """Return whether the entry exists and its comment states that it is guessed."""
        return "# ?" in self.line(key)

    def replace(self, key: str, line: str) -> None:
        """Replace the line of an entry."""
        self[self.index(self.line(key))] = line

    def leave_out(self, *keys: str) -> None:
        """Remove entries."""
        self[:] = [line for line in self if line not in map(self.line, keys)]


@dataclass
class Proposal:
    """A map under construction: its lines, remarks and doubts, and the units of columns that are known."""

    layout: TextLayout
    time: list[str] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    units: Mapping[str, str] = field(default_factory=dict)
    gravity: dict[TriadIndices, TriadIndices] = field(default_factory=dict)
    """Columns of accelerations without gravity, and those of the gravity that was subtracted."""

    attitudes: list[list[str]] = field(default_factory=list)
    """Columns of quaternions, w first, as a map names them."""
    asides: list[Item] = field(default_factory=list)
    """Items that are written into the map as comments."""

    def name_line(self, stem: str) -> str:
        """Return the line with the next free name that begins with a stem: Acc, Acc2, ..."""
        number = sum(item.name.startswith(stem) for item in self.items)
        return f'name = "{stem}{number + 1 if number else ""}"'

    def add(self, table: str, stem: str, *lines: str) -> None:
        """Add an item with the next free name that begins with a stem."""
        self.items.append(Item([f"[[{table}]]", self.name_line(stem), *lines]))

    def attitude_lines(self, is_comment: bool) -> list[str]:
        """Return the line of a sensor that adds gravity again by the attitude of its rows, commented out if
        `is_comment`; an empty list without an attitude.
        """
        mark = "# " if is_comment else ""
        return [
            f"{mark}attitude_columns = [{', '.join(names)}]   # w, x, y, z: adds 1 g along up again"
            for names in self.attitudes[:1]
        ]

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
        for item in self.asides:
            parts += ["", *(f"# {line}" for line in item)]
        return "\n".join(parts) + "\n"


_WRAPS = (2.0**32, 2.0**24, 2.0**16)


def is_time_of_rows(name: str, values: Floats) -> bool:
    """Return whether a column has an increasing time for each row: its values increase and its name is that of a time,
    or they increase in every row and its name is not that of a row number.
    """
    if not increases(values):
        return False
    return bool(TIME.search(name)) or (bool((np.diff(values) > 0).all()) and not INDEX.fullmatch(name.strip()))


UNKNOWN_RATE = "rate_hz = 100   # ? enter the true rate"
"""The line of `[time]` for rows of unknown rate."""


def rate_line(proposal: Proposal) -> str:
    """Return the line of `[time]` for rows without times: the rate stated in the recording, or a guess."""
    layout = proposal.layout
    if layout.rate_hz is None:
        return UNKNOWN_RATE
    return f"rate_hz = {layout.rate_hz:g}   # stated by {printable(layout.rate_source)[:80]}"


def add_own_time(
    item: Item,
    names: Sequence[str],
    columns: Sequence[Floats],
    first: int,
    time: tuple[int | None, Mapping[int, str]],
    proposal: Proposal,
) -> None:
    """Add a sensor's time column to its lines, if it differs from that of the table, `time`, which may be a date."""
    time_of_sensor = _own_time(names[first], names, columns, time[0]) if names else None
    if time_of_sensor is None:
        return
    label = column_label(names, time_of_sensor)
    units = [
        _unit_of_time(unit_in(names[index]), columns[index][np.isfinite(columns[index])])[0]
        for index in (time_of_sensor, time[0])
        if index is not None and index not in time[1]
    ]
    if len(units) == 2 and units[0] == units[1]:
        item.append(f"time_column = {label}   # ? by its name")
    else:
        proposal.doubts.append(
            f"column {label} seems to be the time of {item.name}; as time_column it needs the unit of [time]"
        )


def time_index(names: Sequence[str], columns: Sequence[Floats], dates: Mapping[int, str]) -> int | None:
    """Return the column of time: named so, and increasing (a counter may wrap, rows may be out of order)."""
    if dates:
        return min(dates)
    increasing = [index for index, values in enumerate(columns) if increases(values)]
    called = [index for index in range(min(len(names), len(columns))) if TIME.search(names[index])]
    ordered = [index for index in called if index in increasing]
    shuffled = [index for index in called if len(np.unique(columns[index])) > len(columns[index]) / 2]
    return next(iter([*ordered, *shuffled, *increasing]), None)


def _own_time(name: str, names: Sequence[str], columns: Sequence[Floats], time: int | None) -> int | None:
    """Return the time column that has the beginning of its name in common with a sensor's column; None if there is no
    such column, or if the name of the whole table's `time` has as much in common.
    """

    def common(index: int) -> int:
        same = takewhile(lambda pair: pair[0] == pair[1], zip(names[index].lower(), name.lower(), strict=False))
        return sum(1 for _ in same)

    fitting = [
        index
        for index in range(min(len(names), len(columns)))
        if index != time
        and TIME.search(names[index])
        and common(index) >= _OWN_PREFIX
        and increases(columns[index][np.isfinite(columns[index])])
    ]
    best = max(fitting, key=common, default=None)
    return None if best is None or (time is not None and common(time) >= common(best)) else best


_OWN_PREFIX = 2


def increases(values: Floats) -> bool:
    """Return whether values (n,) increase like time: at least 99 % of the steps are positive (a counter may wrap)."""
    finite = values[np.isfinite(values)]
    if len(finite) < _MOSTLY_KNOWN * len(values):
        return False
    steps = np.diff(finite)
    return len(steps) > 1 and float(np.mean(steps < 0)) < 1e-2 and steps.max() > 0


_MOSTLY_KNOWN = 0.5
"""Least share of rows with a time: events between readings may have none."""


def is_clock(values: Floats) -> bool:
    """Return whether values (n,) never fall and mostly rise, as a second clock or counter of a table does."""
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 1 and bool((steps >= 0).all()) and float(np.mean(steps > 0)) > _MOSTLY_KNOWN


def _fraction_lines(names: Sequence[str], columns: Sequence[Floats], index: int) -> list[str]:
    """Return the lines of `[time]` for whole seconds in the column `index` and their fraction in the next one, by names
    such as sec and nsec; otherwise an empty list.
    """
    rest = index + 1
    if rest >= min(len(names), len(columns)):
        return []
    unit = next((unit for unit, pattern in _FRACTIONS.items() if pattern.search(names[rest])), "")
    values, seconds = columns[rest], columns[index]
    if not unit or not np.isin(np.diff(seconds), (0.0, 1.0)).all() or not (seconds == np.rint(seconds)).all():
        return []
    if float(values.min()) < 0 or float(values.max()) >= 1e9 / NS_PER_UNIT[unit]:
        return []
    return [
        f"column = {column_label(names, index)}",
        'unit = "s"',
        f"fraction_column = {column_label(names, rest)}",
        f'fraction_unit = "{unit}"',
    ]


_FRACTIONS: Mapping[str, re.Pattern[str]] = {
    "ns": re.compile(r"n(ano)?s(ecs?|econds?)?$", re.IGNORECASE),
    "us": re.compile(r"(u|micro)s(ecs?|econds?)?$", re.IGNORECASE),
    "ms": re.compile(r"(m|milli)s(ecs?|econds?)?$", re.IGNORECASE),
}
"""Names of columns with the fraction of a second, by unit: nsecs, nanosec, tv_usec."""


def time_lines(
    names: Sequence[str],
    columns: Sequence[Floats],
    index: int,
    dates: Mapping[int, str],
    proposal: Proposal,
) -> list[str]:
    """Return the lines of `[time]` for the column `index`; adds doubts to the proposal."""
    if index not in dates and (lines := _fraction_lines(names, columns, index)):
        return lines
    name = names[index] if index < len(names) else ""
    lines = [f"column = {column_label(names, index)}"]
    if index in dates:
        unit, layout = dates[index], proposal.layout
        if layout.day_column is not None and has_no_day(unit):
            unit = f"{layout.day_format} {unit}"
            lines.append(f"date_column = {column_label(names, layout.day_column)}")
        month = "   # ? the month may come after the day: %d/%m" if unit.startswith("%m/") else ""
        return [*lines, f"unit = {quote(unit)}{month}"]
    values = columns[index]
    steps = np.diff(values)
    if name.lower() == "sampletimefine":
        is_coarse = 1e4 / max(_unit_of_time("us", values)[1], 1e-9) >= USUAL_RATES_HZ[0]
        ticks_line = ["ticks = 100   # of Xsens: a clock of 10 kHz"] if is_coarse else []
        return [*lines, 'unit = "us"', *ticks_line, "wraps_at = 4294967296"]
    stated_unit = proposal.units.get(name) or unit_in(name) or _unit_called(name)
    if ticks := _TICKS.fullmatch(stated_unit):
        tick_s = float(ticks[1]) * NS_PER_UNIT[SPELLINGS.get(ticks[2], ticks[2])] * 1e-9
        rate_hz = 1 / max(_unit_of_time("s", values)[1] * tick_s, 1e-12)
        lines += [
            f'unit = "{SPELLINGS.get(ticks[2], ticks[2])}"   # {rate_hz:.4g} rows a second, if so',
            f"ticks = {ticks[1]}",
        ]
        return lines + _restarts(values)
    is_number = names and (not name.strip() or INDEX.fullmatch(name.strip()))
    if stated_unit not in NS_PER_UNIT and is_number and _counts_rows(steps):
        label = f"column {name!r}" if name.strip() else f"the first column without a name, {index},"
        wrapped = f", from 0 again at {1 - steps.min():.0f}" if steps.min() < 0 else ""
        if proposal.layout.rate_hz is None:
            proposal.doubts.append(
                f"{label} counts the rows{wrapped} and says nothing about time: 100 rows a second are assumed; enter"
                " the rate in rate_hz"
            )
        return [rate_line(proposal)]
    if stated_unit not in NS_PER_UNIT and is_number and bool((steps == np.rint(steps)).all()):
        return _counter_lines(name, column_label(names, index), values, proposal)
    unit, step = _unit_of_time(stated_unit, values)
    rate_hz = _rate_hz(unit, step)
    inferred, _ = _unit_of_time("", values)
    other_hz = _rate_hz(inferred, step)
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1] and USUAL_RATES_HZ[0] <= other_hz <= USUAL_RATES_HZ[1]:
        proposal.doubts.append(
            f"column {name!r} says {unit}, which would be {rate_hz:.3g} rows a second; {inferred} is assumed"
        )
        unit, rate_hz = inferred, other_hz
    if not stated_unit and len(steps) >= FEWEST_ROWS and bool((steps == 1).all()):
        proposal.doubts.append(
            f"column {name!r} rises by 1 from row to row: it may count the rows; {unit} are assumed, which would be"
            f" {rate_hz:.4g} rows a second"
        )
    mark = "" if stated_unit == unit else "   # ?"
    lines.append(f'unit = "{unit}"{mark or "   #"} {rate_hz:.4g} rows a second, if so')
    return lines + _restarts(values)


def _counter_lines(name: str, label: str, values: Floats, proposal: Proposal) -> list[str]:
    """Return the lines of `[time]` for a counter of rows (n,) with missing numbers: its times at the stated or assumed
    rate, if most steps are equal; otherwise the rate only, because rows of other kinds have the other numbers.
    """
    steps = np.diff(values)
    forward = steps[steps > 0]
    usual = float(np.median(forward)) if len(forward) else 1.0
    is_regular = float(np.mean(forward == usual)) >= _REGULAR_COUNTER
    rate_hz = proposal.layout.rate_hz
    if rate_hz is None or not is_regular:
        numbers = "the rows, some of which are missing" if is_regular else "rows of other kinds, too"
        assumed = "100 rows a second are assumed" if rate_hz is None else f"{rate_hz:g} rows a second are stated"
        proposal.doubts.append(
            f"column {name!r} numbers {numbers}, and says nothing about time: {assumed}; enter the rate in rate_hz"
            + (", or the time of a count in ticks" if is_regular else "")
        )
    if not is_regular:
        return [rate_line(proposal)]
    source = (
        "   # ? 100 rows a second"
        if rate_hz is None
        else f"   # stated by {printable(proposal.layout.rate_source)[:80]}"
    )
    tick_s = 1 / ((rate_hz or 100.0) * usual)
    wrap = _restarts(values) or _power_of_two_wrap(values)
    return [f"column = {label}", 'unit = "s"', f"ticks = {tick_s:.12g}{source}", *wrap]


def _power_of_two_wrap(values: Floats) -> list[str]:
    """Return the line of `[time]` for a counter (n,) of a few bits, which falls to 0 after its largest number; an empty
    list if it does not.
    """
    period = float(values.max()) + 1
    falls = np.flatnonzero(np.diff(values) < 0)
    is_counter = period >= 16 and period == 2.0 ** round(ln(period) / ln(2)) and values.min() == 0
    is_wrap = bool(len(falls)) and bool((values[falls] - values[falls + 1] > period / 2).all())
    return [f"wraps_at = {period:.0f}"] if is_counter and is_wrap else []


_REGULAR_COUNTER = 0.75
"""Least share of equal steps of a counter of rows of which some are missing; a counter that rows of several kinds share
has steps of several sizes.
"""


def _counts_rows(steps: Floats) -> bool:
    """Return whether the steps of a column are those of a counter of rows, which may wrap."""
    falls = steps[steps < 0]
    return bool((steps[steps >= 0] == 1).all()) and len(np.unique(falls)) < 2


def _rate_hz(unit: str, step: float) -> float:
    return 1e9 / max(step * NS_PER_UNIT[unit], 1e-3)


_CALLED: Mapping[str, re.Pattern[str]] = {
    "us": re.compile(r"(?:^|[_ .])(?:us|usec|micros|microseconds)$|[a-z]US$", re.ASCII),
    "ms": re.compile(r"(?:^|[_ .])(?:ms|msec|millis|milliseconds)$|[a-z]MS$", re.ASCII),
    "ns": re.compile(r"(?:^|[_ .])(?:ns|nsec|nanos|nanoseconds)$|[a-z]NS$", re.ASCII),
    "s": re.compile(r"(?:^|[_ .])(?:sec|secs|seconds)$", re.ASCII),
}
"""Names of times that state their unit without brackets, by unit."""


def _unit_called(name: str) -> str:
    """Return the unit of time that a name states without brackets; "" if it states none."""
    return next((unit for unit, pattern in _CALLED.items() if pattern.search(name.strip())), "")


_TICKS = re.compile(r"(\d+\.?\d*) ?([mun\u00b5\u03bc]?s)")
"""Pattern of a unit of time that is a multiple of another: "39.0625us"."""


def _restarts(values: Floats) -> list[str]:
    """Return the lines of `[time]` for a counter that wraps, and for times that repeat."""
    steps, lines = np.diff(values), []
    if (steps < 0).any() and (wraps_at := _wrap_of(values)):
        lines.append(f"wraps_at = {wraps_at:.0f}")
    if (steps == 0).any():
        lines.append("ties = true   # rows with equal times")
    return lines


def _wrap_of(values: Floats) -> float:
    """Return the usual period of a counter (n,) that wraps; 0 without one."""
    least, most = float(values.min()), float(values.max())
    if least < 0:  # a signed counter
        return next((period for period in _WRAPS if 0.9 * period < 2 * min(most, -least) <= period), 0.0)
    return next((period for period in _WRAPS if 0.9 * period < most <= period), 0.0)


def _unit_of_time(stated_unit: str, values: Floats) -> tuple[str, float]:
    """Return the unit of times, as stated in their column's name or inferred from their step, and the step."""
    steps = np.diff(values)
    step = float((values[-1] - values[0]) / len(steps)) if len(steps) else np.nan
    if (steps < 0).any():
        step = float(np.median(steps[steps > 0]))
    if stated_unit in NS_PER_UNIT:
        return stated_unit, step
    return next((unit for unit, most in _STEPS if step < most), "ns"), step


_STEPS = (("d", 1e-5), ("s", 0.2), ("ms", 200.0), ("us", 2e5))
"""Units of time, and the steps from row to row below which they are plausible; larger steps are taken for ns."""


NAMES = {"specific_force": "Acc", "angular_rate": "Gyro", "magnetic_field": "Mag"}
_PRESSURES = {"Pa": 1e5, "hPa": 1e3, "kPa": 1e2, "bar": 1.0}
"""Air pressure at sea level in each unit."""
_MAGNETOMETERS = ((333.3, 12.0), (666.7, 48.0), (1090.0, 1.3), (3000.0, 8.0), (6842.0, 4.0), (12_000.0, 2.0))
"""Counts per gauss and range in gauss of common magnetometers: AK8975, AK8963, HMC5883L after power-up (HMC-21),
QMC5883L (8 gauss), LIS3MDL (4 gauss), QMC5883L (2 gauss).
"""
_EARTH_GAUSS = 0.45
"""Usual size of the earth's field in gauss."""
COUNTS_OF_GYROSCOPE = 131.0
_CODES_16 = 1 << 16
_LEAST_MIDDLE = 128.0
_NEAR_MIDDLE = 0.15
_GRAVITY_FROM_MIDDLE = 0.55
"""Constants of an unsigned converter: the least middle of its range (8 bits), and the largest relative distances from
the middle of the medians of the other two axes and of the axis along gravity, which is one half at +-2 g.
"""
_APPLE = re.compile(
    r"user_?acceleration|accelerometerAcceleration|motionGravity|DeviceMotion|CMAcceleration", re.IGNORECASE
)
"""Names used by Apple's CoreMotion: a device on its back measures -1 g along z."""


def propose_sensor(
    quantity: str,
    names: Sequence[str],
    columns: Sequence[Floats],
    indices: TriadIndices,
    force_unit: str,
    proposal: Proposal,
) -> Item:
    """Return the lines of a sensor."""
    values = np.stack([columns[index][: min(map(len, columns))] for index in indices], axis=1)
    gravity = proposal.gravity.get(indices)
    if gravity is not None:
        values = values + np.stack([columns[index][: len(values)] for index in gravity], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    length = float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0
    stated_unit = proposal.units.get(names[indices[0]]) or unit_in(names[indices[0]]) if names else ""
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
        values, codes, largest = _sign_codes(values)
        length = float(np.median(np.linalg.norm(values, axis=1)))
    listed = ", ".join(column_label(names, index) for index in indices)
    item = Item(
        [
            "[[sensor]]",
            proposal.name_line(NAMES[quantity]),
            'chip = "unknown"   # ?',
            f'quantity = "{quantity}"' if names else f'quantity = "{quantity}"   # ? the columns have no names',
            f"columns = [{listed}]",
        ]
    )
    if gravity is not None:
        item.append(f"gravity_columns = [{', '.join(column_label(names, index) for index in gravity)}]")
    if quantity == "specific_force" and names and _APPLE.search(names[indices[0]]):
        item.append('signs = "---"   # ? Apple\'s CoreMotion has the opposite sign: -1 g along the axis that points up')
    is_computed = bool(proposal.attitudes or (names and COMPUTED.search(names[indices[0]])))
    sphere = fit_sphere(values) if quantity == "specific_force" and (is_wide or whole) else None
    gravity_length = length if sphere is None else sphere.radius
    if stated_unit in UNITS_OF[quantity]:  # type: ignore[index]
        item.append(f'unit = "{stated_unit}"')
    elif is_wide:
        item += _wide_codes(gravity_length, beyond)
    elif quantity == "specific_force" and is_computed and not whole and length < _WEIGHTLESS:
        item.append('unit = "m/s2"   # ? gravity is subtracted, and programs that do so write m/s2')
    elif not whole:
        item += _propose_unit(quantity, values, force_unit)
    elif sphere is not None and not codes and is_in_mg(sphere.radius):
        item.append(UNIT_MG.format(sphere.radius))
    else:
        item += [*codes, *_propose_counts(quantity, gravity_length, largest)]
    if stated_unit not in UNITS_OF[quantity] and _LIKE_A_UNIT.search(stated_unit):  # type: ignore[index]
        proposal.doubts.append(
            f"{item.name}: its columns state the unit {stated_unit!r}, which maps do not have: {item.text('unit')} is"
            " assumed; enter one that they have, and the factor to it in factor"
        )
    return item


_LIKE_A_UNIT = re.compile(r"[/^\u00b2\u00b0]|-[12]$")
"""Pattern of text in brackets after a name that is a unit and not a remark, such as (raw) or (body)."""


_WEIGHTLESS = 0.7
"""Median length of accelerations, in g or m/s2, below which they do not include gravity."""

_WHOLE = 0.999
"""Least share of whole numbers in a column of codes: a torn row may contain others."""

UNIT_MG = 'unit = "mg"   # ? from gravity in all directions: {:.5g}'


UNIT_MILLI = 'unit = "mg"   # ? from gravity, {:.5g}, and the gyroscope in mdps'


def is_in_mg(length: float) -> bool:
    """Return whether the length of gravity agrees with numbers in mg and not with 1024 counts per g."""
    return abs(ln(length / 1000)) < abs(ln(length / 1024)) and abs(ln(length / 1000)) < _EXACT


_EXACT = 0.012
"""Largest log ratio of gravity's length in all directions to the counts per g."""


def _sign_codes(values: Floats) -> tuple[Floats, list[str], float]:
    """Return codes (n, 3) as signed codes, the lines of the map for this conversion, and the largest code that is then
    possible.
    """
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
    """Return the lines for the scale of an accelerometer's codes of more than 16 bits, up to `beyond`."""
    per_g = min(WIDE_SENSITIVITIES["specific_force"], key=lambda sensitivity: abs(ln(length / sensitivity)))
    if abs(ln(length / per_g)) > NEAR_GRAVITY:
        per_g = 2.0 ** round(ln(length) / ln(2))
    if abs(ln(length / per_g)) > NEAR_GRAVITY:
        per_g = float(f"{length:.3g}")
    bits = usual_bits(beyond)
    return [
        'unit = "g"',
        f"range = {(1 << bits - 1) / per_g:.6g}   # ? of {bits} bits",
        f"sensitivity = {per_g:.9g}   # ? from gravity: {length:.6g} counts",
    ]


def _propose_counts(quantity: str, length: float, largest: float) -> list[str]:
    """Return unit and scale of columns of integers up to `largest`."""
    bits = f"of {round(ln(2 * largest) / ln(2))} bits"
    if quantity == "specific_force":
        per_g = 2.0 ** round(ln(length) / ln(2))
        if abs(ln(length / per_g)) > NEAR_GRAVITY:
            per_g = float(f"{length:.2g}")
        return [
            'unit = "g"',
            f"range = {largest / per_g:g}   # ? {bits}",
            f"sensitivity = {per_g:g}   # ? from gravity: {length:.5g} counts",
        ]
    if quantity == "angular_rate":
        usual_scales = ", ".join(f"{131 / (1 << power):.4g} ({250 << power} dps)" for power in range(4))
        reason = f"{SCALE_UNKNOWN}: turns at known times are required"
        return [
            'unit = "dps"',
            "range = 250   # ?",
            f"sensitivity = {COUNTS_OF_GYROSCOPE:g}   # ? {reason}; common are {usual_scales}",
        ]
    per_gauss, range_gauss = min(_MAGNETOMETERS, key=lambda scale: abs(ln(max(length, 1.0) / scale[0] / _EARTH_GAUSS)))
    return [
        'unit = "gauss"',
        f"range = {range_gauss:g}   # ?",
        f"sensitivity = {per_gauss:g}   # ? {length:.4g} counts for the earth's 0.2 to 0.7 gauss",
    ]


def _propose_unit(quantity: str, values: Floats, force_unit: str) -> list[str]:
    """Return the line of the unit of columns of physical values (n, 3)."""
    length = float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0
    if quantity == "angular_rate":
        largest = float(np.abs(values).max(initial=0.0))
        if largest > _MOST_DPS:
            return [f'unit = "mdps"   # ? from the size of the values: up to {largest:.4g}']
        if named := _unit_of_codes(values):
            return [f'unit = "{named[0]}"   # ? the step of its values is 1/{named[1]:.4g} dps, as that of usual chips']
        unit = "rad/s" if force_unit == "m/s2" else "dps"
        return [f'unit = "{unit}"   # ? {UNIT_UNKNOWN}: the import report compares rotations, if there are any']
    if quantity == "specific_force":
        sizes = {"g": 1.0, "m/s2": STANDARD_GRAVITY, "mg": 1000.0}
    else:
        sizes = {"gauss": 0.45, "uT": 45.0, "mgauss": 450.0, "T": 4.5e-5, "nT": 4.5e4}
    unit = min(sizes, key=lambda scale: abs(ln(max(length, 1e-12) / sizes[scale])))
    is_gal = unit == "mg" and abs(length - 100 * STANDARD_GRAVITY) < abs(length - 1000.0)
    other = "; 1 g in gal (cm/s2) would be 980.7" if is_gal else ""
    return [f'unit = "{unit}"   # ? from the size of the values: {length:.4g}{other}']


def _unit_of_codes(rates: Floats) -> tuple[str, float] | None:
    """Return the unit in which the step of rates (n, 3) is that of a chip in a data sheet, and its counts per dps; None
    unless this is so in exactly one unit.
    """
    axes = list(rates[:SAMPLE_ROWS].T)
    step = common_step(axes)
    units = []
    for unit in ("dps", "rad/s"):
        sensitivities = [value * UNITS_OF["angular_rate"][unit] for value in RATE_SENSITIVITIES]
        grid = named_step(axes, sensitivities) if step is None else step
        if grid is None:
            continue
        per_unit = min(sensitivities, key=lambda value: abs(value * grid - 1))
        if abs(per_unit * grid - 1) < _NEAR_STEP:
            units.append((unit, per_unit / UNITS_OF["angular_rate"][unit]))
    return units[0] if len(units) == 1 else None


_NEAR_STEP = 2e-3
"""Largest relative difference of a step from that of a data sheet for a decision between units."""

_MOST_DPS = 6000.0
"""Readings in dps that no gyroscope exceeds; larger values are in thousandths."""


def propose_thermometer(proposal: Proposal, name: str, values: Floats) -> None:
    """Propose a column of temperatures: in degrees, or as counts with unknown scale."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return
    unit = proposal.units.get(name) or unit_in(name)
    unit = unit if unit in ZERO_OF_UNIT else ""
    if not unit and finite.min() > 200 and finite.max() < 420 and (finite != np.rint(finite)).any():
        unit = "K"
    if unit or (finite.min() > -60 and finite.max() < 150 and (finite != np.rint(finite)).any()):
        unit_line = f'unit = "{unit}"' if unit else 'unit = "degC"   # ? from the size of the values'
        proposal.add("thermometer", "Thermometer", f"column = {quote(name)}", unit_line)
        return
    span = f"{finite.min():g} to {finite.max():g}"
    proposal.doubts.append(
        f"column {name!r} may be a chip's thermometer ({span} counts): set temperature_column ="
        f" {quote(name)} and thermometer = {{ zero_degc, lsb_per_degc }} of its sensor from its data sheet"
    )


def propose_barometer(proposal: Proposal, name: str, values: Floats) -> None:
    """Propose a column of air pressures, if the values are plausible in one of the units."""
    finite = values[np.isfinite(values)]
    middle = float(np.median(finite)) if len(finite) else 0.0
    near = next((unit for unit, sea_level in _PRESSURES.items() if 0.2 < middle / sea_level < 1.2), None)
    unit = proposal.units.get(name, near)
    if unit is None:
        proposal.doubts.append(
            f"column {name!r}: no air pressure in {', '.join(_PRESSURES)} has its size, {middle:.4g}"
        )
        return
    mark = "" if name in proposal.units else f"   # ? from the size of the values: {middle:.6g}"
    proposal.add("barometer", "Barometer", f"column = {quote(name)}", f'unit = "{unit}"{mark}')

"""The column of time of a recording, its unit, and the lines of a proposed map that describe it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import takewhile

import numpy as np

from imuarray.arrays import Floats
from imuarray.importers.column_names import INDEX, SPELLINGS, TIME, column_label, unit_in
from imuarray.importers.mapping import NS_PER_UNIT
from imuarray.importers.plausibility import RATES_HZ, USUAL_RATES_HZ
from imuarray.importers.proposal import Item, Proposal
from imuarray.importers.text_layout import quoted
from imuarray.printable import printable

_WRAPS = (2.0**32, 2.0**24, 2.0**16)


def is_time_of_rows(name: str, values: Floats) -> bool:
    """Return whether a column has an increasing time for each row: it is called a time, or grows without being called
    a number of the rows.
    """
    if not increases(values):
        return False
    return bool(TIME.search(name)) or (bool((np.diff(values) > 0).all()) and not INDEX.fullmatch(name.strip()))


UNKNOWN_RATE = "rate_hz = 100   # ? enter the true rate"
"""The line of `[time]` for rows of unknown rate."""


def rate_line(proposal: Proposal) -> str:
    """Return the line of `[time]` for rows without times: the rate that the recording states, or a guess."""
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
    """Add the time column of a sensor to its lines, if it is not that of the table, `time`, which may be a date."""
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
        and TIME.search(names[index])
        and common(index) >= _OWN_PREFIX
        and increases(columns[index][np.isfinite(columns[index])])
    ]
    best = max(fitting, key=common, default=None)
    return None if best is None or (time is not None and common(time) >= common(best)) else best


_OWN_PREFIX = 2


def increases(values: Floats) -> bool:
    """Return whether values (n,) increase like time: all but a hundredth of the steps, as a counter may wrap."""
    finite = values[np.isfinite(values)]
    if len(finite) < _MOSTLY_KNOWN * len(values):
        return False
    steps = np.diff(finite)
    return len(steps) > 1 and float(np.mean(steps < 0)) < 1e-2 and steps.max() > 0


_MOSTLY_KNOWN = 0.5
"""Least share of rows that have a time: events between readings may have none."""


def _fraction_lines(names: Sequence[str], columns: Sequence[Floats], index: int) -> list[str]:
    """Return the lines of `[time]` for whole seconds in the column `index` and the rest of them in the next one, by
    names such as sec and nsec; none otherwise.
    """
    rest = index + 1
    if rest >= min(len(names), len(columns)):
        return []
    unit = next((unit for unit, spelt in _FRACTIONS.items() if spelt.search(names[rest])), "")
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
"""Names of columns with the rest of a second, by unit: nsecs, nanosec, tv_usec."""


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
        month = "   # ? the month may come after the day: %d/%m" if dates[index].startswith("%m/") else ""
        return [*lines, f"unit = {quoted(dates[index])}{month}"]
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
    unit, step = _unit_of_time(stated_unit, values)
    rate_hz = _rate_hz(unit, step)
    inferred, _ = _unit_of_time("", values)
    other_hz = _rate_hz(inferred, step)
    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1] and USUAL_RATES_HZ[0] <= other_hz <= USUAL_RATES_HZ[1]:
        proposal.doubts.append(
            f"column {name!r} says {unit}, which would be {rate_hz:.3g} rows a second; {inferred} is assumed"
        )
        unit, rate_hz = inferred, other_hz
    mark = "" if stated_unit == unit else "   # ?"
    lines.append(f'unit = "{unit}"{mark or "   #"} {rate_hz:.4g} rows a second, if so')
    return lines + _restarts(values)


def _counts_rows(steps: Floats) -> bool:
    """Return whether the steps of a column are those of a counter of rows, which may wrap."""
    falls = steps[steps < 0]
    return bool((steps[steps >= 0] == 1).all()) and len(np.unique(falls)) < 2


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
    """Return the usual period that a counter (n,) with falls has; 0 without one."""
    least, most = float(values.min()), float(values.max())
    if least < 0:  # a signed counter
        return next((period for period in _WRAPS if 0.9 * period < 2 * min(most, -least) <= period), 0.0)
    return next((period for period in _WRAPS if 0.9 * period < most <= period), 0.0)


def _unit_of_time(stated_unit: str, values: Floats) -> tuple[str, float]:
    """Return the unit of times, as their column's name says it or by their step, and the step."""
    steps = np.diff(values)
    step = float((values[-1] - values[0]) / len(steps))
    if (steps < 0).any():
        step = float(np.median(steps[steps > 0]))
    if stated_unit in NS_PER_UNIT:
        return stated_unit, step
    return next((unit for unit, most in _STEPS if step < most), "ns"), step


_STEPS = (("d", 1e-5), ("s", 0.2), ("ms", 200.0), ("us", 2e5))
"""Units of time, and the steps from row to row below which they are plausible; above the last, nanoseconds are."""

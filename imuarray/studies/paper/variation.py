"""Variation of biases, noise and logging rate: Tables 5 to 7, and columns of Tables 2, 9, 10 and 11.

Biases (Tables 5 and 11) vary within a run and from one switch-on to the next. Table 5 averages Table 11's in-run column
over groups of axes. Table 11's ratio is run-to-run over in-run; for BMA1 and Gyro3 its run-to-run columns follow from
the single runs of Tables 6 and 7. The range R of a sample of n numbers limits its standard deviation: it lies between R
sqrt(1 / (2 (n - 1))) (all but two in the middle) and R sqrt(floor(n/2) ceil(n/2) / (n (n - 1))) (half at either end).
Table 11 prints both columns, so each can be checked against the other.

A boot fault (Table 6) is a run in the wrong range. The channel along gravity is the one with the largest median over
the runs. Each run's reading divided by that median, times the configured sensitivity, is the apparent sensitivity of
the run; the chip's range with the nearest sensitivity (nearest in ratio) is the actual range. A run is faulty if this
is not the configured range, so the threshold follows from the chip's own range table.

Two bias states (Table 7) are separated using all three axes: runs are sorted along the principal axis of their scatter
and divided so that the scatter within the two parts, over all three axes, is smallest.

Blending of two ranges (Table 10): the best weights for the average of two readings of one quantity with independent
noise s_low and s_high are proportional to 1 / s^2; the noise s of the mean is then given by 1 / s^2 = 1 / s_low^2 + 1 /
s_high^2. The noise of the plain average is sqrt(s_low^2 + s_high^2) / 2. In-plane and out-of-plane axes are compared by
columns of Tables 8, 10 and 11.

The logging rate follows from a standard deviation and the standard error of the mean: the number of samples is n = (std
/ sem)^2, which divided by a known duration is a rate. All channels of one log were read equally often, so a single
number must explain a whole column of standard errors of Tables 2, 9 and 11. `admitted` returns the numbers that are
possible within the rounding; the column is recomputed with the middle one. Table 2 repeats Table 9.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import product
from math import dist, hypot, log, sqrt
from statistics import fmean, median, stdev
from typing import Any

from imuarray.studies.paper.tables import (
    BMA180_LSB_PER_G,
    Cell,
    RecomputedRow,
    Row,
    channels,
    design_of,
    half_unit,
    is_inertial,
    mean,
    milli_g,
    number_in,
    numeric_cell,
    physical,
    table,
)

_SOURCES = {"BMA1": 6, "Gyro3": 7}
_RUNS = 15
_NORMAL_RANGE = 3.534
"""Mean ratio of range to sample standard deviation of fifteen normal numbers: 3.4718 (the mean range, Tippett 1925)
divided by 0.98232 (the mean deviation). The ratio is independent of the deviation (Basu), so its mean is the quotient
of the means.
"""


_RUN_COLUMNS: dict[str, Callable[[Sequence[Decimal]], Decimal]] = {
    "runs_mean": mean,
    "runs_std_of_means": stdev,
    "runs_range_of_means": lambda values: max(values) - min(values),
}


def _run_cells(row: Row) -> tuple[Cell, ...]:
    sensor, axis = row["channel"].split()
    if sensor not in _SOURCES:
        return ()
    column = "temp_int" if axis == "t" else f"{axis}_lsb"
    means = [number_in(run, column) for run in table(_SOURCES[sensor])]
    return tuple(numeric_cell(row, name, formula, means) for name, formula in _RUN_COLUMNS.items())


def table11() -> tuple[RecomputedRow, ...]:
    """Return Table 11 with its ratio recomputed, and for BMA1 and Gyro3 the run-to-run columns from Tables 6 and 7."""
    rows = []
    for row in table(11):
        inputs = [number_in(row, "runs_std_of_means"), number_in(row, "cont_std_of_means")]
        ratio = numeric_cell(row, "ratio", lambda values: values[0] / values[1], inputs)
        rows.append(RecomputedRow(row, (*_run_cells(row), ratio)))
    return tuple(rows)


def unexplained_cells() -> tuple[tuple[str, Cell], ...]:
    """Return (channel, cell) of every cell of Table 11 that is not explained even by the rounding of its inputs."""
    return tuple(
        (row.row["channel"], cell) for row in table11() for cell in row.cells if not cell.within_input_rounding
    )


def group_members(group: str) -> tuple[Row, ...]:
    """Return the rows of Table 11 that belong to a group of Table 5, such as "BMA (1.5g) X&Y"."""
    *kind, axes = group.split()
    range_name = kind[1].strip("()") if len(kind) > 1 else None
    return tuple(
        row
        for row in table(11)
        if design_of(row["channel"]) == kind[0]
        and range_name in (None, row["range"].replace(" ", ""))
        and row["channel"].split()[1] in axes.lower().split("&")
    )


def table5() -> tuple[RecomputedRow, ...]:
    """Return Table 5 as the mean of Table 11's in-run standard deviations over each group."""
    rows = []
    for row in table(5):
        inputs = [number_in(member, "cont_std_of_means") for member in group_members(row["group"])]
        rows.append(RecomputedRow(row, (numeric_cell(row, "std_of_5min_means_lsb", mean, inputs),)))
    return tuple(rows)


def deviation_bounds(spread: float, count: int) -> tuple[float, float]:
    """Return the smallest and largest sample standard deviation that `count` numbers with range `spread` can have."""
    smallest = spread * sqrt(1 / (2 * (count - 1)))
    return smallest, spread * sqrt((count // 2) * ((count + 1) // 2) / (count * (count - 1)))


def impossible_deviations() -> tuple[tuple[str, str, Decimal, float], ...]:
    """Return (channel, column, printed standard deviation, violated bound) of every standard deviation of Table 11 that
    is impossible for the printed range.
    """
    result = []
    for row in table(11):
        for half in ("runs", "cont"):
            deviation, spread = (number_in(row, f"{half}_{what}_of_means") for what in ("std", "range"))
            slack = half_unit(deviation) + half_unit(spread)
            smallest, largest = deviation_bounds(float(spread), _RUNS)
            if not smallest - float(slack) <= deviation <= largest + float(slack):
                bound = largest if deviation > largest else smallest
                result.append((row["channel"], f"{half}_std_of_means", deviation, bound))
    return tuple(result)


def range_over_deviation() -> dict[str, Any]:
    """Return the ratios of the ranges of fifteen means to their standard deviations in Table 11, and the possible
    interval.

    `rows` contain the two series of each channel; `mean` is over the inertial channels, `normal` is the mean ratio of
    fifteen normal numbers.
    """
    least, most = (1 / bound for bound in reversed(deviation_bounds(1.0, _RUNS)))
    forbidden = {(channel, column) for channel, column, *_ in impossible_deviations()}
    rows: list[dict[str, Any]] = []
    for row, half in product(table(11), ("runs", "cont")):
        spread, deviation = (number_in(row, f"{half}_{what}_of_means") for what in ("range", "std"))
        ratio = round(float(spread / deviation), 3)
        possible = (row["channel"], f"{half}_std_of_means") not in forbidden
        rows.append({"channel": row["channel"], "half": half, "range_over_deviation": ratio, "possible": possible})
    inertial = [row for row in rows if not row["channel"].endswith(" t") and row["channel"].split()[0] not in _SOURCES]
    return {
        "least": round(least, 3),
        "most": round(most, 3),
        "normal": _NORMAL_RANGE,
        "possible": [sum(row["possible"] for row in rows), len(rows)],
        "mean": {
            half: round(fmean(row["range_over_deviation"] for row in inertial if row["half"] == half), 3)
            for half in ("runs", "cont")
        },
        "rows": rows,
    }


_AXES = ("x_lsb", "y_lsb", "z_lsb")
_CONFIGURED_RANGE = "16g"
_POWER_STEPS = 50

Point = tuple[float, ...]
"""The mean counts of x, y, z over one run."""


@dataclass(frozen=True)
class WrongRangeRun:
    """A run in which the reading of gravity belongs to a range other than the configured one."""

    run: int
    column: str
    reading_lsb: Decimal
    ratio: Decimal
    """The reading divided by the median of all runs."""
    range_g: str
    range_lsb_per_g: Decimal

    def as_json(self) -> dict[str, Any]:
        """Return the fault with the exact ratio of its actual range."""
        return {
            "sensor": "BMA1",
            "run": self.run,
            "column": self.column,
            "reading_lsb": float(self.reading_lsb),
            "ratio": round(float(self.ratio), 3),
            "nearest_range": self.range_g,
            "nearest_range_lsb_per_g": int(self.range_lsb_per_g),
            "nearest_range_ratio": float(self.range_lsb_per_g / BMA180_LSB_PER_G[_CONFIGURED_RANGE]),
            "configured_range": _CONFIGURED_RANGE,
        }


def gravity_column(rows: Sequence[Row]) -> str:
    """Return the column with the largest median: the axis that measures 1 g."""
    return max(_AXES, key=lambda column: abs(median(number_in(row, column) for row in rows)))


def nearest_range(lsb_per_g: Decimal) -> str:
    """Return the BMA180 range whose sensitivity is nearest in ratio to a positive sensitivity in counts per g."""
    return min(BMA180_LSB_PER_G, key=lambda name: abs(log(lsb_per_g / BMA180_LSB_PER_G[name])))


def _ratio(row: Row) -> Decimal:
    column = gravity_column(table(6))
    return number_in(row, column) / median(number_in(other, column) for other in table(6))


def _range_of(row: Row) -> str:
    return nearest_range(_ratio(row) * BMA180_LSB_PER_G[_CONFIGURED_RANGE])


def boot_faults() -> tuple[WrongRangeRun, ...]:
    """Return the runs of Table 6 (BMA1) that were not in the configured range."""
    column = gravity_column(table(6))
    return tuple(
        WrongRangeRun(int(row["run"]), column, number_in(row, column), _ratio(row), name, BMA180_LSB_PER_G[name])
        for row in table(6)
        if (name := _range_of(row)) != _CONFIGURED_RANGE
    )


def table6() -> tuple[RecomputedRow, ...]:
    """Return Table 6 with each run's gravity reading over the median, and the range of that ratio."""
    return tuple(
        RecomputedRow(row, (), {"ratio_to_median": round(float(_ratio(row)), 4), "nearest_range": _range_of(row)})
        for row in table(6)
    )


@dataclass(frozen=True)
class TurnOnState:
    """One of the states in which a sensor starts: its runs, their centre and their spread, in counts."""

    runs: tuple[int, ...]
    centre: Point
    spread: Point
    """Sample standard deviation of the runs' means, per axis."""

    def as_json(self) -> dict[str, Any]:
        """Return the state with its numbers rounded to a thousandth of a count."""
        return {
            "runs": list(self.runs),
            "centre_lsb": [round(value, 3) for value in self.centre],
            "spread_lsb": [round(value, 3) for value in self.spread],
        }


def principal_axis(points: Sequence[Point]) -> Point:
    """Return the unit vector along which points scatter most (power iteration on their scatter matrix)."""
    centre = _centre(points)
    offsets = [tuple(value - mid for value, mid in zip(point, centre, strict=True)) for point in points]
    vector: Point = max(offsets, key=lambda offset: hypot(*offset))
    for _ in range(_POWER_STEPS):
        weights = [_dot(offset, vector) for offset in offsets]
        pulled = [_dot(weights, column) for column in zip(*offsets, strict=True)]
        length = hypot(*pulled) or 1.0
        vector = tuple(value / length for value in pulled)
    return vector


def two_way_split(points: Sequence[Point]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the indices of the two groups, of at least two points each, with the least squared scatter within them."""
    axis = principal_axis(points)
    order = sorted(range(len(points)), key=lambda i: _dot(points[i], axis))
    cuts = range(2, len(points) - 1)
    best = min(cuts, key=lambda cut: sum(_scatter([points[i] for i in part]) for part in (order[:cut], order[cut:])))
    return tuple(sorted(order[:best])), tuple(sorted(order[best:]))


def bias_states() -> tuple[TurnOnState, TurnOnState]:
    """Return the two bias states of Table 7 (Gyro3), beginning with that of the first run."""
    points = [tuple(float(row[column]) for column in _AXES) for row in table(7)]
    first, second = sorted(two_way_split(points))
    return _state(first, points), _state(second, points)


def separation(states: tuple[TurnOnState, TurnOnState]) -> float:
    """Return the distance of two states' centres over the larger spread (root sum of squares over the axes)."""
    return dist(states[0].centre, states[1].centre) / max(hypot(*state.spread) for state in states)


def table7() -> tuple[RecomputedRow, ...]:
    """Return Table 7 with the state in which each run started: 1 for the first run's state, 2 for the other."""
    first, _ = bias_states()
    return tuple(RecomputedRow(row, (), {"state": 1 if int(row["run"]) in first.runs else 2}) for row in table(7))


def _state(indices: Sequence[int], points: Sequence[Point]) -> TurnOnState:
    members = [points[i] for i in indices]
    spread = tuple(stdev(column) for column in zip(*members, strict=True))
    return TurnOnState(tuple(int(table(7)[i]["run"]) for i in indices), _centre(members), spread)


def _centre(points: Sequence[Point]) -> Point:
    return tuple(fmean(column) for column in zip(*points, strict=True))


def _scatter(points: Sequence[Point]) -> float:
    centre = _centre(points)
    return sum(dist(point, centre) ** 2 for point in points)


def _dot(first: Sequence[float], second: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(first, second, strict=True))


FACE_SECONDS = 900
"""Duration of the log of each face in the six-position experiment, in s: 15 minutes (section 4)."""
SAMPLE_SECONDS = 300
"""Duration of each sample of the turn-on experiment, in s: five minutes (section 4)."""
HIGH_RATE_HZ = 350
"""The rate of the single-sensor experiments in Hz (section 5.1)."""
TRIADS = 12
"""The factor by which the logging of the whole array was slower than that of one sensor (section 4)."""


@dataclass(frozen=True)
class RangeNoise:
    """The noise of a low-range and a high-range sensor, and of their combinations, in mg."""

    low_mg: Decimal
    high_mg: Decimal

    @property
    def weight_low(self) -> Decimal:
        """The inverse-variance weight of the low range; the weights of both ranges add up to 1."""
        low, high = 1 / self.low_mg**2, 1 / self.high_mg**2
        return low / (low + high)

    @property
    def plain_mg(self) -> Decimal:
        """The noise of the plain average."""
        return self.noise_mg(Decimal("0.5"))

    @property
    def weighted_mg(self) -> Decimal:
        """The noise with the inverse-variance weights, the smallest that any weights give."""
        return self.noise_mg(self.weight_low)

    def noise_mg(self, weight_low: Decimal) -> Decimal:
        """Return the noise of the weighted mean for this weight of the low range."""
        return ((weight_low * self.low_mg) ** 2 + ((1 - weight_low) * self.high_mg) ** 2).sqrt()

    def as_json(self) -> dict[str, Any]:
        """Return the blend with noise to a thousandth of a mg and the two gains in per cent."""
        return {
            "sensor": "BMA180",
            "low_range": "1.5g",
            "high_range": "16g",
            "low_mg": round(float(self.low_mg), 3),
            "high_mg": round(float(self.high_mg), 3),
            "weight_low": round(float(self.weight_low), 4),
            "weight_high": round(float(1 - self.weight_low), 4),
            "weighted_mg": round(float(self.weighted_mg), 3),
            "plain_average_mg": round(float(self.plain_mg), 3),
            "gain_over_plain_average_percent": round(100 * float(1 - self.weighted_mg / self.plain_mg), 1),
            "gain_over_low_range_percent": round(100 * float(1 - self.weighted_mg / self.low_mg), 1),
        }


def bma180_blend() -> RangeNoise:
    """Return the BMA180's noise at both ranges, each the mean of Table 10's six channels at the typical sensitivity."""
    low, high = (
        mean([milli_g(row, number_in(row, "std_lsb")) for row in channels(10, "BMA", name)]) for name in ("1.5g", "16g")
    )
    return RangeNoise(low, high)


PLANE_COLUMNS: dict[str, tuple[int, str]] = {
    "noise": (10, "std_lsb"),
    "thermal_slope": (8, "slope_lsb_per_degc"),
    "in_run": (11, "cont_std_of_means"),
    "turn_on": (11, "runs_std_of_means"),
}
"""The quantities compared between the out-of-plane and the in-plane axes of a sensor: table and column."""


def plane_ratio(sensor: str, quantity: str) -> Decimal:
    """Return |z| over the mean of |x| and |y| of one sensor, for a key of `PLANE_COLUMNS`."""
    number, column = PLANE_COLUMNS[quantity]
    rows = {row["channel"]: abs(number_in(row, column)) for row in table(number) if is_inertial(row)}
    return rows[f"{sensor} z"] / mean([rows[f"{sensor} x"], rows[f"{sensor} y"]])


def planes() -> list[dict[str, Any]]:
    """Return each triad's out-of-plane over in-plane ratios: noise, temperature slope, in-run and turn-on variation."""
    sensors = [row["sensor"] for row in table(1)]
    return [
        {"sensor": sensor, "design": design_of(sensor)}
        | {f"{what}_z_over_xy": round(float(plane_ratio(sensor, what)), 3) for what in PLANE_COLUMNS}
        for sensor in sensors
    ]


def rate_hz(deviation: Decimal, standard_error: Decimal, seconds: int) -> Decimal:
    """Return the samples per second that a standard deviation and a standard error imply over `seconds`."""
    return (deviation / standard_error) ** 2 / seconds


def table10_rates() -> tuple[Decimal, ...]:
    """Return the logging rate that each inertial channel of Table 10 implies, in Hz."""
    return tuple(_row_rate(row) for row in table(10) if is_inertial(row))


def _row_rate(row: Row) -> Decimal:
    return rate_hz(number_in(row, "std_lsb"), number_in(row, "sem_lsb"), FACE_SECONDS)


def table11_rates() -> tuple[Decimal, ...]:
    """Return the logging rate in Hz that each inertial channel of Table 11 implies: separate runs, then the
    continuous one.
    """
    return tuple(
        rate_hz(number_in(row, f"{half}_std"), number_in(row, f"{half}_sem"), SAMPLE_SECONDS)
        for half in ("runs", "cont")
        for row in table(11)
        if is_inertial(row)
    )


def logging_rate() -> dict[str, Any]:
    """Return the array's logging rate in Hz by Tables 10 and 11, and 350 Hz divided by section 4's factor of twelve."""
    return {
        "table10_hz": _summary(table10_rates()),
        "table11_hz": _summary(table11_rates()),
        "stated_hz": round(HIGH_RATE_HZ / TRIADS, 1),
        "samples_per_face": round(mean(table10_rates()) * FACE_SECONDS),
    }


def _summary(rates: Sequence[Decimal]) -> dict[str, float]:
    return {
        "mean": round(float(mean(rates)), 2),
        "smallest": round(float(min(rates)), 2),
        "largest": round(float(max(rates)), 2),
    }


def table10() -> tuple[RecomputedRow, ...]:
    """Return Table 10 with each channel's implied logging rate and noise in physical units (typical sensitivity)."""
    rows = []
    for row in table(10):
        extra: dict[str, Any] = {"rate_hz": round(float(_row_rate(row)), 2)}
        if is_inertial(row):
            extra["noise"] = round(float(physical(row, number_in(row, "std_lsb"))), 4)
            extra["unit"] = "dps" if design_of(row["channel"]) == "Gyro" else "mg"
        rows.append(RecomputedRow(row, (), extra))
    return tuple(rows)


@dataclass(frozen=True)
class ReadingCount:
    """The number of readings that a column of standard errors admits, `least` to `most`, and the rate or duration that
    follows.
    """

    table: int
    log: str
    channels: int
    least: Decimal
    most: Decimal
    rate_hz: Decimal | None
    """The rate that follows from the middle number, if the paper states the duration (Table 11)."""
    seconds: Decimal | None
    """The duration that follows from the middle number, if the paper states the rate (Table 9)."""

    @property
    def middle(self) -> Decimal:
        """The middle of the interval."""
        return (self.least + self.most) / 2

    def as_json(self) -> dict[str, Any]:
        """Return the readings; `agree` is true if a single number explains the column."""
        return {
            "table": f"Table {self.table}",
            "log": self.log,
            "channels": self.channels,
            "least": round(self.least),
            "most": round(self.most),
            "agree": self.least <= self.most,
            "rate_hz": None if self.rate_hz is None else round(float(self.rate_hz), 2),
            "seconds": None if self.seconds is None else round(float(self.seconds), 1),
        }


def admitted(deviation: Decimal, standard_error: Decimal) -> tuple[Decimal, Decimal]:
    """Return the smallest and largest number of readings for which both values could be printed as they are; the
    standard error must not be 0.
    """
    wide, narrow = half_unit(deviation), half_unit(standard_error)
    least, most = (deviation - wide) / (standard_error + narrow), (deviation + wide) / (standard_error - narrow)
    return least**2, most**2


def table9_rows(range_name: str) -> tuple[Row, ...]:
    """Return the rows of one of Table 9's two logs, its thermometer's included; the upper half is at 250 dps."""
    half = len(table(9)) // 2
    return table(9)[:half] if range_name == "250dps" else table(9)[half:]


def readings() -> tuple[ReadingCount, ...]:
    """Return the numbers of readings that Table 9's two logs (at 350 Hz) and Table 11's two series (five minutes each)
    admit: those that all channels of a log admit. If there is no such number, the smallest is above the largest.
    """
    result = []
    for name in ("250dps", "2k dps"):
        rows = table9_rows(name)
        least, most = _common((number_in(row, "std_lsb"), number_in(row, "sem_lsb")) for row in rows)
        result.append(ReadingCount(9, name, len(rows), least, most, None, (least + most) / 2 / HIGH_RATE_HZ))
    for half in ("runs", "cont"):
        least, most = _common((number_in(row, f"{half}_std"), number_in(row, f"{half}_sem")) for row in table(11))
        result.append(ReadingCount(11, half, len(table(11)), least, most, (least + most) / 2 / SAMPLE_SECONDS, None))
    return tuple(result)


def _common(printed: Iterable[tuple[Decimal, Decimal]]) -> tuple[Decimal, Decimal]:
    """Return the interval that all pairs of deviation and standard error admit."""
    ends = [admitted(*pair) for pair in printed]
    return max(least for least, _ in ends), min(most for _, most in ends)


def number_row(place: str, channel: str, printed: Row, cell: Cell, source: str) -> RecomputedRow:
    """Return one recomputed number as a row: its place, the cell, the difference, both verdicts, its derivation."""
    row = {"table": place, "channel": channel, cell.column: printed[cell.column]}
    extra = {
        "difference": round(float(cell.value) - float(cell.printed), 9) + 0.0,
        "matches": cell.matches,
        "within_input_rounding": cell.within_input_rounding,
        "follows_from": source,
    }
    return RecomputedRow(row, (cell,), extra)


def derived() -> tuple[RecomputedRow, ...]:
    """Return Table 2 from Table 9, and the standard errors of Tables 9 and 11 from deviation and number of readings."""
    rows = []
    for row in table(2):
        source = next(r for r in table(9) if (r["output"], r["range"]) == (row["output"], row["range"]))
        for column in ("mean_lsb", "std_lsb"):
            cell = numeric_cell(row, column, lambda values: values[0], [number_in(source, column)])
            rows.append(number_row("Table 2", f"{row['output']} {row['range']}", row, cell, f"Table 9, {column}"))
    for reading in readings()[:2]:
        for row in table9_rows(reading.log):
            rows.append(_standard_error(reading, row, "sem_lsb", "std_lsb", f"{row['output']} {reading.log}"))
    for reading in readings()[2:]:
        for row in table(11):
            rows.append(_standard_error(reading, row, f"{reading.log}_sem", f"{reading.log}_std", row["channel"]))
    return tuple(rows)


def _standard_error(readings: ReadingCount, row: Row, column: str, deviation: str, channel: str) -> RecomputedRow:
    cell = numeric_cell(row, column, lambda values: values[0] / readings.middle.sqrt(), [number_in(row, deviation)])
    return number_row(f"Table {readings.table}", channel, row, cell, f"{deviation} / sqrt({round(readings.middle)})")

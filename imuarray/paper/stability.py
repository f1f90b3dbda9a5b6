"""Tables 5 and 11: how far biases wander within a run and from one switch-on to the next.

Table 5 averages Table 11's in-run column over groups of axes. Table 11's ratio is run-to-run over in-run; for BMA1
and Gyro3 its run-to-run columns follow from the single runs of Tables 6 and 7.

A sample of n numbers that spread over a range R can't have any standard deviation: it lies between R sqrt(1 / (2 (n -
1))) (all but two in the middle) and R sqrt(floor(n/2) ceil(n/2) / (n (n - 1))) (half at either end). Table 11 prints
both columns, so each can be checked against the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal
from math import sqrt
from statistics import fmean
from typing import Any

from imuarray.paper.cells import Cell, RecomputedRow, half_unit, numeric_cell
from imuarray.paper.tables import Row, design_of, mean, number_in, table

_SOURCES = {"BMA1": 6, "Gyro3": 7}
_RUNS = 15
_NORMAL_RANGE = 3.534
"""Mean of range over sample standard deviation of fifteen normal numbers: 3.4718 (the mean range, Tippett 1925) over
0.98232 (the mean deviation); the ratio is independent of the deviation (Basu), so its mean is that quotient.
"""


def _spread(values: Sequence[Decimal]) -> Decimal:
    return max(values) - min(values)


def _deviation(values: Sequence[Decimal]) -> Decimal:
    centre = mean(values)
    squares = [(value - centre) ** 2 for value in values]
    return (sum(squares, Decimal(0)) / (len(values) - 1)).sqrt()


_RUN_COLUMNS: dict[str, Callable[[Sequence[Decimal]], Decimal]] = {
    "runs_mean": mean,
    "runs_std_of_means": _deviation,
    "runs_range_of_means": _spread,
}


def _run_cells(row: Row) -> tuple[Cell, ...]:
    sensor, axis = row["channel"].split()
    if sensor not in _SOURCES:
        return ()
    column = "temp_int" if axis == "t" else f"{axis}_lsb"
    means = [number_in(run, column) for run in table(_SOURCES[sensor])]
    return tuple(numeric_cell(row, name, formula, means) for name, formula in _RUN_COLUMNS.items())


def _ratio_cell(row: Row) -> Cell:
    inputs = [number_in(row, "runs_std_of_means"), number_in(row, "cont_std_of_means")]
    return numeric_cell(row, "ratio", lambda values: values[0] / values[1], inputs)


def table11() -> tuple[RecomputedRow, ...]:
    """Table 11 with its ratio recomputed, and for BMA1 and Gyro3 the run-to-run columns from Tables 6 and 7."""
    return tuple(RecomputedRow(row, (*_run_cells(row), _ratio_cell(row))) for row in table(11))


def unexplained_cells() -> tuple[tuple[str, Cell], ...]:
    """(channel, cell) of every cell of Table 11 that not even the rounding of its inputs explains."""
    return tuple(
        (row.row["channel"], cell) for row in table11() for cell in row.cells if not cell.within_input_rounding
    )


def group_members(group: str) -> tuple[Row, ...]:
    """The rows of Table 11 that a group of Table 5, such as "BMA (1.5g) X&Y", stands for."""
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
    """Table 5 as the mean of Table 11's in-run standard deviations over each group."""
    return tuple(RecomputedRow(row, (_group_cell(row),)) for row in table(5))


def _group_cell(row: Row) -> Cell:
    inputs = [number_in(member, "cont_std_of_means") for member in group_members(row["group"])]
    return numeric_cell(row, "std_of_5min_means_lsb", mean, inputs)


def deviation_bounds(spread: float, count: int) -> tuple[float, float]:
    """Smallest and largest sample standard deviation that `count` numbers with range `spread` can have."""
    smallest = spread * sqrt(1 / (2 * (count - 1)))
    return smallest, spread * sqrt((count // 2) * ((count + 1) // 2) / (count * (count - 1)))


def impossible_deviations() -> tuple[tuple[str, str, Decimal, float], ...]:
    """(channel, column, printed standard deviation, bound passed) of Table 11 where its range column forbids it."""
    found = []
    for row in table(11):
        for half in ("runs", "cont"):
            deviation, spread = (number_in(row, f"{half}_{what}_of_means") for what in ("std", "range"))
            slack = half_unit(deviation) + half_unit(spread)
            smallest, largest = deviation_bounds(float(spread), _RUNS)
            if not smallest - float(slack) <= deviation <= largest + float(slack):
                bound = largest if deviation > largest else smallest
                found.append((row["channel"], f"{half}_std_of_means", deviation, bound))
    return tuple(found)


def range_over_deviation() -> dict[str, Any]:
    """How many ranges of fifteen means were over their standard deviations in Table 11, and what is possible at all.

    `rows` hold a channel's two series; `mean` is over the inertial ones, `normal` what fifteen normal numbers have on
    average over their sample deviation.
    """
    least, most = (1 / bound for bound in reversed(deviation_bounds(1.0, _RUNS)))
    rows = [_range_row(row, half) for row in table(11) for half in ("runs", "cont")]
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


def _range_row(row: Row, half: str) -> dict[str, Any]:
    spread, deviation = (number_in(row, f"{half}_{what}_of_means") for what in ("range", "std"))
    forbidden = {(channel, column) for channel, column, *_ in impossible_deviations()}
    return {
        "channel": row["channel"],
        "half": half,
        "range_over_deviation": round(float(spread / deviation), 3),
        "possible": (row["channel"], f"{half}_std_of_means") not in forbidden,
    }

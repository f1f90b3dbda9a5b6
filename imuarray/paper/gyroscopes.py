"""Table 4 from Table 10, and the degrees per second of Tables 2 and 9 from their counts.

Unlike Table 3's, Table 4's bias is the mean of all seven readings, the repeated first face counted. Its differences
are up minus down and its drift first minus last, all with the typical sensitivities 0.07 and 0.00875 dps per count
(L3G-40, L3G-42).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal

from imuarray.paper.accelerometers import READINGS, check_drift
from imuarray.paper.cells import Cell, RecomputedRow, numeric_cell
from imuarray.paper.tables import Row, dps, is_inertial, mean, number_in, numbers_in, row_of, table


def _up_minus_down(axis: str) -> Callable[[Sequence[Decimal]], Decimal]:
    up, down = READINGS.index(f"{axis}_up"), READINGS.index(f"{axis}_down")
    return lambda readings: readings[up] - readings[down]


_TABLE_4: dict[str, Callable[[Sequence[Decimal]], Decimal]] = {
    "bias": mean,
    "dbias_x": _up_minus_down("x"),
    "dbias_y": _up_minus_down("y"),
    "dbias_z": _up_minus_down("z"),
    "drift": check_drift,
}
"""Table 4's quantities (columns without `_lsb` or `_dps`) from the seven readings of Table 10."""


def _both_units(row: Row, quantity: str) -> tuple[Cell, Cell]:
    readings = numbers_in(row_of(10, row["channel"]), READINGS)
    formula = _TABLE_4[quantity]
    return (
        numeric_cell(row, f"{quantity}_lsb", formula, readings),
        numeric_cell(row, f"{quantity}_dps", lambda inputs: dps(row["range"], formula(inputs)), readings),
    )


def table4() -> tuple[RecomputedRow, ...]:
    """Table 4 with all ten columns recomputed from Table 10."""
    return tuple(
        RecomputedRow(row, tuple(cell for quantity in _TABLE_4 for cell in _both_units(row, quantity)))
        for row in table(4)
    )


def _dps_cells(row: Row, quantities: Sequence[str]) -> tuple[Cell, ...]:
    if not is_inertial(row):
        return ()
    return tuple(
        numeric_cell(
            row, f"{quantity}_dps", lambda inputs: dps(row["range"], inputs[0]), [number_in(row, f"{quantity}_lsb")]
        )
        for quantity in quantities
    )


def table2() -> tuple[RecomputedRow, ...]:
    """Table 2 with its dps columns recomputed from its counts."""
    return tuple(RecomputedRow(row, _dps_cells(row, ("mean", "std"))) for row in table(2))


def table9() -> tuple[RecomputedRow, ...]:
    """Table 9 with its dps columns recomputed; `samples` is how many readings its standard errors imply."""
    return tuple(
        RecomputedRow(row, _dps_cells(row, ("mean", "sem", "std")), {"samples": round(_samples(row))})
        for row in table(9)
    )


def _samples(row: Row) -> Decimal:
    return (number_in(row, "std_lsb") / number_in(row, "sem_lsb")) ** 2

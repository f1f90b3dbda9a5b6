"""Everything recomputed, as one JSON-ready object."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Context, localcontext
from typing import Any

from imuarray.paper import accelerometers, gyroscopes, noise, orientation, stability, startup, thermal
from imuarray.paper.cells import RecomputedRow, tally
from imuarray.paper.conclusions import conclusions
from imuarray.paper.derived import derived, readings
from imuarray.paper.slips import slips
from imuarray.paper.stated import stated

SOURCE = (
    "H. Martin, P. Groves, M. Newman, R. Faragher, A New Approach to Better Low-Cost MEMS IMU Performance Using Sensor "
    "Arrays, 26th International Technical Meeting of the Satellite Division of The Institute of Navigation "
    "(ION GNSS+ 2013), Nashville, Tennessee, September 2013"
)
"""The paper whose Tables 1 to 11 are recomputed."""

TABLES: dict[str, Callable[[], tuple[RecomputedRow, ...]]] = {
    "table1": orientation.table1,
    "table2": gyroscopes.table2,
    "table3": accelerometers.table3,
    "table4": gyroscopes.table4,
    "table5": stability.table5,
    "table6": startup.table6,
    "table7": startup.table7,
    "table8": thermal.table8,
    "table9": gyroscopes.table9,
    "table10": noise.table10,
    "table11": stability.table11,
}
"""The paper's tables, each with what follows for it from the others."""

FURTHER: dict[str, Callable[[], tuple[RecomputedRow, ...]]] = {"derived": derived, "stated": stated}
"""Further columns of Tables 2, 9 and 11, and figures in the text: a row per number."""

_DIGITS = Context(prec=34)


def recomputed_rows() -> dict[str, tuple[RecomputedRow, ...]]:
    """Everything of `TABLES` and `FURTHER` by name; a caller's decimal context does not matter."""
    with localcontext(_DIGITS):
        return {name: build() for name, build in (TABLES | FURTHER).items()}


def recompute() -> dict[str, Any]:
    """Recompute the paper from its published tables.

    `table1` ... `table11` hold rows with the CSV files' column names; a recomputed column `x` is followed by the
    printed one as `printed_x`; it is rounded as that is if they agree. `matches` counts per table and column [equal
    to the printed digits, all], `within_input_rounding` [explained by the rounding of the printed inputs, all].
    `derived` and `stated` are further columns and the text's figures, a row each, with the difference, both verdicts
    and what it follows from. `pairs`, `boot_fault`, `bias_states`, `blending`, `planes`, `logging_rate`, `readings`
    and `range_over_deviation` are results that have no printed column; `slips` and `conclusions` are lists of {claim,
    evidence, holds}; `source` is the citation.
    """
    tables = recomputed_rows()
    with localcontext(_DIGITS):
        return {
            "source": SOURCE,
            "matches": _tallies(tables, within_input_rounding=False),
            "within_input_rounding": _tallies(tables, within_input_rounding=True),
            **{name: [row.as_json() for row in rows] for name, rows in tables.items()},
            "pairs": [pair.as_json() for pair in thermal.pairs()],
            "boot_fault": [fault.as_json() for fault in startup.boot_faults()],
            "bias_states": _bias_states(),
            "blending": noise.bma180_blend().as_json(),
            "planes": noise.planes(),
            "logging_rate": noise.logging_rate(),
            "readings": [found.as_json() for found in readings()],
            "range_over_deviation": stability.range_over_deviation(),
            "slips": [statement.as_json() for statement in slips()],
            "conclusions": [statement.as_json() for statement in conclusions()],
        }


def _tallies(
    tables: dict[str, tuple[RecomputedRow, ...]], *, within_input_rounding: bool
) -> dict[str, dict[str, list[int]]]:
    counts = {name: tally(rows, within_input_rounding=within_input_rounding) for name, rows in tables.items()}
    return {name: count for name, count in counts.items() if count}


def _bias_states() -> dict[str, Any]:
    states = startup.bias_states()
    return {
        "sensor": "Gyro3",
        "states": [state.as_json() for state in states],
        "separation": round(startup.separation(states), 2),
    }

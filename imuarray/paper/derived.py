"""Columns of Tables 2, 9 and 11 that follow from others in other ways than by a unit or a quotient.

Table 2 repeats Table 9. A standard error is a standard deviation over the root of the number of readings. All channels
of one log were read equally often, so one number has to explain a whole column of standard errors: `admitted` says
which numbers do, whatever the rounding, and the middle one recomputes the column.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from imuarray.paper.cells import Cell, RecomputedRow, half_unit, numeric_cell
from imuarray.paper.noise import HIGH_RATE_HZ, SAMPLE_SECONDS
from imuarray.paper.tables import Row, number_in, table


@dataclass(frozen=True)
class Readings:
    """How many readings a column of standard errors admits, `least` to `most`, and what that tells."""

    table: int
    log: str
    channels: int
    least: Decimal
    most: Decimal
    rate_hz: Decimal | None
    """By the middle number, where the paper says for how long (Table 11)."""
    seconds: Decimal | None
    """By the middle number, where the paper says how fast (Table 9)."""

    @property
    def middle(self) -> Decimal:
        """Half-way between the ends."""
        return (self.least + self.most) / 2

    def as_json(self) -> dict[str, Any]:
        """The readings, with `agree` for a column that one number explains."""
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
    """The numbers of readings, least and most, for which both could be printed as they are; the error is not 0."""
    wide, narrow = half_unit(deviation), half_unit(standard_error)
    least, most = (deviation - wide) / (standard_error + narrow), (deviation + wide) / (standard_error - narrow)
    return least**2, most**2


def table9_rows(range_name: str) -> tuple[Row, ...]:
    """The rows of one of Table 9's two logs, its thermometer's included; the upper half is at 250 dps."""
    half = len(table(9)) // 2
    return table(9)[:half] if range_name == "250dps" else table(9)[half:]


def readings() -> tuple[Readings, ...]:
    """Of Table 9's two logs (at 350 Hz) and of Table 11's two series (five minutes each)."""
    found = []
    for name in ("250dps", "2k dps"):
        least, most = _common((row, "") for row in table9_rows(name))
        found.append(Readings(9, name, len(table9_rows(name)), least, most, None, (least + most) / 2 / HIGH_RATE_HZ))
    for half in ("runs", "cont"):
        least, most = _common((row, f"{half}_") for row in table(11))
        found.append(Readings(11, half, len(table(11)), least, most, (least + most) / 2 / SAMPLE_SECONDS, None))
    return tuple(found)


def _common(rows: Iterable[tuple[Row, str]]) -> tuple[Decimal, Decimal]:
    """What all of them admit; least above most if nothing."""
    ends = [_ends(row, prefix) for row, prefix in rows]
    return max(least for least, _ in ends), min(most for _, most in ends)


def _ends(row: Row, prefix: str) -> tuple[Decimal, Decimal]:
    unit = "" if prefix else "_lsb"
    return admitted(number_in(row, f"{prefix}std{unit}"), number_in(row, f"{prefix}sem{unit}"))


def judged(place: str, channel: str, printed: Row, cell: Cell, source: str) -> RecomputedRow:
    """One recomputed number as a row: where it is printed, the cell, the difference, both verdicts, how it follows."""
    row = {"table": place, "channel": channel, cell.column: printed[cell.column]}
    extra = {
        "difference": round(float(cell.value) - float(cell.printed), 9) + 0.0,
        "matches": cell.matches,
        "within_input_rounding": cell.within_input_rounding,
        "follows_from": source,
    }
    return RecomputedRow(row, (cell,), extra)


def derived() -> tuple[RecomputedRow, ...]:
    """Table 2 from Table 9; the standard errors of Tables 9 and 11 from deviation and number of readings."""
    return (*_table2(), *_table9(), *_table11())


def _table2() -> Iterable[RecomputedRow]:
    for row in table(2):
        source = next(r for r in table(9) if (r["output"], r["range"]) == (row["output"], row["range"]))
        for column in ("mean_lsb", "std_lsb"):
            cell = numeric_cell(row, column, _same, [number_in(source, column)])
            yield judged("Table 2", f"{row['output']} {row['range']}", row, cell, f"Table 9, {column}")


def _table9() -> Iterable[RecomputedRow]:
    for found in readings()[:2]:
        for row in table9_rows(found.log):
            yield _standard_error(found, row, "sem_lsb", "std_lsb", f"{row['output']} {found.log}")


def _table11() -> Iterable[RecomputedRow]:
    for found in readings()[2:]:
        for row in table(11):
            yield _standard_error(found, row, f"{found.log}_sem", f"{found.log}_std", row["channel"])


def _standard_error(found: Readings, row: Row, column: str, deviation: str, channel: str) -> RecomputedRow:
    cell = numeric_cell(row, column, lambda values: values[0] / found.middle.sqrt(), [number_in(row, deviation)])
    return judged(f"Table {found.table}", channel, row, cell, f"{deviation} / sqrt({round(found.middle)})")


def _same(values: Sequence[Decimal]) -> Decimal:
    return values[0]

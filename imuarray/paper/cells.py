"""A printed number beside its recomputation, and how to judge the two.

Three things are kept apart. `matches`: the recomputed value, rounded to the digits printed, is the printed one.
`within_input_rounding`: the printed value can be reached when each input moves by at most half a unit of its own last
printed digit (to first order), which is all that a recomputation from printed tables can ask for. Neither: a slip.

A recomputed value can fall exactly half-way between two printable ones (six cells of Tables 2 to 9 do). Printed
inputs can't decide such a tie, and the paper prints some up and some down; both neighbours are right, so a tie
matches either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from typing import Any

from imuarray.paper.tables import Row

Formula = Callable[[Sequence[Decimal]], Decimal]
"""From printed inputs to a recomputed number."""


@dataclass(frozen=True)
class Cell:
    """One recomputed cell: the value, what is printed, and whether the inputs explain the difference.

    A value that agrees stands with the digits printed; one that does not stands with two more, to show by how much.
    """

    column: str
    value: float | str
    printed: float | str
    within_input_rounding: bool

    @property
    def matches(self) -> bool:
        """Whether the recomputed value equals the printed one in every printed digit."""
        return self.value == self.printed


@dataclass(frozen=True)
class RecomputedRow:
    """A printed row, the cells recomputed in it, and columns that the paper does not have."""

    row: Row
    cells: tuple[Cell, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The row under the table's own column names; a recomputed column `x` is followed by `printed_x`."""
        cells = {cell.column: cell for cell in self.cells}
        result: dict[str, Any] = {}
        for column, text in self.row.items():
            if column in cells:
                result[column] = cells[column].value
                result[f"printed_{column}"] = cells[column].printed
            else:
                result[column] = plain(text)
        return result | dict(self.extra)


def last_unit(value: Decimal) -> Decimal:
    """A unit of the last digit that a number was printed with: 0.001 for 1.230."""
    return Decimal(1).scaleb(int(value.as_tuple().exponent))


def half_unit(value: Decimal) -> Decimal:
    """Half a unit of the last printed digit: how far a correctly rounded number can be off."""
    return last_unit(value) / 2


def rounded_like(value: Decimal, printed: Decimal) -> Decimal:
    """`value` with the decimals of `printed`; a tie goes to `printed` if that is one of the two. No negative zero."""
    if abs(value - printed) <= half_unit(printed):
        return printed + 0
    return value.quantize(last_unit(printed)) + 0


def reach(formula: Formula, inputs: Sequence[Decimal]) -> Decimal:
    """By how much `formula` can move, to first order, when each input moves by its `half_unit`."""
    centre = formula(inputs)
    moved = ([*inputs[:i], value + half_unit(value), *inputs[i + 1 :]] for i, value in enumerate(inputs))
    return sum((abs(formula(values) - centre) for values in moved), Decimal(0))


def numeric_cell(row: Row, column: str, formula: Formula, inputs: Sequence[Decimal]) -> Cell:
    """The cell of `column` recomputed as `formula(inputs)`, to the digits that `row` prints there if they agree."""
    printed, value = Decimal(row[column]), formula(inputs)
    within = abs(value - printed) <= half_unit(printed) + reach(formula, inputs)
    shown = rounded_like(value, printed)
    if shown != printed:
        shown = value.quantize(last_unit(printed) / 100) + 0
    return Cell(column, float(shown), float(printed), within)


def text_cell(row: Row, column: str, value: str) -> Cell:
    """A cell of words, such as the axis in Table 1."""
    return Cell(column, value, row[column], value == row[column])


def plain(text: str) -> float | int | str | None:
    """A printed cell as JSON: an empty one is null, whole numbers stay whole, words stay words."""
    if not text:
        return None
    try:
        value = Decimal(text)
    except InvalidOperation:
        return text
    return int(value) if "." not in text else float(value)


def tally(rows: Iterable[RecomputedRow], *, within_input_rounding: bool = False) -> dict[str, list[int]]:
    """Per recomputed column [cells that agree, all]: to the printed digits, or within the inputs' rounding."""
    result: dict[str, list[int]] = {}
    for cell in (cell for row in rows for cell in row.cells):
        count = result.setdefault(cell.column, [0, 0])
        count[0] += cell.within_input_rounding if within_input_rounding else cell.matches
        count[1] += 1
    return result

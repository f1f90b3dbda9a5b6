"""Comparison of a recomputed number: rounding, ties, and the effect of rounded inputs."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_HALF_EVEN, Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.studies.paper.tables import (
    RecomputedRow,
    half_unit,
    numeric_cell,
    plain,
    reach,
    round_like,
    tally,
    text_cell,
)

numbers = st.decimals(-10_000, 10_000, allow_nan=False, allow_infinity=False, places=6)
places = st.integers(0, 4)


def to_places(value: Decimal, digits: int) -> Decimal:
    return value.quantize(Decimal(1).scaleb(-digits), ROUND_HALF_EVEN)


@pytest.mark.parametrize(("printed", "half"), [("1.234", "0.0005"), ("26", "0.5"), ("-0.10", "0.005"), ("0", "0.5")])
def test_a_cell_matches_within_half_a_unit_of_the_last_digit(printed: str, half: str) -> None:
    assert half_unit(Decimal(printed)) == Decimal(half)


@pytest.mark.parametrize(
    ("value", "printed", "rounded"),
    [
        ("1.2344", "1.234", "1.234"),
        ("1.2346", "1.234", "1.235"),
        ("0.2195", "0.219", "0.219"),  # a tie: printed down
        ("0.02285", "0.0229", "0.0229"),  # a tie: printed up
        ("0.2195", "0.230", "0.220"),  # a tie, neither neighbour of which is the printed value
        ("-0.0004", "0.000", "0.000"),
        ("-5369.78471", "-5369.79", "-5369.78"),
    ],
)
def test_rounding_to_the_printed_digits(value: str, printed: str, rounded: str) -> None:
    assert str(round_like(Decimal(value), Decimal(printed))) == rounded


@given(value=numbers, printed=numbers, digits=places)
def test_rounding_moves_by_at_most_half_a_unit(value: Decimal, printed: Decimal, digits: int) -> None:
    shown = to_places(printed, digits)
    rounded = round_like(value, shown)
    assert abs(rounded - value) <= half_unit(shown)
    assert rounded.as_tuple().exponent == shown.as_tuple().exponent


@given(weights=st.lists(st.integers(-5, 5), min_size=1, max_size=6), digits=places)
def test_reach_of_a_linear_formula_is_exact(weights: list[int], digits: int) -> None:
    def formula(values: Sequence[Decimal]) -> Decimal:
        return sum((weight * value for weight, value in zip(weights, values, strict=True)), Decimal(0))

    inputs = [to_places(Decimal(i + 1), digits) for i in range(len(weights))]
    assert reach(formula, inputs) == sum(map(abs, weights)) * Decimal(5).scaleb(-digits - 1)


@given(values=st.lists(numbers, min_size=2, max_size=7), input_digits=places, digits=places)
def test_a_correctly_printed_mean_is_always_explained(values: list[Decimal], input_digits: int, digits: int) -> None:
    """A printed mean of unrounded numbers, recomputed from the rounded numbers, must not be reported as a slip."""

    def formula(inputs: Sequence[Decimal]) -> Decimal:
        return sum(inputs, Decimal(0)) / len(inputs)

    row = {"mean": str(to_places(formula(values), digits))}
    assert numeric_cell(
        row, "mean", formula, [to_places(value, input_digits) for value in values]
    ).within_input_rounding


def test_a_cell_beyond_the_rounding_of_its_inputs_is_not_explained() -> None:
    cell = numeric_cell({"ratio": "17.86"}, "ratio", lambda v: v[0] / v[1], [Decimal("0.574"), Decimal("0.090")])
    assert (cell.value, cell.printed) == (6.3778, 17.86)
    assert not cell.matches
    assert not cell.within_input_rounding


def test_rows_have_printed_and_recomputed_values() -> None:
    row = {"channel": "ADXL1 x", "range": "16g", "a": "1.20", "b": "7", "c": ""}
    cells = (numeric_cell(row, "a", lambda v: v[0], [Decimal("1.31")]), text_cell(row, "range", "2g"))
    result = RecomputedRow(row, cells, {"note": 1}).as_json()
    assert list(result) == ["channel", "range", "printed_range", "a", "printed_a", "b", "c", "note"]
    assert list(result.values()) == ["ADXL1 x", "2g", "16g", 1.31, 1.2, 7, None, 1]
    assert tally([RecomputedRow(row, cells)]) == {"a": [0, 1], "range": [0, 1]}


@pytest.mark.parametrize(("text", "value"), [("", None), ("16g", "16g"), ("3", 3), ("-1.50", -1.5)])
def test_cells_are_converted_to_numbers_or_text(text: str, value: float | str | None) -> None:
    assert plain(text) == value

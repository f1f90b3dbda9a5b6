"""Standard errors and the text's figures, against arithmetic on the printed literals."""

from __future__ import annotations

from decimal import Decimal
from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.studies.paper import recompute
from imuarray.studies.paper.conclusions import stated
from imuarray.studies.paper.tables import tally
from imuarray.studies.paper.variation import admitted, derived, range_over_deviation, readings


def test_standard_errors_and_table_2_follow_from_other_tables() -> None:
    counts = {"mean_lsb": [6, 6], "std_lsb": [6, 6], "sem_lsb": [8, 8], "runs_sem": [34, 34], "cont_sem": [34, 34]}
    assert tally(derived()) == counts
    assert tally(derived(), within_input_rounding=True) == counts


def test_readings_from_the_narrowest_rows() -> None:
    """The limiting rows are listed here; each limit is the rounding of one row, by hand."""
    slow, fast, runs, windows = readings()
    ends = {
        slow: ((35.5115 / 0.05115) ** 2, (35.1935 / 0.05065) ** 2),  # Gyro1 y, z
        fast: ((4.6535 / 0.00795) ** 2, (4.6835 / 0.00795) ** 2),  # Gyro1 x, z
        runs: ((61.6805 / 0.5085) ** 2, (44.1175 / 0.3635) ** 2),  # BMA4 y, x
        windows: ((62.4315 / 0.5185) ** 2, (51.6305 / 0.4285) ** 2),  # BMA4 y, BMA3 y
    }
    for result, (least, most) in ends.items():
        assert (float(result.least), float(result.most)) == (pytest.approx(least), pytest.approx(most))
        assert result.as_json()["agree"] is True
    assert float(runs.rate_hz or 0) == pytest.approx(49.07, abs=0.03)
    assert float(windows.rate_hz or 0) == pytest.approx(48.36, abs=0.04)
    assert float(slow.seconds or 0) == pytest.approx(1378.3, abs=1.2)
    assert float(fast.seconds or 0) == pytest.approx(985, abs=7)


@given(
    count=st.integers(2, 1_000_000),
    deviation=st.decimals("0.5", 100, places=6),
    digits=st.tuples(st.integers(1, 4), st.integers(4, 7)),
)
def test_correctly_printed_values_admit_the_true_number_of_readings(
    count: int, deviation: Decimal, digits: tuple[int, int]
) -> None:
    """A deviation and its standard error are rounded; 10^-5 covers the decimal root."""
    printed, error = (
        value.quantize(Decimal(1).scaleb(-places))
        for value, places in zip((deviation, deviation / Decimal(count).sqrt()), digits, strict=True)
    )
    if error <= Decimal(1).scaleb(-digits[1]):
        return  # half a unit is half of the value: the number is undetermined
    least, most = admitted(printed, error)
    assert float(least) * (1 - 1e-5) <= count <= float(most) * (1 + 1e-5)


def test_possible_and_expected_ranges_over_deviations() -> None:
    """Possible limits: all but two of fifteen in the middle, or seven at one end and eight at the other.

    The normal mean by 200 000 draws: standard error 0.36 / sqrt(200 000), five of them are allowed (1 in 10^6).
    """
    result = range_over_deviation()
    assert (result["least"], result["most"]) == (
        pytest.approx(sqrt(15 / 4), abs=6e-4),
        pytest.approx(sqrt(28), abs=6e-4),
    )
    assert result["possible"] == [64, 68]
    drawn = np.random.default_rng(11).standard_normal((200_000, 15))
    ratios = np.ptp(drawn, axis=1) / drawn.std(axis=1, ddof=1)
    assert result["normal"] == pytest.approx(float(ratios.mean()), abs=5 * 0.36 / sqrt(200_000) + 5e-4)
    rows = {(row["channel"], row["half"]): row for row in result["rows"]}
    assert rows["ADXL1 x", "cont"]["range_over_deviation"] == pytest.approx(0.162 / 0.044, abs=6e-4)
    assert {channel for (channel, _), row in rows.items() if not row["possible"]} == {"BMA1 t", "BMA2 t", "BMA4 t"}


STRAYS = {
    ("Section 4", "whole array logged so much slower"): (12, 7.3, False),
    ("Figure 6", "samples in 5 minutes"): (1400, 14508.1, False),
    ("Section 5.2.4", "ADXL345 run-to-run over in-run: most"): (1.8, 1.95, False),
    ("Section 5.2.4", "Gyro3 y in state 1, LSB"): (69, 69.97, False),
    ("Section 5.2.4", "Gyro3 z in state 2, LSB"): (0, 0.75, False),
    ("Section 5.2.5", "ADXL345 z slope over mean of x and y: most"): (10, 16.37, False),  # 0.352 / 0.0215
    ("Section 5.2.5", "Gyro1, Gyro2 slope but for one, LSB/degC: least"): (1.9, 0.187, False),
    ("Section 5.2.5", "Gyro1, Gyro2 slope but for one, LSB/degC: most"): (2.6, 0.265, False),
    ("Section 5.2.5", "Gyro1 y, Gyro2 y together, LSB/degC"): (0.004, 0.002, False),
    ("Appendix A.1", "seconds at 350 Hz, 2k dps"): (1400, 985, False),
    ("Appendix A.3", "BMA180 x noise, mg"): (15.6642, 15.664258, True),
    ("Appendix A.3", "BMA180 y noise, mg"): (19.3081, 19.308008, True),
}


def test_figures_of_the_text_that_differ_from_the_tables() -> None:
    result = {}
    for row in stated():
        (cell,) = row.cells
        if not cell.matches:
            result[row.row["table"], row.row["channel"]] = (cell.printed, cell.value, cell.within_input_rounding)
    assert result == STRAYS
    assert tally(stated()) == {"value": [23, 35]}


def test_a_figure_is_compared_to_its_digits() -> None:
    """Around 50 LSB: the mean of 40.05, 51.06, 49.98, 46.12, 68.80, 56.33 is 52.06, 50 to one digit."""
    rows = {row.row["channel"]: row.as_json() for row in stated()}
    around = rows["BMA180 1.5g xyz noise, LSB"]
    assert (around["value"], around["printed_value"], around["matches"]) == (50, 50, True)
    assert rows["L3G4200D with a positive slope, of 9"]["value"] == 8


def test_derived_rows_of_the_object() -> None:
    result = recompute()
    first = result["derived"][0]
    assert first == {
        "table": "Table 2",
        "channel": "Gyro1 x 250dps",
        "mean_lsb": 14.174,
        "printed_mean_lsb": 14.174,
        "difference": 0.0,
        "matches": True,
        "within_input_rounding": True,
        "follows_from": "Table 9, mean_lsb",
    }
    slower = result["stated"][0]
    assert (slower["difference"], slower["matches"], slower["within_input_rounding"]) == (-4.7, False, False)
    assert [outcome["log"] for outcome in result["readings"]] == ["250dps", "2k dps", "runs", "cont"]

"""Text of numbers, shares, parameters, statistics and quantities of parts."""

from __future__ import annotations

from dataclasses import replace
from math import asin, atanh, inf, log, nan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.findings.diagnosis import Gap, Pull
from imuarray.gap.findings.text import (
    chance,
    chance_text,
    closed_text,
    difference_text,
    effect_text,
    explained_pulls_text,
    gap_text,
    listed_causes,
    names_text,
    number,
    parameters_text,
    readable_statistic,
    scored,
    share,
    specification_text,
    unexplained_pulls,
)
from imuarray.gap.findings.verdict import LARGEST
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.synthetic_likelihood import LARGEST_SCORE
from tests.report.example_diagnoses import CAUSES, partial_diagnosis, where


def test_many_sensors_are_abbreviated() -> None:
    names = [f"IMU{number}_{half}" for number in range(1, 9) for half in ("acc", "gyro")]
    assert names_text(names) == "IMU1_acc to IMU8_acc, IMU1_gyro to IMU8_gyro"
    assert names_text(["BMA1", "Gyro1", "BMA2"]) == "BMA1, BMA2, Gyro1"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (-0.0, "0"), (12.345, "12.3"), (999.7, "1000"), (1234.5, "1230"), (123456.0, "123000"),
        (1.2e7, "1.2e+07"), (0.00012345, "0.000123"), (-3.0, "-3"), (nan, "–"), (inf, "–"),
    ],
)  # fmt: skip
def test_text_of_numbers(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0.0"), (9.94, "9.9"), (9.96, "10"), (412.3, "412"), (-1.5, "-1.5"), (inf, "∞"), (nan, "–")],
)
def test_text_of_scores(value: float, text: str) -> None:
    assert scored(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0 %"), (0.004, "<1 %"), (0.006, "1 %"), (0.994, "99 %"), (0.996, ">99 %"), (1.0, "100 %"), (None, "–"),
        (nan, "–"), (-0.06, "-6 %"), (1.2, "120 %"),
    ],
)  # fmt: skip
def test_text_of_shares(value: float | None, text: str) -> None:
    assert share(value) == text


def test_text_of_closed_shares_and_chance() -> None:
    assert closed_text(0.86, (0.75, 0.94)) == "86 % (75 to 94)"
    assert closed_text(0.86, None) == "86 %"
    assert closed_text(0.999, (0.996, 1.0)) == ">99 %"
    assert closed_text(1.0, (0.97, 1.0)) == "100 % (97 to 100)"
    assert closed_text(None, None) == "–"
    assert closed_text(0.43, (-7.71, 0.83)) == "43 % (below 0 to 83)"
    assert closed_text(-0.2, (-0.5, 0.1)) == "below 0 % (below 0 to 10)"
    assert closed_text(-0.2, (-0.5, -0.1)) == "below 0 %"
    assert [chance(p) for p in (0.5, 0.0312, 0.00049, nan)] == ["p = 0.5", "p = 0.031", "p < 0.001", "p –"]


@pytest.mark.parametrize(("replicates", "text"), [(64, "p < 0.016"), (40, "p < 0.025"), (400, "p < 0.0025")])
def test_the_smallest_p_is_printed_as_a_bound(replicates: int, text: str) -> None:
    """1/65 is 0.01538: p is at most that, printed as less than 0.016. Twice as much is a value."""
    least = 1 / (replicates + 1)
    assert chance(least, replicates) == text
    assert chance(2 * least, replicates) == f"p = {2 * least:.2g}"


def test_a_p_by_fitted_tails_is_added_where_it_is_smaller() -> None:
    limited = replace(partial_diagnosis(), p=1 / 65, replicates=64)
    none = "p < 0.016: none of 64 simulations without a gap differs as much"
    assert chance_text(limited) == none
    assert chance_text(replace(limited, p_tail=2e-4)) == f"{none}; p = 0.0002 by the tails fitted to these"
    assert chance_text(replace(limited, p_tail=1e-30)) == f"{none}; p < 1e-6 by the tails fitted to these"
    assert chance_text(replace(limited, p_tail=0.3)) == none
    assert chance_text(replace(limited, p=2 / 65, p_tail=1e-9)) == "p = 0.031"


def test_limits_of_scores_are_consistent() -> None:
    """The mean square of scores is limited as the scores are."""
    assert LARGEST == LARGEST_SCORE == 100


def test_text_of_a_gap() -> None:
    assert gap_text(Gap(14.2, 2.9, 1.02, 0.86, (0.75, 0.94))) == (
        "14 standard deviations (rms) before, 2.9 after, 1.0 without a gap: 86 % (75 to 94) closed"
    )
    assert gap_text(Gap(100.0, 0.0, 0.0, 1.0, (1.0, 1.0))).startswith("100 or more standard deviations")
    unknown = gap_text(Gap(5.2, 5.2, 0.9, None, None))
    assert unknown == "5.2 standard deviations (rms); held-out data show too little of it to measure how much closes"


@pytest.mark.parametrize(
    ("about", "unit", "values", "text"),
    [
        ("arcsine of the share of odd codes", "", (asin(0.5**0.5), 0.0), ("share of odd codes", "50 %", "0 %")),
        ("log of the noise from row to row", "log g", (log(0.0012), log(0.001)),
         ("noise from row to row", "1.2 mg", "1 mg")),
        ("log of the variance that the others don't explain", "log dps^2", (log(4.0), log(0.25)),
         ("standard deviation that the others don't explain", "2 dps", "0.5 dps")),
        ("log Allan variance at 8 rows", "", (log(3.0), 0.0), ("Allan variance at 8 rows", "3", "1")),
        ("Fisher's z of the correlation at lag 1", "", (atanh(0.25), 0.0), ("correlation at lag 1", "0.25", "0")),
        ("correlation with the next axis of the sensor, slow", "", (atanh(-0.5), nan),
         ("correlation with the next axis of the sensor, slow", "-0.5", "–")),
        ("normal score of the largest step", "", (23.0, 0.5),
         ("normal score of the largest step", "23 standard deviations", "0.5 standard deviations")),
        ("mean reading", "g", (0.99, 0.98996), ("mean reading", "0.99 g", "0.98996 g")),
        ("mean reading", "g", (0.0012, 0.0), ("mean reading", "1.2 mg", "0 mg")),
        ("slope of the mean over temperature", "g/degC", (4.4e-4, -3.2e-4),
         ("slope of the mean over temperature", "0.44 mg/°C", "-0.32 mg/°C")),
        ("response to force along the axis", "g/g", (0.9, 0.02),
         ("response to force along the axis", "0.9 g/g", "0.02 g/g")),
    ],
)  # fmt: skip
def test_statistics_are_printed_without_their_transformation(
    about: str, unit: str, values: tuple[float, float], text: tuple[str, str, str]
) -> None:
    real, simulated = values
    assert readable_statistic(replace(where(0, 1.0), about=about, unit=unit, real=real, simulated=simulated)) == text


@given(st.sampled_from(sorted(PROBES)), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_no_statistic_is_printed_as_a_logarithm(name: str, real: float, simulated: float) -> None:
    probe = PROBES[name]
    entry = replace(where(0, 1.0), about=probe.about, unit=probe.unit, real=real, simulated=simulated)
    about = readable_statistic(entry).about
    assert not about.startswith(("log", "ar", "Fisher"))


def test_text_of_a_difference() -> None:
    entry = replace(where(0, 412.3), phase="hot")
    text = (
        "Gyro2 x, coefficient of dT/dt in hot: recorded 50.9 dps s/°C, simulated 0 dps s/°C (more than 100 sd too high;"
        " 100 times what matters)"
    )
    assert difference_text(entry) == text
    assert "in hot of heating.h5: " in difference_text(entry, logs=2)
    assert difference_text(replace(entry, significance=-9.6, effect_size=-3.2)).endswith(
        "(9.6 sd too low; 3.2 times what matters)"
    )
    assert difference_text(replace(entry, size="harmless", effect_size=0.5)).endswith(
        "harmless, 0.5 times what matters)"
    )
    assert difference_text(replace(entry, size="can't tell")).endswith("too uncertain to say whether it matters)")


def test_text_of_the_change_by_a_cause() -> None:
    cause = replace(CAUSES[0], effect="tone")
    texts = [effect_text(replace(cause, action=action)) for action in ("add", "remove", "replace")]
    assert texts == ["tone", "no tone (the simulator has it)", "tone other than the simulator's"]


def test_only_probable_causes_are_listed() -> None:
    causes = [replace(CAUSES[0], probability=probability) for probability in (0.9, 0.05, 0.049, 0.004)]
    assert listed_causes(causes) == tuple(causes[:2])


PULLS = (
    Pull("scale factor error", "B2", "z", 2.13, "", 0.028, 76.07, "data sheet", ("range_reset",)),
    Pull("scale factor error", "B2", "x", 1.65, "", 0.028, 58.93, "data sheet", ("range_reset",)),
    Pull("misalignment", "B2", "yx", -2.18, "deg", 2.1, -1.038, "usual for such parts", ("range_reset", "bias")),
    Pull("misalignment", "B1", "yx", -2.18, "deg", 2.1, -1.038, "usual for such parts"),
    Pull("bias", "A1", "x", 0.21, "g", 0.2, 1.05, "data sheet"),
    Pull("bias", "A1", "y", 0.19, "g", 0.2, 0.95, "data sheet"),
)


def test_quantities_of_parts_have_units() -> None:
    assert [specification_text(pull) for pull in PULLS[1::2]] == [
        "B2 x: scale factor error 165 %, 58.9 times its tolerance of 2.8 % (data sheet)",
        "B1 yx: misalignment -2.18 deg, 1.04 times its tolerance of 2.1 deg (usual for such parts)",
        "A1 y: bias 0.19 g, 0.95 times its tolerance of 0.2 g (data sheet)",
    ]


def test_a_pull_that_a_cause_may_explain_is_not_a_separate_finding() -> None:
    assert unexplained_pulls(PULLS) == [PULLS[4], PULLS[3]]
    assert explained_pulls_text(PULLS) == (
        "Beyond tolerance as fitted without range_reset and bias, which may be the reason: B2 z x (scale factor error),"
        " B2 yx (misalignment)"
    )
    assert explained_pulls_text(PULLS[3:]) == ""


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"offset_g": [0.0123, -0.004, 0.0]}, "offset 12.3, -4, 0 mg"),
        ({"limit_g": 1.5}, "limit 1.5 g"),
        ({"slope_dps_per_degc": 0.1, "reference_degc": 25.0}, "slope 0.1 dps/°C; reference 25 °C"),
        ({"quadratic_g_per_degc2": 1e-4}, "quadratic 0.1 mg/°C²"),
        ({"slope_per_degc": 0.0003}, "slope 0.0003 /°C"),
        ({"density_dps_per_sqrt_s": 0.02}, "density 0.02 dps/√s"),
        ({"cubic_per_g2": 0.01}, "cubic 0.01 /g²"),
        ({"response_dps_per_g": [0.1, 0.2, 0.3]}, "response 0.1, 0.2, 0.3 dps/g"),
        ({"error": 0.012, "probability": 0.5}, "error 1.2 %; probability 50 %"),
        ({"error_ppm": 40.0}, "error 40 ppm"),
        ({"drift_hz_per_h": -11.5, "frequency_spread_hz": 2.0}, "drift -11.5 Hz/h; frequency spread 2 Hz"),
        ({"switches_per_s": 0.2, "step_lsb": 2, "phase_deg": 12.0}, "switches 0.2 /s; step 2 LSB; phase 12°"),
        ({"time_constant_s": 12.0, "burst_rows": 3.0}, "time constant 12 s; burst rows 3"),
        ({"axes": "+Y+X+Z", "kind": "torn"}, "axes +Y+X+Z; kind torn"),
        ({}, ""),
        ({"cutoff_hz": 15.5, "spans": [1.0, 97.12, 1e9]}, "cutoff 15.5 Hz; in log 2 from 97.1 s on"),
        (
            {"spans": [0.0, 0.0, 8.5, 0.0, 20.0, 30.0, 2.0, 0.0, 1e9]},
            "in log 1 until 8.5 s; in log 1 from 20 to 30 s; in log 3",
        ),
        (
            {"runs": [0.0, 0.0, 3.0], "moments_s": [12.39, 20.93, 4.0], "lengths_s": [0.48, 0.1, 0.5]},
            "in log 1 at 12.4, 20.9 s for 0.1 to 0.48 s; in log 4 at 4 s for 0.5 s",
        ),
        ({"runs": [1.0] * 11, "moments_s": list(range(11))}, "in log 2 at 0, 1, 2, 3, 4, 5, 6, 7, 8 ... (11 in all) s"),
        ({"range": 2.0, "runs": [1.0, 4.0]}, "range 2; in log 2; in log 5"),
        ({"range_g": 2.0, "onset_s": 4321.123, "run": 0.0}, "range 2 g; onset 4321.1 s; in log 1"),
        ({"range_g": 2.0, "run": nan}, "range 2 g"),
        ({"cutoff_hz": 15.5, "spans": [0.0, 4321.123, 1e9]}, "cutoff 15.5 Hz; in log 1 from 4321.1 s on"),
        (
            {"position_mm": [41.5, 0.0, -13.7]},
            "displacement from the configured position (box X, Y, Z) 41.5, 0, -13.7 mm",
        ),
    ],
)
def test_text_of_parameters(parameters: dict[str, Any], text: str) -> None:
    assert parameters_text(parameters) == text

"""The causal thermometer against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.fuse import causal_temperatures
from imuarray.fuse.element_temperature import CausalThermometer
from tests.fuse.conftest import Floats
from tests.fuse.warm_runs import BAROMETER, HEADERS
from tests.fuse.warm_runs import known as with_slopes


def fed(seconds: Floats, degc: Floats, lags_s: list[float], cuts: int = 7) -> CausalThermometer:
    thermometer = CausalThermometer(lags_s)
    for part in np.array_split(np.arange(len(seconds)), cuts):
        thermometer.add(np.round(seconds[part] * 1e9).astype(np.int64), degc[part])
    return thermometer


SECONDS = np.arange(4000) / 4  # 20 rows per segment, their middle 2.375 s after its begin


def test_a_ramp_is_extrapolated() -> None:
    """A ramp of 0.1 degC/s, from the middle of the last complete segment on; the first two segments have no trend and
    are constant.
    """
    thermometer = fed(SECONDS[:4020], 20 + 0.1 * SECONDS[:4020], [0.0])
    asked = np.array([500.01, 502.5, 504.9, 505.01])
    assert thermometer.at(asked, 0) == pytest.approx(20 + 0.1 * asked)
    beginning = fed(SECONDS[:100], 20 + 0.1 * SECONDS[:100], [0.0])
    asked = np.array([5.1, 9.9, 10.1, 14.9, 15.1])
    expected = np.array([2.375, 2.375, 7.375, 7.375, 15.1])
    assert beginning.at(asked, 0) == pytest.approx(20 + 0.1 * expected)


def test_noise_of_the_extrapolation() -> None:
    """Extrapolation for 17.6 s from the mean of 20 rows of unit noise, by the slope through four such means: the slope
    has 12 / (4 (4^2 - 1) 5^2) s^-2 of their variance, and a covariance of 7.5 / 125 s^-1 with the last of them.
    """
    rng = np.random.default_rng(4)
    late = CausalThermometer([0.0], 15.0)
    seconds = np.arange(40_000) / 4
    late.add((seconds * 1e9).astype(np.int64), rng.normal(0, 1, len(seconds)))
    values = np.array([late.at(np.array([at]), 0)[0] for at in (seconds[-1] - 299.9 + np.arange(0, 299, 5.0))])
    expected = (1 + 2 * 17.6 * 7.5 / 125 + 17.6**2 * 12 / (4 * 15 * 25)) / 20
    assert np.mean(values**2) == pytest.approx(expected, rel=0.5)  # 60 of them, of which 15 or more are independent


def test_before_a_segment_is_whole_its_rows_are_averaged() -> None:
    thermometer = fed(SECONDS, 20 + 0.1 * SECONDS, [0.0, 50.0])
    for column in (0, 1):
        means = 20 + 0.1 * np.array([0, 0.125, 1, 2.375])
        assert thermometer.at(np.array([0.0, 0.3, 2.0, 4.9]), column) == pytest.approx(means)
        assert thermometer.at(np.array([-1.0]), column) == pytest.approx([20.0])


def test_a_ramp_is_late_by_the_lag() -> None:
    """After more than ten lags."""
    thermometer = fed(SECONDS, 20 + 0.1 * SECONDS, [0.0, 40.0])
    assert thermometer.at(np.array([903.0]), 1) == pytest.approx([20 + 0.1 * (903.0 - 40.0)], abs=1e-6)


def test_late_rows_are_extrapolated_by_their_age() -> None:
    """Rows are 15 s old: the ramp is extrapolated by 15 s, and so is the element after it."""
    late = CausalThermometer([0.0, 40.0], 15.0)
    late.add((SECONDS * 1e9).astype(np.int64), 20 + 0.1 * SECONDS)
    asked = np.array([615.1, 903.0])
    assert late.at(asked, 0) == pytest.approx(20 + 0.1 * asked)
    assert late.at(asked, 1) == pytest.approx(20 + 0.1 * (asked - 40.0), abs=1e-5)
    assert late.at(np.array([3.0]), 0) == pytest.approx([20.0])


def test_a_step_is_followed_as_an_exponential() -> None:
    """From 20 to 30 degC between two segments: the straight line between their middles is a part of the step."""
    lag_s, at_s = 60.0, 500.0
    thermometer = fed(SECONDS, np.where(at_s > SECONDS, 20.0, 30.0), [lag_s])
    after = np.array([530.0, 560.0, 620.0])
    # The response to a ramp of 5 s, whose middle is an eighth of a second before the step.
    start = at_s - 5 + 2.375
    ramp = 10 / 5 * (5 - lag_s * (np.exp(-(after - start - 5) / lag_s) - np.exp(-(after - start) / lag_s)))
    assert thermometer.at(after, 0) == pytest.approx(20 + ramp, abs=1e-6)


def test_temperatures_do_not_depend_on_later_rows() -> None:
    rng = np.random.default_rng(1)
    degc = 20 + rng.normal(0, 1, len(SECONDS))
    asked = np.arange(0.0, 600.0, 0.7)
    whole, part = fed(SECONDS, degc, [30.0]), fed(SECONDS[:2401], degc[:2401], [30.0], cuts=50)
    assert whole.at(asked, 0) == pytest.approx(part.at(asked, 0), abs=1e-12)


def test_nan_values_are_ignored() -> None:
    degc = np.where(SECONDS % 1 == 0, np.nan, 25.0)
    assert fed(SECONDS, degc, [10.0]).at(np.array([0.0, 3.0, 700.0]), 0) == pytest.approx([25.0] * 3)
    assert np.isnan(fed(SECONDS, np.full(len(SECONDS), np.nan), [10.0]).at(np.array([5.0]), 0)).all()


@pytest.mark.slow
def test_old_segments_are_dropped() -> None:
    thermometer = CausalThermometer([10.0])
    for start in range(0, 40_000, 50):
        seconds = start + np.arange(50.0)
        thermometer.add((seconds * 1e9).astype(np.int64), 20 + 0.001 * seconds)
        thermometer.at(seconds, 0)
    assert len(thermometer._closed) < 100


@pytest.mark.parametrize(
    ("thermometers", "slopes", "found"),
    [
        (["P", "A1"], "barometer", {"A1": "P", "A2": "P", "G1": "P"}),
        (["A1"], "chip", {"A1": "A1", "A2": "A1", "G1": "A1"}),
        (["A1", "G1"], "chip", {"A1": "A1", "A2": "A1"}),  # the thermometer of a gyroscope has no zero
        (["G1"], "relative", {"A1": "G1", "A2": "G1", "G1": "G1"}),
        ([], "barometer", {}),
    ],
)
def test_the_thermometer_of_each_element(thermometers: list[str], slopes: str, found: dict[str, str]) -> None:
    inertial = [replace(header, has_temperature=name in thermometers) for name, header in HEADERS.items()]
    everything = [*inertial, *([BAROMETER] if "P" in thermometers else [])]
    temperatures = causal_temperatures(everything, inertial, with_slopes(slopes))
    assert set(temperatures.elements) == set(found)
    assert set(temperatures.feeds) == set(found.values())


def test_without_slopes_no_thermometer_is_used() -> None:
    temperatures = causal_temperatures([*HEADERS.values(), BAROMETER], list(HEADERS.values()), Calibration())
    assert (temperatures.elements, temperatures.feeds) == ({}, {})

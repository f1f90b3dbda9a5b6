"""A thermometer for those who can't see the future, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.fuse import running_temperatures
from imuarray.fuse.running import RunningThermometer
from tests.fuse.conftest import Floats
from tests.fuse.test_thermal import BAROMETER, HEADERS
from tests.fuse.test_thermal import known as with_slopes


def fed(seconds: Floats, degc: Floats, lags_s: list[float], cuts: int = 7) -> RunningThermometer:
    thermometer = RunningThermometer(lags_s)
    for part in np.array_split(np.arange(len(seconds)), cuts):
        thermometer.add(np.round(seconds[part] * 1e9).astype(np.int64), degc[part])
    return thermometer


SECONDS = np.arange(4000) / 4  # 20 rows a segment, their middle 2.375 s after its begin


def test_the_last_whole_segment_holds() -> None:
    """Of a ramp of 0.1 degC/s: what it was in the middle of that segment."""
    thermometer = fed(SECONDS, 20 + 0.1 * SECONDS, [0.0])
    asked = np.array([500.01, 502.5, 504.9, 505.01])
    middles = np.array([495.0, 495.0, 495.0, 500.0]) + 2.375
    assert thermometer.at(asked, 0) == pytest.approx(20 + 0.1 * middles)


def test_before_a_segment_is_whole_its_rows_are_averaged() -> None:
    thermometer = fed(SECONDS, 20 + 0.1 * SECONDS, [0.0, 50.0])
    for column in (0, 1):
        means = 20 + 0.1 * np.array([0, 0.125, 1, 2.375])
        assert thermometer.at(np.array([0.0, 0.3, 2.0, 4.9]), column) == pytest.approx(means)
        assert thermometer.at(np.array([-1.0]), column) == pytest.approx([20.0])


def test_behind_a_lag_a_ramp_is_late_by_it() -> None:
    """After ten lags: by the lag itself, and by what holds since the middle of the last segment."""
    lag_s = 40.0
    thermometer = fed(SECONDS, 20 + 0.1 * SECONDS, [0.0, lag_s])
    middle = 895 + 2.375
    since = 3.0 + 5 - 2.375
    exact = 20 + 0.1 * middle - 0.1 * lag_s * np.exp(-since / lag_s)
    assert thermometer.at(np.array([900.0 + 3.0]), 1) == pytest.approx([exact], abs=1e-6)


def test_rows_that_come_late_are_waited_for_by_nobody() -> None:
    """15 s old: as if it were 15 s earlier, but that the element has gone on towards the last mean since."""
    prompt = fed(SECONDS, 20 + 0.1 * SECONDS, [0.0, 40.0])
    late = RunningThermometer([0.0, 40.0], 15.0)
    late.add((SECONDS * 1e9).astype(np.int64), 20 + 0.1 * SECONDS)
    asked = np.array([615.1, 903.0])
    assert late.at(asked, 0) == pytest.approx(prompt.at(asked - 15, 0))
    held = prompt.at(asked - 15, 0)
    gone = held + (prompt.at(asked - 15, 1) - held) * np.exp(-15 / 40)
    assert late.at(asked, 1) == pytest.approx(gone)
    assert late.at(np.array([3.0]), 0) == pytest.approx([20.0])


def test_a_step_is_followed_as_an_exponential() -> None:
    """From 20 to 30 degC between two segments: the straight line between their middles is a part of the way."""
    lag_s, at_s = 60.0, 500.0
    thermometer = fed(SECONDS, np.where(at_s > SECONDS, 20.0, 30.0), [lag_s])
    after = np.array([530.0, 560.0, 620.0])
    # The response to the ramp of 5 s that the line is, whose middle is the step less an eighth of a second.
    start = at_s - 5 + 2.375
    ramp = 10 / 5 * (5 - lag_s * (np.exp(-(after - start - 5) / lag_s) - np.exp(-(after - start) / lag_s)))
    assert thermometer.at(after, 0) == pytest.approx(20 + ramp, abs=1e-6)


def test_what_it_says_depends_on_no_later_row() -> None:
    rng = np.random.default_rng(1)
    degc = 20 + rng.normal(0, 1, len(SECONDS))
    asked = np.arange(0.0, 600.0, 0.7)
    whole, part = fed(SECONDS, degc, [30.0]), fed(SECONDS[:2401], degc[:2401], [30.0], cuts=50)
    assert whole.at(asked, 0) == pytest.approx(part.at(asked, 0), abs=1e-12)


def test_values_that_are_none_do_not_count() -> None:
    degc = np.where(SECONDS % 1 == 0, np.nan, 25.0)
    assert fed(SECONDS, degc, [10.0]).at(np.array([0.0, 3.0, 700.0]), 0) == pytest.approx([25.0] * 3)
    assert np.isnan(fed(SECONDS, np.full(len(SECONDS), np.nan), [10.0]).at(np.array([5.0]), 0)).all()


def test_it_keeps_no_more_than_it_needs() -> None:
    thermometer = RunningThermometer([10.0])
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
        (["A1", "G1"], "chip", {"A1": "A1", "A2": "A1"}),  # a gyroscope's own has no zero
        (["G1"], "relative", {"A1": "G1", "A2": "G1", "G1": "G1"}),
        ([], "barometer", {}),
    ],
)
def test_whose_thermometer_it_is(thermometers: list[str], slopes: str, found: dict[str, str]) -> None:
    inertial = [replace(header, has_temperature=name in thermometers) for name, header in HEADERS.items()]
    everything = [*inertial, *([BAROMETER] if "P" in thermometers else [])]
    warming = running_temperatures(everything, inertial, with_slopes(slopes))
    assert set(warming.elements) == set(found)
    assert set(warming.feeds) == set(found.values())


def test_without_slopes_nobody_is_asked() -> None:
    warming = running_temperatures([*HEADERS.values(), BAROMETER], list(HEADERS.values()), Calibration())
    assert (warming.elements, warming.feeds) == ({}, {})

"""The temperature of a room without a record: each replicate has its own course."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.gap.model.base_model import replicate_seed
from imuarray.gap.model.replication import SensorModel, Stage
from imuarray.gap.model.rest import FittedParameters
from imuarray.gap.model.room_temperature import RoomTemperature, draw_room_temperature
from imuarray.simulate import Motion
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.motion.stimulus import temperature_at
from imuarray.simulate.streams import Streams
from tests.gap.small_bench import prepared

STILL = Still(seconds=20)
DAY_NS = np.arange(0, 86_400 * 10**9, 10**9, dtype=np.int64)


def courses(count: int) -> np.ndarray:
    """Temperatures (count, n) of rooms over a day, minus their mean, in degC."""
    rooms = (draw_room_temperature(STILL, Streams(seed), 0) for seed in range(count))
    degc = np.array([room.stimulus(DAY_NS).temperature_degc for room in rooms])
    return degc - degc.mean(axis=1, keepdims=True)


def test_the_course_is_a_sum_of_waves() -> None:
    room = RoomTemperature(Still(seconds=20, temperature_degc=20.0), 0.5, (4.0, 8.0), (0.0, 0.0))
    degc = temperature_at(room, np.array([0, 2, 4]) * 10**9)
    np.testing.assert_allclose(degc, [20.0, 20.5, 20.0], atol=1e-12)


@pytest.mark.slow
def test_courses_have_the_usual_size_of_rooms() -> None:
    """Between 0.02 and 0.5 degC (rms), half of the rooms below their geometric mean of 0.1 degC; 200 rooms are below it
    in 80 to 120 cases with a probability of 0.996.
    """
    rms_degc = courses(200).std(axis=1)
    assert 0.019 < rms_degc.min() < 0.03 and 0.35 < rms_degc.max() < 0.51
    assert 80 <= np.count_nonzero(rms_degc < 0.1) <= 120


@pytest.mark.slow
def test_courses_have_periods_of_20_s_to_half_an_hour() -> None:
    spectra = np.abs(np.fft.rfft(courses(30))) ** 2
    frequency_hz = np.fft.rfftfreq(len(DAY_NS))
    is_within = (frequency_hz > 1 / 2000) & (frequency_hz < 1 / 18)
    assert (spectra[:, is_within].sum(axis=1) > 0.95 * spectra.sum(axis=1)).all()
    period_s = np.sort(1 / frequency_hz[1 + spectra[:, 1:].argmax(axis=1)])
    assert period_s[0] < 40 and period_s[-1] > 1000


def test_sensors_of_a_log_share_the_course_and_logs_do_not() -> None:
    streams = Streams(7)
    assert draw_room_temperature(STILL, streams, 1) == draw_room_temperature(STILL, Streams(7), 1)
    assert draw_room_temperature(STILL, streams, 1) != draw_room_temperature(STILL, streams, 2)


@pytest.mark.parametrize("has_temperature", [True, False])
def test_biases_follow_the_room_without_a_recorded_temperature(has_temperature: bool) -> None:
    """The bias of a part without noise, 100 dps per degC from 25 degC on, is constant or follows the room's course."""
    bench, _ = prepared([("static", STILL)], ["G1"])
    experiments = tuple(each._replace(has_temperature=has_temperature) for each in bench.experiments)
    stage = Stage(bench.kinds, bench.split, bench.layouts, experiments, bench.base)
    steep = FittedParameters((1e-6,) * 3, (0.0,) * 3, (100.0,) * 3)
    kinds = frozenset(effect.name for effect in stage.base.drawn(3)["G1"]) - {"thermal_bias"}
    summary = stage.simulated({"G1": SensorModel(steep, removed=kinds)}, 3).logs[0].phases[0].sensors["G1"]
    level_dps = summary.segments.mean[:, 0] / summary.header.sensitivity
    room: Motion = draw_room_temperature(STILL, Streams(replicate_seed(bench.base.seed, 3)), 0)
    at_ns = np.rint(summary.segments.time_s * 1e9).astype(np.int64)
    degc = (STILL if has_temperature else room).stimulus(at_ns).temperature_degc
    assert (np.ptp(degc) > 0.02) != has_temperature
    np.testing.assert_allclose(level_dps, 100.0 * (degc - 25.0), atol=0.1)

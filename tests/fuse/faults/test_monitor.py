"""The fault monitor: blocks, latency, readmission, faults that cannot be isolated, and normal
behaviour without faults.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import FusionError
from imuarray.fuse import Frames
from imuarray.fuse.faults import FaultMonitor
from imuarray.fuse.faults.monitor import ExclusionMasks
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.effects.readings import Stuck
from tests.fuse.faults.conftest import (
    QUANTITIES,
    Floats,
    Run,
    faulty,
    of_range,
    simulated,
    watched,
)
from tests.selection import some


def at_rest(quantity: str = "specific_force") -> Run:
    return simulated("static", 25.0)[quantity]


def spoilt() -> Frames:
    """A sensor with an error for 2 s, then a sensor that gets stuck, and readings that flags exclude."""
    run = at_rest()

    def change(values: Floats) -> None:
        values[503:703, 4] += 1.0
        values[1207:, 9:12] = values[1207, 9:12]

    fed = faulty(run, change, 0, 1500)
    valid = fed.valid.copy()
    valid[300:340, 0:3] = False
    valid[::7, 15:18] = False
    return replace(fed, valid=valid)


@pytest.mark.slow
@settings(max_examples=3, deadline=None)
@given(cuts=st.lists(st.integers(0, 1500), max_size=12))
def test_results_do_not_depend_on_blocks(cuts: list[int]) -> None:
    fed = spoilt()
    whole, events = watched(at_rest().monitor(), fed)
    edges = [0, *sorted(cuts), len(fed.time)]
    blocks = [fed.part(slice(start, stop)) for start, stop in pairwise(edges)]
    joined, result = watched(at_rest().monitor(), *blocks)
    assert (joined.valid == whole.valid).all()
    assert (joined.time == fed.time).all()
    assert (joined.values == fed.values).all()
    assert [event.time_ns for event in result] == [event.time_ns for event in events]


@pytest.mark.slow
def test_flagged_readings_stay_excluded_and_healthy_axes_stay_in_use() -> None:
    fed = spoilt()
    whole, _ = watched(at_rest().monitor(), fed)
    assert not (whole.valid & ~fed.valid).any()
    lost = (fed.valid & ~whole.valid).any(axis=0)
    assert np.flatnonzero(lost).tolist() == [4, 9, 10, 11]


@pytest.mark.slow
def test_single_frames_are_delayed_by_at_most_a_fifth_of_a_second() -> None:
    run = at_rest()
    monitor, given_ = run.monitor(), 0
    for index in range(100):
        given_ += len(monitor(run.frames.part(slice(index, index + 1))).time)
        assert (index + 1 - given_) * run.period_s <= 0.2
    rest = monitor.finish()
    assert rest is not None
    assert given_ + len(rest.time) == 100


@pytest.mark.slow
def test_a_log_shorter_than_a_window_is_passed_through() -> None:
    run = at_rest()
    fed = run.frames.part(slice(0, 3))
    whole, events = watched(run.monitor(), fed)
    assert (whole.valid == fed.valid).all()
    assert not events


@pytest.mark.parametrize("quantity", some(QUANTITIES, 1))
def test_readmission_takes_three_seconds_and_six_the_second_time(quantity: str) -> None:
    """An error from 5 to 7 s, and from 12 to 14 s."""
    run = at_rest(quantity)

    def change(values: Floats) -> None:
        values[500:700, 4] += 10 * run.noise[4]
        values[1200:1400, 4] += 10 * run.noise[4]

    whole, events = watched(run.monitor(), faulty(run, change))
    assert [event.state for event in events] == ["isolated", "readmitted"] * 2
    seconds = [event.time_ns * 1e-9 for event in events]
    assert seconds == pytest.approx([5.0, 9.9, 12.0, 19.9], abs=0.25)
    assert whole.valid[1020:1180, 4].all()
    assert not whole.valid[1200:1400, 4].any()


@pytest.mark.slow
@pytest.mark.parametrize("pair", some([(("BMA1", "BMA2"),), (("Gyro1", "Gyro2"),)], 1))
def test_a_bias_between_two_triads_is_not_isolated(pair: tuple[str, str]) -> None:
    """A bias that grows within a second, without a jump that would identify the sensor; both stay in use, and an event
    reports it.
    """
    run = next(run for run in simulated("static", 25.0).values() if run.members(pair[0])).only(*pair)

    def change(values: Floats) -> None:
        values[1000:, 3] += 30 * run.noise[3] * np.clip((np.arange(len(values) - 1000)) / 100, 0, 1)

    whole, events = watched(run.monitor(), faulty(run, change))
    assert whole.valid.all()
    assert [event.state for event in events] == ["not isolated"]
    assert {events[0].sensor, *events[0].others} == set(pair)
    assert f"sigma), or the fault is in {events[0].others[0]}: not isolated, all remain in use" in events[0].sentence


KNOCK_ROWS = (900, 1100, 1400, 1650)
"""Each of a tenth of a second."""


def knocked(values: Floats, size: float) -> None:
    """Every axis rings on its own, like chips that sample a knock at different times."""
    for row in KNOCK_ROWS:
        values[row : row + 10] += np.random.default_rng(row).normal(0, size, (10, values.shape[1]))


@pytest.mark.parametrize("sigmas", [5, 30, 300])
def test_a_knock_of_all_sensors_is_not_a_fault(sigmas: float) -> None:
    run = at_rest()
    monitor = run.monitor()
    whole, events = watched(monitor, faulty(run, lambda values: knocked(values, sigmas * float(run.noise.max()))))
    assert events == ()
    assert whole.valid.all()
    assert 0 < monitor.disagreement_s <= 8 * 0.1 + 1e-9


def test_a_fault_that_begins_at_a_knock_is_isolated() -> None:
    """A bias of 30 standard deviations that begins with a knock of 5 and stays."""
    run = at_rest()
    axes = run.members("BMA2")

    def change(values: Floats) -> None:
        knocked(values, 5 * float(run.noise.max()))
        values[900:, axes] += 30 * run.noise[axes]

    whole, events = watched(run.monitor(), faulty(run, change))
    assert [(event.sensor, event.kind, event.state) for event in events] == [("BMA2", "bias", "isolated")]
    assert not whole.valid[930:, axes].any()


def test_rest_after_a_shake_is_not_stuck() -> None:
    """For 4 s readings scatter 40 times as much as at rest, and then as before."""
    run = at_rest()

    def change(values: Floats) -> None:
        shaken = slice(800, 1200)
        values[shaken] += np.random.default_rng(5).normal(0, 40, values[shaken].shape) * run.noise

    _, events = watched(run.monitor(), faulty(run, change))
    assert [event.kind for event in events] == []


@pytest.mark.parametrize("fault", some(["stuck", "range_reset", "noise"], 1))
@pytest.mark.parametrize("pair", [("BMA1", "BMA2"), ("Gyro1", "Gyro2")])
def test_a_stuck_reset_or_noisy_sensor_of_two_is_isolated(pair: tuple[str, str], fault: str) -> None:
    """The remaining sensor is reported as without redundancy."""
    run = next(run for run in simulated("static", 25.0).values() if run.members(pair[0])).only(*pair)
    rng = np.random.default_rng(2)

    def change(values: Floats) -> None:
        if fault == "stuck":
            values[1003:, 3:6] = values[1003, 3:6]
        elif fault == "range_reset":
            values[1003:, 3:6] *= of_range(run, pair[1])[2]
        else:
            values[1003:, 3:6] += rng.normal(0, 6 * run.noise[3:6], (len(values) - 1003, 3))

    whole, events = watched(run.monitor(), faulty(run, change))
    assert not whole.valid[1100:, 3:6].any()
    assert whole.valid[:, :3].all()
    assert [event.state for event in events] == ["isolated", "no redundancy"]
    assert {event.sensor for event in events} == {pair[1]}
    assert fault not in ("stuck", "range_reset") or events[0].kind == fault


def test_the_last_triad_stays_in_use() -> None:
    """All sensors of an array get stuck one after the other; the last triad is still fused."""
    run = at_rest("angular_rate")

    def change(values: Floats) -> None:
        for sensor in range(3):
            first = 1000 + 300 * sensor
            values[first:, 3 * sensor : 3 * sensor + 3] = values[first, 3 * sensor : 3 * sensor + 3]

    whole, events = watched(run.monitor(), faulty(run, change))
    assert whole.valid[2000:, 6:9].all()
    assert not whole.valid[2000:, :6].any()
    assert "no redundancy" in [event.state for event in events]


@pytest.mark.slow
def test_a_slow_drift_is_isolated_in_the_end() -> None:
    """10 mg/s on one axis: the drift within a second is below the noise, 0.1 g is beyond the effect of temperature."""
    run = simulated("static", 40.0)["specific_force"]

    def change(values: Floats) -> None:
        values[1000:, 1] += 0.01 * 9.80665 * (np.arange(len(values) - 1000) / 100)

    _, events = watched(run.monitor(), faulty(run, change))
    assert [(event.sensor, event.axes, event.kind) for event in events] == [("ADXL1", ("y",), "random_walk")]
    assert 0.1 < events[0].size_si / 9.80665 < 0.25


def test_a_silent_sensor_is_reported_with_its_return() -> None:
    run = at_rest()
    valid = run.frames.valid.copy()
    valid[500:900, 6:9] = False
    _, events = watched(run.monitor(), replace(run.frames, valid=valid))
    assert [(event.sensor, event.state) for event in events] == [("BMA1", "silent"), ("BMA1", "back")]
    assert [event.time_ns * 1e-9 for event in events] == pytest.approx([5.9, 9.9], abs=0.2)


@pytest.mark.slow
def test_simulated_stuck_counts_and_a_range_reset_are_isolated() -> None:
    """Repeated counts, which their chip flags as stale, and 2 g instead of 16 g from the middle of a log on."""
    changed = (("Gyro3", Stuck(onset_s=7.0)), ("BMA2", RangeReset(range=2.0, onset_s=7.0)))
    runs = simulated("static", 12.0, changed=changed)
    for quantity, sensor, kind in (("specific_force", "BMA2", "range_reset"), ("angular_rate", "Gyro3", "stuck")):
        whole, events = watched(runs[quantity].monitor(), runs[quantity].frames)
        assert [(event.sensor, event.kind) for event in events] == [(sensor, kind)]
        assert not whole.valid[720:, runs[quantity].members(sensor)].any()
    assert events[0].time_ns * 1e-9 == pytest.approx(7.0, abs=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_unknown_noise_is_learnt(quantity: str) -> None:
    """Learnt from the first seconds of the log: no healthy sensor is excluded, an error of 10 sigma is detected."""
    run = at_rest(quantity)
    unknown = tuple(replace(axis, noise_si=None) for axis in run.axes)

    def change(values: Floats) -> None:
        values[1500:, 3:6] += 10 * run.noise[3:6]

    monitor = FaultMonitor(unknown, quantity, period_s=run.period_s)
    _, events = watched(monitor, faulty(run, change))
    assert [(event.sensor, event.state) for event in events] == [(run.axes[3].sensor, "isolated")]
    assert events[0].time_ns * 1e-9 == pytest.approx(15.0, abs=0.15)


def test_noise_is_learnt_though_a_sensor_starts_late_or_stuck() -> None:
    """A sensor without a valid reading for 5 s, and a sensor stuck for as long: no other sensor is excluded."""
    run = at_rest()
    unknown = tuple(replace(axis, noise_si=None) for axis in run.axes)

    def change(values: Floats) -> None:
        values[:500, 9:12] = values[500, 9:12]
        values[:500, 0:3] = 0.0

    fed = faulty(run, change)
    valid = fed.valid.copy()
    valid[:500, 0:3] = False
    whole, events = watched(FaultMonitor(unknown, run.quantity, period_s=run.period_s), replace(fed, valid=valid))
    assert {event.sensor for event in events} <= {"ADXL1", "BMA2"}
    assert whole.valid[1000:].all()


def test_invalid_axes_and_periods_are_refused() -> None:
    axes = at_rest().axes
    with pytest.raises(FusionError, match="triads in the order"):
        FaultMonitor(axes[:4], "specific_force", period_s=0.01)
    with pytest.raises(FusionError, match="ADXL1"):
        FaultMonitor((*axes[:2], axes[5]), "specific_force", period_s=0.01)
    with pytest.raises(FusionError, match="period_s"):
        FaultMonitor(axes, "specific_force", period_s=0.0)


@pytest.mark.slow
def test_lever_arm_effects_are_not_a_fault() -> None:
    """Up to 3 cm from the middle, shaken at up to 500 dps: the lever-arm acceleration, computed here from the truth, is
    up to 0.3 g; with known rates of the box it is not a fault, without them it is.
    """
    runs = simulated("motion", 30.0)
    run, turned = runs["specific_force"], runs["angular_rate"].truth
    places = np.random.default_rng(3).uniform(-0.03, 0.03, (6, 3)).repeat(3, axis=0)
    axes = tuple(replace(axis, position_m=tuple(place)) for axis, place in zip(run.axes, places, strict=True))
    rows = np.array([axis.direction_box for axis in axes])
    faster = np.gradient(turned, run.frames.time * 1e-9, axis=0)
    cross = np.zeros((len(turned), 3, 3))
    for (i, j), sign, axis in (((0, 1), -1, 2), ((0, 2), 1, 1), ((1, 2), -1, 0)):
        cross[:, i, j], cross[:, j, i] = sign * turned[:, axis], -sign * turned[:, axis]
    spun = np.einsum("nij,njk,mk->nmi", cross, cross, places) + np.cross(faster[:, None], places[None])
    felt = (spun * rows).sum(axis=2)
    assert np.abs(felt).max() > 0.2 * 9.80665
    moved = replace(run.frames, values=run.frames.values + felt)
    for rates, fine in ((turned, True), (None, False)):
        monitor = FaultMonitor(axes, run.quantity, period_s=run.period_s)
        monitor(moved, rates)
        assert fine == (not [event.sentence for event in monitor.events if event.state == "isolated"])


HEALTHY = (
    ("static", 3600.0, "hand"),
    pytest.param("heating", 4800.0, "hand", marks=pytest.mark.campaign),
    pytest.param("motion", 1200.0, "hand", marks=pytest.mark.campaign),
    ("motion", 1200.0, "vehicle"),
)


@pytest.mark.slow
@pytest.mark.parametrize(("experiment", "seconds", "drive"), HEALTHY)
def test_healthy_sensors_are_not_excluded(experiment: str, seconds: float, drive: str) -> None:
    """None in three hours: at a rate of one exclusion an hour, the chance of that is 1 in e^3 = 20; the slow half has
    80 minutes of them, in which none has a chance of 1 in e^1.3 = 4 at that rate, and of 1 in 50 at three an hour. The
    data sheet's calibration: mounting errors up to 5 degrees, scale errors of 3 %, and 28 degC of heating.
    """
    for run in simulated(experiment, seconds, 25.0, 7, drive, ("range_reset",)).values():
        whole, events = watched(run.monitor(), run.frames)
        assert not [event.sentence for event in events if event.state in ("isolated", "not isolated")]
        assert (whole.valid == run.frames.valid).all()


@pytest.mark.slow
def test_readings_of_unknown_age_are_not_a_fault() -> None:
    """Nine axes, shaken at 5 Hz by 150 dps (4700 dps/s), their noise 0.17 dps; each chip's reading is up to 0.6 ms
    older or younger than assumed (800 a second): 3 dps at most. A hundred seconds.
    """
    rng = np.random.default_rng(8)
    time_s = np.arange(100 * 48) / 48
    run = simulated("static", 20.0)["angular_rate"]
    rows = np.array([axis.direction_box for axis in run.axes])
    late_s = np.repeat(rng.uniform(-0.000625, 0.000625, (len(time_s), 3)), 3, axis=1)
    shaken = np.radians(150) * np.sin(2 * np.pi * 5 * (time_s[:, None] - late_s))
    values = shaken * (rows @ np.array([0.6, -0.5, 0.62])) + rng.normal(0, run.noise, (len(time_s), 9))
    frames = Frames((time_s * 1e9).astype(np.int64), values, np.ones(values.shape, bool))
    _, events = watched(FaultMonitor(run.axes, "angular_rate", period_s=1 / 48), frames)
    assert events == ()


def test_masks_last_until_the_next_change() -> None:
    """Windows of four frames: no exclusion, axis 1 for two windows, no exclusion. The array of a window is reused."""
    masks, window = ExclusionMasks(4, 2), np.zeros(2, bool)
    for out in (False, True, True, False):
        window[1] = out
        masks.add(window[None])
    frames = Frames(np.arange(14), np.zeros((14, 2)), np.ones((14, 2), bool))
    valid = masks.of(frames, 2).valid  # frames 2 ... 15
    assert valid[:, 0].all()
    assert valid[:, 1].tolist() == [True] * 2 + [False] * 8 + [True] * 4
    assert masks.of(frames, 12) is frames

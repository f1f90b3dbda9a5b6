"""One sensor stuck, reset to another range, or biased by 10 sigma is excluded within a second, and the result equals
that of an array without it.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pytest

from imuarray.fuse import Frames
from imuarray.fuse.faults import FaultEvent, FaultMonitor
from imuarray.fuse.faults.exclusions import State
from imuarray.fuse.frames import directions
from imuarray.fuse.least_squares import AxisNoise, weighted
from tests.fuse.faults.conftest import (
    ACCELEROMETERS,
    GYROSCOPES,
    Flags,
    Floats,
    Run,
    faulty,
    of_range,
    simulated,
    watched,
)
from tests.selection import some


class Motion(NamedTuple):
    """A simulated log, and the first and last of its frames that are examined."""

    experiment: str
    seconds: float
    drive: str
    begins: int
    ends: int


AT_REST = Motion("static", 25.0, "hand", 1500, 2500)
DRIVEN = Motion("motion", 60.0, "vehicle", 2500, 3500)
SHAKEN = Motion("motion", 30.0, "hand", 1500, 2500)
"""By up to 8 g and 500 dps: the sensors of 1.5 g are clipped nearly all the time."""


def run_of(motion: Motion, sensor: str) -> Run:
    runs = simulated(motion.experiment, motion.seconds, drive=motion.drive)
    return runs["specific_force" if sensor in ACCELEROMETERS else "angular_rate"]


@lru_cache(maxsize=8)
def healthy(motion: Motion, quantity: str) -> tuple[FaultMonitor, Frames]:
    """A monitor after the log up to the examined frames, and its results."""
    run = simulated(motion.experiment, motion.seconds, drive=motion.drive)[quantity]
    monitor = run.monitor()
    return monitor, monitor(run.frames.part(slice(0, motion.begins)))


def seen(motion: Motion, run: Run, change: Callable[[Floats], None]) -> tuple[Flags, tuple[FaultEvent, ...]]:
    """The readings (n, m) of the stretch that remain in use after `change`, and the events."""
    before, given = healthy(motion, run.quantity)
    monitor = deepcopy(before)
    after, events = watched(monitor, faulty(run, change, motion.begins, motion.ends))
    return np.concatenate([given.valid, after.valid])[motion.begins : motion.ends], events


def rms(run: Run, values: Floats, valid: Flags, weights: Floats, motion: Motion) -> Floats:
    """(3,) error of the weighted fusion in the stretch."""
    stretch = slice(motion.begins, motion.ends)
    rows = directions(run.axes)
    fused = weighted(values[stretch], valid * weights, AxisNoise(rows, np.ones(len(rows)))).triad_box
    return np.asarray(np.sqrt(((fused - run.truth[stretch]) ** 2).mean(axis=0)))


class Fault(NamedTuple):
    """A fault of values (n, m) from a row on; the axes (0, 1, 2) of the sensor that it affects, and its name."""

    name: str
    spoil: Callable[[Floats, Run, str, int], None]
    axes: tuple[int, ...]
    kind: str


def stick(values: Floats, run: Run, sensor: str, onset: int) -> None:
    values[onset:, run.members(sensor)] = values[onset - 1, run.members(sensor)]


def reset(values: Floats, run: Run, sensor: str, onset: int) -> None:
    values[onset:, run.members(sensor)] *= of_range(run, sensor)[2]


def shift(*axes: int) -> Callable[[Floats, Run, str, int], None]:
    def spoil(values: Floats, run: Run, sensor: str, onset: int) -> None:
        concerned = [run.members(sensor)[axis] for axis in axes]
        values[onset:, concerned] += 10 * run.noise[concerned]

    return spoil


STUCK = Fault("stuck", stick, (0, 1, 2), "stuck")
RESET = Fault("reset", reset, (0, 1, 2), "range_reset")
WHOLE = Fault("whole sensor", shift(0, 1, 2), (0, 1, 2), "bias")
ONE = tuple(Fault(f"{'xyz'[axis]} alone", shift(axis), (axis,), "bias") for axis in range(3))


def check(motion: Motion, sensor: str, fault: Fault, onset_s: float = 0.0) -> None:
    """Check that the fault is detected within a second, named, and attributed to no other sensor, and that the error in
    x, y and z is at most 10 % above that of an array without the axes concerned: by the mean and by inverse variance,
    over the ten seconds from the onset on.
    """
    run = run_of(motion, sensor)
    onset = motion.begins + round(onset_s / run.period_s)
    values = run.frames.values.copy()
    fault.spoil(values, run, sensor, onset)
    left, events = seen(motion, run, lambda all_: fault.spoil(all_, run, sensor, onset))
    concerned = [run.members(sensor)[axis] for axis in fault.axes]
    late = run.frames.valid[motion.begins : motion.ends, concerned] & left[:, concerned]
    assert not late[onset - motion.begins + 100 :].any()
    observable = [event for event in events if event.state in ("isolated", "not isolated")]
    assert {event.sensor for event in observable} == {sensor}
    assert observable[0].kind == fault.kind
    assert set("".join("".join(event.axes) for event in observable)) == {"xyz"[axis] for axis in fault.axes}
    without = run.frames.valid[motion.begins : motion.ends].copy()
    without[:, concerned] = False
    for weights in (np.ones(len(run.axes)), 1 / run.noise**2):
        reached = rms(run, values, left, weights, motion)
        wanted = rms(run, run.frames.values, without, weights, motion)
        assert (reached < 1.1 * wanted).all()


EVERY = (*ACCELEROMETERS, *GYROSCOPES)
WITH_RANGES = EVERY[2:]
"""An ADXL345 at full resolution has one scale whatever its range (ADX-40)."""


@pytest.mark.parametrize("sensor", some(EVERY, 1))
@pytest.mark.parametrize(
    "fault",
    [STUCK, ONE[2], *(pytest.param(fault, marks=pytest.mark.slow) for fault in (WHOLE, ONE[0]))],
    ids=lambda fault: fault.name,
)
def test_a_fault_at_rest_is_isolated(sensor: str, fault: Fault) -> None:
    check(AT_REST, sensor, fault, onset_s=0.01 * EVERY.index(sensor))


@pytest.mark.parametrize("sensor", some(WITH_RANGES, 1))
def test_a_range_reset_at_rest_is_isolated(sensor: str) -> None:
    """A gyroscope at rest indicates it by its noise only."""
    check(AT_REST, sensor, RESET, onset_s=0.01 * EVERY.index(sensor))


@pytest.mark.slow
@pytest.mark.parametrize("sensor", EVERY)
@pytest.mark.parametrize("fault", [STUCK, WHOLE, ONE[1]], ids=lambda fault: fault.name)
def test_a_fault_in_a_vehicle_is_isolated(sensor: str, fault: Fault) -> None:
    check(DRIVEN, sensor, fault, onset_s=0.01 * EVERY.index(sensor))


@pytest.mark.slow
@pytest.mark.parametrize("sensor", some(["BMA2", "BMA3", "Gyro3"], 1))
def test_a_range_reset_in_a_vehicle_is_isolated(sensor: str) -> None:
    check(DRIVEN, sensor, RESET, onset_s=0.01 * EVERY.index(sensor))


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [*ACCELEROMETERS[:4], *GYROSCOPES])
@pytest.mark.parametrize("fault", [STUCK, RESET, WHOLE, *ONE], ids=lambda fault: fault.name)
def test_a_fault_while_shaken_by_hand_is_isolated(sensor: str, fault: Fault) -> None:
    if fault is RESET and sensor not in WITH_RANGES:
        pytest.skip("an ADXL345 at full resolution has one scale whatever its range")
    check(SHAKEN, sensor, fault, onset_s=0.01 * EVERY.index(sensor))


@pytest.mark.parametrize("onset", [1500, 1503, 1509])
def test_a_fault_is_isolated_at_any_onset_within_a_window(onset: int) -> None:
    """Ten frames are a window; one of the largest faults, on the axis along gravity and on those near 0 g."""
    check(AT_REST, "BMA2", RESET, onset_s=0.01 * (onset - 1500))


def test_a_burst_of_spikes_is_isolated() -> None:
    """Spikes of 20 sigma on three of ten readings of one axis, for a second; no other axis is suspected."""
    run = run_of(AT_REST, "BMA1")
    axis = run.members("BMA1")[1]
    rng = np.random.default_rng(3)
    hit = 1533 + np.flatnonzero(rng.random(100) < 0.3)
    size = 20 * run.noise[axis] * rng.choice([-1.0, 1.0], len(hit))

    def spoil(values: Floats) -> None:
        values[hit, axis] += size

    left, events = seen(AT_REST, run, spoil)
    assert not left[hit - 1500, axis].any()
    assert {(event.sensor, event.axes) for event in events} == {("BMA1", ("y",))}
    assert events[0].kind == "glitches"
    assert events[0].size_si == pytest.approx(20 * run.noise[axis], rel=0.2)


def test_two_faults_in_one_window_are_isolated() -> None:
    """One sensor is biased, and another gets stuck in the same window."""
    run = run_of(AT_REST, "BMA3")
    off, held = run.members("BMA3"), run.members("ADXL2")

    def spoil(values: Floats) -> None:
        values[1600:, off] += 10 * run.noise[off]
        values[1602:, held] = values[1602, held]

    left, events = seen(AT_REST, run, spoil)
    assert not left[200:, [*off, *held]].any()
    assert {(event.sensor, event.kind) for event in events} == {("BMA3", "bias"), ("ADXL2", "stuck")}


def test_the_sentence_states_the_size_of_the_error() -> None:
    run = run_of(AT_REST, "Gyro2")
    axis = run.members("Gyro2")[2]

    def spoil(values: Floats) -> None:
        values[1600:, axis] += np.radians(5.0)

    _, events = seen(AT_REST, run, spoil)
    assert len(events) == 1
    assert np.degrees(events[0].size_si) == pytest.approx(5.0, abs=0.3)
    assert events[0].sentence.startswith("16.00 s: Gyro2 z is off by ")
    assert " dps (" in events[0].sentence
    assert events[0].sentence.endswith(" sigma): excluded")


@pytest.mark.parametrize(
    ("axes", "state", "sentence"),
    [
        ("y", "isolated", "2.00 s: A y scatters 3 times as much as before (9 sigma): excluded"),
        ("xz", "isolated", "2.00 s: A x and z scatter 3 times as much as before (9 sigma): excluded"),
        ("xyz", "isolated", "2.00 s: A scatters 3 times as much as before (9 sigma): excluded"),
        ("xz", "readmitted", "2.00 s: A x and z agree with the others again: back in use"),
        (
            "xz",
            "not isolated",
            "2.00 s: A x and z scatter 3 times as much as before (9 sigma), or the fault is in B or C: "
            "not isolated, all remain in use",
        ),
    ],
)
def test_sentences_of_one_axis_two_axes_and_a_sensor(axes: str, state: State, sentence: str) -> None:
    event = FaultEvent(
        2_000_000_000, "specific_force", "A", tuple(axes), "white_noise", state, 3.0, 9.0, others=("B", "C")
    )
    assert event.sentence == sentence


@pytest.mark.parametrize(("axes", "verb"), [("z", "disagrees"), ("xz", "disagree")])
def test_an_error_with_too_few_readings_has_no_stated_size(axes: str, verb: str) -> None:
    event = FaultEvent(2_000_000_000, "angular_rate", "A", tuple(axes), "bias", "isolated", 0.0, 8.0)
    assert event.sentence.endswith(f"{verb} with the others in its few valid readings (8 sigma): excluded")

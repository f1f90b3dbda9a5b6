"""Window means of several sensors against a plain loop; true motion and common errors separated by the mounting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from imuarray.gap.model.signal_delay import NO_DELAY, SignalDelay, can_fit_signal_delays, fit_signal_delays
from imuarray.gap.statistics.campaign import Campaign, Layout, LogSummary, PhaseSummary
from imuarray.gap.statistics.cross import Cross, CrossTally, window_ns
from imuarray.gap.statistics.probes import PROBES, CrossProbe
from imuarray.gap.statistics.probes.motion import joint_gains
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate.motion.faces import resting
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.units import SI_PER_UNIT
from tests.gap.small_campaign import block, header

WINDOW_NS = 100_000_000
ROWS, INTERVAL_NS = 4000, 10_000_000
PHASE = Phase(0, ROWS * INTERVAL_NS, "static", "+Z")


def crossed(
    sensors: list[SensorHeader],
    counts: list[np.ndarray],
    phase: Phase = PHASE,
    pieces: int = 1,
    window: int = WINDOW_NS,
) -> Cross:
    tally = CrossTally(sensors, phase, window)
    for part in range(pieces):
        for sensor, rows in zip(sensors, counts, strict=True):
            first, stop = part * len(rows) // pieces, (part + 1) * len(rows) // pieces
            tally.update(sensor.name, block(rows[first:stop], INTERVAL_NS, first * INTERVAL_NS))
    return tally.result()


def value(name: str, cross: Cross, sensor: str) -> np.ndarray:
    probe = PROBES[name]
    assert isinstance(probe, CrossProbe)
    return probe.statistic(cross, sensor)


def random_counts(seed: int, sigma: float = 30.0) -> np.ndarray:
    return np.rint(np.random.default_rng(seed).normal(0, sigma, (ROWS, 3)))


@pytest.mark.parametrize("pieces", [1, 7, 40])
def test_moments_equal_those_of_a_plain_loop(pieces: int) -> None:
    """400 windows of 10 rows in 50 segments of 8."""
    sensors = [header("A"), header("B", "-X+Y-Z")]
    counts = [random_counts(1), random_counts(2)]
    found = crossed(sensors, counts, pieces=pieces)
    line = np.concatenate([rows.reshape(400, 10, 3).mean(axis=1) / 2048 for rows in counts], axis=1)
    segments = line.reshape(50, 8, 6)
    apart = (segments - segments.mean(axis=1, keepdims=True)).reshape(400, 6)
    assert found.windows == 400
    np.testing.assert_allclose(found.slow[:, :6], segments.mean(axis=1), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.fast[:6, :6], apart.T @ apart / 400, rtol=1e-9)
    inside = apart.reshape(50, 8, 6)
    changes = (inside[:, 2:] - inside[:, :-2]) / 2
    changes = (changes - changes.mean(axis=1, keepdims=True)).reshape(300, 6)
    turning = inside[:, 1:-1].reshape(300, 6).T @ changes
    np.testing.assert_allclose(found.turning[:6, :6], turning / 300, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.changes[:6, :6], changes.T @ changes / 300, rtol=1e-9)
    np.testing.assert_allclose(found.slow_covariance[:6, :6], np.cov(segments.mean(axis=1).T), rtol=1e-9)


def test_replicates_together_equal_single_ones() -> None:
    sensors = [header("A"), header("B", "-X+Y-Z")]
    replicates = [[random_counts(1), random_counts(2)], [random_counts(3), random_counts(4)]]
    tally = CrossTally(sensors, PHASE, WINDOW_NS, 2)
    for at, sensor in enumerate(sensors):
        tally.update(sensor.name, *(block(counts[at], INTERVAL_NS) for counts in replicates))
    for found, counts in zip(tally.results(), replicates, strict=True):
        alone = crossed(sensors, counts)
        for name in ("slow", "fast", "turning", "changes"):
            np.testing.assert_allclose(getattr(found, name), getattr(alone, name), rtol=1e-12, atol=1e-15)
        assert found.windows == alone.windows


def test_windows_that_one_sensor_lacks_are_excluded() -> None:
    sensors = [header("A"), header("B")]
    tally = CrossTally(sensors, PHASE, WINDOW_NS)
    tally.update("A", block(random_counts(1), INTERVAL_NS))
    tally.update("B", block(random_counts(2)[:2000], INTERVAL_NS))
    tally.update("B", block(random_counts(3)[:1960], INTERVAL_NS, 2040 * INTERVAL_NS))
    assert tally.result().windows == 396


def test_common_windows_end_with_the_first_lost_sensor() -> None:
    sensors = [header("A"), header("B")]
    tally = CrossTally(sensors, PHASE, WINDOW_NS)
    tally.update("B", block(random_counts(2)[:2000], INTERVAL_NS))
    tally.end("B")
    tally.update("A", block(random_counts(1), INTERVAL_NS))
    found = tally.result()
    assert found.windows == 200
    assert np.isnan(found.slow[25:]).all()
    assert np.isfinite(found.slow[:25]).all()


def test_the_mounting_separates_motion_from_a_common_error() -> None:
    """B is upside down: x and z reversed. Correlation s^2 / (s^2 + n^2) = 0.5 where both read the same."""
    sensors = [header("A"), header("B", "-X+Y-Z")]
    shared, mine, yours = random_counts(1), random_counts(2), random_counts(3)
    z = np.arctanh(0.5)
    error = crossed(sensors, [shared + mine, shared + yours])
    motion = crossed(sensors, [shared + mine, shared * [-1, 1, -1] + yours])
    # 350 degrees of freedom: a standard error of 0.053 each, 5 of them
    for name in ("fast_own_axes", "slow_own_axes"):
        wide = 5 / np.sqrt(45) if name.startswith("slow") else 0.27
        np.testing.assert_allclose(value(name, error, "A"), z, atol=wide)
        np.testing.assert_allclose(value(name, motion, "A"), [-z, z, -z], atol=wide)
    np.testing.assert_allclose(value("fast_box_axes", error, "B"), [-z, z, -z], atol=0.27)
    np.testing.assert_allclose(value("fast_box_axes", motion, "B"), z, atol=0.27)
    np.testing.assert_allclose(value("fast_between_axes", motion, "B"), 0.0, atol=0.27)


def test_box_axes_are_reported_at_the_sensor_axis_along_them() -> None:
    """A's y is along X, B's x against X: the common motion along X is reported on A's y."""
    sensors = [header("A", "+Y+X-Z"), header("B", "-X+Y-Z")]
    along_x, mine, yours = random_counts(1)[:, :1], random_counts(2), random_counts(3)
    found = crossed(sensors, [mine + along_x * [0, 1, 0], yours + along_x * [-1, 0, 0]])
    np.testing.assert_allclose(value("fast_box_axes", found, "A"), [0, np.arctanh(0.5), 0], atol=0.27)


def test_a_single_sensor_of_its_kind_has_no_common_statistics() -> None:
    found = crossed([header("A"), header("G", chip="l3g4200d")], [random_counts(1), random_counts(2)])
    for name in ("fast_own_axes", "slow_box_axes", "motion_gain", "motion_delay", "motion_coupling"):
        assert np.isnan(value(name, found, "A")).all()
    assert np.isfinite(value("fast_between_axes", found, "A")).all()


def swaying(seconds: np.ndarray) -> np.ndarray:
    """(n, 3) three sines of incommensurate frequencies."""
    return np.stack([np.sin(2 * np.pi * hz * seconds) for hz in (0.9, 1.3, 1.7)], axis=1)


SECONDS = np.arange(ROWS) * 0.01
MOVING = PHASE._replace(name="motion", up="")


def moved(response: np.ndarray, delay_s: float = 0.0) -> Cross:
    """A reads the motion through `response` and with a delay; B, rotated, reads it without errors. One count is 5e-5 of
    it.
    """
    other = header("B", "-X+Y-Z")
    counts = [20_000 * swaying(SECONDS - delay_s) @ response.T, 20_000 * swaying(SECONDS) @ np.array(other.orientation)]
    return crossed([header("A"), other], [np.rint(rows) for rows in counts], MOVING, window=50_000_000)


def test_gain_and_cross_axis_response_of_motion() -> None:
    response = np.array([[1.02, 0.01, 0.0], [0.0, 0.97, -0.03], [0.02, 0.0, -1.0]])
    found = moved(response)
    np.testing.assert_allclose(value("motion_gain", found, "A"), [1.02, 0.97, -1.0], atol=1e-4)
    np.testing.assert_allclose(value("motion_next", found, "A"), [0.01, -0.03, 0.02], atol=1e-4)
    np.testing.assert_allclose(value("motion_after", found, "A"), [0.0, 0.0, 0.0], atol=1e-4)


def test_motion_about_one_axis_determines_the_scale_along_it() -> None:
    """All axes of the box have the same rate: the gain along each alone is that of the scale and of its cross-axis
    response, and a regression on all three, which only the noise could separate, has no value. An axis without rotation
    has no value.
    """
    sway = swaying(SECONDS)[:, :1] * [0.8, 0.6, 0.0]
    response = np.diag([0.75, 0.75, 0.75])
    response[0, 1] = 0.02
    rng = np.random.default_rng(4)
    counts = [np.rint(20_000 * sway @ matrix.T + rng.normal(0, 30, (ROWS, 3))) for matrix in (response, np.eye(3))]
    found = crossed([header("A"), header("B")], counts, MOVING, window=50_000_000)
    along = value("motion_along", found, "A")
    np.testing.assert_allclose(along[:2], [0.75 + 0.02 * 0.6 / 0.8, 0.75], atol=2e-3)
    assert np.isnan(along[2])
    for probe in ("motion_gain", "motion_next", "motion_after"):
        assert np.isnan(value(probe, found, "A")).all()


def test_motion_about_one_axis_determines_the_cross_axis_responses() -> None:
    """A box that turns about Y only: the other axes of a sensor read the sines of its misalignment. Motions about three
    axes have shares on each axis.
    """
    sway = swaying(SECONDS)[:, :1] * [0.0, 1.0, 0.0]
    response = np.array([[1.0, 0.05, 0.0], [0.0, 1.0, 0.0], [0.0, -0.03, 1.0]])
    rng = np.random.default_rng(4)
    counts = [np.rint(20_000 * sway @ matrix.T + rng.normal(0, 30, (ROWS, 3))) for matrix in (response, np.eye(3))]
    across = value("motion_across", crossed([header("A"), header("B")], counts, MOVING, window=50_000_000), "A")
    np.testing.assert_allclose(across[[0, 2]], [0.05, -0.03], atol=2e-3)
    assert np.isnan(across[1])
    assert np.isnan(value("motion_across", moved(response), "A")).all()


def test_turns_about_several_single_axes_determine_the_response() -> None:
    """Three turns, each about another oblique axis: none separates the axes, all three do."""
    response = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.02], [0.0, 0.0, 0.97]])
    rng = np.random.default_rng(4)
    crosses = []
    for axis in ([0.8, 0.6, 0.0], [0.0, 0.8, 0.6], [0.6, 0.0, 0.8]):
        sway = swaying(SECONDS)[:, :1] * axis
        counts = [np.rint(20_000 * sway @ matrix.T + rng.normal(0, 30, (ROWS, 3))) for matrix in (response, np.eye(3))]
        crosses.append(crossed([header("A"), header("B")], counts, MOVING, window=50_000_000))
        assert np.isnan(joint_gains(crosses[-1:], "A")).all()
    np.testing.assert_allclose(joint_gains(crosses, "A"), response, atol=5e-3)
    assert np.isnan(joint_gains([], "A")).all()
    assert np.isnan(joint_gains(crosses, "C")).all()


@dataclass(frozen=True)
class Swaying:
    """Motion of a box that sways along X and Y, and along Z by a share, with the rates and forces of `swaying` in SI
    units.
    """

    phases: tuple[Phase, ...] = (MOVING,)
    seconds: float = 40.0
    share_z: float = 0.0

    def stimulus(self, time_ns: np.ndarray) -> BoxStimulus:
        sway = swaying(time_ns * 1e-9) * [1.0, 1.0, self.share_z]
        return replace(resting(time_ns, np.eye(3), 25.0), force_box=9.80665 * sway, rate_box=np.radians(100) * sway)


def test_a_single_sensor_is_compared_with_the_track() -> None:
    """An accelerometer with errors of scale and mounting, a gyroscope without errors: gains of 1.05 and 1, 2 % of X on
    the axis along Y, and nothing of Z, along which the box does not move.
    """
    sensors = [
        header("A", "+Y+X-Z"),
        header("G", chip="l3g4200d", unit="dps", quantity="angular_rate", sensitivity=100.0),
    ]
    motion = Swaying()
    own = swaying(SECONDS) * [1.0, 1.0, 0.0]
    response = np.array([[1.05, 0.02, 0.0], [0.0, 1.05, 0.0], [0.0, 0.0, 1.0]])  # own x is along the box's Y
    counts = [2048 * own[:, [1, 0, 2]] @ response.T, 100 * 100 * own]
    tally = CrossTally(sensors, MOVING, 50_000_000, track=motion)
    for sensor, rows in zip(sensors, counts, strict=True):
        for first in (0, 1500):
            part = np.rint(rows[first : 1500 if first == 0 else None])
            tally.update(sensor.name, block(part, INTERVAL_NS, first * INTERVAL_NS))
    found = tally.result()
    np.testing.assert_allclose(value("motion_gain", found, "A"), [1.05, 1.05, 0.0], atol=3e-3)
    np.testing.assert_allclose(value("motion_next", found, "A"), [0.02, 0.0, 0.0], atol=3e-3)
    np.testing.assert_allclose(value("motion_gain", found, "G"), [1.0, 1.0, 0.0], atol=3e-3)
    np.testing.assert_allclose(value("motion_delay", found, "A")[:2], 0.0, atol=1e-3)
    assert found.fast[found.kinematic, found.kinematic].shape == (9, 9)


def tracked_gains(gains: tuple[float, ...]) -> tuple[tuple[str, ...], list[np.ndarray]]:
    """Sensors that the track is compared with, and `motion_gain` of sensors with these gains."""
    sensors = [header(name) for name in "ABC"[: len(gains)]]
    tally = CrossTally(sensors, MOVING, 50_000_000, track=Swaying(share_z=1.0))
    for sensor, gain in zip(sensors, gains, strict=True):
        tally.update(sensor.name, block(np.rint(gain * 2048 * swaying(SECONDS)), INTERVAL_NS))
    moments = tally.result()
    return moments.tracked, [value("motion_gain", moments, sensor.name) for sensor in sensors]


def test_the_track_identifies_the_wrong_one_of_two_sensors() -> None:
    """Each is compared with the mean of the other and the track: 1.1 with 1, and 1 with 1.05."""
    tracked, (first, other) = tracked_gains((1.1, 1.0))
    assert tracked == ("A", "B")
    np.testing.assert_allclose(first, 1.1, atol=3e-3)
    np.testing.assert_allclose(other, 1 / 1.05, atol=3e-3)


def test_a_common_delay_behind_the_track_is_allowed() -> None:
    """The clock of the reference differs from that of the sensors."""

    def campaign(delay_s: float) -> Campaign:
        tally = CrossTally(list(headers.values()), MOVING, 50_000_000, track=Swaying(share_z=1.0))
        for name in headers:
            tally.update(name, block(np.rint(2048 * swaying(SECONDS - delay_s)), INTERVAL_NS))
        phase = PhaseSummary(MOVING, 0, Layout({}, 50_000_000), {}, tally.result())
        return Campaign((LogSummary("motion", (phase,)),))

    headers = {name: header(name, bandwidth_hz=1e4) for name in "AB"}
    trials = [(dict.fromkeys(headers, NO_DELAY), [campaign(0.0)])]
    fitted = fit_signal_delays(campaign(0.004), headers, (), trials)
    assert fitted["A"].stamp_s == fitted["B"].stamp_s == pytest.approx(0.004, rel=0.1)


def swaying_campaign(headers: Mapping[str, SensorHeader], *delays_s: float) -> Campaign:
    """A motion that these sensors read with these delays."""
    tally = CrossTally(list(headers.values()), MOVING, 50_000_000)
    for sensor, delay_s in zip(headers.values(), delays_s, strict=True):
        rows = np.rint(sensor.sensitivity * swaying(SECONDS - delay_s))
        tally.update(sensor.name, block(rows, INTERVAL_NS))
    phase = PhaseSummary(MOVING, 0, Layout({}, 50_000_000), {}, tally.result())
    return Campaign((LogSummary("motion", (phase,)),))


@pytest.mark.parametrize(("chips", "is_nuisance"), [(("bma180", "adxl345"), True), (("adxl345", "adxl345"), False)])
def test_a_common_delay_of_the_units_of_a_chip_is_allowed(chips: tuple[str, str], is_nuisance: bool) -> None:
    """18 ms at a data rate of 100 Hz; a delay of one of two units of a chip is a fault."""
    headers = {name: header(name, chip=chip, rate_hz=100.0) for name, chip in zip("AB", chips, strict=True)}

    assert can_fit_signal_delays(swaying_campaign(headers, 0.0, 0.018), headers, ()) == is_nuisance
    trials = [(dict.fromkeys(headers, NO_DELAY), [swaying_campaign(headers, 0.0, 0.0)])]
    fitted = fit_signal_delays(swaying_campaign(headers, 0.0, 0.018), headers, (), trials)
    later_s = fitted["B"].stamp_s - fitted["A"].stamp_s
    assert later_s == pytest.approx(0.018 if is_nuisance else 0.0, abs=0.002)


def test_a_replicate_with_an_outlying_delay_does_not_shift_the_fit() -> None:
    """One of six is late by 60 ms, by which the mean of all would be late by 10 ms."""
    headers = {
        name: header(name, chip=chip, rate_hz=100.0) for name, chip in zip("AB", ("bma180", "adxl345"), strict=True)
    }
    replicates = [swaying_campaign(headers, 0.0, late_s) for late_s in (0.0, 0.0, 0.06, 0.0, 0.0, 0.0)]
    trials = [(dict.fromkeys(headers, NO_DELAY), replicates)]
    fitted = fit_signal_delays(swaying_campaign(headers, 0.0, 0.018), headers, (), trials)
    assert fitted["B"].stamp_s - fitted["A"].stamp_s == pytest.approx(0.018, abs=0.002)


def test_a_step_that_increases_the_distance_is_reverted() -> None:
    """The first trial is 2 ms too early, the second 30 ms too late: the first is nearer."""
    headers = {name: header(name, chip=chip, rate_hz=100.0) for name, chip in (("A", "bma180"), ("B", "adxl345"))}
    delays = [{"A": NO_DELAY, "B": SignalDelay(stamp_s=stamp_s)} for stamp_s in (0.016, 0.048)]
    trials = [(tried, [swaying_campaign(headers, 0.0, tried["B"].stamp_s)]) for tried in delays]
    assert fit_signal_delays(swaying_campaign(headers, 0.0, 0.018), headers, (), trials) == delays[0]


@pytest.mark.parametrize("late_s", [0.0, 0.018])
def test_the_delay_of_one_unit_is_not_assigned_to_its_chip(late_s: float) -> None:
    """One is 30 ms later than the other: the fault is its own, and the common delay is that of the other."""
    chips = {"A": "bma180", "B": "adxl345", "C": "adxl345"}
    headers = {name: header(name, chip=chip, rate_hz=100.0) for name, chip in chips.items()}

    trials = [(dict.fromkeys(headers, NO_DELAY), [swaying_campaign(headers, 0.0, 0.0, 0.0)])]
    fitted = fit_signal_delays(swaying_campaign(headers, 0.0, late_s, late_s + 0.03), headers, (), trials)
    assert fitted["B"].stamp_s == fitted["C"].stamp_s
    assert fitted["B"].stamp_s - fitted["A"].stamp_s == pytest.approx(late_s, abs=0.002)


def test_three_sensors_are_compared_with_each_other_only() -> None:
    tracked, (first, second, third) = tracked_gains((1.1, 1.0, 1.0))
    assert tracked == ()
    np.testing.assert_allclose(first, 1.1, atol=3e-3)
    np.testing.assert_allclose([second, third], 1 / 1.05, atol=3e-3)


def test_the_track_stands_beside_the_first_of_three_sensors() -> None:
    """In its unit, along the box's axes: a sensor that reads 1.1 of a force has 1.1 of the track's variance."""
    sensors = [header(name) for name in "ABC"]
    tally = CrossTally(sensors, MOVING, 50_000_000, track=Swaying(share_z=1.0))
    for sensor in sensors:
        tally.update(sensor.name, block(np.rint(1.1 * 2048 * swaying(SECONDS)), INTERVAL_NS))
    moments = tally.result()
    assert moments.with_track == ("A",)
    track, own = (np.diag(moments.fast)[at] for at in (moments.track_columns("A"), moments.columns("A")))
    np.testing.assert_allclose(own, 1.21 * track, rtol=0.01)


def test_an_axis_that_hardly_moves_has_no_delay() -> None:
    """One part in a thousand of the others' motion, with a misaligned part a quarter of a period late."""
    mixed = np.stack([np.sin(2 * np.pi * 0.9 * SECONDS), np.cos(2 * np.pi * 0.9 * SECONDS)], axis=1)
    still = 1e-3 * mixed[:, :1]
    first = 20_000 * np.concatenate([mixed, still - 0.01 * mixed[:, 1:]], axis=1)
    other = 20_000 * np.concatenate([mixed, still], axis=1)
    found = crossed([header("A"), header("B")], [np.rint(first), np.rint(other)], MOVING, window=50_000_000)
    delay_s = value("motion_delay", found, "A")
    assert abs(delay_s[2]) < 0.02  # 0.01 / (1e-3 * 2 pi 0.9 Hz) = 1.8 s by the plain ratio
    np.testing.assert_allclose(delay_s[:2], 0.0, atol=1e-4)


def test_a_constant_delay_has_no_residual() -> None:
    """Three milliseconds of a sine give (w d)^2 of its mean square. Less than a tenth of that remains, mostly of the
    slowest sine: a segment of eleven windows has half a period of it.
    """
    square = (20_000 / 2048) ** 2 / 2
    delayed = square * (2 * np.pi * np.array([0.9, 1.3, 1.7]) * 0.003) ** 2
    assert np.exp(value("motion_residual", moved(np.eye(3), 0.003), "A")).sum() < delayed.sum() / 10


def test_a_random_delay_of_rows_remains_in_the_residual() -> None:
    """Jitter of 10 ms rms gives (w d)^2 of a sine's mean square in each of the five rows of a window, minus the part of
    a segment's mean, one of eleven; 800 windows whose speed varies: 5 standard errors of 6 %.
    """
    late_s = np.random.default_rng(8).normal(0.0, 0.01, ROWS)
    counts = [20_000 * swaying(SECONDS - off) for off in (late_s, 0.0)]
    found = crossed([header("A"), header("B")], [np.rint(rows) for rows in counts], MOVING, window=50_000_000)
    square = (20_000 / 2048) ** 2 / 2
    expected = square * (2 * np.pi * np.array([0.9, 1.3, 1.7]) * 0.01) ** 2 / 5
    np.testing.assert_allclose(np.exp(value("motion_residual", found, "A")), expected, rtol=0.3)


def test_the_delay_of_motion_is_estimated() -> None:
    """Three milliseconds late. For a sine the central difference over h is sin(w h) / (w h) of the change: the
    estimated delay is too long by 1.3, 2.8 and 4.8 % at 0.9, 1.3 and 1.7 Hz and 50 ms.
    """
    found = moved(np.eye(3), 0.003)
    np.testing.assert_allclose(value("motion_delay", found, "A"), [0.00304, 0.00308, 0.00314], rtol=0.02)
    np.testing.assert_allclose(value("motion_delay", found, "B"), [-0.00304, -0.00308, -0.00314], rtol=0.02)


def test_a_displacement_is_estimated_from_rotation() -> None:
    """A is r from the origin: alpha x r + w x (w x r); B at the origin."""
    r = np.array([0.0, 0.08, 0.03])
    rate = 3.0 * swaying(SECONDS)
    gain = 2 * np.pi * np.array([0.9, 1.3, 1.7])
    alpha = 3.0 * gain * np.stack([np.cos(hz * SECONDS) for hz in gain], axis=1)
    added = np.cross(alpha, r) + np.cross(rate, np.cross(rate, r))
    rng = np.random.default_rng(1)
    force = 0.5 * swaying(0.77 * SECONDS + 0.3)
    one, here, there = (
        np.rint(2048 * (force + more / 9.80665 + rng.normal(0, 0.003, (ROWS, 3)))) for more in (added, 0.0, 0.0)
    )
    gyroscope = header("G", chip="l3g4200d")
    turning = np.rint(rate / SI_PER_UNIT["dps"] * gyroscope.sensitivity)
    sensors = [header("A"), header("B"), gyroscope]
    still, placed = (crossed(sensors, [first, there, turning], MOVING, window=50_000_000) for first in (here, one))
    assert (value("motion_coupling", placed, "A") > 1.0).all()
    assert (value("motion_coupling", still, "A") < 0.1).all()  # nine regressors of 800 windows
    assert (value("motion_residual", placed, "A") > value("motion_residual", still, "A")).all()


def test_windows_have_at_least_two_rows() -> None:
    """Two rows of the slowest sensor."""
    assert window_ns([100.0, 400.0]) == 20_000_000
    assert window_ns([28.0, 400.0]) == 100_000_000
    assert window_ns([0.01]) == 5_000_000_000


def test_windows_of_unresolved_motions_have_at_least_five_rows() -> None:
    """Five rows of the slowest sensor and 0.1 s."""
    assert window_ns([100.0, 400.0], is_resolved=False) == 100_000_000
    assert window_ns([28.0, 400.0], is_resolved=False) == 200_000_000


def test_nonlinear_responses_are_estimated_as_square_and_cube() -> None:
    """Two gyroscopes on one turning box, noise of 0.1 dps, rates of 60 dps rms about each axis. A reads w + b w^2 + c
    w^3, with b = 2e-4 per dps on x and c = 2e-6 per dps^2 on y: 1.0 dps and 1.0 dps rms in addition to the linear
    response.
    """
    stream = np.random.default_rng(5)
    rate = np.cumsum(stream.normal(0, 1.0, (ROWS, 3)), axis=0)
    rate -= rate.reshape(-1, 80, 3).mean(axis=1).repeat(80, axis=0)
    rate *= 60 / rate.std(axis=0)
    sensors = [header(name, quantity="angular_rate", unit="dps", sensitivity=100.0) for name in "AB"]
    bent = rate + np.array([2e-4, 0.0, 0.0]) * rate**2 + np.array([0.0, 2e-6, 0.0]) * rate**3
    counts = [np.rint(100 * (seen + stream.normal(0, 0.1, rate.shape))) for seen in (bent, rate)]
    found = crossed(sensors, counts, Phase(0, ROWS * INTERVAL_NS, "motion"))
    squares, cubes = value("motion_square", found, "A"), value("motion_cube", found, "A")
    assert squares[0] > 1.0
    assert cubes[1] > 1.0
    assert np.abs(squares[[1, 2]]).max() < 0.4
    assert np.abs(cubes[[0, 2]]).max() < 0.4


def test_only_gyroscopes_have_nonlinear_statistics_of_the_rate() -> None:
    found = crossed([header("A"), header("B")], [random_counts(1), random_counts(2)])
    assert np.isnan(value("motion_square", found, "A")).all()
    assert np.isnan(value("motion_cube", found, "A")).all()

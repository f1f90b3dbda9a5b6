"""Probes of temperature, force, times and flags against closed forms, on rows made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.axes import face_up, up_vector
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import LOST_BEFORE, STALE, Phase
from imuarray.simulate.motion.tumble import ORDER
from tests.gap.small_campaign import SCALE, SECOND, block, gaussian, header, summary, value


def heated(coefficients: tuple[float, float, float, float]) -> list[Summary]:
    """Two phases whose readings are a polynomial of T(t) = 25 + 10 sin(t / 30 s) and its slope, with noise."""
    offset, slope, square, lag = coefficients

    def degc(time_ns: np.ndarray) -> np.ndarray:
        return 25 + 10 * np.sin(np.asarray(time_ns) / 30e9)

    phases = []
    for start_s in (0, 60):
        phase = Phase(start_s * SECOND, (start_s + 60) * SECOND, "heat", "+Z")
        time_ns = np.arange(phase.start_ns, phase.end_ns, 5_000_000)
        warm = degc(time_ns) - 25
        change = np.cos(time_ns / 30e9) / 3
        counts = offset + slope * warm + square * warm**2 + lag * change + np.random.default_rng(1).normal(0, 1, 12_000)
        chip = np.rint((degc(time_ns) + 1.5 - 24) * 2).astype(np.int16)
        rows = block(np.rint(counts), 5_000_000, phase.start_ns, temperature_counts=chip)
        phases.append(summary(rows, phase, degc))
    return phases


def test_probes_of_temperature() -> None:
    """Each term is estimated in the presence of the earlier terms of the fit."""
    phases = heated((100.0, 0.0, 3.0, 300.0))
    np.testing.assert_allclose(value("thermal_change", phases), 300.0 / SCALE, rtol=0.02)
    np.testing.assert_allclose(value("thermal_residual", phases), 0.0, atol=0.7)  # 124 degrees of freedom
    straight = heated((100.0, 20.0, 0.0, 0.0))
    np.testing.assert_allclose(value("thermal_slope", straight), 20.0 / SCALE, rtol=1e-3)
    np.testing.assert_allclose(value("thermal_square", straight), 0.0, atol=0.03 / SCALE)
    curved = heated((100.0, 20.0, 3.0, 0.0))
    np.testing.assert_allclose(value("thermal_square", curved), 3.0 / SCALE, rtol=1e-2)
    np.testing.assert_allclose(value("thermal_change", curved), 0.0, atol=5.0 / SCALE)


def test_a_constant_temperature_has_no_thermal_probes() -> None:
    phase = summary(block(gaussian(rows=3000)))
    for name in ("thermal_slope", "thermal_square", "thermal_change", "thermal_residual", "thermal_noise"):
        assert np.isnan(value(name, [phase])).all()


def test_noise_that_grows_with_temperature() -> None:
    """Standard deviation exp(0.02 (T - 25)): 0.04 of the log variance per degC."""

    def degc(time_ns: np.ndarray) -> np.ndarray:
        return 25 + np.asarray(time_ns) / 10e9

    time_ns = np.arange(20_000) * 10_000_000
    counts = gaussian() * np.exp(0.02 * (degc(time_ns) - 25))[:, None]
    found = value("thermal_noise", [summary(block(np.rint(counts)), temperature=degc)])
    np.testing.assert_allclose(found, 0.04, atol=0.012)  # five standard errors: root 2 / (root 20,000 * 5.8 degC)


AXES = ("+X+Y+Z", "+Y+X-Z")


@pytest.mark.parametrize("axes", AXES)
def test_probes_of_force(axes: str) -> None:
    """Readings b + M f + q f^2 of six faces and a check, along the sensor's own axes."""
    response = np.array([[1000.0, 30.0, -50.0], [7.0, 1100.0, 0.0], [0.0, -90.0, 900.0]])
    quadratic, bias = np.array([40.0, 0.0, -20.0]), np.array([500.0, -300.0, 80.0])
    sensor = header(axes=axes)
    phases = []
    for name, up in ORDER:
        force = np.array(sensor.orientation).T @ np.array(up_vector(face_up(name)))
        counts = np.tile(bias + response @ force + quadratic * force**2, (100, 1))
        phases.append(summary(block(counts), Phase(0, SECOND, name, up), sensor=sensor))
    np.testing.assert_allclose(value("force_own", phases), np.array([1000.0, 1100.0, 900.0]) / SCALE)
    np.testing.assert_allclose(value("force_next", phases), np.array([30.0, 0.0, 0.0]) / SCALE, atol=1e-9)
    np.testing.assert_allclose(value("force_after", phases), np.array([-50.0, 7.0, -90.0]) / SCALE, atol=1e-9)
    np.testing.assert_allclose(value("force_square", phases), quadratic / SCALE, atol=1e-9)
    assert np.isnan(value("force_own", phases[:5])).all()


def test_a_response_that_changed_between_two_times_on_the_same_faces() -> None:
    """A scale that grows by 2 and 3 % along y and z; along x one face changes, like by a wandering bias."""
    sensor = header(axes="-X+Y-Z")
    faces = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
    phases = []
    for number, up in enumerate((*faces, *faces)):
        force = np.array(sensor.orientation).T @ np.array(up_vector(up))
        is_later = number >= len(faces)
        scale = np.array([1.0, 1.02, 1.03]) if is_later else np.ones(3)
        wander = np.array([15.0 * is_later * (up == "+X"), 0.0, 0.0])
        counts = np.tile(40.0 + 1000.0 * scale * force + wander, (100, 1))
        phases.append(summary(block(counts), Phase(number * SECOND, (number + 1) * SECOND, "face", up), sensor=sensor))
    np.testing.assert_allclose(value("force_return", phases), np.array([0.0, 20.0, 30.0]) / SCALE, atol=1e-9)
    assert np.isnan(value("force_return", phases[: len(faces) + 1])).all()


def test_probes_of_timing() -> None:
    rows = gaussian(rows=3000)
    rows[100:103] = rows[99]
    times = np.arange(3000) * 10_000_000
    times[2000:] += 40_000_000
    found = summary(block(rows, time=times))
    np.testing.assert_allclose(value("interval", found), np.log(0.01), atol=1e-9)
    np.testing.assert_allclose(value("irregularity", found), np.log(1e-6), atol=1e-6)
    np.testing.assert_allclose(value("gaps", found), np.arcsin(np.sqrt(1 / 2999)))
    np.testing.assert_allclose(value("longest_interval", found), np.log(5.0), atol=1e-9)
    np.testing.assert_allclose(value("repeats", found), np.arcsin(np.sqrt(3 / 2999)))
    np.testing.assert_allclose(value("longest_repeat", found), 4.0)
    assert np.isnan(value("skips", found))
    for at in range(150, 3000, 150):
        times[at:] += 2_000_000_000
    times[2500:] += 180_000_000  # 19 intervals; 20 are a stall
    stalled = summary(block(rows, time=times))
    np.testing.assert_allclose(value("gaps", stalled), np.arcsin(np.sqrt(21 / 2999)))
    np.testing.assert_allclose(value("skips", stalled), np.arcsin(np.sqrt(2 / 2999)))


def test_probes_of_status_flags() -> None:
    status = np.zeros(1000, np.uint16)
    status[:250] = STALE
    status[400:410] |= LOST_BEFORE
    found = summary(block(gaussian(rows=1000), status=status))
    np.testing.assert_allclose(value("stale", found), np.pi / 6)  # the root of a quarter
    np.testing.assert_allclose(value("lost", found), np.arcsin(0.1))
    for name in ("saturated", "doubt"):
        assert value(name, found) == 0.0
    words = gaussian(rows=1000)
    words[:40] = -1
    np.testing.assert_allclose(value("words", summary(block(words))), np.arcsin(0.2), atol=0.01)

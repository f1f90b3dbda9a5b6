"""`planes`: no axis of the box is noisier than an in-plane axis, and out-of-plane axes monitor the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.array import parse_array
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import TurnOn
from imuarray.fuse import TECHNIQUES, Axis, Frames, axes_of, changes, fuse
from imuarray.fuse.techniques.planes import Monitor, PlaneBlend, dilution
from imuarray.log import open_log
from imuarray.simulate import Simulation, parse_model, write_log
from imuarray.simulate.motion.faces import Still
from tests.fuse.arrays import at_once, triad, weights
from tests.fuse.conftest import DPS, Floats, G, Part, WriteRun, calibration, joined


def test_planes_weigh_by_inverse_variance() -> None:
    """z has twice the noise of x and y: weights 4 to 1 where they are along one box axis."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 2.0)), *triad("B", "+Y+Z+X", (1.0, 1.0, 2.0))]
    # B: x along Y, y along Z, z along X.
    expected = [[0.8, 0, 0, 0, 0, 0.2], [0, 0.5, 0, 0.5, 0, 0], [0, 0, 0.2, 0, 0.8, 0]]
    assert weights(TECHNIQUES["planes"](axes), 6) == pytest.approx(np.array(expected), abs=1e-12)


def test_planes_prefer_out_of_plane_axes_of_lower_noise() -> None:
    axes = [*triad("A", "+X+Y+Z", (3.0, 3.0, 1.0)), *triad("B", "+Y+Z+X", (3.0, 3.0, 1.0))]
    result = weights(TECHNIQUES["planes"](axes), 6)
    assert result[0, [0, 5]] == pytest.approx([0.1, 0.9])


def test_planes_weigh_by_the_plane_and_not_by_the_sensor() -> None:
    """B has ten times the noise on every axis, C another design: within a design weights differ by plane alone."""
    axes = [
        *triad("A", "+X+Y+Z", (1.0, 1.0, 2.0)),
        *triad("B", "+X+Y+Z", (10.0, 10.0, 20.0)),
        *triad("C", "+X+Y+Z", (5.0, 5.0, 5.0), chip="d"),
    ]
    result = weights(TECHNIQUES["planes"](axes), 9)
    assert result[0, [0, 3, 6]] == pytest.approx([1 / 3, 1 / 3, 1 / 3])
    assert result[2, [2, 5, 8]] == pytest.approx([1 / 6, 1 / 6, 4 / 6])


IN_PLANE_LSB, OUT_OF_PLANE_LSB = 6.0, 12.0
"""Noise of an ADXL345's x and y, and of its z (Table 10, section 6.2), of 256 to the g."""


def test_perpendicular_boards_have_no_axis_noisier_than_in_plane() -> None:
    """The first board's z is the second's x: ``1 / (1/36 + 1/144)`` there, two in-plane axes along Y; 6 and 12 LSB.

    To the rate of 6e-5, two-sided, of 50 000 readings; the plain average is noisier along X and Z.
    """
    noise = (IN_PLANE_LSB, IN_PLANE_LSB, OUT_OF_PLANE_LSB)
    axes = [*triad("A", "+X+Y+Z", noise), *triad("B", "+Z+Y-X", noise)]
    rng = np.random.default_rng(11)
    frames = at_once(rng.normal(0, 1, (50000, 6)) * np.tile(noise, 2))
    planes, mean = (TECHNIQUES[name](axes)(frames) for name in ("planes", "mean"))
    both, pair = (1 / 36 + 1 / 144) ** -0.5, 6 / np.sqrt(2)
    assert planes.triad_box.std(axis=0) == pytest.approx([both, pair, both], rel=4 / np.sqrt(100000))
    assert np.sqrt(planes.covariance_box[0, :3]) == pytest.approx([both, pair, both])
    assert both < IN_PLANE_LSB < mean.triad_box.std(axis=0)[[0, 2]].min()


ARRAY = """
[array]
name = "perpendicular"
mux = { chip = "pca9544a", address = 0x70 }

[[sensor]]
name = "FLAT"
chip = "adxl345"
channel = 0
address = 0x53
range = 16
rate_hz = 800
axes = "+X+Y+Z"

[[sensor]]
name = "UPRIGHT"
chip = "adxl345"
channel = 0
address = 0x1D
range = 16
rate_hz = 800
axes = "+Z+Y-X"
"""

MODEL = f"""
[model]
name = "table 10"
about = "white noise of an ADXL345 by plane, and codes"

[[design]]
chip = "adxl345"

[design.white_noise]
rms_g = [{IN_PLANE_LSB / 256}, {IN_PLANE_LSB / 256}, {OUT_OF_PLANE_LSB / 256}]
"""


def test_simulated_perpendicular_boards_have_no_axis_noisier_than_in_plane(tmp_path: Path) -> None:
    """The paper's proposal of section 2.2, through the simulator's codes and a log; same error rate."""
    simulation = Simulation.of_array(
        parse_array(ARRAY), Still(seconds=100.0), parse_model(MODEL), frame_rate_hz=200.0, seed=2
    )
    write_log(simulation, tmp_path / "run.h5")
    noise = np.array([IN_PLANE_LSB, IN_PLANE_LSB, OUT_OF_PLANE_LSB])
    with open_log(tmp_path / "run.h5") as log:
        known = Calibration(
            {
                name: measured(Part(name, way, chip="adxl345", sensitivity=256.0), noise)
                for name, way in (("FLAT", "+X+Y+Z"), ("UPRIGHT", "+Z+Y-X"))
            }
        )
        result = {name: joined(list(fuse(log, known, name)))[1] / G * 256 for name in ("planes", "mean")}
        text = changes("planes", axes_of(list(log.of("specific_force")), known))
    both, pair = (1 / 36 + 1 / 144) ** -0.5, 6 / np.sqrt(2)
    assert len(result["planes"]) == 20000
    assert result["planes"].std(axis=0) == pytest.approx([both, pair, both], rel=4 / np.sqrt(40000) + 0.003)
    assert (result["planes"].std(axis=0) < IN_PLANE_LSB).all()
    assert (result["mean"].std(axis=0)[[0, 2]] > IN_PLANE_LSB).all()
    assert text == ["adxl345 (z weighs 0.25 of full, by noise)"]


def measured(part: Part, noise_lsb: Floats, turn_on_lsb: Floats | None = None) -> SensorCalibration:
    """Calibration of a sensor with measured noise and, optionally, its change from run to run."""
    known = calibration([part], noise=False).sensors[part.name]
    turn_on = None
    if turn_on_lsb is not None:
        turn_on = TurnOn(turn_on_lsb, turn_on_lsb / 5, turn_on_lsb, np.zeros(3), 15)
    return SensorCalibration(
        part.name,
        part.quantity,
        known.unit,
        known.bias_lsb,
        known.response_lsb_per_unit,
        noise_lsb=noise_lsb,
        turn_on=turn_on,
    )


def with_stability(axes: list[Axis], *stability: float | None) -> list[Axis]:
    """The axes with the slow error of x, y and z of every sensor."""
    return [replace(axis, stability_si=stability[axis.index]) for axis in axes]


def test_slow_errors_are_weighted_like_the_mean_of_a_hundred_readings() -> None:
    """``1/100 + 0.3^2 = 0.1`` and ``1/100 + 0.7^2 = 0.5``, though all three have the same noise: 5 to 1."""
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 1.0)), *triad("B", "+Y+Z+X", (1.0, 1.0, 1.0))]
    result = weights(TECHNIQUES["planes"](with_stability(axes, 0.3, 0.3, 0.7)), 6)
    assert result[0, [0, 5]] == pytest.approx([5 / 6, 1 / 6])
    assert changes("planes", with_stability(axes, 0.3, 0.3, 0.7)) == [
        "c (z weighs 0.2 of full, by noise and stability)"
    ]
    assert changes("planes", with_stability(axes, 0.7, 0.7, 0.3)) == [
        "c (x and y weigh 0.2 of full, by noise and stability)"
    ]


def test_a_stability_unknown_for_some_axis_is_ignored() -> None:
    axes = [*triad("A", "+X+Y+Z", (1.0, 1.0, 2.0)), *triad("B", "+Y+Z+X", (1.0, 1.0, 2.0))]
    result = weights(TECHNIQUES["planes"](with_stability(axes, 0.3, 0.3, None)), 6)
    assert result[0, [0, 5]] == pytest.approx([0.8, 0.2])


@pytest.mark.parametrize("ratio", [1.2, 1.8, 2.0, 4.0])
@pytest.mark.parametrize("slow", [0.0, 0.1, 5.0])
def test_no_axis_is_noisier_than_in_plane_for_any_slow_errors(ratio: float, slow: float) -> None:
    """With equal slow errors the weights would be equal, and the noise ``sqrt(1 + ratio^2) / 2`` of an
    in-plane axis.
    """
    noise = (1.0, 1.0, ratio)
    axes = with_stability([*triad("A", "+X+Y+Z", noise), *triad("B", "+Z+Y-X", noise)], slow, slow, slow)
    covariance = TECHNIQUES["planes"](axes)(at_once(np.zeros((1, 6)))).covariance_box[0, :3]
    assert (covariance <= 1 + 1e-12).all()


def test_the_calibration_gives_the_stability(tmp_path: Path, write_run: WriteRun) -> None:
    """The change from run to run, in SI: 2.56 LSB at 256 LSB/g are 0.01 g."""
    part = Part("A", chip="adxl345", sensitivity=256.0)
    known = measured(part, np.full(3, 6.0), np.array([2.56, 2.56, np.nan]))
    with open_log(write_run([part], frames=10)) as log:
        axes = axes_of([log["A"]], Calibration({"A": known}))
    assert [axis.stability_si for axis in axes] == [pytest.approx(0.01 * G), pytest.approx(0.01 * G), None]
    assert axes[0].bandwidth_hz is None


def watched(bias: float, frames: int = 2000, blocks: int = 1, stability: float | None = None) -> PlaneBlend:
    """Perpendicular boards, the z of the second of which has a bias (in the unit of its noise, 12)."""
    noise = (6.0, 6.0, 12.0)
    axes = [*triad("BMA1", "+X+Y+Z", noise), *triad("BMA2", "+Z+Y-X", noise)]
    technique = PlaneBlend(with_stability(axes, stability, stability, stability))
    values = np.random.default_rng(12).normal(0, 1, (frames, 6)) * np.tile(noise, 2) + [0, 0, 0, 0, 0, bias]
    whole = at_once(values)
    for part in np.array_split(np.arange(frames), blocks):
        technique(Frames(whole.time[part], whole.values[part], whole.valid[part]))
    return technique


def test_axes_of_lower_weight_monitor_the_others() -> None:
    """A bias of z of 12 LSB against X of the other board: scatter sqrt(144 + 36), of 2000 frames 0.3 LSB: 40 sigma."""
    sound, off = watched(12.0).monitors()
    assert (sound.label, off.label) == ("BMA1 z", "BMA2 z")
    sem = np.sqrt(180 / 2000)
    assert off.difference_si == pytest.approx(12.0, abs=4 * sem)
    assert off.sem_si == pytest.approx(sem, rel=4 / np.sqrt(4000))
    assert off.sigmas == pytest.approx(off.difference_si / off.sem_si)
    assert abs(sound.sigmas) < 4
    assert off.frames == 2000


def test_a_difference_within_the_calibration_is_not_an_alarm() -> None:
    (_, off) = watched(12.0, stability=6.0).monitors()
    assert off.sigmas == pytest.approx(off.difference_si / np.hypot(6.0, off.sem_si))


def test_monitors_do_not_depend_on_blocks() -> None:
    for whole, pieces in zip(watched(3.0).monitors(), watched(3.0, blocks=7).monitors(), strict=True):
        assert pieces.difference_si == pytest.approx(whole.difference_si)
        assert pieces.sem_si == pytest.approx(whole.sem_si)


def test_a_monitor_is_reported_in_a_sentence() -> None:
    assert Monitor("BMA2 z", 3.1e-3 * G, 1e-3, 8.02, 2000).sentence("specific_force") == (
        "BMA2 z differs from the in-plane axes by 3.1 mg, 8 sigma"
    )
    assert Monitor("G1 x", -0.02 * DPS, 1e-3, -3.0, 5).sentence("angular_rate") == (
        "G1 x differs from the out-of-plane axes by -0.02 dps, 3 sigma"
    )


def test_a_monitor_without_a_comparison_is_reported() -> None:
    """All boards have the same orientation: along Z there are only out-of-plane axes."""
    noise = (6.0, 6.0, 12.0)
    technique = PlaneBlend([*triad("A", "+X+Y+Z", noise), *triad("B", "+X+Y+Z", noise)])
    technique(at_once(np.zeros((10, 6))))
    first = technique.monitors()[0]
    assert first.frames == 0 and np.isnan(first.sigmas)
    assert first.sentence("specific_force") == "A z has no axis to compare with"


def test_the_normal_of_a_flat_board_has_no_comparison() -> None:
    """Tilts of 0.3 degrees give in-plane axes half a percent of the normal; a value from them would have 300 times the
    noise, and scale errors in motion would be reported as a difference of the out-of-plane axes.
    """
    noise = (6.0, 6.0, 12.0)
    axes = [*triad("A", "+X+Y+Z", noise), *triad("B", "+X+Y+Z", noise)]
    tilted = [
        replace(axis, direction_box=(axis.direction_box[0], axis.direction_box[1], axis.direction_box[2] + 5e-3 * at))
        for at, axis in enumerate(axes)
    ]
    technique = PlaneBlend(tilted)
    technique(at_once(np.random.default_rng(4).normal(np.array([0, 0, 900, 0, 0, 900]), 6, (100, 6))))
    assert [monitor.frames for monitor in technique.monitors()] == [0, 0]
    assert technique.remarks("specific_force") == [
        "2 axes of lower weight cannot be compared: no axis of full weight lies near their direction"
    ]


@pytest.mark.parametrize(
    ("others", "wanted"),
    [
        (np.eye(3), 1.0),
        (np.eye(3)[:2], np.inf),
        (np.array([[1.0, 0, 0], [0, 1, 0], [0, 0.6, 0.8]]), np.hypot(1, 0.6) / 0.8),
    ],
)
def test_the_noise_of_the_comparison(others: np.ndarray, wanted: float) -> None:
    """By hand: along Z from axes along X, Y and (Y, Z) at angles with sine 0.8, z = (m - 0.6 y) / 0.8."""
    assert dilution(np.array([[0.0, 0, 1]]), others)[0] == pytest.approx(wanted)


def test_repeated_readings_do_not_narrow_the_comparison() -> None:
    noise = (6.0, 6.0, 12.0)
    technique = PlaneBlend([*triad("A", "+X+Y+Z", noise), *triad("B", "+Z+Y-X", noise)])
    frames = at_once(np.ones((10, 6)))
    stale = np.zeros((10, 6), bool)
    stale[3:, :3] = True
    technique(Frames(frames.time, frames.values, frames.valid, None, stale))
    assert [monitor.frames for monitor in technique.monitors()] == [3, 10]

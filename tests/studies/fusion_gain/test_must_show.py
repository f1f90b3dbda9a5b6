"""Claims about the techniques on the simulated paper array, against the truth for each seed. Claims about `optimal`,
with the whole log and for live fusion, are also checked on the posterior mean ("bound, causal"), for which they must
hold.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.calibrate.start_up import start_up_states
from imuarray.fuse import OPTIMAL, error_frames, fuse
from imuarray.log import Log, open_log
from imuarray.simulate import Simulation, plan_of, write_log
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.experiments import EXPERIMENTS as MOTIONS
from imuarray.simulate.experiments import ExperimentOptions
from imuarray.studies.fusion_gain.cramer_rao import true_calibration
from imuarray.studies.fusion_gain.gain_study import (
    CAUSAL,
    FAULTS,
    NO_SLOPES,
    OPTIMAL_CAUSAL,
    GainRow,
    Study,
    calibrate_units,
    martin2013,
    simulate,
    study,
)

MG = 9.80665e-3
BOUNDED = ("static", "tumble", "heating", "turn-on", "motion")
SINGLE = ("mean", "opposed", "planes", "ranges")

ESTIMATORS = (OPTIMAL, OPTIMAL_CAUSAL, CAUSAL)

LATE = pytest.mark.xfail(
    strict=True, reason="28 degC within 20 s, of which a barometer tells 15 s later: the law knows of no such error"
)
"""The paper's heating in a sixtieth of its time is beyond a live estimator, whose model is not right there."""

SLOW = ("static",)
"""The experiment of the slow half; the others are a campaign."""


def of_experiment(experiment: str, *arguments: str, marks: tuple[pytest.MarkDecorator, ...] = ()) -> Any:
    """Return the parameters of a claim about an experiment."""
    also = () if experiment in SLOW else (pytest.mark.campaign,)
    return pytest.param(*arguments, marks=(*marks, *also))


EACH = [
    of_experiment(
        experiment,
        technique,
        experiment,
        marks=(LATE,) if (technique, experiment) == (OPTIMAL_CAUSAL, "heating") else (),
    )
    for technique in ESTIMATORS
    for experiment in BOUNDED
]

pytestmark = pytest.mark.slow

StudyOf = Callable[[str], Study]


@pytest.fixture(scope="module")
def study_of() -> StudyOf:
    """Return the function that gives two seeds of an experiment, cut short; simulated when a test first needs it."""
    return cache(lambda experiment: study((experiment,), 2, seconds=100.0))


def row_of(of_all: Study, **wanted: str) -> GainRow:
    (row,) = of_all.of(**wanted)
    return row


def test_opposed_gyroscopes_have_smaller_thermal_slopes(tmp_path: Path) -> None:
    """The paper's heating by 28 degC in a tenth of its time: about box Y at most a tenth of the average's slope with
    temperature, elsewhere at most one per cent more. The test of the campaign has the whole time, two seeds, and
    `optimal`.
    """
    path = tmp_path / "heating.h5"
    array = martin2013().only(("Gyro1", "Gyro2", "Gyro3", "BMP180"))
    write_log(simulate(array, MOTIONS["heating"](ExperimentOptions(seconds=660.0)), 1, 200, FAULTS), path)
    with open_log(path) as log:
        calibration, _ = start_up_states(log, calibrate_units("martin2013", 1)[NO_SLOPES])
        mean, opposed = (_drifts(log, calibration, technique)[0] for technique in ("mean", "opposed"))
    x, y, z = np.abs(opposed / mean)
    assert y <= 0.1 and max(x, z) <= 1.01


@pytest.mark.campaign
def test_opposed_gyroscopes_drift_less_while_heated(tmp_path: Path) -> None:
    """The paper's heating by 28 degC, its 110 minutes, a calibration without slopes, two seeds.

    About box Y, where the slopes of Gyro1 y, Gyro2 y and Gyro3 y agree to 2 % (Table 8), at most a tenth of the
    average's drift: of the thermal drift for each seed, and of all drift, rms of minutes minus the first. Elsewhere the
    thermal drift exceeds that of the average by at most one per cent. `optimal` (one seed) reaches the same about Y,
    and has a smaller drift of all three together.
    """
    array = martin2013().only(("Gyro1", "Gyro2", "Gyro3", "BMP180"))
    squares = np.zeros((2, 3))
    for seed in (1, 2):
        path = tmp_path / f"heating{seed}.h5"
        write_log(simulate(array, MOTIONS["heating"](ExperimentOptions()), seed, 200, FAULTS), path)
        known = calibrate_units("martin2013", seed)[NO_SLOPES]
        techniques = ("mean", "opposed", OPTIMAL) if seed == 1 else ("mean", "opposed")
        with open_log(path) as log:
            calibration, _ = start_up_states(log, known)
            result = [_drifts(log, calibration, technique) for technique in techniques]
        x, y, z = np.abs(result[1][0] / result[0][0])
        assert y <= 0.1 and max(x, z) <= 1.01
        squares += [minutes for _, minutes in result[:2]]
        for slope, minutes in result[2:]:
            assert abs(slope[1]) <= 0.1 * abs(result[0][0][1]) and minutes[1] <= 0.1**2 * result[0][1][1]
            assert minutes.sum() <= result[1][1].sum()
    assert squares[1, 1] <= 0.1**2 * squares[0, 1]


def _drifts(log: Log, calibration: Calibration, technique: str) -> tuple[np.ndarray, np.ndarray]:
    """(3,) slopes of the error with the true temperature, and (3,) mean squares of minutes minus the first."""
    result = error_frames(log, fuse(log, calibration, technique))["angular_rate"]
    truth = log.truth
    assert truth is not None and truth.temperature is not None
    degc = np.interp(result.time, truth.time[:], truth.temperature[:])
    minutes = np.array([part.mean(axis=0) for part in np.array_split(result.errors, 110)])
    return np.polyfit(degc, result.errors, 1)[0], np.mean((minutes - minutes[0]) ** 2, axis=0)


def test_noise_of_planes_with_perpendicular_boards(study_of: StudyOf) -> None:
    """Noise along every box axis at most that of the quietest axis in plane: 21.3 mg, ADXL2 x (Tables 10 and 11)."""
    whole = study_of("static")
    for axis in "XYZ":
        row = row_of(
            whole, experiment="static", calibration="measured", sensors="2 ADXL345", technique="planes",
            measure="noise", box_axis=axis,
        )  # fmt: skip
        assert row.value / MG <= 21.3


def test_noise_of_ranges_with_two_bma180(tmp_path: Path) -> None:
    """A 1.5 g and a 16 g BMA180 of Table 10's mean noise, 9.53 and 17.05 mg: 8.3 mg, where the average has 9.8 and the
    low range alone 9.5. 3 x 14400 readings determine an rms to 0.4 %; four of these.
    """
    sensors = ("BMA1", "BMA3")
    effects = {"BMA1": (WhiteNoise((0.01705,) * 3),), "BMA3": (WhiteNoise((0.00953,) * 3),)}
    plan = plan_of(martin2013().only(sensors), 48.0, 300.0)
    simulation = Simulation(plan, MOTIONS["static"](ExperimentOptions(seconds=300.0)), effects, seed=1)
    write_log(simulation, tmp_path / "static.h5")
    calibration = true_calibration([sensor.header for sensor in simulation.sensors.values()], effects)
    noise = {}
    with open_log(tmp_path / "static.h5") as log:
        for label, technique, only in (
            ("low", "mean", sensors[1:]), ("average", "mean", sensors), ("ranges", "ranges", sensors)
        ):  # fmt: skip
            errors = error_frames(log, fuse(log, calibration, technique, only=only))["specific_force"].errors
            noise[label] = float(np.sqrt(np.mean(errors**2))) / MG
    assert noise == pytest.approx({"low": 9.53, "average": 9.77, "ranges": 8.32}, rel=4 * 0.004)


@pytest.mark.parametrize(("technique", "experiment"), EACH)
def test_optimal_is_within_five_per_cent_of_the_bound(study_of: StudyOf, technique: str, experiment: str) -> None:
    whole = study_of(experiment)
    rows = whole.of(experiment=experiment, calibration="true", technique=technique, measure="rms")
    assert {row.box_axis for row in rows} == {"X", "Y", "Z", "XYZ"}
    for row in rows:
        assert row.over_bound is not None
        assert row.over_bound.ratio <= 1.05, (row.sensors, row.quantity, row.box_axis)


@pytest.mark.parametrize(("technique", "experiment"), EACH)
def test_the_covariance_of_optimal_is_consistent(study_of: StudyOf, technique: str, experiment: str) -> None:
    """In its 95 % interval except for the number that chance allows in eight runs or more (two seeds, four quantities;
    more than two of eight are outside in 0.6 % of the cases), and always within 5 %.
    """
    whole = study_of(experiment)
    rows = whole.of(experiment=experiment, calibration="true", technique=technique, measure="rms", box_axis="XYZ")
    shares = [row.consistent for row in rows if row.consistent is not None]
    assert len(shares) == len(rows) == 4
    assert np.mean(shares) >= 0.75
    for row in rows:
        assert row.normalised == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("technique", "experiment"), EACH)
def test_optimal_is_not_worse_than_the_best_other_technique(study_of: StudyOf, technique: str, experiment: str) -> None:
    """On the same readings: the whole error within half a per cent of the best of them."""
    whole = study_of(experiment)
    rows = whole.of(experiment=experiment, calibration="true", technique=technique, measure="rms", box_axis="XYZ")
    assert len(rows) == 4
    for row in rows:
        assert row.value <= 1.005 * _best(whole, row), (row.sensors, row.quantity)


CALIBRATED = [
    of_experiment(experiment, technique, experiment, "measured")
    for technique in (OPTIMAL, OPTIMAL_CAUSAL)
    for experiment in ("static", "tumble", "turn-on", "motion")
]


@pytest.mark.parametrize(
    ("technique", "experiment", "calibration"),
    [
        *CALIBRATED,
        of_experiment("heating", OPTIMAL, "heating", "measured"),
        of_experiment("heating", OPTIMAL, "heating", "no slopes"),
    ],
)
def test_optimal_with_a_calibration_is_not_worse_than_the_best_other(
    study_of: StudyOf, technique: str, experiment: str, calibration: str
) -> None:
    """With a calibration of the same units by `calibrate`, and without slopes: within one per cent, the resolution of a
    ratio by two seeds where the best is the simple average.
    """
    whole = study_of(experiment)
    rows = whole.of(experiment=experiment, calibration=calibration, technique=technique, measure="rms", box_axis="XYZ")
    assert len(rows) == 4
    for row in rows:
        assert row.value <= 1.01 * _best(whole, row), (row.sensors, row.quantity)


@pytest.mark.campaign
@pytest.mark.parametrize("technique", [OPTIMAL, OPTIMAL_CAUSAL])
def test_optimal_shaken_by_hand_is_as_good_as_the_average(study_of: StudyOf, technique: str) -> None:
    """Errors are due to the ages of readings, and only `ranges` learns the difference between the ranges: it is better
    for the gyroscopes by some per cent.
    """
    shaken = study_of("shaking")
    for row in shaken.of(experiment="shaking", technique=technique, measure="rms", box_axis="XYZ"):
        assert row.over_mean.ratio <= 1.01, (row.sensors, row.quantity)
        if row.quantity == "specific_force":
            assert row.value <= 1.01 * _best(shaken, row), row.sensors


def _best(found: Study, row: GainRow) -> float:
    """The error of the best single technique on the same readings."""
    same = found.of(
        experiment=row.experiment, calibration=row.calibration, sensors=row.sensors, quantity=row.quantity,
        measure="rms", box_axis="XYZ",
    )  # fmt: skip
    return min(other.value for other in same if other.technique in SINGLE)

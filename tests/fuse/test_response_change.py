"""A log with turns of the box determines the change of responses since their calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.fuse import fuse
from imuarray.fuse.fusion import complete_responses, prepare_inputs
from imuarray.fuse.response_change import with_response_change
from imuarray.log import open_log
from tests.fuse.conftest import Floats, Part, WriteRun, calibration, nothing, pointing
from tests.selection import some

MOUNTED = ("+X+Y+Z", "-Y-X-Z", "+X-Y-Z")
SIGMA_DPS = 0.1


def turning(seconds: Floats) -> Floats:
    """Turns at up to 40 dps about all axes."""
    return 40 * np.sin(np.outer(seconds, [0.9, 1.3, 1.7]) + np.arange(3.0))


def gyroscopes(changes: Sequence[Floats]) -> list[Part]:
    """Gyroscopes whose responses differ by these shares (3, 3) from the data sheet's."""
    return [
        Part(
            f"Gyro{number}",
            axes,
            "angular_rate",
            "l3g4200d",
            250.0,
            100.0,
            sigma=SIGMA_DPS,
            error=lambda seconds, change=change: turning(seconds) @ change.T,  # type: ignore[misc]
        )
        for number, (axes, change) in enumerate(zip(MOUNTED, changes, strict=False), start=1)
    ]


def measured(parts: Sequence[Part], sem_share: float = 1e-5) -> Calibration:
    """A calibration with the responses of the data sheet and this standard error."""
    return Calibration(
        {
            name: replace(known, response_sem_lsb_per_unit=np.full(3, 100.0 * sem_share))
            for name, known in calibration(parts).sensors.items()
        }
    )


def learned(run: Path, known: Calibration) -> float | None:
    """The change estimated from a log, the same for all of its gyroscopes."""
    with open_log(run) as log:
        changes = {sensor.response_change for sensor in with_response_change(log, known).sensors.values()}
    assert len(changes) == 1
    return changes.pop()


def drawn(rng: np.random.Generator, share: float) -> list[Floats]:
    return [share * rng.normal(size=(3, 3)) for _ in MOUNTED]


@pytest.mark.slow
@pytest.mark.parametrize("share", some([0.0, 0.001, 0.004], 2, 0))
def test_the_estimated_change_is_that_of_the_world(share: float, write_run: WriteRun) -> None:
    """Twelve worlds of three gyroscopes give 12 times 18 combinations: the rms of a change within 1 / sqrt(2 * 216) = 5
    %, and its prior (0.2 %) pulls the estimate of one world, with 18 degrees of freedom, by some percent more. Without
    a change, the remainder is due to noise: 0.1 dps over 28 dps rms and the root of 6000 rows is 5e-5.
    """
    rng = np.random.default_rng(7)
    squares = []
    for seed in range(12):
        parts = gyroscopes(drawn(rng, share))
        run = write_run(parts, rate=turning, frames=6000, seed=seed, name=f"{seed}.h5")
        change = learned(run, measured(parts))
        assert change is not None
        squares.append(change**2)
    rms = float(np.sqrt(np.mean(squares)))
    assert rms < 1.5e-4 if share == 0 else abs(rms / share - 1) < 0.15


def test_uncertainty_of_the_calibration_is_not_a_change(write_run: WriteRun) -> None:
    """Differences of 1 % between responses that are known to 1 % are errors of the calibration."""
    parts = gyroscopes(drawn(np.random.default_rng(8), 0.01))
    run = write_run(parts, rate=turning, frames=3000)
    explained, unexplained = (learned(run, measured(parts, sem_share)) for sem_share in (0.01, 1e-4))
    assert explained is not None and explained < 0.005
    assert unexplained == pytest.approx(0.01, rel=0.3)


def test_a_fault_is_not_a_change(write_run: WriteRun) -> None:
    """A gyroscope is stuck for a third of the log."""
    parts = gyroscopes(drawn(np.random.default_rng(9), 0.001))
    stuck = parts[0]._replace(
        error=lambda seconds: np.where((seconds > 20)[:, None], -turning(seconds) @ pointing("+X+Y+Z").T, 0.0)
    )
    change = learned(write_run([stuck, *parts[1:]], rate=turning, frames=3000), measured(parts))
    assert change is not None and change < 0.0025


def tumbled_s(seconds: Floats) -> Floats:
    """Angle (n,) of a box with rests of four seconds and turns of two, in turns."""
    step, rest = np.divmod(seconds, 6.0)
    return np.asarray(step + np.clip(rest - 4, 0, 2) / 2)


def tumbled_force(seconds: Floats) -> Floats:
    """Gravity in a box that turns about an oblique axis by 70 degrees each time."""
    angle = np.radians(70) * tumbled_s(seconds)
    return np.stack([np.sin(angle) * 0.8, np.sin(angle) * 0.6, np.cos(angle)], axis=1)


def tumbled_rate(seconds: Floats) -> Floats:
    """35 dps while it turns."""
    return np.outer(seconds % 6.0 > 4, [21.0, -28.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("with_gyroscope", [True, False])
def test_lever_arms_of_accelerometers_are_not_a_change(with_gyroscope: bool, write_run: WriteRun) -> None:
    """While the box turns, one of them reads 5 % more; without a gyroscope the turns are unknown."""
    apart = lambda seconds: 0.05 * tumbled_force(seconds) * (seconds % 6.0 > 4)[:, None]  # noqa: E731
    parts = [Part(f"Acc{number}", sigma=0.004, error=error) for number, error in ((1, apart), (2, nothing))]
    gyroscope = Part("Gyro1", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 100.0, sigma=SIGMA_DPS)
    every = [*parts, gyroscope] if with_gyroscope else parts
    known = calibration(every).sensors
    for part in parts:
        known[part.name] = replace(known[part.name], response_sem_lsb_per_unit=np.full(3, 0.02))
    run = write_run(every, force=tumbled_force, rate=tumbled_rate, frames=6000)
    with open_log(run) as log:
        change = with_response_change(log, Calibration(known)).sensors["Acc1"].response_change
    assert (change is not None and change < 5e-4) if with_gyroscope else change is None


def test_no_change_is_estimated_without_motion_or_another_sensor(write_run: WriteRun) -> None:
    parts = gyroscopes([np.zeros((3, 3))] * 3)
    at_rest = [part._replace(error=nothing) for part in parts]
    assert learned(write_run(at_rest, frames=3000), measured(parts)) is None
    assert learned(write_run(parts[:1], rate=turning, frames=3000, name="single.h5"), measured(parts[:1])) is None


def test_a_stated_change_or_an_exact_response_is_kept(write_run: WriteRun) -> None:
    parts = gyroscopes(drawn(np.random.default_rng(10), 0.003))
    run = write_run(parts, rate=turning, frames=2000)
    stated = Calibration({n: replace(each, response_change=0.01) for n, each in measured(parts).sensors.items()})
    assert learned(run, stated) == 0.01
    assert learned(run, measured(parts, 0.0)) is None


def test_the_change_is_estimated_without_known_noise(write_run: WriteRun) -> None:
    parts = gyroscopes(drawn(np.random.default_rng(11), 0.004))
    known = Calibration({n: replace(each, noise_lsb=None) for n, each in measured(parts).sensors.items()})
    assert learned(write_run(parts, rate=turning, frames=3000), known) == pytest.approx(0.004, rel=0.5)


def test_a_large_change_is_in_the_covariance_and_the_remarks(write_run: WriteRun) -> None:
    """1.5 % of 40 dps is 0.6 dps, for three gyroscopes 0.35 dps, many times the noise of their mean, 0.06 dps."""
    parts = gyroscopes(drawn(np.random.default_rng(12), 0.015))
    with open_log(write_run(parts, rate=turning, frames=3000)) as log:
        inputs = complete_responses(log, prepare_inputs(log, measured(parts), technique="mean"))
        biases, change = inputs.remarks
        assert biases == (
            "the biases of Gyro1 to Gyro3 were not measured: covariances do not contain them, except those of optimal,"
            " which allows for usual biases"
        )
        assert change.startswith("responses of Gyro1 to Gyro3 differ by 1.")
        blocks = list(fuse(log, inputs.calibration, "mean"))
    variances = np.concatenate([block.covariances["angular_rate"] for block in blocks])[:, :3]
    assert np.degrees(np.sqrt(variances.max())) > 0.25

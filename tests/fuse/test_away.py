"""A calibration at another temperature: a printed line, and wider covariances."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from imuarray.calibrate import Calibration
from imuarray.calibrate.model import BIAS, Thermal
from imuarray.cli import main
from imuarray.fuse import fuse, temperature_mismatch
from imuarray.fuse.element_temperature import AWAY_DEGC, SCALE_PER_DEGC, mismatch_sentences
from imuarray.fuse.frames import matrices
from imuarray.fuse.fusion import fuse_together
from imuarray.log import open_log
from tests.fuse.conftest import DPS, Floats, G, Part, WriteRun, calibration, joined
from tests.selection import some

HERE_DEGC = 25.0
"""What `WriteRun` has in `/reference`."""
SLOPE_G, SLOPE_DPS = 5e-4, 0.022
"""Usual slopes per degC: mean of BMA180s and of L3G4200Ds in the paper's Table 8."""


def parts() -> list[Part]:
    return [Part("A", sigma=0.01), Part("G", "-Y-X-Z", "angular_rate", "l3g4200d", 250.0, 100.0, sigma=0.1)]


def known(calibrated_degc: float | None, **more: object) -> Calibration:
    """A calibration without errors except the noise, at a temperature."""
    result = calibration(parts())
    values = {"bias_sem_lsb": np.zeros(3), "temperature_degc": calibrated_degc, **more}
    return Calibration({name: replace(sensor, **values) for name, sensor in result.sensors.items()})  # type: ignore[arg-type]


def claimed(run: Path, calibration: Calibration, quantity: str) -> Floats:
    """The covariance of the first frame."""
    with open_log(run) as log:
        return np.asarray(matrices(next(iter(fuse(log, calibration, "mean"))).covariances[quantity])[0])


@pytest.mark.parametrize(
    ("quantity", "slope"), some([("specific_force", SLOPE_G * G), ("angular_rate", SLOPE_DPS * DPS)], 1)
)
def test_the_covariance_allows_for_usual_slopes(write_run: WriteRun, quantity: str, slope: float) -> None:
    run = write_run(parts(), truth="reference", frames=400)
    at_home, unknown, away = (claimed(run, known(degc), quantity) for degc in (HERE_DEGC, None, HERE_DEGC - 20))
    assert at_home == pytest.approx(unknown)
    assert away - at_home == pytest.approx((20 * slope) ** 2 * np.eye(3), rel=1e-6)


def test_compared_techniques_state_the_covariances_of_fuse(write_run: WriteRun) -> None:
    """The mean of one sensor, 20 degC away: larger by the square of the usual slope times 20 degC."""
    run = write_run(parts(), truth="reference", frames=400)
    with open_log(run) as log:
        home, away = (
            matrices(next(fuse_together(log, known(degc), ["mean"]))["mean"].covariances["specific_force"])[0]
            for degc in (HERE_DEGC, HERE_DEGC - 20)
        )
    assert away - home == pytest.approx((20 * SLOPE_G * G) ** 2 * np.eye(3), rel=1e-6)


def test_a_known_slope_adds_its_standard_error_only(write_run: WriteRun) -> None:
    """0.1 counts per degC at 2048 per g, 20 degC away; an axis whose slope may be of the scale factor has the whole
    usual slope.
    """
    thermal = Thermal(np.array([1.0, 1.0, 2.0]), np.full(3, 0.1), 5.0, (BIAS, BIAS, "bias or scale"), "reference")
    run = write_run(parts(), truth="reference", frames=400)
    home, away = (claimed(run, known(degc, thermal=thermal), "specific_force") for degc in (HERE_DEGC, HERE_DEGC - 20))
    expected = (20 * np.array([0.1, 0.1, np.hypot(2.0, 0.1)]) / 2048 * G) ** 2
    assert away - home == pytest.approx(np.diag(expected), rel=1e-6)


def test_the_covariance_allows_for_changes_of_the_scale_factor(write_run: WriteRun) -> None:
    """Under 1 g along Z with a measured response: 2 % over 125 degC (L3G-72), 20 degC away, along Z alone."""
    run = write_run(parts(), truth="reference", frames=400)
    response = {"response_sem_lsb_per_unit": np.full(3, 1e-9)}
    home, away = (claimed(run, known(degc, **response), "specific_force") for degc in (HERE_DEGC, HERE_DEGC - 20))
    swollen = (20 * 0.02 / 125 * G) ** 2 * np.diag([0.0, 0.0, 1.0])
    bias = (20 * SLOPE_G * G) ** 2 * np.eye(3)
    assert away - home == pytest.approx(bias + swollen, rel=0.05)
    assert pytest.approx(0.02 / 125) == SCALE_PER_DEGC


@pytest.mark.slow
def test_errors_of_sensors_that_changed_are_within_their_covariance(write_run: WriteRun) -> None:
    """40 sensors with slopes drawn from the usual population, 20 degC away: the normalised error squared of the mean of
    a log is chi-square of 120 degrees of freedom, error rate 1e-3.
    """
    rng, squares = np.random.default_rng(11), 0.0
    for draw in range(40):
        off = 20 * SLOPE_G * rng.normal(size=3)
        part = Part("A", sigma=1e-4, error=lambda seconds, off=off: np.tile(off, (len(seconds), 1)))
        run = write_run([part], truth="reference", frames=200, seed=draw, name=f"{draw}.h5")
        with open_log(run) as log:
            blocks = list(fuse(log, Calibration({"A": known(HERE_DEGC - 20).sensors["A"]}), "mean"))
        error = joined(blocks)[1].mean(axis=0) - [0.0, 0.0, G]
        covariance = matrices(blocks[0].covariances["specific_force"])[0]
        squares += float(error @ np.linalg.solve(covariance, error))
    low, high = chi2.ppf((0.0005, 0.9995), 120)
    # The noise that `known` states, 0.01 g, is half of the covariance and absent from the mean over a log: see below.
    share = (20 * SLOPE_G) ** 2 / ((20 * SLOPE_G) ** 2 + 0.01**2)
    assert low < squares / share < high


@pytest.mark.slow
def test_the_command_prints_a_line_on_the_temperature(
    write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = str(write_run(parts(), truth="reference", frames=400))
    for degc, lines in ((HERE_DEGC - 20, 1), (HERE_DEGC - 0.9 * AWAY_DEGC, 0)):
        known(degc).save(tmp_path / "cal.toml", force=True)
        command = ["fuse", run, "--calibration", str(tmp_path / "cal.toml"), "-o", str(tmp_path / "f.h5"), "--force"]
        assert main([*command, "--technique", "mean", "--json"]) == 0
        text = json.loads(capsys.readouterr().out)["temperature"]
        assert len(text) == lines
        if text:
            assert text[0] == (
                "calibrated at 5.0 degC, this log is at 25.0: A, G; biases are known to 10 mg and 0.44 dps only; the"
                " covariances include this"
            )
            assert main([*command, "--technique", "mean"]) == 0
            assert text[0] in capsys.readouterr().out


def test_without_noise_the_line_states_unknown_covariances(write_run: WriteRun) -> None:
    """The covariances are NaN, and the line states it."""
    cold = known(HERE_DEGC - 20)
    bare = Calibration({name: replace(each, noise_lsb=None) for name, each in cold.sensors.items()})
    with open_log(write_run(parts(), truth="reference", frames=400)) as log:
        away = temperature_mismatch(log, list(log.sensors.values()), bare)
        (text,) = mismatch_sentences(bare, away)
        assert text.endswith("the covariances are unknown without the noise (calibrate noise)")
        assert np.isnan(next(iter(fuse(log, bare, "mean"))).covariances["specific_force"]).any()


def test_no_line_is_printed_for_unknown_temperatures(write_run: WriteRun) -> None:
    with open_log(write_run(parts(), truth="truth", frames=400)) as log:
        assert temperature_mismatch(log, list(log.sensors.values()), known(5.0)) == {}
    with open_log(write_run(parts(), truth="reference", frames=400, name="b.h5")) as log:
        assert temperature_mismatch(log, list(log.sensors.values()), known(None)) == {}

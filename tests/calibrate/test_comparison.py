"""Several calibrations of one array: changes in sigmas, their common part, and the part that opposing axes cancel."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from imuarray.calibrate import Calibration, SensorCalibration, compare_calibrations
from imuarray.calibrate.model import BIAS, Thermal
from imuarray.cli import main
from imuarray.errors import CalibrationError
from tests.calibrate.conftest import Floats, ideal

PER_G = 2048.0


def sensor(name: str, axes: str = "+X+Y+Z", **values: object) -> SensorCalibration:
    """An accelerometer whose biases are known to 2 counts and whose response to 1."""
    plain: dict[str, object] = {
        "bias_lsb": np.zeros(3),
        "bias_sem_lsb": np.full(3, 2.0),
        "response_lsb_per_unit": ideal(axes, PER_G),
        "response_sem_lsb_per_unit": np.ones(3),
        "chip": "bma180",
    }
    return SensorCalibration(name=name, quantity="specific_force", unit="g", **{**plain, **values})  # type: ignore[arg-type]


def calibration(*sensors: SensorCalibration) -> Calibration:
    return Calibration({each.name: each for each in sensors})


def test_a_change_is_the_difference_over_both_standard_errors() -> None:
    """Bias x by 40 counts of 2048 a g, known to 2 and 3 counts: 40 / sqrt(13) = 11.09 sigmas; scale factor y by 5
    counts of 2048, known to 1 each: 3.54; an angle of 1 degree, known to atan(1 / 2048).
    """
    leaning = PER_G * np.array([[1, 0, 0], [0, 2053 / 2048, 0], [0, np.sin(np.radians(1)), np.cos(np.radians(1))]])
    later = sensor("A", bias_lsb=np.array([40.0, 0, 0]), bias_sem_lsb=np.full(3, 3.0), response_lsb_per_unit=leaning)
    result = compare_calibrations({"march": calibration(sensor("A")), "june": calibration(later)})
    figures = {(change.axis, change.figure): change for change in result.changes}
    bias = figures["x", "bias"]
    assert bias.changed and bias.sigmas == pytest.approx(40 / np.sqrt(13))
    assert (bias.difference, bias.unit) == (pytest.approx(40 / PER_G), "g")
    assert (bias.first, bias.last, bias.calibrations) == (0, 1, (0, 1))
    scale = figures["y", "scale factor"]
    assert scale.difference == pytest.approx(5) and scale.sigmas == pytest.approx(5 / np.sqrt(2))
    lean = figures["z", "lean to Y"]
    assert lean.difference == pytest.approx(1.0, rel=1e-3)
    assert lean.sigmas == pytest.approx(1 / np.degrees(np.sqrt(2) / PER_G), rel=1e-3)
    assert {key for key, change in figures.items() if change.changed} == {
        ("x", "bias"),
        ("z", "lean to Y"),
        ("y", "scale factor"),
    }
    # Two-sided normal tail of 3.5355 sigmas, 4.07e-4; 12 figures, two of them smaller: Holm multiplies by 10.
    assert len(figures) == 12
    assert scale.p_value == pytest.approx(10 * 4.07e-4, rel=2e-3)


def test_the_two_most_different_calibrations_are_named() -> None:
    files = {
        f"{n}": calibration(sensor("A", bias_lsb=np.array([bias, 0.0, 0]))) for n, bias in enumerate((0, 30, -9, 3))
    }
    change = next(c for c in compare_calibrations(files).changes if (c.axis, c.figure) == ("x", "bias"))
    assert (change.first, change.last) == (1, 2)
    assert change.sigmas == pytest.approx(39 / np.sqrt(8))
    assert len(change.values) == 4


@pytest.mark.slow
def test_false_alarms_of_unchanged_figures_are_rare() -> None:
    """200 pairs of calibrations of three sensors whose figures scatter by their standard errors: in 5 % of them some
    figure is reported as changed; less than one of five hundred seeds gives more than 10 %.
    """
    rng = np.random.default_rng(5)

    def drawn(name: str) -> SensorCalibration:
        scatter = rng.normal(0, 1.0, (3, 3))
        return sensor(name, bias_lsb=rng.normal(0, 2.0, 3), response_lsb_per_unit=ideal("+X+Y+Z", PER_G) + scatter)

    def files() -> Calibration:
        return calibration(*(drawn(name) for name in "ABC"))

    alarms = sum(any(c.changed for c in compare_calibrations({"a": files(), "b": files()}).changes) for _ in range(200))
    assert binom.sf(20, 200, 0.05) < 2e-3
    assert alarms <= 20


def test_biases_are_compared_at_one_temperature() -> None:
    """A slope of 2 counts per degC and 10 degC between them: 20 counts are no change, which they are without slopes."""
    thermal = Thermal(np.full(3, 2.0), np.full(3, 0.1), 25.0, (BIAS,) * 3, "barometer")
    for known, changed in ((thermal, False), (None, True)):
        cold = sensor("A", temperature_degc=20.0, thermal=known)
        warm = sensor("A", temperature_degc=30.0, thermal=known, bias_lsb=np.full(3, 20.0))
        result = compare_calibrations({"cold": calibration(cold), "warm": calibration(warm)})
        assert [c.changed for c in result.changes if c.figure == "bias"] == [changed] * 3


def files_of(changes: Floats, axes: tuple[str, ...]) -> dict[str, Calibration]:
    """Calibrations of sensors A, B, ...: biases (n, s) in counts along all own axes."""
    return {
        str(n): calibration(
            *(sensor("ABCD"[s], axes[s], bias_lsb=np.full(3, bias)) for s, bias in enumerate(row.tolist()))
        )
        for n, row in enumerate(changes)
    }


def test_common_change_by_hand() -> None:
    """Two units, three calibrations: (-1, -3), (0, 0), (1, 3). Common: -2, 0, 2; mean square 2 * 8 / 2 = 8; the
    remainder, +-1, 0, +-1: 4 / 2 = 2. Common variance (8 - 2) / 2 = 3; F = 4, 2 and 2 degrees of freedom: p = 1 / (1 +
    4).
    """
    result = compare_calibrations(files_of(np.array([[-1.0, -3], [0, 0], [1, 3]]), ("+X+Y+Z", "+X+Y+Z")))
    (x, _, _) = result.common
    assert (x.axis, x.units, x.chip) == ("x", ("A", "B"), "bma180 specific force")
    assert x.common * PER_G == pytest.approx(np.sqrt(3))
    assert x.own * PER_G == pytest.approx(np.sqrt(2))
    assert x.p_value == pytest.approx(0.2)


def test_cancellation_of_opposed_axes_by_hand() -> None:
    """Own x of A and B change by (-1, -3), (0, 0), (1, 3) counts and oppose each other in the box, as y does not: alone
    sqrt((2 + 18) / 2 / 2) = 2.236, together half of the difference, sqrt(2 / 2) = 1; they correlate fully.
    """
    result = compare_calibrations(files_of(np.array([[-1.0, -3], [0, 0], [1, 3]]), ("+X+Y+Z", "-X+Y-Z")))
    assert [(pair.first, pair.second, pair.box_axis) for pair in result.opposed] == [
        ("A x", "B x", "X"),
        ("A z", "B z", "Z"),
    ]
    pair = result.opposed[0]
    assert pair.alone * PER_G == pytest.approx(np.sqrt(5))
    assert pair.together * PER_G == pytest.approx(1.0)
    assert pair.correlation == pytest.approx(1.0) and pair.p_value < 1e-6


@pytest.mark.slow
def test_p_values_of_common_and_opposed_changes_are_uniform() -> None:
    """200 draws of four calibrations that share nothing: 5 % below 0.05, to four standard errors of 1.5 %."""
    rng = np.random.default_rng(6)
    common, opposed = [], []
    for _ in range(200):
        result = compare_calibrations(files_of(rng.normal(0, 5.0, (4, 2)), ("+X+Y+Z", "-X+Y-Z")))
        common.append(result.common[0].p_value)
        opposed.append(result.opposed[0].p_value)
    for chances in (common, opposed):
        assert np.mean(np.array(chances) < 0.05) == pytest.approx(0.05, abs=0.062)


def test_calibrations_that_cannot_be_compared_are_refused() -> None:
    one = calibration(sensor("A"))
    with pytest.raises(CalibrationError, match="at least two calibrations"):
        compare_calibrations({"a": one})
    with pytest.raises(CalibrationError, match="no sensor is in two of them"):
        compare_calibrations({"a": one, "b": calibration(sensor("B"))})
    with pytest.raises(
        CalibrationError, match="sensor A: chip bma180 in a, mpu6050 in b: two sensors with the same name"
    ):
        compare_calibrations({"a": one, "b": calibration(sensor("A", chip="mpu6050"))})


def test_the_command_prints_and_writes_the_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = []
    for number, file in enumerate(files_of(np.array([[0.0, 0], [50, 45], [100, 95]]), ("+X+Y+Z", "-X+Y-Z")).values()):
        paths.append(str(tmp_path / f"{number}.toml"))
        file.save(paths[-1])
    assert main(["calibrate", "compare", *paths]) == 0
    text = capsys.readouterr().out
    assert f"1: {paths[0]}" in text
    assert "A x            bias" in text and "+48.8281 mg" in text and "1 to 3" in text
    assert "18 of 24 figures agree" in text
    assert "A x and B x along X" in text and "common" in text
    assert main(["calibrate", "compare", *paths[:2], "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["opposed"][0]["p_value"] is None  # two calibrations always correlate
    assert sum(change["changed"] for change in report["changes"]) == 6
    assert main(["calibrate", "compare", paths[0]]) == 2
    assert main(["calibrate", "compare", paths[0], paths[0]]) == 2
    assert len(capsys.readouterr().err.splitlines()) >= 2


def test_figures_of_only_one_calibration_are_omitted() -> None:
    noisy = replace(sensor("A"), noise_lsb=np.ones(3), noise_sem_lsb=np.full(3, 0.1))
    result = compare_calibrations({"a": calibration(noisy), "b": calibration(sensor("A", bias_sem_lsb=None))})
    assert {change.figure for change in result.changes} == {"scale factor", "lean to X", "lean to Y", "lean to Z"}
    assert result.common == () and result.opposed == ()

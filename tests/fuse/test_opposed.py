"""Opposed axes of the paper's array while it is heated, and the predicted cancellation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import BIAS, BIAS_OR_SCALE, Thermal
from imuarray.cli import main
from imuarray.commands.fuse_report import pair_lines, pairs_of
from imuarray.fuse import errors_of, fuse
from imuarray.fuse.techniques.opposed import capabilities
from imuarray.log import Log, open_log
from tests.fuse.conftest import Floats, Part, WriteRun, calibration
from tests.selection import some

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
GYROS = ("Gyro1", "Gyro2", "Gyro3")
HOTTER_DEGC = 26.5
"""The end of the profile's last 28 degrees."""


def heated(folder: Path, seed: int, *options: str, rate_hz: float) -> Path:
    """The paper's heating experiment of its three gyroscopes."""
    path = folder / f"heating{seed}.h5"
    known = ["--model", "martin2013", "--experiment", "heating", "--only", ",".join(GYROS), *options]
    assert main(["simulate", str(CONFIG), *known, f"--rate-hz={rate_hz}", f"--seed={seed}", "-o", str(path)]) == 0
    return path


def drifts(path: Path) -> dict[str, Floats]:
    """Magnitude (3,) in dps of the thermal drift: the error when 28 degC hotter minus that of the first
    five minutes.
    """
    ways = {"mean": ("mean", ()), "opposed": ("opposed", ()), **{name: ("mean", (name,)) for name in GYROS}}
    result = {}
    with open_log(path) as log:
        for name, (technique, only) in ways.items():
            time, error = errors_of(log, fuse(log, Calibration(), technique, only=only))["angular_rate"]
            result[name] = np.abs(np.degrees(error[_hot(log, time)].mean(axis=0) - error[time < 300e9].mean(axis=0)))
    return result


def _hot(log: Log, time: np.ndarray) -> np.ndarray:
    track = log.truth
    assert track is not None and track.temperature is not None
    degc = np.interp(time, np.asarray(track.time[:]), np.asarray(track.temperature[:], float))
    return np.asarray(degc > degc[0] + HOTTER_DEGC)


@pytest.mark.slow
def test_a_heated_array_keeps_a_tenth_of_the_drift_where_slopes_agree(tmp_path: Path) -> None:
    """Table 8: the y axes' slopes are 0.0186, 0.0183 and 0.0187 dps/degC, the average of 1 + 2 keeps 0.0061 of it."""
    result = drifts(heated(tmp_path, 4, rate_hz=10.0))
    assert result["mean"][1] == pytest.approx(0.0061 * 27.5, rel=0.15)
    assert result["opposed"][1] < result["mean"][1] / 10
    assert all(result["opposed"][1] < result[name][1] / 30 for name in GYROS)
    assert (result["opposed"][[0, 2]] <= 1.001 * result["mean"][[0, 2]]).all()


@pytest.mark.parametrize("seeds", some([3, 10], 0, 1))
def test_drift_over_seeds_is_a_tenth_where_slopes_agree_and_at_most_the_average(tmp_path: Path, seeds: int) -> None:
    """Several seeds (noise, in-run wander and turn-on of the paper's figures)."""
    result = [drifts(heated(tmp_path, seed, rate_hz=15.0)) for seed in range(seeds)]
    ratio = np.array([drift["opposed"] / drift["mean"] for drift in result])
    singles = np.array([[drift["opposed"][1] / drift[name][1] for name in GYROS] for drift in result])
    assert ratio[:, 1].max() < 0.1
    assert singles.max() < 0.035
    assert np.sqrt(np.mean(ratio[:, 1] ** 2)) < 0.05
    assert (ratio[:, [0, 2]] <= 1.001).all()


@pytest.mark.campaign
def test_drift_of_drawn_units_increases_by_at_most_a_percent(tmp_path: Path) -> None:
    """30 arrays drawn from the population, a quarter of whose variance the design shares: 90 drifts about the axes.

    The ratio of rms drifts scatters by 0.03; it is smaller where units agree by chance.
    """
    result = [drifts(heated(tmp_path, seed, "--population", rate_hz=4.0)) for seed in range(30)]
    mean, opposed = (np.array([drift[name] for drift in result]) for name in ("mean", "opposed"))
    assert np.sqrt((opposed**2).sum() / (mean**2).sum()) < 1.01


def slopes(*lsb_per_degc: float, sem: float = 0.001, meaning: tuple[str, ...] = (BIAS,) * 3) -> Thermal:
    return Thermal(np.array(lsb_per_degc), np.full(3, sem), 25.0, meaning, "barometer")


OPPOSED = [
    Part("G1", "+X+Y+Z", "angular_rate", "l3g4200d", 2000.0, 10.0),
    Part("G2", "+X-Y-Z", "angular_rate", "l3g4200d", 250.0, 100.0),
    Part("A1", "-X-Y+Z", "angular_rate", "other", 250.0, 100.0),
]


def calibrated(*, meaning: tuple[str, ...] = (BIAS,) * 3, sem: float = 0.001) -> Calibration:
    """Gyro1 and Gyro2 of Table 8 along y, in counts of 0.1 and of 0.01 dps; biases along y of 4 and 3 dps."""
    found = calibration(OPPOSED)

    def gyro(name: str, scale: float, slope: float, bias: float) -> SensorCalibration:
        return replace(
            found.sensors[name],
            thermal=slopes(0.2, slope, 0.1, sem=sem * scale, meaning=meaning),
            bias_lsb=np.array([1.0, bias, 1.0]),
            bias_sem_lsb=np.full(3, 0.1 * scale),
        )

    two = {"G1": gyro("G1", 1.0, 0.265, 40.0), "G2": gyro("G2", 10.0, 2.61, 300.0)}
    return replace(found, sensors={**found.sensors, **two})


def test_pairs_report_their_cancellation(write_run: WriteRun) -> None:
    """By hand: slopes 0.0265 and 0.0261 dps/degC, half of the difference 0.0002 +- 0.00007; biases 4 and 3 dps."""
    path = write_run(OPPOSED, frames=200, rate_hz=20.0)
    with open_log(path) as log:
        first, second = capabilities(log.of("angular_rate"), calibrated())
    assert (first.first, first.second, first.chip, first.box_axis) == ("G1 y", "G2 y", "l3g4200d", "Y")
    assert (second.first, second.second, second.box_axis) == ("G1 z", "G2 z", "Z")
    drift, bias = first.drift, first.bias
    assert drift is not None and bias is not None and first.is_bias
    sem = 0.0001 / np.sqrt(2)
    assert np.degrees([drift.single, drift.remaining, drift.remaining_sem]) == pytest.approx([0.0263, 0.0002, sem])
    assert drift.reduction == pytest.approx(0.0263 / 0.0002)
    assert (drift.least, drift.most) == pytest.approx((0.0263 / (0.0002 + 1.96 * sem), 0.0263 / (0.0002 - 1.96 * sem)))
    assert np.degrees([bias.single, bias.remaining]) == pytest.approx([3.5, 0.5])
    assert drift.p_value < 1e-6 and bias.p_value < 1e-6


def test_a_pair_that_may_cancel_fully_has_no_upper_limit(write_run: WriteRun) -> None:
    with open_log(write_run(OPPOSED, frames=200, rate_hz=20.0)) as log:
        result = pairs_of(log, calibrated(sem=0.01, meaning=(BIAS, BIAS_OR_SCALE, BIAS)), [])
        unknown = pairs_of(log, calibration(OPPOSED), ["G1", "G2"])
        alone = pairs_of(log, calibrated(), ["G1"])
    assert result[0]["drift"]["most"] is None and result[0]["drift"]["least"] > 10
    assert result[0]["drift"]["left"] == result[0]["drift"]["remaining"] == pytest.approx(np.radians(0.0002))
    json.dumps(result, allow_nan=False)
    heading, _, text, *others, key, taken = pair_lines(result, follows_temperature=False)
    assert "drift with 1 degC" in heading and "that of scale" in key and "removes known biases;" in taken
    assert text.startswith("G1 y and G2 y          along Y   in dps       0.0263 ") and ">" in text and "*" in text
    assert len(others) == len(result) - 1
    assert "biases and slopes" in list(pair_lines(result, follows_temperature=True))[-1]
    assert [pair["drift"] for pair in unknown] == [None, None]
    assert list(pair_lines(unknown, follows_temperature=False)) == [
        "2 opposing pairs: cancellation unknown; run `imuarray calibrate thermal`"
    ]
    assert alone == []


@pytest.mark.slow
def test_fuse_reports_opposing_pairs(write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_run(OPPOSED, frames=200, rate_hz=20.0)
    calibrated().save(tmp_path / "cal.toml")
    fused = ["fuse", str(path), "--calibration", str(tmp_path / "cal.toml"), "-o", str(tmp_path / "f.h5"), "--force"]
    assert main([*fused, "--technique", "opposed"]) == 0
    assert "G1 y and G2 y          along Y" in capsys.readouterr().out
    assert main([*fused, "--technique", "opposed", "--json"]) == 0
    assert [pair["box_axis"] for pair in json.loads(capsys.readouterr().out)["pairs"]] == ["Y", "Z"]
    assert main([*fused, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pairs"] == []

"""`imuarray fuse` through the command line."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.calibrate.noise import with_noise_of
from imuarray.cli import main
from imuarray.fuse import evaluate, fuse, quiet_noise, read_fused
from imuarray.fuse.fusion import NAMES
from imuarray.fuse.technique_descriptions import TECHNIQUE_DESCRIPTIONS
from imuarray.fuse.techniques import CHANGES
from imuarray.log import open_log
from imuarray.log.format import Phase
from tests.fuse.arrays import HIGH_MG, LOW_MG, low_and_high
from tests.fuse.conftest import G, Part, WriteRun, calibration, still
from tests.selection import some

STATIC = (Phase(0, 10_000_000_000, "static", "+Z"),)
BIAS_G = 0.05


def parts(bias_g: float = 0.0) -> list[Part]:
    """Two accelerometers of the same orientation and a gyroscope."""
    return [
        *(Part(f"A{i}", sigma=0.01, error=lambda seconds: np.full((len(seconds), 3), bias_g)) for i in (1, 2)),
        Part("G1", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 100.0, sigma=0.2),
    ]


@pytest.fixture
def run(write_run: WriteRun) -> Path:
    return write_run(parts(), phases=STATIC)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Exit code 2, one line on standard error, nothing on standard output; the line."""
    assert main(["fuse", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("imuarray: ") and err.count("\n") == 1
    return err


@pytest.mark.parametrize("technique", some(["mean", "opposed", "planes", "ranges"], 1))
def test_fuse_writes_a_file_and_reports_errors(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], technique: str
) -> None:
    output = tmp_path / "fused.h5"
    assert main(["fuse", str(run), "--technique", technique, "-o", str(output), "--json"]) == 0
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert (report["fused"], report["technique"], report["frames"]) == (str(output), technique, 1000)
    # Two equal sensors: sigma / sqrt(2) of 1000 frames, to five standard errors.
    rms = np.array(report["error"]["specific_force"]["rms"]) / G
    assert rms == pytest.approx([0.01 / np.sqrt(2)] * 3, rel=5 / np.sqrt(2000))
    assert np.degrees(report["error"]["angular_rate"]["noise"]) == pytest.approx([0.2] * 3, rel=6 / np.sqrt(2000))
    assert ("measured in this log at rest" in err) == (technique in ("planes", "ranges"))
    with h5py.File(output) as file:
        assert file["fused/specific_force"].shape == (1000, 3)
        assert file.attrs["technique"] == technique
        assert file.attrs["log"] == str(run)


def test_fuse_prints_a_summary(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fuse", str(run), "-o", str(tmp_path / "fused.h5")]) == 0
    out = capsys.readouterr().out
    assert "1000 frames by mean" in out
    lines = [line.split() for line in out.splitlines() if "against the truth" in line]
    units = {line[0]: line[-1] for line in lines}
    assert units == {"specific_force": "mg", "angular_rate": "dps"}
    rms = next(line for line in lines if line[:2] == ["specific_force", "rms"])
    assert float(rms[rms.index("x") + 1]) == pytest.approx(7.07, rel=0.12)


@pytest.mark.slow
def test_optimal_reports_learnt_biases(write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One of two sensors has an error of 100 mg on each axis, and it is unknown which: 50 mg for each, and half of the
    variance remains. Their responses are known to 1e-4.
    """
    one = Part("A2", sigma=0.01, error=lambda seconds: np.full((len(seconds), 3), 0.1))
    path, known, output = write_run([*parts()[:1], one]), tmp_path / "cal.toml", str(tmp_path / "f.h5")
    sure = calibration([*parts()[:1], one])
    sensors = {name: replace(each, response_sem_lsb_per_unit=np.full(3, 0.2)) for name, each in sure.sensors.items()}
    replace(sure, sensors=sensors).save(known)
    asked = ["fuse", str(path), "--calibration", str(known), "--technique", "optimal", "--no-watch", "-o", output]
    assert main([*asked, "--json"]) == 0
    learned = json.loads(capsys.readouterr().out)["learned"]["biases"]["specific_force"]
    assert [each["axis"] for each in learned] == ["A1 x", "A1 y", "A1 z", "A2 x", "A2 y", "A2 z"]
    mg = np.array([each["bias"] for each in learned]) / G * 1e3
    # 14 mg over sqrt(1000), and some allowance for the prior
    assert mg[3:] - mg[:3] == pytest.approx([100.0] * 3, abs=1.0)
    assert mg == pytest.approx([-50.0] * 3 + [50.0] * 3, abs=1.0)
    left = [each["sd"] / each["sd_before"] for each in learned]
    assert left == pytest.approx([0.5**0.5] * 6, rel=0.01)
    assert main([*asked, "--force"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (heading,) = [index for index, line in enumerate(lines) if "slow errors of the specific_force sensors" in line]
    assert [line.split()[0] for line in lines[heading + 1 : heading + 3]] == ["A1", "A2"]
    assert float(lines[heading + 2].split()[2]) == pytest.approx(mg[3], abs=1e-3)
    assert "mg (before: 0 +- 125)" in lines[heading]  # BMA180: 2.5 times the paper's 50 mg


@pytest.mark.slow
def test_techniques_report_remarks_on_sensors(
    write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A low range that reads 20 mg more; relative to the blend of both by inverse variance a share of 9.53^2 / (9.53^2
    + 17.05^2) of it remains.
    """
    low, high = low_and_high()
    low = low._replace(error=lambda seconds: np.full((len(seconds), 3), 0.02))
    path, known, output = write_run([low, high]), tmp_path / "cal.toml", str(tmp_path / "f.h5")
    calibration([low, high]).save(known)
    asked = ["fuse", str(path), "--calibration", str(known), "--technique", "ranges", "-o", output]
    assert main(asked) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "LOW x relative to the blend" in line]
    words = line.split("blend:")[1].split()
    assert words[3] == "mg"
    assert float(words[0]) == pytest.approx(20 * LOW_MG**2 / (LOW_MG**2 + HIGH_MG**2), abs=5 * float(words[2]))
    assert 0.05 < float(words[2]) < 0.5
    assert main([*asked[:-4], "--technique", "planes", "-o", output, "--force", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["learned"] == {"biases": {}, "remarks": []}


def test_a_log_without_a_truth_is_fused_without_errors(
    write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_run(parts(), truth="")
    assert main(["fuse", str(path), "-o", str(tmp_path / "fused.h5"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["error"] == {}


def test_the_calibration_is_used(write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, known = write_run(parts(BIAS_G)), tmp_path / "cal.toml"
    calibration(parts()).save(known)
    biased = f"bias_lsb = [{', '.join([str(BIAS_G * 2048)] * 3)}]"
    known.write_text(known.read_text().replace("bias_lsb = [0.0, 0.0, 0.0]", biased, 1), encoding="utf-8")
    output = tmp_path / "fused.h5"
    assert main(["fuse", str(path), "--calibration", str(known), "--only", "A1", "-o", str(output), "--json"]) == 0
    mean = np.array(json.loads(capsys.readouterr().out)["error"]["specific_force"]["mean"]) / G
    assert mean == pytest.approx([0.0] * 3, abs=5 * 0.01 / np.sqrt(1000) + 0.5 / 2048)


@pytest.mark.slow
def test_a_bias_without_an_uncertainty_is_used_by_every_technique(
    write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, known = write_run(parts(BIAS_G), phases=STATIC), tmp_path / "cal.toml"
    calibration(parts(), noise=False).save(known)
    biased = f"bias_lsb = [{', '.join([str(BIAS_G * 2048)] * 3)}]"
    known.write_text(known.read_text().replace("bias_lsb = [0.0, 0.0, 0.0]", biased, 1), encoding="utf-8")
    means = []
    for name in ("mean", "planes"):
        output = str(tmp_path / f"{name}.h5")
        options = ["--calibration", str(known), "--only", "A1", "--technique", name, "-o", output, "--json"]
        assert main(["fuse", str(path), *options]) == 0
        means.append(json.loads(capsys.readouterr().out)["error"]["specific_force"]["mean"])
    assert means[1] == pytest.approx(means[0])


def test_an_existing_output_is_not_overwritten(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "fused.h5"
    output.write_text("mine")
    assert "exists already" in refused([str(run), "-o", str(output)], capsys)
    assert output.read_text() == "mine"
    assert main(["fuse", str(run), "-o", str(output), "--force"]) == 0
    assert h5py.is_hdf5(output)


def test_every_technique_is_described_in_the_order_of_the_registry(capsys: pytest.CaptureFixture[str]) -> None:
    assert tuple(TECHNIQUE_DESCRIPTIONS) == NAMES
    assert main(["fuse", "--help"]) == 0
    help_text = capsys.readouterr().out
    for name, description in TECHNIQUE_DESCRIPTIONS.items():
        assert re.search(rf"^  {name} +{re.escape(description.about)}$", help_text, re.MULTILINE), name


def test_techniques_that_change_only_some_arrays_are_described_for_both() -> None:
    for name, description in TECHNIQUE_DESCRIPTIONS.items():
        assert bool(description.effect) == bool(description.no_effect) == (name in CHANGES)


def test_invalid_input_gives_one_line(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = ["-o", str(tmp_path / "fused.h5")]
    assert "no such file" in refused([str(tmp_path / "no.h5"), *output], capsys)
    assert "allowed are mean, opposed, planes, ranges" in refused([str(run), "--technique", "best", *output], capsys)
    assert "no sensor 'B1'; it has A1, A2, G1" in refused([str(run), "--only", "A1,B1", *output], capsys)
    assert "No such file" in refused([str(run), "--calibration", str(tmp_path / "no.toml"), *output], capsys)
    assert "-o" in refused([str(run)], capsys)
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.h5"]


def test_noise_of_a_log_without_rest_is_refused(
    write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(3)
    path = write_run(parts(), force=lambda seconds: rng.normal(0, 0.5, (len(seconds), 3)) + still(seconds))
    output = tmp_path / "fused.h5"
    assert main(["fuse", str(path), "--technique", "ranges", "-o", str(output)]) == 2
    error = capsys.readouterr().err
    assert "no stretch in which the box stood still, to measure the noise, which the calibration lacks" in error
    assert "run `imuarray calibrate noise` on that log" in error
    assert not output.exists()


def test_an_output_in_a_missing_folder_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused([str(run), "-o", str(tmp_path / "no" / "fused.h5")], capsys)


def test_the_log_as_output_is_refused(run: Path) -> None:
    main(["fuse", str(run), "-o", str(run), "--force"])
    with open_log(run) as log:
        assert len(log["A1"]) == 1000


def test_a_calibration_of_another_array_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a common sensor nothing would be calibrated, and the result would not reveal it."""
    foreign = tmp_path / "foreign.toml"
    foreign.write_text("[calibration]\nformat_version = 1\n")
    arguments = ["fuse", str(run), "--calibration", str(foreign), "-o", str(tmp_path / "f.h5")]
    assert main(arguments) == 2
    assert "contains no sensor, but none of" in capsys.readouterr().err


@pytest.mark.slow
def test_the_report_lists_changes_and_uncalibrated_sensors(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fuse", str(run), "--technique", "opposed", "-o", str(tmp_path / "f.h5"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    with open_log(run) as log:
        assert sorted(report["uncalibrated"]) == sorted(log.sensors)
    assert report["changes"] == []
    assert set(report["results"]) == {"mean", "opposed"}
    same = [report["results"][name]["specific_force"]["rms"] for name in ("mean", "opposed")]
    assert same[0] == pytest.approx(same[1], rel=1e-12)


@pytest.mark.parametrize("technique", some(["mean", "opposed", "ranges"], 1))
@pytest.mark.parametrize("truth", some(["truth", ""], 1))
def test_both_results_are_measured_while_the_file_is_written(
    write_run: WriteRun, tmp_path: Path, technique: str, truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same as each of them fused alone, and the file read back."""
    path = write_run(parts(), phases=STATIC, truth=truth)
    assert main(["fuse", str(path), "--technique", technique, "-o", str(tmp_path / "f.h5"), "--json"]) == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert list(results) == list(dict.fromkeys(["mean", technique]))
    with open_log(path) as log:
        for name, by_quantity in results.items():
            blocks = list(fuse(log, with_noise_of(log, Calibration()), name))
            if name == technique:
                written = np.concatenate([block.triads["specific_force"] for block in read_fused(tmp_path / "f.h5")])
                np.testing.assert_array_equal(
                    written, np.concatenate([block.triads["specific_force"] for block in blocks])
                )
            if truth:
                for quantity, error in evaluate(log, blocks).items():
                    np.testing.assert_allclose(by_quantity[quantity]["rms"], error.rms, rtol=1e-12)
            else:
                for quantity, noise in quiet_noise(blocks).items():
                    np.testing.assert_allclose(by_quantity[quantity]["noise"], noise, rtol=1e-12)

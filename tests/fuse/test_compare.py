"""All techniques on one log; `imuarray fuse --evaluate`."""

from __future__ import annotations

import json
from dataclasses import astuple
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.calibrate.noise import with_noise_of
from imuarray.cli import main
from imuarray.commands.fuse_report import print_evaluation
from imuarray.fuse import ErrorFrames, FusedBlock, compare, fuse, technique_names
from imuarray.fuse.comparison import both
from imuarray.fuse.evaluation import ratio_of
from imuarray.fuse.fusion import fuse_together
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.gap.model.workers import processes
from imuarray.log import open_log
from tests.fuse.conftest import Part, WriteRun, calibration
from tests.selection import some

FRAMES = 8000


def parts() -> list[Part]:
    """A low range of low noise and a noisy high range, and a gyroscope without drift."""
    return [
        Part("LOW", range=1.5, sensitivity=16384.0, sigma=0.01),
        Part("HIGH", sigma=0.02),
        Part("G", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 100.0, sigma=0.2),
    ]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return WriteRun(tmp_path_factory.mktemp("compare"))(parts(), frames=FRAMES)


@pytest.mark.slow
def test_scores_of_every_technique_relative_to_the_average(run: Path) -> None:
    """0.01 and 0.02 g by inverse variance: 0.8 of the average, with which such errors correlate by 0.8: a ratio of 8000
    each scatters by 0.8 sqrt(0.36 / 8000) = 0.0054. Covariances from the true noise are consistent.
    """
    with open_log(run) as log:
        comparison = compare(log, calibration(parts()))
    assert [(s.technique, s.quantity) for s in comparison.scores if s.quantity == "specific_force"] == [
        (name, "specific_force") for name in technique_names()
    ]
    scores = {(score.technique, score.quantity): score for score in comparison.scores}
    for axis, ratio in scores["ranges", "specific_force"].ratio.items():
        assert ratio.ratio == pytest.approx(0.8, abs=4 * 0.0054), axis
        assert ratio.high - ratio.low < 0.06
    alone = scores["mean", "specific_force"]
    assert {(ratio.ratio, ratio.low, ratio.high) for ratio in alone.ratio.values()} == {(1.0, 1.0, 1.0)}
    for technique in ("mean", "ranges"):
        held = scores[technique, "specific_force"].consistency
        assert held is not None and held.normalised == pytest.approx(1.0, abs=5 * np.sqrt(2 / (3 * FRAMES)))
    assert {len(coast.begins_s) for coast in comparison.coasting.values()} == {1}
    # 0.2 dps at 100 Hz is 0.02 dps/sqrt(Hz): after 10 s of rest 0.02 sqrt(60 + 360) deg; one draw, four of these.
    assert abs(comparison.coasting["mean"].heading_deg[0]) < 4 * 0.02 * np.sqrt(420)


@pytest.mark.slow
def test_optimal_gives_the_average_of_the_same_frames(run: Path) -> None:
    averages: list[FusedBlock] = []
    with open_log(run) as log:
        known = calibration(parts())
        smoothed = FusedBlock.joined(list(fuse(log, known, "optimal", average=averages.append)))
        mean = FusedBlock.joined(list(fuse(log, known, "mean")))
    average = FusedBlock.joined(averages)
    for time in (average.time, smoothed.time):
        np.testing.assert_array_equal(time, mean.time)
    for quantity, triads in mean.triads.items():
        np.testing.assert_allclose(average.triads[quantity], triads, rtol=1e-12, atol=1e-13)


@pytest.mark.slow
def test_another_process_computes_the_same_figures(run: Path) -> None:
    shares, other_shares = list[float](), list[float]()
    with open_log(run) as log, processes(1) as executor:
        alone = compare(log, calibration(parts()), ("optimal",), progress=shares.append)
        parallel = compare(log, calibration(parts()), ("optimal",), progress=other_shares.append, executor=executor)
    for score, other in zip(alone.scores, parallel.scores, strict=True):
        assert (score.technique, score.quantity, score.ratio) == (other.technique, other.quantity, other.ratio)
        assert score.consistency == other.consistency
        assert score.error.rms.tolist() == other.error.rms.tolist()
    heading, its = (comparison.coasting["optimal"].heading_deg for comparison in (alone, parallel))
    np.testing.assert_array_equal(heading, its)
    for heard in (shares, other_shares):
        assert heard == sorted(heard) and heard[-1] <= 1.0
    assert shares[-1] == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("block", some([777, 5000], 1))
def test_scores_do_not_depend_on_blocks(run: Path, block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_log(run) as log:
        wanted = compare(log, calibration(parts()), ("ranges",))
        monkeypatch.setattr("imuarray.fuse.spools.AT_ONCE", block)
        monkeypatch.setattr("imuarray.fuse.comparison.AT_ONCE", block)
        result = compare(log, calibration(parts()), ("ranges",))
    for score, other in zip(result.scores, wanted.scores, strict=True):
        for axis, ratio in score.ratio.items():
            assert astuple(ratio) == pytest.approx(astuple(other.ratio[axis]), rel=1e-12)
        np.testing.assert_allclose(score.error.rms, other.error.rms, rtol=1e-12)
        assert score.consistency is not None and other.consistency is not None
        assert astuple(score.consistency) == pytest.approx(astuple(other.consistency), rel=1e-12)
    assert result.coasting["ranges"].heading_deg.tolist() == wanted.coasting["ranges"].heading_deg.tolist()


def test_frames_at_common_times_are_compared() -> None:
    """Each of two techniques has frames that the other lacks, at the beginning, in the middle and at the end."""
    frames = [np.setdiff1d(np.arange(5, 90_005), missing) for missing in ([5, 40_000, 90_004], [7, 8, 39_999])]
    made = {
        quantity: ErrorFrames(time, *(np.repeat(time[:, None] * factor, k, axis=1) for k in (3, 3, 6)))
        for quantity, time, factor in zip(("angular_rate", "specific_force"), frames, (1.0, 2.0), strict=True)
    }
    blocks = list(both(made))
    time = np.concatenate([block.time for block in blocks])
    assert len(blocks) > 1 and time.tolist() == sorted(set(frames[0].tolist()) & set(frames[1].tolist()))
    assert np.concatenate([block.rate_error for block in blocks])[:, 2].tolist() == time.tolist()
    assert np.concatenate([block.force for block in blocks])[:, 2].tolist() == (2 * time).tolist()


@pytest.mark.slow
def test_the_interval_covers_a_ratio() -> None:
    """White errors, half of them shared: of 400 intervals from twenty parts 95 % cover the true ratio, to four standard
    errors of 1.1 %.
    """
    rng = np.random.default_rng(8)
    held = 0
    for _ in range(400):
        shared, one, other = rng.normal(size=(3, 2000))
        squares = [
            np.array([np.sum(part**2) for part in np.split(rows, 20)]) for rows in (shared + one, shared + other)
        ]
        result = ratio_of(squares[0], 0.25 * squares[1])
        held += result.low <= 0.5 <= result.high
    assert held / 400 == pytest.approx(0.95, abs=0.045)


@pytest.mark.slow
def test_the_command_reports_all_scores(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As JSON, from which the table is printed; the command also writes the requested output."""
    output = tmp_path / "fused.h5"
    assert main(["fuse", str(run), "--evaluate", "--technique", "ranges", "-o", str(output), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert output.exists() and report["fused"] == str(output) and report["technique"] == "ranges"
    scores = report["evaluation"]["scores"]
    assert {score["technique"] for score in scores} == set(technique_names())
    ranges = next(s for s in scores if (s["technique"], s["quantity"]) == ("ranges", "specific_force"))
    assert set(ranges) >= {"mean", "noise", "rms", "drift", "ratio_to_mean", "consistency"}
    assert ranges["ratio_to_mean"]["XYZ"]["ratio"] == pytest.approx(0.8, abs=0.03)
    assert report["evaluation"]["coasting"]["mean"]["coasts"] == 1
    print_evaluation(report["evaluation"])
    out = capsys.readouterr().out
    for technique in technique_names():
        assert sum(line.startswith(f"  {technique} ") for line in out.splitlines()) >= 3
    table = out[out.index("errors against the truth") :]
    assert "coasting" in table and max(map(len, table.splitlines())) <= 132


@pytest.mark.slow
def test_a_reference_of_temperature_alone_is_refused(
    write_run: WriteRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_run(parts(), truth="reference")
    with h5py.File(path, "r+") as file:
        del file["reference/specific_force"], file["reference/angular_rate"]
    with open_log(path) as log:
        assert log.reference is not None
        assert log.motion_track is None
    assert main(["fuse", str(path), "-o", str(tmp_path / "fused.h5")]) == 0
    out, _ = capsys.readouterr()
    assert "scatter from frame to frame" in out and "against the truth" not in out
    assert main(["fuse", str(path), "--evaluate"]) == 2


def test_evaluation_without_a_truth_is_refused(write_run: WriteRun, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_run(parts(), truth="")
    assert main(["fuse", str(path), "--evaluate"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and "neither /truth nor /reference" in err.splitlines()[-1]


def test_fuse_without_output_or_evaluate_is_refused(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fuse", str(run)]) == 2
    assert "--output" in capsys.readouterr().err


def test_techniques_together_equal_each_alone(run: Path) -> None:
    """Aligned once, or once for each: equal to rounding, also where counts need no alignment."""
    names = [name for name in technique_names() if name in TECHNIQUES]
    with open_log(run) as log:
        known = with_noise_of(log, calibration(parts()))
        together = list(fuse_together(log, known, names))
        for name in names:
            own = FusedBlock.joined(list(fuse(log, known, name)))
            result = FusedBlock.joined([blocks[name] for blocks in together])
            assert (result.time == own.time).all()
            for quantity, triad in own.triads.items():
                np.testing.assert_allclose(result.triads[quantity], triad, rtol=1e-12, atol=1e-12)
                np.testing.assert_allclose(result.covariances[quantity], own.covariances[quantity], rtol=1e-12)
                assert (result.used[quantity] == own.used[quantity]).all()

"""Errors against a truth, compared with closed forms."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.errors import FusionError
from imuarray.fuse import FusedBlock, errors_of, evaluate, quiet_noise
from imuarray.log import open_log
from imuarray.log.format import Phase
from tests.fuse.conftest import DPS, Floats, G, Part, WriteRun, still
from tests.selection import some

PART = Part("A0")
ROWS = 1600


def shaken(seconds: Floats) -> Floats:
    """1 Hz, 1 g."""
    return np.asarray(np.sin(2 * np.pi * (seconds[:, None] + [0.0, 0.1, 0.2])))


def results(error: Floats, *, late_s: float = 0.0, cut: int = 700) -> list[FusedBlock]:
    """A fusion of `shaken` at 100 Hz with an error of `error` (n, 3) m/s2, in two blocks; its rate has no error."""
    seconds = np.arange(len(error)) / 100 + late_s
    force, rate = shaken(seconds) * G + error, still(seconds) * DPS
    time = np.round(seconds * 1e9).astype(np.int64)
    parts = (slice(0, cut), slice(cut, None))
    return [FusedBlock(time[part], {"specific_force": force[part], "angular_rate": rate[part]}) for part in parts]


def log_of(write_run: WriteRun, truth: str = "truth") -> Path:
    return write_run([PART], force=shaken, rate=still, frames=ROWS, truth=truth)


@pytest.mark.parametrize("truth", ["truth", "reference"])
def test_figures_of_a_ramp_of_errors(write_run: WriteRun, truth: str) -> None:
    """From 0 to 1: mean 1/2, rms 1/sqrt(3), no scatter between neighbours, means of sixteenths 15/16 apart."""
    ramp = np.outer(np.arange(ROWS) / ROWS, [1.0, -2.0, 0.0])
    with open_log(log_of(write_run, truth)) as log:
        result = evaluate(log, results(ramp))
    force = result["specific_force"]
    assert force.mean == pytest.approx([0.5, -1.0, 0.0], abs=1e-3)
    assert force.rms == pytest.approx([1 / np.sqrt(3), 2 / np.sqrt(3), 0.0], abs=2e-3)
    assert force.noise == pytest.approx([0.0] * 3, abs=1e-9)
    assert force.drift == pytest.approx([15 / 16, 30 / 16, 0.0], abs=1e-9)
    assert force.frames == ROWS
    assert result["angular_rate"].rms == pytest.approx([0.0] * 3, abs=1e-12)


def test_figures_of_white_errors(write_run: WriteRun) -> None:
    """Noise and rms are sigma within four standard errors, 1 / sqrt(2 n) and slightly more for differences."""
    sigma = np.array([0.1, 0.2, 0.3])
    with open_log(log_of(write_run)) as log:
        force = evaluate(log, results(np.random.default_rng(5).normal(0, sigma, (ROWS, 3))))["specific_force"]
    assert force.rms / sigma == pytest.approx([1.0] * 3, abs=4 / np.sqrt(2 * ROWS))
    assert force.noise / sigma == pytest.approx([1.0] * 3, abs=4 * np.sqrt(1.5) / np.sqrt(2 * ROWS))


def test_errors_are_limited_to_phases(write_run: WriteRun) -> None:
    error = np.zeros((ROWS, 3))
    error[300:500], error[1000:1001] = 1.0, 7.0
    phases: Sequence[Phase] = [
        Phase(3_000_000_000, 5_000_000_000, "a"),
        Phase(10_000_000_000, 10_010_000_000, "b"),
    ]
    with open_log(log_of(write_run)) as log:
        time, rows = errors_of(log, results(error), phases)["specific_force"]
    assert time.tolist() == [10_000_000 * k for k in (*range(300, 500), 1000)]
    assert rows[:, 0] == pytest.approx([1.0] * 200 + [7.0])


def test_nan_frames_are_excluded(write_run: WriteRun) -> None:
    error = np.zeros((ROWS, 3))
    error[100:200, 1] = np.nan
    with open_log(log_of(write_run)) as log:
        result = evaluate(log, results(error))
    assert result["specific_force"].frames == ROWS - 100
    assert result["angular_rate"].frames == ROWS


def test_a_spline_interpolates_the_truth(write_run: WriteRun) -> None:
    """Halfway between rows: 5/384 h^4 of the fourth derivative, (2 pi)^4 g: 2 um/s2. Straight lines: 5 mm/s2."""
    with open_log(log_of(write_run)) as log:
        time, rows = errors_of(log, results(np.zeros((ROWS, 3)), late_s=0.005))["specific_force"]
    assert len(time) == ROWS - 1  # the last row is beyond the truth
    inner = np.abs(rows[20:-20]).max()
    assert inner < 1.1 * 5 / 384 * 0.01**4 * (2 * np.pi) ** 4 * G
    assert np.abs(rows).max() < 100 * inner  # the ends of a spline are less accurate


def test_results_do_not_depend_on_blocks(write_run: WriteRun) -> None:
    error = np.zeros((ROWS, 3))
    with open_log(log_of(write_run)) as log:
        one = errors_of(log, results(error, late_s=0.005, cut=701))["specific_force"][1]
        other = errors_of(log, results(error, late_s=0.005, cut=5))["specific_force"][1]
    assert one == pytest.approx(other, abs=1e-9)


def test_a_log_without_truth_or_reference_is_refused(write_run: WriteRun) -> None:
    with open_log(log_of(write_run, "")) as log, pytest.raises(FusionError, match="neither /truth nor /reference"):
        evaluate(log, results(np.zeros((ROWS, 3))))


def test_a_truth_at_other_times_gives_no_errors(write_run: WriteRun) -> None:
    with open_log(log_of(write_run)) as log:
        assert evaluate(log, results(np.zeros((50, 3)), late_s=1000.0, cut=20)) == {}


def test_a_gap_of_the_reference_excludes_frames(write_run: WriteRun) -> None:
    path = log_of(write_run, "reference")
    with h5py.File(path, "a") as file:
        file["reference/specific_force"][100:110] = np.nan
    with open_log(path) as log:
        errors = evaluate(log, results(np.zeros((ROWS, 3))))
    assert ROWS - 200 < errors["specific_force"].frames < ROWS
    assert errors["angular_rate"].frames == ROWS  # a gap of the other quantity does not concern this one


def test_a_truth_of_one_row_gives_no_errors(write_run: WriteRun) -> None:
    path = log_of(write_run)
    with h5py.File(path, "a") as file:
        first = {name: column[:1] for name, column in file["truth"].items()}
        del file["truth"]
        truth = file.create_group("truth")
        for name, rows in first.items():
            truth[name] = rows
    with open_log(path) as log:
        assert evaluate(log, results(np.zeros((ROWS, 3)))) == {}


def test_the_quiet_noise_of_white_noise_for_any_blocks() -> None:
    """256 steps of differences determine sigma to 5 %, so that their lower quartile is 3.6 % below it: 0.92 to 1."""
    frames = 40 * 256 + 100
    time, triad = np.arange(frames) * 10_000_000, np.random.default_rng(5).normal(0, 2.0, (frames, 3))
    whole = FusedBlock(time, {"specific_force": triad})
    cuts = [0, 1, 255, 300, 7000, 7001, frames]
    pieces = [
        FusedBlock(time[start:end], {"specific_force": triad[start:end]}) for start, end in itertools.pairwise(cuts)
    ]

    noise = quiet_noise([whole])["specific_force"]

    assert np.all((noise > 0.92 * 2.0) & (noise < 2.0))
    np.testing.assert_array_equal(quiet_noise(pieces)["specific_force"], noise)
    assert quiet_noise([]) == {}


@pytest.mark.parametrize("faster", [2, 5])
def test_the_quiet_noise_of_a_quantity_slower_than_the_frames(faster: int) -> None:
    """Frames of which every second or fifth has a reading of the accelerometer: the scatter is that of the readings."""
    frames = 40 * 256 * faster
    triad = np.random.default_rng(5).normal(0, 2.0, (frames, 3))
    triad[np.arange(frames) % faster != 0] = np.nan
    noise = quiet_noise([FusedBlock(np.arange(frames) * 4_000_000, {"specific_force": triad})])["specific_force"]
    assert np.all((noise > 0.92 * 2.0) & (noise < 2.0))


@pytest.mark.parametrize(("rows", "block"), some([(2, 333), (3, 1), (17, 5), (1000, 333), (ROWS, 1 << 15)], 2))
def test_figures_of_errors_on_the_disk_equal_those_in_memory(
    write_run: WriteRun, rows: int, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imuarray.fuse.spools.AT_ONCE", block)
    error = np.random.default_rng(2).normal(0.5, 0.1, (rows, 3)) + np.linspace(0, 1, rows)[:, None]
    with open_log(log_of(write_run)) as log:
        result = evaluate(log, results(error, cut=rows // 2))["specific_force"]
        errors = errors_of(log, results(error, cut=rows // 2))["specific_force"][1]
    assert result.frames == rows
    slow = [part.mean(axis=0) for part in np.array_split(errors, min(16, rows))]
    wanted = {
        "mean": errors.mean(axis=0),
        "noise": np.diff(errors, axis=0).std(axis=0) / np.sqrt(2),
        "rms": np.sqrt((errors**2).mean(axis=0)),
        "drift": np.ptp(slow, axis=0),
    }
    for name, values in wanted.items():
        np.testing.assert_allclose(getattr(result, name), values, rtol=1e-12, atol=1e-15, err_msg=name)

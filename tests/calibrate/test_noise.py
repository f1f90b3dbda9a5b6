"""The scatter of single readings: pooled, about means of short segments, without doubtful rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.calibrate import Calibration, SensorCalibration, calibrate_noise, load_calibration
from imuarray.calibrate.noise_lines import _share
from imuarray.cli import main
from imuarray.errors import CalibrationError
from imuarray.fuse.fusion import prepare_inputs
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import LOST_BEFORE, Phase, SensorHeader
from tests.calibrate.conftest import EPOCH, Floats, accelerometer, gyroscope

STILL = Phase(0, 10**12, "static", "+Z")


def write(
    folder: Path,
    counts: Floats,
    phases: list[Phase],
    status: npt.NDArray[np.uint16] | None = None,
    header: SensorHeader | None = None,
) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "run.h5"
    time = np.arange(len(counts), dtype=np.int64) * 10_000_000
    header = header or gyroscope("G")
    with LogWriter(path, [header], source="simulated", epoch=EPOCH) as writer:
        whole = np.rint(counts).astype(np.int16)
        writer.append(header.name, Block(time, whole, np.zeros(len(time), np.uint16) if status is None else status))
        for phase in phases:
            writer.phase(phase)
    return path


def noise_of(path: Path, name: str = "G") -> Floats:
    with open_log(path) as log:
        noise = calibrate_noise(log).sensors[name].noise_lsb
    assert noise is not None
    return noise


def white(rows: int, sigma: tuple[float, float, float] = (20.0, 30.0, 50.0), seed: int = 2) -> Floats:
    return np.asarray(np.random.default_rng(seed).normal(0, sigma, (rows, 3)))


def test_noise_of_white_readings_is_their_standard_deviation(tmp_path: Path) -> None:
    """Five standard errors of a standard deviation, sigma / sqrt(2 n)."""
    noise = noise_of(write(tmp_path, white(20000), [STILL]))
    expected = np.sqrt(np.array([20.0, 30.0, 50.0]) ** 2 + 1 / 12)
    assert (np.abs(noise - expected) < 5 * expected / np.sqrt(2 * 20000 * 255 / 256)).all()


def test_a_drift_hardly_adds_to_the_noise(tmp_path: Path) -> None:
    """A ramp of 0.2 counts a row adds 0.2^2 * 256^2 / 12 to the variance within a segment, not its 4000 counts."""
    ramp = 0.2 * np.arange(20000)[:, None] - 2000
    noise = noise_of(write(tmp_path, white(20000) + ramp, [STILL]))
    expected = np.sqrt(np.array([20.0, 30.0, 50.0]) ** 2 + 0.2**2 * 256**2 / 12 + 1 / 12)
    assert (np.abs(noise - expected) < 5 * expected / np.sqrt(2 * 20000)).all()


def test_noise_is_pooled_over_segments_with_different_means(tmp_path: Path) -> None:
    """Two faces of 300 and 10 rows: squares about the mean of each, over the degrees of freedom, by hand."""
    counts = np.rint(white(310, seed=5))
    counts[300:] += 5000
    phases = [Phase(0, 3_000_000_000, "x_up", "+X"), Phase(3_000_000_000, 4_000_000_000, "x_down", "-X")]
    groups = [counts[:256], counts[256:300], counts[300:]]
    squares = sum(((group - group.mean(axis=0)) ** 2).sum(axis=0) for group in groups)
    assert noise_of(write(tmp_path, counts, phases)) == pytest.approx(np.sqrt(squares / (310 - 3)))


def test_stale_saturated_and_suspect_rows_are_excluded(tmp_path: Path) -> None:
    counts = np.rint(white(200, seed=6))
    status = np.zeros(200, np.uint16)
    for row, flag in ((10, 1), (50, 4), (90, 32)):
        status[row], counts[row] = flag, 20000
    sound = counts[status == 0]
    expected = sound.std(axis=0, ddof=1)
    assert noise_of(write(tmp_path, counts, [STILL], status)) == pytest.approx(expected)


def test_motion_outside_the_still_phases_is_excluded(tmp_path: Path) -> None:
    counts = white(4000)
    counts[2000:] *= 100
    phases = [Phase(0, 20_000_000_000, "room"), Phase(20_000_000_000, 40_000_000_000, "motion")]
    assert (noise_of(write(tmp_path, counts, phases)) < [25, 35, 55]).all()


def test_a_motion_with_a_noted_axis_is_no_rest(tmp_path: Path) -> None:
    counts = white(4000)
    counts[2000:] *= 3
    phases = [Phase(0, 20_000_000_000, "pose 1"), Phase(20_000_000_000, 40_000_000_000, "motion", "+Z")]
    assert (noise_of(write(tmp_path, counts, phases)) < [25, 35, 55]).all()


def test_a_heated_rest_is_excluded_if_there_is_another(tmp_path: Path) -> None:
    counts = white(4000)
    counts[2000:] *= 3
    phases = [Phase(0, 20_000_000_000, "room", "+Z"), Phase(20_000_000_000, 40_000_000_000, "heat", "+Z")]
    assert (noise_of(write(tmp_path, counts, phases)) < [25, 35, 55]).all()
    (tmp_path / "heated").mkdir()
    assert (noise_of(write(tmp_path / "heated", counts, phases[1:])) > [25, 35, 55]).all()


def test_rests_are_detected_by_accelerometers_where_phases_are_missing(tmp_path: Path) -> None:
    counts = white(6000, (5.0, 5.0, 5.0)) + np.array([0, 0, 2048])
    counts[3000:3600] += np.random.default_rng(7).normal(0, 500, (600, 3))
    noise = noise_of(write(tmp_path, counts, [], header=accelerometer("A")), "A")
    assert noise == pytest.approx([5.0] * 3, rel=5 / np.sqrt(2 * 4000))


def test_a_log_without_rest_is_refused(tmp_path: Path) -> None:
    counts = white(6000, (900.0, 900.0, 900.0))
    path = write(tmp_path, counts, [], header=accelerometer("A"))
    with open_log(path) as log, pytest.raises(CalibrationError, match="no stretch in which the box stood still"):
        calibrate_noise(log)


def test_progress_is_reported_for_each_sensor(tmp_path: Path) -> None:
    reports: list[tuple[str, int, int]] = []
    with open_log(write(tmp_path, white(2000), [STILL])) as log:
        calibrate_noise(log, progress=lambda *told_now: reports.append(told_now))
    assert reports == [("noise", 1, 1)]


@pytest.mark.parametrize(("technique", "expected"), [("planes", [("noise", 1, 1)]), ("mean", [])])
def test_progress_is_reported_for_the_noise_that_a_technique_needs(
    tmp_path: Path, technique: str, expected: list[tuple[str, int, int]]
) -> None:
    reports: list[tuple[str, int, int]] = []
    with open_log(write(tmp_path, white(2000), [STILL])) as log:
        prepare_inputs(log, Calibration(), technique=technique, progress=lambda *now: reports.append(now))
    assert reports == expected


def test_a_sensor_without_valid_readings_is_named(tmp_path: Path) -> None:
    path = write(tmp_path, white(100), [STILL], np.full(100, 32, np.uint16))
    with open_log(path) as log, pytest.raises(CalibrationError, match="sensor G: no valid readings"):
        calibrate_noise(log)


def calibrated(path: Path, name: str = "G") -> SensorCalibration:
    with open_log(path) as log:
        return calibrate_noise(log).sensors[name]


@pytest.mark.slow
def test_standard_error_is_the_scatter_of_repetitions(tmp_path: Path) -> None:
    """Of 16 logs of 4096 white rows each, three axes: the standard deviation of 48 figures is known to 10 %."""
    result = []
    for seed in range(16):
        known = calibrated(write(tmp_path / str(seed), white(4096, (20.0, 20.0, 20.0), seed), [STILL]))
        assert known.noise_sem_lsb is not None
        result.append((known.noise_lsb, known.noise_sem_lsb))
    noise, sem = np.array(result).transpose(1, 0, 2)
    assert np.mean(sem) == pytest.approx(noise.std(ddof=1), rel=0.3)
    assert np.mean(sem) == pytest.approx(20 / np.sqrt(2 * 4096), rel=0.1)


@pytest.mark.slow
def test_standard_error_grows_with_the_correlation_of_neighbours(tmp_path: Path) -> None:
    """Rows that correlate by r^k are fewer independent ones: the error of the variance grows by sqrt((1 + r^2) / (1 -
    r^2)).
    """
    known = calibrated(write(tmp_path, filtered(32768, 0.8), [STILL]))
    assert known.noise_sem_lsb is not None and known.noise_lsb is not None
    expected = known.noise_lsb * np.sqrt((1 + 0.8**2) / (1 - 0.8**2) / (2 * 32768))
    assert known.noise_sem_lsb == pytest.approx(expected, rel=0.3)


def filtered(rows: int, kept: float, seed: int = 9) -> Floats:
    """(rows, 3) that correlate by kept^k, 30 counts rms."""
    steps = np.random.default_rng(seed).normal(0, 30 * np.sqrt(1 - kept**2), (rows, 3))
    out = np.zeros((rows, 3))
    for i in range(1, rows):
        out[i] = kept * out[i - 1] + steps[i]
    return out


@pytest.mark.slow
def test_correlation_of_neighbours(tmp_path: Path) -> None:
    """White: 0 within four of 1 / sqrt(n); a filter of first order: its coefficient."""
    plain = calibrated(write(tmp_path / "white", white(10000), [STILL])).noise_correlation
    coloured = calibrated(write(tmp_path / "coloured", filtered(10000, 0.5), [STILL])).noise_correlation
    assert plain == pytest.approx([0.0] * 3, abs=4 / np.sqrt(10000))
    assert coloured == pytest.approx([0.5] * 3, abs=4 / np.sqrt(10000) + 3 / 256)


def test_rows_across_a_gap_are_not_neighbours(tmp_path: Path) -> None:
    """Runs of a, -a, a, ... of 8 rows: 7 products of -a^2. Their variance is 8/7 a^2, a mean of 8 white rows would take
    1/8 of it from each product, which is put back: (-7 + 1) / 7 / (8/7). Across the gaps there would be -7/8.
    """
    size = np.random.default_rng(3).choice([-500.0, 500.0], (500, 3))
    rows = np.repeat(size, 8, axis=0) * np.tile([1.0, -1.0], 2000)[:, None]
    status = np.where(np.arange(4000) % 8 == 0, LOST_BEFORE, 0).astype(np.uint16)
    assert calibrated(write(tmp_path, rows, [STILL], status)).noise_correlation == pytest.approx([-0.75] * 3)


def test_stale_rows_do_not_correlate_with_their_original(tmp_path: Path) -> None:
    """Every row is repeated, the repetition flagged: the new rows do not correlate."""
    rows = np.repeat(np.rint(white(4000)), 2, axis=0)
    status = np.tile([0, 1], 4000).astype(np.uint16)
    result = calibrated(write(tmp_path, rows, [STILL], status)).noise_correlation
    assert result == pytest.approx([0.0] * 3, abs=4 / np.sqrt(4000))


def test_a_line_is_detected_with_its_share_of_the_variance(tmp_path: Path) -> None:
    """40 counts at 23.4 Hz on 20 counts of noise on x: 800 of 1200 of the variance."""
    counts = white(12000)
    counts[:, 0] += 40 * np.sin(2 * np.pi * 23.4 * np.arange(12000) / 100)
    (line,) = calibrated(write(tmp_path, counts, [STILL])).noise_lines
    assert line.axis == "x"
    assert line.frequency_hz == pytest.approx(23.4, abs=0.01)
    assert line.amplitude_lsb == pytest.approx(40, abs=1.0)
    assert line.share == pytest.approx(800 / 1200, abs=0.02)


def wandering(rows: int, from_hz: float, to_hz: float, amplitude: float) -> Floats:
    """A sine at 100 readings per second whose frequency changes from `from_hz` to `to_hz`."""
    return np.asarray(amplitude * np.sin(2 * np.pi * np.cumsum(np.linspace(from_hz, to_hz, rows)) / 100))


def test_a_line_of_varying_frequency_is_one_line(tmp_path: Path) -> None:
    """40 counts from 20 to 22 Hz on 20 counts of noise: a hump in the mean spectrum, a line in every window."""
    counts = white(24000)
    counts[:, 0] += wandering(24000, 20.0, 22.0, 40.0)
    (line,) = calibrated(write(tmp_path, counts, [STILL])).noise_lines
    assert line.range_hz == pytest.approx([20.0, 22.0], abs=0.2)
    assert line.frequency_hz == pytest.approx(21.0, abs=0.1)
    assert line.share == pytest.approx(800 / 1200, abs=0.05)


def test_a_short_line_is_not_a_line_of_varying_frequency(tmp_path: Path) -> None:
    """A tenth of the log: neither steady nor in a quarter of the windows, at two frequencies far apart."""
    counts = white(24000)
    counts[:1200, 0] += wandering(1200, 20.0, 26.0, 60.0)
    lines = calibrated(write(tmp_path, counts, [STILL])).noise_lines
    assert all(line.range_hz is None for line in lines)


@pytest.mark.slow
def test_noise_alone_shows_no_lines(tmp_path: Path) -> None:
    """One in a hundred logs of noise alone may show a line: none of 8 white logs, and none of 2 coloured logs."""
    logs = [white(4096, seed=seed) for seed in range(6)] + [filtered(4096, 0.5, seed) for seed in (1, 2)]
    result = [calibrated(write(tmp_path / str(i), counts, [STILL])).noise_lines for i, counts in enumerate(logs)]
    assert [lines for lines in result if lines] == []


def test_lines_are_printed_and_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    counts = white(12000)
    counts[:, 1] += 60 * np.sin(2 * np.pi * 23.4 * np.arange(12000) / 100)
    run = write(tmp_path, counts, [STILL])
    assert main(["calibrate", "noise", str(run), "-o", str(tmp_path / "cal.toml")]) == 0
    text = capsys.readouterr().out
    assert "G y: a line at 23.40 Hz carries 67 % of the scatter" in text
    saved = load_calibration(tmp_path / "cal.toml").sensors["G"]
    assert [line.axis for line in saved.noise_lines] == ["y"] and saved.drift is not None


def test_a_line_in_rows_that_arrive_in_bursts_is_detected(tmp_path: Path) -> None:
    """Read at 100 Hz, polled by a host every 50 to 90 ms: lines are those of the readings, and a line of amplitude 15
    has a fifth of the variance, 15^2 / 2 of 15^2 / 2 + 20^2.
    """
    rows, rng = 30_000, np.random.default_rng(6)
    read_s = np.arange(rows) / 100.0
    visits_s = np.cumsum(rng.uniform(0.05, 0.09, rows))
    counts = white(rows, (20.0, 20.0, 20.0))
    counts[:, 2] += 15.0 * np.sin(2 * np.pi * 31.4 * read_s)
    visit = np.searchsorted(visits_s, read_s)
    place = np.arange(rows) - np.searchsorted(visit, visit)
    header = SensorHeader("G", "l3g4200d", "angular_rate", "dps", 250.0, 114.0)
    path = tmp_path / "run.h5"
    with LogWriter(path, [header], source="imported", epoch="2024-01-01T00:00:00Z") as log:
        times_ns = np.rint((visits_s[visit] + 0.001 * place) * 1e9).astype(np.int64)
        log.append("G", Block(times_ns, np.rint(counts).astype(np.int16), np.zeros(rows, np.uint16)))
        log.phase(Phase(0, int(times_ns[-1]) + 1, "static", "+Z"))
    known = calibrated(path)
    (line,) = known.noise_lines
    assert line.frequency_hz == pytest.approx(31.4, abs=0.1)
    assert line.share == pytest.approx(15**2 / 2 / (15**2 / 2 + 20**2), rel=0.15)


def test_the_share_of_a_line_is_at_most_the_whole_variance() -> None:
    """A sine of amplitude a has the variance a^2 / 2; a sine that was estimated too large has the whole variance."""
    assert _share(1.0, 1.0) == 0.5
    assert _share(4.0, 1.0) == _share(2.0, 1.0) == 1.0

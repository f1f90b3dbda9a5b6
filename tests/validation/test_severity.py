"""The matched statistic against closed forms, on synthetic logs, and the search for a severity."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from imuarray.errors import ConfigError
from imuarray.log import Block, Log, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Stimulus
from imuarray.validation import generator
from imuarray.validation.case import Put
from imuarray.validation.severity import LIMIT, find_severity, matched_statistic
from imuarray.validation.trial import frozen_thresholds
from tests.selection import examples, some

Floats = npt.NDArray[np.float64]
ROWS, SIGMA = 6400, 20.0
HEADER = SensorHeader("A", "bma180", "specific_force", "g", 4.0, 2048.0)


@contextmanager
def logs(folder: Path, *counts: Floats, header: SensorHeader = HEADER, up: str = "+Z") -> Iterator[list[Log]]:
    """Logs at 100 Hz of these (n, 3); `up` is noted for the whole log."""
    opened = []
    for number, values in enumerate(counts):
        path = folder / f"{len(list(folder.iterdir()))}-{number}.h5"
        time = np.arange(len(values), dtype=np.int64) * 10_000_000
        with LogWriter(path, [header], source="imported", epoch="2024-01-01T00:00:00Z") as log:
            rounded = np.round(values).astype(np.int16)
            log.append("A", Block(time, rounded, np.zeros(len(values), np.uint16)))
            log.phase(Phase(0, int(time[-1]) + 1, "static", up))
        opened.append(open_log(path))
    yield opened
    for log in opened:
        log.close()


def noise(seed: int = 1, rows: int = ROWS) -> Floats:
    return SIGMA * np.random.default_rng(seed).standard_normal((rows, 3))


def on_x(values: Floats) -> Floats:
    return np.stack([values, 0 * values, 0 * values], axis=1)


@pytest.mark.slow
def test_a_step_between_halves_has_the_ratio_of_a_matched_filter(tmp_path: Path) -> None:
    """A step of h at the middle of n rows of white noise, with a fitted mean: h sqrt(n) / (2 sigma) = 4; the density of
    the noise is estimated from the lowest bins of a spectrum of some tens of windows.
    """
    step = 8 * SIGMA / math.sqrt(ROWS) * (np.arange(ROWS) >= ROWS / 2)
    with logs(tmp_path, noise(), noise() + on_x(step)) as (plain, changed):
        assert matched_statistic([plain], [changed]) == pytest.approx(4.0, rel=0.12)
        assert matched_statistic([plain], [plain]) == 0.0


def test_a_fitted_bias_or_noise_has_no_ratio(tmp_path: Path) -> None:
    """A bias; a noise that is also white: the remainder is chance."""
    louder = noise() * 1.3
    with logs(tmp_path, noise(), noise() + 50.0, louder) as (plain, moved, loud):
        assert matched_statistic([plain], [moved]) < LIMIT
        assert matched_statistic([plain], [loud]) < LIMIT


def test_independent_noise_of_two_counts_has_no_ratio(tmp_path: Path) -> None:
    """White noise of 1.95 and of 1.55 counts. Half of the steps are at most two counts large, and so are half of the
    differences of independent steps.
    """
    plain, other = ([size / SIGMA * noise(first + log) for log in range(4)] for size, first in ((1.95, 0), (1.55, 4)))
    with logs(tmp_path, *plain, *other) as opened:
        assert matched_statistic(opened[:4], opened[4:]) < LIMIT


@pytest.mark.slow
def test_deviations_within_the_tolerance_of_a_part_are_not_an_effect(tmp_path: Path) -> None:
    """A scale factor within 2.3 % (BMA-70), four times the noise, and a bias that scatters by half of what is usual
    from one log to the next (0.6 mg, 1.2 counts); ten times as much of a scale or a scatter is an effect.
    """
    swing = noise() + on_x(2000 * np.sin(2 * np.pi * 0.02 * np.arange(ROWS) / 100 * 16))
    with logs(tmp_path, swing, 1.01 * swing, 1.1 * swing, 4 * noise(3), noise(3)) as (plain, usual, off, loud, quiet):
        assert matched_statistic([plain], [usual]) < LIMIT < matched_statistic([plain], [off])
        assert matched_statistic([quiet], [loud]) < LIMIT
    with logs(tmp_path, *(noise() + bias for bias in (0.0, 1.2, 24.0))) as (first, near, far):
        assert matched_statistic([first, first], [first, near]) < LIMIT
        assert matched_statistic([first, first], [first, far]) > LIMIT


@pytest.mark.slow
def test_a_cutoff_within_its_tolerance_is_not_an_effect(tmp_path: Path) -> None:
    """The filter of a part may differ by a half; a filter at a third of its cutoff is an effect."""
    header = replace(HEADER, bandwidth_hz=20.0)

    def filtered(cutoff_hz: float) -> Floats:
        kept = math.exp(-2 * math.pi * cutoff_hz / 100)
        return np.asarray(lfilter([1 - kept], [1, -kept], 3 * noise(), axis=0))

    with logs(tmp_path, *map(filtered, (20.0, 24.0, 4.0)), header=header) as (plain, near, far):
        assert matched_statistic([plain], [near]) < LIMIT < matched_statistic([plain], [far])


@pytest.mark.slow
def test_a_tilt_of_one_accelerometer_is_observable_with_noted_attitude(tmp_path: Path) -> None:
    """A tilt by 10 deg moves 0.17 g from z to x."""
    level, tilted = (
        noise() + 2048 * np.array([math.sin(angle), 0.0, math.cos(angle)]) for angle in (0.0, math.radians(10))
    )
    halves = np.where(np.arange(ROWS)[:, None] < ROWS / 2, level, tilted)
    with logs(tmp_path, level, tilted, up="") as (plain, moved):
        assert matched_statistic([plain], [moved]) < LIMIT
    with logs(tmp_path, level, halves) as (plain, moved):
        assert matched_statistic([plain], [moved]) > LIMIT


SECONDS = np.arange(ROWS) / 100
ANGLE_RAD = np.where(np.arange(ROWS) // 800 % 2, 2 * np.pi * np.sin(np.pi * SECONDS / 8) ** 2, 0.0)


def turning(folder: Path, *added: Floats, names: str = "A") -> list[Log]:
    """Return logs of accelerometers that turn about z at times, with `added` counts, and the motion as commanded."""
    opened = []
    force_g = np.stack([np.sin(ANGLE_RAD), np.cos(ANGLE_RAD), 0 * ANGLE_RAD], axis=1)
    time = np.arange(ROWS, dtype=np.int64) * 10_000_000
    for number, counts in enumerate(added):
        path = folder / f"turning-{number}.h5"
        headers = [replace(HEADER, name=name) for name in names]
        with LogWriter(path, headers, source="imported", epoch="2024-01-01T00:00:00Z") as log:
            for seed, name in enumerate(names, start=1):
                rounded = np.round(2048 * force_g + noise(seed) + counts).astype(np.int16)
                log.append(name, Block(time, rounded, np.zeros(ROWS, np.uint16)))
            rate = np.zeros((ROWS, 3))
            rate[:, 2] = np.gradient(ANGLE_RAD, SECONDS)
            log.stimulus("reference", Stimulus(time, 9.80665 * force_g, rate, np.full(ROWS, 25.0)))
        opened.append(open_log(path))
    return opened


@pytest.mark.slow
def test_a_bias_is_not_an_effect_in_motion(tmp_path: Path) -> None:
    """The constant that the bias adds to all rows of a log is fitted, also in motion; a term of the square of the force
    is not.
    """
    square = on_x(40.0 * np.sin(ANGLE_RAD) ** 2)
    plain, biased, bent = turning(tmp_path, on_x(np.zeros(ROWS)), np.full((ROWS, 3), 30.0), square)
    assert matched_statistic([plain], [biased]) < LIMIT
    assert matched_statistic([plain], [bent]) > LIMIT


@pytest.mark.slow
def test_sensor_noise_is_not_an_effect_in_motion(tmp_path: Path) -> None:
    """The response is that to the commanded motion: the sensor's own noise, 80 times its standard error in the readings
    of all rows, is not a response to the motion. Spectra of fifty windows differ by up to 1.5 limits.
    """
    plain, other = turning(tmp_path, np.zeros((ROWS, 3)), noise(2) - noise())
    assert matched_statistic([plain], [other]) < 1.5 * LIMIT


@pytest.mark.slow
def test_a_delay_is_observable_only_against_another_recording(tmp_path: Path) -> None:
    """An accelerometer 20 ms late, beyond the 9 ms that its filter and a sample of 10 ms explain by half, is observable
    against a track; without a track and without another accelerometer it is not observable.
    """
    late = np.zeros((ROWS, 3))
    plain = turning(tmp_path, late)[0]
    counts = np.asarray(plain["A"].counts[:], float)
    late[5:] = counts[:-5] - counts[5:]
    (tmp_path / "late").mkdir()
    delayed = turning(tmp_path / "late", late)[0]
    assert matched_statistic([plain], [delayed], has_track=True) > 1.5 * matched_statistic(
        [plain], [delayed], has_track=False
    )


@pytest.mark.slow
def test_a_clock_of_all_sensors_is_observable_only_against_a_track(tmp_path: Path) -> None:
    """The recorder dates the rows of two accelerometers 20 ms late. One of them would be late behind the other, but
    both are late together.
    """
    late = np.zeros((ROWS, 3))
    plain = turning(tmp_path, late, names="AB")[0]
    counts = 2048 * np.stack([np.sin(ANGLE_RAD), np.cos(ANGLE_RAD), 0 * ANGLE_RAD], axis=1)
    late[2:] = counts[:-2] - counts[2:]
    (tmp_path / "late").mkdir()
    delayed = turning(tmp_path / "late", late, names="AB")[0]
    of_a_sensor = matched_statistic([plain], [delayed], has_track=False)
    assert matched_statistic([plain], [delayed], has_track=True, is_of_recorder=True) == of_a_sensor
    assert of_a_sensor > 1.5 * matched_statistic([plain], [delayed], has_track=False, is_of_recorder=True)


@pytest.mark.slow
def test_a_displacement_within_the_tolerance_is_not_an_effect(tmp_path: Path) -> None:
    """An accelerometer 3 mm from its noted place reads rate x (rate x r) + acceleration x r (about z: -x w^2 along x, x
    w' along y); at 50 mm it is an effect.
    """
    rate = np.gradient(ANGLE_RAD, SECONDS)
    per_metre = np.stack([-(rate**2), np.gradient(rate, SECONDS), 0 * rate], axis=1) / 9.80665 * 2048
    plain, near, far = turning(tmp_path, *(metres * per_metre for metres in (0.0, 0.003, 0.05)))
    assert matched_statistic([plain], [near]) < LIMIT < matched_statistic([plain], [far])


@pytest.mark.slow
@pytest.mark.parametrize("sigma", some([0.25, 0.4, 0.6], 1))
def test_another_level_within_a_code_is_not_an_effect(tmp_path: Path, sigma: float) -> None:
    """With little noise another bias changes the noise of rounding, the share of repeated codes, and the share of even
    codes (its first harmonic at a sigma of 0.4 counts is 0.21 of the mean); codes that are all even are an effect.
    """
    white = sigma * np.random.default_rng(3).standard_normal((ROWS, 3))
    levels = [white + 500.0 + level for level in (0.0, 0.25, 0.5)]
    even = 2 * np.round((3 * white + 500) / 2)
    with logs(tmp_path, *levels, 3 * white + 500, even) as (plain, quarter, half, loud, changed):
        assert matched_statistic([plain], [quarter]) < LIMIT
        assert matched_statistic([plain], [half]) < LIMIT
        assert sigma < 0.3 or matched_statistic([loud], [changed]) > LIMIT


@pytest.mark.slow
def test_another_draw_of_noise_is_not_an_effect(tmp_path: Path) -> None:
    with logs(tmp_path, *(noise(seed) for seed in range(6))) as (plain, *others):
        assert max(matched_statistic([plain], [other]) for other in others) < LIMIT


@pytest.mark.slow
def test_a_line_is_detected_in_the_spectrum(tmp_path: Path) -> None:
    """With an amplitude of sigma, half the noise's power in a bin or three of thirty-two, of some hundred windows."""
    line = SIGMA * np.sin(2 * np.pi * 0.31 * np.arange(ROWS))
    with logs(tmp_path, noise(), noise() + on_x(0.3 * line), noise() + on_x(line)) as (plain, small, large):
        assert LIMIT < matched_statistic([plain], [small]) < matched_statistic([plain], [large])


@settings(max_examples=examples(60))
@given(limit=st.floats(0.05, 15.0), power=st.floats(0.7, 2.2), wanted=st.sampled_from([2.0, 5.0]))
def test_the_search_for_a_severity_needs_few_steps(limit: float, power: float, wanted: float) -> None:
    asked: list[float] = []

    def statistic(size: float) -> float:
        asked.append(size)
        return LIMIT * (size / limit) ** power

    score = find_severity(statistic, wanted, 1.0)
    assert len(asked) <= 4
    if math.isfinite(score.limits):
        assert score.limits == pytest.approx((score.severity / limit) ** power)
        assert 0.5 < score.limits / wanted < 2.0


def test_an_unobservable_mechanism_has_no_limit() -> None:
    score = find_severity(lambda size: 0.01, 5.0, 1.0)
    assert math.isnan(score.limits)
    assert score.severity == 64.0
    assert LIMIT == 4.0


def test_a_mechanism_without_a_size_near_the_wanted_one_is_as_small_as_possible() -> None:
    """A converter that clips above a severity of 3 is tried at 1 (nothing), 10 (100 limits), 0.5 = 10 * 5 / 100, and at
    ten times the latter.
    """
    score = find_severity(lambda size: 400.0 if size > 3 else 0.01, 5.0, 1.0)
    assert math.isnan(score.limits)
    assert score.severity == 5.0


@pytest.mark.slow
def test_an_error_of_the_generator_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"the generator of cases: .*nobody"):
        generator.record(tmp_path, "static", (Put("mains_ripple", 1.0, 1.0, ("nobody",)),), 1)
    with pytest.raises(ConfigError, match=r"the generator of cases: .*world: recorder is missing"):
        generator.record_in({"array": "", "sessions": [], "room": {}}, tmp_path / "world", (), 1)


def test_thresholds_are_noted_with_the_version() -> None:
    noted = frozen_thresholds()
    assert noted["significance level of a gap"] == 0.05
    assert str(noted["software"]).startswith("imuarray ")

"""The motion of a recorded log: its truth or reference, else its phases."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.calibrate.segments import TemperatureSeries
from imuarray.errors import LogError
from imuarray.log import Block, Log, LogWriter, Stimulus
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate.motion import HandShake
from imuarray.simulate.motion import like as like_module
from imuarray.simulate.motion.like import LikeLog, _average
from imuarray.simulate.motion.stimulus import temperature_at

G = 9.80665
S = 10**9
ACC = SensorHeader("Acc", "bma180", "specific_force", "g", 16.0, 512.0)
BARO = SensorHeader(
    "Baro", "bmp180", "pressure", "Pa", 0.0, 0.0, columns=("ut", "up"), compensated=("temperature", "pressure")
)
Times = npt.NDArray[np.int64]


def write(
    path: Path,
    phases: Sequence[Phase] = (),
    tracks: dict[str, Stimulus] | None = None,
    barometer: tuple[Times, npt.NDArray[np.float64]] | None = None,
    length_s: float = 10.0,
) -> Path:
    sensors = [ACC] if barometer is None else [ACC, BARO]
    with LogWriter(path, sensors, source="simulated", epoch="2024-01-01T00:00:00Z") as log:
        time = np.linspace(0, length_s * S, 11).astype(np.int64)
        log.append("Acc", Block(time, np.zeros((11, 3), np.int16), np.zeros(11, np.uint16)))
        if barometer is not None:
            time, degc = barometer
            made = {"temperature": degc, "pressure": np.full(len(time), 1e5)}
            log.append(
                "Baro", Block(time, np.zeros((len(time), 2), np.int32), np.zeros(len(time), np.uint16), None, made)
            )
        for phase in phases:
            log.phase(phase)
        for name, rows in (tracks or {}).items():
            log.stimulus(name, rows)
    return path


SHAKE = HandShake(peak_g=4.0, peak_dps=300.0, still_s=1.0, motion_s=8.0)


def track(time: Times) -> Stimulus:
    stimulus = SHAKE.stimulus(time)
    return Stimulus(time, stimulus.force_box, stimulus.rate_box, 20.0 + time * 1e-9)


@pytest.mark.slow
def test_the_truth_is_interpolated_between_its_rows(tmp_path: Path) -> None:
    """Rows at 200 Hz, sines up to 6 Hz: cubic pieces with three-point slopes err by some w^3 h^3 / 50 of the amplitude,
    1e-4 of it; a straight line would err by w^2 h^2 / 8, 4e-3.
    """
    rows = np.arange(0, 10 * S + 1, 5_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"truth": track(rows)})) as log:
        motion = LikeLog(log)
        assert motion.source == "truth"
        assert motion.stimulus(rows).force_box == pytest.approx(SHAKE.stimulus(rows).force_box, abs=1e-12)
        between = rows[:-1] + 2_500_000
        stimulus, expected = motion.stimulus(between), SHAKE.stimulus(between)
        assert stimulus.force_box == pytest.approx(expected.force_box, abs=4 * G * 1e-3)
        assert stimulus.rate_box == pytest.approx(expected.rate_box, abs=5 * 1e-3)
        scale = np.abs(expected.angular_acceleration_box).max()
        assert stimulus.angular_acceleration_box == pytest.approx(expected.angular_acceleration_box, abs=0.03 * scale)
        assert stimulus.temperature_degc == pytest.approx(20 + between * 1e-9, abs=1e-9)
        slope = (motion.stimulus(between + 1000).rate_box - motion.stimulus(between - 1000).rate_box) / 2e-6
        assert stimulus.angular_acceleration_box == pytest.approx(slope, abs=1e-4)


@pytest.mark.slow
def test_results_do_not_depend_on_blocks_or_earlier_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.cumsum(np.random.default_rng(2).integers(1_000_000, 9_000_000, 2000))  # uneven
    path = write(tmp_path / "log.h5", tracks={"truth": track(rows)})
    asked = np.random.default_rng(3).integers(-S, 12 * S, 3000)
    with Log(path) as log:
        whole = LikeLog(log).stimulus(asked)
    monkeypatch.setattr(like_module, "BLOCK", 64)
    with Log(path) as log:
        motion = LikeLog(log)
        stimulus = motion.stimulus(asked)
        assert stimulus.force_box == pytest.approx(whole.force_box, abs=1e-11)
        assert stimulus.angular_acceleration_box == pytest.approx(whole.angular_acceleration_box, abs=1e-8)
        assert np.array_equal(motion.stimulus(asked[1000:1100]).force_box, stimulus.force_box[1000:1100])


def test_only_a_few_blocks_are_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(like_module, "BLOCK", 64)
    read: list[int] = []
    whole = like_module.SplineColumns._read
    monkeypatch.setattr(
        like_module.SplineColumns, "_read", lambda own, number: read.append(number) or whole(own, number)
    )
    rows = np.arange(0, 10 * S, 5_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"truth": track(rows)})) as log:
        for kept_bytes, kept in ((0, 4), (1 << 20, 32)):
            monkeypatch.setattr(like_module, "_KEPT_BYTES", kept_bytes)
            read.clear()
            moving = LikeLog(log)._moving
            assert moving is not None
            moving.at(rows)
            assert read == list(range(32))  # 2000 rows in blocks of 64, each read once
            assert sorted(moving._blocks) == list(range(32 - kept, 32))


def test_a_gap_in_the_rows_is_crossed_without_overshoot() -> None:
    """Rest, a stall of 1.2 s, and a rotation that began in it: between the rows the rate lies between theirs. A cubic
    piece by the slopes of the adjacent short intervals would swing to +2.6 deg/s.
    """
    time_ns = np.r_[np.arange(20), np.arange(44, 60)] * 50_000_000
    rate = np.where(time_ns < 44 * 50_000_000, 0.0, -0.4 - 100.0 * (time_ns * 1e-9 - 2.2))[:, None] * np.ones((1, 3))
    columns = like_module.SplineColumns(time_ns, (rate,), "a track")
    across = columns.values_at(np.linspace(0.95e9, 2.2e9, 100).astype(np.int64))
    assert across.max() <= 0 and across.min() >= -0.4 - 1e-12
    even = like_module.SplineColumns(np.arange(36) * 50_000_000, (rate,), "a track")
    assert even.values_at(np.array([975_000_000]))[0, 0] > 0.1  # an ordinary interval keeps the slopes


@pytest.mark.parametrize("late", [0, 2])
def test_a_lagging_thermometer_among_three_is_ignored(tmp_path: Path, late: int) -> None:
    """Chips warm by 20 degC; their zeros differ, and one of them lags by a minute. BMA-64: 2 LSB/degC, 24 degC at 0."""
    time = np.arange(0, 60 * S, S // 10)
    headers = [replace(ACC, name=f"Acc{at}", chip="bma180", has_temperature=True) for at in range(3)]
    with LogWriter(tmp_path / "log.h5", headers, source="simulated", epoch="2024-01-01T00:00:00Z") as log:
        for at, header in enumerate(headers):
            warmth = 20 * np.clip(time / S / 60, 0, 1) if at != late else np.zeros(len(time))
            counts = np.rint(2 * (warmth + at)).astype(np.int16)
            log.append(
                header.name, Block(time, np.zeros((len(time), 3), np.int16), np.zeros(len(time), np.uint16), counts)
            )
    with Log(tmp_path / "log.h5") as log:
        degc = LikeLog(log).stimulus(np.array([S, 59 * S])).temperature_degc
    assert degc[1] - degc[0] == pytest.approx(20 * 58 / 60, abs=0.5)


def test_the_first_and_last_rows_are_extended(tmp_path: Path) -> None:
    rows = np.arange(3 * S, 5 * S, 10_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"reference": track(rows)})) as log:
        motion = LikeLog(log)
        assert motion.source == "reference"
        stimulus = motion.stimulus(np.array([-S, rows[0], rows[-1], 9 * S]))
        expected = SHAKE.stimulus(rows[[0, 0, -1, -1]])
        assert np.array_equal(stimulus.force_box, expected.force_box)
        assert not stimulus.angular_acceleration_box[[0, 3]].any()
        assert stimulus.temperature_degc == pytest.approx([23, 23, 4.99 + 20, 4.99 + 20])


def test_the_truth_has_precedence_over_the_reference(tmp_path: Path) -> None:
    rows = np.array([0, S])
    other = Stimulus(rows, np.ones((2, 3)), np.ones((2, 3)), np.full(2, -7.0))
    with Log(write(tmp_path / "log.h5", tracks={"reference": other, "truth": track(rows)})) as log:
        assert LikeLog(log).stimulus(rows).temperature_degc.tolist() == [20.0, 21.0]


def test_without_tracks_the_faces_of_phases_are_used(tmp_path: Path) -> None:
    """Out of order in the file; between faces the last is kept, before the first the first is used."""
    phases = [Phase(5 * S, 8 * S, "x_down", "-X"), Phase(S, 2 * S, "y_up", "+Y"), Phase(3 * S, 4 * S, "motion")]
    with Log(write(tmp_path / "log.h5", phases)) as log:
        motion = LikeLog(log)
        assert motion.source == "phases"
        stimulus = motion.stimulus(np.array([0, 1000, 3500, 4999, 5000, 7000, 9000]) * 1_000_000)
        up, down = [0, G, 0], [-G, 0, 0]
        assert stimulus.force_box.tolist() == [up, up, up, up, down, down, down]
        assert stimulus.field_box[0] == pytest.approx([0.2, -0.43, 0])
        assert stimulus.field_box[-1] == pytest.approx([0.43, 0, 0.2])
        assert not stimulus.rate_box.any()
        assert stimulus.temperature_degc.tolist() == [25.0] * 7
        assert [phase.name for phase in motion.phases] == ["y_up", "motion", "x_down"]
        assert motion.seconds == 10.0  # its last reading
        assert motion.stimulus(np.array([], np.int64)).force_box.shape == (0, 3)


def test_a_log_without_phases_is_upright(tmp_path: Path) -> None:
    with Log(write(tmp_path / "log.h5")) as log:
        assert LikeLog(log).stimulus(np.array([0, S])).force_box.tolist() == [[0, 0, G]] * 2


def test_the_temperature_is_that_of_the_barometer(tmp_path: Path) -> None:
    """A parabola in time passes through cubic pieces unchanged, except next to its ends."""
    time = np.arange(11) * S
    degc = 30 - 0.1 * (time * 1e-9 - 5) ** 2
    with Log(write(tmp_path / "log.h5", barometer=(time, degc))) as log:
        motion = LikeLog(log)
        at = np.array([1.5, 4.25, 7.75])
        stimulus = motion.stimulus((at * S).astype(np.int64))
        assert stimulus.temperature_degc == pytest.approx(30 - 0.1 * (at - 5) ** 2, abs=1e-9)
        assert stimulus.force_box[0].tolist() == [0, 0, G]


def test_means_of_a_thermometer_of_whole_degrees_are_shorter_in_fast_heating() -> None:
    """From 60 s on by a degree a second, which means of ten seconds would delay and smooth by degrees; before,
    and in a room that warms by a degree in a hundred seconds, they are means of ten seconds.
    """
    time_s = np.arange(0.25, 120, 0.5)
    heat_degc = np.where(time_s < 60, 20.0, time_s - 40)
    mean_s, degc = _average(TemperatureSeries("chip", time_s, np.rint(heat_degc), 1.0), 10.0)
    np.testing.assert_allclose(np.interp(time_s, mean_s, degc), heat_degc, atol=0.7)
    assert np.count_nonzero(mean_s < 60) == 6
    slow, _ = _average(TemperatureSeries("chip", time_s, np.rint(20.2 + 0.01 * time_s), 1.0), 10.0)
    assert len(slow) == 12


def test_the_noise_of_a_thermometer_does_not_shorten_its_means() -> None:
    """Of 2 degC at each reading, in steps of 0.01 degC: at most one in a hundred windows is divided."""
    rng, time_s = np.random.default_rng(4), np.arange(0.25, 5000, 0.5)
    mean_s, _ = _average(TemperatureSeries("chip", time_s, rng.normal(20, 2, len(time_s)), 0.01), 10.0)
    assert 500 <= len(mean_s) <= 505


def test_a_barometer_with_one_reading_gives_a_constant_temperature(tmp_path: Path) -> None:
    time = np.array([4 * S])
    path = write(tmp_path / "log.h5", [Phase(0, S, "x_up", "+X")], barometer=(time, np.array([33.0])))
    with Log(path) as log:
        stimulus = LikeLog(log).stimulus(np.array([0, 4, 9]) * S)
        assert stimulus.temperature_degc.tolist() == [33.0] * 3
        assert stimulus.force_box.tolist() == [[G, 0, 0]] * 3


def test_invalid_logs_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "up.h5", [Phase(0, S, "z_up", "up")])
    with Log(path) as log, pytest.raises(LogError, match=r"up.h5: phase 'z_up': up 'up'; allowed are \+X"):
        LikeLog(log)
    rows = track(np.arange(5) * S)
    rows.specific_force[3, 1] = np.nan
    path = write(tmp_path / "nan.h5", tracks={"truth": rows})
    with Log(path) as log, pytest.raises(LogError, match=r"nan.h5, truth: rows 0 to 5: finite numbers are required"):
        LikeLog(log).stimulus(np.array([0]))
    back = track(np.array([0, 2, 1, 3]) * S)
    with Log(write(tmp_path / "back.h5", tracks={"truth": back})) as log, pytest.raises(LogError, match="in order"):
        LikeLog(log).stimulus(np.array([0]))


def test_a_constant_track_is_one_row_exactly(tmp_path: Path) -> None:
    """Uneven times: the three-point formula rounds; a row of no change still has no slope."""
    rows = np.cumsum(np.random.default_rng(5).integers(1_000_000, 9_000_000, 300))
    force = np.tile([0.1, -0.3, 9.7], (300, 1))
    still = Stimulus(rows, force, np.zeros((300, 3)), np.full(300, 21.3))
    asked = np.arange(rows[0] - S, rows[-1] + S, 3_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"truth": still})) as log:
        stimulus = LikeLog(log).stimulus(asked)
        assert len(asked) > 300  # more than are kept
        assert np.array_equal(stimulus.force_box, np.broadcast_to(force[0], (len(asked), 3)))
        assert (
            stimulus.force_box.strides[0] == stimulus.rate_box.strides[0] == stimulus.temperature_degc.strides[0] == 0
        )
        assert not stimulus.angular_acceleration_box.any()


def test_a_rest_within_a_motion_is_exact(tmp_path: Path) -> None:
    rows = np.arange(0, 10 * S, 10_000_000)
    moved = track(rows)
    moved.specific_force[400:600] = [1.0, 2.0, 3.0]
    asked = np.arange(3 * S, 7 * S, 7_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"truth": moved})) as log:
        force = LikeLog(log).stimulus(asked).force_box
        shuffled = np.random.default_rng(0).permutation(asked)
        again = LikeLog(log).stimulus(shuffled).force_box
        assert np.array_equal(again[np.argsort(shuffled)], force)
    within = (asked >= rows[401]) & (asked <= rows[598])
    assert np.array_equal(force[within], np.tile([1.0, 2.0, 3.0], (int(within.sum()), 1)))
    assert not np.array_equal(force[0], force[1])


def test_results_for_a_few_instants_are_cached(tmp_path: Path) -> None:
    rows = np.arange(0, 10 * S, 10_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"truth": track(rows)})) as log:
        motion = LikeLog(log)
        few = np.array([S, 2 * S])
        assert motion.stimulus(few) is motion.stimulus(few.copy())
        assert motion.stimulus(few[:1]) is not motion.stimulus(few)


def test_a_motion_is_sent_as_its_log(tmp_path: Path) -> None:
    rows = np.arange(0, 10 * S, 10_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"truth": track(rows)})) as log:
        motion = LikeLog(log)
        stimulus = motion.stimulus(rows)
        pickled = pickle.dumps(motion)
        assert len(pickled) < 1000
        again = pickle.loads(pickled)  # noqa: S301
        assert np.array_equal(again.stimulus(rows).force_box, stimulus.force_box)
        again.log.close()


def test_instants_with_equal_ends_are_distinguished(tmp_path: Path) -> None:
    rows = np.arange(0, 10 * S, 5_000_000)
    asked = np.linspace(0, 9 * S, 1000).astype(np.int64)
    other = np.concatenate([asked[:1], asked[1:-1] + 1_000_000, asked[-1:]])
    with Log(write(tmp_path / "log.h5", tracks={"truth": track(rows)})) as log:
        motion = LikeLog(log)
        wanted = [LikeLog(log).stimulus(times).force_box for times in (asked, other)]
        assert not np.array_equal(*wanted)
        for _ in range(2):
            for times, force in zip((asked, other), wanted, strict=True):
                np.testing.assert_array_equal(motion.stimulus(times).force_box, force)


def test_a_long_track_is_followed_as_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its noise is not reduced, since the track would have to be in memory."""
    rows = np.arange(0, 10 * S, 10_000_000)
    monkeypatch.setattr("imuarray.simulate.motion.like._MOST_TRACK_ROWS", len(rows) - 1)
    with Log(write(tmp_path / "log.h5", tracks={"reference": track(rows)})) as log:
        asked = np.array([S, 5 * S, 7 * S])
        followed = LikeLog(log, rests=((2 * S, 5 * S),)).stimulus(asked)
        np.testing.assert_array_equal(followed.force_box, LikeLog(log).stimulus(asked).force_box)
        np.testing.assert_array_equal(followed.rate_box, LikeLog(log).stimulus(asked).rate_box)


def test_a_box_at_rest_has_the_mean_of_its_track(tmp_path: Path) -> None:
    rows = np.arange(0, 10 * S, 10_000_000)
    with Log(write(tmp_path / "log.h5", tracks={"reference": track(rows)})) as log:
        resting = LikeLog(log, rests=((2 * S, 5 * S),))
        own = resting.stimulus(np.array([S, 2 * S, 3 * S, 5 * S - 1, 5 * S]))
        inside = SHAKE.stimulus(rows[(rows >= 2 * S) & (rows < 5 * S)])
        for name in ("force_box", "rate_box"):
            mean = getattr(inside, name).mean(axis=0)
            np.testing.assert_allclose(getattr(own, name)[1:4], [mean] * 3, atol=1e-9)
            assert np.abs(getattr(own, name)[[0, 4]] - mean).min() > 1e-3
        assert not own.angular_acceleration_box[1:4].any()
        assert pickle.loads(pickle.dumps(resting)).rests == resting.rests  # noqa: S301


@pytest.mark.parametrize(("lead_s", "expected_degc"), [(0.0, [22.0, 23.5]), (2.0, [24.0, 25.5])])
def test_the_temperature_alone_rises_with_the_track(tmp_path: Path, lead_s: float, expected_degc: list[float]) -> None:
    """By 1 degC/s: the box is warmer by that, times its lag, than a thermometer that lags."""
    path = write(tmp_path / "log.h5", tracks={"truth": track(np.arange(0, 10 * S + 1, S // 10))})
    with Log(path) as log:
        degc = temperature_at(LikeLog(log, lead_s=lead_s), np.array([2 * S, 3 * S + S // 2]))
    np.testing.assert_allclose(degc, expected_degc, rtol=1e-9)


def test_a_log_without_a_thermometer_has_a_constant_temperature(tmp_path: Path) -> None:
    with Log(write(tmp_path / "log.h5")) as log:
        np.testing.assert_array_equal(temperature_at(LikeLog(log), np.array([0, S])), [25.0, 25.0])

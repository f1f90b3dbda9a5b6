"""Rows in pieces of random length give the same result as the log. A silent sensor is not waited for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import FusionError
from imuarray.fuse import TECHNIQUES, Axis, Frames, FusedBlock, FusionStream, Pipeline, QuantityPipeline, fuse, live
from imuarray.fuse.alignment import RowWindow, cut
from imuarray.fuse.fusion import Patience
from imuarray.log import Block, Log, open_log
from imuarray.log.sensor_log import recorded_header
from tests.fuse.conftest import Floats, Part, WriteRun, calibration, joined
from tests.fuse.row_pushes import AXES, push_rows, read, same
from tests.fuse.warm_runs import ELEMENT, heating
from tests.fuse.warm_runs import known as with_slopes
from tests.selection import some

QUANTITIES = ("specific_force", "angular_rate")


def parts() -> list[Part]:
    """Two ranges and two gyroscopes, one after the other in a frame of 10 ms; some are silent for a while."""
    units = [
        Part(
            f"A{i}",
            AXES[i],
            sigma=0.01,
            late_s=0.001 * i,
            range=(16.0, 16.0, 1.5, 1.5)[i],
            sensitivity=(2048.0, 2048.0, 16384.0, 16384.0)[i],
        )
        for i in range(4)
    ]
    units[1] = units[1]._replace(lost=lambda seconds: (seconds > 2.0) & (seconds < 2.5))
    units[2] = units[2]._replace(lost=lambda seconds: np.round(seconds * 100) % 7 == 0)
    gyro = Part("G1", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 114.0, sigma=0.1, late_s=0.004)
    return [*units, gyro, gyro._replace(name="G2", axes="-Y-X-Z", late_s=0.005, lost=lambda seconds: seconds > 4.0)]


def shaken(seconds: Floats) -> Floats:
    return np.asarray(np.sin(2 * np.pi * np.outer(seconds, [1.0, 0.7, 1.3])) * [0.9, 0.3, 0.6] + [0, 0, 1])


def turned(seconds: Floats) -> Floats:
    return np.asarray(30 * np.cos(2 * np.pi * np.outer(seconds, [0.9, 1.1, 0.4])))


def in_steps(stream: FusionStream, rows: dict[str, Block], until_s: float, step_s: float = 0.1) -> Iterator[FusedBlock]:
    """Rows in the order of a recording: the rows of every sensor for each interval of time."""
    for start_ns in range(0, round(until_s * 1e9), round(step_s * 1e9)):
        for name, block in rows.items():
            first, last = np.searchsorted(block.time, [start_ns, start_ns + round(step_s * 1e9)])
            yield from stream.push(name, cut(block, slice(int(first), int(last))))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    write = WriteRun(tmp_path_factory.mktemp("stream"))
    return write(parts(), force=shaken, rate=turned, frames=600, jitter_s=0.0005)


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return heating(tmp_path_factory.mktemp("warm") / "heat.h5", "barometer")


@pytest.mark.parametrize("technique", some(TECHNIQUES, 1))
@given(seed=st.integers(0, 1 << 32), most_s=st.sampled_from([0.02, 0.3, 1.5]))
@settings(max_examples=4, deadline=None)
def test_rows_in_any_pieces_give_the_result_of_the_log(run: Path, technique: str, seed: int, most_s: float) -> None:
    with open_log(run) as log:
        headers = [recorded_header(sensor) for sensor in log.sensors.values()]
        stream = live(headers, calibration(parts()), technique, patience=Patience(10.0))
        same(list(push_rows(stream, read(log), seed, most_s)), list(fuse(log, calibration(parts()), technique)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(3), 1))
def test_live_temperatures_are_causal(warm: Path, seed: int) -> None:
    with open_log(warm) as log:
        headers = [recorded_header(sensor) for sensor in log.sensors.values()]
        stream = live(headers, with_slopes(), "mean", patience=Patience(1000.0))
        one = list(push_rows(stream, read(log), seed, 300.0))
        same(one, list(fuse(log, with_slopes(), "mean", causal=True)))
        same(one, list(fuse(log, with_slopes(), "mean", causal=True, block=777)))
        # Up to 22.5 s old at 20 degC in 300 s, 1.5 degC of 3 counts each: the difference is at most that.
        (_, early), (_, late) = joined(one), joined(list(fuse(log, with_slopes(), "mean")))
        assert 1e-3 < np.abs(early - late).max() / 9.80665 * 512 < 4.5


def started(log: Log, timeout_s: float = 10.0, tell: Callable[[str], None] = lambda text: None) -> FusionStream:
    """Live fusion by the mean for the sensors of the log."""
    headers = [recorded_header(sensor) for sensor in log.sensors.values()]
    return live(headers, calibration(parts()), "mean", patience=Patience(timeout_s, tell))


def test_frames_are_given_while_rows_arrive(run: Path) -> None:
    """At most a margin after them, plus a block, the look-ahead of the grid, and a step of the rows."""
    with open_log(run) as log:
        frames = np.concatenate([fused.time for fused in in_steps(started(log), read(log), 3.5)])
    assert 3.5 - frames[-1] * 1e-9 < (2 * 32 + 6 + 10) / 100


@pytest.mark.slow
def test_a_silent_sensor_is_waited_for_until_the_time_out_and_reported(run: Path) -> None:
    """G2 ends at 4 s: after the time-out frames are given without it, and equal those of the log."""
    text: list[str] = []
    with open_log(run) as log:
        stream = started(log, 1.0, text.append)
        waits = list(in_steps(started(log), read(log), 6.1))
        early = list(in_steps(stream, read(log), 6.1))
        same([*early, *stream.finish()], list(fuse(log, calibration(parts()), "mean")))
    assert text == ["G2: silent, fused without it"]
    assert waits[-1].time[-1] < 4.0e9 < 5.0e9 < early[-1].time[-1]


def test_a_silent_sensor_is_used_again_after_its_return(run: Path) -> None:
    """A1 is silent from 2 to 2.5 s."""
    text: list[str] = []
    with open_log(run) as log:
        fused = list(in_steps(started(log, 0.3, text.append), read(log), 5.0))
    assert text[:2] == ["A1: silent, fused without it", "A1: fused again"]
    used = np.concatenate([block.used["specific_force"] for block in fused])
    time = np.concatenate([block.time for block in fused]) * 1e-9
    assert (used[(time > 2.05) & (time < 2.45), 1] == 0).all()
    assert (used[(time > 2.55) & (time < 3.5), 1] == 7).all()


def test_rows_out_of_order_are_refused(run: Path) -> None:
    with open_log(run) as log:
        block = read(log)["A0"]
    rows = RowWindow()
    rows.append(cut(block, slice(0, 10)))
    with pytest.raises(ValueError, match="comes after one at"):
        rows.append(cut(block, slice(9, 12)))


def test_the_window_of_rows_does_not_grow(run: Path) -> None:
    """Three margins of rows, a step, the look-ahead and look-back of the grid, half a second of silence of another
    sensor.
    """
    with open_log(run) as log:
        stream = started(log)
        most = max(stream.rows_kept for _ in in_steps(stream, read(log), 6.0))
    assert most < 6 * (3 * 32 + 10 + 3 * 6 + 50)


def test_too_few_rows_are_refused(run: Path) -> None:
    with open_log(run) as log:
        stream = started(log)
        assert list(stream.push("A0", cut(read(log)["A0"], slice(0, 2)))) == []
    with pytest.raises(FusionError, match="sensor A0: 2 rows; at least three are required"):
        list(stream.finish())
    with open_log(run) as log, pytest.raises(FusionError, match="sensor A0: 0 rows; at least three are required"):
        list(started(log).finish())


def test_a_pipeline_may_delay_frames(run: Path) -> None:
    """A pipeline that gives all frames at the end gives the same result."""

    class Late:
        def __init__(self, inner: Pipeline[FusedBlock]) -> None:
            self.inner, self.held = inner, list[FusedBlock]()

        def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FusedBlock]:
            assert len({part.time.tobytes() for part in frames.values()}) == 1
            self.held += self.inner(frames, degc)
            return iter(())

        def finish(self) -> Iterator[FusedBlock]:
            return iter(self.held)

    with open_log(run) as log:
        late = list(
            fuse(log, calibration(parts()), lambda axes, period_s: Late(QuantityPipeline(axes, "opposed")), block=100)
        )
        same(late, list(fuse(log, calibration(parts()), "opposed")))


@pytest.mark.slow
def test_a_pipeline_receives_the_element_temperatures(warm: Path) -> None:
    heard: dict[str, list[Floats]] = {"A1": [], "A2": [], "G1": []}

    class Listening:
        def __init__(self, axes: Mapping[str, Sequence[Axis]], period_s: float) -> None:
            assert period_s > 0
            self.inner = QuantityPipeline(axes, "mean")

        def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FusedBlock]:
            for name, values in degc.items():
                assert values.shape == frames["specific_force"].time.shape
                heard[name].append(values)
            return self.inner(frames, degc)

        def finish(self) -> Iterator[FusedBlock]:
            return self.inner.finish()

    with open_log(warm) as log:
        list(fuse(log, with_slopes(), Listening))
    for values in heard.values():
        assert np.concatenate(values)[100:-100] == pytest.approx(ELEMENT[100:-100], abs=0.25)

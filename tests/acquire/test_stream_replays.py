"""Frames with a good checksum that are not the stream's: old, repeated, reordered, of an earlier boot.

Each test injects them into the output of an emulated microcontroller, at random places from a fixed seed, and compares
the log with the bytes on the microcontroller's own wire.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from imuarray.acquire.recording import RecordingCounts
from imuarray.array import ArrayConfig
from imuarray.log import open_log
from tests.acquire.streams import LOST, MS, SUSPECT, events, logged, on_the_wire, stream
from tests.bus.serial_bench import Bench
from tests.firmware.kinds import both_kinds
from tests.selection import some

RATE_HZ, SECONDS = 100.0, 4.0
DATA = 0xD0
WORLD = "world=shaking&still_s=0.2&motion_s=10"
SENSORS = ("A", "G", "B")


class Injection(NamedTuple):
    """Bytes between two genuine frames, and how many whole frames they hold."""

    data: bytes
    frames: int


class Tape:
    """Frames that a microcontroller has sent, one after the other."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def whole(self, first: int, last: int) -> Injection:
        """Frames `first` to `last`, without `last`."""
        part = self.frames[max(first, 0) : max(last, 0)]
        return Injection(b"".join(part), len(part))

    def torn(self, draw: np.random.Generator, frames: int) -> Injection:
        """The last `frames` frames, less some bytes at either end."""
        part = self.frames[-frames:]
        if len(part) < 3:
            return Injection(b"", 0)
        head, tail = int(draw.integers(1, len(part[0]))), int(draw.integers(1, len(part[-1])))
        return Injection(b"".join(part)[head:-tail], len(part) - 2)


Inject = Callable[[Tape, np.random.Generator], Injection]


def previous_boot(array: ArrayConfig, path: Path, counter_us: int) -> Tape:
    """The frames of an earlier boot, whose counter was `counter_us` when it was plugged in."""
    bench, tape = Bench(array, WORLD + "&seed=5", counter_us=counter_us), Tape()

    def kept(piece: bytes) -> bytes:
        tape.frames += [piece] if piece and piece[4] == DATA else []
        return piece

    bench.delivered = kept
    stream(bench, array, path, rate_hz=RATE_HZ, seconds=SECONDS + 2)
    return tape


def injected(
    array: ArrayConfig, path: Path, seed: int, inject: Inject, chance: float = 0.05, counter_us: int = 70_000_000
) -> tuple[Bench, RecordingCounts, int, int]:
    """A recording with injections before every twentieth frame or so; how many whole frames were injected."""
    bench, tape, draw = Bench(array, WORLD, counter_us=counter_us, drift=-1e-3), Tape(), np.random.default_rng(seed)
    count = 0
    end_ns = [1 << 62]

    def delivered(piece: bytes) -> bytes:
        nonlocal count
        if not piece or piece[4] != DATA:
            return piece
        if not tape.frames:
            end_ns[0] = bench.now_ns() + round((SECONDS - 0.2) * 1e9)  # bytes at the very end are not read
        extra = Injection(b"", 0)
        if tape.frames and draw.random() < chance and bench.now_ns() < end_ns[0]:
            extra = inject(tape, draw)
        tape.frames.append(piece)
        count += extra.frames
        return extra.data + piece

    bench.delivered = delivered
    summary, start_ns = stream(bench, array, path, rate_hz=RATE_HZ, seconds=SECONDS)
    return bench, summary, start_ns, count


def check_rows(bench: Bench, array: ArrayConfig, path: Path, start_ns: int) -> dict[str, int]:
    """Each row is a genuine reading at its true time, and none is repeated; the numbers of rows."""
    rows = {}
    for name in SENSORS:
        time, counts, status = logged(path, name)
        wire_time, wire_counts = on_the_wire(bench, array, name)
        nearest = np.abs(time[:, None] + start_ns - wire_time[None, :]).argmin(axis=1)
        assert np.abs(time + start_ns - wire_time[nearest]).max() < MS // 5
        np.testing.assert_array_equal(counts, wire_counts[nearest])
        assert (np.diff(nearest) > 0).all()
        np.testing.assert_array_equal((status & LOST) != 0, np.diff(nearest, prepend=-1) > 1)
        assert not (status & SUSPECT).any()
        rows[name] = len(time)
    return rows


def one_old_frame(tape: Tape, draw: np.random.Generator) -> Injection:
    at = int(draw.integers(len(tape.frames)))
    return tape.whole(at, at + 1)


def the_last_frame_again(tape: Tape, draw: np.random.Generator) -> Injection:
    return tape.whole(len(tape.frames) - 1, len(tape.frames))


def a_recent_span(tape: Tape, draw: np.random.Generator) -> Injection:
    return tape.whole(len(tape.frames) - int(draw.integers(1, 60)), len(tape.frames))


def recent_bytes(tape: Tape, draw: np.random.Generator) -> Injection:
    return tape.torn(draw, int(draw.integers(1, 60)))


def a_shuffled_span(tape: Tape, draw: np.random.Generator) -> Injection:
    part = tape.whole(len(tape.frames) - int(draw.integers(1, 60)), len(tape.frames))
    frames = tape.frames[len(tape.frames) - part.frames :]
    return Injection(b"".join(frames[at] for at in draw.permutation(len(frames))), len(frames))


REPLAYS = [one_old_frame, the_last_frame_again, a_recent_span, recent_bytes, a_shuffled_span]


@both_kinds(pytest.mark.slow)
@pytest.mark.slow
@pytest.mark.parametrize("inject", some(REPLAYS, 1))
@pytest.mark.parametrize("counter_us", some([(1 << 32) - 3_000_000, 70_000_000], 1, 0))  # it wraps after 3 s
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.campaign)])
def test_a_replayed_frame_is_refused_and_loses_no_other(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, inject: Inject, counter_us: int, seed: int
) -> None:
    array = an_array(A=0, G=1, B=None)
    path = tmp_path / "r.h5"
    bench, summary, start_ns, count = injected(array, path, seed, inject, counter_us=counter_us)
    assert count >= 15
    assert summary.refused == count
    assert check_rows(bench, array, path, start_ns) == {"A": 400, "G": 400, "B": 400}
    assert set(summary.lost.values()) == {0}
    reports = events(path)
    assert {kind for _, kind, _ in reports} == {"refused"}
    assert "of the link refused: " in reports[0][2]
    assert reports[0][2].endswith("old, repeated or out of order")


@pytest.mark.slow
@pytest.mark.parametrize(
    "later_us", some([-1_000_000_000, -2_300_000, -37_000, 13_000, 37_000, 400_000, 1 << 31], 1, 2)
)
def test_frames_of_an_earlier_boot_are_refused(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, later_us: int
) -> None:
    """Its counter had another value when it was started: `later_us` is the difference."""
    array = an_array(A=0, G=1, B=None)
    tape = previous_boot(array, tmp_path / "old.h5", (70_000_000 + later_us) % (1 << 32))

    def inject(now: Tape, draw: np.random.Generator) -> Injection:
        if draw.random() < 0.5:  # anything
            first = int(draw.integers(len(tape.frames) - 60))
        else:  # sent at the same value of the counter, within half a second
            first = len(now.frames) + int(draw.integers(-100, 100))
        return tape.whole(first, first + int(draw.integers(1, 60)))

    path = tmp_path / "r.h5"
    bench, summary, start_ns, count = injected(array, path, 11, inject)
    assert count > 400
    assert summary.refused == count
    assert check_rows(bench, array, path, start_ns) == {"A": 400, "G": 400, "B": 400}
    assert set(summary.lost.values()) == {0}
    assert {kind for _, kind, _ in events(path)} == {"refused"}


@pytest.mark.slow
def test_frames_of_an_earlier_boot_with_equal_counters_are_refused_or_replace_the_true_frame(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    """Two boots that were started at the same count of their counters send the same frames at the same counts. What is
    ahead of now or behind it is refused; a frame that is due now can't be, and then the true one is refused.
    """
    array = an_array(A=0, G=1, B=None)
    tape = previous_boot(array, tmp_path / "old.h5", 70_000_000)
    path = tmp_path / "r.h5"
    bench, summary, start_ns, count = injected(
        array, path, 3, lambda now, draw: tape.whole(len(now.frames) - 60, len(now.frames) + 60), chance=0.02
    )
    time, _, _ = logged(path, "A")
    wire_time, _ = on_the_wire(bench, array, "A")
    nearest = np.abs(time[:, None] + start_ns - wire_time[None, :]).argmin(axis=1)
    assert np.abs(time + start_ns - wire_time[nearest]).max() < 20 * MS  # their times are those of the true frames
    assert (np.diff(time) > 0).all()
    assert len(time) + summary.lost["A"] == 400
    assert summary.refused >= count * 0.8


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 5))])
def test_reordered_frames_lose_no_more_than_the_moved_frames(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, seed: int
) -> None:
    """Spans of frames arrive later than those behind them: in order again if together, refused if much later."""
    array = an_array(A=0, G=1, B=None)
    bench, draw = Bench(array, WORLD), np.random.default_rng(seed)
    held: list[bytes] = []
    moved, release = 0, 0
    sent = 0

    def delivered(piece: bytes) -> bytes:
        nonlocal moved, release, sent
        if not piece or piece[4] != DATA:
            return b"".join([piece, *held])
        sent += 1
        if held and sent >= release:
            late = b"".join(held)
            held.clear()
            return piece + late
        if not held and draw.random() < 0.03:
            release = sent + int(draw.integers(2, 30))
        if sent < release and (not held or draw.random() < 0.4):
            held.append(piece)
            moved += 1
            return b""
        return piece

    bench.delivered = delivered
    path = tmp_path / "r.h5"
    summary, start_ns = stream(bench, array, path, rate_hz=RATE_HZ, seconds=SECONDS)
    rows = check_rows(bench, array, path, start_ns)
    assert moved > 30
    assert 0 < summary.refused <= moved
    for name in SENSORS:
        assert rows[name] + summary.lost[name] == 400
    assert sum(summary.lost.values()) <= 3 * summary.refused  # a frame holds a reading of each sensor
    assert {kind for _, kind, _ in events(path)} == {"refused", "lost"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_inserted_bytes_lose_at_most_the_frame_that_they_split(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, seed: int
) -> None:
    array = an_array(A=0, G=1, B=None)
    bench, draw, tape = Bench(array, WORLD), np.random.default_rng(seed), Tape()
    split = 0

    def delivered(piece: bytes) -> bytes:
        nonlocal split
        if not piece or piece[4] != DATA:
            return piece
        extra = b""
        if len(tape.frames) > 60 and draw.random() < 0.05:
            extra = a_recent_span(tape, draw).data if draw.random() < 0.5 else recent_bytes(tape, draw).data
        tape.frames.append(piece)
        at = int(draw.integers(1, len(piece))) if extra else 0
        split += bool(extra)
        return piece[:at] + extra + piece[at:]

    bench.delivered = delivered
    path = tmp_path / "r.h5"
    summary, start_ns = stream(bench, array, path, rate_hz=RATE_HZ, seconds=SECONDS)
    rows = check_rows(bench, array, path, start_ns)
    for name in SENSORS:
        assert rows[name] + summary.lost[name] == 400
        assert summary.lost[name] <= split
    assert split > 10


@pytest.mark.slow
def test_the_number_of_refused_frames_is_reported_over_time(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0, G=1, B=None)
    path = tmp_path / "r.h5"
    injected(array, path, 0, a_recent_span, chance=0.3)
    with open_log(path) as log:
        first, *_, last = [event for event in log.events if event.kind == "refused"]
    assert first.sensor == last.sensor == ""
    assert last.message.startswith("in all ")
    assert " refused in " in last.message

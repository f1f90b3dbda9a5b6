"""Frames that the line lost are sent again by the firmware's core, and are rows like any others; frames that it no
longer has are lost, flagged and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from imuarray.acquire.recording import RecordingCounts
from imuarray.array import ArrayConfig
from imuarray.bus.serial_link import Frame, PollList, Request
from imuarray.bus.serial_session import Admission
from tests.acquire.conftest import an_array
from tests.acquire.streams import DATA, LOST, SUSPECT, BadLine, S, events, logged, on_the_wire, stream
from tests.bus import serial_bench
from tests.bus.serial_bench import Bench
from tests.firmware.build import CoreFirmware
from tests.selection import some

__all__ = ["an_array"]

WORLD = "world=shaking&still_s=0.2&motion_s=9"


@pytest.fixture(autouse=True)
def _the_core(core_firmware: type[CoreFirmware], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(serial_bench, "Firmware", core_firmware)
    yield


def check_rows(bench: Bench, array: ArrayConfig, path: Path, start_ns: int, summary: RecordingCounts) -> None:
    """Each row is a reading of the wire at its true time, in order, once; a gap is flagged, and the sum is right."""
    for sensor in array.sensors:
        time, counts, status = logged(path, sensor.name)
        wire_time, wire_counts = on_the_wire(bench, array, sensor.name)
        nearest = np.abs(time[:, None] + start_ns - wire_time[None, :]).argmin(axis=1)
        assert np.abs(time + start_ns - wire_time[nearest]).max() < 200_000
        np.testing.assert_array_equal(counts, wire_counts[nearest])
        assert (np.diff(nearest) > 0).all()
        np.testing.assert_array_equal((status & LOST) != 0, np.diff(nearest, prepend=-1) > 1)
        assert not (status & SUSPECT).any()
        assert len(time) + summary.lost[sensor.name] == summary.frames


@pytest.mark.parametrize("seed", some(range(4), 1))
def test_frames_that_a_bad_line_loses_are_sent_again(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, seed: int
) -> None:
    array = an_array(A=0, G=1, B=None)
    bench = Bench(array, WORLD, drift=-1e-3)
    line = bench.delivered = BadLine(seed, 0.1)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", seconds=3)
    check_rows(bench, array, tmp_path / "r.h5", start_ns, summary)
    assert line.damaged > 20
    assert max(summary.lost.values()) <= 2  # three attempts were spoiled as well, or it was the last frame
    # An answer that was requested twice is refused as superfluous; data never is.
    refusals = [text for _, kind, text in events(tmp_path / "r.h5") if kind == "refused"]
    assert not [text for text in refusals if "old" in text or "no kind" in text or "connected" in text]


@pytest.mark.slow
@pytest.mark.parametrize("silent_s", some([0.5, 1.5], 1))
def test_an_interruption_of_the_line_loses_nothing(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, silent_s: float
) -> None:
    array = an_array(A=0, G=1)
    bench = Bench(array, WORLD, drift=1e-3)

    def dead(now: bool) -> None:
        bench.delivered = lambda piece: b"" if now else piece

    summary, start_ns = stream(
        bench,
        array,
        tmp_path / "r.h5",
        seconds=4,
        at={1.0: lambda: dead(True), 1.0 + silent_s: lambda: dead(False)},
    )
    check_rows(bench, array, tmp_path / "r.h5", start_ns, summary)
    assert set(summary.lost.values()) == {0}
    assert events(tmp_path / "r.h5") == []


@pytest.mark.slow
def test_frames_beyond_the_memory_are_lost_and_flagged(an_array: Callable[..., ArrayConfig], tmp_path: Path) -> None:
    """A frame of two sensors takes 15 + 1 + 2 (2 + 8) bytes and 4 more in the memory: 32 KB hold at most 819 of them,
    and fewer with the read-backs.
    """
    array = an_array(A=0, G=1)
    bench = Bench(array, WORLD)

    def dead(now: bool) -> None:
        bench.delivered = lambda piece: b"" if now else piece

    summary, start_ns = stream(
        bench, array, tmp_path / "r.h5", rate_hz=800, seconds=4, at={1.0: lambda: dead(True), 2.6: lambda: dead(False)}
    )
    check_rows(bench, array, tmp_path / "r.h5", start_ns, summary)
    time, _, status = logged(tmp_path / "r.h5", "A")
    assert np.flatnonzero(status & LOST).tolist() == [int(np.diff(time).argmax()) + 1]
    assert 1.6 - 819 / 800 < np.diff(time).max() / S < 1.6 - 0.6 * 819 / 800
    assert summary.lost["A"] == pytest.approx(np.diff(time).max() / S * 800, abs=3)


@pytest.mark.slow
def test_skipped_frames_are_seldom_requested_again(an_array: Callable[..., ArrayConfig], tmp_path: Path) -> None:
    array = an_array(A=0, G=1)
    bench = Bench(array, WORLD)
    asked = 0

    def slow(address: int, write: bytes) -> bool:
        if bench.now_ns() % (S // 2) < 8_000_000:
            bench.clock.advance(15_000_000)
        return False

    def heard(data: bytes) -> bytes:
        nonlocal asked
        asked += data[4] == 6
        return data

    bench.fails, bench.heard = slow, heard
    summary, _ = stream(bench, array, tmp_path / "r.h5", rate_hz=200, seconds=6)
    assert len(logged(tmp_path / "r.h5", "A")[0]) + summary.lost["A"] == summary.frames
    assert summary.lost["A"] > 20
    assert 1 <= asked < 20


class TestMissing:
    """Which frames are missing, of lists in every frame, every third, and every third from 2 on."""

    LISTS = (
        PollList(1, 0, (Request(0x53, b"\x30", 1),)),
        PollList(3, 0, (Request(0x53, b"\x30", 2),)),
        PollList(3, 2, (Request(0x53, b"\x30", 3),)),
    )
    PERIOD_US = 5000

    def frames(self, pairs: list[tuple[int, int]]) -> tuple[list[Frame], np.ndarray]:
        """DATA of (number, list)."""
        times = np.array([number * self.PERIOD_US + 300 * name for number, name in pairs], np.int64)
        frames = [
            Frame(DATA, number % 65536, int(at), bytes([name]) + bytes(2 + 1 + name))
            for (number, name), at in zip(pairs, times, strict=True)
        ]
        return frames, times

    def sent(self, first: int, end: int) -> list[tuple[int, int]]:
        """Number and list of all frames of the link between frame numbers."""
        return [
            (number, name)
            for number in range(first, end)
            for name, asked in enumerate(self.LISTS)
            if number % asked.every == asked.offset
        ]

    @pytest.mark.parametrize("first", [0, 1, 65_530])
    @pytest.mark.parametrize("seed", some(range(5), 1))
    def test_missing_frames_match_a_count(self, first: int, seed: int) -> None:
        from collections import Counter

        draw = np.random.default_rng(seed)
        admission = Admission(self.LISTS, self.PERIOD_US, 0, Counter())
        before, after = self.sent(0 if first < 2 else first - 9, first), self.sent(first, first + 20)
        if before:
            admission.admit(*self.frames(before))
        arrived = [pair for pair in after if draw.random() < 0.7]
        newest = max(arrived)
        begins = 0 if not before else first
        required = [pair for pair in self.sent(begins, first + 20) if pair <= newest and pair not in before]
        expected = sorted({number for number, name in required if (number, name) not in arrived})
        runs = admission.missing(*self.frames(arrived))
        assert [number for start, count in runs for number in range(start, start + count)] == expected

    def test_a_list_lost_in_the_newest_frame_is_reported_missing_later(self) -> None:
        from collections import Counter

        admission = Admission(self.LISTS, self.PERIOD_US, 0, Counter())
        assert admission.missing(*self.frames([(0, 0)])) == []
        admission.admit(*self.frames([(0, 0)]))
        assert admission.missing(*self.frames([(1, 0), (2, 0), (2, 2)])) == [(0, 1)]  # list 1 of frame 0
        admission.admit(*self.frames([(0, 1), (1, 0), (2, 0), (2, 2)]))
        assert admission.missing(*self.frames([(3, 1)])) == [(3, 1)]

"""Queues that a microcontroller drains by their own count (LSM6DSO, MPU-6050, MPU-6500), with failures of the line.

The world is a clock: the specific force along x is the share of the present second that has passed, so that each row
shows when its sample was taken; y and z are 0, so that bytes that were shifted show. A row is good if its time in the
log differs from that by no more than the log states.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.acquire import connect
from imuarray.acquire.recording import RecordingCounts
from imuarray.acquire.stream import streams
from imuarray.array import ArrayConfig, parse_array
from imuarray.log import open_log
from tests.acquire.clock_world import SPAN_G, ClockElement
from tests.acquire.streams import LOST, MS, OVERRUN, RECONFIGURED, SUSPECT, BadLine, S, events, stream
from tests.bus.serial_bench import Bench
from tests.firmware.kinds import both_kinds
from tests.selection import some

DIES = {  # place, rate, share by which the oscillator is fast
    "lsm6dso": ("address = 0x6A", 416, 0.01),
    "mpu6050": ("address = 0x68", 500, -0.01),
    "mpu6500": ('bus = "/dev/spidev0.1"', 1000, 0.0043),
}
EVERY_DIE = [pytest.param(die, marks=() if die == "lsm6dso" else pytest.mark.slow) for die in DIES]


def array_of(die: str, halves: tuple[str, ...] = ("acc", "gyro")) -> ArrayConfig:
    place, rate_hz, _ = DIES[die]
    text = '[array]\nname = "s"\n'
    for half in halves:
        text += f'[[sensor]]\nname = "{half}"\nchip = "{die}"\n{place}\nrange = {16 if half == "acc" else 500}\n'
        text += f"rate_hz = {rate_hz}\nfifo = true\n"
    return parse_array(text)


def bench_of(array: ArrayConfig, die: str, **firmware: Any) -> Bench:
    bench = Bench(array, selects=8, **firmware)
    chip: Any = bench.emulated.chips["acc"]
    chip._oscillator = 1 + DIES[die][2]
    chip._elements = {half: ClockElement() for half in chip._elements}
    return bench


def check(
    die: str, path: Path, start_ns: int, summary: RecordingCounts, *, sensors: tuple[str, ...] = ("acc", "gyro")
) -> int:
    """Each good row was sampled at its time, in order, once; gaps are flagged and counted. Returns the gaps."""
    period_ns = 1e9 / DIES[die][1] / (1 + DIES[die][2])
    gaps = 0
    with open_log(path) as log:
        for name in sensors:
            sensor = log[name]
            time_ns, counts, status = sensor.time[:], sensor.counts[:], np.asarray(sensor.status[:])
            assert sensor.time_uncertainty is not None
            stated_ns = 1e9 * np.asarray(sensor.time_uncertainty[:], float)
            good = (status & SUSPECT) == 0
            assert not counts[good, 1:].any()
            if name == "acc":  # a gyroscope of 500 dps is no clock: 16 g are
                share = counts[:, 0] / sensor.sensitivity / (SPAN_G * 0.999) + 0.5
                off_ns = ((time_ns - sensor.delay_ns + start_ns) * 1e-9 - share + 0.5) % 1.0 * 1e9 - 0.5e9
                step_ns = 1e9 / sensor.sensitivity / SPAN_G
                assert (np.abs(off_ns[good]) <= stated_ns[good] + step_ns).all()
                true_ns = time_ns - off_ns
                is_after_gap = np.diff(true_ns) > 1.5 * period_ns
                flagged = (status[1:] & (LOST | OVERRUN | RECONFIGURED)) != 0
                assert flagged[is_after_gap].all()
                missing = round(float(np.sum(np.rint(np.diff(true_ns) / period_ns) - 1)))
                gaps = int(is_after_gap.sum())
                assert summary.lost[name] == pytest.approx(
                    missing, abs=2 + 2 * gaps + 0.011 * missing
                )  # nominal period
                begins_ns = np.maximum.accumulate(np.where(np.append(True, is_after_gap), time_ns, 0))
                settled = good & (time_ns - begins_ns > 0.7 * S) & (time_ns > 2.5 * S)
                assert not settled.any() or np.sqrt(np.mean(off_ns[settled] ** 2)) < 0.1 * period_ns
    return gaps


@both_kinds()
@pytest.mark.slow
@pytest.mark.parametrize("die", EVERY_DIE)
def test_every_sample_is_logged_at_its_time(die: str, tmp_path: Path) -> None:
    array = array_of(die)
    bench = bench_of(array, die, drift=-2e-4)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=50, seconds=3)
    assert events(tmp_path / "r.h5") == []
    assert set(summary.lost.values()) == {0}
    assert check(die, tmp_path / "r.h5", start_ns, summary) == 0
    with open_log(tmp_path / "r.h5") as log:
        for sensor in log.sensors.values():
            assert len(sensor) > 3 * DIES[die][1] * (1 + DIES[die][2]) - 60
            assert not np.asarray(sensor.status[:]).any()


@pytest.mark.slow
@pytest.mark.parametrize(("die", "half"), [("lsm6dso", "acc"), ("mpu6050", "acc")])
def test_one_half_alone_is_streamed(die: str, half: str, tmp_path: Path) -> None:
    array = array_of(die, (half,))
    summary, start_ns = stream(bench_of(array, die), array, tmp_path / "r.h5", rate_hz=31, seconds=3)
    assert set(summary.lost.values()) == {0}
    check(die, tmp_path / "r.h5", start_ns, summary, sensors=(half,))


@both_kinds()
@pytest.mark.slow
@pytest.mark.parametrize("die", DIES)
@pytest.mark.parametrize("seed", some(range(4), 1, 0))
def test_a_bad_line_invents_no_samples(seed: int, die: str, tmp_path: Path) -> None:
    array = array_of(die)
    bench = bench_of(array, die, drift=-1e-3)
    line = bench.delivered = BadLine(seed, 0.03, repeats=True)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=50, seconds=4)
    assert line.damaged > 5
    gaps = check(die, tmp_path / "r.h5", start_ns, summary)
    assert (gaps > 0) == any(summary.lost.values())  # none where the firmware sends lost frames again


@both_kinds()
@pytest.mark.slow
@pytest.mark.parametrize("die", DIES)
@pytest.mark.parametrize("held_ms", some([15, 400], 1, 0))
def test_a_counted_queue_bridges_a_short_pause_of_the_microcontroller(held_ms: int, die: str, tmp_path: Path) -> None:
    """The queue bridges a short pause; after a long one the chip reports that it ran over."""
    array = array_of(die)
    bench = bench_of(array, die)
    held: list[int] = []

    def late(address: int, write: bytes, answer: bytes) -> bytes:
        if held and held.pop():
            bench.clock.advance(held_ms * MS)
        return answer

    bench.answered = late
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=50, seconds=6, at={2.0: lambda: held.append(1)})
    gaps = check(die, tmp_path / "r.h5", start_ns, summary)
    is_lost = held_ms > 100 and die != "lsm6dso"  # of 512 words, 0.58 s at this rate, none is lost
    assert (gaps > 0) == is_lost
    with open_log(tmp_path / "r.h5") as log:
        assert log["acc"].time[-1] > 5.5 * S


@both_kinds()
@pytest.mark.slow
@pytest.mark.parametrize("die", DIES)
@pytest.mark.parametrize("errno", some([121, 110], 1, 0))
def test_failed_transactions_give_no_wrong_rows(errno: int, die: str, tmp_path: Path) -> None:
    """No acknowledgement, or a clock that is held low, at intervals: within a drain, too."""
    array = array_of(die)
    bench = bench_of(array, die)
    draw = np.random.default_rng(1)
    begun: list[int] = []

    def fails(address: int, write: bytes) -> bool:
        return bool(begun) and draw.random() < 0.02

    transfer = bench.transfer

    def held(address: int, write: bytes = b"", read: int = 0) -> bytes:
        if errno == 110 and begun and draw.random() < 0.01:
            transfer(address, write, min(read, 5))  # a part is read, and is lost
            raise OSError(110, "held")
        return transfer(address, write, read)

    if errno == 121:
        bench.fails = fails
    else:
        bench.transfer = held  # type: ignore[method-assign]
    at: dict[float, Callable[[], Any]] = {1.0: lambda: begun.append(1), 4.0: begun.clear}
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=50, seconds=8, at=at)
    check(die, tmp_path / "r.h5", start_ns, summary)
    with open_log(tmp_path / "r.h5") as log:
        assert log["acc"].time[-1] > 7.5 * S


def test_queues_are_drained_by_the_host_where_the_firmware_cannot_count() -> None:
    array = array_of("lsm6dso")
    bench = Bench(array)  # reports no features
    with bench.bus() as bus:
        assert not streams(bus, connect(array, bus))

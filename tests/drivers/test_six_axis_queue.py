"""The one queue of a die and its two readers: delivery of samples, queues that ran over, interrupted transfers and
buses that return invalid bytes.

The world counts: the specific force along x rises by a step of 20 counts a millisecond, so that a missing, repeated or
shifted sample shows.
"""

from __future__ import annotations

import errno
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.board import Board
from firmware_emulator.chip import Triple
from imuarray.acquire.bus_segment import connect
from imuarray.acquire.sample_buffer import SensorRoute
from imuarray.array import parse_array
from imuarray.drivers import six_axis_queue
from imuarray.errors import ConfigError
from tests.selection import some

MS = 1_000_000
FINE = "icm42688 in 20 bits"
RATES_HZ = {"icm42688": 1000, FINE: 1000, "lsm6dso": 416, "mpu6050": 500, "mpu6500": 500, "mpu9250": 500}
ADDRESSES = {"icm42688": 0x68, FINE: 0x68, "lsm6dso": 0x6A, "mpu6050": 0x68, "mpu6500": 0x68, "mpu9250": 0x68}
DEPTH = {"icm42688": 128, FINE: 102, "lsm6dso": 250, "mpu6050": 73, "mpu6500": 36, "mpu9250": 36}
"""Samples that the queue holds: 2048 bytes of 16 or 20, 512 words of two halves and more, 1024 and 512 bytes of 14."""


class Counting:
    """Feels 20 counts a millisecond, from -30000 on."""

    def __init__(self, per_unit: float) -> None:
        self._per_unit = per_unit

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        codes = -30000 + 20 * at_ns / MS
        return codes / self._per_unit, 100 / self._per_unit, -100 / self._per_unit

    def temperature(self, at_ns: int) -> float:
        return 25.0

    def pressure(self, at_ns: int) -> float:
        return 101325.0


class CountingBoard(Board):
    def element(self, sensor: Any) -> Counting:
        return Counting(sensor.sensitivity)


class Bench:
    """Both halves of a die, or one, on a bus whose transfers may be made to fail."""

    def __init__(self, die: str, halves: str = "both", rate_hz: int = 0) -> None:
        text = '[array]\nname = "a"\n'
        for half, full_scale in (("acc", 16), ("gyro", 2000)) if die == FINE else (("acc", 4), ("gyro", 500)):
            if halves in ("both", half):
                chip = die.partition(" ")[0]
                text += f'[[sensor]]\nname = "{half}"\nchip = "{chip}"\naddress = {ADDRESSES[die]:#x}\nfifo = true\n'
                text += "high_resolution = true\n" if die == FINE else ""
                text += f"range = {full_scale}\nrate_hz = {rate_hz or RATES_HZ[die]}\n"
        self.bus: EmulatedBus = open_array(parse_array(text), board=CountingBoard)
        self.broken: Callable[[bytes, int], None] = lambda write, read: None
        wire = self.bus.wire.transfer

        def transfer(address: int, write: bytes = b"", read: int = 0) -> bytes:
            answer = wire(address, write, read)
            self.broken(write, read)
            return answer

        self.bus.transfer = transfer
        self.routes: list[SensorRoute] = connect(parse_array(text), self.bus)
        for route in self.routes:
            route.driver.fetch()

    def wait(self, ms: float) -> None:
        self.bus.clock.sleep_until(self.bus.clock.now_ns() + round(ms * MS))

    def fetch(self, number: int) -> tuple[np.ndarray, np.ndarray, bool]:
        """Counts (n, 3) and times of one half, and whether samples are missing before them."""
        driver: Any = self.routes[number].driver
        bursts = np.frombuffer(driver.fetch(), np.uint8).reshape(-1, driver.burst)
        decoded = driver.decode(bursts)
        assert len(bursts) == len(driver.queue.drained)
        assert not len(bursts) or (decoded.counts[:, 1] == 100).all()
        assert not decoded.status.any()
        return decoded.counts, np.array(driver.queue.drained), driver.queue.overrun and len(bursts) > 0


def steps(counts: np.ndarray, rate_hz: float) -> np.ndarray:
    """How many samples each row is after the one before."""
    return np.rint(np.diff(counts[:, 0].astype(int)) / (20e3 / rate_hz)).astype(int)


def test_each_bus_has_its_longest_read() -> None:
    """i2c-dev refuses more than 8192 bytes, spidev buffers 4096, a frame of the link holds 1024 (LNX-05, LNX-52)."""
    assert six_axis_queue.LONGEST_READS == {"i2c:": 8192, "spi:": 4095, "serial:": 1023}
    assert six_axis_queue.LONGEST_READ == 1023


@pytest.mark.parametrize("longest", [20, 61, 1023, 8192])
@pytest.mark.parametrize("die", RATES_HZ)
def test_a_queue_is_read_in_whole_samples_within_the_limit_of_the_bus(
    die: str, longest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(six_axis_queue, "LONGEST_READ", longest)
    bench = Bench(die, "both")
    reads: list[int] = []
    bench.broken = lambda write, read: reads.append(read)
    bench.wait(40)
    rows, _, gap = bench.fetch(0)
    assert max(reads) <= longest
    assert not gap
    assert len(rows) >= 0.04 * RATES_HZ[die] - 2
    assert set(steps(rows, RATES_HZ[die])) == {1}


@pytest.mark.parametrize(("die", "halves"), some(product(RATES_HZ, ["both", "acc", "gyro"]), 3))
def test_every_sample_is_delivered_once_to_each_half(die: str, halves: str) -> None:
    bench = Bench(die, halves)
    counts: list[list[np.ndarray]] = [[] for _ in bench.routes]
    for visit in range(60):
        bench.wait(3 + visit * 7 % 20)
        for number in range(len(bench.routes)):
            rows, times, gap = bench.fetch(number)
            assert not gap
            assert (np.diff(times) > 0).all()
            counts[number].append(rows)
    for rows in map(np.concatenate, counts):
        assert len(rows) > 200
        assert set(steps(rows, RATES_HZ[die]).tolist()) == {1}


@pytest.mark.parametrize(
    ("die", "rate_hz"), [("icm42688", 200), ("icm42688", 25), (FINE, 500), ("lsm6dso", 104), ("mpu6500", 250)]
)
def test_every_sample_is_delivered_at_other_data_rates(die: str, rate_hz: int) -> None:
    bench = Bench(die, rate_hz=rate_hz)
    rows, begun_ns = [], bench.bus.clock.now_ns()
    for _ in range(40):
        bench.wait(24)
        for number in (0, 1):
            counts, _, gap = bench.fetch(number)
            assert not gap
            if number:
                rows.append(counts)
    assert set(steps(np.concatenate(rows), rate_hz).tolist()) == {1}
    assert sum(map(len, rows)) == pytest.approx((bench.bus.clock.now_ns() - begun_ns) * 1e-9 * rate_hz, rel=0.05, abs=2)


@pytest.mark.parametrize("die", some(RATES_HZ, 2))
def test_a_queue_that_ran_over_is_flagged_and_its_rows_are_whole(die: str) -> None:
    bench = Bench(die)
    for _ in range(40):
        bench.wait(10)
        first = [bench.fetch(number) for number in (0, 1)]
    last_ns = [times[-1] for _, times, _ in first]
    bench.wait(2.5 * DEPTH[die] * 1000 / RATES_HZ[die])
    after: list[list[Any]] = [[], []]
    for _ in range(8):
        for number in (0, 1):
            after[number].append(bench.fetch(number))
        bench.wait(10)
    for number in (0, 1):
        batches = [piece for piece in after[number] if len(piece[0])]
        assert batches[0][2]
        assert not any(gap for _, _, gap in batches[2:])  # the LSM6DSO loses more while the first words are read
        rows = np.concatenate([counts for counts, _, _ in batches])
        assert set(steps(rows, RATES_HZ[die]).tolist()) == {1}
        times = np.concatenate([times for _, times, _ in batches])
        assert times[0] > last_ns[number]
        felt_ns = (rows[:, 0].astype(float) + 30000) / 20 * MS
        taken_ns = felt_ns + (bench.routes[number].header.delay_ns or 0)  # the filter shows an earlier input
        assert np.abs(times - taken_ns).max() < 1.2e9 / RATES_HZ[die]


@pytest.mark.parametrize("die", RATES_HZ)
def test_an_interrupted_drain_is_flagged_as_a_gap(die: str) -> None:
    """The bytes have left the chip; which samples they held is unknown."""
    bench = Bench(die)
    for number in (0, 1):
        bench.wait(20)
        bench.fetch(number)

    def break_off(write: bytes, read: int) -> None:
        if read > 20:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")

    bench.broken = break_off
    bench.wait(30)
    with pytest.raises(OSError, match="Remote I/O"):
        bench.fetch(0)
    bench.broken = lambda write, read: None
    pieces = []
    for _ in range(6):
        bench.wait(20)
        pieces.append([bench.fetch(number) for number in (0, 1)])
    for number in (0, 1):
        batches = [piece[number] for piece in pieces if len(piece[number][0])]
        assert batches[0][2]
        assert not any(gap for _, _, gap in batches[1:])
        assert set(steps(np.concatenate([counts for counts, _, _ in batches]), RATES_HZ[die]).tolist()) == {1}


@pytest.mark.parametrize("die", RATES_HZ)
def test_an_undriven_bus_gives_an_error_and_no_rows(die: str) -> None:
    """On SPI a chip without supply reads ff or 00."""
    bench = Bench(die)
    bench.wait(20)
    inner = bench.bus.transfer
    bench.routes[0].driver.registers.bus.transfer = lambda address, write=b"", read=0: b"\xff" * read  # type: ignore[method-assign]
    with pytest.raises(OSError, match=r"its queue reports .* and holds"):
        bench.fetch(0)
    bench.routes[0].driver.registers.bus.transfer = lambda address, write=b"", read=0: bytes(read)  # type: ignore[method-assign]
    for _ in range(3):
        assert len(bench.fetch(0)[0]) == 0
    bench.bus.transfer = inner


@pytest.mark.parametrize("die", RATES_HZ)
def test_setting_up_a_half_again_flags_a_gap_in_the_other(die: str) -> None:
    bench = Bench(die)
    for _ in range(3):
        bench.wait(20)
        for number in (0, 1):
            bench.fetch(number)
    bench.routes[1].driver.configure()
    bench.wait(20)
    (_, _, first), (rows, _, second) = bench.fetch(0), bench.fetch(1)
    assert first
    assert not second
    assert len(rows)


def test_rows_of_an_unread_half_are_kept_up_to_a_limit_and_then_flagged_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imuarray.drivers.six_axis_queue.MOST_ROWS", 200)
    bench = Bench("icm42688")
    seen = 0
    for _ in range(10):
        bench.wait(50)
        seen += len(bench.fetch(0)[0])
    rows, _, gap = bench.fetch(1)
    assert gap
    assert len(rows) < seen
    assert set(steps(rows, 1000).tolist()) == {1}


@pytest.mark.parametrize(
    ("die", "packet"),
    [
        ("icm42688", b"\xff" + bytes(15)),
        (FINE, b"\xff" + bytes(19)),
        ("icm42688", b"\x40" + bytes(7)),
        ("icm42688", b"\x78" + bytes(19)),
        (FINE, b"\x68" + bytes(15)),
        (FINE, b"\x20" + bytes(7)),
    ],
)
def test_a_packet_of_another_kind_is_discarded(die: str, packet: bytes) -> None:
    """TDK-81: an empty queue, and one with packets of 8, 16 and 20 bytes, after which the others are shifted."""
    bench = Bench(die)
    bench.wait(20)
    chip: Any = bench.bus.chips["acc"]
    for number in (0, 1):
        bench.fetch(number)
    bench.wait(20)
    chip._sync(bench.bus.clock.now_ns())
    chip._packets.insert(5, packet)
    assert len(bench.fetch(0)[0]) == 0
    for _ in range(2):
        bench.wait(20)
        rows, _, gap = bench.fetch(0)
    assert gap
    assert set(steps(rows, 1000).tolist()) == {1}


@pytest.mark.parametrize("die", ["icm42688", FINE])
def test_a_lost_packet_shows_in_the_time_stamps(die: str) -> None:
    bench = Bench(die)
    for _ in range(3):
        bench.wait(20)
        for number in (0, 1):
            bench.fetch(number)
    bench.wait(20)
    chip: Any = bench.bus.chips["acc"]
    chip._sync(bench.bus.clock.now_ns())
    chip._packets.popleft()
    rows, _, gap = bench.fetch(0)
    assert gap
    assert set(steps(rows, 1000).tolist()) == {1}


@pytest.mark.parametrize("die", ["icm42688", FINE])
@pytest.mark.parametrize("halves", ["both", "acc", "gyro"])
def test_no_sample_from_before_a_flush_is_delivered(die: str, halves: str) -> None:
    """TDK-84: the count of 0 that follows a flush belongs to no drain, and no sample from before it is delivered."""
    bench = Bench(die, halves)
    bench.wait(20)
    bench.routes[0].driver.configure()  # which empties the queue as its last step
    flushed_ns = bench.bus.clock.now_ns()
    bench.wait(10)
    rows, times, _ = bench.fetch(0)
    taken_ns = (rows[:, 0].astype(float) + 30000) / 20 * MS
    assert flushed_ns - 1.1e6 < taken_ns[0] < flushed_ns + 1.1e6
    assert len(rows) == pytest.approx(10, abs=1)
    assert np.abs(times - taken_ns).max() < 1.2 * MS


def test_both_halves_must_agree_on_a_queue() -> None:
    text = '[array]\nname = "a"\n'
    for half, full_scale, keys in (("acc", 4, "fifo = true\n"), ("gyro", 500, "")):
        text += f'[[sensor]]\nname = "{half}"\nchip = "icm42688"\naddress = 0x68\nrange = {full_scale}\n{keys}'
    with pytest.raises(ConfigError, match="are one icm42688: fifo is the same for both"):
        parse_array(text)

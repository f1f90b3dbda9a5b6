"""Eight ICM-42688-P at 1 kHz over SPI, their queues drained: samples lost, bus time, and processor time for a sample.

The bus time is counted on the emulated chip selects at 24 MHz, configuration checks included; its limit are the bits of
the packets alone. The processor time is that of `record` (drain, times, decoding, checks, log on the disk), with chips
that only hand out bytes made before, so that it is not the emulator's; a sample is a row of one sensor. It is given for
the recording, and with the log compressed and checked at its end.
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from compare import Row, row

from firmware_emulator.array import open_array
from firmware_emulator.clock import VirtualClock
from imuarray.acquire import record
from imuarray.array import load_array
from imuarray.log import open_log

CONFIG = Path(__file__).parents[2] / "configs" / "icm42688x8.toml"
FRAMES_PER_S = 20.0
CHIPS, RATE_HZ, PACKET, CLOCK_HZ = 8, 1000, 16, 24_000_000


class CannedPort:
    """A chip select of which the registers keep what is written and the queue fills by the clock."""

    def __init__(self, clock: VirtualClock, packets: bytes) -> None:
        self._clock, self._packets = clock, packets
        self._banks = [bytearray(128) for _ in range(8)]
        self._bank = 0
        self._taken = 0
        self._banks[0][0x75] = 0x47
        self.spent_s = 0.0

    def exchange(self, sent: bytes) -> bytes:
        """As a chip would."""
        begun_s = time.process_time()
        answer = self._answer(sent)
        self.spent_s += time.process_time() - begun_s
        return answer

    def _answer(self, sent: bytes) -> bytes:
        first, register = sent[0], sent[0] & 0x7F
        if not first & 0x80:
            if register == 0x76:
                self._bank = sent[1] & 7
            elif register == 0x4B:
                self._taken = self._now()
            else:
                self._banks[self._bank][register] = sent[1]
            return sent
        if register == 0x76:
            return bytes([0xFF, self._bank])
        if register == 0x2D:
            waiting = min(self._now() - self._taken, 128) * PACKET
            return bytes([0xFF, 8, waiting >> 8, waiting & 0xFF])
        if register == 0x30:
            count = (len(sent) - 1) // PACKET
            start = self._taken % 65536
            self._taken += count
            return b"\xff" + self._packets[start * PACKET : (start + count) * PACKET]
        return b"\xff" + bytes(self._banks[self._bank][register : register + len(sent) - 1])

    def _now(self) -> int:
        return self._clock.now_ns() // 1_000_000


class CannedBus:
    """An open bus of such chip selects."""

    source = "spi"

    def __init__(self) -> None:
        self.clock: Any = VirtualClock()
        noise = np.random.default_rng(1).integers(-100, 100, (65536 + 4096, 6)).astype(">i2").view(np.uint8)
        table = np.zeros((len(noise), PACKET), np.uint8)
        table[:, 0] = 0x68
        table[:, 1:13] = noise.reshape(-1, 12)
        stamps = (np.arange(len(noise)) % 65536 * 1000 % 65536).astype(">u2")
        table[:, 14:16] = stamps.view(np.uint8).reshape(-1, 2)
        self._packets = table.tobytes()
        self.ports: list[CannedPort] = []

    def spi_port(self, path: str, mode: int, clock_hz: int) -> CannedPort:
        """Another chip."""
        self.ports.append(CannedPort(self.clock, self._packets))
        return self.ports[-1]

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Nobody is on the trunk."""
        raise OSError(6, "no such device or address")


def processor_us(seconds: float) -> tuple[float, float]:
    """Microseconds of processor for a row: while it is recorded, and with the log compressed and checked at the end."""
    array, bus = load_array(CONFIG), CannedBus()
    marks_s: list[float] = []

    def mark(*_: Any) -> None:
        marks_s.append(time.process_time() - sum(port.spent_s for port in bus.ports))

    with TemporaryDirectory() as folder:
        record(
            array,
            bus,  # type: ignore[arg-type]
            Path(folder) / "run.h5",
            rate_hz=FRAMES_PER_S,
            seconds=seconds,
            on_headers=mark,
            progress=mark,
        )
        recorded_s = marks_s[-1] - marks_s[0]
        mark()
        with open_log(Path(folder) / "run.h5") as log:
            rows_ = sum(len(sensor.time) for sensor in log.sensors.values())
            flagged = sum(int(np.count_nonzero(sensor.status[:])) for sensor in log.sensors.values())
    if flagged:
        raise RuntimeError(f"{flagged} rows of canned chips are flagged")
    return recorded_s * 1e6 / rows_, (marks_s[-1] - marks_s[0]) * 1e6 / rows_


def bus_share(seconds: float) -> tuple[float, int]:
    """Share of the time in which one of the chips is selected, and samples that are missing or flagged."""
    array = load_array(CONFIG)
    with TemporaryDirectory() as folder, open_array(array) as bus:
        before: list[int] = []
        record(
            array,
            bus,
            Path(folder) / "run.h5",
            rate_hz=FRAMES_PER_S,
            seconds=seconds,
            on_headers=lambda *_: before.append(sum(select.busy_ns for select in bus.selects.values())),
        )
        busy_ns = sum(select.busy_ns for select in bus.selects.values()) - before[0]
        missing = 0
        with open_log(Path(folder) / "run.h5") as log:
            for sensor in log.sensors.values():
                steps = np.diff(np.asarray(sensor.time[:]))
                missing += int(np.count_nonzero(sensor.status[:])) + int(np.sum(np.rint(steps / 1e6) - 1))
                missing += int(len(sensor.time) < (seconds - 2 / FRAMES_PER_S) * RATE_HZ)
    return busy_ns / (seconds * 1e9), missing


def rows() -> list[Row]:
    """Bus time beside its limit, samples lost, and processor time."""
    limit = CHIPS * RATE_HZ * PACKET * 8 / CLOCK_HZ
    share, missing = bus_share(10.0)
    recording, finished = processor_us(60.0)
    return [
        row("share of bus time of eight ICM-42688-P at 1 kHz on SPI", share, limit, "of the time", 1.1, "lower"),
        row("samples of them lost or flagged in 10 s, plus one", missing + 1.0, 1.0, "samples", 1.0, "lower"),
        row("processor time of a row of them while recording", recording, 3.0, "us", 1.0, "lower"),
        row("processor time of a row of them, with the log compressed", finished, 6.0, "us", 1.0, "lower"),
    ]


if __name__ == "__main__":
    for line in rows():
        print(line)

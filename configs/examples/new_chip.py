"""A whole new chip on one page: an LIS3DH accelerometer (ST data sheet Doc ID 17530, application note AN3308).

It has six parts; a comment names the file where each part belongs. `python configs/examples/new_chip.py` checks the
driver against the golden conversation.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import ClassVar, cast

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.chips import ChipSpec
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes, ChipDriver, DecodedBursts, SelfTest, flag_bits, flag_saturated, words16
from imuarray.facts.registers import Register
from imuarray.log.format import OVERRUN, STALE

# 1. imuarray/facts/lis3dh.py: what the data sheet prints, nothing else. The emulated chip shares it.
ADDRESSES = (0x18, 0x19)  # SA0 low, high
WHO_AM_I = Register(0x0F, "r", reset=0x33)
CTRL_1 = Register(0x20, reset=0x07)
CTRL_4 = Register(0x23)
STATUS = Register(0x27, "r")  # one burst from here on: status, then X, Y, Z, low byte first
RATE, AXES_ON = CTRL_1[7:4], CTRL_1[2:0]
BLOCK_UPDATE, FULL_SCALE, HIGH_RESOLUTION = CTRL_4[7], CTRL_4[5:4], CTRL_4[3]
AUTO_INCREMENT = 0x80  # the top bit of the sub-address

# 2. imuarray/chips.py: what a configuration may ask of it, and what a count means. 12 bits at the top of 16; the data
# sheet's typical 1, 2, 4 and 12 mg a digit.
SPEC = ChipSpec(
    quantity="specific_force",
    addresses=ADDRESSES,
    identity=WHO_AM_I,
    label="LIS{}",
    burst_bytes=7,
    sensitivity={2.0: 1000.0, 4.0: 500.0, 8.0: 250.0, 16.0: 1000 / 12},
    rates_hz=(1.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0),
    default_rate_hz=400.0,
    proposed={"range": 4, "rate_hz": 400},
)


# 3. imuarray/drivers/lis3dh.py
class Lis3dh(ChipDriver):
    """Driver of one LIS3DH in its high-resolution mode."""

    burst: ClassVar[int] = 7
    reading: ClassVar[slice] = slice(1, 7)
    has_data_ready: ClassVar[bool] = True

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.watched = (
            RATE(1 + sensor.spec.rates_hz.index(sensor.chip_rate_hz)) | AXES_ON(0b111),
            BLOCK_UPDATE(1) | FULL_SCALE(list(sensor.spec.sensitivity).index(sensor.range or 2.0)) | HIGH_RESOLUTION(1),
        )

    def steps(self) -> Iterator[float]:
        """Write rate and range, and read them back."""
        yield from self.registers.set_step_by_step(*self.watched)

    def self_test(self) -> SelfTest:
        """Return that there is none."""
        return SelfTest(None, "this driver has no self-test")

    def fetch(self) -> bytes:
        """Read the status and the three axes in one burst."""
        return self.registers.bus.transfer(self.registers.address, bytes([STATUS.address | AUTO_INCREMENT]), self.burst)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 12 bits; stale without ZYXDA (bit 3), overrun with ZYXOR (bit 7)."""
        counts = words16(bursts[:, self.reading]) >> 4
        fresh = flag_bits(~bursts[:, 0], 0x08, STALE) | flag_bits(bursts[:, 0], 0x80, OVERRUN)
        return DecodedBursts(counts, None, fresh | flag_saturated(counts, -2048, 2047))


# 4. One line each: "lis3dh": SPEC in imuarray.chips.CHIPS, by which `detect` recognises the chip, and "lis3dh": Lis3dh
#    in imuarray.drivers.DRIVERS.
# 5. firmware_emulator/chips/lis3dh.py: the emulated chip, written from the data sheet and not from the driver. It is
#    not part of this example; firmware_emulator/chips/lis3mdl.py is a short one.

# 6. tests/golden/lis3dh_*.jsonl, best written by somebody else than the author of the facts: bytes written, bytes read,
#    source.
GOLDEN = (
    ("0f", "33", "WHO_AM_I"),
    ("2077", "", "400 Hz is code 7, all axes on"),
    ("20", "77", "what was written is there"),
    ("2388", "", "whole readings only, 2 g, high resolution"),
    ("23", "88", ""),
    ("a7", "08e01520ea0000", "AN3308, table of outputs at 2 g: 350 mg is E0 15, -350 mg is 20 EA, 0 is 00 00"),
)


class Conversation:
    """A bus that expects these transactions, in this order."""

    def __init__(self, lines: tuple[tuple[str, str, str], ...]) -> None:
        self.lines = list(lines)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Return the next answer; ValueError if this is not the next transaction."""
        asked, answer, source = self.lines.pop(0)
        if (address, write.hex(), read) != (0x18, asked, len(answer) // 2):
            raise ValueError(f"{address:#x} got {write.hex()} for {read} bytes; expected is {asked} ({source})")
        return bytes.fromhex(answer)


class Now:
    """A clock that stands still."""

    def now_ns(self) -> int:
        """Return 0."""
        return 0

    def sleep_until(self, at_ns: int) -> None:
        """Return at once."""


def main() -> list[float]:
    """Identify, configure, fetch and decode; return the reading (3,) in g."""
    place = {"name": "A", "chip": "lis3dh", "place": "trunk address 0x18", "address": 0x18}
    # SensorConfig, once the chip is in CHIPS
    sensor = SimpleNamespace(spec=SPEC, **place, range=2.0, chip_rate_hz=400.0)
    bus = Conversation(GOLDEN)
    driver = Lis3dh(bus, cast(SensorConfig, sensor), Now())
    driver.identify()
    driver.configure()
    decoded = driver.decode(np.frombuffer(driver.fetch(), np.uint8).reshape(1, driver.burst))
    if bus.lines:
        raise ValueError(f"expected transactions that did not happen: {bus.lines}")
    reading: list[float] = (decoded.counts[0] / SPEC.sensitivity[2.0]).tolist()
    return reading


if __name__ == "__main__":
    x, y, z = main()
    print(f"The driver reproduces the golden conversation; its burst reads x {x:+.2f} g, y {y:+.2f} g, z {z:+.2f} g.")

"""An emulated chip select: the bytes of one transfer in both directions, and their duration.

A transfer consists of select, eight clocks for each byte without a gap, and release. The first byte is the command: bit
7 requests a read, the rest is a register's address, in which some chips use one bit to request auto-increment. The chip
sends nothing during that byte and while it is written to. If the clock is too fast for the chip, or the mode is not
supported, each byte of an answer is late by one bit, and written bytes have no effect (DEC-110).
"""

from __future__ import annotations

from typing import NamedTuple

from firmware_emulator.chip import Target
from firmware_emulator.wire import Wire

READ = 0x80
SELECT_NS, RELEASE_NS = 50, 150
"""Time from the select to the first clock, and from the last clock to the next select: the data sheets require less
(DEC-110).
"""
OPEN_LINE = 0xFF
"""Byte that is read if no chip drives the line, which has a pull-up."""


class Dialect(NamedTuple):
    """A chip's SPI protocol: the meaning of the first byte, the fastest clock, and the modes.

    `counts_on`: the bit that requests auto-increment (0: it always increments); `on_i2c`: the same on I2C.
    """

    clock_hz: int
    counts_on: int = 0
    on_i2c: int = 0
    modes: tuple[int, ...] = (0, 3)


_INVENSENSE = Dialect(1_000_000)  # INV-95
_ICM42688 = Dialect(24_000_000)  # TDK-70
_LSM6DSO = Dialect(10_000_000)  # LSM-70

DIALECTS: dict[str, Dialect] = {
    "adxl345": Dialect(5_000_000, 0x40, modes=(3,)),  # ADX-80
    "bma180": Dialect(10_000_000, modes=(3,)),  # BMA-130
    "l3g4200d": Dialect(10_000_000, 0x40, 0x80, modes=(3,)),  # L3G-80
    **{f"{die}_{half}": _INVENSENSE for die in ("mpu6500", "mpu9250") for half in ("acc", "gyro")},
    **{f"icm42688_{half}": _ICM42688 for half in ("acc", "gyro")},
    **{f"lsm6dso_{half}": _LSM6DSO for half in ("acc", "gyro")},
}
"""Protocols by the name of the chip in configurations."""


class ChipSelect:
    """One chip select of a controller; `wire` has the clock and the faults of the host, `device` is the chip.

    `clocks` and `transfers` count the traffic, `busy_ns` is the total time during which the chip was selected.
    """

    def __init__(self, wire: Wire, device: Target, dialect: Dialect) -> None:
        self.wire = wire
        self.device = device
        self._dialect = dialect
        self.clocks = self.transfers = self.busy_ns = 0

    def port(self, mode: int, clock_hz: int) -> ChipSelectPort:
        """Return the chip select with this clock and mode; ValueError if no controller supports them."""
        if mode not in range(4) or clock_hz <= 0:
            raise ValueError(f"SPI mode {mode}, {clock_hz} Hz: allowed are modes 0 to 3 and clocks above 0")
        return ChipSelectPort(self, clock_hz, mode in self._dialect.modes and clock_hz <= self._dialect.clock_hz)

    def exchange(self, sent: bytes, clock_hz: int, understood: bool) -> bytes:
        """Send bytes; return the bytes received during that time."""
        if not sent:
            raise ValueError("an SPI transfer of no bytes")
        wire = self.wire
        wire.delay()
        if wire.interference is not None:
            wire.interference(wire, (self.device,))
        begun_ns, byte_ns, count = wire.clock.now_ns() + wire.host_ns, 8e9 / clock_hz, len(sent)
        first_ns = begun_ns + SELECT_NS + round(byte_ns)
        answer = self._answer(sent, first_ns, round(byte_ns), understood)
        lasted_ns = SELECT_NS + round(count * byte_ns) + RELEASE_NS
        self.device.stop(begun_ns + lasted_ns)
        self.clocks += 8 * count
        self.transfers += 1
        self.busy_ns += lasted_ns
        wire.clock.advance(wire.host_ns + lasted_ns)
        return answer

    def _answer(self, sent: bytes, first_ns: int, byte_ns: int, understood: bool) -> bytes:
        first, data, dialect = sent[0], sent[1:], self._dialect
        register = first & ~(READ | dialect.counts_on) & 0xFF
        repeats = dialect.counts_on and not first & dialect.counts_on
        start = bytes([register if repeats else register | dialect.on_i2c])
        idle = bytes([OPEN_LINE]) * len(sent)
        if not first & READ:
            if understood:
                for value in data if repeats else ():
                    self.device.write(start + bytes([value]), first_ns, byte_ns)
                if not repeats:
                    self.device.write(start + data, first_ns, byte_ns)
            return idle
        pieces = [1] * len(data) if repeats else [len(data)]
        received = b""
        for count in pieces if data else ():
            if self.device.write(start, first_ns, byte_ns) < 1:  # no chip answers
                return idle
            received += self.device.read(count, first_ns, byte_ns)
        if not understood:
            received = (int.from_bytes(received, "big") >> 1).to_bytes(len(received), "big")
        return idle[:1] + received


class ChipSelectPort:
    """A chip select with a clock and a mode; `understood` is true if the chip supports both."""

    def __init__(self, select: ChipSelect, clock_hz: int, understood: bool) -> None:
        self._select = select
        self._clock_hz = clock_hz
        self._understood = understood

    def exchange(self, sent: bytes) -> bytes:
        """Send bytes while the chip is selected; return the same number of received bytes."""
        return self._select.exchange(sent, self._clock_hz, self._understood)

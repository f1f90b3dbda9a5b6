"""L3G4200D gyroscope. ST data sheet Doc ID 17116 Rev 3 (2010); facts L3G-*.

Bit 7 of the register address makes it count on (L3G-03). BDU keeps the two bytes of an axis together (L3G-50). The
bandwidth bits act only where Out_Sel routes the data through the second low-pass (L3G-36, L3G-37). One burst carries
temperature, status and the triad, 0x26 ... 0x2D."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock, sleep_for
from imuarray.drivers.driver import Bytes, Decoded, registers_for, saturated
from imuarray.facts import l3g4200d as facts
from imuarray.log.format import STALE

_COUNT_ON = 0x80  # sub-address bit 7: L3G-03
_RATE_CODES = {100.0: 0b00, 200.0: 0b01, 400.0: 0b10, 800.0: 0b11}  # L3G-30 ... L3G-33
_RANGE_CODES = {250.0: 0b00, 500.0: 0b01, 2000.0: 0b10}  # L3G-40 ... L3G-42
_TURN_ON_S = 0.3  # from power-down; not in the data sheet: L3G-65


class L3g4200d:
    """Driver of one L3G4200D."""

    burst: ClassVar[int] = 8
    tells_fresh: ClassVar[bool] = True

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        self.registers = registers_for(sensor, bus)
        self.clock = clock
        bandwidths = sensor.spec.allowed_bandwidths_hz(sensor.chip_rate_hz)
        # At 100 Hz three of the four codes mean 25 Hz; the first will do.
        bandwidth_code = bandwidths.index(sensor.chip_bandwidth_hz) if sensor.chip_bandwidth_hz in bandwidths else 0
        self.power = (
            facts.DATA_RATE(_RATE_CODES[sensor.chip_rate_hz])
            | facts.BANDWIDTH(bandwidth_code)
            | facts.POWER_ON(1)
            | facts.AXES_ON(0b111)
        )
        self.settings = (
            facts.HIGH_PASS_MODE(0) | facts.HIGH_PASS_CUTOFF(0),
            facts.CTRL_REG3[7:0](0),
            facts.BLOCK_DATA_UPDATE(1)
            | facts.BIG_ENDIAN(0)
            | facts.FULL_SCALE(_RANGE_CODES[sensor.range or 250.0])
            | facts.SELF_TEST(0),
            facts.FIFO_EN(0) | facts.HIGH_PASS_EN(0) | facts.OUT_SELECT(0b10),
            facts.FIFO_MODE(0b000) | facts.FIFO_WATERMARK(0),
        )

    def identify(self) -> None:
        """WHO_AM_I is 0xD3 (L3G-10)."""
        self.registers.expect(facts.WHO_AM_I)

    def configure(self) -> None:
        """There is no reset: every control register is written, then the power bit; wait out the turn-on."""
        for setting in (*self.settings, self.power):
            self.registers.poke(setting.register, setting.value)
            self.registers.verify(setting)
        sleep_for(self.clock, _TURN_ON_S)

    def fetch(self) -> bytes:
        """0x26 ... 0x2D with the count-on bit: temperature, status, x, y, z."""
        return self.registers.bus.transfer(
            self.registers.address, bytes([facts.OUT_TEMP.address | _COUNT_ON]), self.burst
        )

    def decode(self, bursts: Bytes) -> Decoded:
        """Counts of 16 bits, low byte first; temperature falls by one count per degC (L3G-60); stale where ZYXDA was
        clear.
        """
        counts = np.ascontiguousarray(bursts[:, 2:8]).view("<i2").astype(np.int16)
        fresh = bursts[:, 1] & facts.ZYX_AVAILABLE.mask
        status = saturated(counts, -32768, 32767) | np.where(fresh, 0, STALE).astype(np.uint16)
        return Decoded(counts, bursts[:, 0].view(np.int8).astype(np.int16), status)

    def header(self) -> Mapping[str, int]:
        """Nothing of its own."""
        return {}

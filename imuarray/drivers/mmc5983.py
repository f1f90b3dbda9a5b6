"""MMC5983MA magnetometer. MEMSIC data sheet Rev A (2019); facts MMC-*.

Counts have 18 bits, unsigned, 131072 at no field (MMC-11). The control registers can't be read (MMC-12): a setting is
never verified, and a chip that lost its settings is detected only by its readings, which then no longer change.
Therefore the set-up takes one reading after a SET and one after a RESET, both of which must be completed in time; a
log's header contains their mean, the output of the bridges without a field (MMC-14), in counts. Counts are those after
a SET.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np

from imuarray.array import SensorConfig
from imuarray.arrays import Floats
from imuarray.bus.protocol import Bus
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes, ChipDriver, DecodedBursts, SelfTest, flag_saturated
from imuarray.errors import SensorError
from imuarray.facts import mmc5983 as facts
from imuarray.facts.registers import Register, Setting

_ZERO = 1 << 17  # MMC-11
_HIGHEST = (1 << 18) - 1
_RESET_S = 0.010  # MMC-15
_COIL_S = 0.001  # MMC-14: 500 ns, and the time of the coil's capacitor
_MEASURED_S = {100.0: 0.008, 200.0: 0.004, 400.0: 0.002, 800.0: 0.0005}  # by bandwidth: MMC-13
_MARGIN_S = 0.001
_BANDWIDTHS_HZ = tuple(_MEASURED_S)
_PERIODIC_SET = 0b011  # after 100 readings: MMC-16
_FIELD_GAUSS = (0.05, 4.0)
"""Least and largest field strength in gauss for the self-test, half the difference between SET and RESET: the earth's
field is 0.25 to 0.65 gauss, and iron nearby adds to it.
"""
_BRIDGE_GAUSS = 1.0  # MMC-20: within 0.5 gauss, typically


class Mmc5983(ChipDriver):
    """Driver of one MMC5983MA."""

    burst: ClassVar[int] = 7
    first: ClassVar[Register] = facts.X_OUT_0  # the high sixteen bits of each axis, then the low two of all
    reading: ClassVar[slice] = slice(0, 7)
    has_data_ready: ClassVar[bool] = False  # the done bit stays set until it is cleared: MMC-17

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        super().__init__(bus, sensor, clock)
        self.rate_hz = sensor.chip_rate_hz
        self.sensitivity = sensor.spec.sensitivity[8.0]
        bandwidth_hz = sensor.chip_bandwidth_hz
        self._measured_s = _MEASURED_S[bandwidth_hz] + _MARGIN_S
        self._bandwidth = (
            facts.SOFT_RESET(0) | facts.YZ_OFF(0) | facts.X_OFF(0) | facts.BANDWIDTH(_BANDWIDTHS_HZ.index(bandwidth_hz))
        )
        self._continuous = (
            facts.PERIODIC_SET_ON(1)
            | facts.PERIODIC_SET(_PERIODIC_SET)
            | facts.CONTINUOUS(1)
            | facts.FREQUENCY(1 + sensor.spec.rates_hz.index(self.rate_hz))  # codes count up: MMC-16
        )
        self._bridge = self._flipped = np.zeros(3)

    def steps(self) -> Iterator[float]:
        """Reset, take a reading after a RESET and one after a SET, then start continuous readings; SensorError if one
        of the two is not completed in time.
        """
        self.registers.poke(facts.CONTROL_1, facts.SOFT_RESET(1).value)
        yield _RESET_S
        self._poke(self._bandwidth)
        self._poke(facts.CONTROL_3[7:0](0))
        readings = []
        for coil in (facts.RESET_COIL(1), facts.SET_COIL(1)):
            self._poke(coil)
            yield _COIL_S
            self._poke(facts.TAKE_FIELD(1))
            yield self._measured_s
            if not facts.FIELD_DONE.of(self.registers.peek(facts.STATUS)[0]):
                raise SensorError(
                    f"{self.registers.label}: a measurement is not done after {self._measured_s * 1e3:g} ms"
                )
            readings.append(_counts(np.frombuffer(self.fetch(), np.uint8).reshape(1, -1))[0].astype(float))
        after_reset, after_set = readings
        self._bridge, self._flipped = (after_set + after_reset) / 2, (after_set - after_reset) / 2
        self._poke(facts.AUTO_SET_RESET(1))
        self._poke(self._continuous)
        yield 2 / self.rate_hz + self._measured_s

    def _poke(self, setting: Setting) -> None:
        self.registers.poke(setting.register, setting.value)

    def self_test(self) -> SelfTest:
        """Check that SET and RESET reverse the elements: half the difference of the readings after them is the field,
        their mean is the offset of the bridges (MMC-14).
        """
        self.configure()
        field, middle = self._flipped / self.sensitivity, self._bridge / self.sensitivity
        strength = float(np.linalg.norm(field))
        text = f"SET and RESET differ by twice {_text(field)} gauss about {_text(middle)} gauss"
        if np.abs(middle).max() > _BRIDGE_GAUSS or strength > _FIELD_GAUSS[1]:
            return SelfTest(False, f"{text}; allowed are {_FIELD_GAUSS[1]:g} and {_BRIDGE_GAUSS:g} gauss")
        if strength < _FIELD_GAUSS[0]:
            return SelfTest(None, f"{text}: too weak a field, or a coil that does nothing")
        return SelfTest(True, text)

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Return counts of 18 bits, 0 at no field; saturated where a code is the first or the last (MMC-11)."""
        counts = _counts(bursts)
        return DecodedBursts(counts, None, flag_saturated(counts, -_ZERO, _HIGHEST - _ZERO))

    def header(self) -> Mapping[str, float]:
        """Return the counts of the bridges without a field, which are subtracted from readings."""
        return dict(zip(("bridge_x", "bridge_y", "bridge_z"), self._bridge.tolist(), strict=True))


def _counts(bursts: Bytes) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    """Return signed counts (n, 3): less the zero at 131072 (MMC-11)."""
    wide = bursts.astype(np.int32)
    high = wide[:, 0:6:2] << 10 | wide[:, 1:6:2] << 2
    return high + (wide[:, 6:7] >> np.array([6, 4, 2], np.int32) & 0b11) - _ZERO


def _text(gauss: Floats) -> str:
    return ", ".join(f"{value:+.3f}" for value in gauss)

"""A sensing element on which mechanisms act, stage by stage.

::

    world -> felt -> [the unit's own imperfections] -> sensed -> + noise -> amplified -> converter

A stage is a list of functions of the instant, in ns since power-on, and of what the stage before gave. Instants never
go back for one sensor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.element import BLOCK, SensingElement
from firmware_emulator.world import WorldStimulus

Felt = Callable[[int, WorldStimulus], WorldStimulus]
Sensed = Callable[[int, Triple, WorldStimulus], Triple]
Noise = Callable[[int, Triple, Triple, float], Triple]
Amplified = Callable[[int, Triple, float], Triple]
Setting = Callable[[float], float]
Thermometer = Callable[[int, float], float]


@dataclass
class Chain:
    """The stages. Data sheet units (g, dps), axes of the sensor.

    felt: (at_ns, stimulus) -> stimulus at the sensor's place. sensed: (at_ns, input, stimulus) -> input without noise.
    noise: (at_ns, noise, rms, bandwidth_hz) -> noise. amplified: (at_ns, input, full scale) -> converter's input.
    full_scale: the full scale that the analogue part is really set to, of the one that the registers say.
    thermometer: (at_ns, degC of the box) -> degC that the chip's own thermometer feels.
    """

    felt: list[Felt] = field(default_factory=list)
    sensed: list[Sensed] = field(default_factory=list)
    noise: list[Noise] = field(default_factory=list)
    amplified: list[Amplified] = field(default_factory=list)
    full_scale: list[Setting] = field(default_factory=list)
    thermometer: list[Thermometer] = field(default_factory=list)


class MountedElement(SensingElement):
    """`SensingElement` with the stages of `chain` between its own."""

    _chain = Chain()
    _powered_on_ns = 0

    def mount(self, chain: Chain, powered_on_ns: int) -> Self:
        """Put the stages of `chain` between its own; their time counts from when it was powered on. Returns itself."""
        self._chain, self._powered_on_ns = chain, powered_on_ns
        return self

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        """Input of the converter along the sensor's x, y, z, in the data sheet's unit, noise included."""
        chain, gain = self._chain, 1.0
        for setting in chain.full_scale:
            actual = setting(full_scale)
            gain, full_scale = gain * full_scale / actual, actual
        if (full_scale, bandwidth_hz) != self._setting:
            self._set(full_scale, bandwidth_hz)
        since_ns = at_ns - self._powered_on_ns
        x, y, z = self._noiseless(self._world(at_ns), since_ns)
        dx, dy, dz = self._noise_now(since_ns, bandwidth_hz)
        total = x + dx, y + dy, z + dz
        for amplified in chain.amplified:
            total = amplified(since_ns, total, full_scale)
        return total if gain == 1.0 else (total[0] * gain, total[1] * gain, total[2] * gain)

    def temperature(self, at_ns: int) -> float:
        """Return the temperature that the chip's own thermometer feels, its offset included, in degC."""
        degc = self._world(at_ns).temperature_degc
        for thermometer in self._chain.thermometer:
            degc = thermometer(at_ns - self._powered_on_ns, degc)
        return degc + self.unit.thermometer_offset_degc

    def _noiseless(self, stimulus: WorldStimulus, at_ns: int) -> Triple:
        for felt in self._chain.felt:
            stimulus = felt(at_ns, stimulus)
        if stimulus is not self._felt:
            self._felt, self._ideal = stimulus, self._without_noise(stimulus)
        value = self._ideal
        for sensed in self._chain.sensed:
            value = sensed(at_ns, value, stimulus)
        return value

    def _noise_now(self, at_ns: int, bandwidth_hz: float) -> Triple:
        used = self._used
        if used >= len(self._noise):
            self._noise, used = self._random.standard_normal(BLOCK).tolist(), 0
        self._used = used + 3
        drawn, (dx, dy, dz) = self._noise, self._deviation
        noise = dx * drawn[used], dy * drawn[used + 1], dz * drawn[used + 2]
        for shape in self._chain.noise:
            noise = shape(at_ns, noise, self._deviation, bandwidth_hz)
        return noise

"""One sensor at which mechanisms act: its stages, the size of the effect, and its own random numbers.

Mechanisms act on a sensing element stage by stage::

    world -> stimulus -> [the unit's own imperfections] -> sensed -> + noise -> amplified -> converter

A stage is a list of functions of the instant, in ns since power-on, and of the output of the previous stage. Instants
never decrease for one sensor.

The line between a chip's converter and the two wires is the output latch, the contacts and the cable. `ChipLine`
replaces the chip and answers to its address. It has the location of each chip's triad (ADX-27, BMA-12, BMA-60, L3G-44)
and the bit that marks the triad as new (ADX-50, BMA-62, L3G-52).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from struct import Struct
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from firmware_emulator.chip import Chip, TargetProxy, Triple
from firmware_emulator.element import BLOCK, SENSED, Matrix, SensingElement, stream
from firmware_emulator.world import World, WorldStimulus

if TYPE_CHECKING:
    from typing import Any

StimulusStage = Callable[[int, WorldStimulus], WorldStimulus]
Sensed = Callable[[int, Triple, WorldStimulus], Triple]
Noise = Callable[[int, Triple, Triple, float], Triple]
Amplified = Callable[[int, Triple, float], Triple]
Setting = Callable[[float], float]
Thermometer = Callable[[int, float], float]


@dataclass
class Chain:
    """The stages, in data-sheet units (g, dps) and the sensor's axes.

    stimulus: (at_ns, stimulus) -> stimulus at the sensor's place. sensed: (at_ns, input, stimulus) -> input, no noise.
    noise: (at_ns, noise, rms, bandwidth_hz) -> noise. amplified: (at_ns, input, full scale) -> converter's input.
    full_scale: full scale according to the registers -> actual full scale of the analogue part. thermometer: (at_ns,
    degC of the box) -> degC at the chip's own thermometer.
    """

    stimulus: list[StimulusStage] = field(default_factory=list)
    sensed: list[Sensed] = field(default_factory=list)
    noise: list[Noise] = field(default_factory=list)
    amplified: list[Amplified] = field(default_factory=list)
    full_scale: list[Setting] = field(default_factory=list)
    thermometer: list[Thermometer] = field(default_factory=list)


class MountedElement(SensingElement):
    """`SensingElement` with the stages of `chain` between its own stages."""

    _chain = Chain()
    _powered_on_ns = 0

    def mount(self, chain: Chain, powered_on_ns: int) -> Self:
        """Insert the stages of `chain` between its own, with times from power-on, and return itself."""
        self._chain, self._powered_on_ns = chain, powered_on_ns
        return self

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        """Return the input of the converter along the sensor's x, y, z, in the data sheet's unit, including noise."""
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
        """Return the temperature of the chip's own thermometer in degC, including its offset."""
        degc = self._world(at_ns).temperature_degc
        for thermometer in self._chain.thermometer:
            degc = thermometer(at_ns - self._powered_on_ns, degc)
        return degc + self.unit.thermometer_offset_degc

    def _noiseless(self, stimulus: WorldStimulus, at_ns: int) -> Triple:
        for stage in self._chain.stimulus:
            stimulus = stage(at_ns, stimulus)
        if stimulus is not self._stimulus:
            self._stimulus, self._ideal = stimulus, self._ideal_output(stimulus)
        value = self._ideal
        for sensed in self._chain.sensed:
            value = sensed(at_ns, value, stimulus)
        return value

    def _noise_now(self, at_ns: int, bandwidth_hz: float) -> Triple:
        used = self._used
        if used >= len(self._noise):
            self._noise, used = self._random.standard_normal(BLOCK).tolist(), 0
        self._used = used + 3
        samples, (dx, dy, dz) = self._noise, self._deviation
        noise = dx * samples[used], dy * samples[used + 1], dz * samples[used + 2]
        for shape in self._chain.noise:
            noise = shape(at_ns, noise, self._deviation, bandwidth_hz)
        return noise


Codes = tuple[int, int, int]
WORDS = Struct("<3h")


class TriadLayout(NamedTuple):
    """The place of a chip's triad: its first register, the left shift of its codes, and their width in bits."""

    first: int
    shift: int
    bits: int


LAYOUTS = MappingProxyType(
    {"adxl345": TriadLayout(0x32, 0, 13), "bma180": TriadLayout(0x02, 2, 14), "l3g4200d": TriadLayout(0x28, 0, 16)}
)
"""Layouts by chip; inertial chips only."""

Latch = Callable[[int, Codes], Codes]
Contact = Callable[[int], bool]
Cable = Callable[[int, bytes], bytes]
Reset = Callable[[int], int | None]


@dataclass
class Links:
    """The disturbances of a line, each a function of the instant in ns since power-on.

    latches: (at_ns, codes) -> codes as they are read. contacts: (at_ns) -> whether the chip is connected at all.
    cables: (at_ns, bytes sent) -> bytes received. resets: (at_ns) -> time of a supply failure since the previous call,
    or None.
    """

    latches: list[Latch] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    cables: list[Cable] = field(default_factory=list)
    resets: list[Reset] = field(default_factory=list)

    @property
    def idle(self) -> bool:
        """True if there is no disturbance."""
        return not (self.latches or self.contacts or self.cables or self.resets)


class ChipLine(TargetProxy):
    """A chip of that `kind`, read through `links`."""

    def __init__(self, chip: Chip, kind: str, links: Links, powered_on_ns: int = 0) -> None:
        super().__init__(chip)
        self._chip = chip
        self._powered_on_ns = powered_on_ns
        self._links = links
        self._layout = LAYOUTS[kind]
        self._pointer = 0

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Write to the chip; nothing is acknowledged while a contact is open."""
        since_ns = at_ns - self._powered_on_ns
        for reset in self._links.resets:
            failed_ns = reset(since_ns)
            if failed_ns is not None:
                self._chip.power_on(self._powered_on_ns + failed_ns)
        for closed in self._links.contacts:
            if not closed(since_ns):
                return -1 if not data else 0
        if data:
            self._pointer = data[0] & 0x7F
        return self._chip.write(data, at_ns, byte_ns)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read the chip: the triad passes through the latches, all bytes pass through the cable."""
        answer = self._chip.read(count, at_ns, byte_ns)
        at_ns -= self._powered_on_ns
        offset = self._layout.first - self._pointer
        if self._links.latches and offset >= 0 and count >= offset + WORDS.size:
            answer = self._latch(answer, offset, at_ns)
        for cable in self._links.cables:
            answer = cable(at_ns, answer)
        return answer

    def _latch(self, answer: bytes, offset: int, at_ns: int) -> bytes:
        _, shift, bits = self._layout
        words = WORDS.unpack_from(answer, offset)
        low = (1 << shift) - 1
        codes = words[0] >> shift, words[1] >> shift, words[2] >> shift
        for latch in self._links.latches:
            codes = latch(at_ns, codes)
        top = (1 << bits - 1) - 1
        latched = [max(-top - 1, min(top, code)) << shift | word & low for code, word in zip(codes, words, strict=True)]
        return answer[:offset] + WORDS.pack(*latched) + answer[offset + WORDS.size :]


ACCELEROMETERS = ("adxl345", "bma180")
GYROSCOPES = ("l3g4200d",)
INERTIAL = ACCELEROMETERS + GYROSCOPES
WHILE_SET_UP_S = 5.0
"""Time after power-on in s at which faults of the wiring begin; by then chips are set up and the log has started."""


@dataclass
class Site:
    """The sensor `name`: a `chip` in a range of `full_scale` (g or dps), box = `orientation` @ sensor.

    `world` is a function of ns since power-on, like all functions of mechanisms.

    `run` is the number of the power-up, from 0. Mechanisms act on the signal by `chain` and on the wiring by `links`;
    `kinds` changes the chip itself, `switches` its keyword arguments; `notes` collects events for the sealed truth, and
    `touched` the affected sensors, for mechanisms that affect random ones.
    """

    name: str
    chip: str
    full_scale: float
    orientation: Matrix
    world: World
    seed: int
    run: int
    notes: list[str]
    touched: dict[Any, set[str]] = field(default_factory=dict)
    chain: Chain = field(default_factory=Chain)
    links: Links = field(default_factory=Links)
    kinds: list[Callable[[Callable[..., Chip]], Callable[..., Chip]]] = field(default_factory=list)
    switches: dict[str, Any] = field(default_factory=dict)

    def by_unit(self, g: float, dps: float) -> float:
        """Return `g` for an accelerometer, `dps` for a gyroscope."""
        return g if SENSED[self.chip][0] == "force_box" else dps

    def unit_random(self, key: str) -> np.random.Generator:
        """Return a random generator of this part, the same after every power-up."""
        return stream(self.seed, f"{key} in {self.name}")

    def run_random(self, key: str) -> np.random.Generator:
        """Return a random generator of this part and this power-up."""
        return stream(self.seed, f"{key} in {self.name}, run {self.run}")

    def direction(self, key: str) -> Triple:
        """Return the relative effect on each axis of this part: a random direction of length sqrt(3), so that the rms
        over the axes is 1.
        """
        vector = self.unit_random(f"direction of {key}").standard_normal(3)
        x, y, z = (vector * (math.sqrt(3) / float(np.linalg.norm(vector)))).tolist()
        return x, y, z

    def add(self, key: str, g: float, dps: float, course: Callable[[int, WorldStimulus], float]) -> None:
        """Add an error to the signal: `g` or `dps`, by the sensor's unit, along the direction of `key`, times the
        `course` at the instant, which may depend on the stimulus.
        """
        direction, size = self.direction(key), self.by_unit(g, dps)

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            return plus(value, direction, size * course(at_ns, stimulus))

        self.chain.sensed.append(sensed)

    def note(self, event: str) -> None:
        """Add an event at this sensor to the truth."""
        self.notes.append(f"{self.name}: {event}")


class Stopwatch:
    """The seconds since the previous call; 0 at the first."""

    def __init__(self) -> None:
        self._before_ns: int | None = None

    def __call__(self, at_ns: int) -> float:
        """Return the seconds; `at_ns` never decreases."""
        previous_ns = at_ns if self._before_ns is None else self._before_ns
        self._before_ns = at_ns
        return (at_ns - previous_ns) * 1e-9


def plus(value: Triple, direction: Triple, factor: float) -> Triple:
    """Return value + factor * direction."""
    x, y, z = value
    dx, dy, dz = direction
    return x + factor * dx, y + factor * dy, z + factor * dz

"""Noise, vibration and interference that reach the sensing element or its front end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, Stopwatch, plus
from firmware_emulator.world import WorldStimulus


@dataclass(frozen=True)
class CarrierShotNoise(SensorMechanism):
    """Shot noise: the front end counts single charge carriers.

    There are two leakage currents of opposite sign, each of `carriers` per conversion on average; each carrier changes
    the output.

    error = q (N1 - N2), N Poisson with mean `carriers`: variance 2 q^2 `carriers` (Schottky 1918). The charge step q is
    `step_g` or `step_dps`. Reference: 5 mg or 0.15 dps rms.
    """

    carriers: float = 8.0
    step_g: float = 1.25e-3
    step_dps: float = 0.0375

    resembles: ClassVar[tuple[str, ...]] = ("white_noise",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return the mechanism with larger currents: more carriers of the same charge."""
        return cls(carriers=cls.carriers * severity**2)

    def put_on(self, site: Site) -> None:
        """Add one pair of currents to each axis."""
        random, step = site.run_random("carriers"), site.by_unit(self.step_g, self.step_dps)

        def noise(at_ns: int, value: Triple, rms: Triple, bandwidth_hz: float) -> Triple:
            a, b, c, d, e, f = random.poisson(self.carriers, 6).tolist()
            x, y, z = value
            return x + step * (a - b), y + step * (c - d), z + step * (e - f)

        site.chain.noise.append(noise)


@dataclass(frozen=True)
class TrappedCharges(SensorMechanism):
    """Flicker noise: a bank of charge traps, each of which fills and empties with its own time constant.

    Each axis has `traps` that are full or empty, with time constants spread evenly in log(tau) from `fastest_s` to
    `slowest_s`.

    A trap that contributes +-a has the autocorrelation a^2 exp(-dt/tau); the bank has a 1/f spectrum between the two
    corner frequencies (McWhorter 1957). Between two evaluations a trap flips with probability (1 - exp(-dt/tau)) / 2.
    The rms of the bank is a sqrt(traps). Reference: a bank of 2 mg or 0.06 dps rms.
    """

    rms_g: float = 2e-3
    rms_dps: float = 0.06
    traps: int = 12
    fastest_s: float = 0.1
    slowest_s: float = 300.0

    resembles: ClassVar[tuple[str, ...]] = ("bias_instability",)
    scaled: ClassVar[tuple[str, ...]] = ("rms_g", "rms_dps")

    def put_on(self, site: Site) -> None:
        """Add a bank to each axis."""
        random, elapsed = site.run_random("traps"), Stopwatch()
        each = site.by_unit(self.rms_g, self.rms_dps) / self.traps**0.5
        constants_s = np.geomspace(self.fastest_s, self.slowest_s, self.traps)
        bank = np.where(random.random((3, self.traps)) < 0.5, -each, each)
        flips: dict[float, np.ndarray[tuple[int], np.dtype[np.float64]]] = {}

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            passed_s = elapsed(at_ns)
            if passed_s not in flips:
                flips[passed_s] = 0.5 - 0.5 * np.exp(-passed_s / constants_s)
            bank[random.random((3, self.traps)) < flips[passed_s]] *= -1.0
            dx, dy, dz = bank.sum(axis=1).tolist()
            return value[0] + dx, value[1] + dy, value[2] + dz

        site.chain.sensed.append(sensed)


@dataclass(frozen=True)
class StressRelaxation(SensorMechanism):
    """The attachment of the package relaxes: small slips of the glue add up to a random walk.

    Slips occur at the rate `slips_per_s` on each axis (Poisson); their sizes have a Laplace distribution of scale b.

    The variance grows by 2 b^2 `slips_per_s` per second. Over times much longer than those between slips, this is a
    random walk of K = b sqrt(2 slips_per_s). Reference: K = 0.8 mg or 0.025 dps per sqrt(s).
    """

    slips_per_s: float = 2.0
    scale_g: float = 0.4e-3
    scale_dps: float = 0.0125

    resembles: ClassVar[tuple[str, ...]] = ("random_walk",)
    scaled: ClassVar[tuple[str, ...]] = ("scale_g", "scale_dps")

    def put_on(self, site: Site) -> None:
        """Add independent slips to each axis."""
        random, scale = site.run_random("slips"), site.by_unit(self.scale_g, self.scale_dps)
        mean_ns = 1e9 / self.slips_per_s
        due_ns = [random.exponential(mean_ns) for _ in range(3)]
        moved = [0.0, 0.0, 0.0]

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            for axis in range(3):
                while at_ns >= due_ns[axis]:
                    due_ns[axis] += random.exponential(mean_ns)
                    moved[axis] += random.laplace(0.0, scale)
            return value[0] + moved[0], value[1] + moved[1], value[2] + moved[2]

        site.chain.sensed.append(sensed)


@dataclass(frozen=True)
class SingleTrap(SensorMechanism):
    """Popcorn noise: one defect in the amplifier of one axis traps a carrier for some time.

    It is empty for `capture_s` on average and full for `emission_s`, both exponentially distributed; while full it adds
    `size_g` or `size_dps`.

    The share of the time during which it is full is emission_s / (capture_s + emission_s) (Machlup 1954). Reference: 12
    mg or 0.4 dps.
    """

    size_g: float = 12e-3
    size_dps: float = 0.4
    capture_s: float = 4.0
    emission_s: float = 1.0

    resembles: ClassVar[tuple[str, ...]] = ("popcorn_noise",)
    scaled: ClassVar[tuple[str, ...]] = ("size_g", "size_dps")

    def put_on(self, site: Site) -> None:
        """Act in the amplifier of one axis; the axis depends on the part."""
        random, size = site.run_random("trap"), site.by_unit(self.size_g, self.size_dps)
        axis = int(site.unit_random("trap").integers(3))
        place = (float(axis == 0), float(axis == 1), float(axis == 2))
        full, due_ns = False, random.exponential(self.capture_s * 1e9)
        site.note(f"trap in axis {'xyz'[axis]}")

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            nonlocal full, due_ns
            while at_ns >= due_ns:
                full = not full
                due_ns += random.exponential((self.emission_s if full else self.capture_s) * 1e9)
            return plus(value, place, size) if full else value

        site.chain.sensed.append(sensed)


@dataclass(frozen=True)
class MainsRipple(SensorMechanism):
    """Mains ripple on the supply: a fundamental with harmonics, whose frequency wanders like that of the grid.

    error = s (sin p + h2 sin 2p + h3 sin 3p), dp/dt = 2 pi (`mains_hz` + w), with h2, h3 = `harmonics`.

    w wanders with `wander_hz` rms and a correlation time of `wander_s` (first-order Gauss-Markov; the European grid
    keeps within 20 mHz). s is `peak_g` or `peak_dps`, multiplied on each axis by the part's own sensitivity to its
    supply. Reference: 5 mg or 0.15 dps.
    """

    peak_g: float = 5e-3
    peak_dps: float = 0.15
    mains_hz: float = 50.0
    harmonics: tuple[float, float] = (0.3, 0.15)
    wander_hz: float = 0.02
    wander_s: float = 60.0

    resembles: ClassVar[tuple[str, ...]] = ("tone",)
    scaled: ClassVar[tuple[str, ...]] = ("peak_g", "peak_dps")

    def put_on(self, site: Site) -> None:
        """Add the ripple to every axis in the same phase."""
        random, elapsed = site.run_random("mains"), Stopwatch()
        phase, wander = random.uniform(0.0, 2 * math.pi), random.normal(0.0, self.wander_hz)
        second, third = self.harmonics

        def wave(at_ns: int, stimulus: WorldStimulus) -> float:
            nonlocal phase, wander
            seconds = elapsed(at_ns)
            kept = math.exp(-seconds / self.wander_s)
            wander = wander * kept + self.wander_hz * math.sqrt(1 - kept * kept) * random.standard_normal()
            phase = (phase + 2 * math.pi * (self.mains_hz + wander) * seconds) % (2 * math.pi)
            return math.sin(phase) + second * math.sin(2 * phase) + third * math.sin(3 * phase)

        site.add("mains", self.peak_g, self.peak_dps, wave)


@dataclass(frozen=True)
class SpinningMotor(SensorMechanism):
    """A fan near the sensor spins up periodically.

    In each `cycle_s` the motor is on for three quarters of the time: f = F (1 - exp(-t / `spin_up_s`)).

    Its imbalance causes the vibration a (f / F)^2 sin p, p = 2 pi F (t - s (1 - exp(-t / s))), F = `speed_hz`, s =
    `spin_up_s`, a = `peak_g` or `peak_dps`, averaged over the axes. Reference: 15 mg or 0.5 dps at 23 Hz.
    """

    peak_g: float = 15e-3
    peak_dps: float = 0.5
    speed_hz: float = 23.0
    spin_up_s: float = 8.0
    cycle_s: float = 40.0
    scaled: ClassVar[tuple[str, ...]] = ("peak_g", "peak_dps")

    def wave(self, seconds: float) -> float:
        """Return the vibration `seconds` after power-on, relative to its largest amplitude."""
        since = seconds % self.cycle_s - self.cycle_s / 4
        if since <= 0:
            return 0.0
        risen = -math.expm1(-since / self.spin_up_s)
        return risen**2 * math.sin(2 * math.pi * self.speed_hz * (since - self.spin_up_s * risen))

    def put_on(self, site: Site) -> None:
        """Add the vibration along a direction that depends on the sensor."""
        site.add("motor", self.peak_g, self.peak_dps, lambda at_ns, stimulus: self.wave(at_ns * 1e-9))


@dataclass(frozen=True)
class KeyedTransmitter(SensorMechanism):
    """A nearby radio transmitter that is keyed adds noise while it sends.

    A transmitter nearby: for `sending_s` of every `period_s` the demodulated carrier adds Gaussian noise of `rms_g` or
    `rms_dps`.

    Reference: 15 mg or 0.5 dps, 1.5 s in every 9 s.
    """

    rms_g: float = 15e-3
    rms_dps: float = 0.5
    sending_s: float = 1.5
    period_s: float = 9.0
    scaled: ClassVar[tuple[str, ...]] = ("rms_g", "rms_dps")

    def put_on(self, site: Site) -> None:
        """Add noise during the times at which the transmitter sends."""
        random, rms = site.run_random("radio"), site.by_unit(self.rms_g, self.rms_dps)
        offset_s = random.uniform(0.0, self.period_s)

        def noise(at_ns: int, value: Triple, own: Triple, bandwidth_hz: float) -> Triple:
            if (at_ns * 1e-9 + offset_s) % self.period_s >= self.sending_s:
                return value
            a, b, c = random.standard_normal(3).tolist()
            return value[0] + rms * a, value[1] + rms * b, value[2] + rms * c

        site.chain.noise.append(noise)


@dataclass(frozen=True)
class OneSidedNoise(SensorMechanism):
    """One-sided noise, as from a contact that rectifies.

    It adds e - mean, e exponentially distributed with the mean `mean_g` or `mean_dps`: variance mean^2, skewness 2.

    Reference: 8 mg or 0.25 dps.
    """

    mean_g: float = 8e-3
    mean_dps: float = 0.25
    scaled: ClassVar[tuple[str, ...]] = ("mean_g", "mean_dps")

    def put_on(self, site: Site) -> None:
        """Add independent noise to each axis."""
        random, mean = site.run_random("rectifier"), site.by_unit(self.mean_g, self.mean_dps)

        def noise(at_ns: int, value: Triple, rms: Triple, bandwidth_hz: float) -> Triple:
            a, b, c = random.standard_exponential(3).tolist()
            return value[0] + mean * (a - 1), value[1] + mean * (b - 1), value[2] + mean * (c - 1)

        site.chain.noise.append(noise)


@dataclass(frozen=True)
class ReferenceNoise(SensorMechanism):
    """The converter's reference is noisy: the noise of a reading is proportional to its magnitude.

    output = input / (1 + `share` n), n white and Gaussian, one for all axes of a conversion. Reference: 1.5 %.
    """

    share: float = 0.015
    scaled: ClassVar[tuple[str, ...]] = ("share",)

    def put_on(self, site: Site) -> None:
        """Scale all axes of a conversion by the same error."""
        random = site.run_random("reference")

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            gain = 1 / max(0.5, 1 + self.share * random.standard_normal())
            return value[0] * gain, value[1] * gain, value[2] * gain

        site.chain.amplified.append(amplified)

"""Effects of temperature on a sensor and on its thermometer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, Stopwatch
from firmware_emulator.world import ROOM_DEGC, WorldStimulus


@dataclass(frozen=True)
class ThermistorBow(SensorMechanism):
    """The temperature compensation is linear, the physical dependence is not: a quadratic residual remains.

    error = d (T - 25)^2, d is `bow_g_per_k2` or `bow_dps_per_k2`, averaged over the axes. Reference: 50 ug/K^2 (20 mg
    at 45 degC) or 1.5 mdps/K^2.
    """

    bow_g_per_k2: float = 50e-6
    bow_dps_per_k2: float = 1.5e-3

    resembles: ClassVar[tuple[str, ...]] = ("thermal_bias",)
    scaled: ClassVar[tuple[str, ...]] = ("bow_g_per_k2", "bow_dps_per_k2")

    def put_on(self, site: Site) -> None:
        """Add the error to each axis with a sign and share that depend on the part."""

        def bow(at_ns: int, stimulus: WorldStimulus) -> float:
            return (stimulus.temperature_degc - ROOM_DEGC) ** 2

        site.add("bow", self.bow_g_per_k2, self.bow_dps_per_k2, bow)


@dataclass(frozen=True)
class GainResistor(SensorMechanism):
    """The resistor that sets the amplifier's gain changes with temperature.

    gain = exp(k (T - 25)), k = `per_k` as for a diffused resistor, the same for all axes. Reference: 0.1 % per K.
    """

    per_k: float = 1e-3

    resembles: ClassVar[tuple[str, ...]] = ("thermal_scale",)
    scaled: ClassVar[tuple[str, ...]] = ("per_k",)

    def put_on(self, site: Site) -> None:
        """Amplify the whole signal, including the bias."""

        def sensed(at_ns: int, value: Triple, stimulus: WorldStimulus) -> Triple:
            gain = math.exp(self.per_k * (stimulus.temperature_degc - ROOM_DEGC))
            return value[0] * gain, value[1] * gain, value[2] * gain

        site.chain.sensed.append(sensed)


@dataclass(frozen=True)
class BoardToDie(SensorMechanism):
    """Heat reaches the proof mass through the board.

    Two nodes: board dTb/dt = (T - Tb) / `board_s`, die dTd/dt = (Tb - Td) / `die_s`; bias follows Td.

    The chip's thermometer, near the pads, measures Tb. During a ramp of T it lags by board_s, the bias by board_s +
    die_s. Reference: 6 s and 2 s.
    """

    board_s: float = 6.0
    die_s: float = 2.0

    resembles: ClassVar[tuple[str, ...]] = ("thermal_lag",)
    scaled: ClassVar[tuple[str, ...]] = ("board_s", "die_s")

    def put_on(self, site: Site) -> None:
        """Start both nodes at the first temperature."""
        elapsed = Stopwatch()
        board = die = math.nan

        def changed_stimulus(at_ns: int, stimulus: WorldStimulus) -> WorldStimulus:
            nonlocal board, die
            seconds, degc = elapsed(at_ns), stimulus.temperature_degc
            if math.isnan(board):
                board = die = degc
            if board == die == degc:
                return stimulus
            die += (board - die) * -math.expm1(-seconds / self.die_s)
            board += (degc - board) * -math.expm1(-seconds / self.board_s)
            return stimulus._replace(temperature_degc=die)

        site.chain.stimulus.append(changed_stimulus)
        site.chain.thermometer.append(lambda at_ns, degc: degc if math.isnan(board) else board)


@dataclass(frozen=True)
class SelfHeating(SensorMechanism):
    """Self-heating of a chip: its thermometer, near the regulator on the die, is warmer than the box.

    The chip's thermometer measures T + `rise_k` (1 - exp(-t / `settling_s`)), t since power-on; the bias follows the
    temperature T of the mass.

    rise = power x thermal resistance; only chips whose thermometer has a zero. Reference: 3 K after 5 s.
    """

    rise_k: float = 3.0
    settling_s: float = 5.0

    touches: ClassVar[tuple[str, ...]] = ("bma180",)
    resembles: ClassVar[tuple[str, ...]] = ("thermometer",)
    scaled: ClassVar[tuple[str, ...]] = ("rise_k",)

    def put_on(self, site: Site) -> None:
        """Change only the temperature of the thermometer."""

        def thermometer(at_ns: int, degc: float) -> float:
            return degc - self.rise_k * math.expm1(-at_ns * 1e-9 / self.settling_s)

        site.chain.thermometer.append(thermometer)


@dataclass(frozen=True)
class ThermalHysteresis(SensorMechanism):
    """Hysteresis of yielding solder: the bias differs between rising and falling temperature.

    error = s (p - T), p following T with a backlash of +-w kelvin (Prandtl's play operator), w = `backlash_k`.

    p starts at the first temperature. After sufficient warming the error is -s w, after sufficient cooling +s w, at any
    rate of change. s w is `size_g` or `size_dps`, averaged over the axes. Reference: 10 mg or 0.3 dps, 3 K.
    """

    size_g: float = 10e-3
    size_dps: float = 0.3
    backlash_k: float = 3.0
    scaled: ClassVar[tuple[str, ...]] = ("size_g", "size_dps")

    def put_on(self, site: Site) -> None:
        """Add the error to each axis with a sign and share that depend on the part."""
        width = self.backlash_k
        follower: float | None = None

        def lag(at_ns: int, stimulus: WorldStimulus) -> float:
            nonlocal follower
            degc = stimulus.temperature_degc
            follower = degc if follower is None else min(max(follower, degc - width), degc + width)
            return follower - degc

        site.add("hysteresis", self.size_g / width, self.size_dps / width, lag)

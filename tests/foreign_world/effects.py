"""What can be wrong with an array beyond its data sheets.

`EFFECTS` says of each effect which name the project's vocabulary has for it (None: it has none), at which stage of the
chain it acts, which experiments can show it, when it can act, and by which kind of limit its size is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tests.foreign_world import deeds
from tests.foreign_world.chain import Act
from tests.foreign_world.deeds import FORCE, KELVIN, RATE, REFERENCE, Deed, Placement, additive, felt_turned, on_rows
from tests.foreign_world.parts import BMA_NONLINEARITY, DPS, SI, Sensor

Shows = Mapping[str, tuple[frozenset[str], ...]]
"""Of each quantity the sets of experiments of which one suffices to show an effect."""
INERTIAL = ("bma180", "adxl345", "l3g4200d")
BEYOND = 2.0
"""A nonlinearity or thermal slope of the scale factor is at least so many times what the data sheet allows."""


@dataclass(frozen=True)
class Effect:
    """What the generator knows of an effect.

    `limit` is a kind of `severity`: of `tolerance` and `count`, `start` is the limit; of `fixed`, the size; of the
    others, where the search for the limit begins, in rms of the noise if the unit is SI. `span` is what it concerns:
    an axis (at times all three), a sensor, a pair of sensors of one quantity, twins, or the array. `least` is the
    smallest size that is clearly beyond what the data sheet or a good recorder allows.
    """

    design_name: str | None
    stage: str
    act: Deed
    whens: tuple[str, ...]
    limit: str
    start: float
    shows: Shows
    unit: str = "SI"
    span: str = "axis"
    chips: tuple[str, ...] = INERTIAL
    least: Callable[[Sensor], float] = lambda sensor: 0.0

    def acts(self, place: Placement, size: float) -> dict[str, list[Act]]:
        """The effect, at this place and size, for each sensor that it concerns."""
        return {name: [(self.stage, lambda signal: self.act(signal, place, size))] for name in place.sensors}


def at_least(size: float) -> Callable[[Sensor], float]:
    """The same for every sensor."""
    return lambda sensor: size


def nonlinearity_beyond(power: int) -> Callable[[Sensor], float]:
    """Deviation at the reference value for a data sheet's nonlinearity at full scale (BMA-117, ADX-65, L3G-73)."""

    def least(sensor: Sensor) -> float:
        shares = {"bma180": BMA_NONLINEARITY.get(sensor.range, 0.0), "adxl345": 0.005, "l3g4200d": 0.002}
        full_scale = sensor.range * SI[sensor.facts.unit]
        reference = REFERENCE[sensor.facts.quantity]
        return BEYOND * shares[sensor.chip] * full_scale * (reference / full_scale) ** power

    return least


def thermal_scale_beyond(sensor: Sensor) -> float:
    """Deviation at the reference value and `KELVIN`: 0.01 %/K (BMA-116, ADX-64), 2 % in 60 K (L3G-72)."""
    slope = 0.02 / 60 if sensor.chip == "l3g4200d" else 1e-4
    return BEYOND * slope * KELVIN * REFERENCE[sensor.facts.quantity]


def any_of(*sets: str) -> Shows:
    """Each text names experiments that together show the effect: "heating tumble"."""
    alternatives = tuple(frozenset(text.split()) for text in sets)
    return {FORCE: alternatives, RATE: alternatives}


ALL = any_of("static", "tumble", "heating", "turn_on", "motion")
STILL = any_of("static", "heating")
HEATING, MOTION, TURN_ON = any_of("heating"), any_of("motion"), any_of("turn_on")
MOVED: Shows = {FORCE: (frozenset({"tumble"}),), RATE: (frozenset({"motion"}),)}
WARM_AND_MOVED: Shows = {FORCE: (frozenset({"heating", "tumble"}),), RATE: (frozenset({"heating", "motion"}),)}
GYRO_MOTION: Shows = {RATE: MOTION[RATE]}
ACCELEROMETER_MOTION: Shows = {FORCE: MOTION[FORCE]}
GYRO_TUMBLE: Shows = {RATE: (frozenset({"tumble"}),)}

ALWAYS, ONSET, MOMENTS = ("always",), ("always", "from"), ("moments",)
SESSIONS, LONG = ("always", "from", "logs"), ("always", "from", "logs", "stretches")
BMA_L3G, ADXL_L3G = ("bma180", "l3g4200d"), ("adxl345", "l3g4200d")

EFFECTS: dict[str, Effect] = {
    "low_passed_output": Effect(
        "bandwidth", "filter", deeds.low_pass, SESSIONS, "spectrum", 2.0, ALL, "half poll rate over cut-off", "sensor"
    ),
    "vibration_line": Effect("tone", "element", additive(deeds.vibration), LONG, "matched", 0.1, STILL),
    "mains_alias": Effect("tone", "element", additive(deeds.mains), LONG, "matched", 0.1, STILL),
    "repeated_samples": Effect("stale_samples", "poll", deeds.repeat, ONSET, "count", 3, ALL, "rows", "sensor"),
    "even_codes": Effect("quantisation", "code", deeds.coarse_codes(2), SESSIONS, "fixed", 2, ALL, "codes", "sensor"),
    "codes_in_fours": Effect("quantisation", "code", deeds.coarse_codes(4), SESSIONS, "fixed", 4, ALL, "codes"),
    "missing_codes": Effect("quantisation", "code", deeds.missing_codes, ALWAYS, "fixed", 1, ALL, "codes", "sensor"),
    "supply_noise": Effect(
        "common_mode", "element", additive(deeds.supply), ONSET, "energy", 0.1, STILL, "rms", "pair"
    ),
    "held_readings": Effect("stuck", "poll", deeds.hold, MOMENTS, "count", 5, ALL, "s", "sensor"),
    "dropped_rows": Effect("dropped_samples", "poll", deeds.drop, ONSET, "count", 3, ALL, "rows", "sensor"),
    "scale_beyond_tolerance": Effect(
        "scale", "input", felt_turned(deeds.more_scale), ALWAYS, "tolerance", 0.02, MOVED, "1"
    ),
    "scale_step": Effect("scale", "input", felt_turned(deeds.more_scale), ("from",), "tolerance", 0.02, MOTION, "1"),
    "leaning_axes": Effect(
        "misalignment", "input", felt_turned(deeds.lean), ALWAYS, "tolerance", 1.0 * DPS, MOVED, "rad", "sensor"
    ),
    "swapped_axes": Effect("axis_error", "input", felt_turned(deeds.swap), ALWAYS, "fixed", 1, MOVED, "1"),
    "flipped_axis": Effect("axis_error", "input", felt_turned(deeds.flip), ALWAYS, "fixed", 1, MOVED, "1"),
    "quadratic_response": Effect(
        "nonlinearity",
        "element",
        additive(deeds.quadratic),
        ALWAYS,
        "matched",
        0.1,
        MOVED,
        least=nonlinearity_beyond(2),
    ),
    "cubic_response": Effect(
        "nonlinearity",
        "element",
        additive(deeds.cubic),
        ALWAYS,
        "matched",
        0.1,
        GYRO_MOTION,
        least=nonlinearity_beyond(3),
    ),
    "quadratic_thermal_bias": Effect(
        "thermal_bias", "element", additive(deeds.thermal_quadratic), ALWAYS, "matched", 0.1, HEATING
    ),
    "lagging_thermal_bias": Effect(
        "thermal_lag", "element", additive(deeds.thermal_lag), ALWAYS, "matched", 0.3, HEATING
    ),
    "random_walk": Effect(
        "random_walk", "element", additive(deeds.walk), ALWAYS, "energy", 0.02, STILL, "SI per sqrt(s)"
    ),
    "flicker": Effect("bias_instability", "element", additive(deeds.flicker), ALWAYS, "energy", 0.1, STILL),
    "telegraph": Effect("popcorn_noise", "element", additive(deeds.telegraph), ONSET, "matched", 0.2, STILL),
    "bistable_turn_on": Effect(
        "bistable_bias", "element", additive(deeds.bistable), ALWAYS, "tolerance", 1.0, TURN_ON, "turn-on sigma"
    ),
    "scattered_turn_on": Effect(
        "turn_on_bias", "element", additive(deeds.turn_on), ALWAYS, "tolerance", 1.0, TURN_ON, "turn-on sigma", "sensor"
    ),
    "clipping": Effect(
        "saturation", "code", deeds.clip, ALWAYS, "fixed", 0.7, GYRO_MOTION, "share of the largest value"
    ),
    "spikes": Effect("glitches", "poll", on_rows(deeds.spikes), MOMENTS, "matched", 5, ALL),
    "delayed_sensor": Effect(
        "skew",
        "clock",
        deeds.delay,
        ("always", "logs"),
        "matched",
        0.005,
        GYRO_MOTION,
        "s",
        "sensor",
        least=at_least(0.03),
    ),
    "fast_host_clock": Effect(
        "clock_error",
        "clock",
        deeds.fast_clock,
        ALWAYS,
        "matched",
        3e-4,
        GYRO_MOTION,
        "1",
        "array",
        least=at_least(3e-4),
    ),
    "late_stamps": Effect(
        "jitter", "clock", deeds.jitter, ALWAYS, "energy", 0.003, GYRO_MOTION, "s", "sensor", least=at_least(0.004)
    ),
    "other_range": Effect(
        "range_reset", "code", deeds.other_range, ("from", "logs"), "fixed", 1, ALL, "1", "sensor", BMA_L3G
    ),
    "half_data_rate": Effect("odr_error", "code", deeds.half_rate, ALWAYS, "fixed", 2, ALL, "1", "sensor", ADXL_L3G),
    "force_in_gyro": Effect(
        "g_sensitivity", "element", additive(deeds.force_seen), ALWAYS, "matched", 0.1, GYRO_TUMBLE
    ),
    "thermal_scale": Effect(
        "thermal_scale",
        "element",
        additive(deeds.thermal_scale),
        ALWAYS,
        "matched",
        0.1,
        WARM_AND_MOVED,
        least=thermal_scale_beyond,
    ),
    "excess_noise": Effect(
        "white_noise", "element", additive(deeds.white), ("from", "logs", "stretches"), "energy", 0.5, ALL
    ),
    "bias_step": Effect("bias", "element", additive(deeds.constant), ("from", "stretches"), "matched", 0.2, STILL),
    "swapped_sensors": Effect(
        "channel_swap", "poll", deeds.swap_sensors, ("from", "logs"), "fixed", 1, ALL, "1", "twins"
    ),
    "displaced_sensor": Effect(
        "size_effect",
        "element",
        additive(deeds.lever),
        ALWAYS,
        "matched",
        1.0,
        ACCELEROMETER_MOTION,
        "m",
        "sensor",
        least=at_least(0.02),
    ),
    # Nobody's library is likely to name the following.
    "creep_after_power_on": Effect(None, "element", additive(deeds.creep), ALWAYS, "matched", 0.2, STILL),
    "noise_with_signal": Effect(
        None, "element", additive(deeds.white_by_signal), ALWAYS, "energy", 0.5, MOVED, span="sensor"
    ),
    "interleaved_converters": Effect(
        None, "filter", additive(deeds.interleave), ONSET, "matched", 0.1, ALL, span="sensor"
    ),
    "chirp": Effect(None, "element", additive(deeds.chirp), ("always", "stretches"), "matched", 0.1, STILL),
    "skewed_noise": Effect(None, "noise", deeds.skewed, ONSET, "fixed", 1, STILL, "1", "sensor"),
    "backlash": Effect(None, "element", additive(deeds.backlash), ALWAYS, "matched", 0.3, MOVED, span="sensor"),
    "leak_of_last_reading": Effect(None, "poll", on_rows(deeds.leak), ONSET, "matched", 0.01, MOVED, "1", "pair"),
    "read_after_conversion": Effect(
        None, "poll", on_rows(deeds.read_phase), ONSET, "matched", 0.1, STILL, span="sensor"
    ),
    "counter_offset": Effect(None, "poll", on_rows(deeds.counter), ONSET, "matched", 0.1, STILL),
    "noise_bursts": Effect(None, "element", additive(deeds.bursts), ONSET, "energy", 1.0, STILL, span="sensor"),
    "noise_growing_in_log": Effect(
        None, "element", additive(deeds.growing_white), ALWAYS, "energy", 0.5, STILL, span="sensor"
    ),
}

DESIGN_NAMES: dict[str, str] = {name: effect.design_name for name, effect in EFFECTS.items() if effect.design_name}
"""For scoring: the vocabulary's name of each known effect."""
UNKNOWN = tuple(name for name, effect in EFFECTS.items() if effect.design_name is None)

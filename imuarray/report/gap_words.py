"""Effects in a few words each, for a page whose reader has no list of effects at hand."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "clock_error": "the clock of the log is off by a ratio that is constant or settles",
        "own_clock": "the chip samples by its own clock and answers a poll with its latest reading",
        "skew": "readings are older than their time stamps",
        "jitter": "time stamps of readings scatter",
        "dropped_samples": "readings are lost, alone or in bursts",
        "size_effect": "a sensor away from the origin of the box senses the rotation of the box as specific force",
        "thermal_lag": "the sensing element warms up later than the box",
        "axis_error": "the axes of the sensor differ from the configuration",
        "misalignment": "the axes of the sensor are misaligned",
        "nonlinearity": "the response is slightly nonlinear",
        "scale": "the scale factor differs from the data sheet",
        "thermal_scale": "the scale factor depends on the temperature of the sensing element",
        "g_sensitivity": "specific force changes the reading of a sensor of another quantity",
        "bias": "the reading differs from zero at zero input",
        "turn_on_bias": "the bias changes each time the sensor is switched on",
        "bistable_bias": "after some boots the bias is different",
        "thermal_bias": "the bias depends on the temperature of the sensing element",
        "bias_instability": "the bias wanders within bounds",
        "random_walk": "the bias wanders without bounds",
        "popcorn_noise": "the bias jumps between two levels",
        "common_mode": "all units of one design wander together",
        "tone": "a sine wave in the signal",
        "white_noise": "every reading has an independent, normally distributed error",
        "bandwidth": "each reading depends on the previous ones",
        "adaptive_range": "the reading is frozen for a moment when the rate passes a threshold",
        "odr_error": "the chip runs at another data rate, or with another filter, than configured",
        "range_reset": "the chip measures in another range than configured",
        "quantisation": "codes come in steps larger than one",
        "saturation": "the signal saturates before the codes do",
        "thermometer": "the thermometer of the chip has an error",
        "stale_samples": "a reading repeats the previous one",
        "glitches": "single readings are corrupted",
        "stuck": "the counts are frozen for a while",
        "channel_swap": "the sensor delivers the data of another sensor, or is mounted in its place",
    }
)
"""Keyed by the effects' names in models and in JSON."""

"""Effects in a few words each, for a page whose reader has no list of effects at hand."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "clock_error": "the log's clock goes wrong by a ratio that is constant, or settles",
        "own_clock": "the chip makes its readings by a clock of its own, and answers a poll with the latest of them",
        "skew": "readings are older than their stamps",
        "jitter": "readings are stamped a little off",
        "dropped_samples": "readings are lost, alone or in bursts",
        "size_effect": "a sensor away from the box's origin feels the box turn",
        "thermal_lag": "the element warms up later than the box",
        "axis_error": "the sensor's axes are other ones than the configuration says",
        "misalignment": "the axes of the sensor lean",
        "nonlinearity": "the response is a little curved",
        "scale": "a unit of the quantity is more or fewer counts than the data sheet says",
        "thermal_scale": "the scale follows the element's temperature",
        "g_sensitivity": "specific force moves the reading of a sensor that is to measure something else",
        "bias": "what a sensor reads when there is nothing to read",
        "turn_on_bias": "the bias is another one each time the sensor is switched on",
        "bistable_bias": "after some boots the bias is another one",
        "thermal_bias": "the bias follows the element's temperature",
        "bias_instability": "the bias wanders and comes back",
        "random_walk": "the bias walks away and has no reason to come back",
        "popcorn_noise": "the bias jumps to and fro between two levels",
        "common_mode": "all units of one design wander together",
        "tone": "a sine in the signal",
        "white_noise": "every reading is off by an independent normal number",
        "bandwidth": "readings that remember the one before",
        "adaptive_range": "the reading stands still for a moment when the rate passes a threshold",
        "odr_error": "the chip runs at another data rate, or through another filter, than it was told to",
        "range_reset": "the chip measures in another range than it was set to",
        "quantisation": "codes come in coarser steps than one",
        "saturation": "the signal ends before the code span does",
        "thermometer": "the chip's own thermometer is off",
        "stale_samples": "a reading is the one before, once more",
        "glitches": "now and then a reading is corrupted",
        "stuck": "the counts stand still for a while",
        "channel_swap": "the data, or the place, of another sensor",
    }
)
"""By the effects' names in models and in JSON."""

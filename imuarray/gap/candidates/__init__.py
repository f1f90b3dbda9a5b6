"""Every effect that may be the cause of a gap, by its name: one small file each says how it is recognised."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from imuarray.gap.candidates.axis_error import AXIS_ERROR
from imuarray.gap.candidates.bandwidth import BANDWIDTH
from imuarray.gap.candidates.bias import BIAS
from imuarray.gap.candidates.bias_instability import BIAS_INSTABILITY
from imuarray.gap.candidates.bistable_bias import BISTABLE_BIAS
from imuarray.gap.candidates.candidate import Action, Candidate, Kind, Trial
from imuarray.gap.candidates.channel_swap import CHANNEL_SWAP
from imuarray.gap.candidates.clock_error import CLOCK_ERROR
from imuarray.gap.candidates.common_mode import COMMON_MODE
from imuarray.gap.candidates.dropped_samples import DROPPED_SAMPLES
from imuarray.gap.candidates.g_sensitivity import G_SENSITIVITY
from imuarray.gap.candidates.glitches import GLITCHES
from imuarray.gap.candidates.jitter import JITTER
from imuarray.gap.candidates.misalignment import MISALIGNMENT
from imuarray.gap.candidates.nonlinearity import NONLINEARITY
from imuarray.gap.candidates.odr_error import ODR_ERROR
from imuarray.gap.candidates.popcorn_noise import POPCORN_NOISE
from imuarray.gap.candidates.quantisation import QUANTISATION
from imuarray.gap.candidates.random_walk import RANDOM_WALK
from imuarray.gap.candidates.range_reset import RANGE_RESET
from imuarray.gap.candidates.saturation import SATURATION
from imuarray.gap.candidates.scale import SCALE
from imuarray.gap.candidates.size_effect import SIZE_EFFECT
from imuarray.gap.candidates.skew import SKEW
from imuarray.gap.candidates.stale_samples import STALE_SAMPLES
from imuarray.gap.candidates.stuck import STUCK
from imuarray.gap.candidates.thermal_bias import THERMAL_BIAS
from imuarray.gap.candidates.thermal_lag import THERMAL_LAG
from imuarray.gap.candidates.thermal_scale import THERMAL_SCALE
from imuarray.gap.candidates.thermometer import THERMOMETER
from imuarray.gap.candidates.tone import TONE
from imuarray.gap.candidates.turn_on_bias import TURN_ON_BIAS
from imuarray.gap.candidates.white_noise import WHITE_NOISE

__all__ = ["CANDIDATES", "Action", "Candidate", "Kind", "Trial"]

CANDIDATES: Mapping[str, Candidate] = MappingProxyType(
    {
        "clock_error": CLOCK_ERROR,
        "skew": SKEW,
        "jitter": JITTER,
        "dropped_samples": DROPPED_SAMPLES,
        "size_effect": SIZE_EFFECT,
        "thermal_lag": THERMAL_LAG,
        "axis_error": AXIS_ERROR,
        "misalignment": MISALIGNMENT,
        "nonlinearity": NONLINEARITY,
        "scale": SCALE,
        "thermal_scale": THERMAL_SCALE,
        "g_sensitivity": G_SENSITIVITY,
        "bias": BIAS,
        "turn_on_bias": TURN_ON_BIAS,
        "bistable_bias": BISTABLE_BIAS,
        "thermal_bias": THERMAL_BIAS,
        "bias_instability": BIAS_INSTABILITY,
        "random_walk": RANDOM_WALK,
        "popcorn_noise": POPCORN_NOISE,
        "common_mode": COMMON_MODE,
        "tone": TONE,
        "white_noise": WHITE_NOISE,
        "bandwidth": BANDWIDTH,
        "odr_error": ODR_ERROR,
        "range_reset": RANGE_RESET,
        "quantisation": QUANTISATION,
        "saturation": SATURATION,
        "thermometer": THERMOMETER,
        "stale_samples": STALE_SAMPLES,
        "glitches": GLITCHES,
        "stuck": STUCK,
        "channel_swap": CHANNEL_SWAP,
    }
)
"""In the physical order of the effects. `own_clock` is none of them: every chip that is polled has a phase of its own,
and the base model draws it, so that only what goes beyond is left. Of that an age that no period explains is a `skew`,
one that changes a `jitter`, and a rate that repeats rows an `odr_error`, each of which says more of its cause.
"""

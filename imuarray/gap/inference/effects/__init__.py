"""Every effect that may be the cause of a gap, by its name: one small file each says how it is recognised."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from imuarray.gap.inference.effects.adaptive_range import ADAPTIVE_RANGE
from imuarray.gap.inference.effects.axis_error import AXIS_ERROR
from imuarray.gap.inference.effects.bandwidth import BANDWIDTH
from imuarray.gap.inference.effects.bias import BIAS
from imuarray.gap.inference.effects.bias_instability import BIAS_INSTABILITY
from imuarray.gap.inference.effects.bistable_bias import BISTABLE_BIAS
from imuarray.gap.inference.effects.candidate import Action, Candidate, Hypothesis, Kind
from imuarray.gap.inference.effects.channel_swap import CHANNEL_SWAP
from imuarray.gap.inference.effects.clock_error import CLOCK_ERROR
from imuarray.gap.inference.effects.common_mode import COMMON_MODE
from imuarray.gap.inference.effects.dropped_samples import DROPPED_SAMPLES
from imuarray.gap.inference.effects.g_sensitivity import G_SENSITIVITY
from imuarray.gap.inference.effects.glitches import GLITCHES
from imuarray.gap.inference.effects.jitter import JITTER
from imuarray.gap.inference.effects.misalignment import MISALIGNMENT
from imuarray.gap.inference.effects.nonlinearity import NONLINEARITY
from imuarray.gap.inference.effects.odr_error import ODR_ERROR
from imuarray.gap.inference.effects.popcorn_noise import POPCORN_NOISE
from imuarray.gap.inference.effects.quantisation import QUANTISATION
from imuarray.gap.inference.effects.random_walk import RANDOM_WALK
from imuarray.gap.inference.effects.range_reset import RANGE_RESET
from imuarray.gap.inference.effects.saturation import SATURATION
from imuarray.gap.inference.effects.scale import SCALE
from imuarray.gap.inference.effects.size_effect import SIZE_EFFECT
from imuarray.gap.inference.effects.skew import SKEW
from imuarray.gap.inference.effects.stale_samples import STALE_SAMPLES
from imuarray.gap.inference.effects.stuck import STUCK
from imuarray.gap.inference.effects.thermal_bias import THERMAL_BIAS
from imuarray.gap.inference.effects.thermal_lag import THERMAL_LAG
from imuarray.gap.inference.effects.thermal_scale import THERMAL_SCALE
from imuarray.gap.inference.effects.tone import TONE
from imuarray.gap.inference.effects.turn_on_bias import TURN_ON_BIAS
from imuarray.gap.inference.effects.white_noise import WHITE_NOISE

__all__ = ["CANDIDATES", "Action", "Candidate", "Hypothesis", "Kind"]

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
        "adaptive_range": ADAPTIVE_RANGE,
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

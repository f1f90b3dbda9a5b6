"""Every effect by its name, in physical order: the order in which effects act within a stage of the chain."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.bias import (
    Bias,
    BiasInstability,
    BistableBias,
    CommonMode,
    PopcornNoise,
    RandomWalk,
    TurnOnBias,
)
from imuarray.simulate.effects.conversion import AdaptiveRange, OdrError, Quantisation, RangeReset, Saturation
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.readings import ChannelSwap, Glitches, StaleSamples, Stuck
from imuarray.simulate.effects.response import AxisError, GSensitivity, Misalignment, Nonlinearity, Scale, SizeEffect
from imuarray.simulate.effects.temperature import ThermalBias, ThermalLag, ThermalScale, Thermometer
from imuarray.simulate.effects.timing import ClockError, DroppedSamples, Jitter, OwnClock, Skew

EFFECTS: Mapping[str, type[Effect]] = MappingProxyType(
    {
        # when a row is read, and whether it arrives
        "clock_error": ClockError,
        "own_clock": OwnClock,
        "skew": Skew,
        "jitter": Jitter,
        "dropped_samples": DroppedSamples,
        # the stimulus at the place of the sensor
        "size_effect": SizeEffect,
        "thermal_lag": ThermalLag,
        # the element's signal
        "axis_error": AxisError,
        "misalignment": Misalignment,
        "nonlinearity": Nonlinearity,
        "scale": Scale,
        "thermal_scale": ThermalScale,
        "g_sensitivity": GSensitivity,
        "bias": Bias,
        "turn_on_bias": TurnOnBias,
        "bistable_bias": BistableBias,
        "thermal_bias": ThermalBias,
        "bias_instability": BiasInstability,
        "random_walk": RandomWalk,
        "popcorn_noise": PopcornNoise,
        "common_mode": CommonMode,
        "tone": Tone,
        # its noise
        "white_noise": WhiteNoise,
        "bandwidth": Bandwidth,
        "odr_error": OdrError,
        # the converter
        "range_reset": RangeReset,
        "quantisation": Quantisation,
        "saturation": Saturation,
        "thermometer": Thermometer,
        "adaptive_range": AdaptiveRange,
        # what the bus delivers
        "stale_samples": StaleSamples,
        "glitches": Glitches,
        "stuck": Stuck,
        "channel_swap": ChannelSwap,
    }
)


def meaning(name: str) -> str:
    """Return a short description of the effect `name`; "" for an unknown name."""
    return EFFECTS[name].meaning if name in EFFECTS else ""

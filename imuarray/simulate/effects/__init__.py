"""Every effect by its name, in physical order: the order in which effects act within a stage of the chain."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import MappingProxyType

from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.adaptive_range import AdaptiveRange
from imuarray.simulate.effects.axis_error import AxisError
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.bias_instability import BiasInstability
from imuarray.simulate.effects.bistable_bias import BistableBias
from imuarray.simulate.effects.channel_swap import ChannelSwap
from imuarray.simulate.effects.clock_error import ClockError
from imuarray.simulate.effects.common_mode import CommonMode
from imuarray.simulate.effects.dropped_samples import DroppedSamples
from imuarray.simulate.effects.g_sensitivity import GSensitivity
from imuarray.simulate.effects.glitches import Glitches
from imuarray.simulate.effects.jitter import Jitter
from imuarray.simulate.effects.misalignment import Misalignment
from imuarray.simulate.effects.nonlinearity import Nonlinearity
from imuarray.simulate.effects.odr_error import OdrError
from imuarray.simulate.effects.own_clock import OwnClock
from imuarray.simulate.effects.popcorn_noise import PopcornNoise
from imuarray.simulate.effects.quantisation import Quantisation
from imuarray.simulate.effects.random_walk import RandomWalk
from imuarray.simulate.effects.range_reset import RangeReset
from imuarray.simulate.effects.saturation import Saturation
from imuarray.simulate.effects.scale import Scale
from imuarray.simulate.effects.size_effect import SizeEffect
from imuarray.simulate.effects.skew import Skew
from imuarray.simulate.effects.stale_samples import StaleSamples
from imuarray.simulate.effects.stuck import Stuck
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.effects.thermal_lag import ThermalLag
from imuarray.simulate.effects.thermal_scale import ThermalScale
from imuarray.simulate.effects.thermometer import Thermometer
from imuarray.simulate.effects.tone import Tone
from imuarray.simulate.effects.turn_on_bias import TurnOnBias
from imuarray.simulate.effects.white_noise import WhiteNoise

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
    """Return a short description of the effect `name`: the first line of its module, or "" for an unknown name."""
    kind = EFFECTS.get(name)
    docstring = (sys.modules[kind.__module__].__doc__ or "") if kind else ""
    return docstring.splitlines()[0].partition(": ")[2].rstrip(".") if docstring else ""

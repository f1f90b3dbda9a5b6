"""Pulls: the nuisance quantities of parts against their tolerances, and the causes that may have made them.

A pull is fitted without the causes. Where a sensor measures in another range than configured, the fit can only call its
scale factor wrong: that is no second finding.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite
from types import MappingProxyType

from imuarray.gap.findings.diagnosis import Cause, Pull
from imuarray.gap.findings.formatting import listed_causes
from imuarray.gap.model.nuisance import NuisanceEstimate

_OF_RATE = frozenset({"odr_error", "own_clock", "clock_error", "stale_samples", "dropped_samples", "skew", "jitter"})
_OF_FILTER = frozenset({"bandwidth", "odr_error", "white_noise", "stale_samples", "tone"})
_OF_LEVEL = frozenset({"bias", "turn_on_bias", "bistable_bias", "thermal_bias", "random_walk", "popcorn_noise"})
_OF_TEMPERATURE = frozenset({"thermal_bias", "thermal_scale", "thermal_lag", "random_walk", "common_mode"})
_OF_RESPONSE = frozenset(
    {
        "range_reset",
        "axis_error",
        "channel_swap",
        "face_error",
        "scale",
        "misalignment",
        "g_sensitivity",
        "nonlinearity",
        "saturation",
        "adaptive_range",
        "thermal_scale",
        "size_effect",
        "stuck",
        "skew",
        "bandwidth",
        "clock_error",
    }
)

_MOVED_BY: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "bias": _OF_LEVEL | _OF_RESPONSE | {"thermal_lag", "common_mode", "bias_instability", "glitches"},
        "thermal slope of the bias": _OF_TEMPERATURE | _OF_RESPONSE | _OF_LEVEL,
        "cutoff of the filter": _OF_FILTER,
        "rate of the data clock": _OF_RATE,
        "scale factor error": _OF_RESPONSE | _OF_LEVEL,
        "misalignment": _OF_RESPONSE | _OF_LEVEL,
        "g-sensitivity": _OF_RESPONSE | _OF_LEVEL,
        "zero of the chip's thermometer": frozenset({"range_reset", "channel_swap", "stuck"}),
    }
)
"""The effects that move the fitted value of a quantity if the model lacks them."""


def pulls_of(estimates: Iterable[NuisanceEstimate], causes: Sequence[Cause]) -> tuple[Pull, ...]:
    """Return the pulls of the estimates that have a tolerance, each with the listed causes of its sensor that may have
    made it.
    """
    return tuple(
        Pull(*estimate[:-1], estimate.pull, estimate.source, tuple(dict.fromkeys(_reasons(estimate, causes))))
        for estimate in estimates
        if isfinite(estimate.pull)
    )


def _reasons(estimate: NuisanceEstimate, causes: Sequence[Cause]) -> Iterator[str]:
    moved_by = _MOVED_BY.get(estimate.quantity, frozenset())
    for cause in listed_causes(causes):
        if cause.effect in moved_by and (estimate.sensor in cause.sensors or not cause.sensors):
            yield cause.effect

"""`channel_swap`: readings that are another sensor's, by their noise or by their axes; or two in each other's place."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.in_motion import takes_part
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.channel_swap import ChannelSwap

_NOISE = ("fast_own_axes", "fast_box_axes", "fast_other_chips", "slow_own_axes", "slow_box_axes")
_AXES = (("force_own", "motion_gain"), ("force_next", "motion_next"), ("force_after", "motion_after"))
_BEYOND = 3.0
_SAME = 0.9
"""Correlation of window means at rest beyond which two sensors' noise is one."""

_NEAR = 0.25
"""A response is that of another sensor's axes if none of its entries is farther off."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Each sensor whose noise is this one's, and each along whose axes this one seems to lie."""
    yield from with_removal(evidence, ChannelSwap.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    twins = _twins(evidence) if evidence.is_odd(*_NOISE, beyond=_BEYOND) else set()
    odd = evidence.is_odd(*(probe for pair in _AXES for probe in pair), beyond=_BEYOND)
    for other in evidence.others:
        is_rescaled = odd and _lies_along(evidence, other, other.sensitivity / evidence.header.sensitivity)
        if other.name in twins or is_rescaled:
            yield Hypothesis((ChannelSwap(other.name),), shared=True, sensor=evidence.header.name, others=(other.name,))
        if odd and other.name not in twins and other.chip == evidence.header.chip and _lies_along(evidence, other):
            yield _crossed(evidence.header.name, other.name)


def _crossed(sensor: str, other: str) -> Hypothesis:
    """Their plugs were crossed: each is set up and read in the other's place."""
    one, its = ChannelSwap(other, "place"), ChannelSwap(sensor, "place")
    return Hypothesis((one,), shared=True, sensor=sensor, others=(other,), opposite=(its,))


def _twins(evidence: Evidence) -> set[str]:
    """Others with the same readings, counts for counts, whatever is said of their axes."""
    name = evidence.header.name
    largest: dict[str, float] = {}
    for phase in evidence.still:
        if phase.cross is None or not takes_part(evidence, phase.cross):
            continue
        for other in phase.cross.others(name, family=False):
            own, its = phase.cross.columns(name), phase.cross.columns(other)
            size = np.sqrt(np.diag(phase.cross.fast[own, own]) * np.diag(phase.cross.fast[its, its]))
            shared = np.diag(phase.cross.fast[own, its])
            if (size > 0).all():
                largest[other] = max(largest.get(other, -1.0), float((shared / size).min()))
    return {other for other, correlation in largest.items() if correlation > _SAME}


def _lies_along(evidence: Evidence, other: SensorHeader, scale: float = 1.0) -> bool:
    """True if the response is that of the other sensor's axes, times `scale`, rather than of its own."""
    expected = np.array(other.orientation).T @ np.array(evidence.header.orientation) * scale
    if np.allclose(expected, np.eye(3)):
        return False
    return any((np.abs(shown - expected) < _NEAR).all() for shown in _shown(evidence))


def _shown(evidence: Evidence) -> Iterator[Floats]:
    """(3, 3) response of the axes (rows) to force or motion along the nominal ones; residual probes lack the ideal."""
    rows = np.arange(3)
    for kind, ideal in ((0, np.eye(3)), (1, np.zeros((3, 3)))):
        if kind == 0 and evidence.header.quantity != "specific_force":
            continue
        turned = ideal.copy()
        for step, probes in enumerate(_AXES):
            shown = evidence.values.get(probes[kind], np.full((1, 3), np.nan))
            known = np.isfinite(shown).all(axis=1)
            turned[rows, (rows + step) % 3] += np.median(shown[known], axis=0) if known.any() else np.nan
        if np.isfinite(turned).all():
            yield turned


CHANNEL_SWAP = Candidate(
    ChannelSwap.name,
    guesses,
    {
        "static": "still for 1 minute",
        "tumble": "all six faces, 1 minute each",
        "motion": "turns and strokes along every axis, 1 minute",
    },
)

"""What a box feels that somebody put down by hand: which way is up, from the array's own accelerometers.

In every pose the specific force is one g long and all accelerometers feel the same: from poses in many directions the
bias that they have in common is told from the direction, scale taken as nominal. What is felt in a pose is thus an
estimate, with the array's own noise and errors in it; whoever compares a recording with simulations has to estimate it
in these as well, though there it is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.gap.campaign import Campaign
from imuarray.gap.probes.level import mean
from imuarray.gap.summary import Summary
from imuarray.log.format import Phase
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.posed import Posed
from imuarray.units import STANDARD_GRAVITY

Floats = npt.NDArray[np.float64]

GROSS_G = 0.25
"""An accelerometer that reads so much otherwise than the median of all, in any pose, has no say in the mean: a wrong
range, an axis swapped, a dead chip."""

_STEPS = 5
"""Of Gauss and Newton, which double the digits; biases of 0.1 g need three."""

_LEAST_SHARE = 0.1
"""Directions along which the poses tell the common bias so much worse than along the best one are left at none."""

_INSTANTS = 64
"""Of a phase whose force is known: a reference has noise."""

Forces = Mapping[tuple[int, int], Floats]
"""Estimated specific force (3,) in m/s2, box frame, by the number of the log and the start of the phase in it."""


class Ups(NamedTuple):
    """`up_box` (k, 3) of length 1, (0, 0, 0) where nothing is felt; `bias_g` (3,), common to the array, box frame."""

    up_box: Floats
    bias_g: Floats


def ups_of(mean_g: Floats, known_g: Floats) -> Ups:
    """Directions up from what the array reads on average in k poses, `mean_g` (k, 3) in the box frame; `known_g` (k, 3)
    is what is felt where it is known, nan elsewhere.

    Least squares of the lengths' differences from 1 g, of known poses those of all axes, over one bias for all.
    """
    bias = np.zeros(3)
    unknown = np.isnan(known_g).any(axis=1)
    for _ in range(_STEPS):
        ups, lengths = _directions(mean_g - bias)
        apart = (mean_g - bias - known_g)[~unknown]
        design = np.concatenate([ups[unknown], np.tile(np.eye(3), (len(apart), 1))])
        wanted = np.concatenate([lengths[unknown] - 1, apart.ravel()])
        bias = bias + np.linalg.lstsq(design, wanted, rcond=_LEAST_SHARE)[0]
    return Ups(_directions(mean_g - bias)[0], bias)


def array_mean(readings: Floats) -> Floats:
    """(k, 3) mean of s accelerometers, `readings` (k, s, 3) in g in the box frame, nan of what was not read: of those
    that read in every pose and never are `GROSS_G` from the median; of all, if there are none.
    """
    whole = np.isfinite(readings).all(axis=(0, 2))
    if not whole.any():
        with np.errstate(invalid="ignore"):
            known = np.isfinite(readings)
            return np.asarray(np.where(known, readings, 0.0).sum(axis=1) / known.sum(axis=1))
    found = readings[:, whole]
    near = (np.abs(found - np.median(found, axis=1)[:, None]) < GROSS_G).all(axis=(0, 2))
    return np.asarray(found[:, near].mean(axis=1) if near.any() else np.median(found, axis=1))


def estimated_forces(campaign: Campaign, motions: Sequence[Motion]) -> Forces:
    """What is felt in the phases whose attitude is estimated, from all phases at rest of the campaign together."""
    rests = list(_rests(campaign, motions))
    if not any(rest.known is None for rest in rests):
        return {}
    readings = _readings([rest.accelerometers for rest in rests], lambda summary: mean(summary))
    known_g = np.array([np.full(3, np.nan) if rest.known is None else rest.known for rest in rests])
    return _forces(rests, ups_of(array_mean(readings), known_g).up_box)


def forces_left(campaign: Campaign, motions: Sequence[Motion], less: Callable[[Summary], Floats]) -> Forces:
    """The same where what each sensor adds to gravity is known: `less` is its mean (3,) without it, in its unit."""
    rests = [rest for rest in _rests(campaign, motions) if rest.known is None]
    if not rests:
        return {}
    return _forces(rests, _directions(array_mean(_readings([rest.accelerometers for rest in rests], less)))[0])


class _Rest(NamedTuple):
    """A phase at rest: where it is, its accelerometers by name, and what is felt (3,) in g (None: not known)."""

    place: tuple[int, int]
    accelerometers: Mapping[str, Summary]
    known: Floats | None


def _rests(campaign: Campaign, motions: Sequence[Motion]) -> Iterator[_Rest]:
    for number, (log, motion) in enumerate(zip(campaign.logs, motions, strict=True)):
        for part in log.phases:
            there = {
                name: summary
                for name, summary in part.sensors.items()
                if summary.header.quantity == "specific_force" and summary.rows
            }
            if not part.is_still or not there:
                continue
            is_estimated = isinstance(motion, Posed) and motion.is_estimated(part.phase)
            known = None if is_estimated else _mean_force_g(motion, part.phase)
            yield _Rest((number, part.phase.start_ns), there, known)


def _mean_force_g(motion: Motion, phase: Phase) -> Floats:
    at_ns = np.linspace(phase.start_ns, phase.end_ns - 1, _INSTANTS).astype(np.int64)
    return np.asarray(np.mean(motion.felt(at_ns).force_box, axis=0) / STANDARD_GRAVITY)


def _readings(phases: Sequence[Mapping[str, Summary]], of: Callable[[Summary], Floats]) -> Floats:
    """(k, s, 3) in the box frame, nan where a sensor didn't read."""
    names = dict.fromkeys(name for phase in phases for name in phase)
    nothing = np.full(3, np.nan)
    rows = [
        [np.array(phase[name].header.orientation) @ of(phase[name]) if name in phase else nothing for name in names]
        for phase in phases
    ]
    return np.array(rows)


def _forces(rests: Sequence[_Rest], up_box: Floats) -> Forces:
    found = zip(rests, up_box, strict=True)
    return {rest.place: up * STANDARD_GRAVITY for rest, up in found if rest.known is None}


def _directions(vectors: Floats) -> tuple[Floats, Floats]:
    """(k, 3) of length 1, and (k,) the lengths; 0 of nothing."""
    lengths = np.linalg.norm(vectors, axis=1)
    units = np.divide(vectors, lengths[:, None], out=np.zeros_like(vectors), where=lengths[:, None] > 0)
    return units, lengths

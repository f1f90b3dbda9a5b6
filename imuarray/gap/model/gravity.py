"""Specific force in phases at rest whose attitude was not noted, estimated from all accelerometers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, up_vector
from imuarray.gap.recording.attitude import array_mean, attitude_numbers, directions, shared_readings, ups_of
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.probes.level import mean
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import Phase
from imuarray.simulate.motion.posed import PoseSequence
from imuarray.simulate.motion.stimulus import Motion
from imuarray.units import STANDARD_GRAVITY

_INSTANTS = 64
"""Number of instants over which a known force is averaged, since a reference is noisy."""

NO_CHANGE = np.zeros(3)

Forces = Mapping[tuple[int, int], Floats]
"""Estimated specific force (3,) in m/s2, box frame, by the number of the log and the start of the phase in it."""


def estimated_forces(
    campaign: Campaign, motions: Sequence[Motion], thermal: Callable[[Summary], Floats] = lambda summary: NO_CHANGE
) -> Forces:
    """Return the forces in the phases whose attitude is estimated, from all phases at rest of the campaign together.

    `thermal` returns the change (3,) of a sensor's mean reading due to temperature, in its unit, which is subtracted: a
    common drift of the accelerometers with temperature is not a tilt.
    """
    rests = list(_rests(campaign, motions))
    if not any(rest.known is None for rest in rests):
        return {}
    readings = shared_readings(
        [rest.attitude for rest in rests],
        _readings([rest.accelerometers for rest in rests], lambda summary: mean(summary) - thermal(summary)),
    )
    known_g = np.array([np.full(3, np.nan) if rest.known is None else rest.known for rest in rests])
    noted_g = np.array([rest.nominal for rest in rests])
    return _forces(rests, ups_of(array_mean(readings, noted_g), known_g, noted_g).up_box)


def residual_forces(campaign: Campaign, motions: Sequence[Motion], less: Callable[[Summary], Floats]) -> Forces:
    """Return the forces in the phases whose attitude is estimated, from readings that are corrected for the sensors'
    fitted errors: `less` returns the corrected mean (3,) of a sensor, in its unit.
    """
    rests = [rest for rest in _rests(campaign, motions) if rest.known is None]
    if not rests:
        return {}
    attitudes, accelerometers = [rest.attitude for rest in rests], [rest.accelerometers for rest in rests]
    corrected, uncorrected = (shared_readings(attitudes, _readings(accelerometers, of)) for of in (less, mean))
    noted_g = np.array([rest.nominal for rest in rests])
    return _forces(rests, directions(array_mean(corrected, noted_g, uncorrected))[0])


class _Rest(NamedTuple):
    """A phase at rest: its `place` (log number and start in ns), its `attitude` (log number and number of the attitude
    in the log), its accelerometers by name, the `known` force (3,) in g (None if it is estimated), and the `nominal`
    force (3,) in g for the noted face without tilt (nan if no face is noted).
    """

    place: tuple[int, int]
    attitude: tuple[int, int]
    accelerometers: Mapping[str, Summary]
    known: Floats | None
    nominal: Floats


def _rests(campaign: Campaign, motions: Sequence[Motion]) -> Iterator[_Rest]:
    for number, (log, motion) in enumerate(zip(campaign.logs, motions, strict=True)):
        attitudes = attitude_numbers([part.phase for part in log.phases])
        for part, attitude in zip(log.phases, attitudes, strict=True):
            there = {
                name: summary
                for name, summary in part.sensors.items()
                if summary.header.quantity == "specific_force" and summary.rows
            }
            if not part.is_still or not there:
                continue
            is_estimated = isinstance(motion, PoseSequence) and motion.is_estimated(part.phase)
            known = None if is_estimated else mean_force_g(motion, part.phase)
            nominal = np.array(up_vector(part.phase.up)) if part.phase.up in UP_AXES else np.full(3, np.nan)
            yield _Rest((number, part.phase.start_ns), (number, attitude), there, known, nominal)


def mean_force_g(motion: Motion, phase: Phase) -> Floats:
    """Return the mean specific force (3,) of a motion in a phase, in g, box frame."""
    at_ns = np.linspace(phase.start_ns, phase.end_ns - 1, _INSTANTS).astype(np.int64)
    return np.asarray(np.mean(motion.stimulus(at_ns).force_box, axis=0) / STANDARD_GRAVITY)


def _readings(phases: Sequence[Mapping[str, Summary]], of: Callable[[Summary], Floats]) -> Floats:
    """Return the readings `of` the summaries (k, s, 3) of k phases and s sensors in the box frame, nan where a sensor
    has none.
    """
    names = dict.fromkeys(name for phase in phases for name in phase)
    nothing = np.full(3, np.nan)
    rows = [
        [np.array(phase[name].header.orientation) @ of(phase[name]) if name in phase else nothing for name in names]
        for phase in phases
    ]
    return np.array(rows)


def _forces(rests: Sequence[_Rest], up_box: Floats) -> Forces:
    directions_up = zip(rests, up_box, strict=True)
    return {rest.place: up * STANDARD_GRAVITY for rest, up in directions_up if rest.known is None}

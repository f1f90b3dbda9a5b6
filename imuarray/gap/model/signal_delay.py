"""Delays of the chips' own filters, which show where sensors with different cutoffs follow one motion.

A low-pass filter of two poles with the configured cutoff f delays the signal by 1 / (sqrt(2) pi f). No data sheet
prints the order of the filter or the tolerance of its cutoff, and some print a cutoff that is that of the noise alone:
the ratio of the delay to this figure, between 0 and `MOST_RATIO`, is a nuisance parameter that sensors of one quantity
have in common. A sensor that is late by another ratio has another cause. A delay that the log states is that of the
data sheet: it is simulated as it is, and is no parameter.

A chip that decimates delays its readings by some of its own periods besides, all of its units alike and by how many no
data sheet prints: up to `MOST_PERIODS` of them are a nuisance parameter of each kind of chip that another kind, or a
track, is compared with.

Rows from a queue in the chip have times that the recorder works out from those of its polls; these may be off by a
period of the chip, which is another nuisance parameter of each such sensor. So may the times of sensors that are
compared with the track of an instrument, by a period of the rows and all of a quantity alike: the clocks of two
instruments differ.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from imuarray.arrays import Floats
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.probes.motion import delay, information_on_delay
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.bandwidth import two_pole_cutoff_hz
from imuarray.simulate.model import noise_bandwidth_hz

_PRIOR = 1.0
"""Standard deviations of a parameter, in those of its bound: parameters that the motion does not determine are 0."""

MOST_RATIO = 1.5
"""Largest ratio of the delay to that of two poles at the configured cutoff: three poles, or a cutoff a third lower."""

MOST_PERIODS = 2.5
"""Longest usual delay of a decimation filter, in periods of the chip's data rate: a symmetric filter of four periods
with some of a poll's.
"""

_LEAST_CHANGE_S, _SLOPES = 1e-5, (0.5, 5.0)
"""Change of a delay that tells by how much more of it is seen, and the least and the most that is believed."""

_LEAST_S = 1e-7
"""A shorter delay in the filter is none: times are known to a microsecond at best."""


class SignalDelay(NamedTuple):
    """Delay of a sensor's signal in its filter, and how much older its readings are than their times, both in s."""

    filter_s: float = 0.0
    stamp_s: float = 0.0


NO_DELAY = SignalDelay()

SignalDelays = Mapping[str, SignalDelay]
"""By sensor."""

DelayTrial = tuple[SignalDelays, Sequence[Campaign]]
"""Delays, and replicates simulated with them."""


def stated_delay(header: SensorHeader) -> SignalDelay:
    """Return the delay that the log states for the sensor's filter; none if it states none."""
    return SignalDelay(stamp_s=(header.delay_ns or 0) * 1e-9)


def fit_signal_delays(
    campaign: Campaign, headers: Mapping[str, SensorHeader], queued: Collection[str], trials: Sequence[DelayTrial]
) -> dict[str, SignalDelay]:
    """Delays of the sensors by the phases in which the box moves; `queued` sensors have rows from a queue.

    A Gauss-Newton step from the last of the `trials`: least squares of the delays behind the other sensors of the
    quantity, or the track, less those of the replicates on average. A motion that is fast beside the windows shows more
    of a delay than there is: by how much the last two trials tell. Empty without such phases.
    """
    nominal_s = {name: _nominal_delay_s(header) for name, header in headers.items()}
    stated_s = {name: stated_delay(header).stamp_s for name, header in headers.items()}
    delays: dict[str, SignalDelay] = {}
    for quantity in dict.fromkeys(header.quantity for header in headers.values()):
        names = [name for name, header in headers.items() if header.quantity == quantity]
        late = _late_stamps(_crosses(campaign), {name: headers[name] for name in names}, queued)
        observed = _rows(_crosses(campaign), names, nominal_s, late)
        steps = []
        for simulated, replicates in trials[-2:]:
            simulated_s = [_rows(_crosses(replicate), names, nominal_s, late).delay_s for replicate in replicates]
            comparable = [delay_s for delay_s in simulated_s if len(delay_s) == len(observed.delay_s)]
            ratios = [simulated[name].filter_s / nominal_s[name] for name in names if nominal_s[name] > 0]
            stamps_s = np.array([simulated[name].stamp_s - stated_s[name] for name in names])
            are_late = np.array([[name in stamps.sensors for stamps in late] for name in names], float)
            start = np.append(max(ratios, default=0.0), np.linalg.lstsq(are_late, stamps_s)[0])
            if comparable and len(observed.delay_s):
                steps.append((start, np.mean(comparable, axis=0)))
        if not steps:
            continue
        start, seen_s = steps[-1]
        if len(steps) > 1:
            observed = observed._replace(design=observed.design * _slopes(observed.design, *steps)[:, None])
        most = np.array([MOST_RATIO, *(stamps.most_s for stamps in late)])
        least = np.array([0.0, *(stamps.least_s for stamps in late)])
        ratio, *offsets_s = _solve(observed, seen_s, start, (least, most)).tolist()
        for name in names:
            late_s = sum(value_s for value_s, stamps in zip(offsets_s, late, strict=True) if name in stamps.sensors)
            delays[name] = SignalDelay(_truncate(ratio * nominal_s[name]), stated_s[name] + late_s)
    return delays


def _truncate(delay_s: float) -> float:
    """Return the delay of a filter, 0 if it is negligible."""
    return delay_s if delay_s > _LEAST_S else 0.0


def can_fit_signal_delays(campaign: Campaign, headers: Mapping[str, SensorHeader], queued: Collection[str]) -> bool:
    """Return whether the box moves, and sensors of one quantity are of several chips, have filters that delay
    differently or a queue, or are compared with a track.
    """
    by_quantity: dict[str, set[tuple[str, float]]] = {}
    for header in headers.values():
        by_quantity.setdefault(header.quantity, set()).add((header.chip, _nominal_delay_s(header)))
    differ = any(len(kinds) > 1 for kinds in by_quantity.values())
    crosses = _crosses(campaign)
    return bool(crosses) and (differ or bool(queued) or bool(_tracked(crosses)))


def _nominal_delay_s(header: SensorHeader) -> float:
    """Delay at the configured cutoff; 0 where none is known, and where the log states the delay."""
    if header.delay_ns:
        return 0.0
    cutoff_hz = noise_bandwidth_hz(header)
    return two_pole_cutoff_hz(cutoff_hz) if cutoff_hz > 0 else 0.0


class _LateStamps(NamedTuple):
    """Sensors whose readings may be older than their times, all by the same amount, and by how much in s."""

    sensors: frozenset[str]
    most_s: float
    least_s: float


def _late_stamps(
    crosses: Sequence[Cross], headers: Mapping[str, SensorHeader], queued: Collection[str]
) -> list[_LateStamps]:
    """Return which of these sensors' times may be off: those of all that follow a track, of each with a queue, and of
    the units of each chip.
    """
    tracked = _tracked(crosses)
    common = frozenset(tracked) & headers.keys()
    late = []
    if common:
        period_s = max(tracked[name] for name in common)
        late.append(_LateStamps(common, period_s, -period_s))
    late += [
        _LateStamps(frozenset([name]), 1 / header.rate_hz, -1 / header.rate_hz)
        for name, header in headers.items()
        if name in queued and header.rate_hz > 0
    ]
    chips = dict.fromkeys(header.chip for header in headers.values())
    for chip in chips if len(chips) > 1 or common else ():
        units = {name: header for name, header in headers.items() if header.chip == chip}
        rates_hz = [header.rate_hz for header in units.values() if header.rate_hz > 0 and not header.delay_ns]
        if rates_hz:
            late.append(_LateStamps(frozenset(units), MOST_PERIODS / min(rates_hz), 0.0))
    return late


def _tracked(crosses: Sequence[Cross]) -> dict[str, float]:
    """Return the sensors that are compared with a track, each with the period of its rows in s, or a little more."""
    return {name: cross.window_s / 2 for cross in crosses for name in cross.tracked}


def _crosses(campaign: Campaign) -> list[Cross]:
    """Return the joint moments of the phases in which the box moves."""
    return [part.cross for log in campaign.logs for part in log.phases if part.cross is not None and not part.is_still]


class _Delays(NamedTuple):
    """Delays (n,) of sensors' axes behind the others in s, their information, and what they are for each parameter
    (n, p): the ratio, and stamps that are late; nan where there is none.
    """

    delay_s: Floats
    information: Floats
    design: Floats


def _rows(
    crosses: Sequence[Cross], names: Collection[str], nominal_s: Mapping[str, float], late: Sequence[_LateStamps]
) -> _Delays:
    delays, information = [np.zeros(0)], [np.zeros(0)]
    design = [np.zeros((0, 1 + len(late)))]
    coefficients = {
        item.name: np.array([nominal_s.get(item.name, 0.0), *(item.name in stamps.sensors for stamps in late)], float)
        for cross in crosses
        for item in cross.sensors
    }
    for cross in crosses:
        for name in (item.name for item in cross.sensors if item.name in names):
            references = [coefficients[other] for other in cross.others(name, family=False)]
            if name in cross.tracked:
                references.append(np.zeros(1 + len(late)))
            if not references:
                continue
            delays.append(delay(cross, name))
            information.append(information_on_delay(cross, name))
            design.append(np.tile(coefficients[name] - np.mean(references, axis=0), (3, 1)))
    return _Delays(np.concatenate(delays), np.concatenate(information), np.concatenate(design))


def _slopes(design: Floats, before: tuple[Floats, Floats], after: tuple[Floats, Floats]) -> Floats:
    """Return (n,) change of the delays seen between two trials, each parameters (p,) and delays (n,), over the change
    that the design (n, p) expects; 1 where that is none.
    """
    expected_s, change_s = design @ (after[0] - before[0]), after[1] - before[1]
    slopes = np.divide(change_s, expected_s, out=np.ones(len(design)), where=np.abs(expected_s) > _LEAST_CHANGE_S)
    return np.asarray(np.clip(np.nan_to_num(slopes, nan=1.0), *_SLOPES))


def _solve(observed: _Delays, seen_s: Floats, start: Floats, bounds: tuple[Floats, Floats]) -> Floats:
    """Return the parameters (p,) within bounds that explain the delays beyond those `seen_s` with the parameters
    `start`.
    """
    behind_s = observed.delay_s - seen_s + observed.design @ start
    known = np.isfinite(behind_s) & np.isfinite(observed.information)
    if not known.any():
        return start
    weight = np.sqrt(observed.information[known])
    prior = np.diag(_PRIOR / np.maximum(np.abs(bounds[0]), bounds[1]))
    matrix = np.vstack([observed.design[known] * weight[:, None], prior])
    target = np.append(behind_s[known] * weight, np.zeros(len(start)))
    return np.asarray(lsq_linear(matrix, target, bounds=bounds).x)

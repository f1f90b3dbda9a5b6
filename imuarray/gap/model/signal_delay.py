"""Delays of the chips' own filters, which are measured when sensors with different cutoffs follow the same motion.

A two-pole low-pass filter with the configured cutoff f delays the signal by 1 / (sqrt(2) pi f). No data sheet prints
the order of the filter or the tolerance of its cutoff, and some print only the bandwidth of the noise. The ratio of the
delay to this figure, between 0 and `MOST_RATIO`, is a nuisance parameter that is common to the sensors of one quantity.
If a sensor has another ratio, its delay has another cause. If there are `FEWEST_UNITS` or more sensors, one that is
later than the ratio of the others predicts is left out of the fit. A delay that the log states is that of the data
sheet; it is simulated as stated and is not a parameter.

A chip that decimates also delays its readings by several of its own periods. The number of periods is the same for all
units of a chip type and is not printed by any data sheet. Up to `MOST_PERIODS` of them are a nuisance parameter of each
chip type that is compared with another type or with a track. A unit that is later than the others of its type is left
out of this fit, since the fault is its own.

The recorder computes the times of rows from a queue in the chip from the times of its polls. These may be wrong by one
period of the chip, which is another nuisance parameter for each sensor with a queue. The times of sensors that are
compared with the track of an instrument may also be wrong, by one period of the rows and equally for all sensors of a
quantity, since the clocks of two instruments differ.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from imuarray.arrays import Floats
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.probes.motion import delay, information_on_delay
from imuarray.log.format import SensorHeader
from imuarray.robust import MEDIAN_ABSOLUTE
from imuarray.simulate.effects.bandwidth import two_pole_cutoff_hz
from imuarray.simulate.model import noise_bandwidth_hz

_PRIOR = 1.0
"""Standard deviation of the prior of a parameter, as a multiple of its bound: parameters that the motion does not
determine are 0.
"""

MOST_RATIO = 1.5
"""Largest ratio of the delay to that of two poles at the configured cutoff: that of three poles, or of a cutoff that is
lower by a third.
"""

MOST_PERIODS = 2.5
"""Longest usual delay of a decimation filter, in periods of the chip's data rate: that of a symmetric filter of four
periods, with a margin for the polls.
"""

_LEAST_ODD_PERIODS, _LEAST_ODD_SQUARES = 0.5, 25.0
"""Least delay relative to other units of the same chip type, in periods of the data rate, at which a unit is left out
of the fit of their delay, and the least decrease of the sum of squares that this must give: five standard deviations.
"""

FEWEST_UNITS = 4
"""Number of sensors of one quantity with a filter from which on one may be left out of the fit of the common ratio.
Three sensors have only two relative delays, which the ratio and the delay of any one of them explain.
"""

_LEAST_CHANGE_S, _SLOPES = 1e-5, (0.5, 5.0)
"""Least expected change of a delay, in s, from which the ratio of the measured to the expected change is computed, and
the least and the largest ratio that is used.
"""

_LEAST_S = 1e-7
"""Least delay of a filter, in s; a shorter one is set to 0, since times are known to a microsecond at best."""


class SignalDelay(NamedTuple):
    """Delay of a sensor's signal in its filter, and the age of its readings at their time stamps, both in s."""

    filter_s: float = 0.0
    stamp_s: float = 0.0


NO_DELAY = SignalDelay()

SignalDelays = Mapping[str, SignalDelay]
"""Delays by sensor."""

DelayTrial = tuple[SignalDelays, Sequence[Campaign]]
"""Delays, and the replicates that were simulated with them."""


def stated_delay(header: SensorHeader) -> SignalDelay:
    """Return the delay that the log states for the sensor's filter; 0 if it states none."""
    return SignalDelay(stamp_s=(header.delay_ns or 0) * 1e-9)


def fit_signal_delays(
    campaign: Campaign, headers: Mapping[str, SensorHeader], queued: Collection[str], trials: Sequence[DelayTrial]
) -> dict[str, SignalDelay]:
    """Return the delays of the sensors from the phases in which the box moves; `queued` sensors have rows from a queue.

    One Gauss-Newton step from the last of the `trials`: a least-squares fit to the delays relative to the other sensors
    of the quantity, or to the track, less the medians of these delays in the replicates. Delays that scatter between
    the replicates, for example those of an axis with hardly any motion, have less weight. If a motion is fast compared
    with the windows, the measured delay is larger than the true one; the ratio is estimated from the first and the last
    trial, whose delays differ most. If an earlier trial is nearer to the recording than the last one, the delays of the
    nearest trial are returned, since with a motion that is too fast for the rows the ratio does not hold for a whole
    step. Empty if no phase determines a delay.
    """
    delays: dict[str, SignalDelay] = {}
    for quantity in dict.fromkeys(header.quantity for header in headers.values()):
        of_quantity = {name: header for name, header in headers.items() if header.quantity == quantity}
        usual = _late_stamps(_crosses(campaign), of_quantity, queued)
        late = [*usual, *_odd_units(of_quantity, usual)]
        observed, simulated = _compare(campaign, of_quantity, late, trials)
        if not simulated:
            continue
        squares = [np.nansum(observed.information * (observed.delay_s - trial.seen_s) ** 2) for trial in simulated]
        nearest = simulated[int(np.argmin(squares))]
        if nearest is simulated[-1]:
            delays.update(_step(_problem(observed, simulated, late), of_quantity, usual, late))
        else:
            delays.update({name: nearest.delays[name] for name in of_quantity})
    return delays


def _step(
    problem: _Problem, headers: Mapping[str, SensorHeader], usual: Sequence[_LateStamps], late: Sequence[_LateStamps]
) -> SignalDelays:
    """Return the delays of the sensors of one quantity from the solution of a problem."""
    parameters = list(range(1 + len(usual)))
    fits = [_solve(problem, parameters)]
    for place, odd in enumerate(late[len(usual) :], start=1 + len(usual)):
        fit = _solve(problem, [*parameters, place])
        is_late = fit.parameters[-1] > _LEAST_ODD_PERIODS * odd.period_s
        if is_late and fit.squares < fits[0].squares - _LEAST_ODD_SQUARES:
            fits.append(fit)
    ratio, *offsets_s = min(fits, key=lambda fit: fit.squares).parameters.tolist()
    delays = {}
    for name, header in headers.items():
        pairs = zip(offsets_s, usual, strict=False)  # the extra delay of an odd unit is not a usual delay
        late_s = sum(value_s for value_s, stamps in pairs if name in stamps.sensors)
        filter_s = _truncate(ratio * _nominal_delay_s(header))
        delays[name] = SignalDelay(filter_s, stated_delay(header).stamp_s + late_s)
    return delays


class _Problem(NamedTuple):
    """Least-squares problem: delays `behind_s` (n,) in s with their `information` (n,) in s^-2, the `design` (n, p) of
    p parameters, and the `least` and the largest value (`most`) of each parameter (p,).
    """

    behind_s: Floats
    information: Floats
    design: Floats
    least: Floats
    most: Floats


class _Fit(NamedTuple):
    """Parameters (p,), and the sum of squared residuals, including the prior, in squared standard deviations."""

    parameters: Floats
    squares: float


class _SimulatedDelays(NamedTuple):
    """A trial: its delays, the parameters (p,) that give these delays, and the median (n,), in s, of the delays that
    are measured in its replicates.
    """

    delays: SignalDelays
    parameters: Floats
    seen_s: Floats


def _compare(
    campaign: Campaign,
    headers: Mapping[str, SensorHeader],
    late: Sequence[_LateStamps],
    trials: Sequence[DelayTrial],
) -> tuple[_Delays, list[_SimulatedDelays]]:
    """Return the delays of the sensors of one quantity in the recording, with their information reduced by the scatter
    of the replicates, and the trials with replicates that have the same number of delays; no trials if no motion
    determines a delay.
    """
    nominal_s = {name: _nominal_delay_s(header) for name, header in headers.items()}
    observed = _rows(_crosses(campaign), headers, nominal_s, late)
    simulated = []
    information = observed.information
    for delays, replicates in trials:
        seen_s = [_rows(_crosses(replicate), headers, nominal_s, late).delay_s for replicate in replicates]
        comparable = [delay_s for delay_s in seen_s if len(delay_s) == len(observed.delay_s)]
        if not comparable or not len(observed.delay_s):
            continue
        middle_s = np.median(comparable, axis=0)
        scatter_s = np.median(np.abs(comparable - middle_s), axis=0) / MEDIAN_ABSOLUTE
        information = np.fmin(information, observed.information / (1 + observed.information * scatter_s**2))
        simulated.append(_SimulatedDelays(delays, _parameters(delays, headers, nominal_s, late), middle_s))
    return observed._replace(information=information), simulated


def _problem(observed: _Delays, simulated: Sequence[_SimulatedDelays], late: Sequence[_LateStamps]) -> _Problem:
    """Return the problem of a step from the last trial. Its parameters are the ratio of the filter delays and the
    offset of each of the `late` stamps.
    """
    first, last = simulated[0], simulated[-1]
    design = observed.design
    if first is not last:
        slopes = _slopes(design, (first.parameters, first.seen_s), (last.parameters, last.seen_s))
        design = design * slopes[:, None]
    most = np.array([MOST_RATIO, *(stamps.most_s for stamps in late)])
    least = np.array([0.0, *(stamps.least_s for stamps in late)])
    behind_s = observed.delay_s - last.seen_s + design @ last.parameters
    return _Problem(behind_s, observed.information, design, least, most)


def _parameters(
    simulated: SignalDelays,
    headers: Mapping[str, SensorHeader],
    nominal_s: Mapping[str, float],
    late: Sequence[_LateStamps],
) -> Floats:
    """Return the parameters (p,) that give the delays `simulated` of the sensors of one quantity."""
    ratios = [simulated[name].filter_s / nominal_s[name] for name in headers if nominal_s[name] > 0]
    stamps_s = [simulated[name].stamp_s - stated_delay(header).stamp_s for name, header in headers.items()]
    usual = [stamps for stamps in late if not stamps.is_odd]
    are_late = np.array([[name in stamps.sensors for stamps in usual] for name in headers], float)
    offsets_s = np.linalg.lstsq(are_late, np.array(stamps_s))[0]
    return np.concatenate([[max(ratios, default=0.0)], offsets_s, np.zeros(len(late) - len(usual))])


def _truncate(delay_s: float) -> float:
    """Return the delay of a filter, 0 if it is negligible."""
    return delay_s if delay_s > _LEAST_S else 0.0


def can_fit_signal_delays(campaign: Campaign, headers: Mapping[str, SensorHeader], queued: Collection[str]) -> bool:
    """Return whether the box moves, and either sensors of one quantity differ in chip type or nominal delay, or a
    sensor has a queue or is compared with a track.
    """
    by_quantity: dict[str, set[tuple[str, float]]] = {}
    for header in headers.values():
        by_quantity.setdefault(header.quantity, set()).add((header.chip, _nominal_delay_s(header)))
    differ = any(len(kinds) > 1 for kinds in by_quantity.values())
    crosses = _crosses(campaign)
    return bool(crosses) and (differ or bool(queued) or bool(_tracked(crosses)))


def _nominal_delay_s(header: SensorHeader) -> float:
    """Return the delay of two poles at the configured cutoff, in s; 0 if the cutoff is unknown, or if the log states
    the delay.
    """
    if header.delay_ns:
        return 0.0
    cutoff_hz = noise_bandwidth_hz(header)
    return two_pole_cutoff_hz(cutoff_hz) if cutoff_hz > 0 else 0.0


class _LateStamps(NamedTuple):
    """Sensors whose readings may all be older than their time stamps by the same amount, between `least_s` and
    `most_s`. If `is_odd`, it is a single unit that is later than others of its type, which is a fault and not a
    nuisance quantity; `period_s` is the period of its data rate.
    """

    sensors: frozenset[str]
    most_s: float
    least_s: float
    is_odd: bool = False
    period_s: float = 0.0


def _late_stamps(
    crosses: Sequence[Cross], headers: Mapping[str, SensorHeader], queued: Collection[str]
) -> list[_LateStamps]:
    """Return the groups of these sensors whose time stamps may be wrong: all sensors that are compared with a track,
    each sensor with a queue, and the units of each chip type.
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


def _odd_units(headers: Mapping[str, SensorHeader], late: Sequence[_LateStamps]) -> list[_LateStamps]:
    """Return each unit that may be later than those with which it has a delay, or the ratio of the delay of its filter,
    in common. Early units are not considered: a reading can be old when it is stamped, but it is never taken after its
    stamp.
    """
    shared = {name for stamps in late if len(stamps.sensors) > 1 for name in stamps.sensors}
    filtered = {name for name, header in headers.items() if _nominal_delay_s(header) > 0}
    if len(filtered) >= FEWEST_UNITS:
        shared |= filtered
    return [
        _LateStamps(frozenset([name]), math.inf, 0.0, is_odd=True, period_s=1 / header.rate_hz)
        for name, header in headers.items()
        if name in shared and header.rate_hz > 0
    ]


def _tracked(crosses: Sequence[Cross]) -> dict[str, float]:
    """Return the sensors that are compared with a track, each with half of a window in s, which is at least the period
    of its rows.
    """
    return {name: cross.window_s / 2 for cross in crosses for name in cross.tracked}


def _crosses(campaign: Campaign) -> list[Cross]:
    """Return the joint moments of the phases in which the box moves."""
    return [part.cross for log in campaign.logs for part in log.phases if part.cross is not None and not part.is_still]


class _Delays(NamedTuple):
    """Delays (n,) of sensors' axes relative to the others in s, their information (n,) in s^-2, and their derivatives
    (n, p) with respect to the parameters, which are the ratio and the offsets of late stamps; nan if a delay is not
    determined.
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
    """Return the ratio (n,) of the change of measured delays between two trials, each with parameters (p,) and delays
    (n,), to the change that the design (n, p) predicts; 1 where the predicted change is negligible.
    """
    expected_s, change_s = design @ (after[0] - before[0]), after[1] - before[1]
    slopes = np.divide(change_s, expected_s, out=np.ones(len(design)), where=np.abs(expected_s) > _LEAST_CHANGE_S)
    return np.asarray(np.clip(np.nan_to_num(slopes, nan=1.0), *_SLOPES))


def _solve(problem: _Problem, chosen: Sequence[int]) -> _Fit:
    """Return the fit of the `chosen` parameters within their bounds to the delays; a parameter that no delay determines
    is 0.
    """
    known = np.isfinite(problem.behind_s) & np.isfinite(problem.information)
    weight = np.sqrt(problem.information[known])
    least, most = problem.least[chosen], problem.most[chosen]
    prior = np.diag(_PRIOR / np.maximum(np.abs(least), most))
    matrix = np.vstack([problem.design[known][:, chosen] * weight[:, None], prior])
    target = np.append(problem.behind_s[known] * weight, np.zeros(len(chosen)))
    solved = lsq_linear(matrix, target, bounds=(least, most))
    return _Fit(np.asarray(solved.x), 2 * float(solved.cost))

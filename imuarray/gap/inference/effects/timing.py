"""Effects on the times of readings: lags behind the motion of the other sensors; late, lost and repeated rows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.chips import CHIPS
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.evidence import SINGLE, Evidence, PhaseEvidence, Span, rarity_of_events, stretches
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.probes.motion import along, quadrature, residual
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import Phase
from imuarray.simulate.converters import EVEN_ONLY_FROM_HZ, code_span
from imuarray.simulate.effects.conversion import AdaptiveRange, OdrError
from imuarray.simulate.effects.readings import StaleSamples
from imuarray.simulate.effects.timing import ClockError, DroppedSamples, Jitter, Skew

ODD = 2.5
"""Score above which there is something to explain."""


class Lag(NamedTuple):
    """`lag_s` behind the other sensors, `at_s` after the log's epoch, in a motion of mean period 2 pi / `pace`;
    `weight` is the amount of motion. `lag_if_fast_s` is the lag if the motion is the faster one that changes as much
    from window to window: less than a quarter of its period is then resolved.
    """

    at_s: float
    lag_s: float
    pace: float
    weight: float
    lag_if_fast_s: float

    @property
    def is_large(self) -> bool:
        """True if the lag may be wrong by any number of periods."""
        return abs(self.lag_s * self.pace) > 1


def odd_lags(evidence: Evidence) -> list[Lag]:
    """Return the lag in each phase of motion if the lags are odd: by themselves, or because a sensor that is far behind
    shares none of the motion. Otherwise return [].
    """
    all_lags = list(lags(evidence))
    large = any(lag.is_large for lag in all_lags) and bool((evidence.score("motion_residual") > ODD).any())
    return all_lags if large or evidence.is_odd("motion_delay", beyond=ODD) else []


def mean_of(lags_seen: Sequence[Lag], name: str) -> float:
    """Return the mean of the field with this name, weighted by the amount of motion."""
    return float(np.average([getattr(lag, name) for lag in lags_seen], weights=[lag.weight for lag in lags_seen]))


def lags(evidence: Evidence) -> Iterator[Lag]:
    """Yield the lag in each phase of motion, averaged over the axes by their motion. The gain of an axis is computed
    from its own motion alone: a rotation about a single axis does not determine the response of an axis to all three.
    """
    usual_s, share = _usual_of(evidence, "motion_delay", 0.0), _usual_of(evidence, "motion_along", 1.0)
    share = np.where(share > 0, share, np.nan)
    sensor = evidence.header.name
    for phase, cross in motions(evidence):
        rate, weight = _pace(cross, sensor)
        pace = np.arcsin(np.minimum(rate * cross.window_s, 1.0)) / cross.window_s
        angle = np.arctan2(rate * (quadrature(cross, sensor) - usual_s), along(cross, sensor) / share)
        known = np.isfinite(angle / pace) & (weight > 0)
        if known.any():
            middle_s = (phase.start_ns + phase.end_ns) * 0.5e-9
            fast_pace = np.pi / cross.window_s - pace
            lag_s, mean_pace, lag_if_fast_s = (
                float(np.average(item[known], weights=weight[known]))
                for item in (angle / pace, pace, angle / fast_pace)
            )
            yield Lag(middle_s, lag_s, mean_pace, float(weight[known].sum()), lag_if_fast_s)


def motions(evidence: Evidence) -> Iterator[tuple[Phase, Cross]]:
    """Yield the phases in which the box moves, with the mean products of the readings of the sensors in them."""
    for phase in evidence.phases:
        cross = None if phase.is_still else phase.cross
        if cross is not None and any(item.name == evidence.header.name for item in cross.sensors):
            yield phase.raw.phase, cross


def speed_squared(cross: Cross, sensor: str) -> Floats:
    """Return (3,) mean square of the change of readings per second, squared units."""
    return np.asarray(np.diag(cross.changes)[cross.columns(sensor)] / cross.window_s**2)


def _pace(cross: Cross, sensor: str) -> tuple[Floats, Floats]:
    """Return (3,) rms change per second relative to the rms of the signal, 1/s, and the mean square of the change per
    second.
    """
    speed = speed_squared(cross, sensor)
    square = np.diag(cross.fast)[cross.columns(sensor)]
    ratio = np.divide(speed, square, out=np.full(3, np.nan), where=(square > 0) & (speed > 0))
    return np.sqrt(ratio), speed


def _usual_of(evidence: Evidence, probe: str, otherwise: float) -> Floats:
    """Return (3,) the model's value of a probe, as the median over phases; `otherwise` without any."""
    rows = evidence.expected.get(probe, np.zeros((0, 3)))
    known = rows[np.isfinite(rows).all(axis=1)]
    return np.asarray(np.median(known, axis=0)) if len(known) else np.full(3, otherwise)


def repeated_share(evidence: Evidence) -> float:
    """Return the probability that a row that would be new is a repetition, beyond the model's, as the median over
    phases; negative if repetitions are missing.
    """
    shares = [_share_of_repeats(phase.raw) for phase in evidence.phases if phase.raw.rows > phase.raw.repeats.longest]
    usual = _usual_shares(evidence)
    chance = float(np.median(usual)) if len(usual) else 0.0
    return (float(np.median(shares)) - chance) / (1 - chance) if shares and chance < 1 else 0.0


def _share_of_repeats(summary: Summary) -> float:
    """Return the share of rows that repeat the one before, without the longest run, which may be due to a chip that
    hung.
    """
    repeats = summary.repeats
    longest = repeats.longest - 1
    return (repeats.repeat_share * (summary.rows - 1) - longest) / max(summary.rows - 1 - longest, 1)


def _usual_shares(evidence: Evidence) -> Floats:
    """Return the model's shares (m,) of rows that repeat the one before, where they are known."""
    expected = evidence.expected.get("repeats", np.zeros((0, 1)))
    return np.asarray(np.sin(expected[np.isfinite(expected)]) ** 2)


def repeated_rows(summaries: Iterable[Summary]) -> float:
    """Return the number of rows that repeat the one before."""
    return sum(float(np.nan_to_num(summary.repeats.repeat_share)) * summary.rows for summary in summaries)


_HELD_ROWS = 3
"""Largest number of equal successive rows that does not indicate a chip that hung."""


def _share_of_rare_repeats(evidence: Evidence) -> float:
    """Return the probability of a repetition, beyond the model's, over the rows of all phases without a run of more
    than `_HELD_ROWS` equal rows.
    """
    phases = [phase.raw for phase in evidence.phases if phase.raw.repeats.longest <= _HELD_ROWS]
    rows, usual = sum(phase.rows for phase in phases), _usual_shares(evidence)
    chance = float(np.mean(usual)) if len(usual) else 0.0
    return (repeated_rows(phases) / rows - chance) / (1 - chance) if rows and chance < 1 else 0.0


_MOST_PPM = 2e5
_FURTHER = (1.0, -1.0, 3.0, -3.0)
"""Factors of a clock error that are tried if the lag is so large that its sign and period are not determined."""

_FLOOR_S = 1e-3
"""Scatter of the lags of polled sensors in addition to that of noise: the age of readings varies."""

_TELLING = 10.0
"""Nats of the lags that a rate, or its change, must explain."""

_WARM_UPS = 24
_SHORTEST_S, _FEWEST_LAGS = 2.0, 3


def guess_clock_error(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a clock error by the growth of the lag from the log's epoch on; a sensor that is ahead has a positive
    error. The host's clock has a constant rate, or a rate that settles. The lag at the epoch, which is due to filters
    and to the age of readings, is not part of it.
    """
    yield from _clock_of_host(evidence)
    lags_seen = odd_lags(evidence)
    at_s, lag_s, _, weight, _ = np.array(lags_seen).reshape(-1, 5).T
    square = float(weight @ at_s**2)
    if not square > 0:
        return
    error_ppm = -1e6 * float((weight * at_s) @ lag_s) / square
    for factor in _FURTHER if any(lag.is_large for lag in lags_seen) else (1.0,):
        yield Hypothesis((ClockError(float(np.clip(factor * error_ppm, -_MOST_PPM, _MOST_PPM))),), ("error_ppm",))


def _clock_of_host(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest an error of the host's clock, by which all sensors lag alike, polled or not.

    Lags are those of whole logs. The statistics show a clock error in phases whose motion begins or ends too early.
    These may lie in both parts of the data or in one, so the hypothesis needs both parts.
    """
    host_lags = [lag for host in evidence.hosts for lag in host.lags]
    if len(host_lags) < _FEWEST_LAGS:
        return
    at_s, lag_s, error_s = np.array(host_lags).T
    weight = 1 / np.hypot(error_s, _FLOOR_S)
    still, steady = _fit_lags([np.ones_like(at_s)], lag_s, weight), _steady(at_s, lag_s, weight)
    if still.nats - steady.nats > _TELLING and abs(steady.ppm[0]) < _MOST_PPM:
        yield from _of_all_sensors(evidence, ClockError(steady.ppm[0]), ("error_ppm",), at_s, weight)
    longest_s = float(np.ptp(at_s))
    settling = [
        (_settling(at_s, lag_s, weight, warm_up_s), warm_up_s)
        for warm_up_s in np.geomspace(_SHORTEST_S, max(longest_s, 2 * _SHORTEST_S), _WARM_UPS).tolist()
    ]
    best, warm_up_s = min(settling, key=lambda lag: lag[0].nats)
    if min(still.nats, steady.nats) - best.nats > _TELLING and max(map(abs, best.ppm)) < _MOST_PPM:
        effect = ClockError(best.ppm[0], best.ppm[1], warm_up_s)
        yield from _of_all_sensors(evidence, effect, ("error_ppm", "warm_up_ppm"), at_s, weight)


def _of_all_sensors(
    evidence: Evidence, clock: ClockError, free: tuple[str, ...], at_s: Floats, weight: Floats
) -> Iterator[Hypothesis]:
    """Suggest the clock's error in all sensors. A delay that was fitted to the lags without the clock error includes
    the mean lag of the clock. If a delay is fitted, also suggest the error with this mean subtracted.
    """
    yield Hypothesis((clock,), free, shared=True, everywhere=True, whole=True)
    if evidence.fitted.delay.stamp_s:
        warm_up_s = -clock.warm_up_s * np.expm1(-at_s / clock.warm_up_s)
        early_s = 1e-6 * (clock.error_ppm * at_s + clock.warm_up_ppm * warm_up_s)
        effects = (clock, Skew(float(np.average(early_s, weights=weight**2))))
        yield Hypothesis(effects, (*free, "delay_s"), shared=True, everywhere=True, whole=True)


class _ClockFit(NamedTuple):
    """`ppm` of the columns after the first, which is the lag at the epoch; `nats` that remain."""

    ppm: tuple[float, ...]
    nats: float


def _steady(at_s: Floats, lag_s: Floats, weight: Floats) -> _ClockFit:
    return _fit_lags([np.ones_like(at_s), at_s], lag_s, weight)


def _settling(at_s: Floats, lag_s: Floats, weight: Floats, warm_up_s: float) -> _ClockFit:
    return _fit_lags([np.ones_like(at_s), at_s, -warm_up_s * np.expm1(-at_s / warm_up_s)], lag_s, weight)


def _fit_lags(columns: list[Floats], lag_s: Floats, weight: Floats) -> _ClockFit:
    """Fit the columns to the lag. A log whose clock is fast lags, and its error is negative."""
    design = np.stack(columns, axis=1) * weight[:, None]
    coefficients = np.linalg.lstsq(design, lag_s * weight, rcond=None)[0]
    residuals = lag_s * weight - design @ coefficients
    return _ClockFit(tuple((-1e6 * coefficients[1:]).tolist()), float(residuals @ residuals) / 2)


_HARDLY_RESOLVED = 0.2
"""Least ratio of the two periods of a motion, faster and slower than four windows, that changes as much from window to
window, for which both are plausible.
"""

_RARITY_AHEAD = 6.0
"""Nats by which a reading that is measured after its time stamp is rarer than one that is old when it is stamped. Of
two sensors that differ, the one behind is late, rather than the other one early.
"""


def guess_skew(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the mean lag; if it is large, also a lag that differs by a period, and if windows hardly resolve the
    motion, the lag in a motion that is faster than they show.
    """
    lags_seen = odd_lags(evidence)
    if not lags_seen:
        return
    lag_s, pace = mean_of(lags_seen, "lag_s"), mean_of(lags_seen, "pace")
    delays_s = [lag_s]
    if any(lag.is_large for lag in lags_seen):
        delays_s.append(lag_s - math.copysign(2 * math.pi / pace, lag_s))
    lag_if_fast_s = mean_of(lags_seen, "lag_if_fast_s")
    if abs(lag_if_fast_s) > _HARDLY_RESOLVED * abs(lag_s):
        delays_s.append(lag_if_fast_s)
    for delay_s in delays_s:
        yield Hypothesis((Skew(delay_s),), ("delay_s",), rarity=_RARITY_AHEAD if delay_s < 0 else 0.0)


_LEAST_REPEATED, _MOST_LATE = 1e-4, 0.9

_HOST_PROBES = ("repeats", "stale", "longest_repeat", "motion_residual", "motion_delay", "gaps", "lost", "interval")
_RARITY_BEHIND = 3.0
"""Nats by which a wait between a transfer and the reading of the clock is rarer than a wait before the transfer: each
byte of a transfer is another occasion to wait.
"""


def guess_jitter(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the rms lateness that explains the residual variance by the rate of change of the readings, and the share
    of late rows that explains both this and the repetitions.
    """
    if evidence.is_odd(*_HOST_PROBES):
        yield from _jitter_of_host(evidence)
    rms_s = _rms_s(evidence) if (evidence.score("motion_residual") > 2.5).any() else 0.0
    if rms_s > 0:
        yield Hypothesis((Jitter(rms_s),), ("rms_s",))
    repeated = repeated_share(evidence) if evidence.is_odd("repeats", "stale") else 0.0
    if repeated > _LEAST_REPEATED:
        yield from late(repeated, rms_s, 1 / evidence.rows_per_s, evidence.header.rate_hz)


def _jitter_of_host(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the waits of the host, before or after a transfer, as the jitter of every sensor."""
    waits = sum(host.waits for host in evidence.hosts)
    if not waits and not any(host.missed for host in evidence.hosts):
        return
    rms_s = float(np.sqrt(sum(host.square_s2 for host in evidence.hosts) / max(waits, 1)))
    share = min(waits / sum(host.rows for host in evidence.hosts), 1.0)
    for sign in (1.0, -1.0):
        effect = Jitter(rms_s, share, sign)
        yield Hypothesis((effect,), shared=True, everywhere=True, rarity=0.0 if sign > 0 else _RARITY_BEHIND)


def late(repeated: float, rms_s: float, row_s: float, rate_hz: float) -> Iterator[Hypothesis]:
    """Suggest the lateness of a chip of `rate_hz` that is read every `row_s` and repeats a share `repeated` of its
    readings. A reading is repeated if it is late by more than the time between rows less the elapsed part of a period.
    Together with `rms_s` of all rows the share determines the mean lateness; without it, one row is assumed.
    """
    if rate_hz <= 0:
        return
    mean_s = row_s * np.geomspace(0.05, 1.5, 60)
    wait_s = np.maximum(row_s - np.linspace(0, 1, 21) / rate_hz, 0.0)
    share = repeated / np.exp(-wait_s / mean_s[:, None]).mean(axis=1)
    apart = np.abs(np.log(2 * share * mean_s**2 / rms_s**2)) if rms_s > 0 else np.abs(np.log(mean_s / row_s))
    best = int(np.argmin(np.where(share < _MOST_LATE, apart, np.inf)))
    if share[best] < _MOST_LATE:
        guess = Jitter(float(np.sqrt(2) * mean_s[best]), float(share[best]))
        yield Hypothesis((guess,), ("rms_s", "share"), limits={"share": (0.0, _MOST_LATE)})


def _rms_s(evidence: Evidence) -> float:
    """Return the rms lateness of all rows in s, by the residual of motion; 0 without an excess."""
    name, usual = evidence.header.name, _usual_variance(evidence)
    excess = speed = 0.0
    for _, cross in motions(evidence):
        rows = max(cross.window_s * evidence.rows_per_s, 1.0)
        beyond = np.maximum(np.exp(residual(cross, name)) - usual, 0.0)
        excess += float(np.nansum(beyond * rows))
        speed += float(np.nansum(speed_squared(cross, name)))
    return float(np.sqrt(excess / speed)) if excess > 0 and speed > 0 else 0.0


def _usual_variance(evidence: Evidence) -> Floats:
    """Return (3,) the model's residual variance of a window's mean in motion, in squared units; the probe is relative
    to the noise.
    """
    rows = evidence.expected["motion_residual"]
    known = rows[np.isfinite(rows).all(axis=1)]
    return np.asarray(np.exp(np.median(known, axis=0)) * evidence.noise**2) if len(known) else np.zeros(3)


_GAP_PROBES = ("gaps", "skips", "lost", "longest_interval", "irregularity", "interval")


def guess_dropped_samples(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the share of rows that are lost and the length of the losses. If the losses are few, also suggest exactly
    those that the log reports, because a random process loses others, in other phases.
    """
    if not evidence.is_odd(*_GAP_PROBES):
        return
    yield from _rows_lost_alone(evidence)
    rows = sum(phase.raw.rows for phase in evidence.phases)
    holes = [hole for phase in evidence.phases for hole in evidence.holes if _is_within(hole, phase)]
    bursts, lost, longest = _known_losses(holes, evidence) if holes else _losses_by_intervals(evidence)
    if not bursts:
        return
    burst_rows = float(np.clip(lost / bursts, 1.0, max(longest, 1.0)))
    lost = bursts * burst_rows
    probability = min(lost / (rows + lost), 0.9 * burst_rows / (burst_rows + 1))
    yield Hypothesis((DroppedSamples(probability, burst_rows),), ("probability", "burst_rows")[: 1 + (longest > 1.5)])


class _Losses(NamedTuple):
    """The number of `bursts`, the rows lost in all of them and in the longest one."""

    bursts: int
    rows: float
    longest: float


def _is_within(hole: Span, phase: PhaseEvidence) -> bool:
    compared = phase.raw.phase
    return hole.log == phase.log and compared.start_ns <= 1e9 * hole.moment_s < compared.end_ns


def _known_losses(holes: Sequence[Span], evidence: Evidence) -> _Losses:
    """Return the losses in the holes. Other long intervals, such as stalls of the recorder, are not losses."""
    lost = np.maximum(np.rint(np.array([hole.length_s for hole in holes]) / _interval_s(evidence)), 1.0)
    return _Losses(len(lost), float(lost.sum()), float(lost.max()))


def _losses_by_intervals(evidence: Evidence) -> _Losses:
    """Return the losses by long intervals, flagged or not, and by the number of rows that are missing."""
    summaries = [phase.raw for phase in evidence.phases if phase.raw.rows]
    interval_s = _interval_s(evidence)
    bursts = sum(max(summary.intervals.gaps, summary.flags["lost_before"]) for summary in summaries)
    due = sum((summary.phase.end_ns - summary.phase.start_ns) * 1e-9 / interval_s for summary in summaries)
    longest = max((float(np.nan_to_num(summary.intervals.longest_s)) for summary in summaries), default=0.0)
    return _Losses(bursts, due - sum(summary.rows for summary in summaries), longest / interval_s - 1)


def _rows_lost_alone(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest exactly the rows that the log reports as lost."""
    holes = evidence.holes
    if not 0 < len(holes) <= SINGLE:
        return
    yield Hypothesis((DroppedSamples(**stretches(holes)),), whole=True, rarity=rarity_of_events(len(holes)))


def _interval_s(evidence: Evidence) -> float:
    """Return the interval between rows if none is lost, in s: the model's, or else the mean one."""
    rows = evidence.expected.get("interval", np.zeros((0, 1)))
    known = rows[np.isfinite(rows)]
    return float(np.exp(np.median(known))) if len(known) else 1 / evidence.rows_per_s


_REPEATS = ("repeats", "stale", "longest_repeat")
_NEAR_RATE = 0.15
"""Largest relative difference from an allowed rate: the oscillator's tolerance, and the error of the share of repeats.
"""

_LEAST_RATIO = 1e-3
_FEW_ODD = 0.01
_OSCILLATOR = 0.1
_RARITY_OF_RATE, _RARITY_OF_CLOCK = 3.0, 1.0
"""Nats of a rate to which the chip cannot be set, since its oscillator is off by a tenth at most; and of a wrong
oscillator in a chip that can be set to no other rate, for which it is the only cause of a wrong rate.
"""


def guess_odr_error(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest rates to which the chip can be set, or the measured rate; likewise for bandwidths."""
    if evidence.is_odd(*_REPEATS):
        yield from _by_repeats(evidence)
    else:
        yield from _by_age(evidence)
    if evidence.header.chip == "adxl345" and evidence.is_odd("odd_codes", "absent_codes"):
        yield from _by_even_codes(evidence)
    if evidence.is_odd("noise") and not evidence.is_odd(*_REPEATS):
        yield from _by_noise(evidence)


def _by_repeats(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a rate below the poll's by the number of new readings per second. If repeats are missing, the rate is
    higher than configured: suggest the two rates next above the poll's, because higher ones cannot be distinguished.
    """
    rows_hz, allowed = evidence.rows_per_s, _rates_hz(evidence)
    repeated, configured_hz = repeated_share(evidence), evidence.header.rate_hz
    most_hz = min(rows_hz, configured_hz) if configured_hz else rows_hz
    real_hz = (1 - repeated) * most_hz
    if repeated > _LEAST_RATIO:
        near = [rate for rate in allowed if rate < most_hz and abs(real_hz / rate - 1) < _NEAR_RATE]
        for rate in sorted(near, key=lambda rate: abs(real_hz / rate - 1))[:1]:
            yield Hypothesis((OdrError(rate),))
        is_setting = any(abs(real_hz / rate - 1) < _OSCILLATOR for rate in allowed)
        yield Hypothesis((OdrError(real_hz),), ("rate_hz",), rarity=0.0 if is_setting else _RARITY_OF_RATE)
        if not is_setting and code_span(evidence.header).step != 1:  # the codes show which rate is set
            yield from _by_clock(evidence, real_hz)
    elif repeated < -_LEAST_RATIO:
        for rate in [rate for rate in allowed if rate >= rows_hz][:2]:
            yield Hypothesis((OdrError(rate),))


def _by_age(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a rate above the poll's, so that no row repeats, and below the configured one, so that readings are half
    a period old. Either the chip is set to the slower rate, or its oscillator is slow: then the codes are those of the
    configured rate.
    """
    lags_seen = odd_lags(evidence)
    if not lags_seen:
        return
    lag_s = mean_of(lags_seen, "lag_s")
    configured_hz = evidence.header.rate_hz
    age_s = lag_s + (0.5 / configured_hz if configured_hz else 0.0)
    if lag_s <= 0 or age_s >= 0.5 / evidence.rows_per_s:
        return
    real_hz = 0.5 / age_s
    near = [rate for rate in _rates_hz(evidence) if abs(real_hz / rate - 1) < _NEAR_RATE and rate > evidence.rows_per_s]
    for rate in sorted(near, key=lambda rate: abs(real_hz / rate - 1))[:1]:
        yield Hypothesis((OdrError(rate),))
    yield from _by_clock(evidence, real_hz)


def _by_clock(evidence: Evidence, real_hz: float) -> Iterator[Hypothesis]:
    """Suggest this rate with an oscillator that is slower than nominal; for a chip without a configured rate, suggest
    the rate itself.
    """
    configured_hz = evidence.header.rate_hz
    if not configured_hz:
        yield Hypothesis((OdrError(real_hz),), ("rate_hz",), rarity=_RARITY_OF_RATE)
    elif _LEAST_RATIO < real_hz / configured_hz < 1:
        rarity = _RARITY_OF_RATE if _rates_hz(evidence) else _RARITY_OF_CLOCK
        yield Hypothesis((OdrError(clock_ratio=real_hz / configured_hz),), ("clock_ratio",), rarity=rarity)


def _by_even_codes(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest another rate if codes are even, which they are from 1600 Hz on (ADX-47), or if even codes are expected
    and do not occur.
    """
    codes = [histogram for item in evidence.phases for histogram in item.raw.codes]
    odd = sum(int(histogram.counts[histogram.codes % 2 == 1].sum()) for histogram in codes)
    total = sum(int(histogram.counts.sum()) for histogram in codes)
    is_even, expected_even = odd < _FEW_ODD * total, code_span(evidence.header).step == 2
    if is_even == expected_even:
        return
    allowed = _rates_hz(evidence)
    fast = [rate for rate in allowed if rate >= EVEN_ONLY_FROM_HZ]
    slow = [rate for rate in reversed(allowed) if rate < EVEN_ONLY_FROM_HZ]
    for rate in (fast if is_even else slow)[:2]:
        yield Hypothesis((OdrError(rate),))


def _by_noise(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a bandwidth by the variance. A noise that is fitted shows no difference."""
    header, spec = evidence.header, CHIPS.get(evidence.header.chip)
    ratio = math.exp(2 * float(np.median(evidence.typical("noise"))))
    if spec is None or not header.bandwidth_hz:
        return
    wanted_hz = ratio * header.bandwidth_hz
    others = [width for width in spec.allowed_bandwidths_hz(header.rate_hz) if width != header.bandwidth_hz]
    others.sort(key=lambda width: abs(math.log(width / wanted_hz)))
    if others and abs(math.log(others[0] / wanted_hz)) < abs(math.log(ratio)):
        yield Hypothesis((OdrError(bandwidth_hz=others[0]),))


def _rates_hz(evidence: Evidence) -> list[float]:
    """Return the rates to which the chip can be set, ascending, without the configured one."""
    spec = CHIPS.get(evidence.header.chip)
    return sorted(rate for rate in (spec.rates_hz if spec else ()) if rate != evidence.header.rate_hz)


_STALE_PROBES = ("repeats", "repeats_in_all", "stale", "longest_repeat", "lag_1")
_MOST_STALE = 0.95
_FEWEST_BURSTS, _LEAST_BURST = 3, 1.5
"""Fewest stretches of two or more repetitions that are bursts, and the least mean number of rows of all repetitions."""


def guess_stale_samples(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the share of repetitions beyond the model's, and bursts of their mean length. If most phases have none,
    the share is that of all phases together.
    """
    if not evidence.is_odd(*_STALE_PROBES):
        return
    probability = repeated_share(evidence)
    if probability <= _LEAST_REPEATED:
        probability = _share_of_rare_repeats(evidence)
    if probability > _LEAST_REPEATED:
        yield Hypothesis((StaleSamples(min(probability, _MOST_STALE)),), ("probability",))
    yield from _bursts(evidence)


def _bursts(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest repetitions in bursts, by those of two or more rows and by the single ones beyond the model's."""
    rows = sum(phase.raw.rows for phase in evidence.phases)
    repeated, usual = repeated_rows(phase.raw for phase in evidence.phases), _usual_shares(evidence)
    lacking = repeated - rows * float(np.median(usual)) if len(usual) else repeated
    bursts = [repetition.rows for repetition in evidence.repeated if _is_in_a_phase(evidence, repetition.span)]
    if len(bursts) < _FEWEST_BURSTS or not rows:
        return
    single = max(lacking - sum(bursts), 0.0)
    length = (sum(bursts) + single) / (len(bursts) + single)
    probability = (sum(bursts) + single) / rows
    if length > _LEAST_BURST and _LEAST_REPEATED < probability < _MOST_STALE:
        yield Hypothesis(
            (StaleSamples(probability, length),), ("probability", "rows"), limits={"rows": (1.0, math.inf)}
        )


def _is_in_a_phase(evidence: Evidence, span: Span) -> bool:
    """Return whether a span begins in one of the phases; these may be half of the log's."""
    phases = [phase.raw.phase for phase in evidence.phases if phase.log == span.log]
    return any(phase.start_ns <= span.moment_s * 1e9 < phase.end_ns for phase in phases)


_THRESHOLD_DPS, _HOLD_S = 100.0, 0.0015
"""Rate near which the chip changes its range, and the time for which it then delivers no new reading (TDK-18)."""


def guess_adaptive_range(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the rate and the time of the erratum, if rows repeat in motion."""
    moves = any(not phase.is_still for phase in evidence.phases)
    if moves and evidence.is_odd("repeats", "longest_repeat"):
        yield Hypothesis((AdaptiveRange(_THRESHOLD_DPS, _HOLD_S),), ("hold_s",))

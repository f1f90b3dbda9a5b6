"""Effects on the noise of readings.

A filter reduces noise; a reading that is merely late does not. The noise of a sensor is fitted, so no statistic shows
its size. The figure of the data sheet is typical: units differ from it by a third, and many have additional noise from
other sources. The prior of a unit's noise is therefore heavy-tailed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from imuarray.arrays import Booleans, Floats, triple
from imuarray.characterise.spectrum import Spectrum
from imuarray.gap.inference.effects.candidate import Hypothesis, with_removal
from imuarray.gap.inference.effects.levels import Onset, onsets
from imuarray.gap.inference.effects.timing import mean_of, odd_lags
from imuarray.gap.inference.evidence import (
    ALWAYS,
    SAME_RATE,
    Evidence,
    PhaseEvidence,
    Span,
    When,
    in_logs,
    join_spans,
    since,
)
from imuarray.gap.model.base_model import FittedParameters
from imuarray.gap.model.populations import printed_noise
from imuarray.gap.statistics.lines import HALF_WIDTH, highest_lines, pool_spectra, shown_hz, unaliased_hz
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bandwidth import Bandwidth, two_pole_cutoff_hz
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.model import noise_bandwidth_hz
from imuarray.simulate.signal import Triple

_NOISE_SCATTER, _NOISE_TAIL = 0.3, 4.0
"""Standard deviation of the log of a unit's noise relative to the printed noise, and the degrees of freedom of its
tail.
"""

_OF_TWO_POLES = math.pi / (2 * math.sqrt(2))
"""Noise bandwidth of a Butterworth filter with two poles, as a multiple of its cutoff."""

BEYOND = 3.0
"""Standard deviations from which on the noise of a log differs from the noise that was fitted to all logs."""

_LEAST_ELEMENT = 0.1
"""Least share of the noise that is attributed to the element, after the rounding noise is subtracted."""


class NoiseOfLogs(NamedTuple):
    """The numbers of the `noisy` and the `quiet` logs, and the log (3,) of the noise of each group relative to the
    fitted noise.
    """

    noisy: tuple[int, ...]
    quiet: tuple[int, ...]
    more: Floats
    less: Floats


def noise_of_logs(evidence: Evidence) -> NoiseOfLogs | None:
    """Divide the logs by their noise; None if all have the fitted noise. The fitted noise is the median of all logs,
    so it is that of the larger group.
    """
    logs = sorted({phase.log for phase in evidence.still})
    alone = {log: evidence.within([log]) for log in logs}
    noisy = tuple(log for log in logs if alone[log].score("noise").max() > BEYOND)
    noisy = noisy or tuple(log for log in logs if alone[log].score("noise").min() > -BEYOND)
    if not 0 < len(noisy) < len(logs):
        return None
    quiet = tuple(log for log in logs if log not in noisy)
    more, less = (np.median([alone[log].typical("noise") for log in side], axis=0) for side in (noisy, quiet))
    return NoiseOfLogs(noisy, quiet, np.asarray(more), np.asarray(less))


def with_noise(evidence: Evidence, log_ratio: Floats) -> FittedParameters:
    """Return the fitted parameters with a noise that is multiplied by exp(`log_ratio`) (3,); the rounding noise
    stays.
    """
    square = evidence.noise**2 * np.exp(2 * log_ratio)
    rounding = evidence.noise**2 - np.square(evidence.fitted.rms)
    return replace(evidence.fitted, rms=triple(np.sqrt(np.maximum(square - rounding, _LEAST_ELEMENT**2 * square))))


def cutoff_that_passes(evidence: Evidence, share: float) -> float:
    """Return the cutoff in Hz of a two-pole low-pass that passes this share of the rms of the chip's noise; 0 if
    unknown.
    """
    return share**2 * noise_bandwidth_hz(evidence.header) / _OF_TWO_POLES


def rarity_behind(evidence: Evidence, cutoff_hz: float) -> float:
    """Return the nats by which the sensor's noise is rarer with a low-pass of two poles than without it: negative if
    the noise is as much below the printed noise as the filter makes it, positive if it is not. 0 if the filter passes
    as much as the chip's own filter, or if no noise is printed.
    """
    passed_share, log_ratio = passed_by(evidence, cutoff_hz), quietness(evidence)
    return (
        0.0 if log_ratio is None else _rarity_of_noise(log_ratio - math.log(passed_share)) - _rarity_of_noise(log_ratio)
    )


def quietness(evidence: Evidence) -> float | None:
    """Return the log of the fitted noise relative to the printed one, averaged over the axes that have noise; None if
    no noise is printed.
    """
    printed = printed_noise(evidence.header)
    if printed is None:
        return None
    pairs = zip(evidence.fitted.rms, printed, strict=True)
    known = [math.log(rms / typical) for rms, typical in pairs if rms > 0 and typical > 0]
    return sum(known) / len(known) if known else None


def passed_by(evidence: Evidence, cutoff_hz: float) -> float:
    """Return the share of the rms of the chip's noise that a two-pole low-pass passes."""
    own_hz = noise_bandwidth_hz(evidence.header)
    return math.sqrt(min(1.0, _OF_TWO_POLES * cutoff_hz / own_hz)) if own_hz > 0 else 1.0


def _rarity_of_noise(apart: float) -> float:
    """Return the nats by which a unit's noise is rarer than typical noise, if their log ratio is `apart`."""
    return (_NOISE_TAIL + 1) / 2 * math.log1p((apart / _NOISE_SCATTER) ** 2 / _NOISE_TAIL)


_GROWN = 0.1
"""Log of the ratio of the noise after a moment to the noise before it, from which on the noise has grown."""


def guess_white_noise(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest noise that explains the residual of a motion, which the other sensors do not explain, if the sensor was
    never at rest. Otherwise the noise is fitted and cannot be too large everywhere, unless it was fitted to an earlier
    recording: suggest the excess of some logs, or of a spell, over the rest.
    """
    if not evidence.is_refitted:
        yield from _noise_since(evidence)
    if any(evidence.fitted.rms):
        yield from _more_noise(evidence)
        if not evidence.when.spans:
            yield from _from_a_moment(evidence)
    elif evidence.is_odd("motion_residual", beyond=BEYOND):
        yield from _noise_in_motion(evidence)


def _more_noise(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest more noise at some times. The noise of the rest is smaller than the fitted noise, which may lie
    between.
    """
    if evidence.when.spans:
        if evidence.score("noise").max() > BEYOND:
            yield from _grown(evidence, evidence.typical("noise"), np.zeros(3), ALWAYS)
    elif (logs := noise_of_logs(evidence)) is not None:
        yield from _grown(evidence, logs.more, logs.less, in_logs(logs.noisy))


def _grown(evidence: Evidence, more: Floats, less: Floats, when: When) -> Iterator[Hypothesis]:
    """Suggest the excess of the larger noise over the smaller one; (3,) each as the log of its ratio to the fitted
    noise.
    """
    larger, usual = (evidence.noise**2 * np.exp(2 * side) for side in (more, less))
    rms = np.sqrt(np.maximum(np.nan_to_num(larger - usual), 0.0))
    if rms.any():
        yield Hypothesis((WhiteNoise(triple(rms)),), ("rms",), fitted=with_noise(evidence, less)).at(when)


def _from_a_moment(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest noise that grew within a log, even if its phases at rest are too short for spells: in this log alone or
    also in the later logs with the same noise; or in all logs with the same noise, because the dates of logs need not
    follow the clock of the effect.
    """
    for onset in onsets(evidence)[:1]:
        before, after = (
            np.log(noise / evidence.noise) for noise in (onset.states.noise_before, onset.states.noise_after)
        )
        is_larger = after - before > _GROWN
        first, noisy = Span(onset.log, onset.onset_s, math.inf), _as_noisy(evidence, onset, is_larger)
        later = [log for log in noisy if log > onset.log]
        whens = [since(first, later) if later else When((first,))]
        if later != noisy:
            whens.append(join_spans([When((first,)), in_logs(noisy)]))
        for when in whens:
            yield from _grown(evidence, np.where(is_larger, after, before), before, when)


def _as_noisy(evidence: Evidence, onset: Onset, grown: Booleans) -> list[int]:
    """Return the other logs whose noise on the `grown` axes is nearer to that after the moment than to that before
    it.
    """
    middle = np.log(onset.states.noise_before * onset.states.noise_after) / 2
    logs = sorted({phase.log for phase in evidence.still} - {onset.log})
    level = {log: np.log(evidence.noise) + evidence.within([log]).typical("noise") for log in logs}
    return [log for log in logs if ((level[log] - middle)[grown] > 0).all()]


def _noise_in_motion(evidence: Evidence) -> Iterator[Hypothesis]:
    moving = [phase.cross for phase in evidence.phases if not phase.is_still and phase.cross is not None]
    window_rows = max(moving[0].window_s * evidence.rows_per_s, 1.0) if moving else 1.0
    variance = evidence.noise**2 * np.exp(np.nanmedian(evidence.values["motion_residual"], axis=0))
    yield Hypothesis((WhiteNoise(triple(np.sqrt(np.nan_to_num(variance) * window_rows))),), ("rms",))


def _noise_since(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a noise that has changed since the earlier recording, on the axes on which it is odd."""
    if not any(evidence.fitted.rms) or not evidence.is_odd("noise", beyond=BEYOND):
        return
    ratio = np.where(np.abs(evidence.score("noise")) > BEYOND, np.exp(evidence.typical("noise")), 1.0)
    rounding = evidence.noise**2 - np.square(evidence.fitted.rms)
    x, y, z = np.sqrt(np.maximum((ratio * evidence.noise) ** 2 - rounding, 0.0)).tolist()
    without = replace(evidence.fitted, rms=(0.0, 0.0, 0.0))
    yield Hypothesis((WhiteNoise((x, y, z)),), ("rms",), removed=WhiteNoise.name, fitted=without)


_LOW_PASS_TRACES = ("lag_1", "lag_2", "lag_3", "allan_2", "allan_8", "band_5", "band_6", "band_1", "noise_excess")
_BEYOND = 2.7
_LEAST_CORRELATION, _MOST_CORRELATION = 0.01, 0.995
"""Correlations of successive rows outside of which no low-pass is inferred."""

_CUTOFFS_ALIKE = 1.3
_LEAST_CUTOFF_HZ = 0.01
"""Lowest cutoff of the effect: correlations that last longer, in slow rows, are those of a wander."""

_OF_SPELL = ("cutoff_hz", "noise_share")
_QUIET = 0.7
"""Largest share of the rms that a filter leaves: half of the power, as with half the bandwidth."""
_MOST_NOISE = 10.0
_UNSEEN = 0.3
"""Correlation of successive rows from which on they determine the cutoff themselves."""

_NOTHING_LEFT = 0.75 * math.pi
"""Time constants at which the correlation of noise behind two poles is 0 for the first time."""


_TWO_POLES = Bandwidth(1.0, poles=2.0)
"""The filter that is assumed unless correlations show another one."""


def guess_bandwidth(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the cutoff by the correlation at lag 1, -ln(phi) rows_per_s / (2 pi). Suggest others by the square root
    of the correlation at lag 2 and by the ratio of both, in case slow or white noise is added. Each is suggested with
    the signal unfiltered, and if a motion shows a delay, with the signal filtered too.

    Rows that are too slow to show a correlation still show the delay, 1 / (sqrt(2) pi cutoff) for a filter with two
    poles. Only the reduction of the noise then distinguishes the filter from a late reading. A filter during a spell
    reduces the noise by its share, which the fit to the rest of the log does not include.
    """
    if evidence.when.spans:
        yield from (
            replace(trial, effects=tuple(_quieter(evidence, trial)), free=_OF_SPELL)
            for trial in _bandwidth_hypotheses(evidence)
        )
        yield from _in_quiet_spell(evidence)
        return
    yield from _in_quiet_logs(evidence)
    yield from with_removal(evidence, Bandwidth.name, _bandwidth_hypotheses(evidence))
    nuisance = evidence.fitted.effects()  # the usual delay of a filter is no obstacle to an unusual one
    if not any(
        isinstance(effect, Bandwidth) and effect.share and effect not in nuisance for effect in evidence.effects
    ):
        yield from _by_delay(evidence)


def _bandwidth_hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_LOW_PASS_TRACES, beyond=_BEYOND):
        return
    first, second = (float(np.tanh(evidence.typical(f"lag_{lag}")).mean()) for lag in (1, 2))
    shares = (0.0, 1.0) if evidence.is_odd("motion_delay", beyond=_BEYOND) else (0.0,)
    cutoffs_hz: list[float] = []
    for phi in (first, math.sqrt(max(second, 0.0)), second / first if first > 0 else 0.0):
        if not _LEAST_CORRELATION < phi < _MOST_CORRELATION:
            continue
        cutoff_hz = -math.log(phi) * evidence.rows_per_s / (2 * math.pi)
        is_new = all(max(cutoff_hz / other, other / cutoff_hz) > _CUTOFFS_ALIKE for other in cutoffs_hz)
        if is_new and cutoff_hz >= _LEAST_CUTOFF_HZ:
            cutoffs_hz.append(cutoff_hz)
            for share in shares:
                yield Hypothesis((Bandwidth(cutoff_hz, share),), ("cutoff_hz",))
    if _LEAST_CORRELATION < first < _MOST_CORRELATION:
        decay = float(brentq(lambda decay: _TWO_POLES.correlation(decay) - first, 0.0, _NOTHING_LEFT))
        cutoff_hz = two_pole_cutoff_hz(1 / (decay * evidence.rows_per_s))
        for share in shares if cutoff_hz >= _LEAST_CUTOFF_HZ else ():
            yield Hypothesis((Bandwidth(cutoff_hz, share, 2.0),), ("cutoff_hz",))


def _quieter(evidence: Evidence, trial: Hypothesis) -> Iterator[Effect]:
    """Yield the effects of a trial with the share of the fitted noise that the spell has."""
    share = min(float(np.exp(evidence.typical("noise").mean())), _MOST_NOISE)
    for effect in trial.effects:
        yield replace(effect, noise_share=share) if isinstance(effect, Bandwidth) else effect


def _in_quiet_spell(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a filter that reduces the noise in a spell, on all axes, even if the rows are too slow to show a
    correlation.
    """
    if evidence.score("noise").max() < -BEYOND:
        share = float(np.exp(evidence.typical("noise").mean()))
        cutoff_hz = cutoff_that_passes(evidence, share)
        if cutoff_hz > 0:
            yield Hypothesis((Bandwidth(cutoff_hz, poles=2.0, noise_share=share),), _OF_SPELL)


def _in_quiet_logs(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a filter that reduces the noise in some logs, by the same share on all axes, even if their rows are too
    slow to show a correlation. If the reduction is small, the other logs are assumed to have more noise instead.
    """
    logs = noise_of_logs(evidence)
    share = 1.0 if logs is None else float(np.exp((logs.less - logs.more).mean()))
    cutoff_hz = cutoff_that_passes(evidence, share)
    if logs is not None and share < _QUIET and cutoff_hz > 0:
        effect = Bandwidth(cutoff_hz, poles=2.0, noise_share=share)
        yield Hypothesis((effect,), _OF_SPELL, fitted=with_noise(evidence, logs.more)).at(in_logs(logs.quiet))


def _by_delay(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest a filter by its delay, with two poles, as output stages have at least. With one pole, rows would show it
    by their correlation. If the rows have the correlation of a filter that was fitted to their noise, suggest that this
    filter delays the signal too, by as much as its cutoff says or by the delay that the motion shows.
    """
    lags_seen = odd_lags(evidence)
    if not lags_seen or any(lag.is_large for lag in lags_seen):
        return
    lag_s, fitted = mean_of(lags_seen, "lag_s"), evidence.fitted.low_pass
    if lag_s <= 0:
        return
    cutoff_hz = two_pole_cutoff_hz(lag_s)
    if fitted is not None:
        yield Hypothesis((Bandwidth(fitted.cutoff_hz, 1.0, fitted.poles, signal_only=1.0),))
        rarity = max(rarity_behind(evidence, cutoff_hz), 0.0)  # the noise of a slower filter would be less
        yield Hypothesis((Bandwidth(cutoff_hz, 1.0, 2.0, signal_only=1.0),), ("cutoff_hz",), rarity=rarity)
    elif _TWO_POLES.correlation(1 / (lag_s * evidence.rows_per_s)) < _UNSEEN:
        yield Hypothesis((Bandwidth(cutoff_hz, 1.0, 2.0),), ("cutoff_hz",), rarity=rarity_behind(evidence, cutoff_hz))


_LINE_TRACES = (
    *("line", "alternation", "noise_excess", "kurtosis", "lag_1", "lag_2", "lag_3", "lag_5"),
    *("band_2", "band_3", "band_4", "band_5", "band_6", "allan_2", "allan_8", "allan_32"),
    *("fast_own_axes", "fast_box_axes", "fast_between_axes", "fast_other_chips"),
)
_BETWEEN_AXES = "fast_between_axes"
_CLEAR_LINE = 2.0
_LINES = 2

_LEAST_PHASES = 5
_DRIFTS, _SCATTER = 0.75, 0.25
"""Least movement of a drifting line, in bins, and its largest median deviation from a straight course, as a share of
that movement.
"""

_BETWEEN = 2.0

_ALIASES = 4
"""Lines are searched up to this multiple of the row rate. Chips attenuate higher frequencies more and more."""

_SEEN = 4.0
"""Standard deviations by which rows of another rate must show a line, for it to determine the alias."""


class _Sighting(NamedTuple):
    """The highest line of one phase at rest: its log, the time `time_s` in the log, `power` and `height` (3,)."""

    log: int
    time_s: float
    hertz: float
    bin_hz: float
    power: Floats
    height: Floats


@dataclass(frozen=True)
class _Rate:
    """The phases at rest with the same number of rows per second."""

    rows_per_s: float
    phases: tuple[PhaseEvidence, ...]

    @property
    def spectra(self) -> list[Spectrum]:
        """Spectra with at least one segment."""
        return [phase.raw.spectrum for phase in self.phases if phase.raw.spectrum.segments]

    def height(self, hertz: float) -> float:
        """Return the height of a line of that frequency above its neighbourhood, in standard deviations, at the
        frequency at which rows of this rate show it.
        """
        spectrum = pool_spectra(self.spectra)
        if spectrum is None:
            return 0.0
        at = round(shown_hz(hertz, self.rows_per_s) * spectrum.segment_rows / self.rows_per_s)
        near = [line for line in highest_lines(spectrum, _LINES) if abs(line.bin - at) <= HALF_WIDTH]
        return max((float(line.height.max()) for line in near), default=0.0)


def _rates(evidence: Evidence) -> list[_Rate]:
    """Return the rates at which the sensor was read, the fastest first."""
    logs = dict.fromkeys(phase.log for phase in evidence.still)
    by_rate: dict[int, list[int]] = {}
    for log in logs:
        by_rate.setdefault(round(math.log(evidence.within([log]).rows_per_s, SAME_RATE)), []).append(log)
    parts = [evidence.within(logs) for _, logs in sorted(by_rate.items(), reverse=True)]
    return [_Rate(part.rows_per_s, part.still) for part in parts]


def guess_tone(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the two highest lines of the mean spectrum at rest, at the frequency at which rows show them, or at the
    mains' frequency if rows show it there. A line whose frequency differs between phases is suggested with its drift.
    """
    if not evidence.is_odd(*_LINE_TRACES, beyond=_BEYOND):
        return
    known = [effect for effect in evidence.effects if isinstance(effect, Tone)]
    rates = _rates(evidence)
    for rate in rates:
        spectrum = pool_spectra([phase.raw.spectrum for phase in rate.phases])
        if spectrum is None:
            continue
        bin_hz = rate.rows_per_s / spectrum.segment_rows
        places = [shown_hz(effect.frequency_hz, rate.rows_per_s) / bin_hz for effect in known]
        for line in highest_lines(spectrum, _LINES, places):
            amplitude = _amplitude(evidence, line.power, line.height)
            for hertz in _true_hz(line.bin * bin_hz, bin_hz, rate, rates):
                yield Hypothesis((Tone(amplitude, hertz),), ("amplitude",))
    if not any(effect.drift_hz_per_h for effect in known):
        shown_at_hz = [shown_hz(effect.frequency_hz, evidence.rows_per_s) for effect in known]
        yield from _drifting(evidence, shown_at_hz)


def _drifting(evidence: Evidence, known_hz: list[float]) -> Iterator[Hypothesis]:
    """Suggest the line that is highest in most phases, if it moves uniformly in each log. A single log does not
    determine how the first frequency varies between logs: twice the drift in this log is assumed.
    """
    sightings = list(_sightings(evidence, known_hz))
    if len(sightings) < max(_LEAST_PHASES, len(evidence.still) / 2):
        return
    logs, time_s, hertz = (
        np.array([getattr(sighting, name) for sighting in sightings]) for name in ("log", "time_s", "hertz")
    )
    centred = np.zeros((2, len(sightings)))
    for log in set(logs.tolist()):
        is_of_log = logs == log
        centred[:, is_of_log] = [value[is_of_log] - np.median(value[is_of_log]) for value in (time_s, hertz)]
    if np.ptp(centred[0]) == 0:
        return
    from scipy.stats import theilslopes  # imported only on use, because it is slow

    slope = float(theilslopes(centred[1], centred[0]).slope)
    length_s = np.ptp(time_s)
    moved_hz = float(abs(slope) * length_s)
    off_hz = float(np.median(np.abs(centred[1] - slope * centred[0])))
    if moved_hz < _DRIFTS * max(sighting.bin_hz for sighting in sightings) or off_hz > _SCATTER * moved_hz:
        return
    firsts = [float(np.median((hertz - slope * time_s)[logs == log])) for log in sorted(set(logs.tolist()))]
    spread_hz = float(np.std(firsts, ddof=1)) if len(firsts) > 1 else _BETWEEN * moved_hz
    power, height = (
        np.median([getattr(sighting, name) for sighting in sightings], axis=0) for name in ("power", "height")
    )
    first_hz = max(float(np.mean(firsts)), 0.0)
    amplitude = _amplitude(evidence, power, height)
    tone = Tone(amplitude, first_hz, frequency_spread_hz=spread_hz, drift_hz_per_h=3600 * slope)
    yield Hypothesis((tone,), ("amplitude",))


def _sightings(evidence: Evidence, known_hz: list[float]) -> Iterator[_Sighting]:
    for phase in evidence.still:
        spectrum = phase.raw.spectrum
        if spectrum.segments == 0 or not phase.raw.intervals.count:
            continue
        bin_hz = evidence.rows_per_s / spectrum.segment_rows
        for line in highest_lines(spectrum, 1, [hertz / bin_hz for hertz in known_hz]):
            time_s = float(np.nanmean(phase.raw.segments.time_s))
            yield _Sighting(phase.log, time_s, line.bin * bin_hz, bin_hz, line.power, line.height)


def _amplitude(evidence: Evidence, power: Floats, height: Floats) -> Triple:
    """Return the amplitude, in the sensor's unit, on the axes on which the line is clear."""
    return assign_signs(
        triple(np.sqrt(2 * np.where(height > _CLEAR_LINE, power, 0.0)) / evidence.header.sensitivity),
        evidence.typical(_BETWEEN_AXES),
    )


def assign_signs(amplitude: Triple, between_axes: Floats) -> Triple:
    """Return `amplitude` with the signs that agree best with `between_axes` (3,), the excess of the correlation of each
    axis with the next one over the model's: a line with opposite phases on two axes makes it negative.
    """
    signs = np.array([(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)])
    present = np.array(amplitude) != 0
    agreement = (signs * np.roll(signs, -1, axis=1) * present * np.roll(present, -1)) @ between_axes
    return triple(signs[int(agreement.argmax())] * np.array(amplitude))


def _true_hz(seen_hz: float, bin_hz: float, rate: _Rate, rates: Sequence[_Rate]) -> Iterator[float]:
    """Yield the frequencies in Hz that a line at `seen_hz` may have: the alias that agrees best with the rows of other
    rates, if any; and the frequency at which the rows show it, or a mains' frequency that shows in the same bin.
    """
    aliases = [
        hertz
        for turn in range(_ALIASES + 1)
        for hertz in (turn * rate.rows_per_s - seen_hz, turn * rate.rows_per_s + seen_hz)
        if hertz > 0
    ]
    others = [other for other in rates if other is not rate and len(other.spectra)]
    if others:
        heights = [sum(other.height(hertz) for other in others) for hertz in aliases]
        best = int(np.argmax(heights))
        if heights[best] > _SEEN and aliases[best] != seen_hz:
            yield aliases[best]
    yield unaliased_hz(seen_hz, bin_hz, rate.rows_per_s)

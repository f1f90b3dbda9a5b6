"""`tone`: a line in the spectrum, that stays where it is or drifts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.characterise.spectrum import Spectrum
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import SAME_RATE, Evidence, PhaseEvidence
from imuarray.gap.statistics.lines import HALF_WIDTH, highest_lines, pool_spectra
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.signal import Triple

_TRACES = (
    *("line", "alternation", "noise_excess", "kurtosis", "lag_1", "lag_2", "lag_3", "lag_5"),
    *("band_2", "band_3", "band_4", "band_5", "band_6", "allan_2", "allan_8", "allan_32"),
    *("fast_own_axes", "fast_box_axes", "fast_between_axes", "fast_other_chips"),
)
_BETWEEN_AXES = "fast_between_axes"
_BEYOND = 2.7
MAINS_HZ = (50.0, 60.0)
HARMONICS = 3
"""So many multiples of the mains' frequency are looked for; transformers and rectifiers make the second and third."""

BY_CHANCE = 0.05
"""Share of lines that come so near an alias of one of these multiples by chance, at most: short phases have wide bins,
and long ones narrow ones.
"""

_CLEAR = 2.0
_LINES = 2

_LEAST_PHASES = 5
_DRIFTS, _SCATTER = 0.75, 0.25
"""Bins by which a line has to move to drift, and the share of that by which it may leave a straight course."""

_BETWEEN = 2.0

_ALIASES = 4
"""Lines are looked for up to so many times the rate of the rows: chips pass less and less of what lies beyond."""

_SEEN = 4.0
"""Standard deviations by which another rate shows a line, for it to say which alias it is."""


class _Sighting(NamedTuple):
    """The highest line of one phase at rest: in which log, at `time_s` of it, `power` and `height` (3,)."""

    log: int
    time_s: float
    hertz: float
    bin_hz: float
    power: Floats
    height: Floats


@dataclass(frozen=True)
class _Rate:
    """The phases at rest with so many rows a second."""

    rows_per_s: float
    phases: tuple[PhaseEvidence, ...]

    @property
    def spectra(self) -> list[Spectrum]:
        """Spectra with at least one segment."""
        return [phase.raw.spectrum for phase in self.phases if phase.raw.spectrum.segments]

    def height(self, hertz: float) -> float:
        """Return how far a line of that frequency stands above what is beside it, in standard deviations, where rows of
        this rate show it.
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


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the two highest lines of the mean spectrum at rest, at the frequency at which rows show them; at that of
    the mains if it is where rows show these. One that is elsewhere in each phase, by its course.
    """
    yield from with_removal(evidence, Tone.name, _hypotheses(evidence), several=True)


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*_TRACES, beyond=_BEYOND):
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
    """Suggest the line that is highest in most phases, if it moves straight on in each log. What a single log can't
    tell is how far from there others begin: twice as far, it is taken, as it drifts in this one.
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
    from scipy.stats import theilslopes  # its weight is for those who ask

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
    x, y, z = (np.sqrt(2 * np.where(height > _CLEAR, power, 0.0)) / evidence.header.sensitivity).tolist()
    return assign_signs((x, y, z), evidence.typical(_BETWEEN_AXES))


def assign_signs(amplitude: Triple, between_axes: Floats) -> Triple:
    """`amplitude` with the signs that agree best with `between_axes` (3,), by how much each axis correlates more with
    the next one than the model has it: a line that reaches two axes in antiphase makes that negative.
    """
    signs = np.array([(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)])
    present = np.array(amplitude) != 0
    agreement = (signs * np.roll(signs, -1, axis=1) * present * np.roll(present, -1)) @ between_axes
    x, y, z = (signs[int(agreement.argmax())] * np.array(amplitude)).tolist()
    return x, y, z


def shown_hz(hertz: float, rows_per_s: float) -> float:
    """Frequency at which rows show a line, 0 to half their rate."""
    return abs(hertz - rows_per_s * round(hertz / rows_per_s))


def _true_hz(seen_hz: float, bin_hz: float, rate: _Rate, rates: Sequence[_Rate]) -> Iterator[float]:
    """Frequencies in Hz of a line at `seen_hz`: as the rows show it and, if other sensors have another rate, the alias
    that agrees best with theirs; the frequency of the mains if it shows in the same bin.
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


def unaliased_hz(seen_hz: float, bin_hz: float, rows_per_s: float) -> float:
    """Return the frequency of the mains, or its lowest multiple, of which `seen_hz` is an alias to a bin; else
    `seen_hz`.

    Multiples are tried as long as a line at an arbitrary frequency would rarely be so near to one of them.
    """
    share = 2 * len(MAINS_HZ) * bin_hz / (rows_per_s / 2)  # of all frequencies is so near an alias of one multiple each
    most = min(HARMONICS, max(1, int(BY_CHANCE / share)))
    multiples = [number * hertz for number in range(1, most + 1) for hertz in MAINS_HZ]
    if any(abs(hertz - seen_hz) < bin_hz for hertz in multiples):
        return seen_hz
    candidates_hz = [hertz for hertz in multiples if abs(shown_hz(hertz, rows_per_s) - seen_hz) < bin_hz]
    return candidates_hz[0] if candidates_hz else seen_hz


TONE = Candidate(
    Tone.name, guesses, {"static": "still for 5 minutes, and again at another poll rate, by which an alias moves"}
)

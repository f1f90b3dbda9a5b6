"""Single statistics that deviate: where, by how much, and whether it matters (`imuarray.gap.statistics.margins`). Also
the remainder after the causes, and notes on unexplained lines, aliases, and bias changes that all units share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from imuarray.arrays import Floats
from imuarray.gap.findings.diagnosis import Cause, Map, Size, Where
from imuarray.gap.inference.assessment import MORE, Assessment, GroupResidual, group_residuals
from imuarray.gap.inference.comparison import Comparison
from imuarray.gap.model.bench import Bench
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import AXES, Key, statistics
from imuarray.gap.statistics.lines import highest_lines, pool_spectra, unaliased_hz
from imuarray.gap.statistics.margins import SensorConditions
from imuarray.gap.statistics.pairs import Pairs, spread_of
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.probes import spectrum as spectrum_probes
from imuarray.gap.statistics.summary import Summary
from imuarray.gap.statistics.synthetic_likelihood import FORM
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.noise import Tone
from imuarray.units import MAINS_HZ, READABLE

TWO_SIDED_95 = 1.96


def margin(key: Key, header: SensorHeader, noise: Floats, rows_per_s: float, seconds: float) -> float:
    """Return the least difference of a statistic that matters, in the statistic's unit.

    `noise` (3,) is that of single readings in the sensor's unit, `rows_per_s` and `seconds` are the rate and the length
    of the log. Raises KeyError for a probe without a rule.
    """
    axis_noise = float(noise["xyz".index(key.axis)]) if key.axis else float(np.sqrt(np.mean(np.square(noise))))
    return PROBES[key.probe].margin(SensorConditions(header, axis_noise, rows_per_s, seconds))


def sized(shift: float, scale: float, margin: float) -> Size:
    """Judge a difference `shift` with standard error `scale` by two one-sided tests.

    The result is "material" if the 95 % interval of its size is beyond the margin, "harmless" if the interval is within
    the margin (however significant the difference is), and "can't tell" otherwise, also for nan.
    """
    return sizes(np.array([shift]), np.array([scale]), np.array([margin]))[0]


def sizes(shift: Floats, scale: Floats, margin: Floats) -> tuple[Size, ...]:
    """Apply `sized` to arrays (n,)."""
    size, reach = np.abs(shift), TWO_SIDED_95 * np.asarray(scale)
    names: tuple[Size, ...] = ("can't tell", "harmless", "material")
    with np.errstate(invalid="ignore"):
        place = np.where(size - reach > margin, 2, np.where(size + reach < margin, 1, 0))
    return tuple(names[number] for number in place.tolist())


def needed(seconds: float, scale: float, margin: float) -> float:
    """Return the length, in s, of a log that resolves a difference of `margin`; inf for a margin of 0. A log of
    `seconds` has the standard error `scale`, which decreases with the square root of the length.
    """
    return seconds * (TWO_SIDED_95 * scale / margin) ** 2 if margin > 0 else math.inf


def length_words(seconds: float) -> str:
    """Return the length to record in words, rounded up to two digits: "25 minutes"."""
    if not math.isfinite(seconds):
        return "no log is long enough"
    unit, size = next((name, size) for name, size, limit in _UNITS if seconds <= limit)
    count = max(seconds / size, 1.0)
    step = 10 ** max(math.floor(math.log10(count)) - 1, 0)
    rounded = math.ceil(count / step - 1e-9) * step
    return f"{rounded} {unit}{'' if rounded == 1 else 's'}"


def where_of(
    report: StatisticReport, assessment: Assessment, places: Iterable[int], p: Mapping[int, float]
) -> tuple[Where, ...]:
    """Return the report entries of the statistics at these places of the pairs, for one model. `p` has the p-values of
    single statistics; the others have that of the assessment.
    """
    return tuple(report.where(at, assessment, p.get(at, assessment.p)) for at in places)


def tail_p(normal: Floats) -> float:
    """Return the p-value of the largest absolute score (m,), multiplied by the number of scores (Bonferroni); nan
    without any. The scores are standard normal according to the fitted tails.
    """
    known = np.abs(normal[np.isfinite(normal)])
    return float(min(1.0, 2 * len(known) * ndtr(-known.max()))) if len(known) else math.nan


def map_of(pairs: Pairs, before: Assessment, after: Assessment, sensors: Sequence[str]) -> Map:
    """Return the largest absolute normal scores by sensor and domain."""
    domains = tuple(dict.fromkeys(probe.domain for probe in PROBES.values()))
    tables = []
    for assessment in (before, after):
        table = np.full((len(sensors), len(domains)), np.nan)
        for key, score in zip(pairs.keys, assessment.normal.tolist(), strict=True):
            if math.isfinite(score):
                place = sensors.index(key.sensor), domains.index(key.domain)
                table[place] = np.fmax(table[place], abs(score))
        tables.append(table)
    return Map(tuple(sensors), domains, tables[0], tables[1], before.limit)


class StatisticReport:
    """Describes single statistics of a recorded campaign; `names` are those of the logs."""

    def __init__(self, bench: Bench, campaign: Campaign, pairs: Pairs, names: Sequence[str]) -> None:
        self._bench, self._pairs = bench, pairs
        sides = (bench.split.train(campaign), bench.split.held_out(campaign))
        keys = (bench.keys[: bench.of_train], bench.keys[bench.of_train :])
        values = [statistics(side.campaign) for side in sides]
        self._raw = pairs.means(
            np.array(
                [side_values[key] for side_values, side_keys in zip(values, keys, strict=True) for key in side_keys]
            )
        )
        self._logs = [[names[log] for log in side.logs] for side in sides]
        self._phases = [[log.phases for log in side.campaign.logs] for side in sides]

    def where(self, at: int, assessment: Assessment, p: float) -> Where:
        """Return the report entry of the statistic at one place of the pairs."""
        key, header = self._pairs.keys[at], self._bench.base.headers[self._pairs.keys[at].sensor]
        probe = PROBES[key.probe]
        shift, scale = self._shift(at, assessment), self.scale(at, assessment)
        least = self.margin(at)
        raw = float(self._raw[at])
        return Where(
            log=self._log(at),
            sensor=key.sensor,
            axis=key.axis,
            domain=key.domain,
            phase=key.phase,
            statistic=key.probe,
            about=probe.about,
            real=raw,
            simulated=raw - shift,
            unit=probe.unit.replace("{u}", header.unit),
            significance=float(assessment.scores[at]),
            p=p,
            effect_size=shift / least if least > 0 else math.inf,
            margin=least,
            size=sized(shift, scale, least),
        )

    def margin(self, at: int) -> float:
        """Return the least difference of a statistic that matters."""
        key = self._pairs.keys[at]
        header = self._bench.base.headers[key.sensor]
        return margin(key, header, self._bench.base.fitted[key.sensor].noise(header), *self.rate_and_length(at))

    def rate_and_length(self, at: int) -> tuple[float, float]:
        """Return the rows per second of the sensor, and the length in s of its log that was used."""
        key = self._key(at)
        phases = self._phases[self._side(at)][max(key.log, 0)]
        summaries = [phase.sensors[key.sensor] for phase in phases if key.sensor in phase.sensors]
        seconds = sum((phase.phase.end_ns - phase.phase.start_ns) * 1e-9 for phase in phases)
        rates = [1 / summary.intervals.mean_s for summary in summaries if summary.intervals.count]
        return (float(np.median(rates)) if rates else 1.0), seconds

    def scale(self, at: int, assessment: Assessment) -> float:
        """Return the standard error of a statistic's difference, averaged over both parts."""
        scales = assessment.likelihood.scale[self._parts(at)]
        known = scales[np.isfinite(scales)]
        return float(np.sqrt((known**2).sum()) / len(known)) if len(known) else math.nan

    def _shift(self, at: int, assessment: Assessment) -> float:
        """Return the difference of the recording from the model's location, averaged over the parts."""
        parts = assessment.deviation[self._parts(at)]
        return float(np.nanmean(parts)) if np.isfinite(parts).any() else math.nan

    def _parts(self, at: int) -> list[int]:
        """Return the places of the statistic in both parts."""
        return [int(place) for place in (self._pairs.train[at], self._pairs.held_out[at]) if place >= 0]

    def _log(self, at: int) -> str:
        key = self._key(at)
        several = f"all {key.phase} logs" if key.phase else "all logs"
        return several if key.log < 0 else self._logs[self._side(at)][key.log]

    def _key(self, at: int) -> Key:
        """Return the key of the statistic in the part that has it, the training part first."""
        places = (self._pairs.train, self._pairs.held_out)[self._side(at)]
        return self._bench.keys[int(places[at])]

    def _side(self, at: int) -> int:
        """Return 0 for the training part, 1 for a statistic that only the held-out part has."""
        return 0 if self._pairs.train[at] >= 0 else 1


_UNITS = (("second", 1.0, 90.0), ("minute", 60.0, 5400.0), ("hour", 3600.0, 172800.0), ("day", 86400.0, math.inf))


MOST = 6
"""Largest number of axes or sensors that are described."""

_SCORE = 6.0
"""Least score of a peak against its neighbours at which it is a line."""

_LEAST_UNITS, _SPREAD = 3, 0.5
"""Least number of units of a chip with a shared change, and largest ratio of its standard deviation to its mean."""

LINES = 4
"""Largest number of lines of a sensor that are listed."""

_SEARCHED, _APART = 12, 8.0
"""Number of peaks that are examined, and least distance in bins between two lines and of the lowest line from 0. A
drifting line has several peaks, and a wandering bias has some near 0.
"""

_FIRST = 4
_STEADY = 1.5
"""Change of a frequency, in bins, below which the line is steady."""

ONE_SIDED = 2.0
"""Ratio of a mean residual to the largest one of any replicate above which it is significant. A ratio of one would
report differences that do not matter to a user, such as a telegraph noise with slightly longer states.
"""


UNLIKELY = 1.6
"""Size of a remainder above which no combination of known effects makes a recording likely. A smaller remainder is a
slightly different form of an effect. Example: the worst statistic of a chip that stalled for a moment, with the right
cause in the model, had a size of 1.03.
"""


@dataclass(frozen=True)
class Remainder:
    """The remainder with all causes in the model.

    `places` are those of the statistics beyond chance, the worst first; `one_sided` are probes with a residual of the
    same sign in all phases; `where` has both as report entries. `sizes` has by sensor the size of the remainder that
    matters and that an inexact form of the causes does not explain, in units of the smallest one that counts (above 1).
    """

    places: tuple[int, ...]
    one_sided: tuple[GroupResidual, ...]
    where: tuple[Where, ...]
    sizes: Mapping[str, float]

    @property
    def unlikely(self) -> frozenset[str]:
        """The sensors with recordings that no combination of known effects makes likely."""
        return frozenset(name for name, size in self.sizes.items() if size > UNLIKELY)

    @property
    def one_sidedness(self) -> float:
        """The largest mean residual of a one-sided probe, in units of the largest of any replicate; 0 without one."""
        return max((abs(group.score) / group.furthest for group in self.one_sided), default=0.0)


NO_REMAINDER = Remainder((), (), (), {})
"""The remainder without a gap."""


def remainder_of(
    comparison: Comparison, after: Assessment, repaired: Floats, causes: Sequence[Cause], report: StatisticReport
) -> Remainder:
    """Return the remainder of a recording according to `after`, an assessment by the replicates of the `repaired` model
    (b, n).
    """
    normal, scores = (np.nan_to_num(np.abs(values)) for values in (after.normal, after.scores))
    places = tuple(int(at) for at in np.argsort(-scores) if normal[at] > after.limit)
    single = tuple(report.where(at, after, after.p) for at in places)
    one_sided = _one_sided(comparison, after, repaired, causes) if causes else ()
    worst = _worst_places(comparison, after, one_sided, places)
    where = (*single, *(report.where(at, after, after.p) for at in worst))
    averages = [(group.sensor, abs(group.score) / (ONE_SIDED * group.furthest)) for group in one_sided]
    largest: dict[str, float] = {}
    for sensor, size in (*averages, *_material(comparison, after, repaired, places, single)):
        largest[sensor] = max(size, largest.get(sensor, 0.0))
    return Remainder(places, one_sided, where, {sensor: size for sensor, size in largest.items() if size > 1})


def _material(
    comparison: Comparison, after: Assessment, repaired: Floats, places: Sequence[int], single: Sequence[Where]
) -> Iterator[tuple[str, float]]:
    """Yield the sensors with a remainder that matters and that an inexact form of the causes does not explain. Its size
    is in units of a score that is clearly beyond all replicates (one in thirty is extreme for rare events).
    """
    scores = beyond_form(comparison.pairs, comparison.assessment, after, comparison.real.values, repaired)
    sizes = np.nan_to_num(np.abs(scores))[list(places)] / (MORE * after.furthest)
    for entry, size in zip(single, sizes.tolist(), strict=True):
        if entry.size == "material":
            yield entry.sensor, size


def beyond_form(pairs: Pairs, before: Assessment, after: Assessment, real: Floats, replicates: Floats) -> Floats:
    """Return normal scores (m,) of the recording under the model with its causes, with an allowance for an inexact form
    of the causes.

    The scale is increased by the relative error of form times the shift from `before` to `after`; `replicates` are
    those of `after`.
    """
    shift = np.nan_to_num(np.abs(after.likelihood.location - before.likelihood.location))
    wider = replace(after.likelihood, scale=np.hypot(after.likelihood.scale, FORM * shift))
    scores = pairs.sums(wider.scores(real)) / spread_of(pairs.sums(after.likelihood.scores(replicates)))
    return after.tails.normal(scores, pairs.keys)


def _one_sided(
    comparison: Comparison, after: Assessment, repaired: Floats, causes: Sequence[Cause]
) -> tuple[GroupResidual, ...]:
    """Return the probes of sensors with a cause that have a residual of one sign in all phases, well beyond any
    replicate.
    """
    concerned = {name for cause in causes for name in cause.sensors}
    real = comparison.real.values
    groups = group_residuals(comparison.bench.keys, comparison.assessment.likelihood, after.likelihood, real, repaired)
    return tuple(
        group for group in groups if group.sensor in concerned and abs(group.score) > ONE_SIDED * group.furthest
    )


def _worst_places(
    comparison: Comparison, after: Assessment, one_sided: Sequence[GroupResidual], known: Sequence[int]
) -> list[int]:
    """Return the place at which each one-sided probe of a sensor is worst, without probes that are already `known`."""
    sizes, keys = np.nan_to_num(np.abs(after.normal)), comparison.pairs.keys
    worst: dict[tuple[str, str], int] = {}
    for group in one_sided:
        places = [at for at, key in enumerate(keys) if (key.sensor, key.probe) == (group.sensor, group.probe)]
        worst.setdefault((group.sensor, group.probe), max(places, key=lambda at: sizes[at]))
    known_groups = {(keys[at].sensor, keys[at].probe) for at in known}
    return [at for place, at in worst.items() if place not in known_groups]


def unexplained_lines(campaign: Campaign, unexplained: Sequence[Where], names: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence for each axis with an unexplained line, the worst first, log by log; `names` are those of the
    logs.
    """
    axes = dict.fromkeys(
        (entry.sensor, entry.axis) for entry in unexplained if entry.statistic == "line" and entry.axis
    )
    return tuple(
        f"{sensor} {axis}: a line that the causes do not fully explain: {'; '.join(lines)}."
        for sensor, axis in list(axes)[:MOST]
        if (lines := list(_by_log(campaign, sensor, AXES.index(axis), names)))
    )


def lines_shown(campaign: Campaign, odd: Sequence[Where], causes: Sequence[Cause]) -> tuple[str, ...]:
    """Return a sentence for each sensor with a deviating line, or with a line as a cause. It lists the frequencies of
    the lines of the mean spectrum at rest, explained or not, the highest first, and marks aliases of the mains.
    """
    tone_sensors = [name for cause in causes if cause.effect == Tone.name for name in cause.sensors]
    names = dict.fromkeys([*tone_sensors, *(entry.sensor for entry in odd if entry.statistic == "line")])
    sentences = ((name, "; ".join(_lines_of(campaign, name))) for name in list(names)[:MOST])
    return tuple(f"{name}, lines at rest: {lines}." for name, lines in sentences if lines)


def _lines_of(campaign: Campaign, sensor: str) -> Iterator[str]:
    rows_per_s = _rows_per_s(campaign, sensor)
    spectrum = pool_spectra([summary.spectrum for log in campaign.logs for summary in log.still(sensor)])
    if rows_per_s is None or spectrum is None:
        return
    bin_hz = rows_per_s / spectrum.segment_rows
    bins: list[float] = []
    for line in highest_lines(spectrum, _SEARCHED):
        is_line = line.height.max() > _SCORE and line.bin > _APART
        if not is_line or any(abs(line.bin - other) < _APART for other in bins) or len(bins) == LINES:
            continue
        bins.append(line.bin)
        hertz = line.bin * bin_hz
        axes = "".join(axis for axis, height in zip(AXES, line.height, strict=True) if height > _SCORE)
        true_hz = unaliased_hz(hertz, bin_hz, rows_per_s)
        alias = "" if true_hz == hertz else f", an alias of {_mains(true_hz)} ({rows_per_s:.3g} rows a second)"
        yield f"{axes} {hertz:.2f} Hz{alias}"


def _mains(hertz: float) -> str:
    """Return a frequency in words and, if it is a multiple of the mains frequency, the multiple."""
    for mains_hz in MAINS_HZ:
        if (number := round(hertz / mains_hz)) * mains_hz == hertz:
            multiple = "the mains" if number == 1 else f"harmonic {number} of the mains at {mains_hz:g} Hz"
            return f"{hertz:.4g} Hz, {multiple}"
    return f"{hertz:.4g} Hz"


def _rows_per_s(campaign: Campaign, sensor: str) -> float | None:
    """Return the rows per second from the median interval; None if the sensor was never at rest."""
    summaries = (summary for log in campaign.logs for summary in log.still(sensor))
    intervals = [summary.intervals.mean_s for summary in summaries if summary.intervals.count]
    return float(1 / np.median(intervals)) if intervals else None


def shared_changes(
    keys: Sequence[Key], values: Floats, held_out: Sequence[bool], headers: Mapping[str, SensorHeader]
) -> tuple[str, ...]:
    """Return a sentence for each axis on which the level of a held-out log differs from the training part by the same
    amount in all units of a chip, along their own axes. An error of the chip's design has this form. `values` (n,) are
    residual statistics.
    """
    groups: dict[tuple[str, str, int, str], list[float]] = {}
    for key, value, out in zip(keys, values.tolist(), held_out, strict=True):
        header = headers[key.sensor]
        if out and key.probe == "level" and np.isfinite(value) and header.unit in READABLE:
            groups.setdefault((header.chip, header.unit, key.log, key.axis), []).append(value)
    return tuple(
        _shared_change_text(*place, np.array(changes))
        for place, changes in groups.items()
        if _is_shared(np.array(changes))
    )


def _is_shared(changes: Floats) -> bool:
    """Return whether all changes have the same sign and about the same size."""
    same = bool((np.sign(changes) == np.sign(changes[0])).all())
    return len(changes) >= _LEAST_UNITS and same and float(changes.std(ddof=1)) < _SPREAD * abs(float(changes.mean()))


def _shared_change_text(chip: str, unit: str, log: int, axis: str, changes: Floats) -> str:
    factor, unit = READABLE[unit]
    size = (
        f"{factor * changes.mean():+.3g} {unit} (standard deviation between units {factor * changes.std(ddof=1):.2g})"
    )
    return (
        f"All {len(changes)} {chip}, {axis}: held-out log {log + 1} lies {size} from the part fitted to, along the "
        "chips' own axes: a change of bias that the units share."
    )


def line_hz(summary: Summary, axis: int) -> float | None:
    """Return the apparent frequency, in Hz, of the highest peak of one axis; None if it is not a line."""
    spectrum = summary.spectrum
    if spectrum.segments == 0 or not spectrum_probes.line(summary)[axis] > _SCORE or not summary.intervals.count:
        return None
    peak = _FIRST + int(np.nanargmax(spectrum.density[_FIRST:-1, axis]))
    return float(spectrum.frequency_hz[peak] / summary.intervals.mean_s)


def _by_log(campaign: Campaign, sensor: str, axis: int, names: Sequence[str]) -> Iterator[str]:
    for name, log in zip(names, campaign.logs, strict=True):
        phases = log.still(sensor)
        lines_hz = [hz for hz in (line_hz(phase, axis) for phase in phases) if hz is not None]
        if not lines_hz:
            continue
        finest = max(phase.spectrum.resolution_hz / phase.intervals.mean_s for phase in phases if phase.intervals.count)
        where = f"in {len(lines_hz)} of {len(phases)} stretches at rest of {name}"
        if np.ptp(lines_hz) < _STEADY * finest:
            yield f"{np.median(lines_hz):.3g} Hz {where}"
        else:
            course = f"{lines_hz[0]:.3g} at first and {lines_hz[-1]:.3g} at last"
            yield f"{min(lines_hz):.3g} to {max(lines_hz):.3g} Hz {where}, {course}"

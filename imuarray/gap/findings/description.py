"""Notes on the recordings, and the remainder after the causes: single statistics beyond chance, probes whose residual
has a constant sign, unexplained lines, aliases, and bias changes that all units share.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.deviations import StatisticReport
from imuarray.gap.findings.diagnosis import Cause, Where
from imuarray.gap.inference.assessment import MORE, Assessment
from imuarray.gap.inference.comparison import Comparison
from imuarray.gap.inference.effects.noise import MAINS_HZ, unaliased_hz
from imuarray.gap.inference.residuals import GroupResidual, group_residuals
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import AXES, Key
from imuarray.gap.statistics.lines import highest_lines, pool_spectra
from imuarray.gap.statistics.pairs import Pairs, spread_of
from imuarray.gap.statistics.probes import spectrum as spectrum_probes
from imuarray.gap.statistics.summary import Summary
from imuarray.gap.statistics.synthetic_likelihood import FORM
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.noise import Tone
from imuarray.units import READABLE

MOST = 6
"""Most axes that are described."""

_SCORE = 6.0
"""Least score of a peak against its neighbours that is a line."""

_LEAST_UNITS, _SPREAD = 3, 0.5
"""Least number of units of a chip with a shared change, and the largest standard deviation of it over its mean."""

LINES = 4
"""Most lines of a sensor that are listed."""

_SEARCHED, _APART = 12, 8.0
"""Peaks that are searched, and least bins between two lines and from the lowest line to 0: a drifting line has several
peaks, and a wandering bias has some near 0.
"""

_FIRST = 4
_STEADY = 1.5
"""Change of a frequency, in bins, below which it is steady."""

ONE_SIDED = 2.0
"""Ratio of a mean residual to the largest of any replicate from which on it is significant. With a ratio of one it
would report what matters to no user, such as a telegraph noise with slightly longer states.
"""


UNLIKELY = 1.6
"""Size of a remainder from which on no combination of known effects makes a recording likely. A smaller one is a
slightly different form: for a chip that stalled for a moment, with the right cause in, the worst statistic was 1.03
times that size.
"""


@dataclass(frozen=True)
class Remainder:
    """The remainder with all causes in the model.

    `places` are those of the statistics beyond chance, the worst first; `one_sided` are probes whose residual has one
    sign in all phases; `where` holds both as report entries. `sizes` gives, by sensor, the remainder that matters and
    that an inexact form of the causes does not explain, in units of the smallest that counts (above 1).
    """

    places: tuple[int, ...]
    one_sided: tuple[GroupResidual, ...]
    where: tuple[Where, ...]
    sizes: Mapping[str, float]

    @property
    def unlikely(self) -> frozenset[str]:
        """The sensors whose recordings no combination of known effects makes likely."""
        return frozenset(name for name, size in self.sizes.items() if size > UNLIKELY)

    @property
    def one_sidedness(self) -> float:
        """The largest mean residual, in units of the largest of any replicate; 0 without."""
        return max((abs(group.score) / group.furthest for group in self.one_sided), default=0.0)


NO_REMAINDER = Remainder((), (), (), {})
"""The remainder without a gap."""


def remainder_of(
    comparison: Comparison, after: Assessment, repaired: Floats, causes: Sequence[Cause], report: StatisticReport
) -> Remainder:
    """Return the remainder of a recording, as `after` judges it by replicates of the `repaired` model (b, n)."""
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
    """Return the sensors with a remainder that matters and that an inexact form of the causes does not explain, and its
    size in units of what clearly no replicate reaches (one in thirty is extreme for rare events).
    """
    scores = beyond_form(comparison.pairs, comparison.assessment, after, comparison.real.values, repaired)
    sizes = np.nan_to_num(np.abs(scores))[list(places)] / (MORE * after.furthest)
    for entry, size in zip(single, sizes.tolist(), strict=True):
        if entry.size == "material":
            yield entry.sensor, size


def beyond_form(pairs: Pairs, before: Assessment, after: Assessment, real: Floats, replicates: Floats) -> Floats:
    """Return normal scores (m,) of the recording under the model with its causes, with an allowance for an inexact form
    of the causes.

    The scale is widened by the relative error of form times the shift from `before` to `after`; `replicates` are those
    of `after`.
    """
    shift = np.nan_to_num(np.abs(after.likelihood.location - before.likelihood.location))
    wider = replace(after.likelihood, scale=np.hypot(after.likelihood.scale, FORM * shift))
    scores = pairs.sums(wider.scores(real)) / spread_of(pairs.sums(after.likelihood.scores(replicates)))
    return after.tails.normal(scores, pairs.keys)


def _one_sided(
    comparison: Comparison, after: Assessment, repaired: Floats, causes: Sequence[Cause]
) -> tuple[GroupResidual, ...]:
    """Return probes of sensors with a cause whose residual has one sign in all phases, well beyond any replicate."""
    concerned = {name for cause in causes for name in cause.sensors}
    real = comparison.real.values
    groups = group_residuals(comparison.bench.keys, comparison.assessment.likelihood, after.likelihood, real, repaired)
    return tuple(
        group for group in groups if group.sensor in concerned and abs(group.score) > ONE_SIDED * group.furthest
    )


def _worst_places(
    comparison: Comparison, after: Assessment, one_sided: Sequence[GroupResidual], known: Sequence[int]
) -> list[int]:
    """Return the place at which each one-sided probe of a sensor is worst, without those that are already `known`."""
    sizes, keys = np.nan_to_num(np.abs(after.normal)), comparison.pairs.keys
    worst: dict[tuple[str, str], int] = {}
    for group in one_sided:
        places = [at for at, key in enumerate(keys) if (key.sensor, key.probe) == (group.sensor, group.probe)]
        worst.setdefault((group.sensor, group.probe), max(places, key=lambda at: sizes[at]))
    known_groups = {(keys[at].sensor, keys[at].probe) for at in known}
    return [at for place, at in worst.items() if place not in known_groups]


def unexplained_lines(campaign: Campaign, unexplained: Sequence[Where], names: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence for each axis with an unexplained line, the worst first, log by log; `names` are the logs'."""
    axes = dict.fromkeys(
        (entry.sensor, entry.axis) for entry in unexplained if entry.statistic == "line" and entry.axis
    )
    return tuple(
        f"{sensor} {axis}: a line that the causes do not fully explain: {'; '.join(lines)}."
        for sensor, axis in list(axes)[:MOST]
        if (lines := list(_by_log(campaign, sensor, AXES.index(axis), names)))
    )


def lines_shown(campaign: Campaign, odd: Sequence[Where], causes: Sequence[Cause]) -> tuple[str, ...]:
    """Return a sentence for each sensor with a deviating line or a line as cause: the frequencies of the lines of its
    mean spectrum at rest, the highest first, explained or not, with aliases of the mains marked.
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
    """Return a frequency in words, with the multiple of the mains frequency that it is."""
    for mains_hz in MAINS_HZ:
        if (number := round(hertz / mains_hz)) * mains_hz == hertz:
            multiple = "the mains" if number == 1 else f"harmonic {number} of the mains at {mains_hz:g} Hz"
            return f"{hertz:.4g} Hz, {multiple}"
    return f"{hertz:.4g} Hz"


def _rows_per_s(campaign: Campaign, sensor: str) -> float | None:
    """Return the rows per second from the usual interval; None if the sensor was never at rest."""
    summaries = (summary for log in campaign.logs for summary in log.still(sensor))
    intervals = [summary.intervals.mean_s for summary in summaries if summary.intervals.count]
    return float(1 / np.median(intervals)) if intervals else None


def shared_changes(
    keys: Sequence[Key], values: Floats, held_out: Sequence[bool], headers: Mapping[str, SensorHeader]
) -> tuple[str, ...]:
    """Return a sentence for each axis on which the level of a held-out log differs from the training part by the same
    amount in all units of a chip, along their own axes, as an error of their design does. `values` (n,) are residual
    statistics.
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
    """Return the apparent frequency of the highest peak of one axis; None if it is no line."""
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

"""What numbers alone don't say, and what the causes leave: single statistics beyond chance, probes that lie to one side
everywhere, where lines lie that no cause explains, which ones are aliases, and biases that change in all units alike.
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
from imuarray.gap.inference.effects.lines import highest_lines, pooled
from imuarray.gap.inference.effects.tone import MAINS_HZ, unaliased_hz
from imuarray.gap.inference.residuals import GroupResidual, overall
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import AXES, Key
from imuarray.gap.statistics.pairs import Pairs, spread_of
from imuarray.gap.statistics.probes.spectrum import LINE
from imuarray.gap.statistics.summary import Summary
from imuarray.gap.statistics.synthetic_likelihood import FORM
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.tone import Tone
from imuarray.units import READABLE

MOST = 6
"""So many axes are described."""

_SCORE = 6.0
"""A peak that far beyond its neighbours is a line."""

_LEAST_UNITS, _SPREAD = 3, 0.5
"""Units of a chip, and their standard deviation over their mean, of which a change counts as shared."""

LINES = 4
"""So many of a sensor are told."""

_SEARCHED, _APART = 12, 8.0
"""Peaks that are looked at, and bins between two lines, and from the lowest one to 0: a line that drifts has several
peaks, and a bias that wanders has some there."""

_FIRST = 4
_STEADY = 1.5
"""A frequency that changes by fewer bins is steady."""

ONE_SIDED = 2.0
"""An average is so much beyond any replicate's to be something else: of forty phases it tells what no use would notice,
as that a telegraph is a little longer in one of its states than the effect has it.
"""


UNLIKELY = 1.6
"""From so many times the size on at which something is left, no combination of known effects makes a recording likely.
Less is a form that is a little different: of a chip that stood still for a moment with the right cause in, the worst
statistic was 1.03 times that size.
"""


@dataclass(frozen=True)
class Remainder:
    """What is left with all causes in: the statistics that are beyond chance (`places` of pairs), the worst first, the
    probes that lie to one side in all phases (`one_sided`), all of it in the terms of a page (`where`), by sensor the
    size of what is left that matters and that the causes' form doesn't excuse, in units of the least that counts
    (`sizes`, above 1).
    """

    places: tuple[int, ...]
    one_sided: tuple[GroupResidual, ...]
    where: tuple[Where, ...]
    sizes: Mapping[str, float]

    @property
    def unlikely(self) -> frozenset[str]:
        """Sensors whose recordings no combination of known effects makes likely."""
        return frozenset(name for name, size in self.sizes.items() if size > UNLIKELY)

    @property
    def one_sidedness(self) -> float:
        """The largest average, in units of the largest of any replicate; 0 without."""
        return max((abs(one.score) / one.furthest for one in self.one_sided), default=0.0)


NOTHING_LEFT = Remainder((), (), (), {})
"""Where there is no gap."""


def remainder_of(
    comparison: Comparison, after: Assessment, repaired: Floats, causes: Sequence[Cause], report: StatisticReport
) -> Remainder:
    """What the causes leave of a recording, as `after` judges it by replicates of the `repaired` model (b, n)."""
    sizes = np.nan_to_num(np.abs(after.scores))
    places = tuple(int(at) for at in np.argsort(-sizes) if sizes[at] > after.limit)
    single = tuple(report.where(at, after, after.p) for at in places)
    one_sided = _one_sided(comparison, after, repaired, causes) if causes else ()
    worst = _worst_places(comparison, after, one_sided, places)
    where = (*single, *(report.where(at, after, after.p) for at in worst))
    averages = [(one.sensor, abs(one.score) / (ONE_SIDED * one.furthest)) for one in one_sided]
    largest: dict[str, float] = {}
    for sensor, size in (*averages, *_material(comparison, after, repaired, places, single)):
        largest[sensor] = max(size, largest.get(sensor, 0.0))
    return Remainder(places, one_sided, where, {sensor: size for sensor, size in largest.items() if size > 1})


def _material(
    comparison: Comparison, after: Assessment, repaired: Floats, places: Sequence[int], single: Sequence[Where]
) -> Iterator[tuple[str, float]]:
    """Sensors and sizes of what is left that matters and that the causes' form doesn't excuse, in units of what is well
    beyond any replicate's: of a few events one in thirty is a strange one.
    """
    scores = beyond_form(comparison.pairs, comparison.judged, after, comparison.real.values, repaired)
    sizes = np.nan_to_num(np.abs(scores))[list(places)] / (MORE * after.furthest)
    for one, size in zip(single, sizes.tolist(), strict=True):
        if one.size == "material":
            yield one.sensor, size


def beyond_form(pairs: Pairs, before: Assessment, after: Assessment, real: Floats, replicates: Floats) -> Floats:
    """(m,) scores of the recording under the model with its causes in, as `after` has them by these `replicates`; but
    causes may miss what they have moved since `before` by the share by which the form of the right ones may be wrong.
    """
    moved = np.nan_to_num(np.abs(after.likelihood.location - before.likelihood.location))
    wider = replace(after.likelihood, scale=np.hypot(after.likelihood.scale, FORM * moved))
    return np.asarray(pairs.sums(wider.scores(real)) / spread_of(pairs.sums(after.likelihood.scores(replicates))))


def _one_sided(
    comparison: Comparison, after: Assessment, repaired: Floats, causes: Sequence[Cause]
) -> tuple[GroupResidual, ...]:
    """What sensors with a cause keep to one side of it in all their phases, well beyond any replicate."""
    concerned = {name for cause in causes for name in cause.sensors}
    real = comparison.real.values
    groups = overall(comparison.bench.keys, comparison.judged.likelihood, after.likelihood, real, repaired)
    return tuple(one for one in groups if one.sensor in concerned and abs(one.score) > ONE_SIDED * one.furthest)


def _worst_places(
    comparison: Comparison, after: Assessment, one_sided: Sequence[GroupResidual], known: Sequence[int]
) -> list[int]:
    """Where each one-sided probe of a sensor shows most, as places of pairs; without what is `known` already."""
    sizes, keys = np.nan_to_num(np.abs(after.scores)), comparison.pairs.keys
    worst: dict[tuple[str, str], int] = {}
    for one in one_sided:
        own = [at for at, key in enumerate(keys) if (key.sensor, key.probe) == (one.sensor, one.probe)]
        worst.setdefault((one.sensor, one.probe), max(own, key=lambda at: sizes[at]))
    named = {(keys[at].sensor, keys[at].probe) for at in known}
    return [at for place, at in worst.items() if place not in named]


def lines_left(campaign: Campaign, unexplained: Sequence[Where], names: Sequence[str]) -> tuple[str, ...]:
    """A sentence for each axis whose line is not explained, the worst first, log by log; `names` are the logs'."""
    axes = dict.fromkeys((one.sensor, one.axis) for one in unexplained if one.statistic == "line" and one.axis)
    return tuple(
        f"{sensor} {axis}: a line that no cause explains: {'; '.join(told)}."
        for sensor, axis in list(axes)[:MOST]
        if (told := list(_by_log(campaign, sensor, AXES.index(axis), names)))
    )


def lines_shown(campaign: Campaign, odd: Sequence[Where], causes: Sequence[Cause]) -> tuple[str, ...]:
    """A sentence for each sensor of which a line is `odd` or a cause: at which frequencies its mean spectrum at rest
    has lines, highest first, explained or not, and which of them are aliases of the mains.
    """
    told = [name for cause in causes if cause.effect == Tone.name for name in cause.sensors]
    names = dict.fromkeys([*told, *(one.sensor for one in odd if one.statistic == "line")])
    sentences = ((name, "; ".join(_lines_of(campaign, name))) for name in list(names)[:MOST])
    return tuple(f"{name}, lines at rest: {lines}." for name, lines in sentences if lines)


def _lines_of(campaign: Campaign, sensor: str) -> Iterator[str]:
    rows_per_s = _rows_per_s(campaign, sensor)
    spectrum = pooled([one.spectrum for log in campaign.logs for one in log.still(sensor)])
    if rows_per_s is None or spectrum is None:
        return
    bin_hz = rows_per_s / spectrum.segment_rows
    seen: list[float] = []
    for line in highest_lines(spectrum, _SEARCHED):
        is_line = line.height.max() > _SCORE and line.bin > _APART
        if not is_line or any(abs(line.bin - other) < _APART for other in seen) or len(seen) == LINES:
            continue
        seen.append(line.bin)
        hertz = line.bin * bin_hz
        axes = "".join(axis for axis, height in zip(AXES, line.height, strict=True) if height > _SCORE)
        true_hz = unaliased_hz(hertz, bin_hz, rows_per_s)
        alias = "" if true_hz == hertz else f", an alias of {_mains(true_hz)} ({rows_per_s:.3g} rows a second)"
        yield f"{axes} {hertz:.2f} Hz{alias}"


def _mains(hertz: float) -> str:
    """A frequency, and which multiple of the mains' it is."""
    for mains_hz in MAINS_HZ:
        if (number := round(hertz / mains_hz)) * mains_hz == hertz:
            multiple = "the mains" if number == 1 else f"harmonic {number} of the mains at {mains_hz:g} Hz"
            return f"{hertz:.4g} Hz, {multiple}"
    return f"{hertz:.4g} Hz"


def _rows_per_s(campaign: Campaign, sensor: str) -> float | None:
    """Of its usual interval; None if it was never at rest."""
    summaries = (one for log in campaign.logs for one in log.still(sensor))
    intervals = [one.intervals.mean_s for one in summaries if one.intervals.count]
    return float(1 / np.median(intervals)) if intervals else None


def changes_alike(
    keys: Sequence[Key], values: Floats, held_out: Sequence[bool], headers: Mapping[str, SensorHeader]
) -> tuple[str, ...]:
    """A sentence for each axis on which the level of a held-out log is another than that of the training part, and
    that by as much in all units of a chip, along their own axes: what their design shares. `values` (n,) of residual
    statistics.
    """
    groups: dict[tuple[str, str, int, str], list[float]] = {}
    for key, value, out in zip(keys, values.tolist(), held_out, strict=True):
        header = headers[key.sensor]
        if out and key.probe == "level" and np.isfinite(value) and header.unit in READABLE:
            groups.setdefault((header.chip, header.unit, key.log, key.axis), []).append(value)
    return tuple(_told(*place, np.array(found)) for place, found in groups.items() if _is_alike(np.array(found)))


def _is_alike(found: Floats) -> bool:
    """All one way, and about as far."""
    same = bool((np.sign(found) == np.sign(found[0])).all())
    return len(found) >= _LEAST_UNITS and same and float(found.std(ddof=1)) < _SPREAD * abs(float(found.mean()))


def _told(chip: str, unit: str, log: int, axis: str, found: Floats) -> str:
    factor, unit = READABLE[unit]
    size = f"{factor * found.mean():+.3g} {unit} (standard deviation between units {factor * found.std(ddof=1):.2g})"
    return (
        f"All {len(found)} {chip}, {axis}: held-out log {log + 1} lies {size} from the part fitted to, along the "
        "chips' own axes: a change of bias that the units share."
    )


def line_hz(summary: Summary, axis: int) -> float | None:
    """Apparent frequency of the highest peak of one axis; None if it is no line."""
    spectrum = summary.spectrum
    if spectrum.segments == 0 or not LINE.statistic(summary)[axis] > _SCORE or not summary.intervals.count:
        return None
    peak = _FIRST + int(np.nanargmax(spectrum.density[_FIRST:-1, axis]))
    return float(spectrum.frequency_hz[peak] / summary.intervals.mean_s)


def _by_log(campaign: Campaign, sensor: str, axis: int, names: Sequence[str]) -> Iterator[str]:
    for name, log in zip(names, campaign.logs, strict=True):
        phases = log.still(sensor)
        found = [hz for hz in (line_hz(phase, axis) for phase in phases) if hz is not None]
        if not found:
            continue
        finest = max(phase.spectrum.resolution_hz / phase.intervals.mean_s for phase in phases if phase.intervals.count)
        where = f"in {len(found)} of {len(phases)} stretches at rest of {name}"
        if np.ptp(found) < _STEADY * finest:
            yield f"{np.median(found):.3g} Hz {where}"
        else:
            course = f"{found[0]:.3g} at first and {found[-1]:.3g} at last"
            yield f"{min(found):.3g} to {max(found):.3g} Hz {where}, {course}"

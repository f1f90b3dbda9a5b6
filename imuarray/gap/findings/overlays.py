"""Curves of the recording, and of simulations before and after the causes were added, where the recording differs most.

Curves are of the held-out part: the models were fitted to the other part and agree with it too well.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.characterise.codes import Histogram
from imuarray.gap.findings.diagnosis import Overlay, Where
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import TOGETHER, Models
from imuarray.gap.model.workers import Run
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.summary import Summary
from imuarray.units import READABLE

if TYPE_CHECKING:
    pass

Kind = Literal["spectrum", "allan", "temperature", "codes"]

REPLICATES = 12
"""Number of replicates of each model. Their 95 % band is nearly that from the lowest to the highest."""

MOST = 12
"""Largest number of curves of a diagnosis."""

OF_SENSOR = 3
"""Largest number of curves of one sensor."""

CODES, BINS = 200, 40
"""Largest number of bins of a histogram, and of bins of temperature."""

KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "spectrum": "spectrum",
        "autocorrelation": "spectrum",
        "cross_sensor": "spectrum",
        "allan": "allan",
        "level": "allan",
        "spread": "allan",
        "run_to_run": "allan",
        "codes": "codes",
        "distribution": "codes",
        "status": "codes",
        "temperature": "temperature",
    }
)
"""The curve that shows the statistics of a domain. Timing, and responses to force and motion, have no curve."""

_FIRST = 3_000_000
_TERMS = 4
"""Fewest differences of a point of the Allan deviation that is drawn."""

_NAMED = 3
"""Largest number of phases that are named; if there are more, only their number is given."""

_RARE = 0.001
"""Share of the readings at either end of a histogram that does not widen it."""


class Curve(NamedTuple):
    """A curve of one axis; `phases` are their numbers in the log, a single one except for temperatures."""

    kind: Kind
    sensor: str
    axis: int
    log: int
    phases: tuple[int, ...]


class CurveShape(NamedTuple):
    """The x positions of a curve, and the function that returns its values there from the sensor's summaries."""

    x: Floats
    values: Callable[[Sequence[Summary]], Floats]


@dataclass(frozen=True)
class _CurveRequest:
    """The input of a job: curves, with the recorded summaries that determine their x positions."""

    models: Models = field(repr=False)
    numbers: Sequence[int]
    curves: tuple[tuple[Curve, tuple[Summary, ...]], ...] = field(repr=False)


def overlays_of(
    bench: Bench,
    campaign: Campaign,
    where: Sequence[Where],
    models: tuple[Models, Models],
    run: Run,
    names: Sequence[str] = (),
) -> tuple[Overlay, ...]:
    """Return curves that show the statistics `where` (worst first), of the recorded `campaign` and of 12 replicates of
    the `models` before and after the repair. Each curve is returned once; at most `MOST` in all and `OF_SENSOR` of one
    sensor. `names` are those of the logs (as in `where`); without them, a phase is identified by its own name.
    """
    curves = tuple((curve, summaries_of(campaign, curve)) for curve in curves_of(bench, campaign, where, MOST, names))
    if not curves:
        return ()
    sensors = {curve.sensor for curve, _ in curves}
    sides = [{name: of_sensor[name] for name in sorted(sensors)} for of_sensor in models]
    without_duplicates = sides if sides[0] != sides[1] else sides[:1]
    numbers = range(_FIRST, _FIRST + REPLICATES)
    groups = [numbers[first : first + TOGETHER] for first in range(0, REPLICATES, TOGETHER)]
    simulated = list(
        chain.from_iterable(
            run(_simulate, [_CurveRequest(side, some, curves) for side in without_duplicates for some in groups])
        )
    )
    before, after = simulated[:REPLICATES], simulated[-REPLICATES:]
    return tuple(
        _overlay(
            bench,
            curve,
            summaries,
            bands([replicate[at] for replicate in before]),
            bands([replicate[at] for replicate in after]),
        )
        for at, (curve, summaries) in enumerate(curves)
    )


def curves_of(
    bench: Bench, campaign: Campaign, where: Sequence[Where], most: int, names: Sequence[str] = ()
) -> tuple[Curve, ...]:
    """Return the curves to draw for the statistics `where`, worst first."""
    curves: dict[tuple[str, str, int], Curve] = {}
    many: Counter[str] = Counter()
    for entry in where:
        kind = KINDS.get(entry.domain)
        axis = entry.axis or next((other.axis for other in where if other.sensor == entry.sensor and other.axis), "x")
        what = (kind or "", entry.sensor, "xyz".index(axis))
        if kind is None or what in curves or many[entry.sensor] >= OF_SENSOR or len(curves) >= most:
            continue
        place = (
            _widest_heating(bench, campaign, entry)
            if kind == "temperature"
            else _phase(bench, campaign, entry, kind, names)
        )
        if place is not None:
            curves[what] = Curve(kind, entry.sensor, what[2], *place)
            many[entry.sensor] += 1
    return tuple(curves.values())


def summaries_of(campaign: Campaign, curve: Curve) -> tuple[Summary, ...]:
    """Return the summaries of the curve's phases, from a campaign that has all phases of its split."""
    return tuple(campaign.logs[curve.log].phases[at].sensors[curve.sensor] for at in curve.phases)


def drawn(curve: Curve, recorded: Sequence[Summary]) -> CurveShape:
    """Return the shape of a curve from the recorded summaries; simulations have the same x positions."""
    return _DRAWN[curve.kind](curve.axis, recorded)


def bands(replicates: Sequence[Floats]) -> Floats:
    """Return the median and the ends of the 95 % band (3, n) of replicates (n,); nan where fewer than half of them have
    a value.
    """
    values = np.array(replicates)
    table = np.full((3, values.shape[1]), np.nan)
    known = 2 * np.isfinite(values).sum(axis=0) >= len(values)
    table[:, known] = np.nanquantile(values[:, known], (0.5, 0.025, 0.975), axis=0)
    return table


def _simulate(bench: Bench, request: _CurveRequest) -> list[list[Floats]]:
    """Return all curves of each replicate; only the logs of these curves are simulated."""
    replicates = [(request.models, number) for number in request.numbers]
    campaigns = bench.campaigns(replicates, logs={curve.log for curve, _ in request.curves})
    return [
        [drawn(curve, recorded).values(summaries_of(campaign, curve)) for curve, recorded in request.curves]
        for campaign in campaigns
    ]


def _overlay(bench: Bench, curve: Curve, recorded: Sequence[Summary], before: Floats, after: Floats) -> Overlay:
    how, unit = drawn(curve, recorded), _readable(recorded[0])[1]
    x_label, y_label = _LABELS[curve.kind]
    real = how.values(recorded)
    where = _caption(bench, curve, recorded)
    label = y_label.replace("{u}", unit)
    return Overlay(curve.kind, curve.sensor, "xyz"[curve.axis], where, x_label, label, how.x, real, before, after)


def _caption(bench: Bench, curve: Curve, recorded: Sequence[Summary]) -> str:
    """Return the name of the phase, marked as held out."""
    share = bench.split.shares[curve.log]
    names = dict.fromkeys(summary.phase.name for summary in recorded)
    whole = ", ".join(names) if len(names) <= _NAMED else f"{bench.kinds[curve.log]}, {len(recorded)} phases"
    return f"{whole} ({'second halves' if len(recorded) > 1 else 'second half'})" if share.half else whole


def _phase(
    bench: Bench, campaign: Campaign, entry: Where, kind: Kind, names: Sequence[str]
) -> tuple[int, tuple[int, ...]] | None:
    """Return the held-out phase of a statistic, or else the longest one at rest: the spectrum of a moving box is not
    that of its noise.
    """
    own_log = _held_out_log(bench, campaign, entry, names)
    known = [
        (log, at)
        for log, at in _held_out(bench, campaign, entry.sensor)
        if kind == "codes" or campaign.logs[log].phases[at].is_still
    ]
    in_phase = [(log, at) for log, at in known if campaign.logs[log].phases[at].phase.name == entry.phase]
    still = [(log, at) for log, at in known if campaign.logs[log].phases[at].is_still]
    choice = [place for place in in_phase if place[0] == own_log] or in_phase or still
    if not choice:
        return None
    log, at = max(choice, key=lambda place: campaign.logs[place[0]].phases[place[1]].sensors[entry.sensor].rows)
    return log, (at,)


def _widest_heating(bench: Bench, campaign: Campaign, entry: Where) -> tuple[int, tuple[int, ...]] | None:
    """Return all held-out phases at rest of the log with the widest span of temperatures."""
    logs: dict[int, list[int]] = {}
    for log, at in _held_out(bench, campaign, entry.sensor):
        if campaign.logs[log].phases[at].is_still:
            logs.setdefault(log, []).append(at)

    def span_degc(log: int) -> float:
        parts = [campaign.logs[log].phases[at].sensors[entry.sensor].segments for at in logs[log]]
        return float(np.ptp(np.concatenate([part.temperature_degc[part.rows > 0] for part in parts])))

    if not logs:
        return None
    widest = max(logs, key=span_degc)
    return (widest, tuple(logs[widest])) if span_degc(widest) > 0 else None


def _held_out_log(bench: Bench, campaign: Campaign, entry: Where, names: Sequence[str]) -> int | None:
    """Return the held-out log of a pair of statistics, which is named by its training log."""
    train, held_out = (side(campaign).logs for side in (bench.split.train, bench.split.held_out))
    known = [names[log] for log in train] if names else []
    place = known.index(entry.log) if entry.log in known else len(held_out)
    return held_out[place] if place < len(held_out) else None


def _held_out(bench: Bench, campaign: Campaign, sensor: str) -> Iterator[tuple[int, int]]:
    """Yield the numbers (log, phase) of the held-out phases in which a sensor was read."""
    for log, (log_share, summary) in enumerate(zip(bench.split.shares, campaign.logs, strict=True)):
        for at, (out, phase) in enumerate(zip(log_share.held_out, summary.phases, strict=True)):
            if out and sensor in phase.sensors and phase.sensors[sensor].rows:
                yield log, at


def _spectrum(axis: int, recorded: Sequence[Summary]) -> CurveShape:
    """Return the amplitude spectral density without the bin of the mean."""
    rows_per_s = 1 / recorded[0].intervals.mean_s
    factor = _readable(recorded[0])[0] / recorded[0].header.sensitivity

    def values(summaries: Sequence[Summary]) -> Floats:
        density = summaries[0].spectrum.density[1:, axis]
        return np.asarray(factor * np.sqrt(density / rows_per_s))

    return CurveShape(np.asarray(recorded[0].spectrum.frequency_hz[1:] * rows_per_s), values)


def _allan(axis: int, recorded: Sequence[Summary]) -> CurveShape:
    """Return the Allan deviation."""
    factor = _readable(recorded[0])[0] / recorded[0].header.sensitivity
    known = recorded[0].allan.terms >= _TERMS
    factors = 2.0 ** np.flatnonzero(known)
    return CurveShape(
        np.asarray(factors * recorded[0].intervals.mean_s),
        lambda summaries: np.asarray(factor * np.sqrt(summaries[0].allan.variance[known, axis])),
    )


def _codes(axis: int, recorded: Sequence[Summary]) -> CurveShape:
    """Return the shares of the codes around the recorded median. A simulation is shifted to this median, because other
    curves show its level. It is shifted by a multiple of the code steps of both, so that its set of codes does not
    change.
    """
    real = recorded[0].codes[axis]
    middle, low, high = (_quantile(real, share) for share in (0.5, _RARE, 1 - _RARE))
    width = 1
    while 1.5 * (high - low) >= CODES * width:
        width *= 2  # a power of two: codes that are all even, or multiples of four, fill all bins equally
    margin = (high - low) // 4 + width
    edges = np.arange(low - margin, high + margin + width, width)

    def values(summaries: Sequence[Summary]) -> Floats:
        codes = summaries[0].codes[axis]
        step = int(np.lcm(_step(real), _step(codes)))
        shift = step * round((middle - _quantile(codes, 0.5)) / step)
        counts, _ = np.histogram(codes.codes + shift, edges - 0.5, weights=codes.counts)
        return np.asarray(counts / max(int(codes.counts.sum()), 1), float)

    return CurveShape(np.asarray(edges[:-1] + (width - 1) / 2, float), values)


def _temperature(axis: int, recorded: Sequence[Summary]) -> CurveShape:
    """Return the means of readings at similar recorded temperatures, less the mean of the whole log: the shape, not the
    level.
    """
    factor = _readable(recorded[0])[0] / recorded[0].header.sensitivity
    degc, rows = (
        np.concatenate([np.asarray(getattr(summary.segments, name), float) for summary in recorded])
        for name in ("temperature_degc", "rows")
    )
    is_usable = (rows > 0) & np.isfinite(degc)
    edges = np.linspace(degc[is_usable].min(), degc[is_usable].max(), BINS + 1)
    place = np.clip(np.searchsorted(edges, degc, side="right") - 1, 0, BINS - 1)
    filled = np.flatnonzero(np.bincount(place[is_usable], minlength=BINS))

    def means(of: Floats) -> Floats:
        known = is_usable & np.isfinite(of)
        weights = np.bincount(place[known], rows[known], BINS)[filled]
        sums = np.bincount(place[known], rows[known] * of[known], BINS)[filled]
        return np.asarray(np.divide(sums, weights, out=np.full(len(filled), np.nan), where=weights > 0))

    def values(summaries: Sequence[Summary]) -> Floats:
        course = means(factor * np.concatenate([summary.segments.mean[:, axis] for summary in summaries]))
        return np.asarray(course - np.nanmean(course)) if np.isfinite(course).any() else course

    return CurveShape(means(degc), values)


_DRAWN: Mapping[Kind, Callable[[int, Sequence[Summary]], CurveShape]] = MappingProxyType(
    {"spectrum": _spectrum, "allan": _allan, "codes": _codes, "temperature": _temperature}
)

_LABELS: Mapping[Kind, tuple[str, str]] = MappingProxyType(
    {
        "spectrum": ("frequency (Hz)", "amplitude density ({u}/√Hz)"),
        "allan": ("averaging time τ (s)", "Allan deviation ({u})"),
        "codes": ("code (LSB), simulations shifted to the recorded median", "share of readings"),
        "temperature": ("temperature (°C)", "mean reading less that of the log ({u})"),
    }
)


def _readable(summary: Summary) -> tuple[float, str]:
    return READABLE.get(summary.header.unit, (1.0, summary.header.unit))


def _quantile(histogram: Histogram, share: float) -> int:
    """Return the lowest code with at least this share of the readings at or below it; 0 without readings."""
    if not len(histogram.codes):
        return 0
    cumulative = np.cumsum(histogram.counts)
    return int(histogram.codes[min(int(np.searchsorted(cumulative, share * cumulative[-1])), len(histogram.codes) - 1)])


def _step(histogram: Histogram) -> int:
    """Return the greatest common divisor of the differences of the usual codes; 1 without codes."""
    usual = histogram.codes[histogram.counts > _RARE * histogram.counts.sum()]
    return max(int(np.gcd.reduce(np.diff(usual))), 1) if len(usual) > 1 else 1

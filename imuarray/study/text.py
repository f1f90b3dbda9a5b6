"""The study as a table for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from imuarray.fuse.fuse import AVERAGE
from imuarray.fuse.gains import Ratio
from imuarray.study.study import Row, Study
from imuarray.units import INERTIAL, READABLE_SI

_HEAD = f"  {'':18} {'rms':>8} {'over the average':>23} {'its drift':>23} {'over the bound':>23} {'normalised^2':>12}"

_NOTHING = 5e-4
"""A change of a ratio that three digits don't show."""

_WIDE = 20.0
"""Ends of an interval that are so many times apart tell nothing."""

WORDS = {
    "measured": "calibrated",
    "no slopes": "calibrated, no slopes with temperature",
    "true": "true parameters, model right",
}
"""What a calibration is called."""


def render_text(found: Study) -> str:
    """Lengths of error vectors, a line a technique that changes something; then coasting."""
    return "".join(f"{line}\n" for line in _lines(found))


def _lines(found: Study) -> Iterator[str]:
    yield f"seeds {found.seeds[0]} to {found.seeds[-1]}; error of the whole vector, 95 % intervals over the seeds"
    groups = dict.fromkeys((row.experiment, row.sensors, row.calibration) for row in found.rows)
    for experiment, sensors, calibration in groups:
        chosen = found.of(experiment=experiment, sensors=sensors, calibration=calibration)
        yield ""
        yield f"{experiment}: {sensors}, {WORDS[calibration]}"
        yield _HEAD
        for quantity in INERTIAL:
            vectors = [row for row in chosen if row.quantity == quantity and row.box_axis == "XYZ"]
            for row in [row for row in vectors if row.measure == "rms" and _shows(row)]:
                yield _vector_line(row, next(r for r in vectors if _same(r, row) and r.measure == "drift"))
        yield from _coasting_lines([row for row in chosen if not row.quantity])


def changed(row: Row) -> bool:
    """Whether a technique does anything here."""
    return abs(row.over_mean.ratio - 1) > _NOTHING


def _shows(row: Row) -> bool:
    return row.technique == AVERAGE or changed(row)


def _same(one: Row, other: Row) -> bool:
    return one.technique == other.technique


def _vector_line(row: Row, drift: Row) -> str:
    factor, unit = READABLE_SI[row.quantity]
    over_bound = "" if row.over_bound is None else interval_text(row.over_bound)
    normal = "" if row.normalised is None else f"{row.normalised:.2f} ({row.consistent:.0%})"
    value = f"{factor * row.value:8.3f} {unit:3}"
    return (
        f"  {row.technique:15} {value} {interval_text(row.over_mean):>22}"
        f" {interval_text(drift.over_mean):>23} {over_bound:>23} {normal:>12}"
    )


def _coasting_lines(rows: Sequence[Row]) -> Iterator[str]:
    for row in [row for row in rows if row.measure == "heading"]:
        velocity = next(other for other in rows if other.measure == "velocity" and _same(other, row))
        if _shows(row) or changed(velocity):
            yield (
                f"  {row.technique:15} after 60 s: heading {row.value:.3f} deg, {interval_text(row.over_mean)};"
                f" velocity {velocity.value:.3f} m/s, {interval_text(velocity.over_mean)}"
            )


def interval_text(ratio: Ratio) -> str:
    """A ratio with its interval, where there is one."""
    if ratio.low == ratio.high or not ratio.low < ratio.high:
        return f"{ratio.ratio:.3f}"
    if ratio.high > _WIDE * ratio.low:
        return f"{ratio.ratio:.3f} (too few seeds)"
    return f"{ratio.ratio:.3f} ({ratio.low:.3f}-{ratio.high:.3f})"

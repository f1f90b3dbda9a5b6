"""Report of a fused result (technique, noise, sensors and their exclusions, values over time), and of the gain of each
technique over the simple average on a log with truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.calibrate import Calibration
from imuarray.calibrate.noise import with_noise_of
from imuarray.errors import ImuArrayError
from imuarray.fuse import (
    FusedBlock,
    FusedHead,
    Score,
    TechniqueComparison,
    compare,
    quiet_noise,
    read_fused,
    read_fused_events,
)
from imuarray.log import Log
from imuarray.report.figures import course_figure, ratio_figure
from imuarray.report.page import Figure, Section, Table, Verdict
from imuarray.report.verdicts import fused_verdict, techniques_verdict
from imuarray.units import READABLE_SI

_POINTS = 2000
"""Means that are drawn of a course, however long."""

_EVENTS = 50
"""Events that have a row each: the first ones."""


@dataclass(frozen=True)
class _Course:
    """Means of so many frames each: time (n,) in s and triads (n, 3) in SI by quantity; use of sensors by quantity; the
    standard error (3,) in SI that the result claims where it is quietest, by quantity.
    """

    time_s: Floats
    triads: dict[str, Floats]
    frames: int
    used: dict[str, Floats]
    sigma: dict[str, Floats]


def fused_summary(path: Path, head: FusedHead) -> Iterator[str]:
    """Yield a line."""
    calibration = Path(head.calibration).name or "the data sheets"
    yield f"{path.name}: {head.frames} frames of {Path(head.log).name} fused by {head.technique} with {calibration}."
    if failed := _failed(path):
        yield f"{path.name}: left out for part of the time because they failed: {', '.join(failed)}."


def _failed(path: Path) -> list[str]:
    """Return the sensors that were left out for a time."""
    return sorted({event.sensor for event in read_fused_events(path) if event.state == "isolated"})


def fused_sections(path: Path, head: FusedHead, *, drawn: bool) -> tuple[Verdict, Section]:
    """Return the sections on the result's noise, the sensors that were in use, and its course; the verdict on it."""
    noise = quiet_noise(read_fused(path))
    course = _course(path, head.frames)
    rows = []
    for quantity, values in noise.items():
        factor, unit = READABLE_SI[quantity]
        own = course.sigma.get(quantity)
        for axis in range(3):
            deviation = f"{factor * own[axis]:.3f}" if own is not None and 0 < own[axis] < np.inf else "–"
            rows.append(
                [f"{quantity.replace('_', ' ')} {'XYZ'[axis]}", unit, f"{factor * values[axis]:.3f}", deviation]
            )
    heading = ["box axis", "unit", "scatter at rest", "error that it claims"]
    caption = (
        "Scatter from frame to frame in the quietest quarter, and the standard error that the result claims there."
    )
    parts: list[Table | Figure] = [Table(heading, rows, caption, (1,))]
    if use := _use_rows(head, course):
        words = "Share of frames in which an axis of the sensor was used; below 1, it was left out of some frames."
        parts.append(Table(["sensor", "x", "y", "z"], use, words))
    if events := _events(path):
        parts.append(events)
    if drawn:
        parts += [_drawn(quantity, course) for quantity in course.triads]
    section = Section(f"{path.name}: fused by {head.technique}", "The result in the box frame.", parts)
    return fused_verdict(path, head, noise, course.sigma, _failed(path)), section


def _events(path: Path) -> Table | None:
    """Return the table of fault events; None without events."""
    events = read_fused_events(path)
    rows = [[event.sensor, event.kind.replace("_", " "), event.message] for event in events[:_EVENTS]]
    more = f" The first {_EVENTS} of {len(events)}." if len(events) > _EVENTS else ""
    caption = f"Sensors that failed, the evidence in their readings, and the action taken.{more}"
    return Table(["sensor", "fault", "in words"], rows, caption, (1, 2)) if rows else None


def _drawn(quantity: str, course: _Course) -> Figure:
    factor, unit = READABLE_SI[quantity]
    name = quantity.replace("_", " ")
    drawing = course_figure(course.time_s, factor * course.triads[quantity], f"{name} ({unit})")
    caption = f"The fused {name} over time: steps without motion indicate that a sensor was left out or used again."
    return Figure(drawing, caption, f"Fused {name} along the three box axes against time")


def _use_rows(head: FusedHead, course: _Course) -> list[list[str]]:
    rows = []
    for quantity, names in head.sensors.items():
        shares = course.used.get(quantity)
        if shares is not None and len(names) == len(shares):
            rows += [[name, *(f"{part:.4f}" for part in own)] for name, own in zip(names, shares, strict=True)]
    return rows


def _course(path: Path, frames: int) -> _Course:
    """Means over stretches, a block at a time."""
    width = max(1, -(-frames // _POINTS))
    times: list[Floats] = []
    triads: dict[str, list[Floats]] = {}
    used: dict[str, Floats] = {}
    variances: dict[str, list[Floats]] = {}
    for block in read_fused(path, block=width * max(1, (1 << 14) // width)):
        first = np.arange(0, len(block.time), width)
        counts = np.diff(np.append(first, len(block.time)))
        times.append(np.add.reduceat(block.time * 1e-9, first) / counts)
        for quantity, rows in block.triads.items():
            triads.setdefault(quantity, []).append(np.add.reduceat(rows, first) / counts[:, None])
        for quantity, rows in block.covariances.items():
            variances.setdefault(quantity, []).append(_means(rows[:, :3], first))
        _add_use(block, used)
    return _Course(
        np.concatenate(times) if times else np.zeros(0),
        {quantity: np.concatenate(parts) for quantity, parts in triads.items()},
        frames,
        {quantity: counts / max(frames, 1) for quantity, counts in used.items()},
        {quantity: _quiet_error(np.concatenate(parts)) for quantity, parts in variances.items()},
    )


def _means(rows: Floats, first: Indices) -> Floats:
    """Return the means over stretches that begin at `first`, of the rows that are known; NaN where none is."""
    known = np.isfinite(rows)
    counts = np.add.reduceat(known.astype(float), first)
    sums = np.add.reduceat(np.where(known, rows, 0.0), first)
    return np.asarray(np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0))


def _quiet_error(variances: Floats) -> Floats:
    """Return the error (3,) of the lower quartile, as the scatter at rest is: in motion, uncertain times are added."""
    known = variances[np.isfinite(variances).all(axis=1)]
    quartile = np.quantile(known, 0.25, axis=0) if len(known) else np.full(3, np.nan)
    return np.asarray(np.sqrt(np.maximum(quartile, 0.0)))


def _add_use(block: FusedBlock, used: dict[str, Floats]) -> None:
    for quantity, bits in block.used.items():
        counts = np.stack([(bits & bit != 0).sum(axis=0) for bit in (1, 2, 4)], axis=1).astype(float)
        used[quantity] = used.get(quantity, 0.0) + counts


_Z95 = 1.96

_NOISE = 0.1
"""Share of the time that measuring the sensors' noise takes."""


class TechniqueGains(NamedTuple):
    """The section, and the verdict on what fusion gains (None: nothing can be said)."""

    section: Section
    verdict: Verdict | None = None


def techniques_section(
    log: Log,
    calibration: Calibration,
    *,
    drawn: bool,
    progress: Callable[[float], None] = lambda share: None,
    executor: Executor | None = None,
) -> TechniqueGains | None:
    """Return every technique beside the average; None for a log that knows no truth. Processes of the `executor`
    do a part.
    """
    if log.truth is None and log.reference is None:
        return None
    title = f"{log.path.name}: what each technique gains"
    try:
        known = with_noise_of(log, calibration, progress=lambda what, done, of: progress(_NOISE * done / of))
        comparison = compare(
            log, known, progress=lambda share: progress(_NOISE + (1 - _NOISE) * share), executor=executor
        )
    except ImuArrayError as error:
        return TechniqueGains(Section(title, f"It could not be evaluated: {error}."))
    scores = [score for score in comparison.scores if score.technique != "mean"]
    words = (
        "Rms error against the log's truth, divided by that of the simple average of the same sensors."
        " Below one is better."
    )
    parts: list[Table | Figure] = []
    if drawn:
        labels = [f"{score.technique}: {score.quantity.replace('_', ' ')}" for score in scores]
        ratios, errors = zip(*(_ratio(score) for score in scores), strict=True)
        drawing = ratio_figure(labels, ratios, errors)
        caption = "Blue: better than the average beyond chance; bars are two standard errors of this log alone."
        listed = ", ".join(f"{label} {ratio:.3f}" for label, ratio in zip(labels, ratios, strict=True))
        parts.append(Figure(drawing, caption, f"{caption} {listed}."))
    section = Section(title, words, [*parts, _table(comparison), *_coasting(comparison)])
    return TechniqueGains(section, techniques_verdict(log, comparison))


def _ratio(score: Score) -> tuple[float, float]:
    """Return the ratio of the whole vector's errors with its standard error."""
    ratio = score.ratio["XYZ"]
    wide = (ratio.high - ratio.low) / (2 * _Z95)
    return ratio.ratio, wide if np.isfinite(wide) else 0.0


def _table(comparison: TechniqueComparison) -> Table:
    rows = []
    for score in comparison.scores:
        factor, unit = READABLE_SI[score.quantity]
        ratio, held = score.ratio["XYZ"], score.consistency
        interval = f" ({ratio.low:.3f} to {ratio.high:.3f})" if np.isfinite([ratio.low, ratio.high]).all() else ""
        claimed = "–" if held is None else f"{held.normalised:.2f} ({held.low:.2f} to {held.high:.2f})"
        axes = [f"{factor * value:.3f}" for value in score.error.rms]
        name = f"{score.technique}: {score.quantity.replace('_', ' ')}"
        rows.append([name, unit, *axes, f"{ratio.ratio:.3f}{interval}", claimed])
    heading = ["technique", "unit", "rms X", "rms Y", "rms Z", "over the average (95 %)", "squared error over its own"]
    caption = (
        "The last column is the squared error divided by the one that the result claims, with the interval in which it"
        " should lie. Above it, the errors are larger than claimed."
    )
    return Table(heading, rows, caption, (1,))


def _coasting(comparison: TechniqueComparison) -> list[Table]:
    rows = [
        [name, f"{coast.heading_rms_deg:.3f}", f"{coast.velocity_rms_mps:.3f}", str(len(coast.begins_s))]
        for name, coast in comparison.coasting.items()
        if len(coast.begins_s)
    ]
    caption = "Errors of a navigator that stands still for ten seconds and then coasts on this result for a minute."
    return [Table(["technique", "heading °", "velocity m/s", "coasts"], rows, caption)] if rows else []

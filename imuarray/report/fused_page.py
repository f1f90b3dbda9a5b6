"""Report of a fused result (technique, noise, use of sensors, values over time), and of the gain of each technique over
the simple average on a log with truth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from imuarray.arrays import Floats, Indices, Reals
from imuarray.calibrate import Calibration
from imuarray.calibrate.noise import with_noise_of
from imuarray.errors import ImuArrayError
from imuarray.figures import PALETTE, new_figure
from imuarray.fuse import (
    FusedHead,
    Score,
    TechniqueComparison,
    compare,
    quiet_noise,
    read_fused,
    read_fused_events,
)
from imuarray.log import Log
from imuarray.printable import counted
from imuarray.report.page import Figure, Section, Table, Verdict
from imuarray.report.verdicts import fused_verdict, techniques_verdict
from imuarray.units import READABLE_SI

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_POINTS = 2000
"""Largest number of points of a drawn time series; each point is a mean of frames."""

_WHOLE = "1"

_EVENTS = 50
"""Largest number of events that the table shows."""


@dataclass(frozen=True)
class _TimeSeries:
    """Means of consecutive frames: time (n,) in s and triads (n, 3) in SI by quantity. Over all `frames`: the share
    (m, 3) in which each axis of each sensor was used, and the standard error (3,) in SI that the result claims in its
    quietest quarter, both by quantity.
    """

    time_s: Floats
    triads: dict[str, Floats]
    frames: int
    used: dict[str, Floats]
    sigma: dict[str, Floats]


def fused_summary(path: Path, head: FusedHead) -> Iterator[str]:
    """Yield a line on the origin of the result, and one on sensors that failed."""
    calibration = Path(head.calibration).name or "the data sheets"
    yield f"{path.name}: {head.frames} frames of {Path(head.log).name} fused by {head.technique} with {calibration}."
    if failed := _failed_sensors(path):
        yield f"{path.name}: excluded for part of the time because they failed: {', '.join(failed)}."


def _failed_sensors(path: Path) -> list[str]:
    return sorted({event.sensor for event in read_fused_events(path) if event.state == "isolated"})


def fused_sections(path: Path, head: FusedHead, *, with_figures: bool) -> tuple[Verdict, Section]:
    """Return the verdict on a result, and the section on its noise, its use of sensors and its values over time."""
    noise = quiet_noise(read_fused(path))
    series = _time_series(path, head.frames)
    rows = []
    for quantity, values in noise.items():
        factor, unit = READABLE_SI[quantity]
        own = series.sigma.get(quantity)
        for axis in range(3):
            deviation = f"{factor * own[axis]:.3f}" if own is not None and 0 < own[axis] < np.inf else "–"
            name = f"{quantity.replace('_', ' ')} {'XYZ'[axis]}"
            rows.append([name, unit, f"{factor * values[axis]:.3f}", deviation])
    heading = ["box axis", "unit", "scatter at rest", "claimed error"]
    caption = (
        "Scatter from frame to frame in the quietest quarter, and the standard error that the result claims there."
    )
    parts: list[Table | Figure] = [Table(heading, rows, caption, (1,))]
    words = "The result in the box frame."
    use = _use_rows(head, series)
    if use and all(share == _WHOLE for row in use for share in row[1:]):
        words += f" Every axis of {counted(len(use), 'sensor')} was used in every frame."
    elif use:
        shares = "Share of frames in which each axis of a sensor was used; below 1, it was excluded from some frames."
        parts.append(Table(["sensor", "x", "y", "z"], use, shares))
    if events := _events_table(path):
        parts.append(events)
    if with_figures:
        parts += [_time_plot(quantity, series) for quantity in series.triads]
    section = Section(f"{path.name}: fused by {head.technique}", words, parts)
    return fused_verdict(path, head, noise, series.sigma, _failed_sensors(path)), section


def _events_table(path: Path) -> Table | None:
    """Return the table of fault events; None without events."""
    events = read_fused_events(path)
    rows = [[event.sensor, event.kind.replace("_", " "), event.message] for event in events[:_EVENTS]]
    more = f" The first {_EVENTS} of {len(events)}." if len(events) > _EVENTS else ""
    caption = f"Sensors that failed, the evidence in their readings, and the action taken.{more}"
    return Table(["sensor", "fault", "in words"], rows, caption, (1, 2)) if rows else None


def _time_plot(quantity: str, series: _TimeSeries) -> Figure:
    factor, unit = READABLE_SI[quantity]
    name = quantity.replace("_", " ")
    drawing = time_figure(series.time_s, factor * series.triads[quantity], f"{name} ({unit})")
    caption = f"The fused {name} over time: steps without motion indicate that a sensor was excluded or used again."
    return Figure(drawing, caption, f"Fused {name} along the three box axes against time")


def _use_rows(head: FusedHead, series: _TimeSeries) -> list[list[str]]:
    rows = []
    for quantity, names in head.sensors.items():
        shares = series.used.get(quantity)
        if shares is not None and len(names) == len(shares):
            rows += [
                [name, *(_WHOLE if part == 1 else f"{min(part, 0.9999):.4f}" for part in share)]
                for name, share in zip(names, shares, strict=True)
            ]
    return rows


def _time_series(path: Path, frames: int) -> _TimeSeries:
    """Return the means of at most `_POINTS` stretches of equal length, read a block at a time."""
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
        for quantity, bits in block.used.items():
            counts_by_axis = np.stack([(bits & bit != 0).sum(axis=0) for bit in (1, 2, 4)], axis=1).astype(float)
            used[quantity] = used.get(quantity, 0.0) + counts_by_axis
    return _TimeSeries(
        np.concatenate(times) if times else np.zeros(0),
        {quantity: np.concatenate(parts) for quantity, parts in triads.items()},
        frames,
        {quantity: counts / max(frames, 1) for quantity, counts in used.items()},
        {quantity: _quiet_error(np.concatenate(parts)) for quantity, parts in variances.items()},
    )


def _means(rows: Floats, first: Indices) -> Floats:
    """Return the means of the finite rows of each stretch, which begin at `first`; NaN where a stretch has none."""
    is_finite = np.isfinite(rows)
    counts = np.add.reduceat(is_finite.astype(float), first)
    sums = np.add.reduceat(np.where(is_finite, rows, 0.0), first)
    return np.asarray(np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0))


def _quiet_error(variances: Floats) -> Floats:
    """Return the lower quartile (3,) of the claimed errors, to compare with the scatter at rest: in motion, the claim
    includes the effect of uncertain times.
    """
    finite = variances[np.isfinite(variances).all(axis=1)]
    quartile = np.quantile(finite, 0.25, axis=0) if len(finite) else np.full(3, np.nan)
    return np.asarray(np.sqrt(np.maximum(quartile, 0.0)))


_Z95 = 1.96

_NOISE = 0.1
"""Share of the time that measuring the sensors' noise takes."""


def techniques_section(
    log: Log,
    calibration: Calibration,
    *,
    with_figures: bool,
    progress: Callable[[float], None] = lambda share: None,
    executor: Executor | None = None,
) -> tuple[Section, Verdict | None] | None:
    """Return the section on what fusion gains over the average, and the verdict (None if the techniques could not be
    evaluated); None for a log without truth or reference. The processes of the `executor` do a part of the work.
    """
    if log.motion_track is None:
        return None
    title = f"{log.path.name}: gain of each technique"
    try:
        with_noise = with_noise_of(log, calibration, progress=lambda what, done, of: progress(_NOISE * done / of))
        comparison = compare(
            log, with_noise, progress=lambda share: progress(_NOISE + (1 - _NOISE) * share), executor=executor
        )
    except ImuArrayError as error:
        return Section(title, f"The techniques could not be evaluated: {error}."), None
    scores = [score for score in comparison.scores if score.technique != "mean"]
    words = (
        "Rms error against the log's truth, divided by that of the simple average of the same sensors."
        " Below one is better."
    )
    if not calibration.sensors:
        words += (
            " There is no calibration: the biases of the sensors dominate these errors, and no technique removes them."
            " Add a calibration (cal.toml) to the files of this report."
        )
    parts: list[Table | Figure] = []
    if with_figures:
        labels = [f"{score.technique}: {score.quantity.replace('_', ' ')}" for score in scores]
        ratios, errors = zip(*(_ratio(score) for score in scores), strict=True)
        drawing = ratio_figure(labels, ratios, errors)
        caption = "Blue: significantly better than the average; bars are two standard errors, from this log alone."
        listed = ", ".join(f"{label} {ratio:.3f}" for label, ratio in zip(labels, ratios, strict=True))
        parts.append(Figure(drawing, caption, f"{caption} {listed}."))
    section = Section(title, words, [*parts, _table(comparison), *_coasting(comparison)])
    return section, techniques_verdict(log, comparison)


def _ratio(score: Score) -> tuple[float, float]:
    """Return the ratio of the errors of the whole vector, and its standard error."""
    ratio = score.ratio["XYZ"]
    wide = (ratio.high - ratio.low) / (2 * _Z95)
    return ratio.ratio, wide if np.isfinite(wide) else 0.0


def _table(comparison: TechniqueComparison) -> Table:
    rows = []
    for score in comparison.scores:
        factor, unit = READABLE_SI[score.quantity]
        ratio, consistency = score.ratio["XYZ"], score.consistency
        interval = f" ({ratio.low:.3f} to {ratio.high:.3f})" if np.isfinite([ratio.low, ratio.high]).all() else ""
        claimed = (
            "–"
            if consistency is None
            else f"{consistency.normalised:.3g} ({consistency.low:.2f} to {consistency.high:.2f})"
        )
        axes = [f"{factor * value:.3f}" for value in score.error.rms]
        name = f"{score.technique}: {score.quantity.replace('_', ' ')}"
        rows.append([name, unit, *axes, f"{ratio.ratio:.3f}{interval}", claimed])
    rms = [f"rms {axis}" for axis in "XYZ"]
    heading = ["technique", "unit", *rms, "ratio to average (95 %)", "actual/claimed squared error"]
    caption = (
        "The last column is the squared error divided by the squared error that the result claims, in brackets the"
        " interval in which it should lie. Above the interval, the errors are larger than claimed."
    )
    return Table(heading, rows, caption, (1,))


def _coasting(comparison: TechniqueComparison) -> list[Table]:
    rows = [
        [name, f"{coast.heading_rms_deg:.3f}", f"{coast.velocity_rms_mps:.3f}", str(len(coast.begins_s))]
        for name, coast in comparison.coasting.items()
        if len(coast.begins_s)
    ]
    caption = "Errors of a navigator that is aligned at rest for 10 s and then dead-reckons with this result for 60 s."
    return [Table(["technique", "heading °", "velocity m/s", "coasts"], rows, caption)] if rows else []


def ratio_figure(labels: Sequence[str], ratios: Sequence[float], errors: Sequence[float]) -> Drawing:
    """Draw each error divided by that of the average, with two standard errors; below 1 is better."""
    figure = new_figure(8.0, 0.8 + 0.24 * len(labels))
    axes = figure.subplots()
    rows = np.arange(len(labels))[::-1]
    better = [ratio < 1 - 2 * error for ratio, error in zip(ratios, errors, strict=True)]
    colours = [PALETTE[1] if flag else PALETTE[0] for flag in better]
    axes.errorbar(ratios, rows, xerr=2 * np.asarray(errors), fmt="none", ecolor=PALETTE[0], elinewidth=1)
    axes.scatter(ratios, rows, color=colours, zorder=3, s=22)
    axes.axvline(1, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xticks([0.1, 0.2, 0.5, 1.0, 1.2], ["0.1", "0.2", "0.5", "1", "1.2"])
    axes.minorticks_off()
    axes.set_ylim(-0.7, len(labels) - 0.3)
    axes.set_yticks(rows, labels, fontsize=8)
    axes.set_xlabel("error over that of the simple average of the same sensors")
    axes.grid(axis="x", linewidth=0.4, alpha=0.6)
    return figure


def time_figure(time_s: Reals, triad: Reals, label: str) -> Drawing:
    """Draw a triad (n, 3) over time, a panel for each box axis."""
    figure = new_figure(8.0, 4.6)
    panels = figure.subplots(3, 1, sharex=True)
    for axis, panel in enumerate(panels):
        panel.plot(time_s, triad[:, axis], color=PALETTE[1 + axis], linewidth=0.9)
        panel.set_ylabel("XYZ"[axis], rotation=0, labelpad=12)
        panel.grid(linewidth=0.4, alpha=0.6)
    panels[-1].set_xlabel("time (s)")
    figure.suptitle(label, fontsize=10.5, x=0.02, ha="left")
    return figure

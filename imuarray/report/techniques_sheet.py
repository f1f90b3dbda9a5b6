"""Report of what each fusion technique gains over the simple average on a log that knows the truth."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np

from imuarray.calibrate import Calibration
from imuarray.calibrate.noise import with_noise_of
from imuarray.errors import ImuArrayError
from imuarray.fuse import Comparison, Score, compare
from imuarray.log import Log
from imuarray.report.figures import ratio_figure
from imuarray.report.page import Figure, Section, Table, Verdict
from imuarray.report.verdicts import techniques_verdict
from imuarray.units import READABLE_SI

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
    """Every technique beside the average; None for a log that knows no truth. Processes of the `executor` do a part."""
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


def _table(comparison: Comparison) -> Table:
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


def _coasting(comparison: Comparison) -> list[Table]:
    rows = [
        [name, f"{coast.heading_rms_deg:.3f}", f"{coast.velocity_rms_mps:.3f}", str(len(coast.begins_s))]
        for name, coast in comparison.coasting.items()
        if len(coast.begins_s)
    ]
    caption = "Errors of a navigator that stands still for ten seconds and then coasts on this result for a minute."
    return [Table(["technique", "heading °", "velocity m/s", "coasts"], rows, caption)] if rows else []

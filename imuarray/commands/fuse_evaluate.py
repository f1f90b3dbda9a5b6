"""The report of `imuarray fuse --evaluate`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from imuarray.commands.options import progress
from imuarray.printable import counted
from imuarray.units import READABLE_SI

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.fuse import Coasting, Comparison, Score
    from imuarray.log import Log


_STEPS = 1000
"""Steps of a progress bar."""


def evaluated(log: Log, calibration: Calibration, names: Sequence[str]) -> dict[str, Any]:
    """All techniques on a log (with these sensors, if any are named), JSON-ready; a bar on standard error."""
    from imuarray.fuse import compare

    with progress(_STEPS, "techniques") as done:
        comparison = compare(log, calibration, only=names, progress=lambda share: done(int(share * _STEPS)))
    return report_of(comparison)


def report_of(comparison: Comparison) -> dict[str, Any]:
    """Return the whole evaluation, JSON-ready, SI but for headings in degrees."""
    return {
        "scores": [_score(score) for score in comparison.scores],
        "coasting": {technique: _coasting(coast) for technique, coast in comparison.coasting.items()},
    }


def _score(score: Score) -> dict[str, Any]:
    error = score.error
    figures = {name: getattr(error, name).tolist() for name in ("mean", "noise", "rms", "drift")}
    return {
        "technique": score.technique,
        "quantity": score.quantity,
        "frames": error.frames,
        **figures,
        "ratio_to_mean": {
            axis: {name: _finite(value) for name, value in vars(ratio).items()} for axis, ratio in score.ratio.items()
        },
        "consistency": score.consistency and {**vars(score.consistency), "holds": score.consistency.holds},
    }


def _coasting(coast: Coasting) -> dict[str, Any]:
    return {
        "coasts": len(coast.begins_s),
        "heading_rms_deg": _finite(coast.heading_rms_deg),
        "velocity_rms_mps": _finite(coast.velocity_rms_mps),
        "heading_deg": coast.heading_deg.tolist(),
        "velocity_mps": coast.velocity_mps.tolist(),
        "begins_s": coast.begins_s.tolist(),
    }


_SHOWN = ("rms", "noise", "drift")


def print_report(report: dict[str, Any]) -> None:
    """A table per quantity, then coasting; mean errors are for programs."""
    for quantity, (factor, unit) in READABLE_SI.items():
        scores = [score for score in report["scores"] if score["quantity"] == quantity]
        if scores:
            frames = scores[0]["frames"]
            click.echo(
                f"{quantity.replace('_', ' ')}: errors against the truth along box x, y, z in {unit}, {frames} frames"
            )
            heads = "".join(f" {name:^23}" for name in _SHOWN)
            click.echo(f"  {'':8}{heads} {'rms over the mean':^22} normalised^2")
        for score in scores:
            click.echo(_line(score, factor))
    _print_coasting(report["coasting"])


def _line(score: dict[str, Any], factor: float) -> str:
    figures = " ".join(_three(factor * np.array(score[name])) for name in _SHOWN)
    ratio, held = score["ratio_to_mean"]["XYZ"], score["consistency"]
    interval = "-" if ratio["high"] is None else f"{ratio['ratio']:6.3f} ({ratio['low']:.3f} to {ratio['high']:.3f})"
    normal = "-" if held is None else f"{held['normalised']:.3g} ({held['low']:.2f} to {held['high']:.2f})"
    wrong = "" if held is None or held["holds"] else " !"
    return f"  {score['technique']:8} {figures} {interval:22} {normal}{wrong}"


def _print_coasting(coasting: dict[str, Any]) -> None:
    if not coasting:
        return
    if not any(coast["coasts"] for coast in coasting.values()):
        click.echo("coasting: the box never stood still long enough before a coast")
        return
    click.echo("coasting for a minute after standing still for ten seconds, rms")
    for technique, coast in coasting.items():
        heading, velocity = coast["heading_rms_deg"], coast["velocity_rms_mps"]
        if heading is not None:
            click.echo(
                f"  {technique:10} heading {heading:8.4f} deg   horizontal velocity {velocity:8.4f} m/s"
                f"   of {counted(coast['coasts'], 'coast')}"
            )


def _three(values: Any) -> str:
    return " ".join(f"{value:7.3f}" for value in values)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None

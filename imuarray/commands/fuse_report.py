"""The reports of `imuarray fuse`: estimated slow errors, what opposing axes cancel, and the evaluation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from typing import TYPE_CHECKING, Any

import click

from imuarray.commands.options import share_progress
from imuarray.fuse.technique_descriptions import NAME_WIDTH
from imuarray.json_values import json_value
from imuarray.printable import counted
from imuarray.units import INERTIAL, READABLE_SI

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.fuse import FusionNotes
    from imuarray.fuse.optimal import LearnedBias
    from imuarray.log import Log

_MOST_REMARKS = 40
"""Most remarks that are printed."""


def notes_sentences(notes: FusionNotes) -> Iterator[str]:
    """Yield a table of slow errors with a row for each sensor, and the remarks."""
    for quantity, biases in notes.biases.items():
        yield from _bias_table(quantity, biases)
    yield from notes.remarks[:_MOST_REMARKS]
    if len(notes.remarks) > _MOST_REMARKS:
        yield f"{len(notes.remarks) - _MOST_REMARKS} more remarks (--json lists all)"


def _bias_table(quantity: str, biases: Sequence[LearnedBias]) -> Iterator[str]:
    """Yield the table of one quantity: the slow error of every axis with its standard deviation, and the prior one."""
    factor, unit = READABLE_SI[quantity]
    earlier = [factor * bias.sd_before for bias in biases]
    span = f"{min(earlier):.3g}" if max(earlier) < 1.005 * min(earlier) else f"{min(earlier):.3g} to {max(earlier):.3g}"
    yield f"slow errors of the {quantity} sensors at the end, {unit} (before: 0 +- {span})"
    for sensor, axes in groupby(biases, key=lambda bias: bias.axis.rpartition(" ")[0]):
        cells = (
            f"{axis_bias.axis[-1]} {factor * axis_bias.bias:+9.3f} +- {factor * axis_bias.sd:.3f}" for axis_bias in axes
        )
        yield f"  {sensor:8} {'  '.join(cells)}"


# Opposing axes -----------------------------------------------------------------------------------------------------

_SIGNIFICANT = 0.05
_WORTH = 1.25
"""Least significant reduction of the error for which opposing axes are recommended."""

_MOST_PAIRS = 20
"""Most pairs that are printed."""

_HEADING = f"{'each':>8} {'together':>9} {'factor':>12}"


def pairs_of(log: Log, calibration: Calibration, names: Sequence[str]) -> list[dict[str, Any]]:
    """Return every opposing pair of the fused sensors in SI, JSON-ready; None stands for infinity."""
    from imuarray.fuse.techniques.opposed import capabilities

    pairs = []
    for quantity in INERTIAL:
        for pair in capabilities(log.of(quantity, names), calibration):
            figures = asdict(pair)
            for name in ("drift", "bias"):
                if (error := figures[name]) is not None:  # with the former names of two figures
                    error |= {"left": error["remaining"], "left_sem": error["remaining_sem"]}
            pairs.append({"quantity": quantity, **json_value(figures)})
    return pairs


def pair_lines(pairs: Sequence[dict[str, Any]], *, follows_temperature: bool) -> Iterator[str]:
    """Yield a table of the first pairs whose errors the calibration states, and a line on all others.
    `follows_temperature`: known slopes are removed before axes are averaged.
    """
    stated = [pair for pair in pairs if pair["drift"] is not None or pair["bias"] is not None]
    if stated:
        drift = any(pair["drift"] is not None for pair in stated)
        width = max(22, *(len(_axes(pair)) for pair in stated[:_MOST_PAIRS]))
        heads = f"   {'drift with 1 degC':{len(_HEADING)}}  " if drift else ""
        yield f"{'opposing axes of one design':{width + 22}}{heads} bias"
        yield f"{'':{width + 22}}{f'{_HEADING}   ' if drift else ''}{_HEADING}"
        for pair in stated[:_MOST_PAIRS]:
            yield _pair_row(pair, width, drift=drift)
        scale = "; *: the slope may be that of scale, which does not cancel" if drift else ""
        yield f"factor: by which averaging opposing axes reduces it, 95 % interval; -: no significant gain{scale}"
        known_errors = "biases and slopes" if follows_temperature else "biases"
        yield f"the calibration removes known {known_errors}; opposing axes cancel what has changed since"
    if len(stated) > _MOST_PAIRS:
        yield f"{len(stated) - _MOST_PAIRS} more opposing pairs (--json lists all)"
    if len(stated) < len(pairs):
        yield f"{len(pairs) - len(stated)} opposing pairs: cancellation unknown; run `imuarray calibrate thermal`"


def _axes(pair: dict[str, Any]) -> str:
    return f"{pair['first']} and {pair['second']}"


def _pair_row(pair: dict[str, Any], width: int, *, drift: bool) -> str:
    factor, unit = READABLE_SI[pair["quantity"]]
    doubt = " " if pair["is_bias"] else "*"
    slope = f"{_cells(pair['drift'], factor)} {doubt} " if drift else ""
    place = f"{_axes(pair):{width}} along {pair['box_axis']}   in {unit:5}   "
    return f"{place}{slope}{_cells(pair['bias'], factor)}".rstrip()


def _cells(error: dict[str, Any] | None, factor: float) -> str:
    """Return the errors of a single axis and of the mean, and their ratio if the gain is significant."""
    if error is None:
        return " " * len(_HEADING)
    sizes = f"{factor * error['single']:8.3g} {factor * abs(error['remaining']):9.3g}"
    if error["p_value"] > _SIGNIFICANT or (error["reduction"] is not None and error["reduction"] < _WORTH):
        return f"{sizes} {'-':>12}"
    if error["most"] is None:
        return f"{sizes} {'> ' + format(error['least'], '.3g'):>12}"
    return f"{sizes} {format(error['least'], '.3g') + ' to ' + format(error['most'], '.3g'):>12}"


# Evaluation --------------------------------------------------------------------------------------------------------


def evaluate_techniques(log: Log, calibration: Calibration, names: Sequence[str]) -> dict[str, Any]:
    """Return the evaluation of all techniques on a log, JSON-ready, in SI except for headings in degrees, and show a
    progress bar. Only sensors in `names` are used if it is not empty.
    """
    from imuarray.fuse import compare

    with share_progress("techniques") as progress:
        comparison = compare(log, calibration, only=names, progress=progress)
    scores = [
        {
            "technique": score.technique,
            "quantity": score.quantity,
            **vars(score.error),
            "ratio_to_mean": score.ratio,
            "consistency": score.consistency and {**vars(score.consistency), "holds": score.consistency.holds},
        }
        for score in comparison.scores
    ]
    coasting = {
        technique: {
            "coasts": len(coast.begins_s),
            "heading_rms_deg": coast.heading_rms_deg,
            "velocity_rms_mps": coast.velocity_rms_mps,
            **vars(coast),
        }
        for technique, coast in comparison.coasting.items()
    }
    return {"scores": json_value(scores), "coasting": json_value(coasting)}


_PRINTED_MEASURES = ("rms", "noise", "drift")


def print_evaluation(report: dict[str, Any]) -> None:
    """Print a table for each quantity, then coasting; mean errors are only in JSON."""
    for quantity, (factor, unit) in READABLE_SI.items():
        scores = [score for score in report["scores"] if score["quantity"] == quantity]
        if scores:
            frames = scores[0]["frames"]
            click.echo(
                f"{quantity.replace('_', ' ')}: errors against the truth along box x, y, z in {unit}, {frames} frames"
            )
            heads = "".join(f" {name:^23}" for name in _PRINTED_MEASURES)
            click.echo(f"  {'':{NAME_WIDTH}}{heads} {'rms over the mean':^22} normalised^2")
        for score in scores:
            click.echo(_score_line(score, factor))
    _print_coasting(report["coasting"])


def _score_line(score: dict[str, Any], factor: float) -> str:
    triads = (" ".join(f"{factor * value:7.3f}" for value in score[name]) for name in _PRINTED_MEASURES)
    ratio, consistency = score["ratio_to_mean"]["XYZ"], score["consistency"]
    interval = "-" if ratio["high"] is None else f"{ratio['ratio']:6.3f} ({ratio['low']:.3f} to {ratio['high']:.3f})"
    normal = (
        "-"
        if consistency is None
        else f"{consistency['normalised']:.3g} ({consistency['low']:.2f} to {consistency['high']:.2f})"
    )
    wrong = "" if consistency is None or consistency["holds"] else " !"
    return f"  {score['technique']:{NAME_WIDTH}} {' '.join(triads)} {interval:22} {normal}{wrong}"


def _print_coasting(coasting: dict[str, Any]) -> None:
    if not coasting:
        return
    if not any(coast["coasts"] for coast in coasting.values()):
        click.echo("coasting: the box was never at rest long enough before a coast")
        return
    click.echo("coasting for 60 s after 10 s at rest, rms")
    for technique, coast in coasting.items():
        heading, velocity = coast["heading_rms_deg"], coast["velocity_rms_mps"]
        if heading is not None:
            click.echo(
                f"  {technique:{NAME_WIDTH}}   heading {heading:8.4f} deg   horizontal velocity {velocity:8.4f} m/s"
                f"   of {counted(coast['coasts'], 'coast')}"
            )

"""The report of `imuarray fuse --technique opposed` on pairs of anti-parallel axes: how much each can cancel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from imuarray.units import INERTIAL, READABLE_SI

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.fuse.techniques.opposed import Reduction
    from imuarray.log import Log

_SIGNIFICANT = 0.05
_WORTH = 1.25
"""An error that is so many times less, for sure, is worth opposing axes for."""

_MOST = 20
"""Pairs that are told on the screen."""

_HEADING = f"{'each':>8} {'together':>9} {'less by':>12}"


def pairs_of(log: Log, calibration: Calibration, names: Sequence[str]) -> list[dict[str, Any]]:
    """Every pair of the fused sensors, SI, JSON-ready: None stands for infinite."""
    from imuarray.characterise.result import json_ready
    from imuarray.fuse.techniques.opposed import capabilities

    pairs = []
    for quantity in INERTIAL:
        sensors = [sensor for sensor in log.of(quantity) if not names or sensor.name in names]
        for pair in capabilities(sensors, calibration):
            errors = {name: _former_names(getattr(pair, name)) for name in ("drift", "bias")}
            pairs.append({"quantity": quantity, **json_ready(asdict(pair) | errors)})
    return pairs


def _former_names(error: Reduction | None) -> dict[str, Any] | None:
    """The figures of an error, and the former names `left` and `left_sem` of two, for programs that read them."""
    if error is None:
        return None
    return {**vars(error), "left": error.remaining, "left_sem": error.remaining_sem}


def pair_lines(pairs: Sequence[dict[str, Any]], *, follows_temperature: bool) -> Iterator[str]:
    """A table of the first pairs that the calibration knows something of, and a line for all others;
    `follows_temperature`: slopes are taken out before the axes meet.
    """
    known = [pair for pair in pairs if pair["drift"] is not None or pair["bias"] is not None]
    if known:
        yield f"{'axes of one design that oppose each other':43}{'drift with 1 degC':>30}{'bias':>33}"
        yield f"{'':43}{_HEADING}   {_HEADING}"
        yield from map(_row, known[:_MOST])
        yield "less by: 95 % interval; -: no significant gain; *: the slope may be that of scale, which does not cancel"
        taken = "biases and slopes" if follows_temperature else "biases"
        yield f"the calibration removes known {taken}; opposing the axes cancels what has changed since"
    if len(known) > _MOST:
        yield f"{len(known) - _MOST} more opposing pairs (--json lists all)"
    if len(known) < len(pairs):
        yield f"{len(pairs) - len(known)} opposing pairs: cancellation unknown; run `imuarray calibrate thermal`"


def _row(pair: dict[str, Any]) -> str:
    """A pair in the table."""
    factor, unit = READABLE_SI[pair["quantity"]]
    axes = f"{pair['first']} and {pair['second']}"
    doubt = " " if pair["is_bias"] else "*"
    drift, bias = (_cells(pair[what], factor) for what in ("drift", "bias"))
    return f"{axes:22} along {pair['box_axis']}   in {unit:5}   {drift} {doubt} {bias}".rstrip()


def _cells(error: dict[str, Any] | None, factor: float) -> str:
    """The errors of each axis and of both together, and their ratio where the gain is significant."""
    if error is None:
        return " " * len(_HEADING)
    sizes = f"{factor * error['single']:8.3g} {factor * abs(error['remaining']):9.3g}"
    if error["p_value"] > _SIGNIFICANT or (error["reduction"] is not None and error["reduction"] < _WORTH):
        return f"{sizes} {'-':>12}"
    if error["most"] is None:
        return f"{sizes} {'> ' + format(error['least'], '.3g'):>12}"
    return f"{sizes} {format(error['least'], '.3g') + ' to ' + format(error['most'], '.3g'):>12}"

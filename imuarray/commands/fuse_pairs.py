"""What `imuarray fuse --technique opposed` says of every pair of anti-parallel axes: how much it can cancel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from imuarray.units import INERTIAL, READABLE_SI

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.log import Log

_SIGNIFICANT = 0.05
_WORTH = 1.25
"""An error that is so many times less, for sure, is worth opposing axes for."""

_MOST = 20
"""Pairs that are told on the screen."""


def pairs_of(log: Log, calibration: Calibration, names: Sequence[str]) -> list[dict[str, Any]]:
    """Every pair of the fused sensors, SI, JSON-ready: None stands for infinite."""
    from imuarray.characterise.result import json_ready
    from imuarray.fuse.techniques.pairs import capabilities

    found = []
    for quantity in INERTIAL:
        sensors = [sensor for sensor in log.of(quantity) if not names or sensor.name in names]
        found += [{"quantity": quantity, **json_ready(asdict(pair))} for pair in capabilities(sensors, calibration)]
    return found


def pair_sentences(pairs: Sequence[dict[str, Any]]) -> Iterator[str]:
    """A line a pair that the calibration knows something of, of the first ones; one line for all others."""
    known = [pair for pair in pairs if pair["drift"] is not None or pair["bias"] is not None]
    for pair in known[:_MOST]:
        said = [
            _said(pair, what, name)
            for what, name in (("drift", "drift with temperature"), ("bias", "bias"))
            if pair[what] is not None
        ]
        doubt = "" if pair["is_bias"] else " (a slope may be one of scale, which does not cancel)"
        yield f"{pair['first']} against {pair['second']} along {pair['box_axis']}: {'; '.join(said)}{doubt}"
    if len(known) > _MOST:
        yield f"{len(known) - _MOST} more opposing pairs (--json lists all)"
    if len(known) < len(pairs):
        yield f"{len(pairs) - len(known)} opposing pairs: what they cancel is not known (`imuarray calibrate thermal`)"


def _said(pair: dict[str, Any], what: str, name: str) -> str:
    """An error in words; a reduction only where opposing the axes gains something for sure."""
    error = pair[what]
    factor, unit = READABLE_SI[pair["quantity"]]
    unit = f"{unit}/degC" if what == "drift" else unit
    sizes = f"{factor * error['single']:.3g} {unit} each, {factor * abs(error['left']):.2g} together"
    if error["p_value"] > _SIGNIFICANT or (error["reduction"] is not None and error["reduction"] < _WORTH):
        return f"{name} {sizes}: no gain to speak of"
    if error["most"] is None:
        return f"{name} {sizes}: at least {error['least']:.3g} times less (95 %)"
    return f"{name} {sizes}: {error['least']:.3g} to {error['most']:.3g} times less (95 %)"

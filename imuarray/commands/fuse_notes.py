"""The report of `imuarray fuse` on the sensors: the slow errors that were estimated, and remarks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from imuarray.units import READABLE_SI

if TYPE_CHECKING:
    from imuarray.fuse import FusionNotes
    from imuarray.fuse.optimal import LearnedBias

_MOST = 40
"""Remarks that are printed."""


def notes_sentences(notes: FusionNotes) -> Iterator[str]:
    """A table of biases, a row a sensor, and the remarks."""
    for quantity, biases in notes.biases.items():
        yield from _table(quantity, biases)
    yield from notes.remarks[:_MOST]
    if len(notes.remarks) > _MOST:
        yield f"{len(notes.remarks) - _MOST} more remarks (--json lists all)"


def _table(quantity: str, biases: Sequence[LearnedBias]) -> Iterator[str]:
    """The table of one quantity: the slow error of every axis with its uncertainty, and the uncertainty before."""
    factor, unit = READABLE_SI[quantity]
    before = [factor * bias.sd_before for bias in biases]
    span = f"{min(before):.3g}" if max(before) < 1.005 * min(before) else f"{min(before):.3g} to {max(before):.3g}"
    yield f"slow errors of the {quantity} sensors at the end, {unit} (before: 0 +- {span})"
    for sensor, axes in groupby(biases, key=lambda bias: bias.axis.rpartition(" ")[0]):
        cells = (f"{each.axis[-1]} {factor * each.bias:+9.3f} +- {factor * each.sd:.3f}" for each in axes)
        yield f"  {sensor:8} {'  '.join(cells)}"

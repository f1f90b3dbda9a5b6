"""`mean`: every axis weighs the same."""

from __future__ import annotations

from collections.abc import Sequence

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.solve import weighted
from imuarray.fuse.techniques.technique import Technique, noise_of


def mean(axes: Sequence[Axis]) -> Technique:
    """The simple average of the literature (paper, section 2): the yardstick."""
    rows, noise = directions(axes), noise_of(axes)
    return lambda frames: weighted(frames.values, frames.valid.astype(float), rows, noise)

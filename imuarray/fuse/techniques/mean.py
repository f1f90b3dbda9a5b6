"""`mean`: every axis weighs the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.solve import SlowErrors
from imuarray.fuse.techniques.technique import FixedWeights, Technique, noise_of


def mean(axes: Sequence[Axis]) -> Technique:
    """The simple average of the literature (paper, section 2): the yardstick."""
    return FixedWeights(directions(axes), np.ones(len(axes)), noise_of(axes), SlowErrors(axes))

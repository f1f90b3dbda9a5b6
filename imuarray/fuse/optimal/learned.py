"""What an array has found out about its own slow errors: for reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imuarray.fuse.axes import Axis
from imuarray.fuse.optimal.filter import ArrayFilter


@dataclass(frozen=True)
class LearnedBias:
    """The slow error of one axis as it is felt now, in m/s2 or rad/s along the axis: all states but those of its
    response. `sd_before`: its standard deviation had the log told nothing.
    """

    axis: str
    bias: float
    sd: float
    sd_before: float


def learned_biases(axes: Sequence[Axis], of: ArrayFilter) -> list[LearnedBias]:
    """Every axis's, in order."""
    rows = of.states.rows(of.warmer_degc)[0][: len(axes)]
    biases = rows @ of.belief.mean
    spreads = [
        np.sqrt(np.maximum(np.einsum("in,nk,ik->i", rows, covariance, rows), 0.0))
        for covariance in (of.belief.covariance, of.states.prior)
    ]
    return [
        LearnedBias(axis.label, float(bias), float(sd), float(sd_before))
        for axis, bias, sd, sd_before in zip(axes, biases, *spreads, strict=True)
    ]

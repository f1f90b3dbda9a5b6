"""Which measurement would tell what the printed tables can't."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from imuarray.paper.gap.candidate import Discrepancy
from imuarray.paper.gap.wander import LEVELS
from imuarray.paper.replica.statistic import Statistic

SEPARATES: Mapping[frozenset[str], str] = MappingProxyType(
    {
        frozenset(
            {"bandwidth", "stale_samples"}
        ): "log Gyro1 alone at 350 Hz with its data-ready bits: repeated triads are stale_samples, none is bandwidth",
        frozenset(
            {"odr_error", "quantisation"}
        ): "read BW_RATE of the ADXL345 back, and log it at 100 Hz: odd codes and 0.75 LSB rms are odr_error",
        frozenset(
            {"bias_instability", "random_walk"}
        ): "one run of a day: random_walk keeps growing, bias_instability levels off",
    }
)
"""By the two effects that are to be told apart."""


def next_experiment(found: Sequence[Discrepancy], left: Sequence[Statistic]) -> str:
    """The days' levels first, if they are what is left most often; then pairs that are confusable."""
    wanted = []
    if any(row.statistic in LEVELS for row in left):
        wanted.append("switch the array on a dozen times a day for several days, a reference thermometer beside it")
    for one in found:
        pairs = [frozenset({name, other}) for name in one.best.names for other in one.confusable_with(name)]
        wanted += [SEPARATES[pair] for pair in pairs if pair in SEPARATES]
    return "; ".join(wanted)

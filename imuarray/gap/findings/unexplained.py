"""What the causes leave: single statistics that are beyond chance, and probes that are off to one side everywhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.gap.findings.diagnosis import Cause, Where
from imuarray.gap.findings.verdict import beyond_form
from imuarray.gap.inference.assessment import MORE, Assessment
from imuarray.gap.inference.comparison import Comparison
from imuarray.gap.inference.residuals import GroupResidual, overall
from imuarray.gap.model.bench import StatisticValues

ALIKE = 2.0
"""An average is so much beyond any replicate's to be something else: of forty phases it tells what no use would notice,
as that a telegraph is a little longer in one of its states than the effect has it.
"""


def left_single(after: Assessment) -> list[int]:
    """Places of what is still beyond chance, the worst first."""
    sizes = np.nan_to_num(np.abs(after.scores))
    return [int(at) for at in np.argsort(-sizes) if sizes[at] > after.limit]


def is_left_single(
    found: Comparison,
    after: Assessment,
    came: Sequence[StatisticValues],
    left: Sequence[int],
    unexplained: Sequence[Where],
) -> bool:
    """Whether something that matters is left that the causes' form doesn't excuse, well beyond any replicate's:
    of a few events one in thirty is a strange one.
    """
    scores = beyond_form(found.pairs, found.judged, after, found.real.values, np.array([one.values for one in came]))
    sizes = np.nan_to_num(np.abs(scores))[left].tolist()
    told = zip(unexplained, sizes, strict=False)
    return any(one.size == "material" and size > MORE * after.furthest for one, size in told)


def left_alike(
    found: Comparison, after: Assessment, came: Sequence[StatisticValues], causes: Sequence[Cause]
) -> list[GroupResidual]:
    """What sensors with a cause keep to one side of it in all their phases, well beyond any replicate."""
    concerned = {name for cause in causes for name in cause.sensors}
    values = np.array([one.values for one in came])
    told = overall(found.bench.keys, found.judged.likeness, after.likeness, found.real.values, values)
    return [one for one in told if one.sensor in concerned and abs(one.score) > ALIKE * one.furthest]


def worst_of(found: Comparison, after: Assessment, alike: Sequence[GroupResidual], told: Sequence[int]) -> list[int]:
    """Where each probe of a sensor that is left overall shows most, as places of pairs; none that is `told` already."""
    sizes, keys = np.nan_to_num(np.abs(after.scores)), found.pairs.keys
    worst: dict[tuple[str, str], int] = {}
    for one in alike:
        own = [at for at, key in enumerate(keys) if (key.sensor, key.probe) == (one.sensor, one.probe)]
        worst.setdefault((one.sensor, one.probe), max(own, key=lambda at: sizes[at]))
    known = {(keys[at].sensor, keys[at].probe) for at in told}
    return [at for place, at in worst.items() if place not in known]

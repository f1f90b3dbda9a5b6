"""Systematic residuals: the mean residual of each probe of a sensor over all its phases.

A cause of another form than the real one can fit every single statistic by its scatter: rare glitches of either sign
make a skewness of 5 as likely as one of -5, but not forty phases with skewness of one sign. The residuals of the
repaired model are therefore averaged over phases and over axes as well, and the averages compared with those of its
replicates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.synthetic_likelihood import FORM, SyntheticLikelihood

LEAST = 12
"""Fewest statistics of a group: levels of runs, and statistics of a whole log, come twice on each axis and are judged
singly.
"""

_WILD = 5.0
_LEAST_SPREAD = 0.5
"""Least scatter of scores, over the root of their number, for averages that hardly scatter."""


class GroupResidual(NamedTuple):
    """One probe of one sensor over all phases, of one `axis` or of all ("").

    Its `places` among n statistics, the deviation of their mean from that of the replicates (`score`, in standard
    deviations, with an allowance for the causes' form), and the largest such score of any replicate in any group by the
    others (`furthest`, the same for all).
    """

    sensor: str
    axis: str
    probe: str
    places: Indices
    score: float
    furthest: float


def group_residuals(
    keys: Sequence[Key], before: SyntheticLikelihood, after: SyntheticLikelihood, real: Floats, replicates: Floats
) -> list[GroupResidual]:
    """Return the systematic residuals, the worst first, of n statistics of the recording (`real`) and of `replicates`
    (b, n) of the model with its causes.

    `after` is the likelihood of that model, `before` that of the base model. Causes are allowed the relative error of
    form of their shifts. Single statistics count up to five standard deviations, so that none dominates. The
    correlation of axes is ignored: effects are drawn for each axis, although a supply, or a bearing, has one course for
    all.
    """
    scores, real_scores = (np.clip(after.scores(values), -_WILD, _WILD) for values in (replicates, real))
    shift = np.nan_to_num(np.abs(after.location - before.location))
    excused = np.minimum(FORM * shift / after.scale, _WILD)
    says = np.isfinite(real_scores) & np.isfinite(scores).all(axis=0) & ~after.is_silent
    groups = list(_groups(keys, says))
    if not groups:
        return []
    means = np.stack([scores[:, places].mean(axis=1) for *_, places in groups], axis=1)
    least = _LEAST_SPREAD / np.sqrt([len(places) for *_, places in groups])
    form = np.array([excused[places].mean() for *_, places in groups])
    deviation = np.array([real_scores[places].mean() for *_, places in groups]) - means.mean(axis=0)
    score_of_group = deviation / np.hypot(np.maximum(means.std(axis=0, ddof=1), least), form)
    furthest = float(np.abs(_by_others(means, least)).max())
    order = np.argsort(-np.abs(score_of_group))
    scored = zip(groups, score_of_group.tolist(), strict=True)
    groups_scored = [
        GroupResidual(sensor, axis, probe, places, score, furthest) for (sensor, axis, probe, places), score in scored
    ]
    return [groups_scored[at] for at in order.tolist()]


def _groups(keys: Sequence[Key], says: Booleans) -> Iterator[tuple[str, str, str, Indices]]:
    places: dict[tuple[str, str, str], list[int]] = {}
    for at in np.flatnonzero(says).tolist():
        if keys[at].domain == "cross_sensor":
            continue
        for axis in {keys[at].axis, ""}:
            places.setdefault((keys[at].sensor, axis, keys[at].probe), []).append(at)
    for place, members in places.items():
        if len(members) >= LEAST:
            yield place[0], place[1], place[2], np.array(members, np.intp)


def _by_others(means: Floats, least: Floats) -> Floats:
    """Means (b, g) of each replicate, in standard deviations (at least `least`) of the others'."""
    count = len(means)
    deviation = (means - means.mean(axis=0)) * count / (count - 1)
    squares = ((means - means.mean(axis=0)) ** 2).sum(axis=0) - deviation**2 * (count - 1) / count
    return np.asarray(deviation / np.maximum(np.sqrt(np.maximum(squares, 0.0) / (count - 2)), least))

"""What is left a little everywhere and always to the same side: each probe of a sensor over all its phases.

A cause of another form than the real one can reach every statistic by making it scatter: rare glitches of either sign
make a skewness of 5 as likely as one of -5. That forty phases are all skewed to the same side is nothing that it makes.
So what the repaired model leaves is averaged over phases as well, and over axes, and the averages are judged by those
of its replicates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.synthetic_likelihood import FORM, SyntheticLikelihood

LEAST = 12
"""Fewer statistics are judged one by one: levels of runs, and what a log says once, come twice on each axis."""

_WILD = 5.0
_LEAST_SPREAD = 0.5
"""Of scores, over the root of their number: averages that hardly scatter at all say no more than that."""


class GroupResidual(NamedTuple):
    """One probe of one sensor over all phases, of one `axis` or of all (""): its `places` among n statistics, how far
    their mean lies from that of the replicates (`score`, in standard deviations, the causes' form excused), and the
    largest such score that any replicate has in any group by the others (`furthest`, the same for all).
    """

    sensor: str
    axis: str
    probe: str
    places: Indices
    score: float
    furthest: float


def overall(
    keys: Sequence[Key], before: SyntheticLikelihood, after: SyntheticLikelihood, real: Floats, replicates: Floats
) -> list[GroupResidual]:
    """By n statistics of the recording, `real` (n,), and of `replicates` (b, n) of the model with the causes in, that
    made of them what `after` says, and the base model what `before` does. The worst first.

    The causes may miss what they have moved by the share by which the form of the right ones may be wrong, everywhere
    alike. Single statistics count up to five standard deviations, so that none stands for many. How axes hang together
    is left aside: what effects draw they draw for each axis, and one supply, or one bearing, has one course for all.
    """
    scores, own = (np.clip(after.scores(values), -_WILD, _WILD) for values in (replicates, real))
    moved = np.nan_to_num(np.abs(after.location - before.location))
    excused = np.minimum(FORM * moved / after.scale, _WILD)
    says = np.isfinite(own) & np.isfinite(scores).all(axis=0) & ~after.is_silent
    groups = list(_groups(keys, says))
    if not groups:
        return []
    means = np.stack([scores[:, places].mean(axis=1) for *_, places in groups], axis=1)
    least = _LEAST_SPREAD / np.sqrt([len(places) for *_, places in groups])
    form = np.array([excused[places].mean() for *_, places in groups])
    apart = np.array([own[places].mean() for *_, places in groups]) - means.mean(axis=0)
    found = apart / np.hypot(np.maximum(means.std(axis=0, ddof=1), least), form)
    furthest = float(np.abs(_by_others(means, least)).max())
    order = np.argsort(-np.abs(found))
    scored = zip(groups, found.tolist(), strict=True)
    told = [
        GroupResidual(sensor, axis, probe, places, score, furthest) for (sensor, axis, probe, places), score in scored
    ]
    return [told[at] for at in order.tolist()]


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
    """(b, g) of each replicate's means (b, g), in standard deviations (at least `least`) of the others'."""
    count = len(means)
    apart = (means - means.mean(axis=0)) * count / (count - 1)
    squares = ((means - means.mean(axis=0)) ** 2).sum(axis=0) - apart**2 * (count - 1) / count
    return np.asarray(apart / np.maximum(np.sqrt(np.maximum(squares, 0.0) / (count - 2)), least))

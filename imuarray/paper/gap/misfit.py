"""How far statistics are off, before and after, and how sure that is.

By its own scatter a model is judged as a simulator: how far the printed numbers leave the range of its replicates. A
cause is judged by one yardstick instead, for each statistic the wider of its two scatters: a model that foretells a
number more sharply than the base did isn't blamed for it. Misfit is the mean over Tables 6 to 11 and appendix A of
their mean z^2, no |z| counted beyond `candidate.CAP`, derived statistics left out; intervals come of resampling whole
channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.paper.gap.candidate import CAP
from imuarray.paper.gap.sensor import Floats
from imuarray.paper.replica.statistic import Statistic

FLOOR = 1.0
"""Mean z^2 of a model that is right."""
_DRAWS = 1000

Rows = Sequence[Statistic]


class Closed(NamedTuple):
    """Share of the misfit above `FLOOR` that is gone, and 95 % of it."""

    share: float | None
    low: float | None
    high: float | None

    @property
    def ci95(self) -> list[float] | None:
        """The interval, None without one."""
        return None if self.low is None or self.high is None else [self.low, self.high]


class Squares(NamedTuple):
    """Capped z^2 summed by channel and table (c, t), before, after, and how many they are."""

    before: Floats
    after: Floats
    numbers: Floats


def same_yardstick(before: Rows, after: Rows) -> tuple[Rows, Rows]:
    """Both with the wider of the two uncertainties."""
    wider = [max(a.uncertainty, b.uncertainty) for a, b in zip(before, after, strict=True)]
    return tuple(
        [replace(row, uncertainty=sd) for row, sd in zip(rows, wider, strict=True)] for rows in (before, after)
    )  # type: ignore[return-value]


def squares(before: Rows, after: Rows, *, own: bool = False) -> Squares:
    """Of the statistics that count, by one yardstick or each by its own scatter."""
    first, second = (before, after) if own else same_yardstick(before, after)
    used = [i for i, row in enumerate(before) if not row.derived]
    channels = {name: i for i, name in enumerate(dict.fromkeys(before[i].channel for i in used))}
    tables = {name: i for i, name in enumerate(dict.fromkeys(_source(before[i]) for i in used))}
    sums = np.zeros((3, len(channels), len(tables)))
    for i in used:
        at = channels[before[i].channel], tables[_source(before[i])]
        sums[(slice(None), *at)] += [min(abs(first[i].z), CAP) ** 2, min(abs(second[i].z), CAP) ** 2, 1.0]
    return Squares(*sums)


def _source(row: Statistic) -> str:
    return row.table if row.table.startswith("Table") else "Appendix A"


def misfit(total: Floats, count: Floats) -> float:
    """Mean over the tables of sums (t,) over counts (t,)."""
    return float(np.mean(total[count > 0] / count[count > 0]))


def closed(found: Squares, seed: int, base: float | None = None) -> Closed:
    """From before to after, as a share of the misfit before or of `base`; None where there is none to close."""

    def share(weights: Floats) -> float:
        count = weights @ found.numbers
        first, second = (max(misfit(weights @ part, count) - FLOOR, 0.0) for part in (found.before, found.after))
        whole = first if base is None else base - FLOOR
        return (first - second) / whole if whole > 0 else float("nan")

    channels = len(found.numbers)
    value = share(np.ones(channels))
    if not np.isfinite(value):
        return Closed(None, None, None)
    picks = np.random.Generator(np.random.Philox(seed)).multinomial(channels, [1 / channels] * channels, size=_DRAWS)
    drawn = np.array([share(weights.astype(float)) for weights in picks])
    low, high = np.nanquantile(drawn, [0.025, 0.975])
    return Closed(value, float(low), float(high))


def by_table(before: Rows, after: Rows) -> dict[str, dict[str, float | int]]:
    """Per table: how many statistics, how many of them independent, chi-square of these before and after with each
    model's own scatter, its excess over their number, capped misfit by one yardstick, and how many lie beyond three.
    """
    first, second = same_yardstick(before, after)
    return {name: _table(name, before, after, first, second) for name in dict.fromkeys(row.table for row in before)}


def _table(name: str, *sets: Rows) -> dict[str, float | int]:
    ours = [[row for row in rows if row.table == name] for rows in sets]
    free = [[row for row in rows if not row.derived] or rows for rows in ours]
    chi = [sum(row.z**2 for row in rows) for rows in free]
    off = [int(sum(abs(row.z) > 3 for row in rows)) for rows in ours]
    mean = [float(np.mean([min(abs(row.z), CAP) ** 2 for row in rows])) for rows in free]
    degrees = len(free[0])
    return {
        "statistics": len(ours[0]),
        "degrees": degrees,
        "chi_square_before": chi[0],
        "chi_square_after": chi[1],
        "excess_before": chi[0] - degrees,
        "excess_after": chi[1] - degrees,
        "misfit_before": mean[2],
        "misfit_after": mean[3],
        "beyond_3_before": off[0],
        "beyond_3_after": off[1],
    }


def keyed(rows: Rows) -> dict[tuple[str, str, str], Statistic]:
    """By table, channel and statistic."""
    return {(row.table, row.channel, row.statistic): row for row in rows}

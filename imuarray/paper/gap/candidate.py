"""What could explain a discrepancy, and how well: likelihood of the printed numbers with a price for each parameter.

BIC = -2 ln L + k ln n (Schwarz, Annals of Statistics 6, 1978); candidates of one discrepancy are as probable as
exp(-BIC / 2) if all were equally so before. A parameter whose population the data sheet prints is not free: the
likelihood is the mean over that population.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp, log

from scipy.optimize import minimize_scalar

from imuarray.paper.gap.acting import Effects, with_effects
from imuarray.paper.gap.expected import expected, minus_twice_log_likelihood
from imuarray.paper.gap.fast import expected_fast
from imuarray.paper.gap.sensor import Array
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.tables import design_of, row_of

Chosen = Callable[[Statistic], bool]
"""Whether a statistic belongs to the discrepancy."""

CAP = 10.0
"""What is ten deviations off is wrong: how much further says how finely it is printed, not how bad the model is."""


@dataclass(frozen=True)
class Candidate:
    """One explanation. `adds` are its effects by sensor, in the order in which they act; `free` how many parameters
    were fitted; `error` the standard errors of parameters by effect; `impossible` says why a chip can't be so.
    """

    names: tuple[str, ...]
    adds: Effects
    free: int
    minus2log: float
    leaves: str = ""
    error: Mapping[str, object] = field(default_factory=dict)
    impossible: str = ""

    @property
    def label(self) -> str:
        """Its effects, or that there is none."""
        return " + ".join(self.names) or "(nothing)"


@dataclass(frozen=True)
class Ranked:
    """A candidate with its BIC over `n` numbers, its probability among the others, and the mean capped z^2 of the
    discrepancy's statistics once it is in.
    """

    candidate: Candidate
    bic: float
    probability: float
    misfit: float


@dataclass(frozen=True)
class Discrepancy:
    """Something in the tables that the model doesn't have: `statistics` before and, the best candidate added, after."""

    name: str
    about: str
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    numbers: int
    before: tuple[Statistic, ...]
    after: tuple[Statistic, ...]
    ranked: tuple[Ranked, ...]
    held_out: tuple[Mapping[str, object], ...] = ()
    facts: Mapping[str, object] = field(default_factory=dict)

    @property
    def best(self) -> Candidate:
        """The most probable one that the chip allows."""
        return self.ranked[0].candidate

    def confusable_with(self, effect: str) -> tuple[str, ...]:
        """Effects of other candidates, within a factor of twenty of the best, that do without this one."""
        near = [one.candidate.names for one in self.ranked[1:] if one.bic - self.ranked[0].bic < 2 * log(20)]
        others = [name for names in near if effect not in names for name in names if name not in self.best.names]
        return tuple(dict.fromkeys(others))


def statistics(array: Array) -> tuple[Statistic, ...]:
    """All of them."""
    return (*expected(array), *expected_fast(array))


def capped(rows: Iterable[Statistic]) -> float:
    """Mean z^2, no |z| counted for more than `CAP`; about 1 where a model is right, 0 of no rows."""
    found = [min(abs(row.z), CAP) ** 2 for row in rows]
    return sum(found) / len(found) if found else 0.0


def scored(
    array: Array, names: Sequence[str], adds: Effects, free: int, chosen: Chosen, *, leaves: str = ""
) -> Candidate:
    """A candidate whose likelihood is that of the chosen statistics, each a normal number (or its logarithm is)."""
    rows = tuple(row for row in statistics(with_effects(array, adds)) if chosen(row))
    value = minus_twice_log_likelihood(rows)
    return Candidate(tuple(names), adds, free, value, leaves)


def scored_with_scatter(
    array: Array, names: Sequence[str], adds: Effects, free: int, chosen: Chosen, *, leaves: str = ""
) -> Candidate:
    """The same where nothing in the library makes the last bit of scatter: for each design and range one more deviation
    is estimated, with every candidate, and stands in what it leaves.
    """
    groups: dict[tuple[str, str], list[Statistic]] = defaultdict(list)
    for row in statistics(with_effects(array, adds)):
        if chosen(row):
            groups[design_of(row.channel), row_of(10, row.channel)["range"]].append(row)
    value, told = 0.0, []
    for (design, range_), rows in groups.items():
        more = extra_scatter(rows)
        value += _with_more(rows, more)
        told.append(f"{design} {range_} {more:.2g}")
    text = "; ".join(part for part in (leaves, f"scatter of {', '.join(told)} LSB") if part)
    return Candidate(tuple(names), adds, free + len(groups), value, text)


def extra_scatter(rows: Sequence[Statistic]) -> float:
    """The deviation, beside their own, that makes linear statistics most likely."""
    most = max(abs(row.simulated - row.published) for row in rows) * 3 + 1e-6
    found = minimize_scalar(lambda x: _with_more(rows, exp(x)), bounds=(log(most * 1e-5), log(most)), method="bounded")
    return exp(float(found.x))


def _with_more(rows: Sequence[Statistic], more: float) -> float:
    return sum(
        (row.simulated - row.published) ** 2 / (row.uncertainty**2 + more**2) + log(row.uncertainty**2 + more**2)
        for row in rows
    )


def ranked(array: Array, candidates: Sequence[Candidate], numbers: int, chosen: Chosen) -> tuple[Ranked, ...]:
    """The most probable first, those that no chip can be last and without probability."""
    bics = [one.minus2log + one.free * log(numbers) for one in candidates]
    least = min(bic for bic, one in zip(bics, candidates, strict=True) if not one.impossible)
    weights = [0.0 if one.impossible else exp(-(bic - least) / 2) for bic, one in zip(bics, candidates, strict=True)]
    found = [
        Ranked(
            one, bic, weight / sum(weights), capped(r for r in statistics(with_effects(array, one.adds)) if chosen(r))
        )
        for one, bic, weight in zip(candidates, bics, weights, strict=True)
    ]
    return tuple(sorted(found, key=lambda one: (bool(one.candidate.impossible), one.bic)))


def discrepancy(
    array: Array, name: str, about: str, candidates: Sequence[Candidate], numbers: int, chosen: Chosen
) -> Discrepancy:
    """What the candidates make of it; sensors and axes are those whose statistics were more than three deviations off
    or, if none was, all that the best candidate changes.
    """
    order = ranked(array, candidates, numbers, chosen)
    before = tuple(row for row in statistics(array) if chosen(row))
    after = tuple(row for row in statistics(with_effects(array, order[0].candidate.adds)) if chosen(row))
    sensors = tuple(order[0].candidate.adds)
    off = {row.channel.split()[1] for row in before if abs(row.z) > 3 and row.channel.split()[0] in sensors}
    axes = tuple(axis for axis in "xyz" if axis in off)
    return Discrepancy(name, about, sensors, () if len(axes) in (0, 3) else axes, numbers, before, after, order)


def with_checks(found: Discrepancy, held_out: Iterable[Mapping[str, object]], **facts: object) -> Discrepancy:
    """The same with held-out checks and further facts."""
    return replace(found, held_out=tuple(held_out), facts={**found.facts, **facts})


def with_errors(found: Discrepancy, **errors: object) -> Discrepancy:
    """The same with standard errors of the best candidate's parameters: a parameter's name to numbers like its own, or
    with `_share` after it to what share of the parameter they are.
    """
    top = replace(found.ranked[0], candidate=replace(found.best, error={**found.best.error, **errors}))
    return replace(found, ranked=(top, *found.ranked[1:]))


def told_from(rows: Iterable[Statistic], column: str, factor: float = 1.0) -> dict[str, float]:
    """Uncertainties of a column by channel, times a factor."""
    return {row.channel: row.uncertainty * factor for row in rows if row.statistic == column}

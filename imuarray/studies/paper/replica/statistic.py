"""A printed statistic with its simulated counterpart, summaries of many of them, and the text that is printed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import copysign, inf, log, sqrt
from typing import Any

from scipy.stats import chi2

_EXPECTED = (0.025, 0.975)

Place = tuple[str, str, str]
"""Table (or figure, or appendix), channel, statistic."""


@dataclass(frozen=True)
class Statistic:
    """One number of a table, a figure or the text.

    z is (simulated - published) / uncertainty; for standard deviations, whose `scale` is "log", it is ln(simulated /
    published) / uncertainty. `origin` says what the uncertainty is made of. `fitted`: the model was fitted to this very
    number (and the uncertainty is what is left then). `derived`: arithmetic on other printed statistics, counted but
    not part of the chi-square. `shared` of its variance is common to all statistics of the same `group`.
    """

    table: str
    channel: str
    statistic: str
    published: float
    simulated: float
    uncertainty: float
    origin: str
    scale: str = "linear"
    fitted: bool = False
    derived: bool = False
    group: str = ""
    shared: float = 0.0

    @property
    def z(self) -> float:
        """The number of uncertainties that the simulation is off."""
        if self.simulated == self.published:
            return 0.0
        if self.scale == "log":
            away = log(self.simulated / self.published) if self.simulated > 0 and self.published > 0 else -inf
        else:
            away = self.simulated - self.published
        return away / self.uncertainty if self.uncertainty else copysign(inf, away)


def combined(parts: Mapping[str, float]) -> tuple[float, str]:
    """Root sum of squares of the parts, and a text that names those that matter, the largest first."""
    total = sqrt(sum(part**2 for part in parts.values()))
    named = sorted(((abs(part), name) for name, part in parts.items() if part), reverse=True)
    return total, ", ".join(f"{name} {part:.2g}" for part, name in named if part > 0.1 * total)


def linear(at: Place, published: float, simulated: float, parts: Mapping[str, float]) -> Statistic:
    """A statistic compared as it is; `at` is (table, channel, statistic), `parts` of its uncertainty by cause."""
    return Statistic(*at, published, simulated, *combined(parts))


def logarithmic(at: Place, published: float, simulated: float, parts: Mapping[str, float]) -> Statistic:
    """A standard deviation, compared by its logarithm; parts are relative."""
    return Statistic(*at, published, simulated, *combined(parts), scale="log")


@dataclass(frozen=True)
class Summary:
    """The number of statistics `within` 1, 2 and 3 uncertainties, of how many (`count`); `chi_square` of the
    `independent` ones per degree, and the interval `expected` (95 %) for it.

    Statistics with a common cause are fewer than they seem: with the correlations r that the causes give, the mean of n
    squares of unit normals has variance 2 sum(r_ij^2) / n^2, as chi-square over n^2 / sum(r_ij^2) degrees has; these
    are `degrees`.
    """

    count: int
    within: tuple[int, int, int]
    independent: int
    chi_square: float
    degrees: float
    expected: tuple[float, float]


def summary(statistics: Iterable[Statistic]) -> Summary:
    """The summary of some statistics; at least one must not be derived."""
    rows = list(statistics)
    sizes = [abs(row.z) for row in rows]
    free = [row for row in rows if not row.derived]
    degrees = effective_degrees(free)
    low, high = (float(chi2.ppf(share, degrees)) / degrees for share in _EXPECTED)
    within = (sum(size <= 1 for size in sizes), sum(size <= 2 for size in sizes), sum(size <= 3 for size in sizes))
    chi_square = sum(row.z**2 for row in free) / len(free)
    return Summary(len(rows), within, len(free), chi_square, degrees, (low, high))


def effective_degrees(rows: Sequence[Statistic]) -> float:
    """n^2 / sum(r_ij^2), r_ij^2 = the product of two statistics' shares in their group's cause, 1 for i = j."""
    shares: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        if row.group:
            shares[row.group].append(row.shared)
    pairs = sum(sum(group) ** 2 - sum(share**2 for share in group) for group in shares.values())
    return len(rows) ** 2 / (len(rows) + pairs)


@dataclass(frozen=True)
class Replica:
    """A whole replica: the seed and every statistic, in the order of the tables."""

    seed: int
    statistics: tuple[Statistic, ...]

    @property
    def summary(self) -> Summary:
        """Return the summary of all statistics."""
        return summary(self.statistics)

    @property
    def kinds(self) -> dict[str, Summary]:
        """The summaries of what the model was "fitted to" and what it "foretold", and of "axes" and "thermometers"."""
        kinds: dict[str, list[Statistic]] = {"fitted to": [], "foretold": [], "axes": [], "thermometers": []}
        for row in self.statistics:
            kinds["fitted to" if row.fitted else "foretold"].append(row)
            kinds["thermometers" if " t" in row.channel else "axes"].append(row)
        return {name: summary(rows) for name, rows in kinds.items()}

    def of(self, table: str) -> tuple[Statistic, ...]:
        """The statistics of "Table 8", "Figure 13", ..."""
        return tuple(row for row in self.statistics if row.table == table)

    @property
    def tables(self) -> tuple[str, ...]:
        """Return the names of the tables that were compared, in order."""
        return tuple(dict.fromkeys(row.table for row in self.statistics))

    def beyond(self, limit: float = 3.0) -> tuple[Statistic, ...]:
        """The statistics that are more than `limit` uncertainties off."""
        return tuple(row for row in self.statistics if abs(row.z) > limit)

    def as_json(self) -> dict[str, Any]:
        """Summary, summaries per table and all statistics, ready for JSON (an infinite z is null)."""
        return {
            "seed": self.seed,
            "summary": asdict(self.summary),
            "tables": {name: _brief(self.of(name)) for name in self.tables},
            "statistics": [asdict(row) | {"z": row.z if abs(row.z) < inf else None} for row in self.statistics],
        }


def _brief(rows: Sequence[Statistic]) -> dict[str, Any]:
    result = [abs(row.z) for row in rows]
    return {"count": len(rows), "within": [sum(size <= limit for size in result) for limit in (1, 2, 3)]}


_LISTED = 3.0
_WIDTH = 100


def render_text(replica: Replica) -> str:
    """Render the comparison as text: table by table, all together, and every statistic more than three uncertainties
    off.
    """
    return "\n".join((*_tables(replica), "", *_together(replica), "", *_beyond(replica))) + "\n"


def _tables(replica: Replica) -> Iterator[str]:
    yield f"The paper's experiments on the simulated array, seed {replica.seed}"
    yield f"  {'':<14}{'statistics':>10}{'within 1':>10}{'2':>7}{'3':>7}   uncertainties"
    for name in replica.tables:
        rows = replica.of(name)
        result = [sum(abs(row.z) <= limit for row in rows) for limit in (1, 2, 3)]
        yield f"  {name:<14}{len(rows):>10}{result[0]:>10}{result[1]:>7}{result[2]:>7}"


def _together(replica: Replica) -> Iterator[str]:
    whole = replica.summary
    item, two, three = (f"{count} ({100 * count / whole.count:.1f} %)" for count in whole.within)
    yield f"Together: {whole.count} statistics, within 1: {item}, within 2: {two}, within 3: {three}"
    yield "Chi-square per degree (statistics that don't follow from others; 95 % of true models)"
    yield _chi_square("all", whole)
    for name, result in replica.kinds.items():
        yield _chi_square(name, result)


def _chi_square(name: str, summary: Summary) -> str:
    low, high = summary.expected
    return (
        f"  {name:<13}{summary.chi_square:>7.2f} over {summary.independent:>4} of them;"
        f" expected {low:.2f} to {high:.2f}"
        f" ({summary.degrees:.0f} degrees)"
    )


def _beyond(replica: Replica) -> Iterator[str]:
    rows = replica.beyond(_LISTED)
    yield f"More than {_LISTED:g} uncertainties off: {len(rows)} (published -> simulated; most of the uncertainty)"
    yield from map(_line, rows)


def _line(row: Statistic) -> str:
    values = f"{row.published:>9.4g} -> {row.simulated:<9.4g}"
    cause = row.origin.partition(",")[0]
    return f"  {row.table:<9}{row.channel:<15}{row.statistic:<20}{values} z {row.z:+.1f}; {cause}"[:_WIDTH]

"""A printed statistic with its simulated counterpart, summaries of many of them, and the text that is printed.

The uncertainty of a comparison is the disagreement between the paper's own tables where they state the same quantity
twice, in counts, or for standard deviations in natural logarithms. Channels that should be alike are pooled in groups:
one design at one range, x and y together and z separately; the thermometers of a design together.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from math import copysign, inf, log, sqrt
from typing import Any

import numpy as np
from scipy.stats import chi2

from imuarray.arrays import Floats
from imuarray.studies.paper.array_model import (
    PARTS,
    REFERENCE_DEGC,
    STDS,
    WINDOW_S,
    SensorUnit,
    covariance_of_means,
    gyro3_other_state_lsb,
    runs_of,
    unit_of,
    variance_of_mean,
)
from imuarray.studies.paper.systematic import READINGS
from imuarray.studies.paper.tables import DEGC, FACES_DEGC, design_of, number_in, row_of, table
from imuarray.studies.paper.variation import bias_states, boot_faults

RANGE_OVER_DEVIATION = 0.102
"""Standard deviation of ln(range / standard deviation) of 15 normal numbers."""
_CODES_PER_DEGC = {"BMA": 2.0, "Gyro": -1.0}


def printed(number: int, channel: str, column: str) -> float:
    """Return a printed number of Table 3, 4, 8, 10 or 11."""
    return float(number_in(row_of(number, channel), column))


def axis_of(channel: str) -> int:
    """Return 0, 1, 2 for x, y, z, 3 for the thermometer."""
    return "xyzt".index(channel.split()[1])


def own(channel: str, value: Callable[[SensorUnit], Floats]) -> float:
    """Return a figure of the model for this axis, in counts; 0 for a thermometer."""
    unit, axis = unit_of(channel.split()[0]), axis_of(channel)
    return 0.0 if axis == 3 else float(value(unit)[axis]) / unit.lsb


def slope(channel: str) -> float:
    """Return the counts per degC: Table 8, or the thermometer's own."""
    return _CODES_PER_DEGC[design_of(channel)] if channel.endswith("t") else printed(8, channel, "slope_lsb_per_degc")


@cache
def group_of(channel: str) -> tuple[str, ...]:
    """Return the channels of Table 10 that should be like this one."""
    return tuple(row["channel"] for row in table(10) if _kind(row["channel"]) == _kind(channel))


def _kind(channel: str) -> tuple[str, str, str]:
    axis = channel.split()[1]
    return design_of(channel), row_of(10, channel)["range"], "xy" if axis in "xy" else axis


def levels(channel: str) -> Floats:
    """Return the levels that a channel read with +Z up, at 25 degC, usual range and first state, on the days of Tables
    10, 11 (runs), 11 (continuous) and, except for thermometers, 8.
    """
    k = slope(channel)
    name, axis = channel.split()[0], axis_of(channel)
    other_state = float(gyro3_other_state_lsb()[axis]) if name == "Gyro3" and axis < 3 else 0.0
    runs = printed(11, channel, "runs_mean") - other_state * len(bias_states()[1].runs) / PARTS
    if name == "BMA1" and axis < 3:
        runs = float(np.delete(runs_of(name)[:, axis], [fault.run - 1 for fault in boot_faults()]).mean())
    result = [
        printed(10, channel, "z_up") - other_state - k * (FACES_DEGC[0] - REFERENCE_DEGC),
        runs - k * (DEGC[11, "runs_mean"] - REFERENCE_DEGC),
        printed(11, channel, "cont_mean") - k * (DEGC[11, "cont_mean"] - REFERENCE_DEGC),
    ]
    return np.array(result if axis == 3 else [*result, printed(8, channel, "intercept_lsb") + k * REFERENCE_DEGC])


@cache
def day_to_day(channel: str) -> float:
    """Return the standard deviation of a level from one experiment to another."""
    return sqrt(np.mean([levels(member).var(ddof=1) for member in group_of(channel)]))


@cache
def face_residual(channel: str) -> float:
    """Return the root mean square deviation of a pair of opposite faces from the mean of the three pairs.

    The model has four parameters for six faces, so the residual of each face has a third of its variance.
    """
    squares = []
    for member in group_of(channel):
        faces = [printed(10, member, face) for face in READINGS[:6]]
        at_25 = np.array(faces) - slope(member) * (np.array(FACES_DEGC[:6]) - REFERENCE_DEGC)
        if member.endswith("t"):
            at_25 = np.repeat(at_25[[0, 2, 4]], 2)[[0, 2, 4, 1, 3, 5]]
        z_up, x_up, y_up, x_down, y_down, z_down = at_25
        pairs = np.array([x_up + x_down, y_up + y_down, z_up + z_down]) / 2
        squares.append(pairs.var())
    return sqrt(np.mean(squares))


@cache
def noise_residual(channel: str) -> float:
    """Return the root mean square of ln(standard deviation / its quadratic mean) in Tables 10 and 11 (three
    experiments).
    """
    squares = []
    for member in group_of(channel):
        variances = np.array([printed(number, member, column) ** 2 for number, column in STDS])
        squares.extend((np.log(variances / variances.mean()) / 2) ** 2)
    return sqrt(np.mean(squares))


@cache
def thermometer_residual(channel: str) -> float:
    """Return the rms deviation, in codes, of a thermometer's means in three experiments from a constant offset."""
    return sqrt(np.mean([levels(member).var() for member in group_of(channel)]))


def log_deviation(windows: Floats, extra: float) -> float:
    """Return the standard deviation of ln s. s is the sample standard deviation of numbers with covariance `windows`
    (n, n) plus fixed differences of variance `extra`; the result is half the relative spread of a quadratic form in
    normal numbers.
    """
    count = len(windows)
    middle = windows - windows.mean(axis=0)
    mean = np.trace(middle) / (count - 1)
    spread = 2 * np.trace(middle @ middle) + 4 * extra * (count - 1) * mean
    return float(np.sqrt(spread) / (count - 1) / (2 * (mean + extra)))


@cache
def run_windows(channel: str) -> Floats:
    """Return (15, 15) the covariance of the means of separate runs according to the model."""
    turn_on, in_run = own(channel, lambda unit: unit.turn_on), own(channel, lambda unit: unit.in_run)
    sem = printed(11, channel, "runs_sem")
    return np.asarray(np.eye(PARTS) * (turn_on**2 + in_run**2 * variance_of_mean(WINDOW_S) + sem**2))


@cache
def part_windows(channel: str) -> Floats:
    """Return (15, 15) the covariance of the means of consecutive windows according to the model."""
    distance = np.abs(np.subtract.outer(np.arange(PARTS), np.arange(PARTS)))
    of_wander = np.array([variance_of_mean(WINDOW_S), *(covariance_of_means(k, WINDOW_S) for k in range(1, PARTS))])
    sem = printed(11, channel, "cont_sem")
    return np.asarray(own(channel, lambda unit: unit.in_run) ** 2 * of_wander[distance] + np.eye(PARTS) * sem**2)


def run_steps(channel: str) -> float:
    """Return the part of the variance of the runs' means that every series has: states, the faulty run, temperature."""
    name, axis = channel.split()[0], axis_of(channel)
    steady = (slope(channel) * DEGC[11, "runs_std_of_means"]) ** 2
    if axis == 3:
        return steady
    if name == "BMA1":
        runs = runs_of(name)[:, axis]
        (fault,) = boot_faults()
        return steady + float((runs[fault.run - 1] - np.delete(runs, fault.run - 1).mean()) ** 2) / PARTS
    if name == "Gyro3":
        second = len(bias_states()[1].runs)
        share = second * (PARTS - second) / (PARTS * (PARTS - 1))
        return steady + float(gyro3_other_state_lsb()[axis] ** 2) * share
    return steady


def part_steps(channel: str) -> float:
    """Return the same for consecutive windows: temperature."""
    return (slope(channel) * DEGC[11, "cont_std_of_means"]) ** 2


@cache
def between_units(channel: str, column: str) -> float:
    """Return the standard deviation, over the units of a group, of the logarithms of a column of Table 11."""
    return float(np.std([log(printed(11, member, column)) for member in group_of(channel)], ddof=1))


def level_parts(channel: str) -> tuple[dict[str, float], float]:
    """Return the error of a level with +Z up on a day other than that of Table 10: its parts, and the share of their
    variance that all of these levels of the channel have in common (that of the day of Table 10, and that of the face
    relative to the fit).
    """
    days, face = day_to_day(channel), face_residual(channel)
    parts = {"day-to-day": sqrt(2) * days, "face repeatability": face}
    return parts, (days**2 + face**2) / (2 * days**2 + face**2)


_EXPECTED = (0.025, 0.975)

Place = tuple[str, str, str]
"""Table (or figure, or appendix), channel, statistic."""


@dataclass(frozen=True)
class Statistic:
    """One number of a table, a figure or the text.

    z is (simulated - published) / uncertainty; for standard deviations, whose `scale` is "log", it is ln(simulated /
    published) / uncertainty. `origin` names the parts of the uncertainty. `fitted`: the model was fitted to this number
    (the uncertainty is then that of the residual). `derived`: arithmetic on other printed statistics, counted but not
    part of the chi-square. `shared` of its variance is common to all statistics of the same `group`.
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
        """The difference of the simulation, in uncertainties."""
        if self.simulated == self.published:
            return 0.0
        if self.scale == "log":
            log_ratio = log(self.simulated / self.published) if self.simulated > 0 and self.published > 0 else -inf
        else:
            log_ratio = self.simulated - self.published
        return log_ratio / self.uncertainty if self.uncertainty else copysign(inf, log_ratio)


def combine(parts: Mapping[str, float]) -> tuple[float, str]:
    """Return the root sum of squares of the parts, and a text that names the relevant ones, largest first."""
    total = sqrt(sum(part**2 for part in parts.values()))
    named = sorted(((abs(part), name) for name, part in parts.items() if part), reverse=True)
    return total, ", ".join(f"{name} {part:.2g}" for part, name in named if part > 0.1 * total)


def linear(
    at: Place,
    published: float,
    simulated: float,
    parts: Mapping[str, float],
    *,
    fitted: bool = False,
    derived: bool = False,
) -> Statistic:
    """Return a statistic that is compared without a logarithm. `at` is (table, channel, statistic); `parts` are those
    of its uncertainty, by cause.
    """
    return Statistic(*at, published, simulated, *combine(parts), fitted=fitted, derived=derived)


def logarithmic(at: Place, published: float, simulated: float, parts: Mapping[str, float], **marks: bool) -> Statistic:
    """Return a standard deviation, compared by its logarithm; parts are relative, `marks` those of `linear`."""
    return replace(linear(at, published, simulated, parts, **marks), scale="log")


def with_cause(statistic: Statistic, group: str, cause: float) -> Statistic:
    """Return the statistic as one of a `group` that has a part of the uncertainty, `cause`, in common."""
    return replace(statistic, group=group, shared=(cause / statistic.uncertainty) ** 2)


@dataclass(frozen=True)
class AgreementSummary:
    """The numbers of statistics `within` 1, 2 and 3 uncertainties, and of all (`count`); `chi_square` of the
    `independent` ones per degree, and the interval `expected` (95 %) for it.

    Statistics with a common cause are correlated. With correlations r, the mean of n squares of unit normals has the
    variance 2 sum(r_ij^2) / n^2, which is that of chi-square divided by its n^2 / sum(r_ij^2) degrees of freedom; this
    number is `degrees`.
    """

    count: int
    within: tuple[int, int, int]
    independent: int
    chi_square: float
    degrees: float
    expected: tuple[float, float]


def summary(statistics: Iterable[Statistic]) -> AgreementSummary:
    """Return the summary of some statistics; at least one must not be derived."""
    rows = list(statistics)
    free = [row for row in rows if not row.derived]
    degrees = effective_degrees(free)
    low, high = (float(chi2.ppf(share, degrees)) / degrees for share in _EXPECTED)
    chi_square = sum(row.z**2 for row in free) / len(free)
    return AgreementSummary(len(rows), within(rows), len(free), chi_square, degrees, (low, high))


def within(rows: Sequence[Statistic]) -> tuple[int, int, int]:
    """Return how many statistics lie within 1, 2 and 3 uncertainties."""
    first, second, third = (sum(abs(row.z) <= limit for row in rows) for limit in (1, 2, 3))
    return first, second, third


def effective_degrees(rows: Sequence[Statistic]) -> float:
    """Return n^2 / sum(r_ij^2), r_ij^2 = the product of two statistics' shares in their group's cause, 1 for i = j."""
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
    def summary(self) -> AgreementSummary:
        """Return the summary of all statistics."""
        return summary(self.statistics)

    @property
    def kinds(self) -> dict[str, AgreementSummary]:
        """Return the summaries of the statistics that the model was "fitted to" and that it "foretold", and of "axes"
        and "thermometers".
        """
        kinds: dict[str, list[Statistic]] = {"fitted to": [], "foretold": [], "axes": [], "thermometers": []}
        for row in self.statistics:
            kinds["fitted to" if row.fitted else "foretold"].append(row)
            kinds["thermometers" if " t" in row.channel else "axes"].append(row)
        return {name: summary(rows) for name, rows in kinds.items()}

    def of(self, table: str) -> tuple[Statistic, ...]:
        """Return the statistics of "Table 8", "Figure 13", ..."""
        return tuple(row for row in self.statistics if row.table == table)

    @property
    def tables(self) -> tuple[str, ...]:
        """Return the names of the tables that were compared, in order."""
        return tuple(dict.fromkeys(row.table for row in self.statistics))

    def beyond(self, limit: float = 3.0) -> tuple[Statistic, ...]:
        """Return the statistics that differ by more than `limit` uncertainties."""
        return tuple(row for row in self.statistics if abs(row.z) > limit)

    def as_json(self) -> dict[str, Any]:
        """Return the summary, summaries per table and all statistics, ready for JSON (an infinite z is null)."""
        return {
            "seed": self.seed,
            "summary": asdict(self.summary),
            "tables": {
                name: {"count": len(self.of(name)), "within": list(within(self.of(name)))} for name in self.tables
            },
            "statistics": [asdict(row) | {"z": row.z if abs(row.z) < inf else None} for row in self.statistics],
        }


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
        first, second, third = within(rows)
        yield f"  {name:<14}{len(rows):>10}{first:>10}{second:>7}{third:>7}"


def _together(replica: Replica) -> Iterator[str]:
    whole = replica.summary
    item, two, three = (f"{count} ({100 * count / whole.count:.1f} %)" for count in whole.within)
    yield f"Together: {whole.count} statistics, within 1: {item}, within 2: {two}, within 3: {three}"
    yield "Chi-square per degree (statistics that don't follow from others; 95 % of true models)"
    yield _chi_square("all", whole)
    for name, result in replica.kinds.items():
        yield _chi_square(name, result)


def _chi_square(name: str, summary: AgreementSummary) -> str:
    low, high = summary.expected
    return (
        f"  {name:<13}{summary.chi_square:>7.2f} over {summary.independent:>4} of them;"
        f" expected {low:.2f} to {high:.2f} ({summary.degrees:.0f} degrees)"
    )


def _beyond(replica: Replica) -> Iterator[str]:
    rows = replica.beyond(_LISTED)
    yield f"More than {_LISTED:g} uncertainties off: {len(rows)} (published -> simulated; most of the uncertainty)"
    yield from map(_line, rows)


def _line(row: Statistic) -> str:
    values = f"{row.published:>9.4g} -> {row.simulated:<9.4g}"
    cause = row.origin.partition(",")[0]
    return f"  {row.table:<9}{row.channel:<15}{row.statistic:<20}{values} z {row.z:+.1f}; {cause}"[:_WIDTH]

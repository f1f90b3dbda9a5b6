"""The diagnosis as an object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import e, log
from typing import Any

from scipy.stats import norm

from imuarray import __version__
from imuarray.paper.gap.advice import next_experiment
from imuarray.paper.gap.candidate import Discrepancy
from imuarray.paper.gap.misfit import FLOOR, Closed, Squares, by_table, closed, keyed, misfit, same_yardstick, squares
from imuarray.paper.gap.places import place
from imuarray.paper.replica.statistic import Statistic
from imuarray.simulate.parameters import to_table

LIMIT = 3.0
"""Deviations from which on a statistic is listed."""
_IN_BASE = frozenset({"bias", "white_noise", "thermal_bias", "thermal_scale", "scale", "misalignment", "nonlinearity"})
_SHARPER = "foretold more sharply than before"

Rows = tuple[Statistic, ...]


@dataclass(frozen=True)
class Cause:
    """A discrepancy with its explanation, and the statistics of the array that has all effects but these."""

    found: Discrepancy
    without: Rows

    def as_json(self, gap: PaperGap) -> list[dict[str, Any]]:
        """One entry for each effect."""
        share = gap.closed_by(self)
        own = closed(squares(self.found.before, self.found.after), gap.seed)
        return [
            {
                "effect": name,
                "action": "replace" if name in _IN_BASE else "add",
                "sensors": [sensor for sensor, some in self.found.best.adds.items() if name in _names(some)],
                "axes": list(self.found.axes),
                "probability": sum(one.probability for one in self.found.ranked if name in one.candidate.names),
                "parameters": self._parameters(name),
                "closed": share.share,
                "closed_ci95": share.ci95,
                "confusable_with": list(self.found.confusable_with(name)),
                "discrepancy": self.found.name,
                "errors": self.found.best.error,
                "closed_of_discrepancy": own.share,
                "closed_of_discrepancy_ci95": own.ci95,
            }
            for name in self.found.best.names
            if any(name in _names(some) for some in self.found.best.adds.values())
        ]

    def _parameters(self, name: str) -> dict[str, Any]:
        """Of the effect; by sensor, if there are several."""
        tables = {
            sensor: to_table(effect, "dps" if sensor.startswith("Gyro") else "g")
            for sensor, effects in self.found.best.adds.items()
            for effect in effects
            if effect.name == name
        }
        return dict(next(iter(tables.values()))) if len(tables) == 1 else tables


def _names(effects: Any) -> set[str]:
    return {effect.name for effect in effects}


@dataclass(frozen=True)
class PaperGap:
    """All statistics as the data sheets' array has them (`before`), with noise and slopes fitted too (`fitted`), and
    with every cause (`after`), in one order.
    """

    seed: int
    before: Rows
    fitted: Rows
    after: Rows
    causes: tuple[Cause, ...]

    @cached_property
    def squares(self) -> Squares:
        """Of all statistics, each by its own scatter."""
        return squares(self.before, self.after, own=True)

    @property
    def misfits(self) -> tuple[float, float]:
        """Before and after."""
        count = self.squares.numbers.sum(axis=0)
        return misfit(self.squares.before.sum(axis=0), count), misfit(self.squares.after.sum(axis=0), count)

    @cached_property
    def misfit_fitted(self) -> float:
        """With noise, bias and slopes fitted: the base of `imuarray.gap`."""
        found = squares(self.fitted, self.fitted, own=True)
        return misfit(found.before.sum(axis=0), found.numbers.sum(axis=0))

    @cached_property
    def closed(self) -> Closed:
        """By all causes together, each model by its own scatter."""
        return closed(self.squares, self.seed)

    @cached_property
    def closed_one_yardstick(self) -> Closed:
        """By all causes together, by the wider of the two scatters."""
        return closed(squares(self.before, self.after), self.seed)

    def closed_by(self, cause: Cause) -> Closed:
        """Share of the misfit before that opens again without this cause, by one yardstick."""
        return closed(squares(cause.without, self.after), self.seed, self._base)

    @cached_property
    def _base(self) -> float:
        found = squares(self.before, self.after)
        return misfit(found.before.sum(axis=0), found.numbers.sum(axis=0))

    @property
    def unknown(self) -> float:
        """Upper bound of the probability that something else is there, even odds before: 1 / (1 + B), B = -e p ln p
        (Sellke, Bayarri and Berger, American Statistician 55, 2001), p that of the largest |z| left among so many.
        """
        rows = [row for row in self.after if not row.derived]
        p = min(1.0, len(rows) * 2 * float(norm.sf(max(abs(row.z) for row in rows))))
        bound = -e * p * log(p) if 0 < p < 1 / e else float(p > 0)
        return 1 / (1 + bound)

    @property
    def unexplained(self) -> Rows:
        """Statistics that are more than `LIMIT` off with every cause, worst first."""
        return tuple(sorted((row for row in self.after if abs(row.z) > LIMIT), key=lambda row: -abs(row.z)))

    @property
    def verdict(self) -> str:
        """As `gap diagnose` words it."""
        if self.misfits[0] <= FLOOR and not any(abs(row.z) > LIMIT for row in self.before):
            return "no gap"
        if not self.unexplained:
            return "explained"
        return "partly explained" if (self.closed.share or 0) > 0.05 else "unexplained"

    def sweep(self) -> list[dict[str, Any]]:
        """Every statistic that was or is more than `LIMIT` off, worst first, with the discrepancies whose causes close
        it: those without which it is more than `LIMIT` off again, by the wider of the two scatters.
        """
        without = {cause.found.name: keyed(cause.without) for cause in self.causes}
        pairs = [
            (old, new) for old, new in zip(self.before, self.after, strict=True) if max(abs(old.z), abs(new.z)) > LIMIT
        ]
        found = [self._swept(old, new, without) for old, new in pairs]
        return sorted(found, key=lambda row: -max(abs(row["z_before"]), abs(row["z_after"])))

    def _swept(self, old: Statistic, new: Statistic, without: Mapping[str, Any]) -> dict[str, Any]:
        at = (old.table, old.channel, old.statistic)
        is_left = abs(new.z) > LIMIT
        by = [name for name, rows in without.items() if _opens(rows[at], new)]
        verdict = "not explained" if is_left else "closed by " + (", ".join(by) if by else "several together")
        if is_left and abs(old.z) <= LIMIT:
            verdict += f" ({_SHARPER})"
        elif is_left and by:
            verdict += f" (in part {', '.join(by)})"
        return {
            "table": at[0],
            "channel": at[1],
            "statistic": at[2],
            "printed": old.published,
            "before": old.simulated,
            "sd_before": old.uncertainty,
            "z_before": old.z,
            "after": new.simulated,
            "sd_after": new.uncertainty,
            "z_after": new.z,
            "derived": old.derived,
            "effects": sorted(self._effects(by)),
            "verdict": verdict,
        }

    def _effects(self, by: Sequence[str]) -> set[str]:
        return {name for cause in self.causes if cause.found.name in by for name in cause.found.best.names}

    def as_json(self) -> dict[str, Any]:
        """Ready for JSON: the keys of `gap diagnose`, `tables`, `discrepancies` and the `sweep`."""
        before, after = self.misfits
        entries = [entry for cause in self.causes for entry in cause.as_json(self)]
        off = sorted((row for row in self.before if abs(row.z) > LIMIT), key=lambda row: -abs(row.z))
        return {
            "verdict": self.verdict,
            "gap": {
                "before": before,
                "fitted": self.misfit_fitted,
                "after": after,
                "floor": FLOOR,
                "closed": self.closed.share,
                "closed_ci95": self.closed.ci95,
                "closed_one_yardstick": self.closed_one_yardstick.share,
                "closed_one_yardstick_ci95": self.closed_one_yardstick.ci95,
            },
            "where": [place(row) for row in off if not row.derived],
            "causes": sorted(entries, key=lambda entry: -(entry["closed"] or 0.0)),
            "unknown": self.unknown,
            "unexplained": [place(row) for row in self.unexplained if not row.derived],
            "next_experiment": next_experiment([cause.found for cause in self.causes], self.unexplained),
            "seed": self.seed,
            "model": {
                "name": "datasheet",
                "fitted": ["bias"],
                "data_sheet": sorted(_IN_BASE - {"bias"}),
                "not_compared": ["thermometers"],
            },
            "software": f"imuarray {__version__}",
            "tables": by_table(self.before, self.after),
            "discrepancies": [discrepancy_json(cause.found) for cause in self.causes],
            "sweep": self.sweep(),
        }


def discrepancy_json(found: Discrepancy) -> dict[str, Any]:
    """What was seen, every candidate with its rank, checks and facts."""
    worst = max(found.before, key=lambda row: abs(row.z))
    return {
        "name": found.name,
        "about": found.about,
        "numbers": found.numbers,
        "worst": place(worst),
        "misfit_before": sum(row.z**2 for row in found.before) / len(found.before),
        "misfit_after": sum(row.z**2 for row in found.after) / len(found.after),
        "candidates": [
            {
                "effects": list(one.candidate.names),
                "free_parameters": one.candidate.free,
                "minus_twice_log_likelihood": one.candidate.minus2log,
                "bic": one.bic,
                "probability": one.probability,
                "capped_misfit": one.misfit,
                "leaves": one.candidate.leaves,
                "impossible": one.candidate.impossible,
            }
            for one in found.ranked
        ],
        "held_out": [dict(check) for check in found.held_out],
        **found.facts,
    }


def _opens(without: Statistic, new: Statistic) -> bool:
    (first,), (second,) = same_yardstick([without], [new])
    return abs(first.z) > LIMIT and abs(first.z) > 2 * abs(second.z)

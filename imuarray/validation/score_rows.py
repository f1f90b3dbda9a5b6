"""The figures of a validation run, each with its interval, its bar, and its cells: false alarms and detection by
severity, causes against the sealed truth, closed shares against an oracle that knows the effects, probabilities, and
time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from math import inf, isclose, isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from imuarray.validation.rates import (
    Bin,
    RateEstimate,
    auroc,
    bootstrap,
    bootstrap_groups,
    brier,
    calibration_error,
    calibration_error_by_chance,
    limit_of,
    permute_labels,
    rate,
    reliability,
)
from imuarray.validation.score_answers import NO_GAP, NOTHING_NAMED, Answer, meets, number, probability

Bar = tuple[float | None, float | None]
"""Least and greatest value allowed; None: no bound."""

NO_BAR: Bar = (None, None)
FULL = "full"
"""The plan on which bars are judged by default."""
EVERY = ""
"""Stands for all plans; the bars of random worlds are judged on all of them."""

_ROUNDING = 1e-9


@dataclass(frozen=True)
class ScoreRow:
    """A figure: `value` with its 95 % interval over `cases`; `about` describes what is counted. `cells` are the same
    figure for parts of the cases; `group` names the property by which they are divided ("plan", "severity",
    "mechanism", ...).
    """

    name: str
    value: float
    low: float
    high: float
    cases: int
    bar: Bar = NO_BAR
    about: str = ""
    cells: tuple[ScoreRow, ...] = ()
    group: str = ""

    @property
    def passes(self) -> bool | None:
        """True if the value is within the bar; None without cases or without a bar."""
        if self.bar == NO_BAR or not isfinite(self.value):
            return None
        return _within(self.value, self.value, self.bar)

    @property
    def is_refuted(self) -> bool:
        """True if the whole interval is outside the bar, so that the miss is more than chance."""
        return self.passes is False and isfinite(self.low) and not _within(self.high, self.low, self.bar)

    @property
    def mark(self) -> str:
        """ "ok", "FAIL", "n.a." without cases, "" without a bar."""
        if self.bar == NO_BAR:
            return ""
        return {True: "ok", False: "FAIL", None: "n.a."}[self.passes]

    def failing(self) -> tuple[ScoreRow, ...]:
        """Return the cells that miss their bar; those that miss it most significantly are first."""
        failed = [cell for cell in self.cells if cell.passes is False]
        return tuple(sorted(failed, key=lambda cell: (not cell.is_refuted, -cell.cases)))

    def as_json(self) -> dict[str, Any]:
        """Return the row as a table."""
        return {
            "name": self.name,
            **({"group": self.group} if self.group else {"about": self.about}),
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "cases": self.cases,
            "bar": list(self.bar),
            "passes": self.passes,
            "refuted": self.is_refuted,
            **({} if self.group else {"cells": [cell.as_json() for cell in self.cells]}),
        }


def rate_of(answers: Sequence[Answer], is_hit: Callable[[Answer], bool]) -> RateEstimate:
    """Return the share of the answers that are hits."""
    return rate(sum(map(is_hit, answers)), len(answers))


def make_row(
    name: str, estimate: RateEstimate, bar: Bar, about: str, cells: Iterable[ScoreRow] = (), group: str = ""
) -> ScoreRow:
    """Return the row of an estimate."""
    return ScoreRow(name, *estimate, bar, about, tuple(cells), group)


@dataclass(frozen=True)
class Breakdown:
    """The plan on which bars are judged ("": every plan), and the groups of the cells that have the row's bar."""

    full: str = FULL
    groups: Sequence[str] = ("severity", "mechanism")


def rate_row(
    name: str,
    answers: Sequence[Answer],
    is_hit: Callable[[Answer], bool],
    bar: Bar,
    about: str,
    breakdown: Breakdown,
) -> ScoreRow:
    """Return the share of hits on the full plan with cells by plan; if bars are judged on every plan, with cells by
    experiment and by chip. The cells by the breakdown's groups cover the counted cases and have the same bar.
    """
    full = breakdown.full
    counted = on_plan(answers, full)
    parts = ("plan",) if full else ("experiment", "chip")
    cells = [cell for group in parts for cell in cells_of(group, answers, is_hit, NO_BAR)]
    for group in breakdown.groups:
        cells += cells_of(group, counted, is_hit, bar)
    return make_row(name, rate_of(counted, is_hit), bar, about, cells)


def on_plan(answers: Iterable[Answer], full: str) -> list[Answer]:
    """Return the answers of the plan on which bars are judged."""
    return [answer for answer in answers if full in (EVERY, answer.case.plan)]


def group_answers(group: str, answers: Iterable[Answer]) -> Mapping[str, Sequence[Answer]]:
    """Group answers by plan, severity, mechanism or kind, or by experiment, chip or stratum, of which a case may have
    several. Severities are in ascending order, the others by name.
    """
    groups: dict[str, list[Answer]] = {}
    order: Callable[[Answer], Any] = _GROUPS[group]
    if group == "severity":
        order = lambda answer: answer.limits if isfinite(answer.limits) else inf  # noqa: E731
    for answer in sorted(answers, key=order):
        for name in _GROUPS[group](answer):
            groups.setdefault(name, []).append(answer)
    return dict(sorted(groups.items())) if group in ("experiment", "chip", "stratum") else groups


def severity_name(limits: float) -> str:
    """Return the name of a severity: "2x the limit", or "there or not"."""
    return f"{limits:g}x the limit" if isfinite(limits) else "there or not"


_GROUPS: Mapping[str, Callable[[Answer], tuple[str, ...]]] = {
    "plan": lambda answer: (answer.case.plan,),
    "severity": lambda answer: (severity_name(answer.limits),),
    "mechanism": lambda answer: (answer.mechanisms,),
    "kind": lambda answer: (answer.case.kind,),
    "experiment": lambda answer: answer.experiments,
    "chip": lambda answer: answer.chips,
    "stratum": lambda answer: tuple(f"{name} {value}" for name, value in answer.case.strata.items()),
}


def cells_of(group: str, answers: Sequence[Answer], is_hit: Callable[[Answer], bool], bar: Bar) -> Iterable[ScoreRow]:
    """Yield the share of hits in each part."""
    parts = group_answers(group, answers)
    for name, own in parts.items() if len(parts) > 1 or group == "plan" else ():
        yield make_row(name, rate_of(own, is_hit), bar, "", group=group)


def _within(value: float, other: float, bar: Bar) -> bool:
    """Return whether `value` reaches the lower end and `other` does not exceed the upper one."""
    low, high = bar
    return (low is None or value >= low - _ROUNDING) and (high is None or other <= high + _ROUNDING)


FALSE_ALARMS: Bar = (0.035, 0.065)
"""Allowed range of a nominal 5 %."""
DETECTION: Mapping[float, Bar] = {2.0: (0.80, None), 5.0: (0.98, None)}
"""Bars of the detection rate, by size in detection limits."""

Hidden = Mapping[str, Collection[str]]
"""The effects that a plan cannot show, by plan."""


class DetectionCurve(NamedTuple):
    """Detection on one plan ("all": on all of them): (limits, share) in ascending order, of mechanisms with a size."""

    plan: str
    points: tuple[tuple[float, RateEstimate], ...]


class Power(NamedTuple):
    """Detected and all cases (hits, cases) by mechanism (rows) and severity (columns), on the full plan."""

    mechanisms: tuple[str, ...]
    severities: tuple[str, ...]
    counts: tuple[tuple[tuple[int, int], ...], ...]


def detection_rows(answers: Sequence[Answer], hidden: Hidden, full: str) -> Iterator[ScoreRow]:
    """Yield false alarms by plan, detection at 2 and 5 limits, and the reporting of effects that a plan cannot show."""
    yield from _false_alarms([answer for answer in answers if answer.case.kind == "none"], full)
    shown = shown_singles(answers, hidden)
    for limits, bar in DETECTION.items():
        own = [answer for answer in shown if isclose(answer.limits, limits)]
        about = "single mechanisms: a gap is reported; those that a plan can't show are judged below"
        yield rate_row(
            f"detection at {severity_name(limits)}",
            own,
            Answer.is_detected,
            bar,
            about,
            Breakdown(full, ("mechanism",)),
        )
    yield _undetermined_row([answer for answer in answers if is_hidden(answer, hidden)])


def is_hidden(answer: Answer, hidden: Hidden) -> bool:
    """Return whether the plan cannot show a single mechanism under any of its names."""
    effects = set(hidden.get(answer.case.plan, ()))
    is_of_plan = all(mechanism.resembles and mechanism.resembles <= effects for mechanism in answer.active)
    return answer.case.kind == "single" and (answer.case.is_hidden or is_of_plan)


def shown_singles(answers: Sequence[Answer], hidden: Hidden) -> list[Answer]:
    """Return the single mechanisms that the plan can show."""
    return [answer for answer in answers if answer.case.kind == "single" and not is_hidden(answer, hidden)]


def is_reported_undetermined(answer: Answer) -> bool:
    """Return whether the diagnosis reports that it cannot determine the active mechanism, and what to record."""
    return all(
        any(
            entry["effect"] in mechanism.resembles
            and entry.get("record")
            and meets(mechanism.sensors, entry.get("sensors", ()))
            for entry in answer.undetermined
        )
        for mechanism in answer.active
    )


def curves_of(answers: Sequence[Answer], hidden: Hidden) -> tuple[DetectionCurve, ...]:
    """Return the detection curves of all plans together and of each; for random worlds by experiment."""
    sized = [answer for answer in shown_singles(answers, hidden) if answer.limits == answer.limits]
    parts = group_answers("experiment" if any(answer.case.world for answer in sized) else "plan", sized)
    return tuple(
        DetectionCurve(
            plan,
            tuple(
                (own[0].limits, rate_of(own, Answer.is_detected)) for own in group_answers("severity", part).values()
            ),
        )
        for plan, part in {"all": sized, **parts}.items()
        if part
    )


def power_of(answers: Sequence[Answer], full: str) -> Power:
    """Count the detected single mechanisms on the full plan."""
    counted = [answer for answer in on_plan(answers, full) if answer.case.kind == "single"]
    severities, mechanisms = tuple(group_answers("severity", counted)), group_answers("mechanism", counted)
    counts = []
    for own in mechanisms.values():
        by_severity = group_answers("severity", own)
        parts = [by_severity.get(name, ()) for name in severities]
        counts.append(tuple((sum(map(Answer.is_detected, part)), len(part)) for part in parts))
    return Power(tuple(mechanisms), severities, tuple(counts))


def _false_alarms(controls: Sequence[Answer], full: str) -> Iterator[ScoreRow]:
    about = "no fault, but a gap is reported (nominally 5 %)"
    if full == EVERY and controls:
        parts = ("experiment", "chip", "stratum")
        cells = [cell for group in parts for cell in cells_of(group, controls, Answer.is_false_alarm, NO_BAR)]
        yield make_row("false alarms", rate_of(controls, Answer.is_false_alarm), FALSE_ALARMS, about, cells)
        return
    for plan, own in group_answers("plan", controls).items():
        yield make_row(f"false alarms, plan {plan}", rate_of(own, Answer.is_false_alarm), FALSE_ALARMS, about)
    if not controls:
        yield make_row("false alarms", rate_of(controls, Answer.is_false_alarm), FALSE_ALARMS, about)


def _undetermined_row(answers: Sequence[Answer]) -> ScoreRow:
    about = "the plan can't show the mechanism: the diagnosis says that it can't tell, and what to record"
    cells = [
        make_row(name, rate_of(own, is_reported_undetermined), (1.0, None), "", group=group)
        for group in ("plan", "mechanism")
        for name, own in group_answers(group, answers).items()
    ]
    return make_row(
        "effects that a plan can't show, reported so",
        rate_of(answers, is_reported_undetermined),
        (1.0, None),
        about,
        cells,
    )


FIRST: Bar = (0.90, None)
FIRST_LARGE, IN_CLASS, PLACE = (0.97, None), (0.97, None), (0.98, None)
UNKNOWN, FALSE_UNKNOWN = (0.90, None), (None, 0.10)
APART, TOGETHER, REMOVED = (0.75, None), (0.55, None), (0.90, None)
LARGE = 5.0
"""Size in detection limits from which on a mechanism is easy to detect, and at which a known mechanism must not be
reported as unknown.
"""

_OPEN = ("unexplained", "partly explained")
_SURE = 3.0
"""Upper bar of the hits with permuted labels, in standard deviations above their mean by chance."""


class Confusion(NamedTuple):
    """Active mechanisms (rows) against the first reported cause (columns), `counts` (rows, columns) of cases; `right`
    marks the columns that are names of a row's mechanism.
    """

    truths: tuple[str, ...]
    said: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    right: tuple[tuple[bool, ...], ...]


def cause_rows(
    answers: Sequence[Answer], hidden: Hidden, full: str, sensors: Collection[str], seed: int
) -> Iterator[ScoreRow]:
    """Yield the figures of detected single mechanisms, unknown mechanisms, pairs and removals, and the control."""
    singles = [answer for answer in shown_singles(answers, hidden) if answer.is_detected()]
    yield from _first_rows(singles, full)
    right = [answer for answer in singles if answer.is_first_right()]
    placed = sensors or {sensor for answer in answers for work in answer.active for sensor in work.sensors}
    about = "of right first causes: sensors (those of all likely causes of that name) and axes are the truth's"

    def is_right(answer: Answer) -> bool:
        return is_place_right(answer, set(answer.case.chips) or placed)

    yield rate_row("right sensor and axis", right, is_right, PLACE, about, Breakdown(full))
    yield from _unknown_rows(answers, singles, full, seed)
    pairs = [answer for answer in answers if answer.case.kind == "pair"]
    about = "every mechanism has a likely cause (probability 0.5) of a right name at one of its sensors"
    for name, is_apart, bar in (("on different units", True, APART), ("on one sensor", False, TOGETHER)):
        own = [pair for pair in pairs if _are_disjoint([work.sensors for work in pair.active]) == is_apart]
        yield rate_row(f"two {name}, both named", own, are_both_named, bar, about, Breakdown(full))
    removals = [answer for answer in answers if answer.case.kind == "removal"]
    about = "the model has an effect that the sensors lack: a likely cause removes or replaces it"
    yield rate_row("removed base effect named", removals, is_removed, REMOVED, about, Breakdown(full))
    yield _control(on_plan(singles, full), seed)


def is_in_class(answer: Answer) -> bool:
    """Return whether the first cause, or an effect that it is reported to be confusable with, has a right name."""
    first = answer.first
    if first is None or _takes_out(answer):
        return False
    names = {first["effect"], *first.get("confusable_with", ())}
    return any(names & mechanism.resembles for mechanism in answer.active)


def is_place_right(answer: Answer, sensors: Collection[str]) -> bool:
    """Return whether the likely causes of the right name, including the first cause, affect exactly those of `sensors`
    that the truth names, and its axes if it names any.
    """
    first, (work, *_) = answer.first, answer.active
    if first is None:
        return False
    causes = [first, *(cause for cause in answer.named if cause is not first and work.is_named_by(cause))]
    reported = {sensor for cause in causes for sensor in cause.get("sensors") or sensors}
    axes = {axis for cause in causes for axis in cause.get("axes") or "xyz"}
    return reported & set(sensors) == work.sensors & set(sensors) and (not work.axes or axes == work.axes)


def are_both_named(answer: Answer) -> bool:
    """Return whether every mechanism has a likely cause of its name at its sensors. One cause counts for two mechanisms
    only if they have a name in common.
    """
    works, causes = answer.active, answer.named
    if not _are_disjoint([work.resembles for work in works]):
        return all(any(work.is_located_by(cause) for cause in causes) for work in works)
    return any(
        all(work.is_located_by(cause) for work, cause in zip(works, chosen, strict=True))
        for chosen in permutations(causes, len(works))
    )


def is_removed(answer: Answer) -> bool:
    """Return whether a likely cause removes or replaces the model's extra effect at its sensor."""
    effects, sensors = extra_of(answer.case.extra, answer.case.resembles)
    return any(
        cause["effect"] in effects and cause.get("action") != "add" and meets(sensors, cause.get("sensors", ()))
        for cause in answer.named
    )


def extra_of(extra: Mapping[str, Any], resembles: Sequence[Sequence[str]] = ()) -> tuple[set[str], set[str]]:
    """Return the names and sensors of a model's extra effect: its "effect", otherwise its tables, otherwise the names
    that it resembles.
    """
    named = (
        {str(extra["effect"])}
        if "effect" in extra
        else {key for key, value in extra.items() if isinstance(value, Mapping)}
    )
    sensors = extra.get("sensors", extra.get("sensor", extra.get("name", ())))
    named = named or {name for names in resembles for name in names}
    return named, {sensors} if isinstance(sensors, str) else set(sensors)


def confusion_of(answers: Sequence[Answer], full: str) -> Confusion:
    """Return the confusion matrix of the cases of at most one mechanism on the full plan. Names are in the order of the
    mechanisms, so that correct answers are near the diagonal.
    """
    counted = [answer for answer in on_plan(answers, full) if len(answer.active) < 2 and answer.case.kind != "removal"]
    rows: dict[str, list[Answer]] = {}
    for answer in sorted(counted, key=_row_order):
        withheld = " (withheld)" if answer.case.kind == "withheld" else ""
        name = f"{answer.mechanisms}{withheld}" if answer.active else "nothing wrong"
        rows.setdefault(name, []).append(answer)
    names = {
        name: sorted({effect for answer in own for work in answer.active for effect in work.resembles})
        for name, own in rows.items()
    }
    first_names = {answer.first_name for answer in counted} - {NO_GAP, NOTHING_NAMED}
    ordered = dict.fromkeys(effect for effects in names.values() for effect in effects if effect in first_names)
    columns = (*ordered, *sorted(first_names - set(ordered)), NOTHING_NAMED, NO_GAP)
    counts = tuple(
        tuple(sum(answer.first_name == column for answer in own) for column in columns) for own in rows.values()
    )
    right = tuple(tuple(_is_right_column(own, column) for column in columns) for own in rows.values())
    return Confusion(tuple(rows), columns, counts, right)


def _first_rows(singles: Sequence[Answer], full: str) -> Iterator[ScoreRow]:
    about = "single mechanisms that were detected: the most probable cause has a right name"
    yield rate_row("right cause first", singles, Answer.is_first_right, FIRST, about, Breakdown(full))
    large = [answer for answer in singles if answer.limits >= LARGE]
    yield rate_row("right cause first, 5x and above", large, Answer.is_first_right, FIRST_LARGE, about, Breakdown(full))
    about = "as above, or an effect of its stated class of confusable effects"
    yield rate_row("right within the reported class", singles, is_in_class, IN_CLASS, about, Breakdown(full))


def _unknown_rows(answers: Sequence[Answer], singles: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    strangers = [answer for answer in answers if answer.case.kind in ("unnamed", "withheld") and answer.is_detected()]
    groups = ("kind", "severity", "mechanism")
    about = "detected mechanisms that no name of the library fits: the verdict"
    yield rate_row("unknown called unexplained or partly", strangers, _is_open, UNKNOWN, about, Breakdown(full, groups))
    known = [answer for answer in singles if isclose(answer.limits, LARGE)]
    about = f"detected single mechanisms at {severity_name(LARGE)} that the library names: the verdict"
    is_unexplained: Callable[[Answer], bool] = lambda answer: answer.verdict == "unexplained"  # noqa: E731
    yield rate_row("known at 5x called unexplained", known, is_unexplained, FALSE_UNKNOWN, about, Breakdown(full))
    yield rate_row("known at 5x called unexplained or partly", known, _is_open, NO_BAR, about, Breakdown(full))
    yield from _unknown_scores(on_plan(strangers, full), known, singles, full, seed)


def _unknown_scores(
    strangers: Sequence[Answer], known: Sequence[Answer], singles: Sequence[Answer], full: str, seed: int
) -> Iterator[ScoreRow]:
    """Yield the figures of the stated probability that an unknown effect is present."""
    above = [answer.unknown for answer in strangers]
    at_large = [answer.unknown for answer in on_plan(known, full)]
    detected = sum(value > limit_of(at_large, 0.1) for value in above) if at_large else 0
    about = (
        "detected unknown ones whose probability of being unknown is above the limit that 10 % of the known at 5x pass"
    )
    yield make_row(
        "unknown at 5x recognised, 10 % false ones", rate(detected, len(above) if at_large else 0), UNKNOWN, about
    )
    every = [answer.unknown for answer in on_plan(singles, full)]
    about = "the chance that an unknown one has the greater probability of being unknown than a known one at 5x"
    area = bootstrap(auroc, above, at_large, seed=seed)
    cell = make_row(
        "against known ones of every size", bootstrap(auroc, above, every, seed=seed), NO_BAR, "", group="severity"
    )
    yield make_row("unknown against known at 5x, AUROC", area, UNKNOWN, about, [cell])


def _control(singles: Sequence[Answer], seed: int) -> ScoreRow:
    """Permute the labels of the cases: the share of right ones must not exceed chance."""
    labels = [frozenset(effect for work in answer.active for effect in work.resembles) for answer in singles]
    effects = {
        label: np.array([answer.first_name in label and not _takes_out(answer) for answer in singles])
        for label in set(labels)
    }
    hits = np.stack([effects[label] for label in labels], axis=1) if labels else np.zeros((0, 0), bool)
    chance = permute_labels(hits, seed)
    share: RateEstimate = rate(chance.hits, len(singles))
    bar = (None, chance.mean + _SURE * chance.deviation) if isfinite(chance.mean) else (None, 0.5)
    about = "a control of the scoring: labels of cases permuted once"
    if isfinite(chance.mean):
        about += f", which gives {chance.mean:.3f} on average"
    return make_row("right cause first, labels shuffled", share, bar, about)


def _takes_out(answer: Answer) -> bool:
    return answer.first is not None and answer.first.get("action") == "remove"


def _is_open(answer: Answer) -> bool:
    return answer.verdict in _OPEN


def _are_disjoint(sets: Sequence[Collection[str]]) -> bool:
    return len(set().union(*sets)) == sum(map(len, sets))


def _row_order(answer: Answer) -> tuple[int, list[str], str]:
    rank = {"none": 3, "unnamed": 2, "withheld": 1}.get(answer.case.kind, 0)
    return rank, sorted(effect for work in answer.active for effect in work.resembles), answer.mechanisms


def _is_right_column(answers: Sequence[Answer], column: str) -> bool:
    """Return whether this column is correct for the mechanism: a name, no gap, or no name."""
    first = answers[0]
    if not first.active:
        return column == NO_GAP
    if first.case.kind != "single":
        return column == NOTHING_NAMED
    return any(column in work.resembles for answer in answers for work in answer.active)


WITHIN = 0.05
NEAR: Bar = (0.90, None)
COVERED, WRONG, EMPTY = (0.90, 0.97), (None, 0.3), (0.95, None)
CALIBRATION, BRIER = (None, 0.05), (None, 0.15)

_KINDS = ("single", "pair", "removal")
"""The kinds of cases whose gap an oracle can close."""


class Closure(NamedTuple):
    """One case of the full plan: the reported closed share with its interval, and the oracle's. `is_right`: the first
    cause is right, or the extra effect was named.
    """

    name: str
    kind: str
    claimed: float
    low: float
    high: float
    oracle: float
    is_right: bool


def closure_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    """Yield the figures of the closed share: against the oracle, for wrong causes, and without a gap."""
    solvable = [answer for answer in answers if _has_oracle(answer)]
    groups = ("kind", "severity", "mechanism")
    about = f"detected, with an oracle: the share that it claims to close is within {WITHIN} of the oracle's"
    yield rate_row("closure near the oracle's", solvable, is_near, NEAR, about, Breakdown(full, groups))
    about = "as above: the oracle's share lies in the 95 % interval"
    yield rate_row(
        "closure's interval covers the oracle's", solvable, is_covered, COVERED, about, Breakdown(full, groups)
    )
    own = [answer for answer in on_plan(answers, full) if answer.is_detected()]
    yield _wrong(own, seed)
    yield _withheld_row(own, seed)
    controls = [answer for answer in answers if answer.case.kind == "none"]
    about = "no fault: no closure is reported, or its interval contains 0"
    yield rate_row("without a gap, closure may be 0", controls, is_empty, EMPTY, about, Breakdown(full, ()))


def probability_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    """Yield the calibration error and Brier score of all reported causes, and the error expected by chance."""
    counted = on_plan(answers, full)
    about = "all reported causes in cases of one mechanism, two or none: right if the name is, at one of the sensors"
    for name, statistic, bar in (
        ("calibration error (ECE)", calibration_error, CALIBRATION),
        ("Brier score of causes", brier, BRIER),
    ):
        cells = [
            make_row(part, bootstrap_groups(statistic, _probabilities(own), seed), NO_BAR, "", group=group)
            for group in (("experiment", "chip") if full == EVERY else ("plan",))
            for part, own in group_answers(group, answers).items()
        ]
        estimate = bootstrap_groups(statistic, _probabilities(counted), seed)
        yield make_row(name, estimate, bar, f"{about}; counted are causes", cells)
    values = np.array([value for own, _ in _probabilities(counted) for value in own])
    about = (
        "what the calibration error would be, on average, if all these probabilities were right: bins have few causes"
    )
    floor = calibration_error_by_chance(values, seed) if len(values) else nan
    yield make_row("calibration error by chance alone", RateEstimate(floor, nan, nan, len(values)), NO_BAR, about)


def time_rows(answers: Sequence[Answer], full: str, seed: int) -> Iterator[ScoreRow]:
    """Yield the median and the 90 % quantile of the processing time of a case."""
    seconds = [answer.outcome.seconds for answer in on_plan(answers, full)]
    for name, share in (("median", 0.5), ("90 % quantile", 0.9)):
        estimate = bootstrap(lambda sample, share=share: float(np.quantile(sample, share)), seconds, seed=seed)
        yield make_row(f"seconds a case, {name}", estimate, NO_BAR, "recording, diagnosis and oracle of one case")


def is_near(answer: Answer) -> bool:
    """Return whether the reported closed share is close to the oracle's; False without a reported share."""
    return abs(answer.closed - answer.oracle) <= WITHIN + 1e-9


def is_covered(answer: Answer) -> bool:
    """Return whether the reported interval contains the oracle's share; False without an interval."""
    low, high = answer.closed_ci95
    return low <= answer.oracle <= high


def is_empty(answer: Answer) -> bool:
    """Return whether the interval of the reported closed share contains 0, or no share is reported."""
    low, high = answer.closed_ci95
    return not answer.is_detected() or not isfinite(answer.closed) or low <= 0 <= high


def closures_of(answers: Sequence[Answer], full: str) -> tuple[Closure, ...]:
    """Return the cases of the full plan that have an oracle."""
    return tuple(
        Closure(
            answer.case.name, answer.case.kind, answer.closed, *answer.closed_ci95, answer.oracle, _is_right(answer)
        )
        for answer in on_plan(answers, full)
        if _has_oracle(answer)
    )


def reliability_of(answers: Sequence[Answer], full: str) -> tuple[Bin, ...]:
    """Return the reliability of all causes reported on the full plan."""
    groups = _probabilities(on_plan(answers, full))
    return reliability([value for own, _ in groups for value in own], [flag for _, own in groups for flag in own])


def _wrong(answers: Sequence[Answer], seed: int) -> ScoreRow:
    wrong = [
        number(answer.first.get("closed"))
        for answer in answers
        if answer.case.kind == "single" and answer.first and not answer.is_first_right()
    ]
    claims = [value for value in wrong if isfinite(value)]
    about = "detected single mechanisms with a wrong first cause: the mean share that this cause claims to close"
    return make_row("closure claimed for a wrong cause", bootstrap(np.mean, claims, seed=seed), WRONG, about)


def _withheld_row(answers: Sequence[Answer], seed: int) -> ScoreRow:
    """Return the mean share that causes claim to close if the right cause is withheld from the library. The figure for
    reported wrong causes, in contrast, includes only cases in which the right cause was available.
    """
    claims = [
        max(answer.closed, 0.0) if isfinite(answer.closed) else 0.0
        for answer in answers
        if answer.case.kind == "withheld"
    ]
    about = "detected with the right cause withheld: mean share that the causes claim to close, 0 if they claim none"
    return make_row("closure claimed without the right cause", bootstrap(np.mean, claims, seed=seed), NO_BAR, about)


def _probabilities(answers: Sequence[Answer]) -> list[tuple[list[float], list[bool]]]:
    """Return the probabilities of each case's causes, and whether they are right."""
    return [
        (
            [probability(cause) for cause in answer.causes],
            [any(work.is_located_by(cause) for work in answer.active) for cause in answer.causes],
        )
        for answer in answers
        if answer.case.kind in ("single", "pair", "none")
    ]


def _is_right(answer: Answer) -> bool:
    return is_removed(answer) if answer.case.kind == "removal" else answer.is_first_right()


def _has_oracle(answer: Answer) -> bool:
    return answer.case.kind in _KINDS and answer.is_detected() and isfinite(answer.oracle)

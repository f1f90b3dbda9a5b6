"""What a run left behind: the diagnosis of every case beside its sealed truth, and the cases that were lost."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isfinite, nan
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

from imuarray.errors import ConfigError
from imuarray.validation.case import Case, Outcome

LIKELY = 0.5
"""Probability from which on a cause counts as named."""

NO_GAP, NOTHING_NAMED = "no gap", "nothing named"
Said = Mapping[str, Any]
"""A cause, as the JSON of a diagnosis has it."""


OF_A_WORLD: Mapping[tuple[str, str], frozenset[str]] = MappingProxyType(
    {
        ("labels", "some wrong"): frozenset({"face_error"}),
        ("vibration", "fridge"): frozenset({"tone", "common_mode"}),
        ("vibration", "fan"): frozenset({"tone", "common_mode"}),
    }
)
"""By stratum of a random world: what a diagnosis may rightly say of it, whatever else is at work."""


@dataclass(frozen=True)
class AtWork:
    """A mechanism that was at work: its size in detection limits (nan: it is there or not), on which sensors and axes
    (none: all, or it isn't told), and what effects it may rightly be called.
    """

    mechanism: str
    limits: float
    sensors: frozenset[str]
    axes: frozenset[str]
    resembles: frozenset[str]

    def is_called(self, cause: Said) -> bool:
        """Whether the cause has one of its names; what is taken out of the model isn't at work."""
        return cause["effect"] in self.resembles and cause.get("action") != "remove"

    def is_met(self, cause: Said) -> bool:
        """Whether it has one of its names, and concerns at least one of its sensors."""
        return self.is_called(cause) and meets(self.sensors, cause.get("sensors", ()))


@dataclass(frozen=True)
class Answer:
    """A case that was diagnosed: what was `at_work`, and what came of it."""

    case: Case
    at_work: tuple[AtWork, ...]
    outcome: Outcome
    known: tuple[Said, ...] = ()
    """What is said of the control of this case: not what was put into it."""

    @property
    def verdict(self) -> str:
        """In the diagnosis' words."""
        return str(self.outcome.diagnosis["verdict"])

    @property
    def is_detected(self) -> bool:
        """Whether a gap is told."""
        return self.verdict != NO_GAP

    @property
    def causes(self) -> tuple[Said, ...]:
        """Most probable first, without those that are said of the control as well."""
        told = self.outcome.diagnosis.get("causes") or ()
        return tuple(cause for cause in told if not any(_is_same(cause, other) for other in self.known))

    @property
    def is_false_alarm(self) -> bool:
        """Whether a gap is told that the world of a control does not explain: where its faces are noted wrongly, or a
        machine shakes its room, these are right to be told, and everything beside them is not.
        """
        if not self.is_detected or self.verdict != "explained":
            return self.is_detected
        effects = {str(cause["effect"]) for cause in self.causes}
        return not effects or not effects <= self.of_the_world

    @property
    def of_the_world(self) -> frozenset[str]:
        """Effects that a world has by itself."""
        return frozenset().union(*(OF_A_WORLD.get(item, ()) for item in self.case.strata.items()))

    @property
    def named(self) -> tuple[Said, ...]:
        """The causes that are likely."""
        return tuple(cause for cause in self.causes if probability(cause) >= LIKELY)

    @property
    def first(self) -> Said | None:
        """The most probable cause."""
        return self.causes[0] if self.causes else None

    @property
    def said(self) -> str:
        """The first cause's effect, or that there's none, or no gap."""
        if not self.is_detected:
            return NO_GAP
        return str(self.first["effect"]) if self.first else NOTHING_NAMED

    @property
    def limits(self) -> float:
        """Size of the smallest mechanism at work, in detection limits; nan if it is there or not."""
        return min((one.limits for one in self.at_work if isfinite(one.limits)), default=nan)

    @property
    def mechanisms(self) -> str:
        """Their names."""
        return " + ".join(one.mechanism for one in self.at_work)

    @property
    def chips(self) -> tuple[str, ...]:
        """Of the sensors that have what is at work, else of all; none if nobody says."""
        concerned = {name for one in self.at_work for name in one.sensors} or set(self.case.chips)
        return tuple(sorted({chip for name, chip in self.case.chips.items() if name in concerned}))

    @property
    def experiments(self) -> tuple[str, ...]:
        """Of the plan."""
        return tuple(name for name in self.case.plan.split("+") if name)

    @property
    def unknown(self) -> float:
        """How probable it is, by the diagnosis, that something outside the library is present."""
        return number(self.outcome.diagnosis.get("unknown"), 0.0)

    @property
    def closed(self) -> float:
        """Share of the gap that is said to be closed; nan if none is said."""
        return number((self.outcome.diagnosis.get("gap") or {}).get("closed"))

    @property
    def closed_ci95(self) -> tuple[float, float]:
        """Its interval; nan if none is said."""
        return interval((self.outcome.diagnosis.get("gap") or {}).get("closed_ci95"))

    @property
    def oracle(self) -> float:
        """Share of the gap closed by somebody who is told the effects; nan if there is none."""
        return number(self.outcome.oracle.get("closed"))

    @property
    def untold(self) -> tuple[Said, ...]:
        """What the diagnosis says it can't tell."""
        diagnosis = self.outcome.diagnosis
        return tuple(diagnosis.get("unshown") or diagnosis.get("cannot_tell") or ())

    def is_first_right(self) -> bool:
        """Whether the first cause has a name of what is at work."""
        first = self.first
        return first is not None and any(one.is_called(first) for one in self.at_work)


@dataclass(frozen=True)
class Lost:
    """A case of which nothing came, and `why`."""

    name: str
    kind: str
    plan: str
    why: str


@dataclass(frozen=True)
class Run:
    """A validation run: its plan (`plan.json`), answers in the order of their numbers, lost cases, and what was
    noticed.
    """

    plan: Mapping[str, Any]
    answers: tuple[Answer, ...]
    lost: tuple[Lost, ...]
    notes: tuple[str, ...] = ()


def read_run(folder: str | PathLike[str], planned: Iterable[Case] = ()) -> Run:
    """Open the sealed truth of a run's folder. Cases without outcome are lost, as are outcomes without truth; so are
    those of `planned` that have nothing at all. Where what comes by chance never came there is no answer. ConfigError
    if it isn't a run's folder.
    """
    place = Path(folder)
    try:
        plan = json.loads((place / "plan.json").read_text())
    except (OSError, ValueError):
        raise ConfigError(f"{place}: no plan.json; allowed is the folder of a validation run") from None
    sealed, came = _tables(place / "sealed"), _tables(place / "outcomes")
    answers, lost, differing, idle = [], [], 0, 0
    for name, table in sealed.items():
        case, outcome = Case.of_table(table["case"]), Outcome(**came[name]) if name in came else None
        if outcome is None or outcome.error or not outcome.diagnosis:
            lost.append(Lost(name, case.kind, case.plan, _why(outcome)))
            continue
        if _is_idle(table.get("truth") or {}):
            idle += 1
            continue
        answers.append(Answer(case, at_work_of(case, table.get("truth") or {}), outcome))
        differing += _differs(case, table.get("truth") or {})
    lost += _unsealed(planned, sealed, came)
    answers = sorted(_beside_controls(answers), key=lambda one: (one.case.half, one.case.number))
    notes = {
        f"In {differing} cases what is at work has other names in the plan than by its generator.": differing,
        f"In {idle} cases what comes by chance never came while something was recorded: they don't count.": idle,
    }
    return Run(plan, tuple(answers), tuple(lost), tuple(note for note, count in notes.items() if count))


def _beside_controls(answers: Sequence[Answer]) -> Iterator[Answer]:
    """With what is said of their controls."""
    causes = {one.case.name: one.causes for one in answers}
    for one in answers:
        yield replace(one, known=causes.get(one.case.control, ()))


def _is_same(cause: Said, other: Said) -> bool:
    """Whether two causes are one: the effect, at a common sensor."""
    return bool(cause["effect"] == other["effect"]) and meets(cause.get("sensors", ()), other.get("sensors", ()))


def at_work_of(case: Case, truth: Mapping[str, Any]) -> tuple[AtWork, ...]:
    """What was at work in a case, with the sensors of its truth."""
    told = _told(truth) or [{} for _ in case.puts]
    same = len(case.resembles) == len(case.puts)
    names = case.resembles if same else tuple(tuple(one.get("resembles", ())) for one in told)
    return tuple(
        AtWork(
            put.mechanism,
            put.limits,
            frozenset(one.get("sensors") or put.sensors),
            frozenset(_axes(one.get("parameters", {}))),
            frozenset(effects),
        )
        for put, one, effects in zip(case.puts, told, names, strict=True)
    )


def probability(cause: Said) -> float:
    """Of a cause; 0 if it has none."""
    return number(cause.get("probability"), 0.0)


def meets(sensors: Iterable[str], others: Iterable[str]) -> bool:
    """Whether two sets of sensors have one in common; none named is all."""
    one, other = set(sensors), set(others)
    return not one or not other or bool(one & other)


def number(value: Any, otherwise: float = nan) -> float:
    """A number of JSON, which has null for what isn't finite."""
    return otherwise if value is None else float(value)


def interval(value: Sequence[Any] | None) -> tuple[float, float]:
    """An interval of JSON."""
    low, high = value or (None, None)
    return number(low), number(high)


def _axes(parameters: Mapping[str, Any]) -> Iterable[str]:
    """ "x", "y", "z", if the parameters of a mechanism name any."""
    named = parameters.get("axes", parameters.get("axis", ()))
    return {sign for sign in named if sign in "xyz"} if isinstance(named, str | list) else ()


def _told(truth: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return list(truth.get("mechanisms") or ())


def _is_idle(truth: Mapping[str, Any]) -> bool:
    """Whether a mechanism that says whom it touched, when it comes, touched none in any log."""
    said: dict[str, bool] = {}
    for log in truth.get("logs") or ():
        for mechanism, sensors in log.get("touched", {}).items():
            said[mechanism] = said.get(mechanism, False) or bool(sensors)
    return not all(said.values())


def _differs(case: Case, truth: Mapping[str, Any]) -> bool:
    """Whether the plan would call what is at work otherwise than who made it."""
    told = [set(one.get("resembles", ())) for one in _told(truth)]
    return bool(case.resembles and told) and [set(names) for names in case.resembles] != told


def _tables(folder: Path) -> dict[str, Any]:
    """By name; a file that can't be read is none."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        with suppress(ValueError):
            found[path.stem] = json.loads(path.read_text())
    return found


def _unsealed(planned: Iterable[Case], sealed: Mapping[str, Any], came: Mapping[str, Any]) -> Iterable[Lost]:
    """Cases that have no truth: never begun, or their worker died before it was written."""
    known = {case.name: case for case in planned}
    for name in sorted({*known, *came} - set(sealed)):
        kind, plan = (known[name].kind, known[name].plan) if name in known else ("unknown", "unknown")
        yield Lost(name, kind, plan, _why(Outcome(**came[name])) if name in came else "never begun")


def _why(outcome: Outcome | None) -> str:
    if outcome is None:
        return "no outcome"
    return (outcome.error.strip().splitlines() or ["no truth" if outcome.diagnosis else "no diagnosis"])[-1]

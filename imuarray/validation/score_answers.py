"""The results of a run: the diagnosis of every case together with its sealed truth, and the lost cases."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isfinite, nan
from os import PathLike
from pathlib import Path
from typing import Any

from imuarray.errors import ConfigError
from imuarray.validation.case import Case, Outcome

LIKELY = 0.5
"""Probability from which on a cause counts as named."""

NO_GAP, NOTHING_NAMED = "no gap", "nothing named"
NEVER_BEGUN = "never begun"
"""The reason stated for cases that a run did not reach before it was stopped."""

Cause = Mapping[str, Any]
"""A cause, as the JSON of a diagnosis has it."""


WORLD_EFFECTS: Mapping[tuple[str, str], frozenset[str]] = {
    ("labels", "some wrong"): frozenset({"face_error"}),
    ("vibration", "fridge"): frozenset({"tone", "common_mode"}),
    ("vibration", "fan"): frozenset({"tone", "common_mode"}),
}
"""The effects that are correct reports in a stratum of a random world, whichever mechanism is active."""


_IDENTITY = ("frequency_hz", "step_lsb")
"""Parameters that distinguish two causes of the same effect, sensor and axis."""

_SAME = 0.05
"""Largest relative difference of these parameters between equal causes."""


@dataclass(frozen=True)
class ActiveMechanism:
    """A mechanism that was active: its size in detection limits (nan if it has none), its sensors and axes (empty: all,
    or unknown), and its correct effect names.
    """

    mechanism: str
    limits: float
    sensors: frozenset[str]
    axes: frozenset[str]
    resembles: frozenset[str]

    def is_named_by(self, cause: Cause) -> bool:
        """Return whether the cause has one of its names; a cause that removes an effect from the model does not."""
        return cause["effect"] in self.resembles and cause.get("action") != "remove"

    def is_located_by(self, cause: Cause) -> bool:
        """Return whether the cause has one of its names and at least one of its sensors."""
        return self.is_named_by(cause) and meets(self.sensors, cause.get("sensors", ()))


@dataclass(frozen=True)
class Answer:
    """A diagnosed case: the mechanisms that were `active`, and its outcome."""

    case: Case
    active: tuple[ActiveMechanism, ...]
    outcome: Outcome
    known: tuple[Cause, ...] = ()
    """The causes reported for the control of this case, which are not due to the injection."""

    @property
    def verdict(self) -> str:
        """The verdict in the words of the diagnosis."""
        return str(self.outcome.diagnosis["verdict"])

    def is_detected(self) -> bool:
        """Return whether a gap is reported."""
        return self.verdict != NO_GAP

    @property
    def reported(self) -> tuple[Cause, ...]:
        """The reported causes, most probable first, without those that are reported for the control as well."""
        reported = self.outcome.diagnosis.get("causes") or ()
        return tuple(cause for cause in reported if not _is_known(cause, self.known))

    @property
    def is_in_control(self) -> bool:
        """True if the control has a correct cause at the correct place that cannot be distinguished from that of the
        case. Lines and steps can be distinguished by their frequency and size.
        """
        return any(
            mechanism.is_located_by(cause) and meets(mechanism.axes, cause.get("axes") or ())
            for mechanism in self.active
            for cause in self.known
            if not any(name in (cause.get("parameters") or {}) for name in _IDENTITY)
        )

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The reported causes without those that correctly describe the world, which are neither right nor wrong."""
        active = frozenset().union(*(mechanism.resembles for mechanism in self.active))
        of_world = self.world_effects - active
        return tuple(cause for cause in self.reported if cause["effect"] not in of_world)

    def is_false_alarm(self) -> bool:
        """Return whether a gap is reported that the world of a control does not explain. Wrong face labels or a
        vibrating room are correct reports; everything else is a false alarm.
        """
        if not self.is_detected() or self.verdict != "explained":
            return self.is_detected()
        effects = {str(cause["effect"]) for cause in self.reported}
        return not effects or not effects <= self.world_effects

    @property
    def world_effects(self) -> frozenset[str]:
        """The effects that a world has without any mechanism."""
        return frozenset().union(*(WORLD_EFFECTS.get(item, ()) for item in self.case.strata.items()))

    @property
    def named(self) -> tuple[Cause, ...]:
        """The causes with a probability of at least `LIKELY`."""
        return tuple(cause for cause in self.causes if probability(cause) >= LIKELY)

    @property
    def first(self) -> Cause | None:
        """The most probable cause."""
        return self.causes[0] if self.causes else None

    @property
    def first_name(self) -> str:
        """The effect of the first cause, `NOTHING_NAMED` without causes, `NO_GAP` without a gap."""
        if not self.is_detected():
            return NO_GAP
        return str(self.first["effect"]) if self.first else NOTHING_NAMED

    @property
    def limits(self) -> float:
        """Size of the smallest active mechanism in detection limits; nan for a mechanism without a size."""
        return min((mechanism.limits for mechanism in self.active if isfinite(mechanism.limits)), default=nan)

    @property
    def mechanisms(self) -> str:
        """The names of the active mechanisms."""
        return " + ".join(mechanism.mechanism for mechanism in self.active)

    @property
    def chips(self) -> tuple[str, ...]:
        """The chips of the affected sensors, or of all sensors if none is named; empty if unknown."""
        concerned = {name for mechanism in self.active for name in mechanism.sensors} or set(self.case.chips)
        return tuple(sorted({chip for name, chip in self.case.chips.items() if name in concerned}))

    @property
    def experiments(self) -> tuple[str, ...]:
        """The experiments of the plan."""
        return tuple(name for name in self.case.plan.split("+") if name)

    @property
    def unknown(self) -> float:
        """The probability, stated by the diagnosis, that an effect outside the library is present."""
        return number(self.outcome.diagnosis.get("unknown"), 0.0)

    @property
    def closed(self) -> float:
        """The reported share of the gap that is closed; nan without one."""
        return number((self.outcome.diagnosis.get("gap") or {}).get("closed"))

    @property
    def closed_ci95(self) -> tuple[float, float]:
        """The interval of the closed share; nan without one."""
        return interval((self.outcome.diagnosis.get("gap") or {}).get("closed_ci95"))

    @property
    def oracle(self) -> float:
        """The share of the gap that a diagnosis with known effects closes; nan without one."""
        return number(self.outcome.oracle.get("closed"))

    @property
    def undetermined(self) -> tuple[Cause, ...]:
        """The effects that the diagnosis reports as impossible to determine."""
        diagnosis = self.outcome.diagnosis
        return tuple(diagnosis.get("unshown") or diagnosis.get("cannot_tell") or ())

    def is_first_right(self) -> bool:
        """Return whether the first cause names an active mechanism."""
        first = self.first
        return first is not None and any(mechanism.is_named_by(first) for mechanism in self.active)


@dataclass(frozen=True)
class LostCase:
    """A case without a result, and `why`."""

    name: str
    kind: str
    plan: str
    why: str


@dataclass(frozen=True)
class ValidationRun:
    """Results of a validation run: its plan (`plan.json`), answers in the order of their numbers, lost cases, notes."""

    plan: Mapping[str, Any]
    answers: tuple[Answer, ...]
    lost: tuple[LostCase, ...]
    notes: tuple[str, ...] = ()


def read_run(folder: str | PathLike[str], planned: Iterable[Case] = ()) -> ValidationRun:
    """Read a run's folder with its sealed truth. Cases without outcome are lost, as are outcomes without truth and
    those of `planned` without any file. Two kinds of cases are not counted: those in which a random mechanism never
    acted, and those whose control has the same effect at the same place, because the two effects cannot be
    distinguished. ConfigError if it is not the folder of a run.
    """
    place = Path(folder)
    try:
        plan = json.loads((place / "plan.json").read_text())
    except (OSError, ValueError):
        raise ConfigError(f"{place}: no plan.json; allowed is the folder of a validation run") from None
    sealed, outcomes = _tables(place / "sealed"), _tables(place / "outcomes")
    answers, lost, differing, idle = [], [], 0, 0
    for name, table in sealed.items():
        case, truth = Case.of_table(table["case"]), table.get("truth") or {}
        outcome = Outcome(**outcomes[name]) if name in outcomes else None
        if outcome is None or outcome.error or not outcome.diagnosis:
            lost.append(LostCase(name, case.kind, case.plan, _why(outcome)))
            continue
        if _is_idle(truth):
            idle += 1
            continue
        answers.append(Answer(case, active_mechanisms(case, truth), outcome))
        differing += _differs(case, truth)
    lost += _without_truth(planned, sealed, outcomes)
    causes = {answer.case.name: answer.causes for answer in answers}
    with_controls = [replace(answer, known=causes.get(answer.case.control, ())) for answer in answers]
    answers = [answer for answer in with_controls if not answer.is_in_control]
    answers.sort(key=lambda answer: (answer.case.half, answer.case.number))
    same = len(with_controls) - len(answers)
    notes = {
        f"In {same} cases the recording itself has the effect that was put into it: they are not counted.": same,
        f"In {differing} cases the plan and the generator name the mechanism differently.": differing,
        f"In {idle} cases the fault, which occurs by chance, did not occur while logs were recorded: they"
        f" are not counted.": idle,
    }
    return ValidationRun(plan, tuple(answers), tuple(lost), tuple(note for note, count in notes.items() if count))


def _is_known(cause: Cause, known: Iterable[Cause]) -> bool:
    """Return whether the known causes have this effect on all sensors of the cause, each on one of its axes. A line of
    a different frequency or a step of a different size is a different cause.
    """
    same = [other for other in known if other["effect"] == cause["effect"] and _can_be_same(cause, other)]
    sensors = [set(other.get("sensors") or ()) for other in same]
    if not all(sensors):  # one of them is a cause in all sensors
        return True
    own = set(cause.get("sensors") or ())
    return bool(own) and own <= set().union(*sensors)


def _can_be_same(cause: Cause, other: Cause) -> bool:
    """Return whether two causes of one effect share an axis and agree in frequency and step."""
    parameters = cause.get("parameters") or {}, other.get("parameters") or {}
    known = [[number(each.get(name)) for each in parameters] for name in _IDENTITY]
    is_other = any(abs(first - second) > _SAME * abs(second) for first, second in known)
    return not is_other and meets(cause.get("axes") or (), other.get("axes") or ())


def active_mechanisms(case: Case, truth: Mapping[str, Any]) -> tuple[ActiveMechanism, ...]:
    """Return the mechanisms that were active in a case, with the sensors of its truth."""
    mechanisms = truth.get("mechanisms") or [{} for _ in case.puts]
    same = len(case.resembles) == len(case.puts)
    names = case.resembles if same else tuple(tuple(mechanism.get("resembles", ())) for mechanism in mechanisms)
    return tuple(
        ActiveMechanism(
            put.mechanism,
            put.limits,
            frozenset(mechanism.get("sensors") or put.sensors),
            frozenset(_axes(mechanism.get("parameters", {}))),
            frozenset(effects),
        )
        for put, mechanism, effects in zip(case.puts, mechanisms, names, strict=True)
    )


def probability(cause: Cause) -> float:
    """Return the probability of a cause; 0 if it has none."""
    return number(cause.get("probability"), 0.0)


def meets(sensors: Iterable[str], others: Iterable[str]) -> bool:
    """Return whether two sets of sensors intersect; an empty set stands for all sensors."""
    first, second = set(sensors), set(others)
    return not first or not second or bool(first & second)


def number(value: Any, otherwise: float = nan) -> float:
    """Return a number of JSON as a float; `otherwise` for null, which stands for values that are not finite."""
    return otherwise if value is None else float(value)


def interval(value: Sequence[Any] | None) -> tuple[float, float]:
    """Return an interval of JSON."""
    low, high = value or (None, None)
    return number(low), number(high)


def _axes(parameters: Mapping[str, Any]) -> Iterable[str]:
    """Return the "x", "y", "z", if the parameters of a mechanism name any."""
    named = parameters.get("axes", parameters.get("axis", ()))
    return {sign for sign in named if sign in "xyz"} if isinstance(named, str | list) else ()


def _is_idle(truth: Mapping[str, Any]) -> bool:
    """Return whether a mechanism that logs the sensors it affects affected none in any log."""
    has_affected: dict[str, bool] = {}
    for log in truth.get("logs") or ():
        for mechanism, sensors in log.get("touched", {}).items():
            has_affected[mechanism] = has_affected.get(mechanism, False) or bool(sensors)
    return not all(has_affected.values())


def _differs(case: Case, truth: Mapping[str, Any]) -> bool:
    """Return whether the plan and the generator disagree about the names of a mechanism."""
    generated = [set(mechanism.get("resembles", ())) for mechanism in truth.get("mechanisms") or ()]
    return bool(case.resembles and generated) and [set(names) for names in case.resembles] != generated


def _tables(folder: Path) -> dict[str, Any]:
    """Return the readable JSON files of a folder by name."""
    tables = {}
    for path in sorted(folder.glob("*.json")):
        with suppress(ValueError):
            tables[path.stem] = json.loads(path.read_text())
    return tables


def _without_truth(
    planned: Iterable[Case], sealed: Mapping[str, Any], outcomes: Mapping[str, Any]
) -> Iterable[LostCase]:
    """Yield the cases without a truth: never started, or their worker died before it was written."""
    known = {case.name: case for case in planned}
    for name in sorted({*known, *outcomes} - set(sealed)):
        kind, plan = (known[name].kind, known[name].plan) if name in known else ("unknown", "unknown")
        yield LostCase(name, kind, plan, _why(Outcome(**outcomes[name])) if name in outcomes else NEVER_BEGUN)


def _why(outcome: Outcome | None) -> str:
    if outcome is None:
        return "no outcome"
    return (outcome.error.strip().splitlines() or ["no truth" if outcome.diagnosis else "no diagnosis"])[-1]

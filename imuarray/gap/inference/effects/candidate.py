"""Candidates: an effect that may be the cause, and guesses of its parameters from a sensor's evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from typing import Any, Literal

from imuarray.gap.inference.evidence import ALWAYS, NATS_PER_NUMBER, Evidence, When
from imuarray.gap.model.populations import PRINTED, is_near_noted_position, is_usual
from imuarray.gap.model.rest import FittedParameters
from imuarray.log.format import SensorHeader
from imuarray.simulate.active_spans import spans_of
from imuarray.simulate.effect import Effect

Kind = Literal["static", "tumble", "heating", "turn-on", "motion"]
"""Procedure that a log records; one entry of the menu of experiments."""

Need = Literal["faces", "warmth", "runs", "turns", "rest", "warm_faces", "warm_turns"]
"""What a recording must contain: several faces, a temperature change, runs, turns, rest, or two of them at once."""

Action = Literal["add", "remove", "replace"]

_CHOICES = frozenset({"range", "axes"})
"""Parameters that have a few discrete values, so that one value does not approximate another one."""


@dataclass(frozen=True)
class Hypothesis:
    """A change of a sensor's model that may explain the sensor's readings.

    What changes:

    * `effects` are added, with first guesses of their parameters. Effects of the kind `removed` are removed first ("":
      none).
    * `free`: the parameters that the search may refine, each axis by a positive factor; a guess of 0 and its sign stay.
    * `limits`: smallest and largest value of a parameter; beyond them another effect looks the same.
    * `fitted`: the ordinary parameters at the start, if the effect disturbs the fit (None: the fitted ones).

    In which sensors:

    * `shared`: the effect shows only in comparison with other sensors. All sensors of the chip have it, or only
      `sensor`, or only the `members` of the chip. `others` are sensors that show it although they do not have it; they
      get the effects `opposite` and begin with `opposite_fitted`.
    * `everywhere`: the effect concerns all sensors that the host reads.

    When:

    * `when`: the spans in which the effect acts (default: always); see `at`.
    * `whole`: the effect shows only in both parts of the recordings together, not in either part alone.
    * `begin_bounds_s`: earliest and latest time at which the last span begins, if it does not cover its whole log; or
      at which the first effect begins, if it has an onset of its own.

    `rarity`: nats by which the effect is rarer than others that look the same (negative: more usual).
    """

    effects: tuple[Effect, ...]
    free: tuple[str, ...] = ()
    removed: str = ""
    shared: bool = False
    sensor: str = ""
    others: tuple[str, ...] = ()
    opposite: tuple[Effect, ...] = ()
    members: tuple[str, ...] = ()
    everywhere: bool = False
    whole: bool = False
    rarity: float = 0.0
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fitted: FittedParameters | None = None
    opposite_fitted: FittedParameters | None = None
    when: When = ALWAYS
    begin_bounds_s: tuple[float, float] | None = None

    def at(self, when: When) -> Hypothesis:
        """Return the hypothesis restricted to these spans. Each number that was chosen for them makes it rarer."""
        if not when.spans:
            return self
        spans = spans_of(when.triples)
        effects, opposite = (
            tuple(replace(effect, spans=spans) for effect in side) for side in (self.effects, self.opposite)
        )
        rarity = self.rarity + NATS_PER_NUMBER * (when.numbers - self.when.numbers)
        return replace(self, effects=effects, opposite=opposite, rarity=rarity, when=when)

    def narrowed(self, moments_s: Sequence[float], at: int) -> Hypothesis:
        """Return the hypothesis whose last span that is not a whole log, or without spans whose first effect, begins at
        `moments_s[at]`, with the moments before and after it as the bounds of the beginning. `moments_s` ascend.
        """
        spans, begin_s = list(self.when.spans), moments_s[at]
        bounds_s = moments_s[max(at - 1, 0)], moments_s[min(at + 1, len(moments_s) - 1)]
        if not spans:
            first, *others = self.effects
            onset: dict[str, Any] = {"onset_s": begin_s}
            return replace(self, effects=(replace(first, **onset), *others), begin_bounds_s=bounds_s)
        last = max(place for place, span in enumerate(spans) if not span.is_whole)
        spans[last] = spans[last]._replace(moment_s=begin_s)
        return replace(self.at(When(tuple(spans), self.when.chosen)), begin_bounds_s=bounds_s)

    @property
    def name(self) -> str:
        """The name of the effect that the hypothesis adds or removes."""
        return self.effects[0].name if self.effects else self.removed

    @property
    def is_brief(self) -> bool:
        """True if an effect begins within a log or lies between two logs."""
        onsets = [getattr(effect, "onset_s", 0.0) for effect in self.effects]
        return any(isfinite(onset) and onset > 0 for onset in onsets)

    @property
    def needs_both(self) -> bool:
        """True if the effect shows only in both parts together: it is `whole`, or it is brief."""
        return self.whole or self.is_brief

    @property
    def form(self) -> tuple[str, ...]:
        """The action, the effects and their active parameters. A line that drifts and a line that stays have different
        forms, and so do two different ranges. The time of the effect is not part of the form.
        """
        parameters = [
            f"{effect.name}.{item.name}" + (f"={getattr(effect, item.name)}" if item.name in _CHOICES else "")
            for effect in (*self.effects, *self.opposite)
            for item in fields(effect)
            if item.name != "spans" and repr(getattr(effect, item.name)) != repr(getattr(type(effect)(), item.name))
        ]
        return (self.name, self.action, *parameters)

    @property
    def action(self) -> Action:
        """The change to the model: add, remove or replace."""
        if not self.effects:
            return "remove"
        return "replace" if self.removed else "add"


@dataclass(frozen=True)
class Candidate:
    """An effect of `imuarray.simulate.effects`, and how it is recognised.

    `suggestions` yields hypotheses that add the effect, from the evidence of one sensor; at most a handful.
    `shown_by`: what to record so that the effect shows, by kind of experiment; the effect cannot show in the other
    kinds. `about`: how the effect is recognised. Only sensors of this `quantity` and of this `chip` can have it ("":
    all).

    `needs`: alternatives, the usual one first. If a recording contains none of them, the effect is not observable: in
    one attitude it looks like a bias (a clipped axis looks like a quiet axis with a bias), and so does an effect that
    does not change with temperature or from run to run.

    `existing` determines how an effect of the same kind that the model already has is treated: it is replaced, because
    two effects of one kind cannot be distinguished; or it is joined or replaced, because a sensor may have several; or
    it is ignored, because `suggestions` takes care of it.
    """

    effect: str
    suggestions: Callable[[Evidence], Iterable[Hypothesis]]
    shown_by: Mapping[Kind, str] = field(default_factory=dict)
    about: str = ""
    quantity: str = ""
    chip: str = ""
    needs: tuple[Need, ...] = ()
    existing: Literal["replaced", "joined or replaced", "ignored"] = "replaced"

    def can_concern(self, header: SensorHeader) -> bool:
        """Return whether a sensor like this can have the effect."""
        return self.quantity in ("", header.quantity) and self.chip in ("", header.chip)

    def guesses(self, evidence: Evidence) -> Iterator[Hypothesis]:
        """Yield the hypotheses to try: the removal of the effect, if the model has one that is neither ordinary nor
        fitted, and the hypotheses that add one.
        """
        suggestions = self.suggestions(evidence) if self.can_concern(evidence.header) else ()
        if self.existing == "ignored":
            yield from suggestions
        else:
            yield from with_removal(evidence, self.effect, suggestions, several=self.existing != "replaced")


ORDINARY = frozenset({"white_noise", "bias", "misalignment", "own_clock"}) | PRINTED
"""Effects that every sensor has: fitted, or drawn from a population."""


def with_removal(
    evidence: Evidence, name: str, guesses: Iterable[Hypothesis], *, several: bool = False
) -> Iterator[Hypothesis]:
    """Yield the removal of the effects of this kind, and the `guesses` that add one. If the model already has one, each
    guess replaces it, because two of a kind cannot be distinguished; if a sensor may have `several`, the guess is also
    added. Within spans, a guess is always added to the effects that last all the time.
    """
    if _has(evidence, name) and name not in {effect.name for effect in evidence.fitted.effects()}:
        yield Hypothesis((), removed=name)
    has = _has(evidence, name) and not evidence.when.spans
    for guess in guesses:
        if has:
            yield replace(guess, removed=name)
        if not has or several:
            yield guess


def _has(evidence: Evidence, name: str) -> bool:
    header = evidence.header
    return name not in ORDINARY and any(
        effect.name == name and not (is_usual(effect, header) or is_near_noted_position(effect, header))
        for effect in evidence.effects
    )

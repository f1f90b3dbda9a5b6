"""Removal of an effect that the model has and the sensor has not, or its replacement by one of its kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.model.populations import PRINTED, is_near_noted_position, is_usual

ORDINARY = frozenset({"white_noise", "bias", "misalignment", "own_clock"}) | PRINTED
"""What every sensor has: fitted, or drawn from a population."""


def removals(evidence: Evidence, name: str) -> Iterator[Hypothesis]:
    """Suggest the trial without effects of this kind, if the model has any that isn't ordinary, nor fitted."""
    if _has(evidence, name) and not _is_fitted(evidence, name):
        yield Hypothesis((), removed=name)


def with_removal(
    evidence: Evidence, name: str, guesses: Iterable[Hypothesis], *, several: bool = False
) -> Iterator[Hypothesis]:
    """Suggest the trial without effects of this kind, and the `guesses` that add one. Where the model has one already
    each of these takes its place, since two of a kind can't be told apart; unless a sensor may have `several`: then it
    is both added and put in its place. What holds for a while is added to what the model always has.
    """
    yield from removals(evidence, name)
    has = _has(evidence, name) and not evidence.when.spans
    for guess in guesses:
        if has:
            yield replace(guess, removed=name)
        if not has or several:
            yield guess


def _is_fitted(evidence: Evidence, name: str) -> bool:
    """Return whether the chip's own filter is all that the model has of the kind."""
    return name in {effect.name for effect in evidence.fitted.effects()}


def _has(evidence: Evidence, name: str) -> bool:
    header = evidence.header
    return name not in ORDINARY and any(
        effect.name == name and not (is_usual(effect, header) or is_near_noted_position(effect, header))
        for effect in evidence.effects
    )

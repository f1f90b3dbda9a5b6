"""Sensors of one chip that differ together: one cause that all share, against a cause for each of them.

What sensors have in common shows only between them, so that a family is simulated as a whole and its statistics hold
the correlations of its members. The shared cause wins if it makes the held-out part of all of these likelier than the
causes that were found for the members one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.forward_selection import ACCEPTED, Evaluation, Round, confirmed
from imuarray.gap.inference.refinement import FittedHypothesis
from imuarray.gap.inference.unit_state import Unit, UnitState
from imuarray.gap.model.bench import Bench

_MOST = 0.5


def together(bench: Bench, asked: tuple[UnitState, tuple[Evaluation, ...]]) -> Evaluation:
    """What the causes of single members make of the family as a whole."""
    family, members = asked
    models = dict(family.models)
    for one in members:
        models.update({name: model for name, model in one.standing.models.items() if name in models})
    first = members[0].trial if members else Hypothesis(())
    return confirmed(bench, family, FittedHypothesis(first, models, 0.0))


def shared_wins(family: Round, members: Evaluation, count: int = 1) -> Evaluation | None:
    """The shared cause, if it is worth it and beats the `count` causes of the members, each of which has to be worth it
    too, by more than it is rarer. That there is a cause the held-out part has told already; whether it is one or
    several both parts tell, to which as many numbers were fitted either way.
    """
    best = family.taken
    if best is None:
        return None
    more = 2 * ACCEPTED * max(count - 1, 0) - best.trial.rarity
    return best if _on_both(best) + more > _on_both(members) else None


def _on_both(one: Evaluation) -> float:
    """Nats gained on both parts."""
    return 2 * one.gain if one.trial.needs_both else one.train_gain + one.gain


def staying_beside(family: Round, members: Sequence[Evaluation]) -> tuple[Evaluation, ...]:
    """Causes of members that are something else than the shared one, and gain more than their part of what it does."""
    best = family.taken
    if best is None:
        return ()
    part = best.gain / len(best.standing.unit)
    return tuple(one for one in members if one.gain > part and one.trial.name != best.trial.name)


def is_told_twice(bench: Bench, family: Round, member: Evaluation) -> bool:
    """Whether most of what a member's own cause explains is what the shared one explains: of two sensors that wander
    alike, the one that shows it better gains nearly as much by a wander of its own. What the member lacks beside the
    shared cause is looked for in the next round.
    """
    if family.taken is None:
        return False
    own, real = bench.among(member.standing.unit, family.taken.standing.unit), member.standing.real
    before, shared = (one.likelihood.of(own).log_density(real) for one in (family.before, family.taken.standing))
    gains = np.maximum(member.standing.likelihood.log_density(real) - before, 0.0)
    return bool(np.minimum(gains, np.maximum(shared - before, 0.0)).sum() > _MOST * gains.sum())


def members_of(bench: Bench, family: UnitState, standings: Mapping[Unit, UnitState]) -> dict[Unit, UnitState]:
    """Where each member of a family stands with the family's models."""
    found: dict[Unit, UnitState] = {}
    for name in family.unit:
        unit: Unit = (name,)
        own = bench.among(unit, family.unit)
        found[unit] = replace(
            standings[unit],
            models={name: family.models[name]},
            likelihood=family.likelihood.of(own),
            values=family.values[:, own],
        )
    return found


def unlike(trials: Sequence[Hypothesis]) -> list[Hypothesis]:
    """One of each: members guess the same shared cause more than once, and an exchange from either side."""
    return list({min(repr(trial), repr(_mirrored(trial))): trial for trial in trials}.values())


def _mirrored(trial: Hypothesis) -> Hypothesis:
    """As the other one of two in each other's place guesses it."""
    if not trial.opposite or len(trial.others) != 1:
        return trial
    (other,) = trial.others
    return replace(trial, effects=trial.opposite, sensor=other, others=(trial.sensor,), opposite=trial.effects)

"""Shared causes: one cause that several sensors of a chip share, against one cause for each of them.

Common errors show only between sensors, so a family is simulated as a whole and its statistics hold the correlations of
its members. The shared cause wins if it makes the held-out part of all members likelier than their single causes do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.forward_selection import ACCEPTED, Evaluation, Round, confirm
from imuarray.gap.inference.refinement import FittedHypothesis
from imuarray.gap.inference.unit_state import Unit, UnitState
from imuarray.gap.model.bench import Bench

_MOST = 0.5
"""Share of a member's gain that a shared cause explains if the member's own cause is redundant."""

_EXACT = 0.05
"""Share of the gain of several fitted causes by which a shared one without any fitted number may be worse."""


def together(bench: Bench, request: tuple[UnitState, tuple[Evaluation, ...]]) -> Evaluation:
    """Return the evaluation of the family as a whole with the causes of single members."""
    family, members = request
    models = dict(family.models)
    for member in members:
        models.update({name: model for name, model in member.standing.models.items() if name in models})
    first = members[0].trial if members else Hypothesis(())
    return confirm(bench, family, FittedHypothesis(first, models, 0.0))


def shared_wins(family: Round, members: Evaluation, count: int = 1) -> Evaluation | None:
    """Return the shared cause, if it is accepted and beats the `count` causes of the members, each of which has to be
    worth it too, by more than its rarity.

    The held-out part has shown that there is a cause; whether it is one or several is decided on both parts, to which
    equally many numbers were fitted. A shared cause without any, such as an exchange of two sensors, need not explain
    quite as much as causes that are fitted to each: chance would not make it explain nearly as much.
    """
    best = family.selection
    if best is None:
        return None
    more = 2 * ACCEPTED * max(count - 1, 0) - best.trial.rarity
    if count > 1 and not best.factors:
        more += _EXACT * max(members.gain_of_both, 0.0)
    return best if best.gain_of_both + more > members.gain_of_both else None


def separate_causes(family: Round, members: Sequence[Evaluation]) -> tuple[Evaluation, ...]:
    """Return causes of members other than the shared one that gain more than their part of the shared one's gain."""
    best = family.selection
    if best is None:
        return ()
    part = best.gain / len(best.standing.unit)
    return tuple(member for member in members if member.gain > part and member.trial.name != best.trial.name)


def is_redundant(bench: Bench, family: Round, member: Evaluation) -> bool:
    """Return whether the shared cause explains most of what a member's own cause explains.

    Of two sensors with a common wander, the one that shows it better gains nearly as much by a wander of its own. What
    the member lacks beyond the shared cause is searched in the next round.
    """
    if family.selection is None:
        return False
    columns, real = bench.among(member.standing.unit, family.selection.standing.unit), member.standing.real
    before, shared = (
        state.likelihood.of(columns).log_density(real) for state in (family.before, family.selection.standing)
    )
    gains = np.maximum(member.standing.likelihood.log_density(real) - before, 0.0)
    return bool(np.minimum(gains, np.maximum(shared - before, 0.0)).sum() > _MOST * gains.sum())


def members_of(bench: Bench, family: UnitState, standings: Mapping[Unit, UnitState]) -> dict[Unit, UnitState]:
    """Return the state of each member of a family with the family's models."""
    states: dict[Unit, UnitState] = {}
    for name in family.unit:
        unit: Unit = (name,)
        columns = bench.among(unit, family.unit)
        states[unit] = replace(
            standings[unit],
            models={name: family.models[name]},
            likelihood=family.likelihood.of(columns),
            values=family.values[:, columns],
        )
    return states


def without_duplicates(trials: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the trials, each once: members guess the same shared cause several times, and an
    exchange from both sides.
    """
    return list({min(repr(trial), repr(_mirror(trial))): trial for trial in trials}.values())


def _mirror(trial: Hypothesis) -> Hypothesis:
    """Return the trial as the other sensor of an exchange guesses it."""
    if not trial.opposite or len(trial.others) != 1:
        return trial
    (other,) = trial.others
    return replace(
        trial,
        effects=trial.opposite,
        sensor=other,
        others=(trial.sensor,),
        opposite=trial.effects,
        fitted=trial.opposite_fitted,
        opposite_fitted=trial.fitted,
    )

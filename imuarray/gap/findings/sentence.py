"""The diagnosis in the sentences that a person would say."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from inspect import cleandoc

from imuarray.gap.findings.diagnosis import Cause, Gap, Pull, Verdict, Where, is_told_by_both
from imuarray.gap.findings.text import closed_text, parameters_text, places_text, specification_text
from imuarray.gap.model.use import Use
from imuarray.simulate.effects import EFFECTS


def sentence_of(
    verdict: Verdict,
    gap: Gap,
    causes: Sequence[Cause],
    where: Sequence[Where],
    unexplained: Sequence[Where],
    uses: Sequence[Use],
    pulls: Sequence[Pull] = (),
) -> str:
    """What was found, why, how far it is closed, and which parts are out of specification."""
    outside = [f"{specification_text(pull)}." for pull in pulls if pull.is_out_of_specification]
    if verdict == "no gap":
        alike = "The recordings look like what the simulator makes of them: no statistic is beyond chance."
        return " ".join([alike, *outside])
    worst = where[0]
    place = f"{worst.sensor}{' ' + worst.axis if worst.axis else ''}"
    parts = [f"The recordings differ from the simulator, most in {worst.domain.replace('_', ' ')} of {place}."]
    likely = [cause for cause in causes if cause.probability >= 0.5] or list(causes[:1])
    parts += [f"{_named(cause)}." for cause in likely[:_MOST]]
    if gap.closed is not None and likely:
        closed = closed_text(gap.closed, gap.closed_ci95)
        data = "the data that told of it" if is_told_by_both(causes) else "held-out data"
        parts.append(f"With {'it' if len(likely) == 1 else 'them'} {closed} of the gap is closed on {data}.")
    parts += list(_in_use(uses, causes))
    if verdict in ("unexplained", "partly explained") and unexplained:
        left = unexplained[0]
        parts.append(
            f"Not explained: {left.about}, {left.sensor}{' ' + left.axis if left.axis else ''}"
            f"{' in ' + left.phase if left.phase else ''}."
        )
    return " ".join([*parts, *outside])


def meaning(effect: str) -> str:
    """An effect in words, as its module begins; "" for a name that isn't in the library."""
    if effect not in EFFECTS:
        return ""
    first = cleandoc(sys.modules[EFFECTS[effect].__module__].__doc__ or "").partition("\n")[0]
    return first.partition(": ")[2].rstrip(".")


_MOST = 4


def _named(cause: Cause) -> str:
    what = {"add": "", "remove": "without ", "replace": "another "}[cause.action] + cause.effect
    words = f" ({meaning(cause.effect)}: {parameters_text(cause.parameters)})" if cause.parameters else ""
    confusable = f"; it could as well be {' or '.join(cause.confusable_with)}" if cause.confusable_with else ""
    return f"{places_text(cause)}: {what}{words}, probability {cause.probability:.2f}{confusable}"


def _in_use(uses: Sequence[Use], causes: Sequence[Cause]) -> list[str]:
    """The figure of use of a sensor concerned whose prediction changed most."""
    concerned = {name for cause in causes for name in cause.sensors}
    known = [use for use in uses if use.sensor in concerned and use.before.value > 0 and use.real.value > 0]
    if not known:
        return []
    most = max(known, key=lambda use: abs(use.real.value - use.before.value) / use.real.value)
    return [
        f"{most.sensor}, {most.name}: recorded {most.real.value:.3g} {most.unit}, simulated {most.before.value:.3g}"
        f" before and {most.after.value:.3g} after."
    ]

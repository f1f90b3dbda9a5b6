"""The diagnosis in one paragraph of plain sentences."""

from __future__ import annotations

from collections.abc import Sequence

from imuarray.gap.findings.diagnosis import Cause, Pull, Where, needs_both_parts
from imuarray.gap.findings.text import closed_text, parameters_text, places_text, specification_text
from imuarray.gap.findings.verdict import EVEN, Judgement
from imuarray.gap.model.use import Use
from imuarray.simulate.effects import meaning

_EFFECT_OF = {
    "scale factor error": "scale",
    "misalignment": "misalignment",
    "g-sensitivity": "g_sensitivity",
    "bias": "bias",
    "thermal slope of the bias": "thermal_bias",
    "cutoff of the filter": "bandwidth",
    "rate of the data clock": "own_clock",
}
"""The effects that say the same of a part as the pull of a quantity does."""


def sentence_of(
    judgement: Judgement,
    where: Sequence[Where],
    unexplained: Sequence[Where],
    uses: Sequence[Use],
    pulls: Sequence[Pull] = (),
    against: Sequence[str] = (),
) -> str:
    """Return a paragraph that states what differs, why, how much of it is closed, and which parts are out of
    specification; `against` names the earlier recordings of a comparison.
    """
    verdict, gap, causes, _ = judgement
    outside = [f"{_out_of_specification(pull, causes)}." for pull in pulls if pull.is_out_of_specification]
    other = ", ".join(against) or "the simulator"
    if verdict == "no gap":
        agreement = f"The recordings agree with {other}: nothing has changed beyond chance." if against else _AGREEMENT
        return " ".join([agreement, *outside])
    worst = where[0]
    parts = [f"The recordings differ from {other}, most in {worst.domain.replace('_', ' ')} of {_place(worst)}."]
    likely = [cause for cause in causes if cause.probability >= EVEN] or list(causes[:1])
    cause_sentences = [f"{_named(cause)}." for cause in likely[:_MOST_CAUSES]]
    if verdict == "unexplained":
        parts.append(_unexplained(unexplained or where))
        parts += (
            ["No known effect makes these recordings likely; the nearest is", *cause_sentences[:1]]
            if cause_sentences
            else []
        )
    else:
        parts += cause_sentences
    if gap.closed is not None and any(cause.is_accepted for cause in likely):
        closed = closed_text(gap.closed, gap.closed_ci95)
        data = "the data that showed it" if needs_both_parts(causes) else "held-out data"
        parts.append(f"With {'it' if len(likely) == 1 else 'them'} {closed} of the gap is closed on {data}.")
    parts += list(_in_use(uses, causes))
    if verdict == "partly explained" and unexplained:
        remaining = unexplained[0]
        parts.append(
            f"Not explained: {remaining.about}, {_place(remaining)}"
            f"{f' in {remaining.phase}' if remaining.phase else ''}."
        )
    return " ".join([*parts, *outside])


def _out_of_specification(pull: Pull, causes: Sequence[Cause]) -> str:
    """State that a part is out of specification, and which causes of its sensor may have misled the
    fit that says so.
    """
    others = [
        cause.effect
        for cause in causes
        if pull.sensor in cause.sensors and _EFFECT_OF.get(pull.quantity) != cause.effect and cause.probability >= EVEN
    ]
    doubt = f" (fitted without {' and '.join(dict.fromkeys(others))}, which may explain it)" if others else ""
    return f"{specification_text(pull)}{doubt}"


def _unexplained(where: Sequence[Where]) -> str:
    """Describe a gap outside the library: the domain and axes, how far off, in which log and phase."""
    places: dict[tuple[str, str, str], Where] = {}
    for entry in where:  # worst first
        places.setdefault((entry.sensor, entry.axis, entry.domain), entry)
    looks = [
        f"{entry.domain.replace('_', ' ')} of {_place(entry)} ({entry.about}: {entry.significance:+.0f} standard "
        f"deviations in {' of '.join(filter(None, (entry.phase, entry.log)))})"
        for entry in list(places.values())[:_MOST_PLACES]
    ]
    return f"Unexplained: something outside the library. It shows in {'; '.join(looks)}."


def _place(where: Where) -> str:
    return f"{where.sensor} {where.axis}".rstrip()


_AGREEMENT = "The recordings agree with the simulator: no statistic is beyond chance."
_MOST_CAUSES = 4
_MOST_PLACES = 3


def _named(cause: Cause) -> str:
    what = {"add": "", "remove": "without ", "replace": "another "}[cause.action] + cause.effect
    words = f" ({meaning(cause.effect)}: {parameters_text(cause.parameters)})" if cause.parameters else ""
    confusable = (
        f"; {' or '.join(cause.confusable_with)} would explain it equally well" if cause.confusable_with else ""
    )
    return f"{places_text(cause)}: {what}{words}, probability {cause.probability:.2f}{confusable}"


def _in_use(uses: Sequence[Use], causes: Sequence[Cause]) -> list[str]:
    """Return the figure of use of a sensor concerned whose prediction changed most."""
    concerned = {name for cause in causes for name in cause.sensors}
    known = [use for use in uses if use.sensor in concerned and use.before.value > 0 and use.real.value > 0]
    if not known:
        return []
    most = max(known, key=lambda use: abs(use.real.value - use.before.value) / use.real.value)
    return [
        f"{most.sensor}, {most.name}: recorded {most.real.value:.3g} {most.unit}, simulated {most.before.value:.3g}"
        f" before and {most.after.value:.3g} after."
    ]

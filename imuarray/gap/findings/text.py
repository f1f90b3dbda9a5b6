"""A diagnosis as text for the terminal."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from textwrap import wrap

from imuarray.gap.findings.diagnosis import DIFFERENCES, Cause, Diagnosis, Where, needs_both_parts
from imuarray.gap.findings.formatting import (
    NOT_ACCEPTED,
    chance_text,
    closed_text,
    difference_text,
    domain_text,
    effect_text,
    explained_pulls_text,
    gap_text,
    listed_causes,
    names_text,
    own_closure,
    parameters_text,
    places_text,
    share,
    specification_text,
    unexplained_pulls,
    use_text,
)
from imuarray.printable import counted, series
from imuarray.simulate.effects import meaning

WIDTH = 120
"""Most columns."""

_LEAST_WIDTH = 40
_WORST, _WORST_AFTER = 6, 3
"""Statistics that are shown of those that differ before and after the causes are added."""

_MOST_SENSORS = 4
"""Most sensors of a cause of which the parameters are shown, where they differ."""

_MOST_NOTES = 12
"""Most notes that are shown: each of many logs has its own."""

IN_FILES = "gap.json and report.html (-o DIR)"


def text_of(diagnosis: Diagnosis, width: int = WIDTH) -> str:
    """Format a diagnosis for a terminal of so many columns: the verdict; where it differs; the causes; how far they
    close the gap; parts out of specification; notes; what could not be shown or compared; what to record next.
    """
    width = min(max(width, _LEAST_WIDTH), WIDTH)
    parts = (_verdict, _where, _causes, _check, _pulls, _notes, _unshown, _too_short, _missing, _next)
    texts = ["\n".join(_wrapped(part(diagnosis), width)) for part in parts]
    return "\n\n".join(filter(None, texts)) + "\n"


Line = tuple[str, str]
"""The beginning of a line, and its text: where it is broken, it goes on below the text."""


def _verdict(diagnosis: Diagnosis) -> Iterator[Line]:
    reason = f": {diagnosis.reason}" if diagnosis.reason else ""
    yield "Verdict  ", f"{diagnosis.verdict}{reason}"
    yield "Chance   ", chance_text(diagnosis)
    if diagnosis.unknown > 0:
        yield "Unknown  ", f"{share(diagnosis.unknown)} that something outside the library of effects is present"


def _where(diagnosis: Diagnosis) -> Iterator[Line]:
    if not diagnosis.where:
        return
    worst = _distinct(diagnosis.where)
    more = ", the worst of a sensor and domain" if len(diagnosis.where) > len(worst[:_WORST]) else ""
    yield (
        "",
        f"Where it differs: {counted(len(diagnosis.where), 'statistic')}{more} (sd: standard deviations of chance)",
    )
    for entry in worst[:_WORST]:
        yield "  ", difference_text(entry, len(diagnosis.recorded))


def _distinct(where: Sequence[Where]) -> list[Where]:
    """Return the worst statistic of each sensor and domain, since axes, phases and logs repeat each other."""
    kinds: dict[tuple[str, str], Where] = {}
    for entry in where:
        kinds.setdefault((entry.sensor, entry.domain), entry)
    return list(kinds.values())


def _causes(diagnosis: Diagnosis) -> Iterator[Line]:
    causes = listed_causes(diagnosis.causes)
    if causes:
        yield "", "Causes, most probable first"
    elif diagnosis.causes:
        yield "", "Causes: none has a probability of 5 % or more"
    for cause in causes:
        yield f"  {share(cause.probability):>5}  ", f"{effect_text(cause)} in {places_text(cause)}{_about(cause)}"
        for text in _cause(cause, diagnosis):
            yield " " * 9, text
    if fewer := len(diagnosis.causes) - len(causes):
        yield "  ", f"{fewer} less probable: see gap.json (-o DIR)"


def _about(cause: Cause) -> str:
    about = meaning(cause.effect)
    return f": {about}" if about else ""


def _cause(cause: Cause, diagnosis: Diagnosis) -> Iterator[str]:
    yield from _sizes(cause)
    if cause.alternative_to:
        yield f"instead of {cause.alternative_to}, not besides it"
    elif cause.confusable_with:
        yield f"may also be {' or '.join(cause.confusable_with)}"
    if not cause.is_accepted:
        yield NOT_ACCEPTED
    if cause.origin != "sensor":
        yield f"in the {cause.origin}, not in the sensor"
    if closes := _closing(cause, diagnosis):
        yield closes


def _sizes(cause: Cause) -> Iterator[str]:
    """Yield the parameters of a cause; those of each sensor if they differ."""
    each = {name: parameters_text(parameters) for name, parameters in cause.each.items()}
    if len(set(each.values())) < 2:
        yield from filter(None, [parameters_text(cause.parameters)])
        return
    for name, text in list(each.items())[:_MOST_SENSORS]:
        yield f"{name}: {text}"
    if len(each) > _MOST_SENSORS:
        yield f"{counted(len(each) - _MOST_SENSORS, 'more sensor')}: see gap.json (-o DIR)"


def _closing(cause: Cause, diagnosis: Diagnosis) -> str:
    """State how much a cause would close if it were present; "" if unknown."""
    closed, interval = own_closure(cause, diagnosis)
    if closed is None:
        return ""
    data = "the data that showed it" if cause.needs_both else "held-out data"
    remaining = "what the causes before it leave of " if cause.preceding else ""
    of = f"{remaining}the gap of {names_text(cause.sensors) or 'all sensors'} on {data}"
    return f"if this were the cause, it would close {closed_text(closed, interval)} of {of}"


def _check(diagnosis: Diagnosis) -> Iterator[Line]:
    if diagnosis.verdict == "no gap":
        return
    in_model = [cause for cause in diagnosis.causes if cause.is_in_model]
    both = needs_both_parts(in_model)
    yield "", f"Check on {'the data that showed the gap: no part was held out' if both else 'held-out data'}"
    if in_model:
        effects = [f"{'no ' if cause.action == 'remove' else ''}{cause.effect}" for cause in in_model]
        names = series(list(dict.fromkeys(effects)))
        yield "  ", f"With {names} in the simulator: {gap_text(diagnosis.gap)}"
    else:
        yield "  ", "No cause was accepted, so the simulator is unchanged"
    if use := use_text(diagnosis.uses, diagnosis.causes):
        yield "  ", use
    left = _distinct(diagnosis.unexplained) if in_model else []
    if left:
        form = ", by no more than an inexact form of the causes makes" if diagnosis.verdict == "explained" else ""
        yield "  ", f"Still different{form}: {counted(len(diagnosis.unexplained), 'statistic')}"
    for entry in left[:_WORST_AFTER]:
        yield "    ", difference_text(entry, len(diagnosis.recorded))


def _pulls(diagnosis: Diagnosis) -> Iterator[Line]:
    """Yield the parts that are out of specification, worst first."""
    outside = unexplained_pulls(diagnosis.pulls)
    if outside:
        yield "", "Parts out of specification, worst first"
    for pull in outside:
        yield "  ", specification_text(pull)
    if explained := explained_pulls_text(diagnosis.pulls):
        yield "", explained


def _notes(diagnosis: Diagnosis) -> Iterator[Line]:
    notes = _by_log(diagnosis.notes, [recording.name for recording in diagnosis.recorded])
    if notes:
        yield "", "Notes"
    for note in notes[:_MOST_NOTES]:
        yield "  ", note
    if len(notes) > _MOST_NOTES:
        yield "  ", f"{len(notes) - _MOST_NOTES} more in {IN_FILES}"


def _by_log(notes: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the notes, with one that several logs share only once."""
    logs: dict[str, list[str]] = {}
    for note in notes:
        name, _, text = note.partition(": ")
        logs.setdefault(text if name in names else note, []).extend([name] if name in names else [])
    return [f"{_logs(of, names)}: {text}" if of else text for text, of in logs.items()]


def _logs(some: Sequence[str], names: Sequence[str]) -> str:
    return "all logs" if len(names) > 1 and set(some) == set(names) else names_text(some)


def _unshown(diagnosis: Diagnosis) -> Iterator[Line]:
    """Yield the effects that the recordings cannot show, by the experiment that would show them."""
    shown_by: dict[tuple[str, str], list[str]] = {}
    for item in diagnosis.unshown:
        if not item.effect.startswith(DIFFERENCES):
            kind, colon, record = item.record.partition(": ")
            kind, record = (kind, record) if colon else ("record", item.record)
            place = kind, names_text(item.sensors) or "all sensors"
            shown_by.setdefault(place, []).append(f"{item.effect} ({record})")
    if shown_by:
        yield "", "Not observable in these recordings, and what to record"
    kinds = [kind for kind, _ in shown_by]
    for (kind, sensors), effects in sorted(shown_by.items(), key=lambda item: kinds.index(item[0][0])):
        yield "  ", f"{kind}, {sensors}: {'; '.join(effects)}"


def _too_short(diagnosis: Diagnosis) -> Iterator[Line]:
    """Yield for how long to record to exclude differences that matter, by sensors."""
    lengths: dict[str, list[str]] = {}
    for item in diagnosis.unshown:
        if item.effect.startswith(DIFFERENCES):
            domain = domain_text(item.effect.removeprefix(DIFFERENCES).replace(" ", "_"))
            lengths.setdefault(names_text(item.sensors), []).append(f"{domain} ({item.record})")
    if lengths:
        yield "", "Too short to exclude differences that matter, and what to record"
    for sensors, texts in lengths.items():
        yield "  ", f"{sensors}: {'; '.join(texts)}"


def _missing(diagnosis: Diagnosis) -> Iterator[Line]:
    if diagnosis.missing:
        yield "", "Missing, and therefore not compared"
    names = [recording.name for recording in diagnosis.recorded]
    phrases: dict[str, list[str]] = {}
    for phrase in diagnosis.missing:
        start, _, name = phrase.rpartition(" in ")
        phrases.setdefault(start if name in names else phrase, []).extend([name] if name in names else [])
    for phrase, of in phrases.items():
        yield "  ", f"{phrase} in {_logs(of, names)}" if of else phrase


def _next(diagnosis: Diagnosis) -> Iterator[Line]:
    if diagnosis.next_experiment:
        yield "Next experiment: ", diagnosis.next_experiment


def _wrapped(lines: Iterator[Line], width: int) -> Iterator[str]:
    for start, text in lines:
        indent = len(start) if start.endswith("  ") and start.strip() else len(start) - len(start.lstrip()) + 2
        bound = _BOUND.sub(_TIE, start + _printable(text).replace(" degC", " °C"))
        for line in wrap(bound, width, subsequent_indent=" " * indent, break_on_hyphens=False):
            yield line.replace(_TIE, " ")


_TIE = "\x00"
"""Stands for a space at which no line is broken."""

_BOUND = re.compile(
    r"(?<=\d) (?=(?:%|sd|m?g|dps|s|Hz|°C|deg|mm|h|times|minutes?|seconds?|hours?)(?!\w))"
    r"|(?<=\bp) (?=[<=])|(?<=[<=]) (?=\d)"
)


def _printable(text: str) -> str:
    """Return the text without characters that control a terminal."""
    return "".join(sign if sign.isprintable() else " " if sign.isspace() else "?" for sign in text)

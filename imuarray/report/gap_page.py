"""The page of a gap diagnosis: its summary in sentences, where the gap is, its causes, how far they close it, and what
remains unexplained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from os import PathLike

import numpy as np

from imuarray.arrays import Floats
from imuarray.figures import can_draw
from imuarray.gap.findings.diagnosis import (
    EVEN,
    CandidateEvaluation,
    Cause,
    Diagnosis,
    Map,
    Overlay,
    Pull,
    Where,
    needs_both_parts,
)
from imuarray.gap.findings.text import (
    NOT_ACCEPTED,
    NOTHING,
    chance,
    chance_text,
    closed_text,
    effect_text,
    explained_pulls_text,
    gap_text,
    listed_causes,
    number,
    own_closure,
    parameters_text,
    place_text,
    places_text,
    pull_values,
    readable_statistic,
    scored,
    share,
    unexplained_pulls,
)
from imuarray.gap.model.use import IntervalEstimate, Use
from imuarray.printable import counted, duration, series
from imuarray.report.figure_style import SmallFigure
from imuarray.report.gap_figures import (
    can_compare,
    farthest,
    map_figure,
    outside,
    overlay_figure,
    shrink_figure,
    use_figure,
)
from imuarray.report.page import (
    NO_FIGURES,
    Figure,
    Level,
    Section,
    Table,
    Verdict,
    highlight,
    markup,
    write_page,
)
from imuarray.simulate.effects import meaning

Parts = list[Table | Figure]

MOST_ROWS = 40
"""Largest number of rows of a table."""

PLACEBO = "placebo"


def write_gap_page(path: str | PathLike[str], diagnosis: Diagnosis, *, force: bool = False) -> None:
    """Write the page; without matplotlib it has only tables, and a note.

    OutputExistsError if the file exists and not `force`, MissingExtraError without jinja2.
    """
    with_figures = can_draw()
    summary = list(gap_summary(diagnosis))
    sections = gap_sections(diagnosis, with_figures=with_figures)
    title = f"Gap between recording and simulation: {diagnosis.verdict}"
    lines = summary if with_figures else [*summary, NO_FIGURES]
    write_page(path, title, lines, sections, verdict=gap_verdict(diagnosis), force=force)


def gap_sections(diagnosis: Diagnosis, *, with_figures: bool) -> tuple[Section, ...]:
    """Return the sections of the page below its summary."""
    return (
        _map(diagnosis.map, with_figures=with_figures),
        _causes(diagnosis),
        _shrinks(diagnosis, with_figures=with_figures),
        _pulls(diagnosis),
        curves_section(diagnosis.overlays, with_figures=with_figures),
        _where(diagnosis),
        _unexplained_section(diagnosis),
        _unobservable(diagnosis),
        _missing(diagnosis),
        _next(diagnosis),
        _judgement_section(diagnosis),
        _recording_section(diagnosis),
    )


def gap_verdict(diagnosis: Diagnosis) -> Verdict:
    """Return whether the simulator is good enough, and which effects it lacks."""
    gap = diagnosis.gap
    in_model = [cause for cause in diagnosis.causes if cause.is_in_model]
    effects = [effect.replace("_", " ") for effect in dict.fromkeys(cause.effect for cause in in_model)]
    if len(effects) == 1 and (about := meaning(effects[0].replace(" ", "_"))):
        effects = [f"{effects[0]} ({about})"]
    names = _series(effects)
    levels: dict[str, Level] = {"no gap": "good", "unexplained": "bad"}
    sentence = {
        "no gap": "The simulator is good enough for what these recordings show: they agree with it within chance.",
        "explained": f"The simulator is not good enough as it is. {_remainder(diagnosis, names)}",
        "partly explained": f"The simulator is not good enough; {_partly(diagnosis, names)}.",
        "unexplained": "The simulator is not good enough, and no known effect explains the difference.",
    }[diagnosis.verdict]
    figures = [
        (str(len(in_model)), "cause" if len(in_model) == 1 else "causes"),
        (share(diagnosis.unknown), "probability of something unknown"),
    ]
    if gap.closed is not None:
        figures[:0] = [
            (number(gap.before, 2), f"gap in standard deviations; chance alone gives {number(gap.floor, 2)}"),
            (share(gap.closed), "of the gap closed by the causes"),
        ]
    else:
        p = chance(diagnosis.p, diagnosis.replicates).removeprefix("p ").removeprefix("= ")
        figures.insert(0, (p, "probability of such a difference by chance alone"))
    if (worst := _worst_use(diagnosis.uses)) is not None:
        words = f"{worst.sensor or 'array'} {worst.name}: simulated divided by recorded; the largest difference"
        figures.append((f"{number(worst.before.value / worst.real.value, 2)} ×", words))
    return Verdict(sentence, levels.get(diagnosis.verdict, "doubtful"), tuple(figures))


def _partly(diagnosis: Diagnosis, names: str) -> str:
    """State what keeps the causes `names` from explaining the gap."""
    if max((cause.probability for cause in diagnosis.causes), default=0.0) < EVEN:
        nearest = list(dict.fromkeys(cause.effect.replace("_", " ") for cause in listed_causes(diagnosis.causes)))
        maybe = f" (maybe {_series(nearest, 'or')})" if nearest else ""
        return f"which effect it lacks remains open{maybe}"
    return f"with {names} added, {diagnosis.reason or 'a part of the difference remains'}"


def _remainder(diagnosis: Diagnosis, names: str) -> str:
    """State whether the simulator with the effects `names` is good enough, or where a material difference remains."""
    sensors = dict.fromkeys(place.sensor or "the array" for place in diagnosis.unexplained if place.size == "material")
    if not sensors:
        return f"With {names} added it is good enough."
    differ = "differs" if len(sensors) == 1 else "differ"
    return (
        f"With {names} added most of the gap closes, but {_series(list(sensors))} still {differ} by more than matters"
        " to a user."
    )


_NAMED = 3
"""Largest number of effects or sensors that the verdict names."""


def _series(names: Sequence[str], word: str = "and") -> str:
    """Return names in a sentence: "A", "A and B", "A, B and C", "A, B, C and 2 more"."""
    shown = [*names[:_NAMED], *([f"{len(names) - _NAMED} more"] if len(names) > _NAMED else [])]
    return series(shown).replace(" and ", f" {word} ")


def _worst_use(uses: Sequence[Use]) -> Use | None:
    """Return the figure of use whose simulated value differs most from the recorded one; None if none is comparable."""
    return max(
        (use for use in uses if can_compare(use)),
        key=lambda use: abs(np.log(use.before.value / use.real.value)),
        default=None,
    )


def gap_summary(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield the diagnosis in sentences."""
    reason = f": {diagnosis.reason}" if diagnosis.reason else ""
    yield f"{diagnosis.verdict.capitalize()}{reason}. Chance alone: {chance_text(diagnosis)}."
    yield diagnosis.sentence
    if diagnosis.verdict != "no gap":
        yield f"The gap, on held-out data: {gap_text(diagnosis.gap)}."
    if diagnosis.unknown > 0:
        yield f"Something outside the library of effects is present with a probability of {share(diagnosis.unknown)}."


def _map(shown: Map, *, with_figures: bool) -> Section:
    has_scores = [not np.isnan(pair).all() for pair in zip(shown.before.T, shown.after.T, strict=True)]
    domains = [domain for domain, flag in zip(shown.domains, has_scores, strict=True) if flag]
    empty = [domain for domain in shown.domains if domain not in domains]
    if not domains:
        return Section("Where the gap is", "No statistic is available for any sensor in any domain.")
    small = replace(shown, domains=tuple(domains), before=shown.before[:, has_scores], after=shown.after[:, has_scores])
    words = (
        "The largest score of each sensor in each domain, in standard deviations of chance. By chance alone, the "
        f"largest cell of the map exceeds {number(shown.limit, 2)} in one of twenty diagnoses. Amber cells with bold "
        "numbers are above this limit; hatched cells have no statistic."
    )
    if empty:
        words += f" Domains without statistics: {', '.join(empty)}.".replace("_", " ")
    rows = [
        [sensor, *(_pair(*cell, small.limit) for cell in zip(before, after, strict=True))]
        for sensor, before, after in zip(small.sensors, small.before.tolist(), small.after.tolist(), strict=True)
    ]
    caption = f"Before → after; marked if above the limit of {number(small.limit, 2)} after; –: no statistic."
    table = Table(["sensor", *(domain.replace("_", " ") for domain in domains)], rows, caption)
    return Section("Where the gap is", words, [*(_maps(small) if with_figures else []), table])


def _pair(before: float, after: float, limit: float) -> str:
    texts = [scored(before), scored(after)]
    if texts == [NOTHING, NOTHING]:
        return NOTHING
    joined = texts[0] if before == after else " → ".join(texts)
    return highlight(joined) if after > limit else joined


def _maps(shown: Map) -> Iterator[Figure]:
    is_alike = np.array_equal(shown.before, shown.after, equal_nan=True)
    pairs = ((shown.before, "before"), (shown.after, "after"))
    for scores, when in pairs[:1] if is_alike else pairs:
        beyond = int(np.count_nonzero(np.nan_to_num(scores) > shown.limit))
        cells = int(np.count_nonzero(~np.isnan(scores)))
        start = "No cause was added" if is_alike else f"{when.capitalize()} the causes were added"
        caption = f"{start}: {beyond} of {cells} cells are above the limit."
        drawing = map_figure(scores, shown, "" if is_alike else when)
        yield SmallFigure(drawing, caption, f"{caption} {_largest(scores, shown)}")


def _largest(scores: Floats, shown: Map) -> str:
    """Return the text of the five largest cells."""
    cells = [
        (score, f"{sensor} {domain} {scored(score)}")
        for sensor, row in zip(shown.sensors, scores.tolist(), strict=True)
        for domain, score in zip(shown.domains, row, strict=True)
        if score == score
    ]
    return f"Largest: {', '.join(text for _, text in sorted(cells, reverse=True)[:5])}."


def _causes(diagnosis: Diagnosis) -> Section:
    causes = listed_causes(diagnosis.causes)
    fewer = len(diagnosis.causes) - len(causes)
    rest = f" {counted(fewer, 'less probable cause')}: see gap.json." if fewer else ""
    if not causes:
        return Section("Causes", f"No cause {'is probable enough to be listed' if fewer else 'was found'}.{rest}")
    words = (
        "Effects that make the simulation resemble the recordings. Several can be present at once, so each has a "
        "probability of its own. Would close: the share of the gap of these sensors that disappears if this is the "
        "cause, with its 95 % interval, on held-out data (or on all data, if neither part alone shows the effect); it "
        "does not say how probable the cause is. Origin: the sensor, its environment, or the description in the log."
        f"{rest}"
    )
    heading = ["effect", "probability", "where", "parameters", "would close", "may also be", "origin"]
    rows = [_cause_row(cause, diagnosis) for cause in causes]
    parts: Parts = [Table(heading, rows, "Most probable first.", (2, 3, 5, 6))]
    each = [
        [sensor, cause.effect, parameters_text(parameters) or NOTHING]
        for cause in causes
        if _differs(cause)
        for sensor, parameters in cause.each.items()
    ]
    if each:
        caption = "Parameters that differ from sensor to sensor."
        parts.append(Table(["sensor", "effect", "parameters"], each, caption, (1, 2)))
    return Section("Causes", words, parts)


def _cause_row(cause: Cause, diagnosis: Diagnosis) -> list[str]:
    parameters = parameters_text(cause.parameters) or NOTHING
    rivals = f"instead of {cause.alternative_to}" if cause.alternative_to else ", ".join(cause.confusable_with)
    return [
        _explain(effect_text(cause), meaning(cause.effect) or "not in the library"),
        share(cause.probability),
        places_text(cause),
        f"{parameters} ({next(iter(cause.each))}; others below)" if _differs(cause) else parameters,
        closed_text(*own_closure(cause, diagnosis)),
        rivals or NOTHING,
        _origin(cause),
    ]


def _origin(cause: Cause) -> str:
    if not cause.is_accepted:
        return NOT_ACCEPTED
    return f"{cause.origin}, detected on both parts together" if cause.needs_both else cause.origin


def _differs(cause: Cause) -> bool:
    several = list(cause.each.values())
    return any(item != several[0] for item in several)


def _explain(name: str, more: str) -> str:
    """Return an escaped name with its meaning in small type below it; MissingExtraError without jinja2's escaping."""
    return markup('{}<br><small style="font-weight: normal">{}</small>', name, more)


def _pulls(diagnosis: Diagnosis) -> Section:
    title, pulls = "Parts and their specification", diagnosis.pulls
    if not pulls:
        return Section(title, "No quantity was compared with a tolerance of a data sheet.")
    outside, explained = len(unexplained_pulls(pulls)), explained_pulls_text(pulls)
    words = (
        "Quantities that differ from part to part within a data sheet's tolerance, fitted to the recordings without "
        f"the causes. None of them is a cause by itself. {outside} of {len(pulls)} are out of specification."
    )
    words += f" {explained}." if explained else ""
    if len(pulls) > MOST_ROWS:
        words += f" The worst {MOST_ROWS} are shown."
    return Section(title, words, [pulls_table(pulls)])


def pulls_table(pulls: Sequence[Pull]) -> Table:
    """Return the `MOST_ROWS` quantities with the largest pulls, those without a tolerance last. A pull out of tolerance
    is marked if no cause explains it.
    """
    rows = []
    for pull in sorted(pulls, key=lambda pull: -abs(np.nan_to_num(pull.pull)))[:MOST_ROWS]:
        name, causes = f"{pull.sensor} {pull.axis}".rstrip(), ", ".join(pull.explained_by) or NOTHING
        rows.append([name, pull.quantity, *pull_values(pull), _pull(pull), pull.source, causes])
    heading = ["sensor", "quantity", "value", "tolerance", "pull", "source", "may come from"]
    caption = (
        "Worst first. The pull is the deviation from the nominal value in units of the tolerance; marked above one, "
        "unless a cause may explain it."
    )
    return Table(heading, rows, caption, (1, 5, 6))


def _pull(pull: Pull) -> str:
    if not np.isfinite(pull.pull):
        return number(pull.pull)
    text = f"{'-' if pull.pull < 0 else '+'}{number(abs(pull.pull))}"
    return highlight(text) if pull.is_out_of_specification and not pull.explained_by else text


def _shrinks(diagnosis: Diagnosis, *, with_figures: bool) -> Section:
    gap, uses = diagnosis.gap, diagnosis.uses
    words = "There is no gap to close."
    if diagnosis.verdict != "no gap":
        words = "Held-out data show too little of the gap to measure how much of it closes."
    if gap.closed is not None:
        data = (
            "the data that showed the gap"
            if needs_both_parts([cause for cause in diagnosis.causes if cause.is_in_model])
            else "held-out data, to which nothing was fitted"
        )
        words = (
            f"Scores of the statistics that differ, on {data}. Closed: the share of the squared excess over the "
            "floor that disappears, with its 95 % interval."
        )
    if uses:
        words += " The figures in physical units show what the difference means in practice."
    figures: Parts = []
    if with_figures and gap.closed is not None and np.isfinite([gap.before, gap.after, gap.floor]).all():
        caption = "Scores before and after the causes were added. At the dashed floor there is no gap."
        figures.append(SmallFigure(shrink_figure(gap), caption, f"Bars by domain. Overall: {gap_text(gap)}."))
    figures += _use_figures(uses) if with_figures else []
    tables = []
    if gap.closed is not None:
        rows = [["all", scored(gap.before), scored(gap.after), closed_text(gap.closed, gap.closed_ci95)]]
        for domain, (before, after, closed) in gap.domains.items():
            rows.append([domain.replace("_", " "), scored(before), scored(after), share(closed)])
        caption = f"Rms score; {number(gap.floor)} without a gap."
        tables.append(Table(["domain", "before", "after", "closed"], rows, caption))
    tables += [_uses_table(uses)] if uses else []
    return Section("How much of the gap closes", words, [*figures, *tables])


def _uses_table(uses: Sequence[Use]) -> Table:
    """Return the figures in units of use with their intervals; a simulated one is marked if its interval does not
    overlap that of the recording.
    """
    rows = []
    for use in uses:
        simulated = [_against(estimate, use.real) for estimate in (use.before, use.after)]
        rows.append([f"{use.name} ({use.unit})", use.sensor or "array", _interval(use.real), *simulated])
    heading = ["figure", "of", "recorded", "simulated before", "simulated after"]
    caption = "With 95 % intervals; marked where the interval does not overlap that of the recording."
    return Table(heading, rows, caption, (1,))


def _interval(figure: IntervalEstimate) -> str:
    return f"{number(figure.value)} ({number(figure.low)} to {number(figure.high)})"


def _against(simulated: IntervalEstimate, real: IntervalEstimate) -> str:
    text = _interval(simulated)
    return highlight(text) if simulated.low > real.high or simulated.high < real.low else text


def _use_figures(uses: Sequence[Use]) -> Iterator[Figure]:
    comparable = [use for use in uses if can_compare(use)]
    if not comparable:
        return
    caption = "Simulated figures divided by recorded ones, with 95 % intervals; grey: the interval of the recording."
    named = []
    for use in comparable:
        before, after = (number(estimate.value / use.real.value, 2) for estimate in (use.before, use.after))
        named.append(f"{use.sensor or 'array'} {use.name}: {before} times before, {after} times after")
    yield SmallFigure(use_figure(comparable), caption, f"{caption} {'; '.join(named)}.")


def _where(diagnosis: Diagnosis) -> Section:
    where = diagnosis.where
    if not where:
        return Section("Where it differs", "No statistic differs significantly.")
    counts = [f"{sum(place.size == size for place in where)} {size}" for size in ("material", "harmless", "can't tell")]
    words = (
        f"{len(where)} statistics differ significantly: {', '.join(counts)}. The score is in standard "
        "deviations of chance. The size is the difference divided by the smallest one that matters to a user of the "
        "sensor: material from 1, harmless below 1, can't tell if there is too little data."
    )
    return Section("Where it differs", words, [_where_table(where, diagnosis.replicates)])


def _where_table(where: Sequence[Where], replicates: int) -> Table:
    """Return the first `MOST_ROWS` statistics, in their order, the worst first."""
    heading = ["sensor", "domain", "statistic", "recorded in", "real", "simulated", "score", "p", "size"]
    rows = []
    for place in where[:MOST_ROWS]:
        statistic, real, simulated = readable_statistic(place)
        recorded_in = ", ".join(part for part in (place.log, place.phase) if part) or "all"
        score = f"{'-' if place.significance < 0 else '+'}{scored(abs(place.significance))}"
        p = chance(place.p, replicates).removeprefix("p ").removeprefix("= ")
        size = f"{number(place.effect_size, 2)}, {place.size}"
        name, domain = place_text(place), place.domain.replace("_", " ")
        rows.append([name, domain, statistic, recorded_in, real, simulated, score, p, size])
    rest = where[MOST_ROWS:]
    material = sum(place.size == "material" for place in rest)
    more = f" {len(rest)} more are not shown, {material} of them material." if rest else ""
    return Table(heading, rows, f"Worst first.{more}", (1, 2, 3))


def _unexplained_section(diagnosis: Diagnosis) -> Section:
    unexplained = diagnosis.unexplained
    words = "Nothing: no statistic still differs after the causes were added."
    if unexplained:
        words = "What still differs after the causes were added."
    if diagnosis.verdict == "no gap":
        words = "Nothing."
    words += f" Something outside the library of effects is present with a probability of {share(diagnosis.unknown)}."
    tables = [_where_table(unexplained, diagnosis.replicates)] if unexplained else []
    return Section("What is unexplained", words, tables)


def _unobservable(diagnosis: Diagnosis) -> Section:
    title = "What the recordings cannot show"
    if not diagnosis.unshown:
        return Section(title, "These recordings can show all effects of the library.")
    words = "The recordings cannot show whether these effects are present. The last column says what to record."
    rows = [[hidden.effect, ", ".join(hidden.sensors) or "all", hidden.record] for hidden in diagnosis.unshown]
    caption = "Effects that these recordings cannot show."
    return Section(title, words, [Table(["effect", "sensors", "record"], rows, caption, (1, 2))])


def _missing(diagnosis: Diagnosis) -> Section:
    title = "What is missing"
    if not diagnosis.missing:
        return Section(title, "Nothing: recordings and simulator provide what every statistic needs.")
    words = (
        "What a recording or the simulator lacks is not a difference; the statistics that need it were not compared."
    )
    return Section(title, words, [_number_rows("missing", diagnosis.missing, "Statistics that could not be compared.")])


def _next(diagnosis: Diagnosis) -> Section:
    return Section("Next experiment", diagnosis.next_experiment or "None is needed to separate the causes.")


def _judgement_section(diagnosis: Diagnosis) -> Section:
    title, judged = "Candidates that were examined", diagnosis.judged
    if not judged:
        return Section(title, "None: candidates are tried only if there is a gap.")
    placebos = sum(candidate.effect == "" for candidate in judged)
    accepted = [candidate for candidate in judged if candidate.is_accepted]
    words = (
        f"{counted(len(judged), 'candidate')}, {len(accepted)} accepted. Among them {counted(placebos, 'placebo')}, "
        "an effect that changes nothing, whose gain is chance alone; "
        f"{sum(candidate.effect == '' for candidate in accepted)} placebos were accepted."
    )
    if len(judged) > MOST_ROWS:
        words += f" The best {MOST_ROWS} are shown."
    return Section(title, words, [_judged_table(judged)])


def _judged_table(judged: Sequence[CandidateEvaluation]) -> Table:
    """Return the candidates, accepted ones first, then by gain; placebos are marked."""
    ranked = sorted(
        judged,
        key=lambda candidate: (not candidate.is_accepted, -(candidate.gain if candidate.gain is not None else -1e300)),
    )
    rows = []
    for candidate in ranked[:MOST_ROWS]:
        effect, sensors = candidate.effect or highlight(PLACEBO), ", ".join(candidate.sensors) or "all"
        gain = NOTHING if candidate.gain is None else f"{candidate.gain:+.1f}"
        accepted = "yes" if candidate.is_accepted else "no"
        rows.append([effect, candidate.action, sensors, number(candidate.fits, 2), gain, accepted])
    caption = "Fits: how well it explains what the training part shows. Gain: how much likelier it makes held-out data."
    return Table(["effect", "action", "sensors", "fits", "gain (nats)", "accepted"], rows, caption, (1, 2, 5))


def _recording_section(diagnosis: Diagnosis) -> Section:
    recorded = []
    for recording in diagnosis.recorded:
        sizes = [str(recording.sensors), str(recording.phases), f"{recording.rows:,}".replace(",", " ")]
        recorded.append([recording.name, recording.kind, duration(recording.seconds), *sizes])
    heading = ["log", "experiment", "duration", "sensors", "phases", "rows"]
    notes = [_number_rows("note", diagnosis.notes, "Remarks of the diagnosis.")] if diagnosis.notes else []
    origin = [
        ["model", diagnosis.model],
        ["seed", str(diagnosis.seed)],
        ["replicates", str(diagnosis.replicates)],
        ["software", diagnosis.software],
    ]
    parts = [
        Table(heading, recorded, "The diagnosed recordings.", (1,)),
        *notes,
        Table(["", "value"], origin, "With the same recordings, these reproduce this page.", (1,)),
    ]
    return Section("Recordings and method", diagnosis.held_out, parts)


def _number_rows(heading: str, texts: Sequence[str], caption: str) -> Table:
    return Table(["", heading], [[str(place), text] for place, text in enumerate(texts, 1)], caption, (1,))


MOST_OVERLAYS = 12
"""Largest number of curves that are drawn."""

_KINDS = {
    "spectrum": "Spectrum: a peak that only the recording has is a spectral line; a bend is a filter.",
    "allan": (
        "Allan deviation: white noise falls with the square root of the averaging time; a floor is flicker noise; "
        "a rise is a drift."
    ),
    "temperature": "Temperature: a slope is a thermal bias; a loop or a delayed curve is a thermal lag.",
    "codes": "Codes: combs and gaps are coarse or missing codes; a peak at an end is saturation.",
}
"""Text on what the curves show, by kind of overlay, in the order in which the curves are drawn."""


def curves_section(overlays: Sequence[Overlay], *, with_figures: bool) -> Section:
    """Return the section with the `MOST_OVERLAYS` curves that were farthest outside the band before the causes were
    added, by kind; without figures, a section with a table of all curves.
    """
    title = "Curves: real, before and after"
    if not overlays:
        return Section(title, "The diagnosis stored no curves. `gap diagnose -o DIR` draws them in DIR/report.html.")
    worst = sorted(overlays, key=lambda overlay: -farthest(overlay, overlay.before)[1])
    chosen = sorted(worst[:MOST_OVERLAYS], key=lambda overlay: list(_KINDS).index(overlay.kind))
    words = " ".join(text for kind, text in _KINDS.items() if any(overlay.kind == kind for overlay in chosen))
    words = (
        "The black curve is the recording. The bands contain 95 % of the simulations, orange before, blue after. "
        f"{words}"
    )
    if not with_figures:
        return Section(title, words, [_overlays_table(overlays)])
    if len(overlays) > len(chosen):
        words += f" Shown are the {len(chosen)} of {len(overlays)} that lay farthest outside before."
    return Section(title, words, [_overlay(overlay) for overlay in chosen])


def _overlays_table(overlays: Sequence[Overlay]) -> Table:
    """Return the share of each curve that lies outside the bands of the simulations, before and after."""
    rows = []
    for overlay in overlays:
        shares = [share(outside(overlay, bands)) for bands in (overlay.before, overlay.after)]
        rows.append([f"{overlay.sensor} {overlay.axis}".rstrip(), overlay.kind, overlay.phase or "all", *shares])
    caption = "Share of each curve outside the 95 % band of the simulations; about 5 % by chance."
    return Table(["sensor", "curve", "phase", "before", "after"], rows, caption, (1, 2))


def _overlay(overlay: Overlay) -> Figure:
    place = f"{overlay.sensor} {overlay.axis}".rstrip() + (f", {overlay.phase}" if overlay.phase else "")
    before, after = (share(outside(overlay, bands)) for bands in (overlay.before, overlay.after))
    at, distance = farthest(overlay, overlay.before)
    name, _, unit = overlay.x_label.partition(" (")
    most = f", farthest at {name} {number(at)} {unit.removesuffix(')')}".rstrip() if distance else ""
    caption = f"{place}, {overlay.kind}: {before} of the curve outside the band before{most}; {after} after."
    alternative = f"{overlay.y_label} over {overlay.x_label}. {caption}"
    return SmallFigure(overlay_figure(overlay), caption, alternative)

"""The page of a gap diagnosis: its summary in sentences, where the gap is, its causes, how far they close it, and what
remains unexplained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from os import PathLike
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.diagnosis import Diagnosis, Gap, Map, Overlay, Where, needs_both_parts
from imuarray.gap.findings.text import chance, gap_text, number, scored, share
from imuarray.gap.model.use import Use
from imuarray.printable import counted
from imuarray.report import gap_tables as tables
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
from imuarray.report.gap_tables import MEANINGS, overlays_table
from imuarray.report.page import NO_FIGURES, Figure, Level, Section, Table, Verdict, can_draw, write_page

_VERDICTS = MappingProxyType(
    {
        "no gap": "No gap: the recordings look like simulations of the model.",
        "explained": "Explained: the causes below explain the differences.",
        "partly explained": "Partly explained: the causes below explain some of the differences, or none is certain.",
        "unexplained": "Unexplained: no combination of known effects makes the recordings likely.",
    }
)
Parts = list[Table | Figure]


def write_gap_page(path: str | PathLike[str], diagnosis: Diagnosis, *, force: bool = False) -> None:
    """Write the page; without matplotlib it has only tables, and says so.

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
        _pulls(diagnosis),
        _shrinks(diagnosis, with_figures=with_figures),
        curves_section(diagnosis.overlays, with_figures=with_figures),
        _where(diagnosis),
        _unexplained(diagnosis),
        _unobservable(diagnosis),
        _missing(diagnosis),
        _next(diagnosis),
        _judged(diagnosis),
        _recorded(diagnosis),
    )


def gap_verdict(diagnosis: Diagnosis) -> Verdict:
    """Return whether the simulator is good enough, and which effects it lacks."""
    gap = diagnosis.gap
    effects = [effect.replace("_", " ") for effect in dict.fromkeys(cause.effect for cause in diagnosis.causes)]
    if len(effects) == 1 and (meaning := MEANINGS.get(effects[0].replace(" ", "_"))):
        effects = [f"{effects[0]} ({meaning})"]
    names = _series(effects)
    levels: dict[str, Level] = {"no gap": "good", "unexplained": "bad"}
    sentence = {
        "no gap": "The simulator is good enough for what these recordings show: they agree with it within chance.",
        "explained": f"The simulator is not good enough as it is. {_remainder(diagnosis, names)}",
        "partly explained": f"The simulator is not good enough; {names or 'no cause'} explains only a part of it."
        if len(effects) < 2
        else f"The simulator is not good enough; {names} explain only a part of it.",
        "unexplained": "The simulator is not good enough, and no known effect explains the difference.",
    }[diagnosis.verdict]
    accepted = sum(cause.is_accepted for cause in diagnosis.causes)
    figures = [
        (str(accepted), "cause" if accepted == 1 else "causes"),
        (share(diagnosis.unknown), "probability of something unknown"),
    ]
    if gap.closed is not None:
        figures[:0] = [
            (number(gap.before, 2), f"gap in standard deviations; chance alone gives {number(gap.floor, 2)}"),
            (share(gap.closed), "of the gap closed by the causes"),
        ]
    else:
        figures.insert(0, (number(diagnosis.p, 2), "probability of such a difference by chance alone"))
    if (worst := _worst_use(diagnosis.uses)) is not None:
        figures.append((f"{number(worst.before.value / worst.real.value, 2)} ×", _use_words(worst)))
    return Verdict(sentence, levels.get(diagnosis.verdict, "doubtful"), tuple(figures))


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
"""Most effects or sensors that the verdict names."""


def _series(names: Sequence[str]) -> str:
    """Return names in a sentence: "A", "A and B", "A, B and C", "A, B, C and 2 more"."""
    shown = [*names[:_NAMED], *([f"{len(names) - _NAMED} more"] if len(names) > _NAMED else [])]
    return f"{', '.join(shown[:-1])} and {shown[-1]}" if len(shown) > 1 else "".join(shown)


def _worst_use(uses: Sequence[Use]) -> Use | None:
    """Return the figure of use whose simulated value differs most from the recorded one; None if none can be
    compared.
    """
    return max(
        (use for use in uses if can_compare(use)),
        key=lambda use: abs(np.log(use.before.value / use.real.value)),
        default=None,
    )


def _use_words(use: Use) -> str:
    return f"{use.sensor or 'array'} {use.name}: simulated divided by recorded; the largest difference"


def gap_summary(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield the diagnosis in sentences."""
    yield diagnosis.sentence
    yield f"{_VERDICTS[diagnosis.verdict]} Chance alone gives a difference as large as this with {chance(diagnosis.p)}."
    gap = gap_text(diagnosis.gap)
    yield f"The gap, on held-out data: {gap}." if diagnosis.gap.closed is not None else f"Overall: {gap}."
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
    return Section("Where the gap is", words, [*(_maps(small) if with_figures else []), tables.map_table(small)])


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
    if not diagnosis.causes:
        return Section("Causes", "No cause was found.")
    words = (
        "Effects that make the simulation resemble the recordings. Several can be present at once, so each has a "
        "probability of its own. Closes: the share of the gap of these sensors that disappears if only this effect is "
        "added, with its 95 % interval, on held-out data (or on all data, if neither part alone shows the effect). "
        "Origin: the sensor, its environment, or the description in the log."
    )
    each = tables.each_table(diagnosis.causes)
    return Section("Causes", words, [tables.causes_table(diagnosis.causes), *([each] if each else [])])


def _pulls(diagnosis: Diagnosis) -> Section:
    title, pulls = "Parts and their specification", diagnosis.pulls
    if not pulls:
        return Section(title, "No quantity was compared with a tolerance of a data sheet.")
    outside = sum(pull.is_out_of_specification for pull in pulls)
    words = (
        "Quantities that differ from part to part within a data sheet's tolerance, fitted to the recordings. None of "
        "them is a cause by itself. "
        f"{outside} of {len(pulls)} are out of specification."
    )
    if len(pulls) > tables.MOST_ROWS:
        words += f" The worst {tables.MOST_ROWS} are shown."
    return Section(title, words, [tables.pulls_table(pulls)])


def _shrinks(diagnosis: Diagnosis, *, with_figures: bool) -> Section:
    gap, uses = diagnosis.gap, diagnosis.uses
    words = "There is no gap to close."
    if gap.closed is not None:
        data = (
            "the data that showed the gap"
            if needs_both_parts(diagnosis.causes)
            else "held-out data, to which nothing was fitted"
        )
        words = (
            f"Scores of the statistics that differ, on {data}. Closed: the share of the squared excess over the "
            "floor that disappears, with its 95 % interval."
        )
    if uses:
        words += " The figures in physical units show what the difference means in practice."
    figures = [*_shrink_figures(gap), *_use_figures(uses)] if with_figures else []
    more = [tables.uses_table(uses)] if uses else []
    closing = [] if gap.closed is None else [tables.shrink_table(gap)]
    return Section("How much of the gap closes", words, [*figures, *closing, *more])


def _shrink_figures(gap: Gap) -> Iterator[Figure]:
    if gap.closed is None or not np.isfinite([gap.before, gap.after, gap.floor]).all():
        return
    caption = "Scores before and after the causes were added. At the dashed floor there is no gap."
    yield SmallFigure(shrink_figure(gap), caption, f"Bars by domain. Overall: {gap_text(gap)}.")


def _use_figures(uses: Sequence[Use]) -> Iterator[Figure]:
    comparable = [use for use in uses if can_compare(use)]
    if not comparable:
        return
    caption = "Simulated figures divided by recorded ones, with 95 % intervals; grey: the interval of the recording."
    named = [
        f"{use.sensor or 'array'} {use.name}: {_ratios(use.real.value, use.before.value, use.after.value)}"
        for use in comparable
    ]
    yield SmallFigure(use_figure(comparable), caption, f"{caption} {'; '.join(named)}.")


def _ratios(real: float, before: float, after: float) -> str:
    return f"{number(before / real, 2)} times before, {number(after / real, 2)} times after"


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
    return Section("Where it differs", words, [tables.where_table(where, _counted(where))])


def _counted(where: Sequence[Where]) -> str:
    rest = where[tables.MOST_ROWS :]
    more = (
        f" {len(rest)} more are not shown, {sum(place.size == 'material' for place in rest)} of them material."
        if rest
        else ""
    )
    return f"Worst first.{more}"


def _unexplained(diagnosis: Diagnosis) -> Section:
    unexplained = diagnosis.unexplained
    words = (
        "What still differs after the causes were added."
        if unexplained
        else "Nothing: no statistic still differs after the causes were added."
    )
    if diagnosis.verdict == "no gap":
        words = "Nothing."
    words += f" Something outside the library of effects is present with a probability of {share(diagnosis.unknown)}."
    return Section(
        "What is unexplained", words, [tables.where_table(unexplained, _counted(unexplained))] if unexplained else []
    )


def _unobservable(diagnosis: Diagnosis) -> Section:
    title = "What the recordings cannot show"
    if not diagnosis.unshown:
        return Section(title, "These recordings can show all effects of the library.")
    words = "The recordings cannot show whether these effects are present. The last column says what to record."
    return Section(title, words, [tables.unshown_table(diagnosis.unshown)])


def _missing(diagnosis: Diagnosis) -> Section:
    title = "What is missing"
    if not diagnosis.missing:
        return Section(title, "Nothing: recordings and simulator provide what every statistic needs.")
    words = (
        "What a recording or the simulator lacks is not a difference; the statistics that need it were not compared."
    )
    return Section(title, words, [tables.missing_table(diagnosis.missing)])


def _next(diagnosis: Diagnosis) -> Section:
    return Section("Next experiment", diagnosis.next_experiment or "None is needed to separate the causes.")


def _judged(diagnosis: Diagnosis) -> Section:
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
    if len(judged) > tables.MOST_ROWS:
        words += f" The best {tables.MOST_ROWS} are shown."
    return Section(title, words, [tables.judged_table(judged)])


def _recorded(diagnosis: Diagnosis) -> Section:
    parts: Parts = [tables.recorded_table(diagnosis)]
    if diagnosis.notes:
        parts.append(tables.notes_table(diagnosis.notes))
    return Section("Recordings and method", diagnosis.held_out, [*parts, tables.origin_table(diagnosis)])


MOST_OVERLAYS = 12
"""Most curves that are drawn."""

_KINDS = MappingProxyType(
    {
        "spectrum": "Spectrum: a peak that only the recording has is a spectral line; a bend is a filter.",
        "allan": (
            "Allan deviation: white noise falls with the square root of the averaging time; a floor is flicker noise; "
            "a rise is a drift."
        ),
        "temperature": "Temperature: a slope is a thermal bias; a loop or a delayed curve is a thermal lag.",
        "codes": "Codes: combs and gaps are coarse or missing codes; a peak at an end is saturation.",
    }
)
"""What to look for, by kind of overlay, in the order in which the curves are drawn."""


def curves_section(overlays: Sequence[Overlay], *, with_figures: bool) -> Section:
    """Return the section with the `MOST_OVERLAYS` curves that lay farthest outside the band before, by kind; without
    figures, a table of all.
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
        return Section(title, words, [overlays_table(overlays)])
    if len(overlays) > len(chosen):
        words += f" Shown are the {len(chosen)} of {len(overlays)} that lay farthest outside before."
    return Section(title, words, [_overlay(overlay) for overlay in chosen])


def _overlay(overlay: Overlay) -> Figure:
    place = f"{overlay.sensor} {overlay.axis}".rstrip() + (f", {overlay.phase}" if overlay.phase else "")
    before, after = (share(outside(overlay, bands)) for bands in (overlay.before, overlay.after))
    at, distance = farthest(overlay, overlay.before)
    name, _, unit = overlay.x_label.partition(" (")
    most = f", farthest at {name} {number(at)} {unit.removesuffix(')')}".rstrip() if distance else ""
    caption = f"{place}, {overlay.kind}: {before} of the curve outside the band before{most}; {after} after."
    alternative = f"{overlay.y_label} over {overlay.x_label}. {caption}"
    return SmallFigure(overlay_figure(overlay), caption, alternative)

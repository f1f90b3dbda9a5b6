"""The page of a validation run: every figure with its bar, what misses one and where, plots, how it was made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from math import isfinite
from os import PathLike
from types import MappingProxyType
from typing import Any

from imuarray.gap.findings.text import share
from imuarray.report.gap_sheet import SmallFigure
from imuarray.report.gap_tables import marked
from imuarray.report.page import Figure, Section, Table, Verdict, write_page
from imuarray.report.validation_figures import plots_of
from imuarray.report.validation_words import failing_rows, plain_text, summary_lines, transfer_rows
from imuarray.validation.rates import Bin
from imuarray.validation.score_answers import NO_GAP
from imuarray.validation.score_rows import ScoreRow
from imuarray.validation.scoring import Figures, decimal, format_row, lost_by

NO_FIGURES = "No figures on this page: they need matplotlib (pip install 'imuarray[report]')."
Parts = list[Table | Figure]
Plots = Mapping[str, Any]
"""Drawings by their names."""


def write_validation_page(
    path: str | PathLike[str],
    figures: Figures,
    *,
    command: str = "",
    plots: Plots | None = None,
    force: bool = False,
) -> None:
    """Write the page; `command` made the run, `plots` are its drawings if there are any yet (`plots_of`). Without
    matplotlib it says so and has tables alone.

    OutputExistsError if it is there and not `force`, MissingExtraError without jinja2.
    """
    can_draw = find_spec("matplotlib") is not None
    if plots is None:
        plots = plots_of(figures) if can_draw else {}
    summary = list(summary_lines(figures))
    sections = validation_sections(figures, plots, command)
    title = f"Diagnosis checked on data whose effect is withheld: {figures.half or 'unnamed'} half"
    lines = summary if can_draw else [*summary, NO_FIGURES]
    write_page(path, title, lines, sections, verdict=validation_verdict(figures), force=force)


def validation_verdict(figures: Figures) -> Verdict:
    """Return how many of the bars that were set before the diagnosis meets."""
    judged = [row for row in figures.rows if row.mark in ("ok", "FAIL")]
    failed = [row for row in judged if row.mark == "FAIL"]
    if not judged:
        sentence = "Too few cases were run to judge the diagnosis by its bars."
    elif failed:
        sentence = (
            f"The diagnosis misses {len(failed)} of {len(judged)} bars: {', '.join(row.name for row in failed[:3])}."
        )
    else:
        sentence = f"The diagnosis meets all {len(judged)} bars that were set before."
    key_figures = (
        (str(figures.cases), "cases"),
        (f"{len(judged) - len(failed)} of {len(judged)}", "bars met"),
        (str(len(figures.lost)), "cases lost"),
    )
    return Verdict(sentence, "neutral" if not judged else "doubtful" if failed else "good", key_figures)


def validation_sections(figures: Figures, plots: Plots, command: str = "") -> tuple[Section, ...]:
    """Return the sections of the page below its summary."""
    return (
        _figures(figures),
        *_worlds(figures),
        _missed(figures),
        _alarms(figures, plots),
        _detection(figures, plots),
        _causes(figures, plots),
        _probabilities(figures, plots),
        _closure(figures, plots),
        _run(figures, command),
    )


def _figures(figures: Figures) -> Section:
    rows = [[row.name, marked("FAIL") if row.mark == "FAIL" else row.mark, *format_row(row)] for row in figures.rows]
    heading = ["figure", "", "value", "95 %", "cases", "bar"]
    caption = "Marked where a bar is missed; n.a.: no cases; nothing: no bar."
    counted = [[name, about] for about, name in _names_by_meaning(figures).items()]
    words = "Each figure with its interval, the number of cases, and the bar that was set before."
    descriptions = Table(["figure", "what is counted"], counted, "What is counted.", (1,))
    return Section("Figures and their bars", words, [Table(heading, rows, caption), *_by_plan(figures), descriptions])


def _worlds(figures: Figures) -> Iterator[Section]:
    """Figures of several worlds beside each other, and of parts of the cases against the rest."""
    parts: Parts = []
    if figures.transfers:
        heading = ["figure", *figures.worlds, "transfer gap"]
        caption = "Number of cases in brackets; the gap is the loss from the first world to the worst of the others."
        parts.append(Table(heading, list(transfer_rows(figures)), caption))
    for world, world_rows in figures.elsewhere.items():
        cells = [
            [row.name, marked("FAIL") if row.mark == "FAIL" else row.mark, *format_row(row)]
            for row in world_rows
            if row.cases
        ]
        parts.append(Table(["figure", "", "value", "95 %", "cases", "bar"], cells, f"World: {world}."))
    if figures.left_out:
        rows_of = [
            [part.part, part.figure, decimal(part.value), decimal(part.others), str(part.cases)]
            for part in figures.left_out
        ]
        caption = "The cases with a chip or an experiment, and all others."
        parts.append(Table(["part", "figure", "with it", "without it", "cases"], rows_of, caption, (1,)))
    if parts:
        words = "The figures in other worlds, on other chips and on other plans than those of the development."
        yield Section("Elsewhere", words, parts)


def _by_plan(figures: Figures) -> Iterator[Table]:
    """Yield a table of the figures that there are on several plans or with several experiments, if there are any."""
    groups = ("plan", "experiment")
    cells = {row.name: {cell.name: cell for cell in row.cells if cell.group in groups} for row in figures.rows}
    plans = sorted({plan for own in cells.values() for plan in own})
    rows = [
        [name, *(f"{decimal(own[plan].value)} ({own[plan].cases})" if plan in own else "–" for plan in plans)]
        for name, own in cells.items()
        if own
    ]
    if len(plans) > 1:
        yield Table(["figure", *plans], rows, "On each plan, with the number of cases in brackets.")


def _names_by_meaning(figures: Figures) -> dict[str, str]:
    """Return the descriptions of what is counted, with the figures to which each applies."""
    names_by_meaning: dict[str, list[str]] = {}
    for row in figures.rows:
        names_by_meaning.setdefault(row.about, []).append(row.name)
    return {about: "; ".join(names) for about, names in names_by_meaning.items()}


def _missed(figures: Figures) -> Section:
    title = "Where a bar is missed"
    rows = list(failing_rows(figures))
    if not figures.failed:
        return Section(title, "Nowhere.")
    words = (
        "The parts of the cases that pull a figure down, by severity, mechanism or kind, those first whose interval is "
        "outside the bar. A cell of few cases misses by chance."
    )
    heading = ["figure", "cell", "value", "95 %", "cases"]
    return Section(title, words, [Table(heading, rows, "Figures that miss their bar, and cells of them.", (1,))])


def _alarms(figures: Figures, plots: Plots) -> Section:
    rows = [row for row in figures.rows if row.name.startswith("false alarms")]
    known = [row for row in rows if row.cases]
    parts: Parts = []
    if "false-alarms" in plots:
        listed = ", ".join(f"{_plan_of(row)} {share(row.value)}" for row in known)
        caption = "Cases without a fault in which a gap is reported; number of cases in brackets."
        parts.append(SmallFigure(plots["false-alarms"], caption, f"{caption} {listed}."))
    words = "These cases have no fault; a gap may be reported in one of twenty."
    cells = [[_plan_of(row), *format_row(row)] for row in rows]
    table = Table(["plan", "value", "95 %", "cases", "bar"], cells, "Share of cases in which a gap is reported.")
    return Section("False alarms", words, [*parts, table])


def _plan_text(figures: Figures) -> str:
    return f"the plan {figures.full!r}" if figures.full else "all plans"


def _plan_of(row: ScoreRow) -> str:
    """Return the plan of a row of false alarms."""
    return row.name.partition("plan ")[2] or "all"


def _detection(figures: Figures, plots: Plots) -> Section:
    curves, power = figures.curves, figures.power
    if not curves:
        return Section("Detection", "No cases of a single mechanism.")
    parts: Parts = []
    if "detection" in plots:
        whole = ", ".join(f"{limits:g} limits {share(estimate.value)}" for limits, estimate in curves[0].points)
        caption = "Share of cases in which a gap is reported, against severity; grey: the bars at 2 and 5 limits."
        parts.append(SmallFigure(plots["detection"], caption, f"{caption} All plans: {whole}."))
    rows = [
        [name, *(f"{hits} of {cases}" if cases else "–" for hits, cases in counts)]
        for name, counts in zip(power.mechanisms, power.counts, strict=True)
    ]
    caption = f"Detected cases on {_plan_text(figures)}, by mechanism and severity."
    if rows:
        parts.append(Table(["mechanism", *power.severities], rows, caption))
    words = "Severity is in units of the detection limit; some mechanisms have none: they are present or not."
    return Section("Detection", words, [*parts, _curve_table(figures)])


def _curve_table(figures: Figures) -> Table:
    limits = sorted({limits for curve in figures.curves for limits, _ in curve.points})
    rows = []
    for curve in figures.curves:
        points = dict(curve.points)
        cells = [points.get(limits) for limits in limits]
        rows.append([curve.plan, *(f"{decimal(limits.value)} ({limits.cases})" if limits else "–" for limits in cells)])
    return Table(
        ["plan", *(f"{limits:g}x" for limits in limits)], rows, "Share detected, with the number of cases in brackets."
    )


def _causes(figures: Figures, plots: Plots) -> Section:
    confusion = figures.confusion
    if not confusion.truths:
        return Section("Causes", f"No cases on {_plan_text(figures)}.")
    parts: Parts = []
    wrong = _taken_for(figures)
    if "causes" in plots:
        caption = (
            "Active mechanism (rows) against the first reported cause (columns), all severities; numbers"
            " are cases, colour "
            "is the share of the row, red frames mark what is right: no cause, for a mechanism without a name."
        )
        listed = "; ".join(f"{truth} taken for {said}: {count}" for truth, said, count in wrong[:5])
        parts.append(Figure(plots["causes"], caption, f"{caption} Most often wrong: {listed}."))
    if wrong:
        caption = f"The most frequent confusions of {len(wrong)}; cases without a reported gap are not included."
        parts.append(Table(["at work", "first cause said", "cases"], wrong[:20], caption, (1,)))
    words = "The most probable cause of each case of one mechanism or none. A mechanism can have several right names."
    return Section("Causes", words, parts)


def _taken_for(figures: Figures) -> list[tuple[str, str, str]]:
    """Truth, what was said instead, how often; the most frequent first."""
    confusion = figures.confusion
    confusions = [
        (count, truth, said)
        for truth, counts, right in zip(confusion.truths, confusion.counts, confusion.right, strict=True)
        for said, count, is_right in zip(confusion.said, counts, right, strict=True)
        if count and not is_right and said != NO_GAP
    ]
    return [(truth, said, str(count)) for count, truth, said in sorted(confusions, key=lambda confusion: -confusion[0])]


def _probabilities(figures: Figures, plots: Plots) -> Section:
    filled = [bin_ for bin_ in figures.reliability if bin_.cases]
    if not filled:
        return Section("Probabilities", "No cause was reported.")
    caption = "Reported causes by probability: the share that is right should equal it. Numbers count causes."
    listed = "; ".join(f"{_bin_name(bin_)}: {decimal(bin_.right)} of {bin_.cases}" for bin_ in filled)
    parts: Parts = [SmallFigure(plots["probabilities"], caption, f"{caption} {listed}.")] if plots else []
    rows = [[_bin_name(bin_), decimal(bin_.mean), decimal(bin_.right), str(bin_.cases)] for bin_ in filled]
    table = Table(["probability", "mean", "right", "causes"], rows, "Reported probabilities and observed frequencies.")
    words = "Every reported cause, in cases of one mechanism, two or none."
    return Section("Probabilities", words, [*parts, table])


def _bin_name(bin_: Bin) -> str:
    return f"{bin_.low:g} to {bin_.high:g}"


def _closure(figures: Figures, plots: Plots) -> Section:
    known = [closure for closure in figures.closures if isfinite(closure.claimed)]
    silent = len(figures.closures) - len(known)
    words = "Share of the gap that the reported causes close, against that of an oracle that knows the effects."
    words += f" In {silent} cases no share was reported, although the oracle closes some." if silent else ""
    if not known:
        return Section("Closure", f"{words} No cases.")
    caption = "One point per case; grey: close enough."
    summary = f"{caption} {sum(closure.is_right for closure in known)} with the right cause first, {len(known)} in all."
    parts: Parts = [SmallFigure(plots["closure"], caption, summary)] if plots else []
    rows = [[row.name, *format_row(row)] for row in figures.rows if "closure" in row.name]
    return Section("Closure", words, [*parts, Table(["figure", "value", "95 %", "cases", "bar"], rows, "Closure.")])


_THRESHOLDS = MappingProxyType(
    {
        "level of false alarms": "significance level of a gap",
        "nats to be looked at": "least gain (nats) of a candidate that is pursued",
        "nats to be accepted": "least gain (nats) of a candidate that is accepted",
        "nats a parameter costs": "cost (nats) of each parameter",
        "wrong form allowed": "relative error of the form of an effect that is allowed",
        "log odds tempered": "exponent of the odds of a candidate in its probability",
        "right if nothing closes": "probability of a cause that closes nothing",
        "right if all closes": "probability of a cause that closes everything",
        "power of what closes": "exponent of the share closed in the probability of a cause",
        "power of odds against rivals": "exponent of the odds against rivals in the probability of a cause",
        "probability to be told": "least probability of an alternative that is reported",
        "odds to be confusable": "least odds of an effect that could look the same",
        "closed to be a cause": "least share of the gap that a cause closes",
        "closed to be explained": "least share closed for the verdict explained",
        "closed to be partly explained": "least share closed for the verdict partly explained",
        "probability to explain": "least probability of the first cause for the verdict explained",
        "left over to be unlikely": "size of a remaining difference from which something unknown is likely",
        "beyond chance to be left": "factor over chance from which a remaining difference is significant",
        "replicates of the base model": "replicates of the base model",
        "replicates of a trial": "replicates of each candidate",
    }
)
"""What the thresholds of `imuarray.validation.thresholds` mean, by their keys in plan.json."""


def _run(figures: Figures, command: str) -> Section:
    plan = {key: value for key, value in figures.plan.items() if key != "frozen"}
    rows = [["command", command]] if command else []
    rows += [[key, plain_text(value)] for key, value in plan.items()]
    rows += [[f"fixed: {_THRESHOLDS.get(key, key)}", plain_text(value)] for key, value in figures.frozen.items()]
    rows += [["cases", str(figures.cases)], ["lost", str(len(figures.lost))]]
    rows += [[f"lost: {name}", str(count)] for name, count in lost_by(figures.lost).items()]
    caption = "The same command and software reproduce this page."
    words = (
        "Thresholds marked as fixed were chosen before the truth was opened."
        if figures.frozen
        else "No threshold was fixed before the truth was opened."
    )
    return Section("How it was made", words, [Table(["", "value"], rows, caption, (1,))])

"""The page of a validation run, in HTML and in Markdown: every figure with its requirement, those that fail, plots, and
the settings of the run.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from math import isfinite
from os import PathLike
from types import MappingProxyType
from typing import Any

from imuarray.figures import can_draw
from imuarray.gap.findings.text import share
from imuarray.printable import counted
from imuarray.report.figure_style import SmallFigure
from imuarray.report.page import NO_FIGURES, Figure, Section, Table, Verdict, highlight, write_page
from imuarray.report.validation_figures import plots_of
from imuarray.validation.rates import Bin
from imuarray.validation.score_answers import NO_GAP
from imuarray.validation.score_rows import ScoreRow
from imuarray.validation.scoring import (
    HEADLINE,
    MOST_CELLS,
    Figures,
    decimal,
    format_row,
    lost_by,
    shown_rows,
    transfer_line,
)

Parts = list[Table | Figure]
Plots = Mapping[str, Any]
"""Drawings by name."""


def write_validation_page(
    path: str | PathLike[str],
    figures: Figures,
    *,
    command: str = "",
    plots: Plots | None = None,
    force: bool = False,
) -> None:
    """Write the page. `command` is the command of the run; `plots` are its figures (None: `plots_of` draws them).
    Without matplotlib the page has only tables, and a note.

    OutputExistsError if the file exists and not `force`, MissingExtraError without jinja2.
    """
    if plots is None:
        plots = plots_of(figures) if can_draw() else {}
    summary = list(summary_lines(figures))
    sections = validation_sections(figures, plots, command)
    title = f"Diagnosis checked on data whose effect is withheld: {figures.half or 'unnamed'} half"
    lines = summary if can_draw() else [*summary, NO_FIGURES]
    write_page(path, title, lines, sections, verdict=validation_verdict(figures), force=force)


def validation_verdict(figures: Figures) -> Verdict:
    """Return how many of the bars, which were set in advance, the diagnosis meets."""
    judged = [row for row in figures.rows if row.mark in ("ok", "FAIL")]
    failed = [row for row in judged if row.mark == "FAIL"]
    if not judged:
        sentence = "Too few cases were run to judge the diagnosis by its bars."
    elif failed:
        sentence = (
            f"The diagnosis misses {len(failed)} of {len(judged)} bars: {', '.join(row.name for row in failed[:3])}."
        )
    else:
        sentence = f"The diagnosis meets all {len(judged)} bars, which were set in advance."
    without = sum(row.mark == "n.a." for row in figures.rows)
    key_figures = (
        (str(figures.cases), "cases"),
        (f"{len(judged) - len(failed)} of {len(judged)}", "bars met")
        if judged
        else (str(without), "bars without cases"),
        (str(len(figures.lost)), "cases lost"),
    )
    return Verdict(sentence, "neutral" if not judged else "doubtful" if failed else "good", key_figures)


def validation_sections(figures: Figures, plots: Plots, command: str = "") -> tuple[Section, ...]:
    """Return the sections of the page below its summary."""
    return (
        _figures(figures),
        *_worlds(figures),
        _missed_section(figures),
        _alarms(figures, plots),
        _detection(figures, plots),
        _causes(figures, plots),
        _probabilities(figures, plots),
        _closure(figures, plots),
        _run(figures, command),
    )


def _figures(figures: Figures) -> Section:
    shown = shown_rows(figures)
    caption = "Marked where a bar is missed; n.a.: no cases; empty: no bar."
    if len(shown) < len(figures.rows):
        caption = f"{len(figures.rows) - len(shown)} figures without cases are not shown."
    counted = [[name, about] for about, name in _names_by_meaning(figures).items()]
    words = "Each figure with its interval, the number of cases, and the bar, which was set in advance."
    descriptions = Table(["figure", "what is counted"], counted, "What is counted.", (1,))
    return Section("Figures and their bars", words, [_rows_table(shown, caption), *_plan_tables(figures), descriptions])


def _rows_table(rows: Iterable[ScoreRow], caption: str) -> Table:
    cells = [[row.name, highlight("FAIL") if row.mark == "FAIL" else row.mark, *format_row(row)] for row in rows]
    return Table(["figure", "", "value", "95 %", "cases", "bar"], cells, caption)


def _worlds(figures: Figures) -> Iterator[Section]:
    """Yield the section on the figures of several worlds, and of parts of the cases compared with the rest."""
    parts: Parts = []
    if figures.transfers:
        heading = ["figure", *figures.worlds, "transfer gap"]
        caption = "Number of cases in brackets; the gap is the loss from the first world to the worst of the others."
        parts.append(Table(heading, list(transfer_rows(figures)), caption))
    for world, world_rows in figures.elsewhere.items():
        parts.append(_rows_table([row for row in world_rows if row.cases], f"World: {world}."))
    if figures.left_out:
        rows_of = [
            [part.part, part.figure, decimal(part.value), decimal(part.others), str(part.cases)]
            for part in figures.left_out
        ]
        caption = "The cases with a chip or an experiment, and all others."
        parts.append(Table(["part", "figure", "with it", "without it", "cases"], rows_of, caption, (1,)))
    if parts:
        words = "The figures in worlds, on chips and on plans that were not used in development."
        yield Section("Elsewhere", words, parts)


def _plan_tables(figures: Figures) -> Iterator[Table]:
    """Yield a table of the figures that exist for several plans or experiments, if there are any."""
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
    """Return the names of the figures that share each description of what is counted."""
    names_by_meaning: dict[str, list[str]] = {}
    for row in figures.rows:
        names_by_meaning.setdefault(row.about, []).append(row.name)
    return {about: "; ".join(names) for about, names in names_by_meaning.items()}


def _missed_section(figures: Figures) -> Section:
    title = "Where a bar is missed"
    rows = list(failing_rows(figures))
    if not figures.failed:
        return Section(title, "Nowhere.")
    words = (
        "The cases that lower a figure, by severity, mechanism or kind; first those whose whole interval is outside "
        "the bar. A cell with few cases can miss by chance."
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
    words = "These cases have no fault. A gap is expected to be reported in one of twenty."
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
    sizes = sorted({limits for curve in figures.curves for limits, _ in curve.points})
    rows = []
    for curve in figures.curves:
        points = dict(curve.points)
        shares = [points.get(limits) for limits in sizes]
        rows.append([curve.plan, *(f"{decimal(each.value)} ({each.cases})" if each else "–" for each in shares)])
    return Table(
        ["plan", *(f"{limits:g}x" for limits in sizes)], rows, "Share detected, with the number of cases in brackets."
    )


def _causes(figures: Figures, plots: Plots) -> Section:
    confusion = figures.confusion
    if not confusion.truths:
        return Section("Causes", f"No cases on {_plan_text(figures)}.")
    parts: Parts = []
    wrong = _confusions(figures)
    if "causes" in plots:
        caption = (
            "Active mechanism (rows) against the first reported cause (columns), all severities; numbers"
            " are cases, colour "
            "is the share of the row, red frames mark what is right: no cause, for a mechanism without a name."
        )
        listed = "; ".join(f"{truth} taken for {reported}: {count}" for truth, reported, count in wrong[:5])
        parts.append(Figure(plots["causes"], caption, f"{caption} Most often wrong: {listed}."))
    if wrong:
        caption = f"The most frequent confusions of {len(wrong)}; cases without a reported gap are not included."
        parts.append(Table(["active mechanism", "first reported cause", "cases"], wrong[:20], caption, (1,)))
    words = "The most probable cause of each case of one mechanism or none. A mechanism can have several right names."
    return Section("Causes", words, parts)


def _confusions(figures: Figures) -> list[tuple[str, str, str]]:
    """Return the active mechanism, the reported cause and the count of each confusion, the most frequent first."""
    confusion = figures.confusion
    confusions = [
        (count, truth, reported)
        for truth, counts, right in zip(confusion.truths, confusion.counts, confusion.right, strict=True)
        for reported, count, is_right in zip(confusion.said, counts, right, strict=True)
        if count and not is_right and reported != NO_GAP
    ]
    return [
        (truth, reported, str(count))
        for count, truth, reported in sorted(confusions, key=lambda confusion: -confusion[0])
    ]


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
    words = "Share of the gap that the reported causes close, compared with an oracle that knows the effects."
    words += f" In {silent} cases no share was reported, although the oracle closes some." if silent else ""
    if not known:
        return Section("Closure", f"{words} No cases.")
    caption = "One point per case; grey: within tolerance."
    summary = f"{caption} {sum(closure.is_right for closure in known)} with the right cause first, {len(known)} in all."
    parts: Parts = [SmallFigure(plots["closure"], caption, summary)] if plots else []
    rows = [[row.name, *format_row(row)] for row in figures.rows if "closure" in row.name]
    return Section("Closure", words, [*parts, Table(["figure", "value", "95 %", "cases", "bar"], rows, "Closure.")])


def _run(figures: Figures, command: str) -> Section:
    plan = {key: value for key, value in figures.plan.items() if key != "frozen"}
    rows = [["command", command]] if command else []
    rows += [[key, plain_text(value)] for key, value in plan.items()]
    rows += [[f"fixed: {key}", plain_text(value)] for key, value in figures.frozen.items()]
    rows += [["cases", str(figures.cases)], ["lost", str(len(figures.lost))]]
    rows += [[f"lost: {name}", str(count)] for name, count in lost_by(figures.lost).items()]
    caption = "The same command and software reproduce this page."
    words = (
        "Thresholds marked as fixed were chosen before the truth was opened."
        if figures.frozen
        else "No threshold was fixed before the truth was opened."
    )
    return Section("Settings of the run", words, [Table(["", "value"], rows, caption, (1,))])


# Sentences, and the page in Markdown ---------------------------------------------------------------------------------

_MOST_NAMED = 5
"""Largest number of figures without cases that are named one by one."""


def markdown(figures: Figures, date: str, command: str = "", plots: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return a section of results for a committed page: date, command, fixed thresholds, every figure, those that miss
    their bar, and plots (file by text alternative).
    """
    lines = [f"## Results of {_cell(date)}, {_cell(figures.half or 'unnamed')} half", ""]
    lines += [f"- {_cell(line)}" for line in (*summary_lines(figures), frozen_text(figures))]
    lines += ["", "```sh", command.replace("```", ""), "```"] if command else []
    lines += ["", *_markdown_rows(figures.rows, "**FAIL**")]
    for world, rows in figures.elsewhere.items():
        lines += ["", f"World {_cell(world)}:", "", *_markdown_rows([row for row in rows if row.cases], "FAIL")]
    if figures.transfers:
        lines += ["", "| figure | " + " | ".join(map(_cell, figures.worlds)) + " | transfer gap |"]
        lines += ["|---" * (len(figures.worlds) + 2) + "|"]
        lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in transfer_rows(figures)]
    missed = list(failing_rows(figures))
    if missed:
        lines += ["", "Where a bar is missed:", "", "| figure | cell | value | 95 % | cases |", "|---|---|---|---|---|"]
        lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in missed]
    lines += [line for about, file in plots.items() for line in ("", f"![{about}]({file})")]
    return "\n".join(lines) + "\n"


def _markdown_rows(rows: Iterable[ScoreRow], fail: str) -> Iterator[str]:
    yield from ("| | figure | value | 95 % | cases | bar |", "|---|---|---|---|---|---|")
    for row in rows:
        mark = fail if row.mark == "FAIL" else row.mark
        yield "| " + " | ".join([mark, *map(_cell, (row.name, *format_row(row)))]) + " |"


def summary_lines(figures: Figures) -> Iterator[str]:
    """Yield how many figures reach their bar, which do not, which have no cases, and how many cases are lost."""
    judged = [row for row in figures.rows if row.passes is not None]
    sure = [row.name for row in figures.failed if row.is_refuted]
    maybe = [row.name for row in figures.failed if not row.is_refuted]
    empty = [row.name for row in figures.rows if row.mark == "n.a."]
    if judged:
        yield f"{sum(row.passes is True for row in judged)} of {len(judged)} figures reach their bar."
    if sure:
        yield f"Missed significantly (the whole interval is outside the bar): {'; '.join(sure)}."
    if maybe:
        yield f"Missed, but the interval reaches the bar: {'; '.join(maybe)}."
    if empty:
        few = len(empty) <= _MOST_NAMED
        yield f"No cases for: {'; '.join(empty)}." if few else f"{len(empty)} figures have no cases."
    for transfer in figures.transfers:
        if transfer.name == HEADLINE:
            yield f"{transfer_line(transfer).capitalize()}."
    by_reason = "; ".join(f"{name}: {count}" for name, count in lost_by(figures.lost).items())
    yield f"{counted(figures.cases, 'case')}, {len(figures.lost)} of them lost{f' ({by_reason})' if by_reason else ''}."
    yield f"Figures are compared with the bars on {_plan_text(figures)} unless stated otherwise; intervals are 95 %."
    yield from figures.notes


def transfer_rows(figures: Figures) -> Iterator[list[str]]:
    """Yield each figure that several worlds have: its name, its value and cases in each world, and the transfer gap."""
    for transfer in figures.transfers:
        cells = [transfer.rows.get(world) for world in figures.worlds]
        values = [f"{decimal(row.value)} ({row.cases})" if row else "–" for row in cells]
        yield [transfer.name, *values, decimal(transfer.lost)]


def failing_rows(figures: Figures) -> Iterator[list[str]]:
    """Yield figure, cell, value, interval and cases of every figure that misses its bar, and of up to `MOST_CELLS` of
    its cells that do, the most certain first.
    """
    for row in figures.failed:
        failing = row.failing()
        yield [row.name, "all", *format_row(row)[:3]]
        for cell in failing[:MOST_CELLS]:
            yield [row.name, f"{cell.group} {cell.name}", *format_row(cell)[:3]]
        if len(failing) > MOST_CELLS:
            yield [row.name, f"and {len(failing) - MOST_CELLS} more", "", "", ""]


def frozen_text(figures: Figures) -> str:
    """Return the text of the thresholds that were fixed before the truth was opened."""
    if not figures.frozen:
        return "No threshold was fixed before the truth was opened."
    return (
        "Fixed before the truth was opened: "
        + "; ".join(f"{key} {plain_text(value)}" for key, value in figures.frozen.items())
        + "."
    )


def plain_text(value: Any) -> str:
    """Return the text of a value of plan.json in one line."""
    return value if isinstance(value, str) else json.dumps(value)


def _cell(text: str) -> str:
    """Return text for a cell of a Markdown table: one line, escaped."""
    one_line = " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;")
    return "".join(f"\\{sign}" if sign in "\\`*_[]|$" else sign for sign in one_line)

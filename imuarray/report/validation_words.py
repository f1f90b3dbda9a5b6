"""Sentences on the results of a validation run: for the top of its page, and in Markdown for a committed page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from imuarray.printable import counted
from imuarray.validation.scoring import HEADLINE, MOST_CELLS, Figures, decimal, format_row, lost_by, transfer_line

_MOST_NAMED = 5
"""Figures without cases that are named one by one."""


def markdown(figures: Figures, date: str, command: str = "", plots: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return a section of results for a committed page: when, by what command, what was frozen, every figure, what
    misses, and plots by what they show, each a file.
    """
    lines = [f"## Results of {_cell(date)}, {_cell(figures.half or 'unnamed')} half", ""]
    lines += [f"- {_cell(line)}" for line in (*summary_lines(figures), frozen_text(figures))]
    lines += ["", "```sh", command.replace("```", ""), "```"] if command else []
    lines += ["", "| | figure | value | 95 % | cases | bar |", "|---|---|---|---|---|---|"]
    for row in figures.rows:
        mark = "**FAIL**" if row.mark == "FAIL" else row.mark
        lines.append("| " + " | ".join([mark, *map(_cell, (row.name, *format_row(row)))]) + " |")
    for world, rows in figures.elsewhere.items():
        lines += [
            "",
            f"World {_cell(world)}:",
            "",
            "| | figure | value | 95 % | cases | bar |",
            "|---|---|---|---|---|---|",
        ]
        lines += [
            "| " + " | ".join([row.mark, *map(_cell, (row.name, *format_row(row)))]) + " |" for row in rows if row.cases
        ]
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


def summary_lines(figures: Figures) -> Iterator[str]:
    """Return how many figures reach their bar and which don't, what there were no cases for, what is lost."""
    judged = [row for row in figures.rows if row.passes is not None]
    sure = [row.name for row in figures.failed if row.is_refuted]
    maybe = [row.name for row in figures.failed if not row.is_refuted]
    bare = [row.name for row in figures.rows if row.mark == "n.a."]
    yield f"{sum(row.passes is True for row in judged)} of {len(judged)} figures reach their bar."
    if sure:
        yield f"Missed by more than chance (the whole interval is outside the bar): {'; '.join(sure)}."
    if maybe:
        yield f"Missed, but the interval reaches the bar: {'; '.join(maybe)}."
    if bare:
        few = len(bare) <= _MOST_NAMED
        yield f"No cases for: {'; '.join(bare)}." if few else f"{len(bare)} figures have no cases."
    for transfer in figures.transfers:
        if transfer.name == HEADLINE:
            yield f"{transfer_line(transfer).capitalize()}."
    by_reason = "; ".join(f"{name}: {count}" for name, count in lost_by(figures.lost).items())
    yield f"{counted(figures.cases, 'case')}, {len(figures.lost)} of them lost{f' ({by_reason})' if by_reason else ''}."
    judged_on = f"the plan {figures.full!r}" if figures.full else "all plans"
    yield f"Figures are compared with the bars on {judged_on} unless a figure says otherwise; intervals hold 95 %."
    yield from figures.notes


def transfer_rows(figures: Figures) -> Iterator[list[str]]:
    """Yield each figure that several worlds have: its value in each, in brackets the cases, and what is lost."""
    for transfer in figures.transfers:
        cells = [transfer.rows.get(world) for world in figures.worlds]
        values = [f"{decimal(row.value)} ({row.cases})" if row else "–" for row in cells]
        yield [transfer.name, *values, decimal(transfer.lost)]


def failing_rows(figures: Figures) -> Iterator[list[str]]:
    """Figure, cell, value, interval and cases of every figure that misses its bar, and of `MOST_CELLS` of its cells
    that do, the surest first.
    """
    for row in figures.failed:
        failing = row.failing()
        yield [row.name, "all", *format_row(row)[:3]]
        for cell in failing[:MOST_CELLS]:
            yield [row.name, f"{cell.group} {cell.name}", *format_row(cell)[:3]]
        if len(failing) > MOST_CELLS:
            yield [row.name, f"and {len(failing) - MOST_CELLS} more", "", "", ""]


def frozen_text(figures: Figures) -> str:
    """Return the thresholds and settings that were fixed before the truth was opened."""
    if not figures.frozen:
        return "Nothing was frozen before the truth was opened."
    return (
        "Frozen before the truth was opened: "
        + "; ".join(f"{key} {plain_text(value)}" for key, value in figures.frozen.items())
        + "."
    )


def plain_text(value: Any) -> str:
    """Return a value of plan.json in one line."""
    return value if isinstance(value, str) else json.dumps(value)


def _cell(text: str) -> str:
    """One line of Markdown: no markup, no end of a table's cell."""
    one_line = " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;")
    return "".join(f"\\{sign}" if sign in "\\`*_[]|$" else sign for sign in one_line)

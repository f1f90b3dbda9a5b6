"""Results for notebooks: a sentence and a table, as HTML without styles, so that the colours of a theme are used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

MOST_ROWS = 60
"""Largest number of rows that are shown; the number of the others is stated."""


def html_table(sentence: str, heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a sentence, and a table below it; everything is escaped."""
    listed = list(rows)
    head = "".join(f"<th>{escape(str(cell))}</th>" for cell in heading)
    body = "".join(f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in listed[:MOST_ROWS])
    more = f"<p>{len(listed) - MOST_ROWS} more rows</p>" if len(listed) > MOST_ROWS else ""
    return f"<p>{escape(sentence)}</p><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def number(value: float | None, digits: int = 4) -> str:
    """Format a number for reading; an en dash for None and NaN."""
    return "–" if value is None or value != value else f"{value:.{digits}g}"

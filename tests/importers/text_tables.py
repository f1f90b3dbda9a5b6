"""Lines of tables of text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def lines(form: str, *columns: Sequence[object] | np.ndarray) -> list[str]:
    """One line for each row, by a format of `str.format`; columns of numbers (n,) or (n, k)."""
    flat: list[Sequence[object]] = []
    for column in columns:
        values = np.asarray(column)
        flat += [values] if values.ndim == 1 else list(values.T)
    return [form.format(*row) for row in zip(*flat, strict=True)]


def text(*rows: str) -> str:
    return "\n".join(rows) + "\n"

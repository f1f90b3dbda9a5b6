"""Writing the recomputation down: one JSON object, one CSV file per table, and figures where matplotlib is installed.

All names are known before anything is written, so that either every file may be written or none is.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Any

from imuarray.atomic import write_text
from imuarray.errors import ImuArrayError, OutputExistsError
from imuarray.paper.results import TABLES


def can_draw() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def as_json(result: Mapping[str, Any]) -> str:
    """The result as indented JSON text, every number finite."""
    return json.dumps(result, indent=2, allow_nan=False) + "\n"


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV text with the columns of all rows in order of appearance; spaces part the items of a list."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    text = StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({column: _cell(value) for column, value in row.items()} for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    return " ".join(map(str, value)) if isinstance(value, list) else value


def write(result: Mapping[str, Any], directory: Path, *, force: bool) -> tuple[Path, ...]:
    """Write `paper.json`, `table1.csv` ... `table11.csv`, `pairs.csv` and, if `can_draw()`, the figures.

    The directory is made if it is missing. OutputExistsError when a file exists and `force` is false, before anything
    is written; ImuArrayError, naming the place, when it can't be written.
    """
    texts = {"paper.json": as_json(result)} | {f"{name}.csv": as_csv(result[name]) for name in (*TABLES, "pairs")}
    try:
        return _write_all(texts, result, directory, force=force)
    except OSError as error:
        raise ImuArrayError(f"{error.filename or directory}: {error.strerror or error}") from error


def _write_all(
    texts: Mapping[str, str], result: Mapping[str, Any], directory: Path, *, force: bool
) -> tuple[Path, ...]:
    drawings = _drawings()
    paths = [directory / name for name in (*texts, *drawings)]
    if not force and (taken := next((path for path in paths if path.exists()), None)):
        raise OutputExistsError(taken)
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_text(directory / name, text, force=True)
    for name, draw in drawings.items():
        draw(result, directory / name)
    return tuple(paths)


def _drawings() -> Mapping[str, Any]:
    if not can_draw():
        return {}
    from imuarray.paper.figures import FIGURES  # matplotlib is slow to import and optional

    return FIGURES

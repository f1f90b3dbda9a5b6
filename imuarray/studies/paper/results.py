"""The whole recomputation as one JSON-ready object, as a text of at most 100 columns, and as files.

Files are one JSON object, one CSV file per table and, with matplotlib, figures. All names are checked before anything
is written, so that either every file is written or none.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Context, localcontext
from io import StringIO
from pathlib import Path
from textwrap import wrap
from typing import Any

from imuarray.atomic import write_text
from imuarray.errors import ImuArrayError, OutputExistsError
from imuarray.studies.paper import systematic, variation
from imuarray.studies.paper.conclusions import conclusions, slips, stated
from imuarray.studies.paper.tables import RecomputedRow, tally
from imuarray.studies.paper.variation import derived, readings

SOURCE = (
    "H. Martin, P. Groves, M. Newman, R. Faragher, A New Approach to Better Low-Cost MEMS IMU Performance Using Sensor "
    "Arrays, 26th International Technical Meeting of the Satellite Division of The Institute of Navigation "
    "(ION GNSS+ 2013), Nashville, Tennessee, September 2013"
)
"""The paper whose Tables 1 to 11 are recomputed."""

TABLES: dict[str, Callable[[], tuple[RecomputedRow, ...]]] = {
    "table1": systematic.table1,
    "table2": systematic.table2,
    "table3": systematic.table3,
    "table4": systematic.table4,
    "table5": variation.table5,
    "table6": variation.table6,
    "table7": variation.table7,
    "table8": systematic.table8,
    "table9": systematic.table9,
    "table10": variation.table10,
    "table11": variation.table11,
}
"""The paper's tables, each with its recomputation from the others."""

FURTHER: dict[str, Callable[[], tuple[RecomputedRow, ...]]] = {"derived": derived, "stated": stated}
"""Further columns of Tables 2, 9 and 11, and figures in the text: a row per number."""

_DIGITS = Context(prec=34)


def recomputed_rows() -> dict[str, tuple[RecomputedRow, ...]]:
    """Return all rows of `TABLES` and `FURTHER` by name; a caller's decimal context does not matter."""
    with localcontext(_DIGITS):
        return {name: build() for name, build in (TABLES | FURTHER).items()}


def recompute() -> dict[str, Any]:
    """Recompute the paper from its published tables.

    `table1` ... `table11` hold rows with the CSV files' column names; a recomputed column `x` is followed by the
    printed one as `printed_x`, and is rounded to the same digits if both agree. `matches` counts for each table and
    column [equal to the printed digits, all], `within_input_rounding` [explained by the rounding of the printed inputs,
    all]. `derived` and `stated` are further columns and the figures of the text, one row each, with the difference,
    both verdicts and the derivation. `pairs`, `boot_fault`, `bias_states`, `blending`, `planes`, `logging_rate`,
    `readings` and `range_over_deviation` are results that have no printed column; `slips` and `conclusions` are lists
    of {claim, evidence, holds}; `source` is the citation.
    """
    tables = recomputed_rows()
    with localcontext(_DIGITS):
        states = variation.bias_states()
        return {
            "source": SOURCE,
            "matches": _tallies(tables, within_input_rounding=False),
            "within_input_rounding": _tallies(tables, within_input_rounding=True),
            **{name: [row.as_json() for row in rows] for name, rows in tables.items()},
            "pairs": [pair.as_json() for pair in systematic.pairs()],
            "boot_fault": [fault.as_json() for fault in variation.boot_faults()],
            "bias_states": {
                "sensor": "Gyro3",
                "states": [state.as_json() for state in states],
                "separation": round(variation.separation(states), 2),
            },
            "blending": variation.bma180_blend().as_json(),
            "planes": variation.planes(),
            "logging_rate": variation.logging_rate(),
            "readings": [reading.as_json() for reading in readings()],
            "range_over_deviation": variation.range_over_deviation(),
            "slips": [vars(statement) for statement in slips()],
            "conclusions": [vars(statement) for statement in conclusions()],
        }


def _tallies(
    tables: dict[str, tuple[RecomputedRow, ...]], *, within_input_rounding: bool
) -> dict[str, dict[str, list[int]]]:
    counts = {name: tally(rows, within_input_rounding=within_input_rounding) for name, rows in tables.items()}
    return {name: count for name, count in counts.items() if count}


_WIDTH = 100
_TITLES = {
    "table1": "Table 1 orientation",
    "table2": "Table 2 gyroscopes, fast",
    "table3": "Table 3 accelerometers",
    "table4": "Table 4 gyroscopes",
    "table5": "Table 5 in-run",
    "table9": "Table 9 gyroscope noise",
    "table11": "Table 11 turn-on",
    "derived": "Tables 2, 9, 11, further",
    "stated": "figures in the text",
}
_NO_BREAK = "\N{NO-BREAK SPACE}"


def render_text(result: dict[str, Any]) -> str:
    """Return the matches by table, key numbers, slips and conclusions of a `recompute()` result, in lines of at most
    100 columns.
    """
    heading = ["The paper, recomputed from its own tables", *wrap(result["source"], _WIDTH)]
    parts = (heading, _matches(result), _key_numbers(result), _slips(result), _conclusions(result))
    return "\n".join(line for part in parts for line in (*part, "")).rstrip() + "\n"


def _matches(result: dict[str, Any]) -> Iterator[str]:
    yield "Recomputed cells equal to the printed digits, and explained by the rounding of the printed inputs"
    for table, columns in result["matches"].items():
        equal, total = _sums(columns)
        explained, _ = _sums(result["within_input_rounding"][table])
        short = ", ".join(f"{name} {count[0]}/{count[1]}" for name, count in columns.items() if count[0] < count[1])
        head = f"  {_TITLES.get(table, table):<24} {equal:>3} of {total:>3} equal, {explained:>3} explained  "
        yield from hanging(head, short.replace(" ", _NO_BREAK).replace(f",{_NO_BREAK}", ", ") or "all")


def _sums(columns: dict[str, list[int]]) -> tuple[int, int]:
    return sum(count[0] for count in columns.values()), sum(count[1] for count in columns.values())


def _key_numbers(result: dict[str, Any]) -> Iterator[str]:
    yield "Key numbers"
    for label, text in _key_lines(result):
        yield from hanging(f"  {label:<18}", text)


def _key_lines(result: dict[str, Any]) -> Iterator[tuple[str, str]]:
    rate, blend = result["logging_rate"], result["blending"]
    gyros = [pair for pair in result["pairs"] if pair["first"].startswith("Gyro")]
    yield "gyroscope pairs", "; ".join(map(_pair, gyros)) + " LSB/degC"
    yield (
        "BMA180 blending",
        f"{blend['low_mg']:.2f} mg at 1.5 g, {blend['high_mg']:.2f} at 16 g; weights {blend['weight_low']:.2f}/"
        f"{blend['weight_high']:.2f} give {blend['weighted_mg']:.2f}, the plain average "
        f"{blend['plain_average_mg']:.2f}",
    )
    planes = [plane for plane in result["planes"] if plane["design"] == "ADXL"]
    yield "ADXL345 z over xy", ", ".join(f"noise {p['noise_z_over_xy']:.2f} ({p['sensor']})" for p in planes)
    yield (
        "logging rate",
        f"{rate['table10_hz']['mean']:.1f} Hz (Table 10), {rate['table11_hz']['mean']:.1f} Hz (Table 11)",
    )
    yield (
        "standard errors",
        "; ".join(
            f"{results['table']} {results['log']}: {results['least']} to {results['most']} readings"
            for results in result["readings"]
        ),
    )
    for fault in result["boot_fault"]:
        yield (
            "boot fault",
            f"{fault['sensor']} run {fault['run']}: {fault['ratio']:.2f} times the median, as at "
            f"+-{fault['nearest_range']}",
        )
    states = result["bias_states"]["states"]
    yield (
        "Gyro3 states",
        " and ".join(f"({', '.join(f'{c:.1f}' for c in s['centre_lsb'])}) in {len(s['runs'])} runs" for s in states),
    )


def _pair(pair: dict[str, Any]) -> str:
    less = f"{pair['reduction']:.0f} times less" if pair["reduction"] > 1 else "no less"
    return f"{pair['box_axis'].lower()} {pair['relation']} {abs(pair['fused_slope_lsb_per_degc']):.3f} ({less})"


def _slips(result: dict[str, Any]) -> Iterator[str]:
    slips = [slip for slip in result["slips"] if not slip["holds"]]
    yield f"Slips of the paper: {len(slips)} (all evidence: --json)"
    for slip in slips:
        yield from hanging("  - ", slip["claim"])
        yield from hanging("    > ", _first_clause(slip))


def _conclusions(result: dict[str, Any]) -> Iterator[str]:
    holding = sum(conclusion["holds"] for conclusion in result["conclusions"])
    yield f"Conclusions of the paper: {holding} of {len(result['conclusions'])} hold (evidence and criteria: --json)"
    for conclusion in result["conclusions"]:
        yield from hanging("  yes " if conclusion["holds"] else "  NO  ", conclusion["claim"])
        if not conclusion["holds"]:
            yield from hanging("      > ", _first_clause(conclusion))


def _first_clause(statement: dict[str, Any]) -> str:
    return str(statement["evidence"]).partition("; ")[0]


def hanging(head: str, text: str) -> list[str]:
    """Return a text in lines of at most 100 columns, the first of which begins with `head`; the others are indented."""
    lines = wrap(text, _WIDTH, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False)
    return [line.replace(_NO_BREAK, " ") for line in lines]


def as_json(result: Mapping[str, Any]) -> str:
    """Return the result as indented JSON text, every number finite."""
    return json.dumps(result, indent=2, allow_nan=False) + "\n"


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as CSV text with all columns in order of appearance; items of a list are separated by spaces."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    text = StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {column: (" ".join(map(str, value)) if isinstance(value, list) else value) for column, value in row.items()}
        for row in rows
    )
    return text.getvalue()


def write(result: Mapping[str, Any], directory: Path, *, force: bool) -> tuple[Path, ...]:
    """Write `paper.json`, `table1.csv` ... `table11.csv`, `pairs.csv` and, if `can_draw()`, the figures.

    The directory is created if it is missing. OutputExistsError if a file exists and `force` is false, before anything
    is written; ImuArrayError, which names the place, if a file cannot be written.
    """
    from imuarray.figures import can_draw  # imports NumPy, which recomputing does not need

    texts = {"paper.json": as_json(result)} | {f"{name}.csv": as_csv(result[name]) for name in (*TABLES, "pairs")}
    drawings: Mapping[str, Any] = {}
    if can_draw():
        from imuarray.studies.paper.figures import FIGURES  # matplotlib is slow to import and optional

        drawings = FIGURES
    paths = [directory / name for name in (*texts, *drawings)]
    if not force and (existing := next((path for path in paths if path.exists()), None)):
        raise OutputExistsError(existing)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            write_text(directory / name, text, force=True)
        for name, draw in drawings.items():
            draw(result, directory / name)
    except OSError as error:
        raise ImuArrayError(f"{error.filename or directory}: {error.strerror or error}") from error
    return tuple(paths)

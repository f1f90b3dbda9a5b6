"""The recomputation as a page that a person reads in half a minute, at most 100 columns wide."""

from __future__ import annotations

from collections.abc import Iterator
from textwrap import wrap
from typing import Any

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
    """Matches per table, key numbers, slips and conclusions of a `recompute()` result, lines of at most 100 columns."""
    parts = (_heading(result), _matches(result), _key_numbers(result), _slips(result), _conclusions(result))
    return "\n".join(line for part in parts for line in (*part, "")).rstrip() + "\n"


def _heading(result: dict[str, Any]) -> Iterator[str]:
    yield "The paper, recomputed from its own tables"
    yield from wrap(result["source"], _WIDTH)


def _matches(result: dict[str, Any]) -> Iterator[str]:
    yield "Recomputed cells equal to the printed digits, and explained by the rounding of the printed inputs"
    for table, columns in result["matches"].items():
        equal, total = _sums(columns)
        explained, _ = _sums(result["within_input_rounding"][table])
        short = ", ".join(f"{name} {count[0]}/{count[1]}" for name, count in columns.items() if count[0] < count[1])
        head = f"  {_TITLES.get(table, table):<24} {equal:>3} of {total:>3} equal, {explained:>3} explained  "
        yield from _hanging(head, short.replace(" ", _NO_BREAK).replace(f",{_NO_BREAK}", ", ") or "all")


def _sums(columns: dict[str, list[int]]) -> tuple[int, int]:
    return sum(count[0] for count in columns.values()), sum(count[1] for count in columns.values())


def _key_numbers(result: dict[str, Any]) -> Iterator[str]:
    yield "Key numbers"
    for label, text in _key_lines(result):
        yield from _hanging(f"  {label:<18}", text)


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
            f"{found['table']} {found['log']}: {found['least']} to {found['most']} readings"
            for found in result["readings"]
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
        yield from _hanging("  - ", slip["claim"])
        yield from _hanging("    > ", _first_clause(slip))


def _conclusions(result: dict[str, Any]) -> Iterator[str]:
    held = sum(conclusion["holds"] for conclusion in result["conclusions"])
    yield f"Conclusions of the paper: {held} of {len(result['conclusions'])} hold (evidence and criteria: --json)"
    for conclusion in result["conclusions"]:
        yield from _hanging("  yes " if conclusion["holds"] else "  NO  ", conclusion["claim"])
        if not conclusion["holds"]:
            yield from _hanging("      > ", _first_clause(conclusion))


def _first_clause(statement: dict[str, Any]) -> str:
    return str(statement["evidence"]).partition("; ")[0]


def _hanging(head: str, text: str) -> list[str]:
    lines = wrap(text, _WIDTH, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False)
    return [line.replace(_NO_BREAK, " ") for line in lines]

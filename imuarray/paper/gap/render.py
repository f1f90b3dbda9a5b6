"""The diagnosis for a terminal, lines of at most 100 columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from textwrap import wrap
from typing import Any

from imuarray.paper.gap.candidate import Discrepancy
from imuarray.paper.gap.result import LIMIT, PaperGap

_WIDTH = 100
_CANDIDATES = 4
_CHECKS = 8


def render_text(gap: PaperGap) -> str:
    """Verdict, tables, causes, candidates and checks, and what is left."""
    found = gap.as_json()
    parts = (_head(gap, found), _tables(found), _causes(found), _discrepancies(gap), _left(gap, found))
    return "\n".join(line for part in parts for line in (*part, "")).rstrip() + "\n"


def _head(gap: PaperGap, found: Mapping[str, Any]) -> Iterator[str]:
    size = found["gap"]
    yield "The data sheets' array against the paper's tables"
    misfits = (
        f"{size['before']:.1f} before, {size['fitted']:.1f} with noise and slopes fitted, {size['after']:.1f} after"
    )
    yield f"  {found['verdict']}: misfit {misfits}; 1 is right"
    same = _share(size["closed_one_yardstick"], size["closed_one_yardstick_ci95"])
    yield f"  closed {_share(size['closed'], size['closed_ci95'])}; by the wider of both scatters {same}"
    off = [sum(abs(row.z) > LIMIT for row in rows) for rows in (gap.before, gap.after)]
    yield f"  {off[0]} of {len(gap.before)} statistics more than {LIMIT:g} deviations off before, {off[1]} after"


def _tables(found: Mapping[str, Any]) -> Iterator[str]:
    yield f"{'':<14}{'numbers':>8}{'chi2/n before':>15}{'after':>10}{'misfit before':>15}{'after':>7}{'|z| > 3':>12}"
    for name, row in found["tables"].items():
        chi = [row[f"chi_square_{when}"] / row["degrees"] for when in ("before", "after")]
        yield (
            f"  {name:<12}{row['statistics']:>8}{chi[0]:>15.4g}{chi[1]:>10.3g}{row['misfit_before']:>15.2f}"
            f"{row['misfit_after']:>7.2f}{row['beyond_3_before']:>6} ->{row['beyond_3_after']:>3}"
        )


def _causes(found: Mapping[str, Any]) -> Iterator[str]:
    yield "Causes, by the share of the whole misfit that opens again without them"
    for cause in found["causes"]:
        confusable = f"; or {', '.join(cause['confusable_with'])}" if cause["confusable_with"] else ""
        yield (
            f"  {cause['effect']:<17}{cause['discrepancy']:<20}p {cause['probability']:.2f}  "
            f"closes {_share(cause['closed'], cause['closed_ci95'])}{confusable}"
        )


def _share(share: float | None, interval: list[float] | None) -> str:
    if share is None or interval is None:
        return "nothing"
    return f"{share:.1%} [{interval[0]:.1%}, {interval[1]:.1%}]"


def _discrepancies(gap: PaperGap) -> Iterator[str]:
    for cause in gap.causes:
        yield from _discrepancy(cause.found)


def _discrepancy(found: Discrepancy) -> Iterator[str]:
    worst = max(found.before, key=lambda row: abs(row.z))
    yield f"{found.name} ({found.about})"
    yield from _hanging(
        "  worst  ",
        f"{worst.table} {worst.channel} {worst.statistic}: printed {worst.published:g}, expected "
        f"{worst.simulated:.4g} +- {worst.uncertainty:.2g}{' (ln)' if worst.scale == 'log' else ''}, z {worst.z:.3g}",
    )
    for one in found.ranked[:_CANDIDATES]:
        left = one.candidate.impossible or one.candidate.leaves
        text = f"BIC {one.bic:.1f}, k {one.candidate.free}, p {one.probability:.2g}{f'; leaves {left}' if left else ''}"
        yield from _hanging(f"  {one.candidate.label:<29}", text)
    for check in found.held_out[:_CHECKS]:
        yield from _hanging("  held out  ", _check(check))
    yield from _beyond_data_sheet(found)


def _beyond_data_sheet(found: Discrepancy) -> Iterator[str]:
    """Slopes that the data sheet doesn't allow."""
    rows: Any = found.facts.get("slopes", ())
    texts = [
        f"{row['channel']} {1e3 * row[key]:.2f} +- {1e3 * row['error']:.2f} (limit {1e3 * row['data_sheet_limit']:.2f})"
        for row in rows
        for key in row
        if key.startswith("slope_") and row["beyond_limit"]
    ]
    if rows:
        allowed = f"{len(rows) - len(texts)} of {len(rows)} slopes are within the data sheets' limits"
        beyond = f"; not {', '.join(texts)}, mg or mdps per degC" if texts else ""
        yield from _hanging("  allowed   ", allowed + beyond)


def _check(check: Mapping[str, object]) -> str:
    numbers = [f"{key} {_number(value)}" for key, value in check.items() if key not in ("check", "unit")]
    return f"{check['check']}: {', '.join(numbers)}" + (f" {check['unit']}" if "unit" in check else "")


def _number(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_number(one)}" for key, one in value.items())
    if isinstance(value, list | tuple):
        return f"[{', '.join(_number(one) for one in value)}]"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _left(gap: PaperGap, found: Mapping[str, Any]) -> Iterator[str]:
    yield f"Not explained: {len(gap.unexplained)} statistics (p of something unknown up to {found['unknown']:.3f})"
    kinds = Counter((row.table, row.statistic.split()[0]) for row in gap.unexplained)
    yield from _hanging("  ", ", ".join(f"{table} {name} {count}" for (table, name), count in kinds.most_common(12)))
    for row in [row for row in gap.unexplained if not row.derived][:8]:
        yield (
            f"  {row.table:<9}{row.channel:<12}{row.statistic:<20}printed {row.published:>9.5g}, after "
            f"{row.simulated:>9.5g}, z {row.z:>7.1f}"
        )
    if found["next_experiment"]:
        yield from _hanging("Next: ", found["next_experiment"])


def _hanging(head: str, text: str) -> list[str]:
    return wrap(text, _WIDTH, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False)

"""The report of `imuarray calibrate compare`."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from imuarray.printable import counted, printable

if TYPE_CHECKING:
    from imuarray.calibrate.comparison import CalibrationComparison

_MOST = 40
"""Most changes that are printed."""

_PAIRS = 12
"""Most opposing pairs that are printed."""

_UNITS = {"g": (1e3, "mg"), "dps": (1.0, "dps"), "g/degC": (1e3, "mg/degC"), "gauss": (1e3, "mgauss")}


def report_of(comparison: CalibrationComparison) -> dict[str, Any]:
    """Return the whole comparison, JSON-ready."""
    return {
        "calibrations": list(comparison.names),
        "changes": [{**asdict(change), "changed": change.changed} for change in comparison.changes],
        "common": [asdict(row) for row in comparison.common],
        "opposed": [asdict(row) for row in comparison.opposed],
    }


def print_report(report: dict[str, Any]) -> None:
    """Print the changes, the largest first, the common part of biases, and what opposing axes cancel."""
    for number, name in enumerate(report["calibrations"], start=1):
        click.echo(printable(f"{number}: {name}"))
    _print_changes(report["changes"])
    if report["common"]:
        click.echo(
            "standard deviation of biases over the calibrations: the part common to all units of a design, and that of"
            " each unit"
        )
        for row in report["common"]:
            factor, unit = _describe_value(row["unit"])
            units = counted(len(row["units"]), "unit")
            click.echo(
                printable(
                    f"  {row['chip']:24} {row['axis']}: common {factor * row['common']:8.3f}, own"
                    f" {factor * row['own']:8.3f} {unit}, p {row['p_value']:.2g}   ({units})"
                )
            )
    if report["opposed"]:
        click.echo(
            "opposing axes, best pairs first: rms change of each alone and of their mean"
            + ("; p: probability of such a correlation" if report["opposed"][0]["p_value"] is not None else "")
        )
        rows = sorted(report["opposed"], key=lambda row: row["together"] / row["alone"] if row["alone"] else 1.0)
        for row in rows[:_PAIRS]:
            factor, unit = _describe_value(row["unit"])
            chance = "" if row["p_value"] is None else f", p {row['p_value']:.2g}"
            click.echo(
                printable(
                    f"  {row['first']} and {row['second']} along {row['box_axis']}: {factor * row['alone']:.3f} alone,"
                    f" {factor * row['together']:.3f} {unit} together{chance}"
                )
            )
        if len(rows) > _PAIRS:
            click.echo(f"  {len(rows) - _PAIRS} more pairs (--json lists all)")


def _print_changes(changes: list[dict[str, Any]]) -> None:
    changed = sorted((row for row in changes if row["changed"]), key=lambda row: -row["sigmas"])
    if changed:
        click.echo(
            f"{'axis':14} {'figure':14} {'from':>12} {'to':>12} {'change':>12}        {'sigmas':>7} {'p':>8}   files"
        )
    for row in changed[:_MOST]:
        factor, unit = _describe_value(row["unit"])
        values = dict(zip(row["calibrations"], row["values"], strict=True))
        first, last = (factor * values[row[end]] for end in ("first", "last"))
        click.echo(
            printable(
                f"{row['sensor'] + ' ' + row['axis']:14} {row['figure']:14} {first:12.4f} {last:12.4f}"
                f" {factor * row['difference']:+12.4f} {unit:7} {row['sigmas']:6.1f} {row['p_value']:8.2g}"
                f"   {row['first'] + 1} to {row['last'] + 1}"
            )
        )
    if len(changed) > _MOST:
        click.echo(f"{len(changed) - _MOST} more changes (--json lists all)")
    click.echo(f"{len(changes) - len(changed)} of {len(changes)} figures agree within their standard errors")


def _describe_value(unit: str) -> tuple[float, str]:
    return _UNITS.get(unit, (1.0, unit))

"""The report of `imuarray calibrate axes`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from imuarray.calibrate.pointing import Pointing


def report_of(pointings: Sequence[Pointing], before: dict[str, str]) -> dict[str, Any]:
    """Return every sensor's axes before and now, JSON-ready; an empty text where they could not be determined.

    `left` is the former name of `residual`, for programs that read it.
    """
    return {"sensors": [{**asdict(each), "left": each.residual, "before": before[each.sensor]} for each in pointings]}


def print_report(report: dict[str, Any]) -> None:
    """The same as a table."""
    click.echo(f"{'sensor':12} {'axes':8} {'residual':>8} {'next best':>9}")
    for row in report["sensors"]:
        note = row["reason"] and f"  not determined: {row['reason']}; {row['before']} kept"
        fit = f"{row['residual'] or 0:8.2f} {row['next_best'] or 0:9.2f}" if row["axes"] else ""
        click.echo(f"{row['sensor']:12} {row['axes'] or '?':8} {fit}{note}".rstrip())

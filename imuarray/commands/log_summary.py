"""The summary that `imuarray log` prints when a recording is over."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.commands.options import print_json
from imuarray.log.missed_frames import BUS_WAS_LATE
from imuarray.printable import counted

if TYPE_CHECKING:
    from imuarray.acquire import Summary
    from imuarray.fuse.live_fusion import LiveFusion

_CARRIES = ("bus", "channel", "link", "adapter", "refused")
"""Kinds of events of no one sensor that cost readings."""
_NAMED = 3


def print_summary(
    summary: Summary, output: Path, start_up: list[str], fusion: LiveFusion | None, as_json: bool
) -> None:
    """Print what was recorded, as text or JSON; `start_up` holds the sentences on how sensors started."""
    lost = {name: count for name, count in summary.lost.items() if count}
    if as_json:
        print_json(
            {
                "log": str(output),
                "logs": [str(path) for path in summary.logs],
                "frames": summary.frames,
                "late": summary.late,
                "missed": summary.missed,
                "missed_by_bus": summary.missed_by_bus,
                "uncertain": summary.uncertain,
                "refused": summary.refused,
                "lost": lost,
                "silent": summary.silent,
                "seconds": summary.seconds,
                "start_up": start_up,
                **({"fusion": fusion.report()} if fusion else {}),
            }
        )
        return
    rate = summary.frames / summary.seconds if summary.seconds else 0.0
    where = output if len(summary.logs) == 1 else f"{summary.logs[0]} ... {summary.logs[-1].name}"
    click.echo(f"{where}: {summary.frames} frames in {summary.seconds:.1f} s ({rate:.1f} Hz), {summary.late} late")
    if fusion:
        files = fusion.paths or [fusion.path]
        named = files[0] if len(files) == 1 else f"{files[0]} ... {files[-1].name}"
        click.echo(f"  {named}: {counted(fusion.frames, 'frame')} fused while recording")
    if summary.missed:
        click.echo(f"  {counted(summary.missed, 'frame')} missed: {_why_missed(summary)}")
    if summary.uncertain:
        click.echo(f"  {counted(summary.uncertain, 'reading')} with a time that is uncertain by a millisecond or more")
    if summary.refused:
        click.echo(
            f"  {counted(summary.refused, 'frame')} of the link rejected: old, repeated, out of order or unsolicited"
        )
    for name, count in lost.items():
        first, *further = _logs_with_events(summary.logs, name)
        more = f", {', '.join(path.name for path in further[:_NAMED])}" if further else ""
        more += f" and {len(further) - _NAMED} more" if len(further) > _NAMED else ""
        click.echo(f"  {name}: {counted(count, 'reading')} lost (see events: imuarray info {first}{more})")


def _why_missed(summary: Summary) -> str:
    """The cause of the missed frames: the bus, this machine, or both."""
    busy = "the array can't be read this fast, or this machine was busy"
    if not summary.missed_by_bus:
        return busy
    if summary.missed_by_bus == summary.missed:
        return f"{BUS_WAS_LATE}; check its wires and pull-up resistors"
    return f"{summary.missed_by_bus} because {BUS_WAS_LATE}, {summary.missed - summary.missed_by_bus} because {busy}"


def _logs_with_events(logs: Sequence[Path], sensor: str) -> list[Path]:
    """The logs with events about a sensor, or about what carries its readings; all of them if there are none."""
    from imuarray.log import open_log

    if len(logs) == 1:
        return list(logs)
    matching = []
    for path in logs:
        with open_log(path) as log:
            if any(event.sensor == sensor or (not event.sensor and event.kind in _CARRIES) for event in log.events):
                matching.append(path)
    return matching or list(logs)

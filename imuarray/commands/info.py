"""`imuarray info`."""

from __future__ import annotations

from pathlib import Path
from shutil import get_terminal_size
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

from imuarray.commands.options import json_option, log_argument, print_json
from imuarray.printable import counted, printable

if TYPE_CHECKING:
    from imuarray.log import Log, SensorLog

_SAMPLED = 1 << 16


@click.command("info")
@log_argument
@json_option
def command(run: Path, as_json: bool) -> None:
    """Show the contents of a log: sensors, rates, phases, flags, events.

    \b
    imuarray info run.h5
    """
    from imuarray.log import Log

    with Log(run) as log:
        summary = describe(log)
    if as_json:
        print_json(summary)
    else:
        _print(summary)


def describe(log: Log) -> dict[str, Any]:
    """Return the summary of a log, JSON-ready."""
    from imuarray.log.missed_frames import frame_timing

    timing = frame_timing(log)
    return {
        "log": str(log.path),
        "state": log.state,
        "losses": list(log.losses),
        "source": log.source,
        "epoch": log.epoch,
        "dated": log.is_dated,
        **_span(log),
        "software": log.software,
        "frame_rate_hz": log.frame_rate_hz or None,
        "seconds": timing.seconds,
        "missed": timing.missed,
        "sensors": [_sensor(sensor) for sensor in log.sensors.values()],
        "phases": [
            {"name": phase.name, "up": phase.up, "start_s": phase.start_ns * 1e-9, "end_s": phase.end_ns * 1e-9}
            for phase in log.phases
        ],
        "events": [
            {"time_s": event.time_ns * 1e-9, "sensor": event.sensor, "kind": event.kind, "message": event.message}
            for event in sorted(log.events, key=lambda event: event.time_ns)
        ],
        "truth": log.truth is not None,
        "import_report": None if (report := log.import_report) is None else report._asdict(),
    }


def _span(log: Log) -> dict[str, Any]:
    """Return the wall times of the first and last rows: a part of a rotated log begins after its epoch."""
    rows = [sensor for sensor in log.sensors.values() if len(sensor)]
    first = min((int(sensor.time[0]) for sensor in rows), default=None)
    last = max((int(sensor.time[-1]) for sensor in rows), default=None)
    return {
        "starts_s": 0.0 if first is None else first * 1e-9,
        "begins": _wall_time(log.epoch, first),
        "ends": _wall_time(log.epoch, last),
    }


def _wall_time(epoch: str, at_ns: int | None) -> str | None:
    """Return a time in ISO 8601 (UTC); None for a log without rows or without a date."""
    from datetime import timedelta

    from imuarray.wall_time import iso_text, wall_time

    if at_ns is None or (zero := wall_time(epoch)) is None:
        return None
    try:
        return iso_text(zero + timedelta(microseconds=at_ns // 1000), "milliseconds")
    except OverflowError:
        return None


def _sensor(sensor: SensorLog) -> dict[str, Any]:
    rows = len(sensor)
    seconds = float(sensor.time[-1] - sensor.time[0]) * 1e-9 if rows > 1 else 0.0
    return {
        "name": sensor.name,
        "chip": sensor.chip,
        "quantity": sensor.quantity,
        "range": sensor.range,
        "unit": sensor.unit,
        "axes": sensor.axes,
        "rows": rows,
        "seconds": seconds,
        "rate_hz": (rows - 1) / seconds if seconds else 0.0,
        "time_uncertainty_s": _time_uncertainty(sensor),
        "flags": {name: count for name, count in sensor.flagged().items() if count},
    }


def _time_uncertainty(sensor: SensorLog) -> dict[str, float] | None:
    """Return the median (of about `_SAMPLED` rows at most) and maximum of `time_uncertainty`; None if it is missing."""
    import numpy as np

    column = sensor.time_uncertainty
    if column is None or not len(sensor):
        return None
    step = len(sensor) // _SAMPLED + 1
    sampled, largest = [], 0.0
    for block in sensor.blocks():
        uncertainty_s = np.asarray(column[block], float)
        sampled.append(uncertainty_s[::step])
        largest = max(largest, float(uncertainty_s.max()))
    return {"median": float(np.median(np.concatenate(sampled))), "max": largest}


def _print(summary: dict[str, Any]) -> None:
    emulated = " (no hardware)" if summary["source"] == "emulated" else ""
    dated = summary["dated"]
    imported = summary["source"] == "imported"
    start_text = ", without a date" if not dated else "" if imported else f", from {summary['epoch']}"
    _print_line(f"{summary['log']}: {summary['source']}{emulated}{start_text}, written by {summary['software']}")
    if summary["begins"] and dated:
        _print_line(f"  rows from {summary['begins']} to {summary['ends']}, {summary['seconds']:.1f} s")
    elif summary["begins"]:
        _print_line(f"  rows over {summary['seconds']:.1f} s")
    if summary["state"] != "finished":
        hint = f"; `imuarray recover {summary['log']}` finishes it" if summary["state"] == "interrupted" else ""
        readable = "all readable rows" if summary["losses"] else "all acknowledged rows"
        _print_line(f"  {summary['state']}: {readable} are shown{hint}")
    for loss in summary["losses"]:
        _print_line(f"  {loss}")
    if imported and summary["import_report"] is None:
        _print_line(f"  `imuarray report {summary['log']} -o report.html` lists the doubts about the import, if any")
    if summary["frame_rate_hz"]:
        missed = "" if summary["missed"] is None else f", {counted(summary['missed'], 'frame')} missed"
        _print_line(f"  {summary['frame_rate_hz']:g} frames per second requested{missed}")
    names, chips = (
        max([least, *(len(sensor[key]) for sensor in summary["sensors"])])
        for key, least in (("name", 12), ("chip", 10))
    )
    for sensor in summary["sensors"]:
        scale = f"+-{sensor['range']:g} {sensor['unit']}" if sensor["range"] else "no range"
        times = ""
        if (uncertainty := sensor["time_uncertainty_s"]) is not None:
            median_us, most_us = 1e6 * uncertainty["median"], 1e6 * uncertainty["max"]
            times = f"times known within {median_us:.0f} us (at worst {most_us:.0f} us)  "
        flags = ", ".join(f"{count} {name}" for name, count in sensor["flags"].items())
        _print_line(
            f"  {sensor['name']:{names}} {sensor['chip']:{chips}} {sensor['quantity']:15} {scale:12} {sensor['axes']:8}"
            f" {sensor['rows']:8d} rows {sensor['rate_hz']:7.2f} Hz  {times}{flags}".rstrip()
        )
    zero_s = summary["starts_s"] if dated and imported else 0.0  # instead of seconds since 1970
    for phase in summary["phases"]:
        up_text = f" ({phase['up']} up)" if phase["up"] else ""
        start_s, end_s = phase["start_s"] - zero_s, phase["end_s"] - zero_s
        _print_line(f"  phase {phase['name']:12} {start_s:9.1f} s to {end_s:9.1f} s{up_text}")
    for event in summary["events"][:20]:
        _print_line(f"  event {event['time_s'] - zero_s:9.3f} s {event['sensor']} {event['kind']}: {event['message']}")
    for mark, kinds in (("~", ("facts", "remarks", "quirks")), ("?", ("doubts",))):
        for kind in kinds if summary["import_report"] else ():
            for text in summary["import_report"][kind]:
                _print_line(f"  {mark} {text}")
    if len(summary["events"]) > 20:
        _print_line(f"  and {len(summary['events']) - 20} more events (--json lists all)")


_UNLIMITED = 1 << 20
"""Width in characters of an output that is not a terminal, if COLUMNS is not set: lines are not wrapped."""

_LEAST_WIDTH = 40


def _print_line(text: str) -> None:
    """Print a line with control characters escaped, because it may contain text from a file. A line that is wider
    than the terminal is continued on indented lines.
    """
    width = max(get_terminal_size((_UNLIMITED, 24)).columns, _LEAST_WIDTH)
    for line in wrap(printable(text), width, subsequent_indent=" " * 6, break_on_hyphens=False, break_long_words=False):
        click.echo(line)

"""A snapshot as lines of text for a terminal, with the contents of the page, in at least 80 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from imuarray.monitor.snapshot import SensorView, Snapshot
from imuarray.printable import counted, duration, percent, printable
from imuarray.units import READABLE_SI

COLUMNS = 80
EVENTS = 5
"""Largest number of events that are shown."""

_SIGNS = {"specific_force": "force", "angular_rate": "rate"}
_GIB = 1 << 30
_NUMBERS = 70
"""Width of the table without the names, in characters."""


def text_lines(snapshot: Snapshot, columns: int = COLUMNS) -> list[str]:
    """Return the snapshot in lines of at most `columns` (80 or more), without control characters."""
    lines = _wrap(_head(snapshot), columns, first="")
    if snapshot.remark:
        lines += _wrap(printable(snapshot.remark), columns)
    if snapshot.begins_ns is None:
        return lines
    if snapshot.health is not None:
        advice = f": {snapshot.health.advice}" if snapshot.health.advice else ""
        lines += _wrap(f"health {snapshot.health.level}: {snapshot.health.reason}{advice}", columns)
    lines += [*_figures(snapshot, columns), "", *_sensors(snapshot.sensors, columns), ""]
    return [*lines, *_fused_lines(snapshot, columns), *_events(snapshot, columns)]


def _wrap(text: str, columns: int, first: str = "  ") -> list[str]:
    return textwrap.wrap(text, columns, initial_indent=first, subsequent_indent="    ") or [""]


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else text[: max(0, most - 1)] + "…"


def _head(snapshot: Snapshot) -> str:
    span = ""
    if snapshot.begins_ns is not None and snapshot.ends_ns is not None:
        span = f", {duration((snapshot.ends_ns - snapshot.begins_ns) * 1e-9)}"
    phase = f", phase {printable(snapshot.phase)}" if snapshot.phase else ""
    quiet = (
        f", nothing new for {snapshot.quiet_s:.0f} s" if snapshot.quiet_s >= 3 and snapshot.state != "finished" else ""
    )
    return f"{printable(snapshot.path.name)}: {snapshot.state}{span}{phase}{quiet}"


def _figures(snapshot: Snapshot, columns: int) -> list[str]:
    part = "" if snapshot.counted == 1 else f" ({percent(snapshot.counted)} of the log counted)"
    nominal = f" of {snapshot.frame_rate_hz:g} Hz" if snapshot.frame_rate_hz else " Hz"
    frames = f"{counted(snapshot.missed, 'frame')} missed, {snapshot.delayed} delayed{part}"
    kinds = ", ".join(f"{printable(kind)} {count}" for kind, count in (snapshot.events or {}).items())
    disk = snapshot.disk
    remaining = "" if disk is None or disk.left_s is None else f", about {duration(disk.left_s)} of logging"
    room = "disk: not known" if disk is None else f"disk: {disk.free_bytes / _GIB:.1f} GiB free{remaining}"
    total = counted(sum((snapshot.events or {}).values()), "event")
    return [
        f"  {snapshot.rate_hz:.1f}{nominal}, {frames}",
        f"  {room}",
        *_wrap(total + (f": {kinds}" if kinds else ""), columns),
    ]


def _sensors(views: Sequence[SensorView], columns: int) -> list[str]:
    names = [_cut(printable(view.name), max(6, columns - _NUMBERS)) for view in views]
    width = max(6, *map(len, names)) if names else 6
    head = f"  {'sensor':{width}} {'Hz':>6} {'mean of the last second':^26} {'unit':5} {'sd':>7}"
    lines = [f"{head} {'range':>5} {'degC':>6} {'missed':>6}"]
    lines += [f"  {name:{width}} {_sensor(view)}".rstrip() for name, view in zip(names, views, strict=True)]
    if any(view.relative and view.temperature_degc is not None for view in views):
        lines.append("  * only changes are meaningful; the level is unknown")
    return [*lines, *_flags(zip(names, views, strict=True), columns)]


def _sensor(view: SensorView) -> str:
    means = " ".join(f"{value:8.3f}"[:8] for value in view.mean) if view.rows else "no reading"
    if view.rows and view.silent_s is not None:
        means = f"silent {duration(view.silent_s)}"
    noise = f"{view.sd.max():7.4f}"[:7] if len(view.time) > 1 else ""
    use = "" if view.use is None else percent(float(view.use.max()))
    warm = "" if view.temperature_degc is None else f"{view.temperature_degc:.1f}{'*' * view.relative}"
    return f"{view.rate_hz:6.1f} {means:26} {view.unit:5} {noise:>7} {use:>5} {warm:>6} {view.missed:6}"


def _flags(named: Iterable[tuple[str, SensorView]], columns: int) -> list[str]:
    """Return lines on the sensors that have flags among the rows of the last seconds."""
    flagged = [
        f"{name} " + ", ".join(f"{flag.replace('_', ' ')} {count}" for flag, count in view.flags.items())
        for name, view in named
        if view.flags
    ]
    return _wrap("flagged recently: " + "; ".join(flagged), columns) if flagged else []


def _fused_lines(snapshot: Snapshot, columns: int) -> list[str]:
    if snapshot.fused is None:
        return _wrap(f"not fused: {printable(snapshot.not_fused)}", columns)
    fused = snapshot.fused
    scaling = "calibrated" if fused.calibrated else "data sheet's values"
    lines = [f"  fused ({printable(fused.technique)}, {scaling}), box frame, last second"]
    for quantity in fused.triads:
        factor, unit = READABLE_SI[quantity]
        means = " ".join(
            f"{axis} {factor * value:9.3f}" for axis, value in zip("xyz", fused.mean[quantity], strict=True)
        )
        noise = " ".join(f"{factor * value:.3f}" for value in fused.noise[quantity])
        lines.append(f"    {_SIGNS[quantity]:5} {means} {unit:3}  noise {noise}")
    return lines


def _events(snapshot: Snapshot, columns: int) -> list[str]:
    if not snapshot.repeated:
        return []
    lines = ["", "  last events"]
    for event, count, first_ns in snapshot.repeated[:EVENTS]:
        origin = " ".join(word for word in (event.sensor, f"{event.kind}:", event.message) if word)
        times = f"{count} times since {first_ns * 1e-9:.1f} s, " if count > 1 else ""
        lines.append(_cut(f"  {event.time_ns * 1e-9:9.1f} s  {times}{printable(origin)}", columns))
    return lines

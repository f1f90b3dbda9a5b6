"""A snapshot as lines of text: what the page shows, for a terminal, over ssh."""

from __future__ import annotations

from collections.abc import Sequence

from imuarray.monitor.snapshot import SensorView, Snapshot
from imuarray.printable import counted, printable
from imuarray.units import READABLE_SI

EVENTS = 5
"""That are shown."""

_SIGNS = {"specific_force": "specific force", "angular_rate": "angular rate"}
_GIB = 1 << 30


def lines_of(snapshot: Snapshot) -> list[str]:
    """The whole of it; no line steers a terminal."""
    lines = [_head(snapshot)]
    if snapshot.remark:
        lines.append(f"  {printable(snapshot.remark)}")
    if snapshot.begins_ns is None:
        return lines
    return [*lines, *_figures(snapshot), "", *_sensors(snapshot.sensors), "", *_fused(snapshot), *_events(snapshot)]


def _head(snapshot: Snapshot) -> str:
    span = ""
    if snapshot.begins_ns is not None and snapshot.ends_ns is not None:
        span = f", {duration((snapshot.ends_ns - snapshot.begins_ns) * 1e-9)}"
    phase = f", phase {printable(snapshot.phase)}" if snapshot.phase else ""
    quiet = (
        f", nothing new for {snapshot.quiet_s:.0f} s" if snapshot.quiet_s >= 3 and snapshot.state != "finished" else ""
    )
    return f"{printable(snapshot.path.name)}: {snapshot.state}{span}{phase}{quiet}"


def _figures(snapshot: Snapshot) -> list[str]:
    part = "" if snapshot.counted == 1 else f" ({snapshot.counted:.0%} of the log counted)"
    kinds = ", ".join(f"{printable(kind)} {count}" for kind, count in (snapshot.events or {}).items())
    disk = snapshot.disk
    left = "" if disk is None or disk.left_s is None else f", about {duration(disk.left_s)} of logging"
    room = "disk: not known" if disk is None else f"disk: {disk.free_bytes / _GIB:.1f} GiB free{left}"
    total = counted(sum((snapshot.events or {}).values()), "event")
    return [
        f"  {snapshot.rate_hz:.1f} Hz, {counted(snapshot.late, 'frame')} late, {snapshot.missed} missed{part}; {room}",
        f"  {total}" + (f": {kinds}" if kinds else ""),
    ]


def duration(seconds: float) -> str:
    """`75 s`, `12 min`, `3.5 h`, `12 d`."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 48 * 3600 else f"{seconds / 86400:.0f} d"


def _sensors(views: Sequence[SensorView]) -> list[str]:
    width = max((len(printable(view.name)) for view in views), default=6)
    head = f"  {'sensor':{width}} {'Hz':>7} {'mean of the last second':^29} {'unit':5} {'sd':>9}"
    return [f"{head} {'range':>6} {'degC':>6} {'missed':>6}  flags", *(_sensor(view, width) for view in views)]


def _sensor(view: SensorView, width: int) -> str:
    means = " ".join(f"{value:9.3f}" for value in view.mean) if view.rows else "nothing came"
    noise = f"{view.sd.max():9.4f}" if view.rows > 1 else " " * 9
    use = "" if view.use is None else f"{view.use.max():.0%}"
    warm = "" if view.temperature_degc is None else f"{view.temperature_degc:.1f}{'*' * view.relative}"
    flags = ", ".join(f"{name} {count}" for name, count in view.flags.items())
    start = f"  {printable(view.name):{width}} {view.rate_hz:7.1f} {means:29} {view.unit:5} {noise} {use:>6} {warm:>6}"
    return f"{start} {view.missed:6}  {flags}".rstrip()


def _fused(snapshot: Snapshot) -> list[str]:
    if snapshot.fused is None:
        return [f"  not fused: {printable(snapshot.not_fused)}"]
    fused = snapshot.fused
    by = "calibrated" if fused.calibrated else "data sheet's values"
    lines = [f"  fused ({printable(fused.technique)}, {by}), box frame, last second"]
    for quantity in fused.triads:
        factor, unit = READABLE_SI[quantity]
        means = "  ".join(
            f"{axis} {factor * value:9.3f}" for axis, value in zip("xyz", fused.mean[quantity], strict=True)
        )
        noise = ", ".join(f"{factor * value:.3f}" for value in fused.noise[quantity])
        lines.append(f"    {_SIGNS[quantity]:14} {means} {unit}, noise {noise}")
    return lines


def _events(snapshot: Snapshot) -> list[str]:
    if not snapshot.recent:
        return []
    lines = ["", "  last events"]
    for event in snapshot.recent[:EVENTS]:
        about = " ".join(word for word in (event.sensor, f"{event.kind}:", event.message) if word)
        lines.append(f"  {event.time_ns * 1e-9:11.1f} s  {printable(about)}")
    return lines

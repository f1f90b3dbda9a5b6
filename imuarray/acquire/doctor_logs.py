"""Where logs go: may they be written, how long is there room, and what did an earlier night leave behind?"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from imuarray.acquire.doctor_machine import Check, Machine
from imuarray.array import ArrayConfig
from imuarray.log.disk_space import RESERVE, WATERMARK
from imuarray.log.headers import header_of
from imuarray.log.journal import is_running
from imuarray.log.layout import sensor_group

NIGHT_S = 12 * 3600.0
_LIVE = 2.0
"""A log and its journal, while it is written."""


def log_checks(machine: Machine, array: ArrayConfig | None, folder: Path, rate_hz: float) -> list[Check]:
    """All of them."""
    if not folder.is_dir():
        return [Check("folder", False, f"{folder}: there is none", f"mkdir -p {folder}")]
    writable = os.access(folder, os.W_OK | os.X_OK)
    checks = [Check("folder", writable, f"{folder}", "choose another, or change its owner")]
    return [*checks, room(machine, array, folder, rate_hz), *left_over(machine, folder)]


def room(machine: Machine, array: ArrayConfig | None, folder: Path, rate_hz: float) -> Check:
    """How long can this array be logged before a log ends itself for want of room? Without one: is there any room?"""
    free = machine.free_bytes(folder)
    advice = f"make room: a log ends itself when less than {WATERMARK >> 20} MiB are free; --rotate 1h needs half"
    if array is None:
        return Check("disk", free > WATERMARK + RESERVE, f"{free / 2**20:.0f} MiB free", advice)
    rows = ((sensor, min(rate_hz, sensor.chip_rate_hz)) for sensor in array.sensors)
    rate = sum(sensor_group(header_of(sensor, {})).row_bytes * row_rate for sensor, row_rate in rows) * _LIVE
    seconds = max(0.0, free - WATERMARK - RESERVE) / rate
    found = f"{free / 2**20:.0f} MiB free: about {_about(seconds / 3600)} at {rate_hz:g} frames a second"
    return Check("disk", seconds >= NIGHT_S, found, advice)


def _about(hours: float) -> str:
    """As precisely as such a guess can be."""
    if hours < 10:
        return f"{hours:.1f} h"
    return f"{hours:.0f} h" if hours < 48 else f"{hours / 24:.0f} days"


def left_over(machine: Machine, folder: Path) -> Iterator[Check]:
    """Logs that were never finished, and what else a process that is gone has left."""
    clean = True
    for journal in sorted(folder.glob("*.journal")):
        log = journal.with_suffix("")
        if is_running(log):
            yield Check("journal", True, f"{log.name} is being written")
        else:
            clean = False
            left = f"{journal.name} is left over: its log was never finished"
            yield Check("journal", False, left, f"imuarray recover {log}")
    for part in sorted(folder.glob(".*.part")):
        process = part.name.split(".")[-2]
        if process.isdigit() and not machine.path(f"/proc/{process}").exists():
            clean = False
            yield Check("draft", False, f"{part.name} was left by a program that is gone", f"rm {part}")
    if clean:
        yield Check("left-overs", True, "none")

"""A long night: hours of array time on the emulated bus, drivers and poll loop included: does anything grow, get lost?

``python tests/reliability/soak.py --hours 24``: the paper's array at its 48 frames a second, with `--log` through the
file as well.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from imuarray.acquire import record
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.log.writer import Block
from tests.reliability.night import Memory, night

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
RATE_HZ = 48.0


class Counted(Memory):
    """Keeps only the number of rows, whether their times increase, and the memory in use."""

    def __init__(self, every_h: float = 0.25) -> None:
        super().__init__()
        self.every_h = every_h
        self.counts: dict[str, int] = {}
        self.flagged: dict[str, int] = {}
        self.last_ns: dict[str, int] = {}
        self.mib: list[tuple[float, float]] = []

    def append(self, sensor: str, block: Block) -> None:
        if block.time[0] <= self.last_ns.get(sensor, -1) or (np.diff(block.time) <= 0).any():
            raise AssertionError(f"{sensor}: time does not increase")
        self.last_ns[sensor] = int(block.time[-1])
        self.counts[sensor] = self.counts.get(sensor, 0) + len(block.time)
        self.flagged[sensor] = self.flagged.get(sensor, 0) + int(np.count_nonzero(block.status > 1))

    def clocks(self, row: Any) -> None:
        hours = row.time_ns / 3600e9
        if not self.mib or hours >= self.mib[-1][0] + self.every_h:
            self.mib.append((hours, resident_mib()))


def resident_mib() -> float:
    """Memory in use by this process now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def soak(hours: float, every_h: float = 0.25) -> dict[str, Any]:
    """The counts."""
    counted, began = Counted(every_h), time.perf_counter()
    done = night(load_array(CONFIG), (), hours * 3600, rate_hz=RATE_HZ, log=counted)
    summary = done.summary
    return {
        "hours": hours,
        "wall_s": time.perf_counter() - began,
        "frames": summary.frames,
        "late": summary.late,
        "missed": summary.missed,
        "lost": sum(summary.lost.values()),
        "rows": counted.counts,
        "flagged": counted.flagged,
        "events": len(counted.events),
        "mib": counted.mib,
    }


def soak_log(hours: float, path: Path) -> dict[str, Any]:
    """The same into a log."""
    array, began, mib = load_array(CONFIG), time.perf_counter(), [resident_mib()]
    with open_bus("emulated:", array) as bus:
        every = round(900 * RATE_HZ)
        seen = [0]

        def progress(frames: int) -> None:
            if frames >= seen[0] + every:
                seen[0] = frames
                mib.append(resident_mib())

        summary = record(array, bus, path, rate_hz=RATE_HZ, seconds=hours * 3600, progress=progress, force=True)
    return {
        "hours": hours,
        "wall_s": time.perf_counter() - began,
        "frames": summary.frames,
        "late": summary.late,
        "missed": summary.missed,
        "lost": sum(summary.lost.values()),
        "bytes": path.stat().st_size,
        "mib": mib,
    }


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--log", type=Path, help="record into this file")
    asked = parser.parse_args()
    print(json.dumps(soak_log(asked.hours, asked.log) if asked.log else soak(asked.hours)))


if __name__ == "__main__":
    main()

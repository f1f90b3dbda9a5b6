"""How fast the emulated array runs, drivers and log included, beside the clock on the wall."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from compare import Row, row

from imuarray.acquire import record
from imuarray.array import load_array
from imuarray.bus import open_bus

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
SECONDS = 600.0


def rows() -> list[Row]:
    """Seconds of array time per second of wall time, at the paper's 48 Hz."""
    array = load_array(CONFIG)
    with tempfile.TemporaryDirectory() as folder, open_bus("emulated:", array) as bus:
        start = time.perf_counter()
        record(array, bus, Path(folder) / "run.h5", rate_hz=48.0, seconds=SECONDS)
        wall = time.perf_counter() - start
    return [
        row(
            "emulated array with drivers and log at 48 Hz, against real time",
            SECONDS / wall,
            1.0,
            "s per s",
            100.0,
            "higher",
        )
    ]

"""The four runs that a person with a box, a table and a hair dryer would record, on the emulated bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from imuarray.acquire import record
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.log.format import Phase

RATE_HZ = 48.0
"""What the paper's full array was logged at: (std/sem)^2 / 900 s of its Table 10."""

RUNS = {"tumble": 0.25, "static": 0.25, "heating": 0.42, "shaking": 0.08}
"""The runs, and the share of the recorded time that each of them gets."""

Say = Callable[[str], None]


def _world(run: str, seconds: float) -> str:
    """The parameters of the emulated bus for a run of that length."""
    face_s = (seconds - 6 * 2.0) / 7
    return {
        "tumble": f"world=tumble&face_s={face_s:.3f}&turn_s=2",
        "static": "world=still",
        "heating": f"world=heating&scale={seconds / 6600:.6f}",
        "shaking": f"world=shaking&peak_g=3&peak_dps=200&motion_s={seconds * 0.6:.3f}&still_s={seconds * 0.2:.3f}",
    }[run]


def record_all(config: Path, folder: Path, seconds: float, seed: int, say: Say) -> dict[str, Path]:
    """Record every run into its own log."""
    array = load_array(config)
    logs = {}
    for run, share in RUNS.items():
        length = share * seconds
        say(f"recording {run}: {length:.0f} s of array time")
        path = folder / f"{run}.h5"
        with open_bus(f"emulated:?{_world(run, length)}&seed={seed}", array) as bus:
            start_s = bus.clock.now_ns() * 1e-9
            phase = "static" if run == "static" else ""
            phases: Sequence[Phase] = () if phase else getattr(bus, "phases", ())
            record(
                array,
                bus,
                path,
                rate_hz=RATE_HZ,
                seconds=length - start_s,
                phases=phases,
                phase=phase,
                up="+Z" if phase else "",
                force=True,
            )
        logs[run] = path
    return logs

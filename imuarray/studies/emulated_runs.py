"""The runs of the demonstration: four recordings of the emulated array. They are independent of each other, so that
several processes can record them. These processes load only this module, without any analysis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from imuarray.acquire import record
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.gap.model.workers import processes
from imuarray.log.format import Phase

RATE_HZ = 48.0
"""The rate in Hz at which the paper logged its full array: (std/sem)^2 / 900 s in its Table 10."""

RUNS = {"tumble": 0.25, "static": 0.25, "heating": 0.42, "shaking": 0.08}
"""The runs, and the share of each in the recorded time."""

Report = Callable[[str], None]


def _world(run: str, seconds: float) -> str:
    """Return the parameters of the emulated bus for a run of that length."""
    face_s = (seconds - 6 * 2.0) / 7
    return {
        "tumble": f"world=tumble&face_s={face_s:.3f}&turn_s=2",
        "static": "world=still",
        "heating": f"world=heating&scale={seconds / 6600:.6f}",
        "shaking": f"world=shaking&peak_g=3&peak_dps=200&motion_s={seconds * 0.6:.3f}&still_s={seconds * 0.2:.3f}",
    }[run]


@dataclass(frozen=True)
class DemoOptions:
    """`seconds` of array time are recorded in total; `seed` draws the emulated noise; `force` overwrites existing
    files; up to `workers` runs are recorded at a time, without effect on the result.
    """

    seconds: float
    seed: int
    force: bool = False
    workers: int = 1


def record_all(config: Path, folder: Path, options: DemoOptions, report: Report) -> dict[str, Path]:
    """Record every run into its own log, the longest first."""
    with processes(options.workers) if options.workers > 1 else nullcontext() as executor:
        waiting: list[Future[None]] = []
        for run in sorted(RUNS, key=lambda run: -RUNS[run]):
            length = RUNS[run] * options.seconds
            report(f"recording {run}: {length:.0f} s of array time")
            path = folder / f"{run}.h5"
            if executor is None:
                record_run(config, path, run, length, options.seed)
            else:
                waiting.append(executor.submit(record_run, config, path, run, length, options.seed))
        for future in waiting:
            future.result()
    return {run: folder / f"{run}.h5" for run in RUNS}


def record_run(config: Path, path: Path, run: str, seconds: float, seed: int) -> None:
    """Record one run of the emulated array with a length of `seconds`."""
    array = load_array(config)
    with open_bus(f"emulated:?{_world(run, seconds)}&seed={seed}", array) as bus:
        start_s = bus.clock.now_ns() * 1e-9
        phase = "static" if run == "static" else ""
        phases: Sequence[Phase] = () if phase else getattr(bus, "phases", ())
        record(
            array,
            bus,
            path,
            rate_hz=RATE_HZ,
            seconds=seconds - start_s,
            phases=phases,
            phase=phase,
            up="+Z" if phase else "",
            force=True,
        )

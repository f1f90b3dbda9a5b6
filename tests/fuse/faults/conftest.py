"""The paper's array, simulated and aligned: the input of a fault monitor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt

from imuarray.array import load_array
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import nominal
from imuarray.chips import CHIPS
from imuarray.fuse import Axis, Frames, aligned, axes_of
from imuarray.fuse.faults import FaultEvent, FaultMonitor
from imuarray.log import Log, open_log
from imuarray.simulate import Model, Simulation, load_model, plan_of, write_log
from imuarray.simulate.effect import Effect
from imuarray.simulate.experiments import EXPERIMENTS, ExperimentOptions
from imuarray.simulate.simulation import effects_of
from imuarray.units import SI_PER_UNIT

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

RANGES = {name: chip.sensitivity for name, chip in CHIPS.items()}
QUANTITIES = ("specific_force", "angular_rate")
ACCELEROMETERS = ("ADXL1", "ADXL2", "BMA1", "BMA2", "BMA3", "BMA4")
GYROSCOPES = ("Gyro1", "Gyro2", "Gyro3")
CALIBRATED = ("range_reset", "bias", "scale", "misalignment", "turn_on_bias")
"""Effects that a calibration would have taken out."""
CONFIGS = Path(__file__).parents[3] / "configs"


@dataclass(frozen=True)
class Run:
    """One quantity of a simulated log: its axes, all its frames, and the truth (n, 3) on their times."""

    quantity: str
    axes: tuple[Axis, ...]
    frames: Frames
    truth: Floats

    @property
    def period_s(self) -> float:
        """On average: from frame to frame it alternates where a pass over the bus is not a whole tick."""
        return float(self.frames.time[-1] - self.frames.time[0]) * 1e-9 / (len(self.frames.time) - 1)

    @property
    def noise(self) -> Floats:
        return np.array([axis.noise_si for axis in self.axes], float)

    def members(self, sensor: str) -> list[int]:
        """The axes of a sensor."""
        return [index for index, axis in enumerate(self.axes) if axis.sensor == sensor]

    def only(self, *sensors: str) -> Run:
        """These sensors alone."""
        chosen = [index for index, axis in enumerate(self.axes) if axis.sensor in sensors]
        kept = self.frames
        stale = None if kept.stale is None else kept.stale[:, chosen]
        few = Frames(kept.time, kept.values[:, chosen], kept.valid[:, chosen], None, stale)
        return Run(self.quantity, tuple(self.axes[index] for index in chosen), few, self.truth)

    def monitor(self) -> FaultMonitor:
        return FaultMonitor(self.axes, self.quantity, period_s=self.period_s, ranges=RANGES)


@lru_cache(maxsize=8)
def simulated(
    experiment: str,
    seconds: float,
    rate_hz: float = 100.0,
    seed: int = 1,
    drive: str = "hand",
    without: tuple[str, ...] = CALIBRATED,
    changed: tuple[tuple[str, Effect], ...] = (),
) -> Mapping[str, Run]:
    """Both quantities of an experiment with the paper's array, with the effects except those in `without`, and with
    `changed` effects by sensor.
    """
    array, model = load_array(CONFIGS / "martin2013.toml"), load_model(CONFIGS / "models/martin2013.toml")
    plan = plan_of(array, rate_hz, seconds)
    effects = {name: list(chain) for name, chain in effects_of(plan, model, seed, without=without).items()}
    for sensor, effect in changed:
        effects[sensor].append(effect)
    motion = EXPERIMENTS[experiment](ExperimentOptions(seconds=seconds, drive=drive))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        write_log(Simulation(plan, motion, effects, seed=seed), path)
        with open_log(path) as log:
            return {quantity: _run(log, quantity, model, effects) for quantity in QUANTITIES}


def _run(log: Log, quantity: str, model: Model, effects: Mapping[str, Sequence[Effect]]) -> Run:
    sensors = log.of(quantity)
    known = {sensor.name: nominal(sensor) for sensor in sensors}
    for sensor in sensors:
        noise = next(effect for effect in effects[sensor.name] if effect.name == "white_noise")
        rms_lsb = np.array(noise.rms) * sensor.sensitivity  # type: ignore[attr-defined]
        step = 2.0 if sensor.chip == "adxl345" else 1.0  # quantisation: an ADXL345 gives only even codes
        known[sensor.name] = replace(known[sensor.name], noise_lsb=np.hypot(rms_lsb, step / 12**0.5))
    calibration = Calibration(known)
    parts = [result[quantity] for result, _ in aligned(log, calibration)]
    whole = Frames.joined(parts)
    assert log.truth is not None
    felt = np.asarray(getattr(log.truth, quantity))
    truth = np.stack([np.interp(whole.time, np.asarray(log.truth.time), felt[:, axis]) for axis in range(3)], axis=1)
    return Run(quantity, tuple(axes_of(sensors, calibration)), whole, truth)


def watched(monitor: FaultMonitor, *fed: Frames) -> tuple[Frames, tuple[FaultEvent, ...]]:
    """All of the frames, fed block by block, and all events."""
    parts = [*map(monitor, fed), monitor.finish()]
    kept = [part for part in parts if part is not None]
    return Frames.joined(kept), monitor.events


def faulty(run: Run, change: Callable[[Floats], None], start: int = 0, stop: int | None = None) -> Frames:
    """Rows of the run after `change` has changed the values of all rows in place."""
    values = run.frames.values.copy()
    change(values)
    return replace(run.frames, values=values).part(slice(start, stop))


def of_range(run: Run, sensor: str) -> tuple[float, float, float]:
    """The range of a sensor, another range after a reset, and the factor by which it then reads too much."""
    axis = run.axes[run.members(sensor)[0]]
    unit = SI_PER_UNIT[CHIPS[axis.chip].unit]
    now = round(axis.range_si / unit, 6)
    other = {16.0: 2.0, 1.5: 16.0, 2000.0: 250.0, 250.0: 2000.0}[now]
    return now, other, RANGES[axis.chip][other] / RANGES[axis.chip][now]

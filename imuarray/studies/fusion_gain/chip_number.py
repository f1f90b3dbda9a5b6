"""Gain of the number of gyroscopes in an array, and of mounting them in opposite directions, by simulation.

The units are drawn from the data sheets (`configs/models/datasheet.toml`). Data sheets state the scatter of the
temperature slopes of the bias, but not the part that all units of a design share. The heating is therefore simulated
with slopes that are drawn for each unit, and with the slope of the first unit for all units; the latter both as the
array is mounted and with all sensors in one direction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from imuarray.array import ArrayConfig, SensorConfig, parse_array
from imuarray.arrays import Floats, Times
from imuarray.calibrate import Calibration
from imuarray.errors import ConfigError
from imuarray.fuse import fuse
from imuarray.fuse.evaluation import errors_of, ten_second_means
from imuarray.log import open_log
from imuarray.printable import counted
from imuarray.shipped import configs
from imuarray.simulate import Simulation, effects_of, load_model, plan_of, write_log
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.simulate.experiments import EXPERIMENTS as MOTIONS
from imuarray.simulate.experiments import ExperimentOptions
from imuarray.studies.array_demo import polled_text

NOISE_HZ, NOISE_S, NOISE_ROWS = 200.0, 120.0, 50
"""At rest: frames per second, duration in s, and frames in each mean that is compared. The frame rate is twice the
usual bandwidth of 100 Hz, so that the density of the noise is preserved. Means of frames are compared, because the
sensors are read one after the other and their mean therefore correlates from row to row.
"""
HEATING_HZ, HEATING_S = 20.0, 240.0
I2C_HZ = 400_000
OWN, SHARED = "own", "shared"
_RAD_PER_ROOT_S = math.degrees(1.0) * 60.0  # as degrees per root hour


@dataclass(frozen=True)
class NumberRow:
    """Results with the first `count` gyroscopes, rms over seeds and axes: angle random walk of their mean in
    deg/sqrt(h); drift of the mean in deg/s during heating with an individual slope for each unit, with a shared slope
    and all units in one direction, and with a shared slope and units as the array is mounted; bus time of a frame in
    us.
    """

    count: int
    random_walk: float
    drift_own: float
    drift_alike: float
    drift_mounted: float
    bus_us: float


@dataclass(frozen=True)
class NumberStudy:
    """The rows of one array, and the number of seeds."""

    array: str
    seeds: int
    rows: tuple[NumberRow, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the rows, JSON-ready."""
        return {"array": self.array, "seeds": self.seeds, "rows": [vars(row) for row in self.rows]}


def study_numbers(array: ArrayConfig, seeds: int, progress: Callable[[int], None] = lambda done: None) -> NumberStudy:
    """Simulate the gyroscopes of `array` with seeds 1 ... `seeds` and fuse the first 1, 2, 4, ... of them; ConfigError
    for an array with fewer than two. `progress` is called with the number of completed seeds.
    """
    gyroscopes = [sensor for sensor in array.sensors if sensor.spec.quantity == "angular_rate"]
    if len(gyroscopes) < 2:
        raise ConfigError(f"array {array.name}: {len(gyroscopes)} gyroscopes; at least two are compared")
    names = tuple(sensor.name for sensor in gyroscopes)
    polled = parse_array(polled_text(array), array.name).only(names)
    counts = sorted({2**power for power in range(10) if 2**power < len(names)} | {len(names)})
    squares: list[Floats] = []
    for seed in range(1, seeds + 1):
        squares.append(_squares(polled, counts, seed))
        progress(seed)
    means = np.sqrt(np.mean(squares, axis=0))
    rows = tuple(
        NumberRow(count, walk, own_slope, same_way, mounted, bus_us=sum(map(_bus_us, gyroscopes[:count])))
        for count, (walk, own_slope, same_way, mounted) in zip(counts, means.tolist(), strict=True)
    )
    return NumberStudy(array.name, seeds, rows)


def _squares(array: ArrayConfig, counts: Sequence[int], seed: int) -> Floats:
    """Return (counts, 4) mean squares of the quantities of a `NumberRow`."""
    results = np.zeros((len(counts), 4))
    with TemporaryDirectory(prefix="imuarray_study_") as folder:
        path = Path(folder) / "run.h5"
        _simulate(array, "static", (NOISE_HZ, NOISE_S), seed, path)
        _, errors = _errors(path)
        whole = errors.shape[1] // NOISE_ROWS * NOISE_ROWS
        means = errors[:, :whole].reshape(len(errors), -1, NOISE_ROWS, 3).mean(axis=2)
        for row, count in enumerate(counts):
            variance = np.mean(np.diff(means[:count].mean(axis=0), axis=0) ** 2) / 2  # Allan's: N^2 / tau
            results[row, 0] = variance * NOISE_ROWS / NOISE_HZ * _RAD_PER_ROOT_S**2
        for column, (mounted, slopes) in enumerate(((array, OWN), (_align_sensors(array), SHARED), (array, SHARED))):
            _simulate(mounted, "heating", (HEATING_HZ, HEATING_S), seed, path, slopes)
            time, errors = _errors(path)
            for row, count in enumerate(counts):
                drift = ten_second_means(time, errors[:count].mean(axis=0))[1:]
                results[row, 1 + column] = np.mean(np.degrees(drift) ** 2)
    return results


def _align_sensors(array: ArrayConfig) -> ArrayConfig:
    """Return the same sensors, all mounted like the first one."""
    axes = array.sensors[0].axes
    return array.model_copy(
        update={"sensors": tuple(sensor.model_copy(update={"axes": axes}) for sensor in array.sensors)}
    )


def _simulate(
    array: ArrayConfig, experiment: str, frames: tuple[float, float], seed: int, path: Path, slopes: str = OWN
) -> None:
    """Simulate one log; `frames` are their rate in Hz and their duration in s. With `SHARED` slopes, all sensors have
    the temperature slope of the first, in their own axes.
    """
    plan = plan_of(array, *frames)
    model = load_model(configs() / "models" / "datasheet.toml")
    effects = dict(effects_of(plan, model, seed))
    if slopes == SHARED:
        first = next(effect for effect in next(iter(effects.values())) if isinstance(effect, ThermalBias))
        effects = {
            name: tuple(
                replace(own_effect, slope=first.slope) if isinstance(own_effect, ThermalBias) else own_effect
                for own_effect in several
            )
            for name, several in effects.items()
        }
    motion = MOTIONS[experiment](ExperimentOptions(seconds=frames[1]))
    write_log(Simulation(plan, motion, effects, seed=seed), path, force=True)


def _errors(path: Path) -> tuple[Times, Floats]:
    """Return the times (n,) in ns of the first gyroscope's frames, and errors (k, n, 3) in rad/s of each gyroscope."""
    with open_log(path) as log:
        axis_errors = [
            errors_of(log, fuse(log, Calibration(), "mean", only=[gyroscope.name]))["angular_rate"]
            for gyroscope in log.of("angular_rate")
        ]
    rows = min(len(time) for time, _ in axis_errors)
    return axis_errors[0][0][:rows], np.array([errors[:rows] for _, errors in axis_errors])


def _bus_us(sensor: SensorConfig) -> float:
    """Return the time of one burst of the chip in us, from the clocks of its bytes (BUS-07). On SPI, a burst has one
    byte more than the data.
    """
    size = sensor.spec.burst_bytes
    if sensor.on_spi:
        return 1e6 * 8 * (size + 1) / sensor.spi_rules.clock_hz
    return 1e6 * 9 * (size + 3) / I2C_HZ


def render_numbers(study: NumberStudy) -> str:
    """Return the rows as text, with a line end after the last one."""
    single = study.rows[0]
    lines = [
        f"mean of n gyroscopes of {study.array}, drawn from the data sheets, {counted(study.seeds, 'seed')}",
        f"{'':3} {'angle random walk':>23} {'bus time':>9} {'drift while heated, deg/s: each its':>37}"
        f" {'shared slope,':>15} {'shared slope,':>15}",
        f"{'n':>3} {'deg/sqrt(h)':>12} {'x sqrt(n)':>10} {'us':>9} {'own slope':>37} {'all alike':>15}"
        f" {'as mounted':>15}",
    ]
    for row in study.rows:
        relative = row.random_walk / single.random_walk * math.sqrt(row.count)
        lines.append(
            f"{row.count:>3} {row.random_walk:>12.3f} {relative:>10.3f} {row.bus_us:>9.1f} {row.drift_own:>37.4f}"
            f" {row.drift_alike:>15.4f} {row.drift_mounted:>15.4f}"
        )
    return "\n".join(lines) + "\n"

"""Fusing a log: one specific force and one angular rate per frame, in the box frame, block by block."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from imuarray.calibrate import Calibration
from imuarray.calibrate.segments import Thermometer
from imuarray.errors import FusionError
from imuarray.fuse.align import BLOCK, frames
from imuarray.fuse.axes import axes_of
from imuarray.fuse.frames import Estimate, FusedBlock, Times, axis_bits
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.fuse.thermal import element_temperatures
from imuarray.log import Log, SensorLog
from imuarray.units import INERTIAL


def fuse(
    log: Log, calibration: Calibration, technique: str, *, only: Collection[str] = (), block: int = BLOCK
) -> Iterator[FusedBlock]:
    """Fuse the inertial sensors of `log` (`only` these, if any are named) by `technique`; FusionError if they can't
    feed it. Biases follow the temperature that the log tells, where the calibration says how.
    """
    if technique not in TECHNIQUES:
        raise FusionError(f"technique {technique!r}: allowed are {', '.join(TECHNIQUES)}")
    chosen = {quantity: [s for s in log.of(quantity) if not only or s.name in only] for quantity in INERTIAL}
    groups = {quantity: sensors for quantity, sensors in chosen.items() if sensors}
    if not groups:
        raise FusionError(f"{log.path}: no inertial sensor {f'among {sorted(only)}' if only else 'in it'}")
    reference = next(iter(groups.values()))[0]
    warm = element_temperatures(log, (sensor for sensors in groups.values() for sensor in sensors), calibration)
    streams = [_fuse_group(sensors, calibration, technique, reference, block, warm) for sensors in groups.values()]
    axes = {quantity: axes_of(sensors, calibration) for quantity, sensors in groups.items()}
    for parts in zip(*streams, strict=True):
        estimates = dict(zip(groups, (estimate for _, estimate in parts), strict=True))
        yield FusedBlock(
            parts[0][0],
            {quantity: estimate.triad_box for quantity, estimate in estimates.items()},
            {quantity: estimate.covariance_box for quantity, estimate in estimates.items()},
            {quantity: axis_bits(estimate.used, axes[quantity]) for quantity, estimate in estimates.items()},
        )


def _fuse_group(
    sensors: list[SensorLog],
    calibration: Calibration,
    technique: str,
    reference: SensorLog,
    block: int,
    temperatures: Mapping[str, Thermometer],
) -> Iterator[tuple[Times, Estimate]]:
    """Time (n,) and estimate of one quantity, block by block."""
    fused = TECHNIQUES[technique](axes_of(sensors, calibration))
    for part in frames(sensors, calibration, reference, block, temperatures):
        yield part.time, fused(part)

"""What `imuarray fuse` makes of its inputs before it fuses: the calibration as it holds for this log, and what is to be
said of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.units import INERTIAL

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.log import Log, SensorLog


def without_calibration(log: Log, calibration: Calibration, names: Sequence[str], file: Path | None) -> list[str]:
    """Sensors that are fused with the data sheet's values; FusionError if a calibration knows none of them at all."""
    from imuarray.errors import FusionError

    fused = [sensor.name for sensor in inertial(log) if not names or sensor.name in names]
    unknown = [name for name in fused if name not in calibration.sensors]
    if file is not None and fused and unknown == fused:
        raise FusionError(
            f"{file}: knows {', '.join(calibration.sensors) or 'no sensor'}, but none of {log.path}: {', '.join(fused)}"
        )
    return unknown


def in_states_of(log: Log, calibration: Calibration, names: list[str]) -> tuple[Calibration, list[str], list[str]]:
    """The calibration with the biases of the states in which sensors came up; what to say of them; the sensors to fuse,
    those that came up wrong left out.
    """
    from imuarray.calibrate.start_up import came_up
    from imuarray.chips import CHIPS

    ranges = {name: CHIPS[sensor.chip].sensitivity for name, sensor in log.sensors.items() if sensor.chip in CHIPS}
    chosen, found = came_up(log, calibration, ranges)
    wrong = [name for name, start in found.items() if start.fault]
    said = [start.sentence(name, calibration) for name, start in found.items()]
    candidates = names or [sensor.name for sensor in inertial(log)]
    fused = [name for name in candidates if name not in wrong] if wrong else names
    return chosen, [text for text in said if text], fused


def followed_by_temperature(log: Log, calibration: Calibration, names: Sequence[str]) -> list[str]:
    """The sensors whose bias follows the log's temperature; says on standard error whose can't, though they should."""
    from imuarray.fuse import element_temperatures, slopes_of

    sloped = [sensor for sensor in inertial(log) if not names or sensor.name in names]
    sloped = [sensor for sensor in sloped if slopes_of(calibration, sensor) is not None]
    warm = element_temperatures(log, sloped, calibration)
    if cold := [sensor.name for sensor in sloped if sensor.name not in warm]:
        click.echo(
            f"imuarray: {log.path}: no thermometer for the slopes of {', '.join(cold)}; biases stay as calibrated",
            err=True,
        )
    return list(warm)


def temperature_lines(log: Log, calibration: Calibration, names: Sequence[str]) -> list[str]:
    """What to say of sensors that were calibrated at another temperature."""
    from imuarray.fuse import mismatch_sentences, temperature_mismatch

    fused = [sensor for sensor in inertial(log) if not names or sensor.name in names]
    return list(mismatch_sentences(calibration, temperature_mismatch(log, fused, calibration)))


def inertial(log: Log) -> list[SensorLog]:
    """The accelerometers and gyroscopes of a log."""
    return [sensor for quantity in INERTIAL for sensor in log.of(quantity)]


def with_noise(log: Log, calibration: Calibration, technique: str | None, names: Sequence[str] = ()) -> Calibration:
    """The calibration, with the noise measured in the log itself where the technique (None: any of them) needs it and
    the file has none for one of the sensors that are fused (`names`, all if there are none).
    """
    from imuarray.calibrate.noise import with_noise_of
    from imuarray.fuse import NEEDS_NOISE

    fused = [sensor for sensor in inertial(log) if not names or sensor.name in names]
    lacking = [sensor.name for sensor in fused if calibration.or_nominal(sensor).noise_lsb is None]
    if not lacking or (technique is not None and technique not in NEEDS_NOISE):
        return calibration
    of = "" if len(lacking) == len(fused) else f" of {', '.join(lacking)}"
    click.echo(f"imuarray: no noise{of} in the calibration; measured where this log stands still", err=True)
    return with_noise_of(log, calibration, lacking)

"""`imuarray fuse`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.commands.options import force_option, json_option, log_argument, print_json, progress, refuse_existing

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.fuse import Error
    from imuarray.log import Log


@click.command("fuse")
@log_argument
@click.option(
    "--calibration",
    "calibration_file",
    type=click.Path(path_type=Path),
    metavar="CAL.toml",
    help="default: the data sheets",
)
@click.option("--technique", default="mean", show_default=True, metavar="NAME", help="mean, opposed, planes or ranges")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FUSED.h5", help="the result")
@click.option("--only", default="", metavar="SENSOR,...", help="fuse only these sensors")
@force_option
@json_option
def command(
    run: Path, calibration_file: Path | None, technique: str, output: Path, only: str, force: bool, as_json: bool
) -> None:
    """Fuse all sensors of RUN.h5 into one specific force and one angular rate in the box frame.

    \b
    mean     every axis weighs the same
    opposed  anti-parallel axes of one design balance each other: common-mode drift cancels
    planes   in-plane against out-of-plane axes by their measured noise
    ranges   low and high measuring ranges blended, the low one fading out before it clips
    """
    from imuarray.calibrate import Calibration, load_calibration
    from imuarray.fuse import evaluate, fuse, write_fused
    from imuarray.log import open_log

    refuse_existing(output, force, source=run)
    calibration = load_calibration(calibration_file) if calibration_file else Calibration()
    with open_log(run) as log:
        names = [log[name].name for name in only.split(",")] if only else []
        calibration = with_noise(log, calibration, technique)
        rows = max(len(sensor) for sensor in log.sensors.values())
        with progress(rows, technique) as done:
            frames = write_fused(
                output,
                fuse(log, calibration, technique, only=names),
                epoch=log.epoch,
                technique=technique,
                log=str(run),
                calibration=str(calibration_file or ""),
                force=force,
                progress=done,
            )
        errors = evaluate(log, fuse(log, calibration, technique, only=names)) if log.truth or log.reference else {}
    report = {
        "fused": str(output),
        "technique": technique,
        "frames": frames,
        "error": {name: _error(error) for name, error in errors.items()},
    }
    if as_json:
        print_json(report)
    else:
        _print(report)


def with_noise(log: Log, calibration: Calibration, technique: str) -> Calibration:
    """The calibration, with the noise measured in the log itself where the technique needs it and the file has none."""
    from imuarray.calibrate import Calibration, calibrate_noise
    from imuarray.fuse import NEEDS_NOISE

    inertial = [sensor for quantity in ("specific_force", "angular_rate") for sensor in log.of(quantity)]
    known = {sensor.name: calibration.of(sensor) for sensor in inertial}
    if technique not in NEEDS_NOISE or all(sensor.noise_lsb is not None for sensor in known.values()):
        return calibration
    click.echo("imuarray: no noise in the calibration; measured where this log stands still", err=True)
    measured = calibrate_noise(log).sensors
    complete = {
        name: sensor if sensor.noise_lsb is not None else replace(sensor, noise_lsb=measured[name].noise_lsb)
        for name, sensor in known.items()
    }
    return Calibration(complete, (*calibration.sources, str(log.path)))


def _error(error: Error) -> dict[str, Any]:
    """Errors against the truth, JSON-ready, SI."""
    return {
        "mean": error.mean.tolist(),
        "noise": error.noise.tolist(),
        "rms": error.rms.tolist(),
        "drift": error.drift.tolist(),
        "frames": error.frames,
    }


def _print(report: dict[str, Any]) -> None:
    click.echo(f"{report['fused']}: {report['frames']} frames by {report['technique']}")
    for quantity, error in report["error"].items():
        factor, unit = (1e3 / 9.80665, "mg") if quantity == "specific_force" else (57.29577951308232, "dps")
        for name in ("rms", "noise", "drift"):
            x, y, z = (factor * value for value in error[name])
            click.echo(f"  {quantity:15} {name:6} against the truth: x {x:8.3f}  y {y:8.3f}  z {z:8.3f} {unit}")

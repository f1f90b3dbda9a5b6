"""`imuarray calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.commands.options import force_option, json_option, print_json, refuse_existing
from imuarray.units import READABLE

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration, SensorCalibration, Tumble
    from imuarray.log import SensorLog

_output = click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    metavar="CAL.toml",
    help="the calibration file to write",
)
_update = click.option("--update", is_flag=True, help="keep what CAL.toml already knows and add to it")
_logs = click.argument("runs", metavar="RUN.h5...", nargs=-1, required=True, type=click.Path(path_type=Path))


@click.group("calibrate", invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Sensor parameters from a log, into a TOML file."""
    if context.invoked_subcommand is None:
        raise click.UsageError(f"say what to calibrate: {', '.join(command.commands)}")


@command.command("tumble")
@_logs
@_output
@_update
@force_option
@json_option
def tumble(runs: tuple[Path, ...], output: Path, update: bool, force: bool, as_json: bool) -> None:
    """Bias and response of accelerometers, bias and g-sensitivity of gyroscopes, from static poses.

    With phases that name the six faces (z_up, x_down, ...), in one log or in a log each, by the paper's Appendix B;
    without, from at least nine static poses that are found in the logs.
    """
    from imuarray.calibrate import calibrate_tumble, cancellation
    from imuarray.log import open_log

    for run in runs:
        refuse_existing(output, force or update, source=run)
    with ExitStack() as stack:
        logs = [stack.enter_context(open_log(run)) for run in runs]
        result = calibrate_tumble(*logs)
        inertial = [sensor for sensor in logs[0].sensors.values() if sensor.name in result.calibration.sensors]
        pairs = cancellation(inertial, result.calibration)
        rows = [_tumble_row(sensor, result) for sensor in inertial]
    _save(result.calibration, output, update, force)
    report = {
        "method": result.method,
        "poses": result.poses,
        "residual_mg": {name: 1e3 * value for name, value in result.residual_g.items()},
        "sensors": rows,
        "cancellation": [vars(pair) for pair in pairs],
        "calibration": str(output),
    }
    if as_json:
        print_json(report)
    else:
        _print_tumble(report)


@command.command("noise")
@_logs
@_output
@_update
@force_option
@json_option
def noise(runs: tuple[Path, ...], output: Path, update: bool, force: bool, as_json: bool) -> None:
    """Standard deviation of single readings, per sensor axis, from the stretches in which the box stood still."""
    from imuarray.calibrate import calibrate_noise
    from imuarray.log import open_log

    for run in runs:
        refuse_existing(output, force or update, source=run)
    with ExitStack() as stack:
        calibration = calibrate_noise(*[stack.enter_context(open_log(run)) for run in runs])
    _save(calibration, output, update, force)
    rows = [_noise_row(sensor) for sensor in calibration.sensors.values()]
    if as_json:
        print_json({"sensors": rows, "calibration": str(output)})
        return
    click.echo(f"{'sensor':12} {'x':>9} {'y':>9} {'z':>9}  counts rms {'x':>9} {'y':>9} {'z':>9}")
    for row in rows:
        counts, units = (_three(row[key], digits) for key, digits in (("noise_lsb", 3), ("noise", 3)))
        click.echo(f"{row['name']:12} {counts}             {units}  {row['noise_unit']} rms")
    click.echo(f"wrote {output}")


def _save(calibration: Calibration, output: Path, update: bool, force: bool) -> None:
    from imuarray.calibrate import load_calibration

    if update and output.exists():
        load_calibration(output).merged(calibration).save(output, force=True)
    else:
        calibration.save(output, force=force)


def _tumble_row(sensor: SensorLog, result: Tumble) -> dict[str, Any]:
    """One sensor's Appendix B figures, JSON-ready; mg for accelerometers, dps for gyroscopes."""
    known = result.calibration.of(sensor)
    row: dict[str, Any] = {
        "name": sensor.name,
        "chip": sensor.chip,
        "quantity": sensor.quantity,
        "range": sensor.range,
        "unit": sensor.unit,
        "bias_lsb": known.bias_lsb.tolist(),
        "bias_sem_lsb": None if known.bias_sem_lsb is None else known.bias_sem_lsb.tolist(),
        "bias": known.bias_in_units().tolist(),
    }
    if sensor.quantity == "specific_force":
        row["scale_lsb_per_g"] = known.scale_lsb_per_unit.tolist()
        row["azimuth_deg"], row["elevation_deg"] = known.azimuth_elevation_deg().T.tolist()
        row["response_lsb_per_g"] = known.response_lsb_per_unit.tolist()
    elif known.g_sensitivity_lsb_per_g is not None:
        row["g_sensitivity_lsb_per_g"] = known.g_sensitivity_lsb_per_g.tolist()
    if sensor.name in result.drift_lsb:
        row["drift_lsb"] = result.drift_lsb[sensor.name].tolist()
    return row


def _print_tumble(report: dict[str, Any]) -> None:
    """Appendix B as a table: bias, scale factor, azimuth, elevation; then what opposing axes cancel."""
    how = "named faces (Appendix B)" if report["method"] == "faces" else "static poses found in the log"
    click.echo(f"{report['poses']} {how}")
    click.echo(f"{'axis':14} {'bias':>10} {'+-':>7} {'bias':>10}      {'scale':>10} {'azimuth':>8} {'elevation':>9}")
    click.echo(f"{'':14} {'LSB':>10} {'LSB':>7} {'mg or dps':>10}      {'LSB/g':>10} {'deg':>8} {'deg':>9}")
    for row in report["sensors"]:
        factor, unit = READABLE[row["unit"]]
        for index, axis in enumerate("xyz"):
            line = f"{row['name'] + ' ' + axis:14} {row['bias_lsb'][index]:10.3f} "
            line += f"{row['bias_sem_lsb'][index]:7.3f} " if row["bias_sem_lsb"] else " " * 8
            line += f"{factor * row['bias'][index]:10.3f} {unit:3}  "
            if "scale_lsb_per_g" in row:
                angles = f"{row['azimuth_deg'][index]:8.2f} {row['elevation_deg'][index]:9.2f}"
                line += f"{row['scale_lsb_per_g'][index]:10.2f} {angles}"
            click.echo(line.rstrip())
    residuals = ", ".join(f"{name} {value:.2f}" for name, value in report["residual_mg"].items())
    click.echo(f"residual after calibration, rms over the poses (mg): {residuals}")
    _print_cancellation(report["cancellation"])
    click.echo(f"wrote {report['calibration']}")


def _print_cancellation(pairs: Sequence[dict[str, Any]]) -> None:
    click.echo("bias in the box frame: axes of one design that point along, those against, and both ways averaged")
    for pair in pairs:
        factor, unit = READABLE[pair["unit"]]
        line = f"  {pair['chip']:10} {pair['box_axis']}:"
        for key in ("along", "against", "opposed"):
            line += f"  {key} {'none' if pair[key] is None else f'{factor * pair[key]:.2f}':>9}"
        click.echo(f"{line}  single rms {factor * pair['single_rms']:9.2f} {unit}")


def _noise_row(sensor: SensorCalibration) -> dict[str, Any]:
    factor, unit = READABLE[sensor.unit]
    counts = [] if sensor.noise_lsb is None else sensor.noise_lsb.tolist()
    return {
        "name": sensor.name,
        "noise_lsb": counts,
        "noise": [factor * value / scale for value, scale in zip(counts, sensor.scale_lsb_per_unit, strict=True)],
        "noise_unit": unit,
    }


def _three(values: Sequence[float], digits: int) -> str:
    return " ".join(f"{value:9.{digits}f}" for value in values)

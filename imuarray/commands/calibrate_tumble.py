"""The report of `imuarray calibrate tumble`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from imuarray.printable import printable
from imuarray.units import READABLE

if TYPE_CHECKING:
    from imuarray.calibrate import TumbleResult, TurnFit
    from imuarray.log import Log, SensorLog


_METHODS = {
    "faces": "named faces",
    "gravity": "static poses detected in the logs",
    "six faces": "static poses on the six faces, whose names are unknown",
    "path": "stretches of a path without stops, weighted by how little each moved",
}


_RESIDUAL_KEY = (
    "  fitted: after removing the drift of the bias; predicted: each pose by a fit to the other poses;",
    "  stored: with the mean bias, as in the file; over noise: fitted residuals divided by those expected from noise;",
    "  drift: how much the bias changed from the first to the last pose (mg)",
)


def report_of(log: Log, result: TumbleResult) -> dict[str, Any]:
    """Return the whole result, JSON-ready; residuals in mg, biases in g or dps, None for what can't be determined."""
    from imuarray.calibrate import cancellation

    inertial = [sensor for sensor in log.sensors.values() if sensor.name in result.calibration.sensors]
    return {
        "method": result.method,
        "poses": result.poses,
        "residual_mg": {name: 1e3 * value for name, value in result.residual_g.items()},
        "residual_apart_mg": {name: 1e3 * value for name, value in result.held_out_residual_g.items()},
        "residual_steady_mg": {name: 1e3 * value for name, value in result.residual_steady_g.items()},
        "pose_residuals_mg": {
            name: dict(zip(result.pose_names, (1e3 * residual).tolist(), strict=True))
            for name, residual in result.pose_residual_g.items()
        },
        "left_out": [vars(outlier) for outlier in result.left_out],
        "warnings": list(result.warnings),
        "sensors": [_sensor(sensor, result) for sensor in inertial],
        "cancellation": [vars(pair) for pair in cancellation(inertial, result.calibration)],
    }


def _sensor(sensor: SensorLog, result: TumbleResult) -> dict[str, Any]:
    """Return the figures of one sensor as in Appendix B of the paper, and its matrices."""
    parameters = result.calibration.of(sensor)
    row: dict[str, Any] = {
        "name": sensor.name,
        "chip": sensor.chip,
        "quantity": sensor.quantity,
        "range": sensor.range,
        "unit": sensor.unit,
        "bias_lsb": parameters.bias_lsb.tolist(),
        "bias_sem_lsb": None if parameters.bias_sem_lsb is None else parameters.bias_sem_lsb.tolist(),
        "bias": parameters.bias_in_units().tolist(),
    }
    if sensor.quantity == "specific_force":
        row["scale_lsb_per_g"] = parameters.scale_lsb_per_unit.tolist()
        row["azimuth_deg"], row["elevation_deg"] = parameters.azimuth_elevation_deg().T.tolist()
        row["response_lsb_per_g"] = parameters.response_lsb_per_unit.tolist()
    if parameters.g_sensitivity_lsb_per_g is not None and parameters.g_sensitivity_sem_lsb_per_g is not None:
        row["g_sensitivity_lsb_per_g"] = parameters.g_sensitivity_lsb_per_g.tolist()
        row["g_sensitivity_sem_lsb_per_g"] = parameters.g_sensitivity_sem_lsb_per_g.tolist()
    if sensor.name in result.drift_lsb:
        row["drift_lsb"] = result.drift_lsb[sensor.name].tolist()
    if (fit := result.fits.get(sensor.name)) is not None:
        row |= {"reduced_chi_squared": fit.reduced_chi_squared, "freedom": fit.freedom}
        row["repeatability_lsb"] = fit.repeatability_lsb.tolist()
    if sensor.name in result.turns:
        row["turns"] = _turns(result.turns[sensor.name])
    return row


def _turns(fit: TurnFit) -> dict[str, Any]:
    return {
        "used": fit.turns,
        "untold": fit.uncertain_axes,
        "response_lsb_per_dps": fit.response.tolist(),
        "sem_lsb_per_dps": fit.sem.tolist(),
        "residual_deg": fit.residual_deg,
        "reduced_chi_squared": fit.chi_squared / fit.freedom,
        "left_out": [vars(outlier) for outlier in fit.left_out],
    }


def print_report(report: dict[str, Any]) -> None:
    """Print the figures of Appendix B and Table 4 of the paper for this array, the responses of the gyroscopes, the
    residuals, the exclusions, and what opposing axes cancel.
    """
    click.echo(f"{report['poses']} {_METHODS[report['method']]}")
    _print_axes(report["sensors"])
    _print_g_sensitivity([row for row in report["sensors"] if "g_sensitivity_lsb_per_g" in row], report["method"])
    _print_turns([row for row in report["sensors"] if "turns" in row])
    _print_residuals(report)
    has_logs = len({outlier["log"] for outlier in report["left_out"]}) > 1
    for outlier in report["left_out"]:
        log_text = f" of {outlier['log']}" if has_logs else ""
        click.echo(printable(f"excluded: {outlier['phase']}{log_text}: {outlier['reason']}"))
    _print_cancellation(report["cancellation"])
    for sentence in report["warnings"]:
        click.echo(printable(f"warning: {sentence}"))


def _print_axes(rows: Sequence[dict[str, Any]]) -> None:
    click.echo(f"{'axis':14} {'bias':>10} {'+-':>7} {'bias':>10}      {'scale':>10} {'azimuth':>8} {'elevation':>9}")
    click.echo(f"{'':14} {'LSB':>10} {'LSB':>7} {'mg or dps':>10}      {'LSB/g':>10} {'deg':>8} {'deg':>9}")
    for row in rows:
        factor, unit = READABLE[row["unit"]]
        for index, axis in enumerate("xyz"):
            line = f"{row['name'] + ' ' + axis:14} {row['bias_lsb'][index]:10.3f} "
            line += f"{row['bias_sem_lsb'][index]:7.3f} " if row["bias_sem_lsb"] else " " * 8
            line += f"{factor * row['bias'][index]:10.3f} {unit:3}  "
            if "scale_lsb_per_g" in row:
                angles = f"{row['azimuth_deg'][index]:8.2f} {row['elevation_deg'][index]:9.2f}"
                line += f"{row['scale_lsb_per_g'][index]:10.2f} {angles}"
            click.echo(line.rstrip())


def _print_g_sensitivity(rows: Sequence[dict[str, Any]], method: str) -> None:
    """Print the matrices by box axes; values that two standard errors, or half the drift between faces, can explain are
    in brackets.
    """
    by_drift = "" if method == "gravity" else ", or than half the drift"
    if rows:
        click.echo(
            f"g-sensitivity (LSB/g) along box X, Y, Z; [in brackets] no larger than two standard errors{by_drift}"
        )
    for row in rows:
        values, sems = np.array(row["g_sensitivity_lsb_per_g"]), np.array(row["g_sensitivity_sem_lsb_per_g"])
        drift = np.abs(np.array(row["drift_lsb"]))[:, None] / 2 * (method == "faces")
        doubtful = (np.abs(values) < 2 * sems) | (np.abs(values) < drift)
        for index, axis in enumerate("xyz"):
            cells = [
                f"{f'[{value:.3f}]' if doubted else f'{value:.3f} ':>10} +-{sem:6.3f}"
                for value, sem, doubted in zip(values[index], sems[index], doubtful[index], strict=True)
            ]
            click.echo(f"{row['name'] + ' ' + axis:14} {' '.join(cells)}")


def _print_turns(rows: Sequence[dict[str, Any]]) -> None:
    """Print the responses to rates about the box axes, and which of them the turns do not determine."""
    if rows:
        click.echo("response (LSB/dps) to rates about box X, Y, Z, from turns between poses")
    for row in rows:
        turns = row["turns"]
        response, sem = np.array(turns["response_lsb_per_dps"]), np.array(turns["sem_lsb_per_dps"])
        for index, axis in enumerate("xyz"):
            cells = [f"{a:10.3f} +-{b:6.3f}" for a, b in zip(response[index], sem[index], strict=True)]
            click.echo(f"{row['name'] + ' ' + axis:14} {' '.join(cells)}")
        axes = ", ".join(turns["untold"])
        missing = f"; add turns about box {axes}: the response to them is not fully determined"
        click.echo(
            f"{'':14} {turns['used']} turns, which end within {turns['residual_deg']:.2f} deg rms of gravity's"
            f" direction{missing if turns['untold'] else ''}"
        )
        for outlier in turns["left_out"]:
            click.echo(printable(f"{'':14} excluded: {outlier['phase']}: {outlier['reason']}"))


def _print_residuals(report: dict[str, Any]) -> None:
    """Print the rms residuals over the poses in mg (fitted, cross-validated, with the stored bias) and the drift."""
    click.echo("length of the calibrated specific force less 1 g, rms over the poses (mg):")
    click.echo(
        f"{'':14} {'fitted':>8} {'predicted':>9} {'stored':>8} {'over noise':>11}   {'worst pose':20} drift x, y, z"
    )
    rows = {row["name"]: row for row in report["sensors"]}
    for name, value in report["residual_mg"].items():
        held_out, reduced = report["residual_apart_mg"].get(name), rows[name].get("reduced_chi_squared")
        cells = [
            f"{'-' if value is None else f'{value:.3f}':>8}",
            f"{'-' if held_out is None else f'{held_out:.3f}':>9}",
            f"{report['residual_steady_mg'][name]:8.3f}",
            f"{'-' if reduced is None else f'{reduced**0.5:.2f}':>11}",
        ]
        worst = max(report["pose_residuals_mg"][name].items(), key=lambda pair: abs(pair[1]))
        scales = zip(rows[name]["drift_lsb"], rows[name]["scale_lsb_per_g"], strict=True)
        drift = " ".join(f"{-1e3 * change / scale + 0.0:+.2f}" for change, scale in scales)
        click.echo(printable(f"{name:14} {' '.join(cells)}   {f'{worst[0]} {worst[1]:+.3f}':20} {drift}"))
    for line in _RESIDUAL_KEY:
        click.echo(line)


def _print_cancellation(pairs: Sequence[dict[str, Any]]) -> None:
    """Print the mean biases of axes of one design by direction; axes without another of their design are omitted."""
    several = []
    for pair in pairs:
        means = [pair[key] for key in ("along", "against") if pair[key] is not None]
        is_single = len(means) == 1 and abs(abs(means[0]) - pair["single_rms"]) <= 1e-9 * pair["single_rms"]
        several += [] if is_single else [pair]  # the mean of a single axis is as large as its rms
    if several:
        click.echo(
            "bias in the box frame: axes of one design along the box axis, axes against it, and the average of both"
        )
    for pair in several:
        factor, unit = READABLE[pair["unit"]]
        line = f"  {pair['chip']:10} {pair['quantity'].replace('_', ' '):14} {pair['box_axis']}:"
        for key in ("along", "against", "opposed"):
            line += f"  {key} {'none' if pair[key] is None else f'{factor * pair[key]:.2f}':>9}"
        click.echo(f"{line}  single rms {factor * pair['single_rms']:9.2f} {unit}")

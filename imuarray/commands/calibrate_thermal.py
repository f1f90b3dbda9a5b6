"""The report of `imuarray calibrate thermal`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from imuarray.calibrate import SensorCalibration, ThermalResult


_UNREPORTED = ("fit", "offset_lsb", "drift_sem_lsb_per_s")


def report_of(result: ThermalResult) -> dict[str, Any]:
    """Return the slopes of every sensor, the fit of every sensor in every log, and the opposing pairs with p-values
    that are corrected for the number of pairs (Holm), JSON-ready.
    """
    from imuarray.calibrate import holm

    cancels = holm([pair.p_cancels for pair in result.pairs])
    nothing = holm([pair.p_nothing_left for pair in result.pairs])
    return {
        "sensors": [_sensor(sensor) for sensor in result.calibration.sensors.values()],
        "heatings": [
            {name: value for name, value in (vars(heating) | vars(heating.fit)).items() if name not in _UNREPORTED}
            for heating in result.heatings
        ],
        "pairs": [
            {**vars(pair), "p_cancels": p_cancels, "p_nothing_left": p_nothing}
            for pair, p_cancels, p_nothing in zip(result.pairs, cancels.tolist(), nothing.tolist(), strict=True)
        ],
    }


def _sensor(sensor: SensorCalibration) -> dict[str, Any]:
    """Return the entry of the calibration file."""
    from imuarray.calibrate.entries import to_table

    return {"name": sensor.name, "unit": sensor.unit, **to_table(sensor.thermal)}


def print_report(report: dict[str, Any]) -> None:
    """Print the slopes of every axis, then what opposing axes cancel."""
    for log in dict.fromkeys(heating["log"] for heating in report["heatings"]):
        first = next(heating for heating in report["heatings"] if heating["log"] == log)
        low, high = first["span_degc"]
        click.echo(f"{log}: {low:.1f} to {high:.1f} degC by {first['thermometer']}")
    click.echo(
        f"{'axis':14} {'slope':>10} {'+-':>8} {'curvature':>11} {'+-':>8}  {'lag':>6} {'95 % from':>9} {'to':>6}  of"
    )
    click.echo(f"{'':14} {'LSB/degC':>10} {'':>8} {'LSB/degC^2':>11} {'':>8}  {'s':>6} {'s':>9} {'s':>6}")
    for row in report["sensors"]:
        low, high = row.get("lag_interval_s", (row["lag_s"], row["lag_s"]))
        for index, axis in enumerate("xyz"):
            slope, sem = row["slope_lsb_per_degc"][index], row["slope_sem_lsb_per_degc"][index]
            line = f"{row['name'] + ' ' + axis:14} {slope:10.4f} {sem:8.4f} {_curvature(row, index)}"
            line += f"  {row['lag_s']:6.0f} {low:9.0f} {high:6.0f}"
            click.echo(f"{line}  {row['meaning'][index]}{_scale(row, index)}")
    references = sorted({row["reference_degc"] for row in report["sensors"]})
    middle = " and ".join(f"{reference:.1f}" for reference in references)
    click.echo(
        f"slope: at {middle} degC, the middle of the temperature range; it equals the mean slope over that range"
    )
    click.echo("curvature: half the change of the slope per degree; [0] if not significant")
    click.echo("+-: standard error, which includes slow noise; 1.96 standard errors give a 95 % interval")
    click.echo("lag: delay of the sensor behind the thermometer, with its 95 % interval")
    click.echo(
        "of: the quantity that has this slope; bias and scale of an axis along gravity are separated only by heating on"
        " opposite faces"
    )
    _print_lines(report["heatings"])
    _print_pairs(report["pairs"])


def _print_lines(heatings: list[dict[str, Any]]) -> None:
    """Print the slopes of straight lines through one log."""
    if len({heating["log"] for heating in heatings}) != 1:
        return
    click.echo(
        "straight lines through all means, LSB/degC, for comparison with other programs (temperatures that last longer"
        " have more weight):"
    )
    for heating in heatings:
        lines = zip("xyz", heating["line_lsb_per_degc"], heating["line_sem_lsb_per_degc"], strict=True)
        axes = "  ".join(f"{axis} {slope:9.4f} +- {sem:.4f}" for axis, slope, sem in lines)
        click.echo(f"  {heating['sensor']:12} {axes}")


def _curvature(row: dict[str, Any], index: int) -> str:
    """Return the quadratic term and its standard error, as far as they are known."""
    if row.get("quadratic_sem_lsb_per_degc2") is None:
        return f"{'-':>11} {'':>8}"
    curvature = row.get("quadratic_lsb_per_degc2") or [0.0] * 3
    cell = f"{curvature[index]:.5f}" if curvature[index] else "[0]"
    return f"{cell:>11} {row['quadratic_sem_lsb_per_degc2'][index]:8.5f}"


def _scale(row: dict[str, Any], index: int) -> str:
    """Return the slope of the scale factor, if it is known."""
    slopes, sems = row.get("scale_slope_per_degc"), row.get("scale_slope_sem_per_degc")
    if not slopes or not sems or slopes[index] is None:
        return ""
    return f"; scale {1e6 * slopes[index]:+.0f} +- {1e6 * sems[index]:.0f} ppm/degC"


def _print_pairs(pairs: list[dict[str, Any]]) -> None:
    if not pairs:
        return
    click.echo("opposing axes of one design: slopes, and half their difference, by which their mean drifts")
    click.echo(f"  {'':25} {'LSB/degC':>9} {'LSB/degC':>9} {'half':>9} {'+-':>8} {'factor':>8} {'p':>9}")
    for pair in pairs:
        less = "-" if pair["reduction"] is None else f"{pair['reduction']:.1f}"
        line = f"  {pair['first']} and {pair['second']}"
        line = f"{line:27} {pair['slope_first']:9.4f} {pair['slope_second']:9.4f} {pair['half_difference']:9.4f}"
        line += f" {pair['sem']:8.4f} {less:>8} {pair['p_cancels']:9.2g}"
        click.echo(line + ("" if pair["is_bias"] else "  (bias or scale)"))
    click.echo(
        "factor: slope of one axis over that of the mean; p: probability of such slopes if opposing axes gained nothing"
    )

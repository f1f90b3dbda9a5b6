"""The report of `imuarray calibrate noise`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from imuarray.arrays import Floats
from imuarray.units import READABLE

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration, SensorCalibration
    from imuarray.calibrate.model import NoiseLine

_WORTH_SAYING = 0.2
"""Least share of the variance for which a sentence reports the lines of an axis."""


def report_of(calibration: Calibration) -> dict[str, Any]:
    """Return noise, its correlation and lines, and drift of every sensor in counts and in mg or dps, JSON-ready."""
    return {"sensors": [_row(sensor) for sensor in calibration.sensors.values()]}


def print_report(report: dict[str, Any]) -> None:
    """Print the report as a table, and a sentence for each axis with strong lines."""
    drifting = any(row["drift"] is not None for row in report["sensors"])
    drift_heads = f" {'drift, LSB rms':>18} {'time constant':>24}" if drifting else ""
    click.echo(f"{'axis':14} {'noise, LSB rms':>19} {'noise':>17} {'lag-1':>8} {'lines':>6}{drift_heads}")
    for row in report["sensors"]:
        for index, axis in enumerate("xyz" if row["noise_lsb"] else ""):
            click.echo(
                f"{row['name'] + ' ' + axis:14}"
                f" {_describe_measured(row['noise_lsb'][index], _entry(row['noise_sem_lsb'], index)):>19}"
                f" {row['noise'][index]:9.3f} {row['noise_unit'] + ' rms':>7}"
                f" {_correlation(row['noise_correlation'], index):>8} {_lines(row, axis):>6}"
                + (f" {_drift(row, index):>18} {_time_constant(row):>24}" if drifting else "").rstrip()
            )
    for sentence in _sentences(report):
        click.echo(sentence)
    click.echo("lag-1: correlation of neighbouring readings; lines: share of spectral lines in the variance")
    click.echo("drift: slow change of the mean" if drifting else "drift: not determined, all stretches are too short")


def _row(sensor: SensorCalibration) -> dict[str, Any]:
    factor, unit = READABLE[sensor.unit]
    per_count = factor / sensor.scale_lsb_per_unit
    drift = sensor.drift
    return {
        "name": sensor.name,
        "noise_lsb": _list_figures(sensor.noise_lsb),
        "noise_sem_lsb": _list_figures(sensor.noise_sem_lsb),
        "noise": [] if sensor.noise_lsb is None else _list_figures(sensor.noise_lsb * per_count),
        "noise_unit": unit,
        "noise_correlation": _list_figures(sensor.noise_correlation),
        "lines": [_line(line) for line in sensor.noise_lines],
        "drift": None
        if drift is None
        else {
            "rms_lsb": _list_figures(drift.rms_lsb),
            "rms_sem_lsb": _list_figures(drift.rms_sem_lsb),
            "rms_upper_lsb": _list_figures(drift.rms_upper_lsb),
            "rms": _list_figures(drift.rms_lsb * per_count),
            "time_constant_s": drift.time_constant_s,
            "time_constant_interval_s": _list_figures(drift.time_constant_interval_s),
            "span_s": drift.span_s,
        },
    }


def _line(line: NoiseLine) -> dict[str, Any]:
    return {**vars(line), "range_hz": _list_figures(line.range_hz) or None}


def _list_figures(values: Floats | None) -> list[float]:
    return [] if values is None else [float(value) for value in values]


def _entry(values: list[float], index: int) -> float | None:
    return values[index] if values else None


def _describe_measured(value: float, sem: float | None) -> str:
    return f"{value:.3f}" if sem is None else f"{value:.3f} +- {sem:.3f}"


def _correlation(values: list[float], index: int) -> str:
    return f"{values[index]:+.3f}" if values else "-"


def _drift(row: dict[str, Any], index: int) -> str:
    """Return the rms with its standard error; its upper bound if it is less than two standard errors."""
    drift = row["drift"]
    if drift is None:
        return "-"
    rms, sem = drift["rms_lsb"][index], drift["rms_sem_lsb"][index]
    if rms < 2 * sem and drift["rms_upper_lsb"]:
        return f"below {drift['rms_upper_lsb'][index]:.3f}"
    return _describe_measured(rms, sem)


def _time_constant(row: dict[str, Any]) -> str:
    """Return the time constant with its interval; "-" if no axis drifts significantly."""
    drift = row["drift"]
    if drift is None or not any(
        rms >= 2 * sem for rms, sem in zip(drift["rms_lsb"], drift["rms_sem_lsb"], strict=True)
    ):
        return "-"
    ends = drift["time_constant_interval_s"] or (None, None)
    first, last = (None if end is None or np.isnan(end) else _whole(end) for end in ends)
    if first is None:
        interval = "uncertain" if last is None else f"<= {last}"
    else:
        interval = f">= {first}" if last is None else f"{first} to {last}"
    return f"{_whole(drift['time_constant_s'])} s ({interval})"


def _whole(seconds: float) -> str:
    """Return seconds with at least three digits and without an exponent."""
    return f"{seconds:.0f}" if seconds >= 100 else f"{seconds:.3g}"


def _lines(row: dict[str, Any], axis: str) -> str:
    share = sum(line["share"] for line in row["lines"] if line["axis"] == axis)
    return "-" if share == 0 else f"{100 * share:.0f} %" if share >= 0.01 else "< 1 %"


def _place(line: dict[str, Any]) -> str:
    return "{:.2f} to {:.2f}".format(*line["range_hz"]) if line["range_hz"] else f"{line['frequency_hz']:.2f}"


def _sentences(report: dict[str, Any]) -> Iterator[str]:
    for row in report["sensors"]:
        for axis in "xyz":
            lines = [line for line in row["lines"] if line["axis"] == axis]
            if lines and lines[0]["share"] >= _WORTH_SAYING:
                strong = [line for line in lines if line["share"] >= lines[0]["share"] / 4]
                which = ", ".join(_place(line) for line in strong)
                share = 100 * sum(line["share"] for line in strong)
                yield (
                    f"{row['name']} {axis}: {'a line' if len(strong) == 1 else 'lines'} at {which} Hz"
                    f" {'carries' if len(strong) == 1 else 'carry'} {share:.0f} % of the scatter;"
                    " fusion that weighs by noise gives it less weight"
                )

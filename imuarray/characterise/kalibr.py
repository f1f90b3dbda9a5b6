"""Noise figures as Kalibr's `imu.yaml` has them (ethz-asl/kalibr, wiki "IMU Noise Model"): SI, one file an IMU.

An IMU there has one figure for all three axes: the largest of them, which Kalibr's own advice errs towards. The random
walk is that of the bias (rate random walk K); where none is seen there is no figure, only a comment with the bound that
the log allows: what Kalibr reads is measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_PREFIX = {"specific_force": "accelerometer", "angular_rate": "gyroscope"}
_UNITS = {"specific_force": "m/s^2", "angular_rate": "rad/s"}


def imu_files(result: Mapping[str, Any]) -> dict[str, str]:
    """File name ("imu_Gyro1.yaml") to text, for every accelerometer and gyroscope of a `characterise_log` result whose
    noise could be fitted; the two halves of a six-axis chip ("IMU1_acc", "IMU1_gyro") share a file.
    """
    units: dict[str, list[Mapping[str, Any]]] = {}
    for sensor in result["sensors"]:
        if sensor["quantity"] in _PREFIX and _bound(sensor, "white") is not None:
            units.setdefault(_unit_name(sensor["name"]), []).append(sensor)
    return {f"imu_{name}.yaml": _joined(sensors, result) for name, sensors in units.items()}


def imu_text(result: Mapping[str, Any]) -> str | None:
    """The text of one IMU of all sensors of a result: an accelerometer, a gyroscope, or one of each; None if there are
    others, or the noise of one could not be fitted.
    """
    sensors = [sensor for sensor in result["sensors"] if sensor["quantity"] in _PREFIX]
    alone = len({sensor["quantity"] for sensor in sensors}) == len(sensors) > 0
    fitted = all(_bound(sensor, "white") is not None for sensor in sensors)
    return _joined(sensors, result) if alone and fitted else None


def _joined(sensors: list[Mapping[str, Any]], result: Mapping[str, Any]) -> str:
    return "\n".join(_text(sensors, result)) + "\n"


def _unit_name(name: str) -> str:
    for half in ("_acc", "_gyro"):
        name = name.removesuffix(half)
    return name


def _text(sensors: list[Mapping[str, Any]], result: Mapping[str, Any]) -> Iterator[str]:
    stretch = result["stretch"]
    seconds = stretch["end_s"] - stretch["start_s"]
    yield f"# {result['software']}: noise at rest, {seconds:.0f} s; the largest of three axes, discretised by no factor"
    for sensor in sensors:
        prefix, unit = _PREFIX[sensor["quantity"]], _UNITS[sensor["quantity"]]
        density, walk, bound = _worst(sensor, "white"), _worst(sensor, "random walk"), _bound(sensor, "random walk")
        if density is not None:
            yield f"{prefix}_noise_density: {density:.6g}  # {unit}/sqrt(Hz)"
        else:
            yield f"# {prefix}_noise_density: none was seen, at most {_bound(sensor, 'white'):.6g} {unit}/sqrt(Hz)"
        if walk is not None:
            yield f"{prefix}_random_walk: {walk:.6g}  # {unit}/s/sqrt(Hz)"
        elif bound is not None:
            yield f"# {prefix}_random_walk: none was seen, at most {bound:.6g} {unit}/s/sqrt(Hz)"
    if any(axis["fit"]["verdict"] for sensor in sensors for axis in sensor["axes"] if axis.get("fit")):
        yield "# the Allan curve of one of the axes is none of these noises': see what stands out before trusting this"
    yield f"update_rate: {sensors[0]['rate_hz']:.6g}  # Hz"


def _worst(sensor: Mapping[str, Any], term: str) -> float | None:
    """The largest of the axes' coefficients in SI, of those in which the term was seen; None if it was in none."""
    return _largest(sensor, [item["value"] for item in _terms(sensor, term) if item["significant"]])


def _bound(sensor: Mapping[str, Any], term: str) -> float | None:
    """What the term stays below in all axes, in SI; None without a fit."""
    return _largest(sensor, [item["high"] for item in _terms(sensor, term)])


def _terms(sensor: Mapping[str, Any], term: str) -> list[Mapping[str, Any]]:
    terms = [axis["fit"]["terms"].get(term) for axis in sensor["axes"] if axis.get("fit")]
    return [item for item in terms if item]


def _largest(sensor: Mapping[str, Any], values: list[float]) -> float | None:
    scale = sensor["si_per_count"]
    return max(values) * scale if values and scale is not None else None

"""Comparison of several calibrations of one array: what changed between them, in standard errors.

A figure that was measured n times with standard errors s_i has changed if ``sum of (x_i - mean)^2 / s_i^2`` about the
weighted mean is improbably large for chi-squared with n - 1 degrees of freedom, corrected for the number of figures
(Holm). Biases are compared at one temperature if the calibrations state temperatures and slopes.

The change that all U units of a design have in common along one of their own axes, c_k in calibration k, is separated
from the change of each unit by analysis of variance: ``F = U sum c_k^2 / (n - 1)`` over the mean square of the rest.
The comparison also states the part of this change that opposing axes cancel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, fdtrc, stdtr

from imuarray.arrays import Floats
from imuarray.calibrate.model import Calibration, SensorCalibration
from imuarray.calibrate.turn_on import holm
from imuarray.errors import CalibrationError

CHANGED = 0.05
"""Probability, corrected for the number of figures, below which a figure is reported as changed."""

_OPPOSITE = -0.9
"""Cosine between two axes that oppose each other."""


@dataclass(frozen=True)
class Change:
    """One figure of one axis in the n calibrations that contain it.

    `values` and `sems` (standard errors) are in `unit`. `p_value` is the probability of differences at least as large
    without a change, corrected for the number of figures. `first` and `last` are the two calibrations that differ most,
    `difference` is their difference, in `unit`, and `sigmas` the same in standard errors.
    """

    sensor: str
    axis: str
    figure: str
    unit: str
    calibrations: tuple[int, ...]
    values: tuple[float, ...]
    sems: tuple[float, ...]
    p_value: float
    first: int
    last: int
    difference: float
    sigmas: float

    @property
    def changed(self) -> bool:
        """Return whether the change is significant."""
        return self.p_value < CHANGED


@dataclass(frozen=True)
class CommonChange:
    """Change of the biases of a design along one of its own axes: the standard deviation over calibrations of the part
    that all `units` share (`common`) and of the part of each unit (`own`), in `unit`; `p_value` is the probability of a
    common part at least as large by chance.
    """

    chip: str
    axis: str
    unit: str
    units: tuple[str, ...]
    common: float
    own: float
    p_value: float


@dataclass(frozen=True)
class OpposedChange:
    """Change of the biases of two axes of one design that oppose each other along a box axis: the rms over calibrations
    of a single axis (`alone`) and of the mean of both in the box frame (`together`), in `unit`; the `correlation` of
    their changes along their own axes, and the probability of a correlation at least as large by chance (nan for two
    calibrations).
    """

    chip: str
    first: str
    second: str
    box_axis: str
    unit: str
    alone: float
    together: float
    correlation: float
    p_value: float


@dataclass(frozen=True)
class CalibrationComparison:
    """Result of `compare_calibrations`; `names` are the names of the calibrations."""

    names: tuple[str, ...]
    changes: tuple[Change, ...]
    common: tuple[CommonChange, ...]
    opposed: tuple[OpposedChange, ...]


def compare_calibrations(calibrations: Mapping[str, Calibration]) -> CalibrationComparison:
    """Compare two or more calibrations, given by name. CalibrationError if there are fewer, if two different sensors
    have the same name, or if no sensor is in two calibrations.
    """
    names, files = tuple(calibrations), list(calibrations.values())
    if len(files) < 2:
        raise CalibrationError("at least two calibrations are required")
    results: dict[str, dict[int, SensorCalibration]] = {}
    for number, file in enumerate(files):
        for name, sensor in file.sensors.items():
            results.setdefault(name, {})[number] = sensor
    shared = {name: each for name, each in results.items() if len(each) > 1}
    if not shared:
        raise CalibrationError(f"{', '.join(names)}: no sensor is in two of them")
    for name, each in shared.items():
        _refuse_two(name, names, each)
    changes = [change for name, each in shared.items() for change in _changes(name, each)]
    limits = holm([change.p_value for change in changes])
    biases = {name: _biases(each) for name, each in shared.items() if len(_biases(each)) == len(files)}
    return CalibrationComparison(
        names,
        tuple(replace(change, p_value=float(p)) for change, p in zip(changes, limits, strict=True)),
        tuple(_common(shared, biases)),
        tuple(_find_opposed(shared, biases)),
    )


def _refuse_two(name: str, names: Sequence[str], calibrations: Mapping[int, SensorCalibration]) -> None:
    """Raise CalibrationError if calibrations of two different sensors have the same name."""
    (first, calibration), *others = calibrations.items()
    for number, other in others:
        for key in ("quantity", "unit", "chip", "range"):
            value, other_value = getattr(calibration, key), getattr(other, key)
            if None not in (value, other_value) and value != other_value:
                raise CalibrationError(
                    f"sensor {name}: {key} {value} in {names[first]}, {other_value} in {names[number]}: two sensors"
                    " with the same name"
                )


def _changes(name: str, calibrations: Mapping[int, SensorCalibration]) -> Iterator[Change]:
    """Yield every figure that at least two calibrations measured; its probability is not yet corrected for the number
    of figures.
    """
    temperature = _temperature(calibrations)
    rows: dict[tuple[str, str, str], dict[int, tuple[float, float]]] = {}
    for number, sensor in calibrations.items():
        for axis, figure, unit, value, sem in _figures(sensor, temperature):
            if np.isfinite(value) and np.isfinite(sem) and sem > 0:
                rows.setdefault((axis, figure, unit), {})[number] = value, sem
    for (axis, figure, unit), entries in rows.items():
        if len(entries) < 2:
            continue
        numbers = tuple(entries)
        values, sems = np.array(list(entries.values())).T
        weights = sems**-2
        mean = float(np.sum(weights * values) / weights.sum())
        chi_squared = float(np.sum(weights * (values - mean) ** 2))
        sigmas = np.abs(values[:, None] - values) / np.hypot(sems[:, None], sems)
        first, last = sorted(np.unravel_index(int(sigmas.argmax()), sigmas.shape))
        yield Change(
            name,
            axis,
            figure,
            unit,
            numbers,
            tuple(values.tolist()),
            tuple(sems.tolist()),
            float(chdtrc(len(values) - 1, chi_squared)),
            numbers[first],
            numbers[last],
            float(values[last] - values[first]),
            float(sigmas[first, last]),
        )


def _temperature(calibrations: Mapping[int, SensorCalibration]) -> float | None:
    """Return the temperature in degC at which biases are compared: the mean over the calibrations that measured a bias;
    None unless all of these state their temperature.
    """
    of_biased = [sensor.temperature_degc for sensor in calibrations.values() if sensor.bias_sem_lsb is not None]
    temperatures = [degc for degc in of_biased if degc is not None]
    return float(np.mean(temperatures)) if temperatures and len(temperatures) == len(of_biased) else None


def _figures(sensor: SensorCalibration, degc: float | None) -> Iterator[tuple[str, str, str, float, float]]:
    """Yield axis, figure, unit, value and standard error of everything that was measured."""
    scale, unit = sensor.scale_lsb_per_unit, sensor.unit
    for axis, letter in enumerate("xyz"):
        if sensor.bias_sem_lsb is not None:
            bias = sensor.bias_lsb if degc is None else sensor.bias_at(degc)
            yield letter, "bias", unit, float(bias[axis] / scale[axis]), float(sensor.bias_sem_lsb[axis] / scale[axis])
        covariance = sensor.response_covariance()
        if covariance is not None:
            row, block = sensor.directions_box[axis], covariance[3 * axis : 3 * axis + 3, 3 * axis : 3 * axis + 3]
            yield letter, "scale factor", f"LSB/{unit}", float(scale[axis]), float(np.sqrt(row @ block @ row))
            for box in np.argsort(np.abs(row))[:2]:
                across = np.eye(3)[box] - row[box] * row
                lean = float(np.degrees(row[box]))
                yield (
                    letter,
                    f"lean to {'XYZ'[box]}",
                    "deg",
                    lean,
                    float(np.degrees(np.sqrt(across @ block @ across) / scale[axis])),
                )
        if sensor.noise_lsb is not None and sensor.noise_sem_lsb is not None:
            noise, sem = sensor.noise_lsb[axis] / scale[axis], sensor.noise_sem_lsb[axis] / scale[axis]
            yield letter, "noise", unit, float(noise), float(sem)
        if sensor.thermal is not None:
            slope, sem = sensor.thermal.slope_lsb_per_degc[axis], sensor.thermal.slope_sem_lsb_per_degc[axis]
            yield letter, "slope", f"{unit}/degC", float(slope / scale[axis]), float(sem / scale[axis])


def _biases(calibrations: Mapping[int, SensorCalibration]) -> Floats:
    """Return the biases (n, 3) less their mean, in the sensor's unit, from the calibrations that measured them."""
    degc = _temperature(calibrations)
    sensors = [sensor for sensor in calibrations.values() if sensor.bias_sem_lsb is not None]
    rows = [(s.bias_lsb if degc is None else s.bias_at(degc)) / s.scale_lsb_per_unit for s in sensors]
    values = np.array(rows).reshape(-1, 3)
    return np.asarray(values - values.mean(axis=0)) if len(values) else values


def _designs(shared: Mapping[str, Mapping[int, SensorCalibration]], names: Sequence[str]) -> dict[str, list[str]]:
    """Return the sensors of each design: of the same chip and quantity, or of the same quantity without a chip."""
    designs: dict[str, list[str]] = {}
    for name in names:
        sensor = next(iter(shared[name].values()))
        chip = next((calibration.chip for calibration in shared[name].values() if calibration.chip), "")
        designs.setdefault(f"{chip} {sensor.quantity.replace('_', ' ')}".strip(), []).append(name)
    return designs


def _common(
    shared: Mapping[str, Mapping[int, SensorCalibration]], biases: Mapping[str, Floats]
) -> Iterator[CommonChange]:
    for chip, names in _designs(shared, list(biases)).items():
        if len(names) < 2:
            continue
        unit = next(iter(shared[names[0]].values())).unit
        for axis, letter in enumerate("xyz"):
            changes = np.array([biases[name][:, axis] for name in names])  # (u, n), rows of zero mean
            units, freedom = len(changes), changes.shape[1] - 1
            common = changes.mean(axis=0)
            between_units = units * float(np.sum(common**2)) / freedom
            rest = float(np.sum((changes - common) ** 2)) / ((units - 1) * freedom)
            yield CommonChange(
                chip,
                letter,
                unit,
                tuple(names),
                float(np.sqrt(max(between_units - rest, 0.0) / units)),
                float(np.sqrt(rest)),
                float(fdtrc(freedom, (units - 1) * freedom, between_units / rest))
                if rest > 0
                else float(between_units == 0),
            )


def _find_opposed(
    shared: Mapping[str, Mapping[int, SensorCalibration]], biases: Mapping[str, Floats]
) -> Iterator[OpposedChange]:
    for chip, names in _designs(shared, list(biases)).items():
        axes = [(name, axis) for name in names for axis in range(3)]
        rows = {(n, a): next(iter(shared[n].values())).directions_box[a] for n, a in axes}
        for place, item in enumerate(axes):
            for other in axes[place + 1 :]:
                if item[0] == other[0] or float(rows[item] @ rows[other]) > _OPPOSITE:
                    continue
                first_bias, other_bias = biases[item[0]][:, item[1]], biases[other[0]][:, other[1]]
                freedom = len(first_bias) - 1
                size = float(np.sqrt(np.sum(first_bias**2) * np.sum(other_bias**2)))
                correlation = float(np.sum(first_bias * other_bias)) / size if size > 0 else float("nan")
                yield OpposedChange(
                    chip,
                    f"{item[0]} {'xyz'[item[1]]}",
                    f"{other[0]} {'xyz'[other[1]]}",
                    "XYZ"[int(np.abs(rows[item]).argmax())],
                    next(iter(shared[item[0]].values())).unit,
                    float(np.sqrt((np.sum(first_bias**2) + np.sum(other_bias**2)) / 2 / freedom)),
                    float(np.sqrt(np.sum(((first_bias - other_bias) / 2) ** 2) / freedom)),
                    correlation,
                    _chance_of_correlation(correlation, freedom),
                )


def _chance_of_correlation(correlation: float, freedom: int) -> float:
    """Return the probability of a correlation at least as large by chance, by Student's t with one degree of freedom
    less than the changes have; nan for two calibrations, because their changes always correlate fully.
    """
    if freedom < 2 or not np.isfinite(correlation):
        return float("nan")
    t = correlation * np.sqrt((freedom - 1) / max(1 - correlation**2, 1e-300))
    return float(stdtr(freedom - 1, -t))

"""The model of the paper's array, fitted to its tables. This module prints `configs/models/martin2013.toml`.

``python -m imuarray.studies.paper.array_model > configs/models/martin2013.toml``

Wander. Means of a Gauss-Markov process over windows explain Table 11's columns. x is stationary with unit variance and
correlation exp(-|t| / time_constant). Windows of T seconds follow each other directly; with r = time_constant / T and d
= exp(-1 / r), integrating the correlation over one window or over two gives

    var(mean) = 2 r (1 - r (1 - d)),        cov(means k windows apart) = r^2 (1 - d)^2 d^(k - 1),  k >= 1.

Units. The parameters of each of the nine sensors follow from Tables 6 to 11. A reading at rest with the box axis +-K up
and at temperature T is, in counts and along a sensor axis,

    reading = sensitivity (bias + response . force + slope (T - 25 degC)),     force = +-1 g along K.

The six faces of Table 10, brought to 25 degC with the slopes of Table 8 and the face temperatures, give bias (their
mean) and response (half-differences). An accelerometer's response, turned into the sensor's nominal axes, is the
direction of its axis times (1 + error); a gyroscope's is its sensitivity to specific force. During the heating of Table
8, +Z was always up: an axis along Z measured 1 g, so its slope may also be that of its scale factor. The model uses it
as the slope of the bias.

Everything is in g or dps with the data sheets' typical sensitivities, along the sensor's own axes.

Population. Nine sensors on one board also predict other units of the three designs. From k units whose values have mean
m and standard deviation s (over units and axes), a further unit is predicted as m +- s sqrt(1 + 1/k): it differs from
the mean of its design by s, and that mean is only known to s / sqrt(k). The second part is the same for all units that
are drawn, so a share 1 / (k + 1) of the variance is common to them (`shared`). Properties that the paper calls common
to a design (eight of nine gyroscope drifts are positive; ADXL345 z axes are noisier and drift down) are contained in
the means. Parameters that cannot be negative are truncated at 0 and at the same distance above the mean.

Faults of single units (two bias states, a range lost at power-on) are not part of the populations.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from math import atan2, degrees, exp, floor, sqrt
from textwrap import wrap

import numpy as np
from scipy.optimize import brentq

from imuarray.arrays import Floats
from imuarray.axes import orientation_of
from imuarray.simulate.population import Spread
from imuarray.studies.paper.systematic import READINGS, as_text, believed_axes
from imuarray.studies.paper.tables import (
    BMA180_LSB_PER_G,
    DEGC,
    FACES_DEGC,
    Row,
    design_of,
    number_in,
    physical,
    row_of,
    table,
)
from imuarray.studies.paper.variation import bias_states, boot_faults

WINDOW_S = 300.0
"""Duration in s of the means of Table 11: five minutes (section 4)."""
PARTS = 15
"""Number of consecutive windows, and of runs, of which Table 11 gives the standard deviation."""
TIME_CONSTANT_S = 600.0
"""Time constant in s of the in-run wander, the same for all channels. The paper does not print it; three columns
bracket it.

It is longer than 100 s. After subtraction of the drift with temperature, the first and last face of Table 10 differ by
a median of 1.6 in-run deviations of Table 11; a time constant of 100 s predicts 0.64, 600 s predicts 0.94 and 3000 s
predicts 1.4. The ratio of range to deviation of Table 11's fifteen windows is 3.39 on average; independent windows have
3.54, and a time constant of 600 s gives 3.45. It is shorter than 1000 s, because x and y of BMA3 vary less from run to
run than within a run.
"""


def variance_of_mean(window_s: float, time_constant_s: float = TIME_CONSTANT_S) -> float:
    """Return the variance of the mean over one window, as a share of the process's."""
    ratio = time_constant_s / window_s
    return 2 * ratio * (1 - ratio * (1 - exp(-1 / ratio)))


def covariance_of_means(windows_apart: int, window_s: float, time_constant_s: float = TIME_CONSTANT_S) -> float:
    """Return the covariance of the means over two windows; the second begins `windows_apart` >= 1 windows later."""
    ratio = time_constant_s / window_s
    decay = exp(-1 / ratio)
    return ratio**2 * (1 - decay) ** 2 * decay ** (windows_apart - 1)


def expected_scatter() -> float:
    """Return the expected sample variance of the means of `PARTS` consecutive windows of Table 11."""
    pairs = sum((PARTS - k) * covariance_of_means(k, WINDOW_S) for k in range(1, PARTS))
    return variance_of_mean(WINDOW_S) - 2 * pairs / (PARTS * (PARTS - 1))


REFERENCE_DEGC = 25.0
CHIP = {"ADXL": "adxl345", "BMA": "bma180", "Gyro": "l3g4200d"}
RANGE = {"16g": 16.0, "1.5g": 1.5, "2k dps": 2000.0, "250dps": 250.0}
"""Ranges as the tables print them, in the sensor's unit."""
STEP_LSB = {"ADXL": 2.0, "BMA": 1.0, "Gyro": 1.0}
"""Step between the codes that occur: the ADXL345 returned only even codes (appendix A.2)."""
TONE_HZ = 50.0
"""The line on the gyroscopes' y axis (appendix A.1, Figure 14)."""
CUTOFF_HZ = 51.0
"""exp(-2 pi cutoff / 350 Hz) = 0.4, the correlation of neighbours in Figure 13."""
TONE_SHARE = 0.03
"""Assumed share of the line in Table 9's variance on y; the paper prints no number. With this share the autocorrelation
of 480 000 readings has a ripple of 0.03, twenty times its sampling error ("can be clearly seen"), and the deviation of
y grows by 1.5 %, which is less than the 5 % by which Table 9's x and z differ from each other.
"""
STDS = ((10, "std_lsb"), (11, "runs_std"), (11, "cont_std"))


@dataclass(frozen=True)
class SensorUnit:
    """One sensor: vectors have an entry for each of its axes, `response` (3, 3) a row; unit is "g" or "dps".

    `bias` at 25 degC (Gyro3: in its first state), `response` to force along the sensor's nominal axes, `slope` per
    degC, `noise` of single readings, `in_run` the stationary wander's rms, `turn_on` the scatter between runs.
    `thermometer` is the error of the chip's own thermometer, (offset, rms) in degC; None without a thermometer.
    """

    name: str
    design: str
    range: str
    lsb: float
    bias: Floats
    response: Floats
    slope: Floats
    noise: Floats
    in_run: Floats
    turn_on: Floats
    thermometer: tuple[float, float] | None

    @property
    def unit(self) -> str:
        """The data sheet's unit."""
        return "dps" if self.design == "Gyro" else "g"

    @property
    def scale_error(self) -> Floats:
        """The accelerometer's scale factors relative to the typical one, less one."""
        return np.asarray(np.linalg.norm(self.response, axis=1) - 1)

    @property
    def angles_deg(self) -> list[float]:
        """Return the misalignments of an accelerometer's axes towards the others: xy, xz, yx, yz, zx, zy."""
        r = self.response
        return [degrees(atan2(r[i, j], r[i, i])) for i in range(3) for j in range(3) if i != j]


@cache
def units() -> tuple[SensorUnit, ...]:
    """Return the nine sensors in the order of Table 1."""
    return tuple(_unit(row["sensor"]) for row in table(1))


def unit_of(name: str) -> SensorUnit:
    """Return the sensor of that name."""
    return next(unit for unit in units() if unit.name == name)


def tone_dps() -> float:
    """Return the amplitude of the line on the gyroscopes' y axis: `TONE_SHARE` of Table 9's variance at 250 dps."""
    row = next(row for row in table(9) if row["output"] == "Gyro1 y" and row["range"] == "250dps")
    return sqrt(2 * TONE_SHARE) * float(number_in(row, "std_dps"))


def gyro3_other_state_lsb() -> Floats:
    """Return the step in counts from Gyro3's first state of Table 7 to its second, in which 8 of 15 runs started."""
    first, second = bias_states()
    return np.asarray(np.array(second.centre) - np.array(first.centre))


def bma1_reset_offset_g() -> Floats:
    """Return the difference of BMA1's reading in run 10 of Table 6, taken at 2 g, from its other runs, in g."""
    faulty = {fault.run: float(fault.range_lsb_per_g) for fault in boot_faults()}
    ((run, lsb_per_g),) = faulty.items()
    runs = runs_of("BMA1")
    usual = np.delete(runs, run - 1, axis=0).mean(axis=0) / float(BMA180_LSB_PER_G["16g"])
    return np.asarray(runs[run - 1] / lsb_per_g - usual)


def bma1_reset_noise_share() -> Floats:
    """Return the noise of BMA1 in run 10 over its usual noise in g.

    Table 11 prints the mean deviation of the 15 runs. The deviation of the fourteen runs without the fault is assumed
    to have the same ratio to that of the continuous run as for BMA2; the rest of the sum is that of run 10.
    """
    continuous, runs = (_column(11, "BMA1", column) for column in ("cont_std", "runs_std"))
    sound = continuous * _column(11, "BMA2", "runs_std") / _column(11, "BMA2", "cont_std")
    faulty = len(runs_of("BMA1")) * runs - (len(runs_of("BMA1")) - 1) * sound
    ratio = float(BMA180_LSB_PER_G["16g"] / BMA180_LSB_PER_G["2g"])
    return np.asarray(faulty / sound * ratio)


def runs_of(name: str) -> Floats:
    """Return (15, 3) means of the runs of Table 6 ("BMA1") or 7 ("Gyro3"), counts."""
    number = {"BMA1": 6, "Gyro3": 7}[name]
    return np.array([[float(number_in(row, f"{axis}_lsb")) for axis in "xyz"] for row in table(number)])


def gyro1_bias_at_250dps() -> Floats:
    """Return the bias of Gyro1 at 250 dps from Table 9 (+X up), because the bias depends on the range (section 5.1)."""
    gyro = unit_of("Gyro1")
    rows = [row for row in table(9) if row["range"] == "250dps"]
    means = np.array([float(number_in(row, "mean_dps")) for row in rows])
    along_x = np.array(orientation_of(as_text(believed_axes("Gyro1"))))[0]
    return np.asarray(means - gyro.response @ along_x - gyro.slope * (high_rate_degc("250dps") - REFERENCE_DEGC))


def high_rate_degc(range_name: str) -> float:
    """Return the temperature of a high-rate experiment of Table 9 by Gyro1's thermometer, the only one printed."""
    rows = [row for row in table(9) if row["output"] == "Gyro1 t"]
    row = rows[0] if range_name == "250dps" else rows[1]
    return _zero("Gyro1") - float(number_in(row, "mean_lsb"))


def _unit(name: str) -> SensorUnit:
    rows = [row_of(10, f"{name} {axis}") for axis in "xyz"]
    per_lsb = float(physical(rows[0], Decimal(1)))
    design = design_of(name)
    lsb = per_lsb if design == "Gyro" else per_lsb / 1000
    slope = _column(8, name, "slope_lsb_per_degc")
    bias, response = _six_faces(name, rows, slope)
    in_run = _in_run(name, slope)
    thermometer = None if design == "ADXL" else _thermometer_parameters(name, design)
    noise, turn_on = _noise(name, design, lsb), _turn_on(name, slope, in_run)
    bias, response, slope, noise, in_run, turn_on = (
        part * lsb for part in (bias, response, slope, noise, in_run, turn_on)
    )
    range_name = rows[0]["range"]
    return SensorUnit(name, design, range_name, lsb, bias, response, slope, noise, in_run, turn_on, thermometer)


def _column(number: int, name: str, column: str) -> Floats:
    return np.array([float(number_in(row_of(number, f"{name} {axis}"), column)) for axis in "xyz"])


def _six_faces(name: str, rows: Sequence[Row], slope: Floats) -> tuple[Floats, Floats]:
    """Return bias (3,) at 25 degC and response (3, 3) along the sensor's nominal axes, counts and counts per g."""
    readings = np.array([[float(number_in(row, face)) for face in READINGS[:6]] for row in rows])
    readings = readings - slope[:, None] * (np.array(FACES_DEGC[:6]) - REFERENCE_DEGC)
    z_up, x_up, y_up, x_down, y_down, z_down = readings.T
    box = np.stack([x_up - x_down, y_up - y_down, z_up - z_down], axis=1) / 2
    state = gyro3_other_state_lsb() if name == "Gyro3" else 0.0  # Table 10 shows the second state's biases
    return readings.mean(axis=1) - state, box @ np.array(orientation_of(as_text(believed_axes(name))))


def _noise(name: str, design: str, lsb: float) -> Floats:
    """Return the root of the mean variance in three experiments, in counts, without rounding and the line."""
    variance = np.mean([_column(number, name, column) ** 2 for number, column in STDS], axis=0)
    tone = np.array([0.0, (tone_dps() / lsb) ** 2 / 2, 0.0]) if design == "Gyro" else 0.0
    return np.asarray(np.sqrt(variance - STEP_LSB[design] ** 2 / 12 - tone))


def _in_run(name: str, slope: Floats) -> Floats:
    """Return the rms of the in-run wander from Table 11's in-run deviation, after subtraction of white noise and the
    drift with temperature.
    """
    scatter = _column(11, name, "cont_std_of_means") ** 2 - _column(11, name, "cont_sem") ** 2
    remaining = scatter - (slope * DEGC[11, "cont_std_of_means"]) ** 2
    return np.asarray(np.sqrt(np.maximum(remaining, 0) / expected_scatter()))


def _turn_on(name: str, slope: Floats, in_run: Floats) -> Floats:
    """Return the turn-on deviation from Table 11's run-to-run deviation, after subtraction of white noise, temperature
    and the in-run wander of a run's mean.
    """
    remaining = _run_variance(name) - _column(11, name, "runs_sem") ** 2 - in_run**2 * variance_of_mean(WINDOW_S)
    return np.asarray(np.sqrt(np.maximum(remaining - (slope * DEGC[11, "runs_std_of_means"]) ** 2, 0)))


def _run_variance(name: str) -> Floats:
    """Return the variance of the runs' means: for BMA1 without its fault, for Gyro3 within its states, otherwise Table
    11's column.
    """
    if name == "BMA1":
        return np.asarray(np.delete(runs_of(name), [fault.run - 1 for fault in boot_faults()], axis=0).var(0, ddof=1))
    if name == "Gyro3":
        states = bias_states()
        squares = sum((len(state.runs) - 1) * np.array(state.spread) ** 2 for state in states)
        return np.asarray(squares / (sum(len(state.runs) for state in states) - len(states)))
    return _column(11, name, "runs_std_of_means") ** 2


def _zero(name: str) -> float:
    """Return the code of a gyroscope's thermometer at 0 degC: it decreases by one per degC (L3G-60)."""
    return float(np.mean([code + degc for code, degc in _thermometer_readings(name)]))


def _thermometer_readings(name: str) -> list[tuple[float, float]]:
    """Return (mean code, independent temperature) of Table 10 and the two halves of Table 11."""
    faces = row_of(10, f"{name} t")
    first = (float(np.mean([float(number_in(faces, face)) for face in READINGS])), float(np.mean(FACES_DEGC)))
    columns = ("runs_mean", "cont_mean")
    return [first, *((float(number_in(row_of(11, f"{name} t"), column)), DEGC[11, column]) for column in columns)]


def _thermometer_parameters(name: str, design: str) -> tuple[float, float]:
    """Return (offset, rms) in degC: a BMA180's code is 2 (T - 24 degC) (BMA-63), an L3G4200D's 47 - T by convention."""
    readings = _thermometer_readings(name)
    if design == "Gyro":
        return 47.0 - _zero(name), rms_before_rounding(_code_variance(name, 1.0))
    offset = float(np.mean([24.0 + code / 2 - degc for code, degc in readings]))
    return offset, sqrt(_code_variance(name, 2.0) - 1 / 12) / 2


def _code_variance(name: str, codes_per_degc: float) -> float:
    """Return the mean variance of the thermometer's codes in three experiments, minus that of the temperature."""
    variances = [float(number_in(row_of(number, f"{name} t"), column)) ** 2 for number, column in STDS]
    return float(np.mean(variances) - codes_per_degc**2 * np.mean([DEGC[key] ** 2 for key in STDS]))


def rms_before_rounding(variance: float) -> float:
    """Return the rms of the noise that has this variance, on average, after rounding to whole codes, if its mean is at
    a random position between two codes.

    The average is s^2 + 1/12 - sum_k exp(-4 pi^2 k^2 s^2) / (2 pi^2 k^2); it grows with s from 0.
    """
    k = np.arange(1, 200)

    def excess(s: float) -> float:
        bias = np.sum(np.exp(-4 * np.pi**2 * k**2 * s**2) / (2 * np.pi**2 * k**2))
        return float(s**2 + 1 / 12 - bias - variance)

    return float(brentq(excess, 0.0, 2.0, xtol=1e-15))


Table = dict[str, object]

NOISE_BANDWIDTH_HZ = {"adxl345": 800.0, "l3g4200d": 35.0}
"""Bandwidths in Hz of `configs/martin2013.toml` at which the noise of Tables 10 and 11 holds: half of 1600 Hz (ADX-32),
and 35 Hz (this gives 0.03 dps/sqrt(Hz), L3G-74). The paper does not state that of the BMA180; its noise is used as
printed.
"""


def spread(values: Floats, count: int, *, positive: bool = False) -> Spread:
    """Return the population that is predicted by `values` (any shape) of `count` units."""
    mean, sigma = float(values.mean()), float(values.std(ddof=1)) * sqrt(1 + 1 / count)
    limit = floor(mean * 1e6) / 1e6 if positive and mean < 3 * sigma else None
    return Spread(mean=mean, sigma=sigma, shared=1 / (count + 1), limit=limit)


def about_zero(values: Floats, count: int) -> Spread:
    """Return the same for a parameter without a preferred sign: the mean is 0."""
    return Spread(sigma=float(np.sqrt(np.mean(values**2))) * sqrt(1 + 1 / count), shared=1 / (count + 1))


def designs() -> Iterator[tuple[Table, dict[str, Table]]]:
    """Yield (head, effects) of every [[design]] table: each chip at any range, then the effects that depend on the
    range.
    """
    for design, chip in CHIP.items():
        group = [unit for unit in units() if unit.design == design]
        head: Table = {"chip": chip}
        if chip in NOISE_BANDWIDTH_HZ:
            head["noise_bandwidth_hz"] = NOISE_BANDWIDTH_HZ[chip]
        yield head, _population(group, _POPULATION_EFFECTS)
        ranges = dict.fromkeys(unit.range for unit in group)
        for name in ranges if len(ranges) > 1 else ():  # only the bias of gyroscopes depends on the range (section 5.1)
            members = [unit for unit in group if unit.range == name]
            yield {**head, "range": RANGE[name]}, _population(members, _OF_RANGE if design == "BMA" else ("bias",))


_OF_RANGE = ("bias", "turn_on_bias", "bias_instability", "white_noise")
_POPULATION_EFFECTS = (
    "g_sensitivity", "misalignment", "scale", "thermal_bias", "thermometer", *_OF_RANGE, "tone", "bandwidth"
)  # fmt: skip
"""The effects that have populations, in the order of the file; faults of single units are not included."""


def _population(group: Sequence[SensorUnit], names: Sequence[str]) -> dict[str, Table]:
    """Return the effects that these units predict for other units of the design; effects they lack are omitted."""
    measured = [unit_effects(unit) for unit in group]
    design, first = group[0].design, measured[0]
    return {
        name: {
            key: _foretold(design, name, key, [known_unit[name][key] for known_unit in measured]) for key in first[name]
        }
        for name in names
        if name in first
    }


def _foretold(design: str, effect: str, key: str, values: Sequence[object]) -> object:
    """Return the population of a parameter: one for all axes, or for the ADXL345 one for x and y and another one for z,
    whose design differs (section 2.2).
    """
    if effect in ("tone", "bandwidth") or key == "time_constant_s":
        return values[0]
    measured, count = np.array(values, float), len(values)
    if effect in ("g_sensitivity", "misalignment"):  # no direction is preferred
        return about_zero(measured, count)
    positive = key.startswith("rms_")
    if design != "ADXL":
        return spread(measured, count, positive=positive)
    plane, across = (spread(part, count, positive=positive) for part in (measured[:, :2], measured[:, 2]))
    return [plane, plane, across]


_HEAD = """\
# The nine inertial sensors of Martin, Groves, Newman and Faragher (ION GNSS+ 2013), fitted to the tables they print.
# Written by `python -m imuarray.studies.paper.array_model`; don't edit. Its fidelity: `imuarray paper --replica`.
# Counts are converted to g and dps with the data sheets' typical sensitivities. Axes are those of the sensor.
"""
_SOURCES = {
    "misalignment": "Table 10: directions of the half-differences (up - down) / 2, which include the board's rotation",
    "scale": "Table 10: norm of the half-differences over the typical sensitivity, minus one (Table 3)",
    "g_sensitivity": "Table 10: half-differences, rotated into the sensor's axes (half of Table 4's differences)",
    "bias": "Table 10: mean of the six faces, each corrected to 25 degC with Table 8's slope",
    "thermal_bias": "Table 8 (an accelerometer axis along box Z measured 1 g: the slope may be its scale factor's)",
    "turn_on_bias": "Table 11: (deviation of the 15 runs' means)^2 - sem^2 - (slope 0.131 degC)^2 - in-run part; 0 if "
    "nothing remains",
    "bias_instability": "Table 11: ((deviation of the 15 five-minute means)^2 - sem^2 - (slope 0.086 degC)^2) / 0.665, "
    "the share of the variance of a Gauss-Markov process of 600 s in such means (array_model.py brackets the 600 s)",
    "white_noise": "Tables 10 and 11: mean variance of three experiments minus step^2 / 12; gyroscope y: also minus "
    "the tone",
    "tone": "Figure 14: near 50 Hz, y only, seen on Gyro1; the amplitude is not printed: 3 % of Table 9's variance, a "
    "guess",
    "bandwidth": "Figure 13: neighbours at 350 Hz correlate by 0.4 = exp(-2 pi 51 / 350); no effect at 48 Hz",
    "thermometer": "Tables 10 and 11, rows t, compared with the BMP180; the zero of an L3G4200D varies from part to "
    "part (L3G-60): 47 - T is assumed",
    "bistable_bias": "Table 7: second state minus first, in 8 of 15 runs, all axes together",
    "range_reset": "Table 6, run 10 of 15: at the power-on range of 2 g (4096 LSB/g) the offset differs (BMA-79); "
    "Table 11: so does the noise, a tenth to a sixth in g",
}
_NOTES = {
    ("Gyro1", "bias"): "at all ranges except 250 dps: Table 10, at 2000 dps",
    ("Gyro3", "bias"): "of the first of two states; Table 10 shows the second",
    ("Gyro1 at 250", "bias"): "Table 9 at 250 dps: +X up, at 23.9 degC by Gyro1's own thermometer",
}
_POPULATION = """\
# Other units of these designs: mean and spread over the units above and their axes, widened because these are few;
# `shared` is the share of the variance common to all drawn units (array_model.py).
"""


_MAGNETOMETERS = """\
# The paper logs its two magnetometers but does not analyse them. Data sheet: gain +-5 % (HMC-52), -1.2 counts of 1024
# per degC (HMC-57), 10 mG (HMC-53).
"""


def fit_text() -> str:
    """Return the whole model file."""
    parts = [_HEAD, _lines({"name": "martin2013", "about": "the array of the paper, unit by unit"}, "[model]")]
    parts += [_sensor(unit) for unit in units()]
    head: Table = {"name": "Gyro1", "chip": CHIP["Gyro"], "range": 250.0}
    parts.append(_part("sensor", head, {"bias": {"offset_dps": gyro1_bias_at_250dps()}}, "Gyro1 at 250"))
    parts.append(_POPULATION)
    parts += [_part("design", head, effects) for head, effects in designs()]
    compass: dict[str, Table] = {
        "scale": {"error": Spread(sigma=0.025, limit=0.05)},
        "thermal_scale": {"slope_per_degc": -1.2 / 1024},
        "white_noise": {"rms_gauss": 0.01},
    }
    return "\n".join([*parts, _MAGNETOMETERS, _part("design", {"chip": "hmc5883"}, compass)])


def unit_effects(unit: SensorUnit) -> dict[str, Table]:
    """Return the effects of a known unit, with keys and values in the form of a model file."""
    u = unit.unit
    effects: dict[str, Table] = {"g_sensitivity": {"response_dps_per_g": unit.response.ravel()}}
    if u == "g":
        effects = {"misalignment": {"angles_deg": np.array(unit.angles_deg)}, "scale": {"error": unit.scale_error}}
    effects["bias"] = {f"offset_{u}": unit.bias}
    effects["turn_on_bias"] = {f"rms_{u}": unit.turn_on}
    if unit.name == "Gyro3":
        effects["bistable_bias"] = {"offset_dps": gyro3_other_state_lsb() * unit.lsb, "probability": 8 / 15}
    if unit.name == "BMA1":
        fault: Table = {"range_g": 2.0, "offset_g": bma1_reset_offset_g(), "noise_share": bma1_reset_noise_share()}
        effects["range_reset"] = {**fault, "probability": 1 / 15}
    effects["thermal_bias"] = {f"slope_{u}_per_degc": unit.slope}
    effects["bias_instability"] = {f"rms_{u}": unit.in_run, "time_constant_s": TIME_CONSTANT_S}
    if u == "dps":
        effects["tone"] = {"amplitude_dps": np.array([0.0, tone_dps(), 0.0]), "frequency_hz": TONE_HZ}
        effects["bandwidth"] = {"cutoff_hz": CUTOFF_HZ}
    effects["white_noise"] = {f"rms_{u}": unit.noise}
    if unit.thermometer is not None:
        effects["thermometer"] = dict(zip(("offset_degc", "rms_degc"), unit.thermometer, strict=True))
    return effects


def _sensor(unit: SensorUnit) -> str:
    head: Table = {"name": unit.name, "chip": CHIP[unit.design]}
    if unit.name != "Gyro1":
        head["range"] = RANGE[unit.range]
    if head["chip"] in NOISE_BANDWIDTH_HZ:
        head["noise_bandwidth_hz"] = NOISE_BANDWIDTH_HZ[CHIP[unit.design]]
    effects = {
        kind: table
        for kind, table in unit_effects(unit).items()
        if any(np.any(np.asarray(value) != 0) for key, value in table.items() if key != "time_constant_s")
    }
    return _part("sensor", head, effects, unit.name)


def _part(kind: str, head: Table, effects: Mapping[str, Table], name: str = "") -> str:
    texts = [_lines(head, f"[[{kind}]]")]
    for effect, parameters in effects.items():
        source = _NOTES.get((name, effect), "") or (_SOURCES[effect] if kind == "sensor" else "")
        comment = "".join(f"# {line}\n" for line in wrap(source, 118))
        texts.append(comment + _lines(parameters, f"[{kind}.{effect}]"))
    return "\n".join(texts)


def _lines(table: Table, title: str) -> str:
    return "\n".join([title, *(f"{key} = {_value(value)}" for key, value in table.items())]) + "\n"


def _value(value: object) -> str:
    """Format as TOML a text, a number (six digits), a population, or a list of them."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Spread) and value.sigma == 0:
        return _value(value.mean)
    if isinstance(value, Spread):
        items = {"mean": value.mean, "sigma": value.sigma, "limit": value.limit, "shared": value.shared}
        return "{ " + ", ".join(f"{key} = {_value(item)}" for key, item in items.items() if item is not None) + " }"
    if isinstance(value, list) and isinstance(value[0], Spread):
        return "[\n" + "".join(f"  {_value(item)},\n" for item in value) + "]"
    if isinstance(value, list | np.ndarray):
        return f"[{', '.join(map(_value, value))}]"
    if not isinstance(value, float):
        raise TypeError(f"{value!r}: not a parameter of a model")
    text = f"{value:.6g}"
    return text if any(mark in text for mark in ".en") else f"{text}.0"


if __name__ == "__main__":
    sys.stdout.write(fit_text())

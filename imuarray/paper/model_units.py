"""The nine sensors of the paper's array as parameters of a simulator, one by one, from Tables 6 to 11.

A reading at rest with the box axis +-K up and at temperature T is, in counts and along a sensor axis,

    reading = sensitivity (bias + response . force + slope (T - 25 degC)),     force = +-1 g along K.

The six faces of Table 10, brought to 25 degC with the slopes of Table 8 and the face temperatures, give bias (their
mean) and response (half-differences). An accelerometer's response, turned into the sensor's nominal axes, is the
direction of its axis times (1 + error); a gyroscope's is its sensitivity to specific force. Table 8's heating had +Z up
all the time: an axis along Z carried 1 g, and its slope may as well be that of its scale factor. It stands as bias.

Everything is in g or dps with the data sheets' typical sensitivities, along the sensor's own axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from math import atan2, degrees, sqrt

import numpy as np
import numpy.typing as npt

from imuarray.axes import orientation_of
from imuarray.paper.accelerometers import READINGS
from imuarray.paper.orientation import as_text, believed_axes
from imuarray.paper.startup import bias_states, boot_faults
from imuarray.paper.tables import BMA180_LSB_PER_G, DEGC, FACES_DEGC, Row, design_of, number_in, physical, row_of, table
from imuarray.paper.wander import WINDOW_S, expected_scatter, variance_of_mean

Floats = npt.NDArray[np.float64]

REFERENCE_DEGC = 25.0
CHIP = {"ADXL": "adxl345", "BMA": "bma180", "Gyro": "l3g4200d"}
RANGE = {"16g": 16.0, "1.5g": 1.5, "2k dps": 2000.0, "250dps": 250.0}
"""Ranges as the tables print them, in the sensor's unit."""
STEP_LSB = {"ADXL": 2.0, "BMA": 1.0, "Gyro": 1.0}
"""Distance of the codes that occur: the ADXL345 gave even ones only (appendix A.2)."""
TONE_HZ = 50.0
"""The line on the gyroscopes' y axis (appendix A.1, Figure 14)."""
CUTOFF_HZ = 51.0
"""exp(-2 pi cutoff / 350 Hz) = 0.4, the correlation of neighbours in Figure 13."""
TONE_SHARE = 0.03
"""Our guess at its share of Table 9's variance on y; no number is printed.

The autocorrelation of 480 000 readings then ripples by 0.03, twenty times its sampling error ("can be clearly seen"),
and y's deviation grows by 1.5 %, less than the 5 % by which Table 9's x and z differ from each other.
"""
_STDS = ((10, "std_lsb"), (11, "runs_std"), (11, "cont_std"))


@dataclass(frozen=True)
class Unit:
    """One sensor: vectors have an entry for each of its axes, `response` (3, 3) a row; unit is "g" or "dps".

    `bias` at 25 degC (Gyro3: in its first state), `response` to force along the sensor's nominal axes, `slope` per
    degC, `noise` of single readings, `in_run` the stationary wander's rms, `turn_on` what runs differ by.
    `thermometer` is what the chip's own one is off by, (offset, rms) in degC; None without one.
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
        """An accelerometer's scale factors over the typical one, less one."""
        return np.asarray(np.linalg.norm(self.response, axis=1) - 1)

    @property
    def angles_deg(self) -> list[float]:
        """By how much an accelerometer's axes lean towards the others: xy, xz, yx, yz, zx, zy."""
        r = self.response
        return [degrees(atan2(r[i, j], r[i, i])) for i in range(3) for j in range(3) if i != j]


@cache
def units() -> tuple[Unit, ...]:
    """The nine sensors in the order of Table 1."""
    return tuple(_unit(row["sensor"]) for row in table(1))


def unit_of(name: str) -> Unit:
    """The sensor of that name."""
    return next(unit for unit in units() if unit.name == name)


def tone_dps() -> float:
    """Amplitude of the line on the gyroscopes' y axis: `TONE_SHARE` of the variance that Table 9 gives at 250 dps."""
    row = next(row for row in table(9) if row["output"] == "Gyro1 y" and row["range"] == "250dps")
    return sqrt(2 * TONE_SHARE) * float(number_in(row, "std_dps"))


def gyro3_other_state_lsb() -> Floats:
    """From Gyro3's first state of Table 7 to its second, in counts: 8 of 15 runs came up in that."""
    first, second = bias_states()
    return np.asarray(np.array(second.centre) - np.array(first.centre))


def bma1_reset_offset_g() -> Floats:
    """What BMA1 reads more in run 10 of Table 6, taken at 2 g, than in its other runs, in g."""
    faulty = {fault.run: float(fault.range_lsb_per_g) for fault in boot_faults()}
    ((run, lsb_per_g),) = faulty.items()
    runs = runs_of("BMA1")
    usual = np.delete(runs, run - 1, axis=0).mean(axis=0) / float(BMA180_LSB_PER_G["16g"])
    return np.asarray(runs[run - 1] / lsb_per_g - usual)


def bma1_reset_noise_share() -> Floats:
    """How noisy BMA1 is in run 10, as a share of its usual noise in g.

    Table 11 prints the mean deviation of the 15 runs; the fourteen sound ones are taken to differ from the continuous
    run as BMA2's do, and what is left is run 10's.
    """
    continuous, runs = (_column(11, "BMA1", column) for column in ("cont_std", "runs_std"))
    sound = continuous * _column(11, "BMA2", "runs_std") / _column(11, "BMA2", "cont_std")
    faulty = len(runs_of("BMA1")) * runs - (len(runs_of("BMA1")) - 1) * sound
    ratio = float(BMA180_LSB_PER_G["16g"] / BMA180_LSB_PER_G["2g"])
    return np.asarray(faulty / sound * ratio)


def runs_of(name: str) -> Floats:
    """(15, 3) means of the runs of Table 6 ("BMA1") or 7 ("Gyro3"), counts."""
    number = {"BMA1": 6, "Gyro3": 7}[name]
    return np.array([[float(number_in(row, f"{axis}_lsb")) for axis in "xyz"] for row in table(number)])


def gyro1_bias_at_250dps() -> Floats:
    """Gyro1 at 250 dps, from Table 9 (+X up): another range, another bias (section 5.1)."""
    gyro = unit_of("Gyro1")
    rows = [row for row in table(9) if row["range"] == "250dps"]
    means = np.array([float(number_in(row, "mean_dps")) for row in rows])
    along_x = np.array(orientation_of(as_text(believed_axes("Gyro1"))))[0]
    return np.asarray(means - gyro.response @ along_x - gyro.slope * (high_rate_degc("250dps") - REFERENCE_DEGC))


def high_rate_degc(range_name: str) -> float:
    """Temperature of a high-rate experiment of Table 9, told by Gyro1's own thermometer: no other is printed."""
    rows = [row for row in table(9) if row["output"] == "Gyro1 t"]
    row = rows[0] if range_name == "250dps" else rows[1]
    return _zero("Gyro1") - float(number_in(row, "mean_lsb"))


def _unit(name: str) -> Unit:
    rows = [row_of(10, f"{name} {axis}") for axis in "xyz"]
    per_lsb = float(physical(rows[0], Decimal(1)))
    design = design_of(name)
    lsb = per_lsb if design == "Gyro" else per_lsb / 1000
    slope = _column(8, name, "slope_lsb_per_degc")
    bias, response = _six_faces(name, rows, slope)
    in_run = _in_run(name, slope)
    thermometer = None if design == "ADXL" else _thermometer(name, design)
    noise, turn_on = _noise(name, design, lsb), _turn_on(name, slope, in_run)
    bias, response, slope, noise, in_run, turn_on = (
        part * lsb for part in (bias, response, slope, noise, in_run, turn_on)
    )
    range_name = rows[0]["range"]
    return Unit(name, design, range_name, lsb, bias, response, slope, noise, in_run, turn_on, thermometer)


def _column(number: int, name: str, column: str) -> Floats:
    return np.array([float(number_in(row_of(number, f"{name} {axis}"), column)) for axis in "xyz"])


def _six_faces(name: str, rows: Sequence[Row], slope: Floats) -> tuple[Floats, Floats]:
    """Bias (3,) at 25 degC and response (3, 3) along the sensor's nominal axes, counts and counts per g."""
    readings = np.array([[float(number_in(row, face)) for face in READINGS[:6]] for row in rows])
    readings = readings - slope[:, None] * (np.array(FACES_DEGC[:6]) - REFERENCE_DEGC)
    z_up, x_up, y_up, x_down, y_down, z_down = readings.T
    box = np.stack([x_up - x_down, y_up - y_down, z_up - z_down], axis=1) / 2
    state = gyro3_other_state_lsb() if name == "Gyro3" else 0.0  # Table 10 shows the second state's biases
    return readings.mean(axis=1) - state, box @ np.array(orientation_of(as_text(believed_axes(name))))


def _noise(name: str, design: str, lsb: float) -> Floats:
    """Root of the mean variance in three experiments, less what rounding and the line add, counts."""
    variance = np.mean([_column(number, name, column) ** 2 for number, column in _STDS], axis=0)
    tone = np.array([0.0, (tone_dps() / lsb) ** 2 / 2, 0.0]) if design == "Gyro" else 0.0
    return np.asarray(np.sqrt(variance - STEP_LSB[design] ** 2 / 12 - tone))


def _in_run(name: str, slope: Floats) -> Floats:
    """Table 11's in-run deviation, less white noise and the drift with temperature, as the wander behind it."""
    scatter = _column(11, name, "cont_std_of_means") ** 2 - _column(11, name, "cont_sem") ** 2
    left = scatter - (slope * DEGC[11, "cont_std_of_means"]) ** 2
    return np.asarray(np.sqrt(np.maximum(left, 0) / expected_scatter()))


def _turn_on(name: str, slope: Floats, in_run: Floats) -> Floats:
    """Table 11's run-to-run deviation, less white noise, temperature and the in-run wander of a run's mean."""
    left = _run_variance(name) - _column(11, name, "runs_sem") ** 2 - in_run**2 * variance_of_mean(WINDOW_S)
    return np.asarray(np.sqrt(np.maximum(left - (slope * DEGC[11, "runs_std_of_means"]) ** 2, 0)))


def _run_variance(name: str) -> Floats:
    """Variance of the runs' means: BMA1's without its fault, Gyro3's within its states, else Table 11's column."""
    if name == "BMA1":
        return np.asarray(np.delete(runs_of(name), [fault.run - 1 for fault in boot_faults()], axis=0).var(0, ddof=1))
    if name == "Gyro3":
        states = bias_states()
        squares = sum((len(state.runs) - 1) * np.array(state.spread) ** 2 for state in states)
        return np.asarray(squares / (sum(len(state.runs) for state in states) - len(states)))
    return _column(11, name, "runs_std_of_means") ** 2


def _zero(name: str) -> float:
    """Code of a gyroscope's thermometer at 0 degC: it falls by one per degC (L3G-60)."""
    return float(np.mean([code + degc for code, degc in _thermometer_readings(name)]))


def _thermometer_readings(name: str) -> list[tuple[float, float]]:
    """(mean code, independent temperature) of Table 10 and the two halves of Table 11."""
    faces = row_of(10, f"{name} t")
    first = (float(np.mean([float(number_in(faces, face)) for face in READINGS])), float(np.mean(FACES_DEGC)))
    columns = ("runs_mean", "cont_mean")
    return [first, *((float(number_in(row_of(11, f"{name} t"), column)), DEGC[11, column]) for column in columns)]


def _thermometer(name: str, design: str) -> tuple[float, float]:
    """(offset, rms) in degC: a BMA180's code is 2 (T - 24 degC) (BMA-63), an L3G4200D's 47 - T by our convention."""
    readings = _thermometer_readings(name)
    if design == "Gyro":
        return 47.0 - _zero(name), rms_before_rounding(_code_variance(name, 1.0))
    offset = float(np.mean([24.0 + code / 2 - degc for code, degc in readings]))
    return offset, sqrt(_code_variance(name, 2.0) - 1 / 12) / 2


def _code_variance(name: str, codes_per_degc: float) -> float:
    """Mean variance of the thermometer's codes in three experiments, less that of the temperature itself."""
    own = [float(number_in(row_of(number, f"{name} t"), column)) ** 2 for number, column in _STDS]
    return float(np.mean(own) - codes_per_degc**2 * np.mean([DEGC[key] ** 2 for key in _STDS]))


def rms_before_rounding(variance: float) -> float:
    """Noise that, rounded to whole codes about a mean anywhere between two, has this variance on average.

    The average is s^2 + 1/12 - sum_k exp(-4 pi^2 k^2 s^2) / (2 pi^2 k^2); it grows with s from 0. Bisection.
    """
    k = np.arange(1, 200)
    low, high = 0.0, 2.0
    for _ in range(60):
        middle = (low + high) / 2
        bias = np.sum(np.exp(-4 * np.pi**2 * k**2 * middle**2) / (2 * np.pi**2 * k**2))
        low, high = (middle, high) if middle**2 + 1 / 12 - bias < variance else (low, middle)
    return (low + high) / 2

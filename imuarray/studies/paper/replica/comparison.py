"""The simulated experiments as the paper's tables, and every printed statistic compared with its simulated counterpart.

Tables 3, 4 and 10: the model contains the mean and the half-differences of the six faces of Table 10. The uncertainty
of a face is the disagreement between opposite faces plus, in the simulation, turn-on bias (common to all faces), in-run
wander and white noise. The repeated face was not fitted: its variance is the sum of that of a face and that of the fit.

Tables 5, 6, 7 and 11: the uncertainty of a level on a day other than that of Table 10 contains the day-to-day variance
twice, once for each of the two days. A standard deviation of fifteen means has a sampling error. It counts once if the
model was fitted to the printed value, and twice if it was not fitted (the model has 0).

Text and figures: "around" and "about" mean within one unit of the last digit, evenly distributed: a standard deviation
of 1 / sqrt(3) units. A wrong yes or no (codes all even, a spectral line or none) counts as three uncertainties.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import hypot, isnan, log, sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import signal

from imuarray.arrays import Floats
from imuarray.simulate.motion.heating import Heating
from imuarray.studies.paper.array_model import PARTS, TIME_CONSTANT_S, WINDOW_S, unit_of, variance_of_mean
from imuarray.studies.paper.replica.simulation import BOOTS, ExperimentData, Window, array_rate_hz, high_rate_s
from imuarray.studies.paper.replica.statistic import (
    RANGE_OVER_DEVIATION,
    Statistic,
    axis_of,
    between_units,
    face_residual,
    level_parts,
    linear,
    log_deviation,
    logarithmic,
    noise_residual,
    own,
    part_steps,
    part_windows,
    printed,
    run_steps,
    run_windows,
    slope,
    thermometer_residual,
    with_cause,
)
from imuarray.studies.paper.systematic import READINGS
from imuarray.studies.paper.tables import number_in, table
from imuarray.studies.paper.variation import FACE_SECONDS, HIGH_RATE_HZ, bias_states, boot_faults, group_members

Columns = Mapping[str, float]
Table = Mapping[str, Columns]
"""Rows by channel ("Gyro1 y"), for Table 2 and 9 with the range ("Gyro1 y 250dps"), for Tables 6 and 7 by run."""

_LINE_OVER_FLOOR = 10.0
_AROUND_HZ = (40.0, 60.0)


def compare(observed: ExperimentData) -> Iterator[Statistic]:
    """Yield every statistic, table by table."""
    simulated = tabulate(observed)
    yield from compare_gyro_noise(2, simulated[2])
    yield from compare_accelerometers(simulated[3])
    yield from compare_gyroscopes(simulated[4])
    yield from compare_in_run(simulated[5])
    yield from compare_runs(6, "BMA1", simulated[6])
    yield from compare_runs(7, "Gyro3", simulated[7])
    yield from compare_slopes(simulated[8])
    yield from compare_gyro_noise(9, simulated[9])
    yield from compare_faces(simulated[10])
    yield from compare_turn_on(simulated[11])
    yield from compare_figures(observed)
    yield from compare_text(observed, simulated[10], simulated[6])


def tabulate(observed: ExperimentData) -> dict[int, Table]:
    """Return Tables 2 to 11 of the simulated array."""
    ten, eleven = table10(observed), table11(observed)
    nine = table9(observed)
    return {
        2: {key: row for key, row in nine.items() if " t " not in key},
        3: {row["channel"]: accelerometer(ten[row["channel"]]) for row in table(3)},
        4: {row["channel"]: gyroscope(ten[row["channel"]]) for row in table(4)},
        5: {row["group"]: {"std_of_5min_means_lsb": _group(eleven, row["group"])} for row in table(5)},
        6: _runs(observed.runs["BMA1"]),
        7: _runs(observed.runs["Gyro3"]),
        8: table8(observed),
        9: nine,
        10: ten,
        11: eleven,
    }


def table8(observed: ExperimentData) -> Table:
    """Return slopes and intercepts."""
    columns = ("slope_lsb_per_degc", "intercept_lsb")
    return {
        f"{name} {axis}": dict(zip(columns, (float(fit.slope[i]), float(fit.intercept[i])), strict=True))
        for name, fit in observed.heated.items()
        for i, axis in enumerate("xyz")
    }


def table9(observed: ExperimentData) -> Table:
    """Return Gyro1 at both ranges."""
    return {
        f"Gyro1 {axis} {name}": {
            "mean_lsb": float(result.window.mean[i]),
            "sem_lsb": float(result.window.std[i] / np.sqrt(result.window.rows)),
            "std_lsb": float(result.window.std[i]),
        }
        for name, result in observed.high_rate.items()
        for i, axis in enumerate("xyzt")
    }


def table10(observed: ExperimentData) -> Table:
    """Return means over the faces; standard error and deviation are means over the six (section 5.2)."""
    return _per_channel(observed.faces, _faces)


def _faces(means: Floats, stds: Floats, rows: Floats) -> Columns:
    faces = {face: float(mean) for face, mean in zip(READINGS, means, strict=True)}
    six = slice(0, 6)
    return {**faces, "sem_lsb": float((stds[six] / np.sqrt(rows[six])).mean()), "std_lsb": float(stds[six].mean())}


def table11(observed: ExperimentData) -> Table:
    """Return both halves and their ratio."""
    runs, parts = _per_channel(observed.runs, _half("runs")), _per_channel(observed.parts, _half("cont"))
    return {
        channel: {
            **runs[channel],
            **parts[channel],
            "ratio": runs[channel]["runs_std_of_means"] / parts[channel]["cont_std_of_means"],
        }
        for channel in runs
    }


def _half(half: str) -> Callable[[Floats, Floats, Floats], Columns]:
    def columns(means: Floats, stds: Floats, rows: Floats) -> Columns:
        return {
            f"{half}_mean": float(means.mean()),
            f"{half}_sem": float((stds / np.sqrt(rows)).mean()),
            f"{half}_std": float(stds.mean()),
            f"{half}_std_of_means": float(means.std(ddof=1)),
            f"{half}_range_of_means": float(np.ptp(means)),
        }

    return columns


def _per_channel(
    windows: Mapping[str, Sequence[Window]], columns: Callable[[Floats, Floats, Floats], Columns]
) -> dict[str, Columns]:
    """Return `columns` of (means, standard deviations, numbers of readings) over the windows, for every axis."""
    return {
        f"{name} {axis}": columns(
            np.array([window.mean[i] for window in result]),
            np.array([window.std[i] for window in result]),
            np.array([float(window.rows) for window in result]),
        )
        for name, result in windows.items()
        for i, axis in enumerate("xyzt")
        if not np.isnan(result[0].mean[i])
    }


def accelerometer(row: Columns) -> Columns:
    """Return Table 3's columns from a row of Table 10; the scale factor has no sign, unlike the paper's."""
    faces = np.array([row[face] for face in READINGS])
    return {
        "drift_lsb": float(faces[0] - faces[6]),
        "sem_lsb": row["sem_lsb"],
        "bias_lsb": float(faces[:6].mean()),
        "scale_lsb_per_g": float(np.linalg.norm([row[f"{k}_up"] - row[f"{k}_down"] for k in "xyz"]) / 2),
    }


def gyroscope(row: Columns) -> Columns:
    """Return Table 4's columns from a row of Table 10; its bias is the mean of all seven readings."""
    return {
        "bias_lsb": float(np.mean([row[face] for face in READINGS])),
        **{f"dbias_{k}_lsb": row[f"{k}_up"] - row[f"{k}_down"] for k in "xyz"},
        "drift_lsb": row["z_up"] - row["z_up_check"],
    }


def _runs(windows: Sequence[Window]) -> Table:
    columns = ("x_lsb", "y_lsb", "z_lsb", "temp_int")
    return {
        str(run): dict(zip(columns, map(float, window.mean), strict=True))
        for run, window in enumerate(windows, start=1)
    }


def _group(eleven: Table, group: str) -> float:
    return float(np.mean([eleven[row["channel"]]["cont_std_of_means"] for row in group_members(group)]))


def autocorrelation(counts: npt.NDArray[np.int16], lag: int) -> Floats:
    """Return (3,) autocorrelation of counts (n, 3) at one lag."""
    centred = counts - counts.mean(axis=0)
    return np.asarray((centred[lag:] * centred[:-lag]).sum(axis=0) / (centred**2).sum(axis=0))


def period(counts: npt.NDArray[np.int16], axis: int) -> int:
    """Return the lag from 3 to 12 rows at which an axis correlates best with itself (Figure 13)."""
    return 3 + int(np.argmax([autocorrelation(counts, lag)[axis] for lag in range(3, 13)]))


def line_hz(counts: npt.NDArray[np.int16], axis: int) -> float:
    """Return the frequency of the line between 40 and 60 Hz in an axis' spectrum (Figure 14), nan if no density there
    exceeds ten times the median.
    """
    hz, power = signal.welch(counts[:, axis].astype(float), HIGH_RATE_HZ, nperseg=2048)
    near = (hz >= _AROUND_HZ[0]) & (hz <= _AROUND_HZ[1])
    top = int(np.argmax(np.where(near, power, 0)))
    return float(hz[top]) if power[top] > _LINE_OVER_FLOOR * np.median(power[near]) else float("nan")


def compare_faces(ten: Table) -> Iterator[Statistic]:
    """Compare Table 10."""
    for row in table(10):
        channel = row["channel"]
        for face in READINGS:
            yield _face(channel, face, ten[channel][face])
        for column in ("sem_lsb", "std_lsb"):
            place = ("Table 10", channel, column)
            values = printed(10, channel, column), ten[channel][column]
            parts = {"between experiments": noise_residual(channel)}
            yield logarithmic(place, *values, parts, derived=column == "sem_lsb", fitted=True)


def compare_accelerometers(three: Table) -> Iterator[Statistic]:
    """Compare Table 3, except for the bias that it repeats in mg. Scale factors are compared without their sign, which
    is an artefact of the paper's formula.
    """
    for row in table(3):
        channel = row["channel"]
        wander, sem = _wander(channel), printed(10, channel, "sem_lsb")
        result = three[channel]
        values = {column: (abs(float(number_in(row, column))), result[column]) for column in ("sem_lsb", _SCALE)}
        yield _drift("Table 3", channel, float(number_in(row, "drift_lsb")), result["drift_lsb"])
        sem_parts = {"between experiments": noise_residual(channel)}
        yield logarithmic(("Table 3", channel, "sem_lsb"), *values["sem_lsb"], sem_parts, derived=True, fitted=True)
        yield _bias("Table 3", channel, float(number_in(row, "bias_lsb")), result["bias_lsb"])
        parts = {"in-run": wander / sqrt(2), "sem": sem / sqrt(2), "rounding": 0.005 / sqrt(3)}
        yield linear(("Table 3", channel, _SCALE), *values[_SCALE], parts, derived=True, fitted=True)


_SCALE = "scale_lsb_per_g"


def compare_gyroscopes(four: Table) -> Iterator[Statistic]:
    """Compare Table 4 in LSB; its columns in dps are the same numbers in another unit."""
    for row in table(4):
        channel, result = row["channel"], four[row["channel"]]
        yield _bias("Table 4", channel, float(number_in(row, "bias_lsb")), result["bias_lsb"])
        for column in ("dbias_x_lsb", "dbias_y_lsb", "dbias_z_lsb"):
            parts = {"in-run": _wander(channel) * sqrt(2), "sem": printed(10, channel, "sem_lsb") * sqrt(2)}
            values = float(number_in(row, column)), result[column]
            yield linear(("Table 4", channel, column), *values, parts, derived=True, fitted=True)
        yield _drift("Table 4", channel, float(number_in(row, "drift_lsb")), result["drift_lsb"])


def _face(channel: str, face: str, simulated: float) -> Statistic:
    published, place = printed(10, channel, face), ("Table 10", channel, face)
    repeated = face == READINGS[-1]
    residual = face_residual(channel) * (sqrt(5) if repeated else 1.0)  # s^2 (1 + 2/3) against s^2 / 3
    if axis_of(channel) == 3:
        days = thermometer_residual(channel)
        parts = {"day-to-day": days, "face repeatability": face_residual(channel) * sqrt(3)}
        return with_cause(linear(place, published, simulated, parts, fitted=True), f"{channel}, Table 10", days)
    turn_on = own(channel, lambda unit: unit.turn_on)
    parts = {"turn-on": turn_on, "in-run": _wander(channel), "sem": printed(10, channel, "sem_lsb")}
    result = linear(place, published, simulated, parts | {"face repeatability": residual}, fitted=not repeated)
    return with_cause(result, f"{channel}, Table 10", turn_on)


def _bias(name: str, channel: str, published: float, simulated: float) -> Statistic:
    sem = printed(10, channel, "sem_lsb") / sqrt(6)
    parts = {"turn-on": own(channel, lambda unit: unit.turn_on), "in-run": _wander(channel) / sqrt(6), "sem": sem}
    if name == "Table 4":  # its mean includes the repeated face
        parts["face repeatability"] = face_residual(channel) * sqrt(5) / 7
    return linear((name, channel, "bias_lsb"), published, simulated, parts, derived=True, fitted=True)


def _drift(name: str, channel: str, published: float, simulated: float) -> Statistic:
    parts = {
        "face repeatability": face_residual(channel) * sqrt(6),
        "in-run": _wander(channel) * sqrt(2),
        "sem": printed(10, channel, "sem_lsb") * sqrt(2),
    }
    return linear((name, channel, "drift_lsb"), published, simulated, parts, derived=True)


def _wander(channel: str) -> float:
    """Return the in-run wander of the mean over a face, counts."""
    return own(channel, lambda unit: unit.in_run) * sqrt(variance_of_mean(FACE_SECONDS))


_RESET_RATIO = 8.0
"""Counts per g at 2 g divided by those at 16 g."""


def compare_turn_on(simulated: Table) -> Iterator[Statistic]:
    """Compare Table 11."""
    for row in table(11):
        channel, result = row["channel"], simulated[row["channel"]]
        spreads = {half: deviation_spread(channel, half) for half in ("runs", "cont")}
        for half, values_of_half in spreads.items():
            yield _mean(channel, half, result[f"{half}_mean"])
            for column in (f"{half}_sem", f"{half}_std"):
                values = printed(11, channel, column), result[column]
                place, parts = ("Table 11", channel, column), {"between experiments": noise_residual(channel)}
                yield logarithmic(place, *values, parts, derived=column.endswith("sem"), fitted=True)
            scatter = {"between units" if axis_of(channel) == 3 else "scatter of fifteen": values_of_half}
            shape = {"range over deviation": sqrt(2) * RANGE_OVER_DEVIATION}
            own_marks = {"fitted": _is_fitted(channel, half), "derived": _is_derived(channel, half)}
            for name, parts, marks in (("std", scatter, own_marks), ("range", scatter | shape, {"derived": True})):
                column = f"{half}_{name}_of_means"
                values = printed(11, channel, column), result[column]
                yield logarithmic(("Table 11", channel, column), *values, parts, **marks)
        halves = {"runs": spreads["runs"], "windows": spreads["cont"]}
        place, values = ("Table 11", channel, "ratio"), (printed(11, channel, "ratio"), result["ratio"])
        yield logarithmic(place, *values, halves, derived=True, fitted=True)


def compare_in_run(simulated: Table) -> Iterator[Statistic]:
    """Compare Table 5."""
    for row in table(5):
        members = [member["channel"] for member in group_members(row["group"])]
        sizes = [printed(11, member, "cont_std_of_means") for member in members]
        errors = [size * deviation_spread(member, "cont") for member, size in zip(members, sizes, strict=True)]
        spread = sqrt(sum(error**2 for error in errors)) / sum(sizes)
        column = "std_of_5min_means_lsb"
        values = float(number_in(row, column)), simulated[row["group"]][column]
        parts = {"scatter of fifteen": spread}
        yield logarithmic(("Table 5", row["group"], column), *values, parts, derived=True, fitted=True)


def compare_runs(number: int, name: str, simulated: Table) -> Iterator[Statistic]:
    """Compare Tables 6 (BMA1) and 7 (Gyro3): every run's means."""
    faulty = {fault.run for fault in boot_faults()} if name == "BMA1" else set()
    for row in table(number):
        run = int(row["run"])
        for axis, column in zip("xyzt", ("x_lsb", "y_lsb", "z_lsb", "temp_int"), strict=True):
            place = (f"Table {number}", f"{name} {axis}", f"run {run}")
            values = float(number_in(row, column)), simulated[row["run"]][column]
            yield _one_run(place, *values, _RESET_RATIO if run in faulty and axis != "t" else 1.0)


def deviation_spread(channel: str, half: str) -> float:
    """Return the standard deviation of ln(simulated / published) for a deviation of fifteen means of Table 11."""
    if axis_of(channel) == 3:  # each chip follows the room temperature differently
        return between_units(channel, f"{half}_std_of_means")
    if half == "cont":
        spread = log_deviation(part_windows(channel), part_steps(channel))
    else:
        spread = hypot(log_deviation(run_windows(channel), run_steps(channel)), _step_of_fault(channel))
    return spread * (1.0 if _is_fitted(channel, half) else sqrt(2))


def _step_of_fault(channel: str) -> float:
    """Return the relative uncertainty of the distance of the faulty run from the others; 0 for a sensor without a
    faulty run.

    This distance scatters by seven times the day-to-day change and by eight times the run-to-run change.
    """
    if not channel.startswith("BMA1"):
        return 0.0
    parts, _ = level_parts(channel)
    days = (_RESET_RATIO - 1) * hypot(*parts.values())
    run = _RESET_RATIO * sqrt(float(run_windows(channel)[0, 0]))
    return hypot(days, run) / sqrt(run_steps(channel) * PARTS)


def _is_fitted(channel: str, half: str) -> bool:
    """Return whether the model has its own parameter for this deviation."""
    return axis_of(channel) < 3 and own(channel, lambda unit: unit.turn_on if half == "runs" else unit.in_run) > 0


def _is_derived(channel: str, half: str) -> bool:
    """Return whether Table 6 or 7 prints the individual runs."""
    return half == "runs" and channel.split()[0] in ("BMA1", "Gyro3")


def _mean(channel: str, half: str, simulated: float) -> Statistic:
    column = f"{half}_mean"
    place, published = ("Table 11", channel, column), printed(11, channel, column)
    if axis_of(channel) == 3:
        offset = {"day-to-day": thermometer_residual(channel)}
        return linear(place, published, simulated, offset, fitted=True, derived=_is_derived(channel, half))
    windows = run_windows(channel) if half == "runs" else part_windows(channel)
    own_boot = 0.0 if half == "runs" else own(channel, lambda unit: unit.turn_on)
    factor = (PARTS - 1 + _RESET_RATIO) / PARTS if channel.startswith("BMA1") and half == "runs" else 1.0
    parts, share = level_parts(channel)
    days = {name: part * factor for name, part in parts.items()}
    wander = {"in-run and sem": float(sqrt(windows.sum())) / PARTS, "turn-on": own_boot}
    result = linear(place, published, simulated, days | wander, derived=_is_derived(channel, half))
    return with_cause(result, f"{channel}, other days", sqrt(share) * hypot(*days.values()))


def _one_run(place: tuple[str, str, str], published: float, simulated: float, ratio: float) -> Statistic:
    channel = place[1]
    if axis_of(channel) == 3:
        offset = thermometer_residual(channel)
        parts = {"day-to-day": offset, "in-run": printed(11, channel, "cont_std_of_means")}
        return with_cause(linear(place, published, simulated, parts, fitted=True), f"{channel}, {place[0]}", offset)
    days = {name: part * ratio for name, part in level_parts(channel)[0].items()}
    twice = sqrt(2) * ratio
    parts = {
        "turn-on": twice * own(channel, lambda unit: unit.turn_on),
        "in-run": twice * own(channel, lambda unit: unit.in_run) * sqrt(variance_of_mean(WINDOW_S)),
        "sem": twice * printed(11, channel, "runs_sem"),
    }
    result = linear(place, published, simulated, days | parts)
    return with_cause(result, f"{channel}, other days", hypot(*days.values()))


DPS_AT_250 = 0.00875
"""Angular rate of one count at 250 dps, in dps (L3G-40)."""

_AROUND = 1 / sqrt(3)
_HALF_A_DIGIT = 0.5 / sqrt(3)
_FAST_NOISE = sqrt(110 / 35 * 1.4 / 0.6)
"""Noise of the mean at 110 Hz divided by that of the same number of independent readings at 35 Hz; neighbouring
readings correlate by 0.4.
"""
_A3_STDS = {"x": 8.0201, "y": 9.8857, "z": 9.3002}
"""Appendix A.3: standard deviations in LSB of a BMA180 at 16 g; the paper does not state which unit."""


class _HeatingSpread(NamedTuple):
    """The heating: mean temperature; standard deviation of a fitted slope, per degC, caused by unit white noise and by
    a unit in-run wander; standard deviation of the mean caused by a unit wander.
    """

    degc: float
    of_noise: float
    of_wander: float
    level_of_wander: float


def compare_slopes(simulated: Table) -> Iterator[Statistic]:
    """Compare Table 8."""
    heated = _heating_spread()
    for row in table(8):
        for column, compare in (("slope_lsb_per_degc", _slope), ("intercept_lsb", _intercept)):
            channel, published = row["channel"], float(number_in(row, column))
            yield compare(heated, channel, published, simulated[channel][column])


def _slope(heated: _HeatingSpread, channel: str, published: float, simulated: float) -> Statistic:
    parts = _tilts(heated, channel) | {"rounding": 0.001 * _HALF_A_DIGIT}
    return linear(("Table 8", channel, "slope_lsb_per_degc"), published, simulated, parts, fitted=True)


def _intercept(heated: _HeatingSpread, channel: str, published: float, simulated: float) -> Statistic:
    days, share = level_parts(channel)
    own_boot = {
        "turn-on": own(channel, lambda unit: unit.turn_on),
        "slope": heated.degc * hypot(*_tilts(heated, channel).values()),
        "in-run": own(channel, lambda unit: unit.in_run) * heated.level_of_wander,
    }
    result = linear(("Table 8", channel, "intercept_lsb"), published, simulated, days | own_boot)
    return with_cause(result, f"{channel}, other days", sqrt(share) * hypot(*days.values()))


def _tilts(heated: _HeatingSpread, channel: str) -> dict[str, float]:
    """Return the error of the simulated slope by cause; the model has the printed slope."""
    return {
        "in-run": heated.of_wander * own(channel, lambda unit: unit.in_run),
        "sem": heated.of_noise * own(channel, lambda unit: unit.noise),
    }


@cache
def _heating_spread() -> _HeatingSpread:
    """Return the spread of the heating experiment's lines, from the temperature every half minute."""
    motion = Heating()
    seconds = np.arange(0.0, motion.seconds, 30.0)
    degc = np.asarray(motion.stimulus((seconds * 1e9).astype(np.int64)).temperature_degc, float)
    deviation = degc - degc.mean()
    weights = deviation / (deviation**2).sum()
    wander = np.exp(-np.abs(np.subtract.outer(seconds, seconds)) / TIME_CONSTANT_S)
    of_noise = 1 / sqrt(array_rate_hz(10) * motion.seconds) / float(degc.std())
    level = sqrt(variance_of_mean(motion.seconds))
    return _HeatingSpread(float(degc.mean()), of_noise, sqrt(float(weights @ wander @ weights)), level)


def compare_gyro_noise(number: int, simulated: Table) -> Iterator[Statistic]:
    """Compare Table 9, or Table 2, which prints the same means and deviations; the upper half is at 250 dps."""
    rows = table(number)
    for index, row in enumerate(rows):
        name = "250dps" if index < len(rows) / 2 else "2k dps"
        for column in (column for column in ("mean_lsb", "sem_lsb", "std_lsb") if column in row):
            result = simulated[f"{row['output']} {name}"][column]
            statistic = _nine(number, row["output"], name, column, float(number_in(row, column)), result)
            yield replace(statistic, derived=statistic.derived or number == 2)


def _nine(number: int, channel: str, name: str, column: str, published: float, simulated: float) -> Statistic:
    place = (f"Table {number}", f"{channel} {name}", column)
    if column != "mean_lsb":
        noise_sd = noise_residual(channel) * sqrt(2)  # a fourth experiment compared with the mean of three
        filter_sd = 0.0 if channel.endswith("t") else _between_filters()
        own_parts = {"between experiments": noise_sd, "filters": filter_sd}
        return logarithmic(place, published, simulated, own_parts, derived=column == "sem_lsb")
    if channel.endswith("t"):
        return linear(place, published, simulated, {"day-to-day": thermometer_residual(channel)}, fitted=True)
    boot = {
        "turn-on": own(channel, lambda unit: unit.turn_on),
        "in-run": own(channel, lambda unit: unit.in_run) * sqrt(variance_of_mean(high_rate_s(name))),
        "sem": own(channel, lambda unit: unit.noise) * _FAST_NOISE / sqrt(HIGH_RATE_HZ * high_rate_s(name)),
    }
    if name == "250dps":
        coarser = unit_of("Gyro1").lsb / DPS_AT_250  # ratio of the sizes of a count
        parts = {part: size * coarser for part, size in boot.items()}
        return linear(place, published, simulated, parts, fitted=True)
    days, share = level_parts(channel)
    warmth = {"temperature": slope(channel) * thermometer_residual("Gyro1 t")}
    result = linear(place, published, simulated, boot | days | warmth)
    return with_cause(result, f"{channel}, other days", sqrt(share) * hypot(*days.values()))


def _between_filters() -> float:
    """Return the standard deviation over the axes of ln(noise at 110 Hz over that in the array runs), Tables 9 (2000
    dps), 10, 11. The model uses the root of the ratio of the bandwidths for all axes.
    """
    rows = [row for row in table(9) if row["range"] == "2k dps"]
    noise = [own(row["output"], lambda unit: unit.noise) for row in rows]
    ratios = [log(float(number_in(row, "std_lsb")) / own_noise) for row, own_noise in zip(rows, noise, strict=True)]
    return float(np.std(ratios, ddof=1))


def compare_figures(observed: ExperimentData) -> Iterator[Statistic]:
    """Compare Figures 13 and 14 (Gyro1 at 250 dps)."""
    counts = observed.high_rate["250dps"].counts
    neighbours = autocorrelation(counts, 1)
    for i, axis in enumerate("xyz"):
        place = ("Figure 13", f"Gyro1 {axis}", "correlation of neighbours")
        yield linear(place, 0.4, float(neighbours[i]), {"around": 0.1 * _AROUND}, fitted=True)
    yield linear(("Figure 13", "Gyro1 y", "period, samples"), 6.0, float(period(counts, 1)), {"around": _AROUND})
    for i, axis in enumerate("xyz"):
        hz = line_hz(counts, i)
        yield _yes_or_no(("Figure 14", f"Gyro1 {axis}", "line near 50 Hz"), float(axis == "y"), float(not isnan(hz)))
        if axis == "y":
            place = ("Figure 14", "Gyro1 y", "line, Hz")
            yield linear(place, 50.0, 0.0 if isnan(hz) else hz, {"around": 10 * _AROUND}, fitted=True)


def compare_text(observed: ExperimentData, ten: Table, six: Table) -> Iterator[Statistic]:
    """Compare Appendices A.2 and A.3, and sections 5.2.4's two odd sensors."""
    for name, share in observed.even.items():
        yield _yes_or_no(("Appendix A.2", name, "all codes even"), 1.0, float(share == 1.0))
    for axis, std in _A3_STDS.items():
        first, second = (ten[f"{name} {axis}"]["std_lsb"] for name in ("BMA1", "BMA2"))
        units = abs(log(printed(10, f"BMA1 {axis}", "std_lsb") / printed(10, f"BMA2 {axis}", "std_lsb"))) / sqrt(2)
        days = noise_residual(f"BMA1 {axis}") * sqrt(2)
        place = ("Appendix A.3", f"BMA1, BMA2 {axis}", "std_lsb")
        yield logarithmic(place, std, sqrt(first * second), {"between units": units, "between experiments": days})
    yield _reset(six)
    second = len(bias_states()[1].runs) / PARTS
    yield _share(("Table 7", "Gyro3", "share of runs in second state"), second, observed.second / BOOTS)
    faulty = len(boot_faults()) / PARTS
    yield _share(("Table 6", "BMA1", "share of faulty runs"), faulty, observed.faulty / BOOTS)


def _reset(six: Table) -> Statistic:
    """Return the factor by which the reading of gravity is larger in the faulty run."""
    (fault,) = boot_faults()
    mean_of_others = np.mean([row["z_lsb"] for run, row in six.items() if int(run) != fault.run])
    printed_others = np.mean([float(number_in(row, "z_lsb")) for row in table(6) if int(row["run"]) != fault.run])
    scatter = sqrt(2) * own("BMA1 z", lambda unit: np.hypot(unit.turn_on, unit.in_run)) / float(printed_others) * 8
    values = float(fault.reading_lsb) / float(printed_others), six[str(fault.run)]["z_lsb"] / float(mean_of_others)
    place = ("Table 6", "BMA1 z", f"run {fault.run} over the others")
    return linear(place, *values, {"turn-on and in-run": scatter}, derived=True, fitted=True)


def _share(place: tuple[str, str, str], published: float, simulated: float) -> Statistic:
    """Compare a share: the model has the printed one; the simulated one is a binomial number of `BOOTS`."""
    return linear(place, published, simulated, {"binomial": sqrt(published * (1 - published) / BOOTS)}, fitted=True)


def _yes_or_no(place: tuple[str, str, str], published: float, simulated: float) -> Statistic:
    return linear(place, published, simulated, {"yes or no": 1 / 3}, fitted=True)

"""The simulated experiments as the paper's tables: the same rows and columns as the CSV files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy import signal

from imuarray.paper.accelerometers import READINGS
from imuarray.paper.noise import HIGH_RATE_HZ
from imuarray.paper.replica.experiments import Observed
from imuarray.paper.replica.windows import Window
from imuarray.paper.stability import group_members
from imuarray.paper.tables import table

Floats = npt.NDArray[np.float64]
Columns = Mapping[str, float]
Table = Mapping[str, Columns]
"""Rows by channel ("Gyro1 y"), for Table 2 and 9 with the range ("Gyro1 y 250dps"), for Tables 6 and 7 by run."""

_LINE_OVER_FLOOR = 10.0
_AROUND_HZ = (40.0, 60.0)


def tabulate(observed: Observed) -> dict[int, Table]:
    """Tables 2 to 11 as the simulated array gives them."""
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


def table8(observed: Observed) -> Table:
    """Slopes and intercepts."""
    columns = ("slope_lsb_per_degc", "intercept_lsb")
    return {
        f"{name} {axis}": dict(zip(columns, (float(fit.slope[i]), float(fit.intercept[i])), strict=True))
        for name, fit in observed.heated.items()
        for i, axis in enumerate("xyz")
    }


def table9(observed: Observed) -> Table:
    """Gyro1 alone at both ranges."""
    return {
        f"Gyro1 {axis} {name}": {
            "mean_lsb": float(found.window.mean[i]),
            "sem_lsb": float(found.window.std[i] / np.sqrt(found.window.rows)),
            "std_lsb": float(found.window.std[i]),
        }
        for name, found in observed.high_rate.items()
        for i, axis in enumerate("xyzt")
    }


def table10(observed: Observed) -> Table:
    """Means over the faces; standard error and deviation are means over the six (section 5.2)."""
    return _per_channel(observed.faces, _faces)


def _faces(means: Floats, stds: Floats, rows: Floats) -> Columns:
    faces = {face: float(mean) for face, mean in zip(READINGS, means, strict=True)}
    six = slice(0, 6)
    return {**faces, "sem_lsb": float((stds[six] / np.sqrt(rows[six])).mean()), "std_lsb": float(stds[six].mean())}


def table11(observed: Observed) -> Table:
    """Both halves and their ratio."""
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
    """`columns` of (means, standard deviations, numbers of readings) over the windows, for every axis that there is."""
    return {
        f"{name} {axis}": columns(
            np.array([window.mean[i] for window in found]),
            np.array([window.std[i] for window in found]),
            np.array([float(window.rows) for window in found]),
        )
        for name, found in windows.items()
        for i, axis in enumerate("xyzt")
        if not np.isnan(found[0].mean[i])
    }


def accelerometer(row: Columns) -> Columns:
    """Table 3's columns from a row of Table 10; the scale factor without the sign that the paper gives it."""
    faces = np.array([row[face] for face in READINGS])
    return {
        "drift_lsb": float(faces[0] - faces[6]),
        "sem_lsb": row["sem_lsb"],
        "bias_lsb": float(faces[:6].mean()),
        "scale_lsb_per_g": float(np.linalg.norm([row[f"{k}_up"] - row[f"{k}_down"] for k in "xyz"]) / 2),
    }


def gyroscope(row: Columns) -> Columns:
    """Table 4's columns from a row of Table 10; its bias is the mean of all seven readings."""
    return {
        "bias_lsb": float(np.mean([row[face] for face in READINGS])),
        **{f"dbias_{k}_lsb": row[f"{k}_up"] - row[f"{k}_down"] for k in "xyz"},
        "drift_lsb": row["z_up"] - row["z_up_check"],
    }


def _runs(found: Sequence[Window]) -> Table:
    columns = ("x_lsb", "y_lsb", "z_lsb", "temp_int")
    return {
        str(run): dict(zip(columns, map(float, window.mean), strict=True)) for run, window in enumerate(found, start=1)
    }


def _group(eleven: Table, group: str) -> float:
    return float(np.mean([eleven[row["channel"]]["cont_std_of_means"] for row in group_members(group)]))


def neighbour_correlation(counts: npt.NDArray[np.int16]) -> Floats:
    """(3,) autocorrelation at lag 1 (Figure 13)."""
    return autocorrelation(counts, 1)


def autocorrelation(counts: npt.NDArray[np.int16], lag: int) -> Floats:
    """(3,) autocorrelation of counts (n, 3) at one lag."""
    centred = counts - counts.mean(axis=0)
    return np.asarray((centred[lag:] * centred[:-lag]).sum(axis=0) / (centred**2).sum(axis=0))


def period(counts: npt.NDArray[np.int16], axis: int) -> int:
    """The lag from 3 to 12 rows at which an axis correlates best with itself (Figure 13)."""
    return 3 + int(np.argmax([autocorrelation(counts, lag)[axis] for lag in range(3, 13)]))


def line_hz(counts: npt.NDArray[np.int16], axis: int) -> float:
    """Where an axis' spectrum has a line between 40 and 60 Hz (Figure 14), nan if nothing there is ten times the
    median.
    """
    hz, power = signal.welch(counts[:, axis].astype(float), HIGH_RATE_HZ, nperseg=2048)
    near = (hz >= _AROUND_HZ[0]) & (hz <= _AROUND_HZ[1])
    top = int(np.argmax(np.where(near, power, 0)))
    return float(hz[top]) if power[top] > _LINE_OVER_FLOOR * np.median(power[near]) else float("nan")

"""Table 10's faces: how accelerometers' axes lie and answer, and what force does to gyroscopes; noise beside the data
sheets'.
"""

from __future__ import annotations

from itertools import product
from math import degrees, sqrt
from typing import Any

import numpy as np

from imuarray.paper.accelerometers import READINGS
from imuarray.paper.gap.acting import Effects
from imuarray.paper.gap.candidate import (
    Discrepancy,
    discrepancy,
    scored,
    scored_with_scatter,
    told_from,
    with_checks,
    with_errors,
)
from imuarray.paper.gap.even_codes import found_noise
from imuarray.paper.gap.expected import FACE_VECTORS, expected
from imuarray.paper.gap.sensor import Array, Floats, faces_of, sigma
from imuarray.paper.model_units import unit_of
from imuarray.paper.replica.spread import noise_residual
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.room import FACES_DEGC
from imuarray.simulate.effects.g_sensitivity import GSensitivity
from imuarray.simulate.effects.misalignment import Misalignment
from imuarray.simulate.effects.odr_error import OdrError
from imuarray.simulate.effects.scale import Scale
from imuarray.simulate.effects.white_noise import WhiteNoise

_WIDEST_HZ = 1200.0
"""The BMA180's widest filter (BMA-88)."""


def mounting(array: Array) -> Discrepancy:
    """Accelerometers' six faces, with `misalignment`, `scale`, both, and the data sheet's populations as candidates."""
    names = [name for name, sensor in array.items() if sensor.header.unit == "g"]
    leaning = {name: (Misalignment(tuple(unit_of(name).angles_deg)),) for name in names}
    stretched: Effects = {name: (Scale(tuple(unit_of(name).scale_error.tolist())),) for name in names}
    both: Effects = {name: (*leaning[name], *stretched[name]) for name in names}
    candidates = [
        scored_with_scatter(array, ("misalignment", "scale"), both, 54, _of_force),
        scored_with_scatter(array, ("misalignment",), leaning, 36, _of_force, leaves="sizes of responses"),
        scored_with_scatter(array, ("scale",), stretched, 18, _of_force, leaves="what faces give axes across"),
        scored_with_scatter(array, (), {}, 0, _of_force, leaves="all of it"),
    ]
    found = discrepancy(array, "mounting", "Tables 3, 10: axes lean and answer", candidates, 108, _of_force)
    found = with_checks(found, [box := _of_the_box(array, names)], beyond_data_sheet=_beyond(array, names))
    # six of eighteen numbers a sensor are left when responses and biases are fitted; a half-difference is of two faces
    rms_mg: Any = box["rms_mg"]
    half = {name: mg / 1000 * sqrt(3) / sqrt(2) for name, mg in rms_mg.items()}
    return with_errors(found, error=half, angles_deg={name: degrees(one) for name, one in half.items()})


def g_sensitivity(array: Array) -> Discrepancy:
    """Gyroscopes' six faces, with `g_sensitivity` and in-run wander alone as candidates."""
    names = [name for name, sensor in array.items() if sensor.header.unit == "dps"]
    answers = {name: (GSensitivity(tuple(unit_of(name).response.ravel().tolist())),) for name in names}
    candidates = [
        scored_with_scatter(array, ("g_sensitivity",), answers, 27, _of_rate),
        scored_with_scatter(array, (), {}, 0, _of_rate, leaves="all that wander doesn't explain"),
    ]
    about = "Table 4: bias changes with the face"
    found = discrepancy(array, "force on gyroscopes", about, candidates, 54, _of_rate)
    differences = told_from(expected(array), "dbias_x_lsb")
    errors = {channel: sd / 2 * array[channel.split()[0]].lsb for channel, sd in differences.items()}
    return with_errors(found, response_dps_per_g=errors)


def noise(array: Array, chip: str) -> Discrepancy:
    """Noise of the BMA180 or L3G4200D in the array runs, with `white_noise` of each axis, the chip's widest filter
    (`odr_error`) and the data sheet's density as candidates.
    """

    def belongs(row: Statistic) -> bool:
        in_array = row.table in ("Table 10", "Table 11") and row.channel.split()[0] in names
        return in_array and row.statistic in ("std_lsb", "runs_std", "cont_std")

    names = [name for name, sensor in array.items() if sensor.header.chip == chip]
    widest = _WIDEST_HZ if chip == "bma180" else 110.0
    own = {name: (_own(array, name),) for name in names}
    wide = {name: (OdrError(bandwidth_hz=widest),) for name in names}
    numbers = 9 * len(names)
    candidates = [
        scored(array, ("white_noise",), own, 3 * len(names), belongs, leaves="why it is so much"),
        scored(array, ("odr_error",), wide, 1, belongs, leaves=f"noise over {widest:g} Hz"),
        scored(array, (), {}, 0, belongs, leaves="all of it"),
    ]
    about = f"Tables 10, 11: noise of the {chip.upper()}"
    found = discrepancy(array, f"noise of {chip}", about, candidates, numbers, belongs)
    ratios = {name: (found_noise(name) / array[name].rounded_noise).tolist() for name in names}
    shares = {name: [noise_residual(f"{name} {axis}") / sqrt(3) for axis in "xyz"] for name in names}
    return with_errors(with_checks(found, [], noise_over_data_sheet=ratios), rms_share=shares)


def _own(array: Array, name: str) -> WhiteNoise:
    sensor = array[name]
    rms = np.sqrt(found_noise(name) ** 2 - sensor.step**2 / 12) * sensor.lsb
    x, y, z = rms.tolist()
    return WhiteNoise((x, y, z))


def _of_force(row: Statistic) -> bool:
    return row.table == "Table 10" and row.statistic in READINGS[:6] and not row.channel.startswith("Gyro")


def _of_rate(row: Statistic) -> bool:
    return row.table == "Table 10" and row.statistic in READINGS[:6] and row.channel.startswith("Gyro")


def _of_the_box(array: Array, names: list[str]) -> dict[str, object]:
    """What the faces' readings leave once every axis has its response, bias and slope, in mg along the box's axes: how
    much of it all sensors share is of the box and the table, not of a sensor.
    """
    left = []
    for name in names:
        slope = unit_of(name).slope[:, None] / array[name].lsb
        readings = faces_of(name)[:, :6] - slope * np.array(FACES_DEGC[:6])
        response = np.stack([_half(readings, letter) for letter in "xyz"], axis=1)
        rest = readings - readings.mean(axis=1, keepdims=True) - response @ FACE_VECTORS[:6].T
        left.append(np.array(array[name].header.orientation) @ rest * array[name].lsb * 1000)
    residuals = np.array(left)
    shared = residuals.mean(axis=0)
    return {
        "check": "what faces leave is alike in all accelerometers: then it is of the box and the table, not of sensors",
        "rms_mg": {name: float(np.sqrt(np.mean(rest**2))) for name, rest in zip(names, residuals, strict=True)},
        "shared_rms_mg": float(np.sqrt(np.mean(shared**2))),
        "variance_shared": len(names) * float((shared**2).sum()) / float((residuals**2).sum()),
        "by_chance": 1 / len(names),
        "p": _by_signs(residuals, float((shared**2).sum())),
    }


def _by_signs(residuals: Floats, shared: float) -> float:
    """How often the sensors' residuals, each with either sign, have a mean as large: all 2^(n - 1) ways."""
    ways = np.array([(1, *signs) for signs in product((1, -1), repeat=len(residuals) - 1)], float) / len(residuals)
    means = np.tensordot(ways, residuals, axes=1)
    return float(np.mean((means**2).sum(axis=(1, 2)) >= shared * (1 - 1e-9)))


def _half(readings: Floats, letter: str) -> Floats:
    up, down = (READINGS.index(f"{letter}_{way}") for way in ("up", "down"))
    return np.asarray((readings[:, up] - readings[:, down]) / 2)


def _beyond(array: Array, names: list[str]) -> list[dict[str, object]]:
    """Angles and scale factors more than three of the data sheet's deviations off; boards turn as a whole too."""
    rows: list[dict[str, object]] = []
    for name in names:
        angles, errors = np.array(unit_of(name).angles_deg), unit_of(name).scale_error
        spread = sigma(array[name].header, "misalignment", "angles_deg", 6)
        for what, value, deviation in zip(("xy", "xz", "yx", "yz", "zx", "zy"), angles, spread, strict=True):
            at: dict[str, object] = {"sensor": name, "what": f"angle {what}, deg"}
            rows.append({**at, "value": float(value), "z": float(value / deviation)})
        spread = sigma(array[name].header, "scale", "error")
        for what, value, deviation in zip("xyz", errors, spread, strict=True):
            rows.append({"sensor": name, "what": f"scale {what}", "value": float(value), "z": float(value / deviation)})
    return [row for row in rows if abs(float(str(row["z"]))) > 3]

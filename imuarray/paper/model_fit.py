"""The model of the paper's array, fitted to its tables: `configs/models/martin2013.toml` is what this prints.

``python -m imuarray.paper.model_fit > configs/models/martin2013.toml``
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from textwrap import wrap

import numpy as np

from imuarray.paper.model_population import NOISE_BANDWIDTH_HZ, Spread, Table, designs
from imuarray.paper.model_units import (
    CHIP,
    CUTOFF_HZ,
    RANGE,
    TONE_HZ,
    Unit,
    bma1_reset_noise_share,
    bma1_reset_offset_g,
    gyro1_bias_at_250dps,
    gyro3_other_state_lsb,
    tone_dps,
    units,
)
from imuarray.paper.wander import TIME_CONSTANT_S

_HEAD = """\
# The nine inertial sensors of Martin, Groves, Newman and Faragher (ION GNSS+ 2013), fitted to the tables they print.
# Written by `python -m imuarray.paper.model_fit`; don't edit. Its fidelity: `imuarray paper --replica`.
# LSB are turned into g and dps with the data sheets' typical sensitivities; all is along a sensor's own axes.
"""
_SOURCES = {
    "misalignment": "Table 10: directions of the half-differences (up - down) / 2; the board's own turn is in them",
    "scale": "Table 10: norm of the half-differences over the typical sensitivity, less one (Table 3)",
    "g_sensitivity": "Table 10: half-differences, turned into the sensor's axes (half of Table 4's differences)",
    "bias": "Table 10: mean of the six faces, each brought to 25 degC with Table 8's slope",
    "thermal_bias": "Table 8 (an accelerometer axis along box Z carried 1 g: its slope may be its scale factor's)",
    "turn_on_bias": "Table 11: (deviation of the 15 runs' means)^2 - sem^2 - (slope 0.131 degC)^2 - in-run part; 0: "
    "none is left",
    "bias_instability": "Table 11: ((deviation of the 15 five-minute means)^2 - sem^2 - (slope 0.086 degC)^2) / 0.665, "
    "the share of a Gauss-Markov process of 600 s that such means scatter by (wander.py brackets the 600 s)",
    "white_noise": "Tables 10 and 11: mean variance of three experiments, less step^2 / 12, on gyroscope y the tone",
    "tone": "Figure 14: near 50 Hz, y only, seen on Gyro1; no amplitude printed: 3 % of Table 9's variance, a guess",
    "bandwidth": "Figure 13: neighbours at 350 Hz correlate by 0.4 = exp(-2 pi 51 / 350); at 48 Hz nothing shows of it",
    "thermometer": "Tables 10 and 11, rows t, beside the BMP180; an L3G4200D's zero is its own (L3G-60), ours 47 - T",
    "bistable_bias": "Table 7: second state less first, in 8 of 15 runs, all axes together",
    "range_reset": "Table 6, run 10 of 15: at the power-on range of 2 g (4096 LSB/g) the offset is another (BMA-79); "
    "Table 11: its noise too, a tenth to a sixth in g",
}
_NOTES = {
    ("Gyro1", "bias"): "at any range but 250 dps: Table 10, at 2000 dps",
    ("Gyro3", "bias"): "of the first of two states; Table 10 shows the second",
    ("Gyro1 at 250", "bias"): "Table 9 at 250 dps: +X up, at the 23.9 degC that Gyro1's own thermometer tells",
}
_POPULATION = """\
# What other units of these designs may be like: mean and spread over the units above and their axes, widened by how
# little so few can tell; `shared` is the share of the variance common to all drawn units (model_population.py).
"""


_MAGNETOMETERS = """\
# The paper logs its two magnetometers and analyses nothing of them. Data sheet: gain +-5 % (HMC-52), -1.2 counts of
# 1024 per degC (HMC-57), 10 mG (HMC-53).
"""


def fit_text() -> str:
    """The whole model file."""
    parts = [_HEAD, _lines({"name": "martin2013", "about": "the array of the paper, unit by unit"}, "[model]")]
    parts += [_sensor(unit) for unit in units()]
    head: Table = {"name": "Gyro1", "chip": CHIP["Gyro"], "range": 250.0}
    parts.append(_part("sensor", head, {"bias": {"offset_dps": gyro1_bias_at_250dps()}}, "Gyro1 at 250"))
    parts.append(_POPULATION)
    parts += [_part("design", head, effects) for head, effects in designs()]
    compass: dict[str, Table] = {
        "scale": {"error": Spread(0.0, 0.025, 0.0, limit=0.05)},
        "thermal_scale": {"slope_per_degc": -1.2 / 1024},
        "white_noise": {"rms_gauss": 0.01},
    }
    return "\n".join([*parts, _MAGNETOMETERS, _part("design", {"chip": "hmc5883"}, compass)])


def unit_effects(unit: Unit) -> dict[str, Table]:
    """The effects of a known unit: keys and figures as a model file has them."""
    u = unit.unit
    return {
        **_response(unit),
        "bias": {f"offset_{u}": unit.bias},
        "turn_on_bias": {f"rms_{u}": unit.turn_on},
        **_faults(unit),
        "thermal_bias": {f"slope_{u}_per_degc": unit.slope},
        "bias_instability": {f"rms_{u}": unit.in_run, "time_constant_s": TIME_CONSTANT_S},
        **_line(unit),
        "white_noise": {f"rms_{u}": unit.noise},
        **_thermometer(unit),
    }


def _response(unit: Unit) -> dict[str, Table]:
    if unit.unit == "dps":
        return {"g_sensitivity": {"response_dps_per_g": unit.response.ravel()}}
    return {"misalignment": {"angles_deg": np.array(unit.angles_deg)}, "scale": {"error": unit.scale_error}}


def _faults(unit: Unit) -> dict[str, Table]:
    if unit.name == "Gyro3":
        return {"bistable_bias": {"offset_dps": gyro3_other_state_lsb() * unit.lsb, "probability": 8 / 15}}
    if unit.name == "BMA1":
        offset, share = bma1_reset_offset_g(), bma1_reset_noise_share()
        return {"range_reset": {"range_g": 2.0, "offset_g": offset, "noise_share": share, "probability": 1 / 15}}
    return {}


def _line(unit: Unit) -> dict[str, Table]:
    if unit.unit == "g":
        return {}
    tone: Table = {"amplitude_dps": np.array([0.0, tone_dps(), 0.0]), "frequency_hz": TONE_HZ}
    return {"tone": tone, "bandwidth": {"cutoff_hz": CUTOFF_HZ}}


def _thermometer(unit: Unit) -> dict[str, Table]:
    if unit.thermometer is None:
        return {}
    offset, rms = unit.thermometer
    return {"thermometer": {"offset_degc": offset, "rms_degc": rms}}


def _sensor(unit: Unit) -> str:
    head: Table = {"name": unit.name, "chip": CHIP[unit.design]}
    if unit.name != "Gyro1":
        head["range"] = RANGE[unit.range]
    if head["chip"] in NOISE_BANDWIDTH_HZ:
        head["noise_bandwidth_hz"] = NOISE_BANDWIDTH_HZ[CHIP[unit.design]]
    effects = {kind: table for kind, table in unit_effects(unit).items() if _does_something(table)}
    return _part("sensor", head, effects, unit.name)


def _does_something(table: Table) -> bool:
    return any(np.any(np.asarray(value) != 0) for key, value in table.items() if key != "time_constant_s")


def _part(kind: str, head: Table, effects: Mapping[str, Table], name: str = "") -> str:
    texts = [_lines(head, f"[[{kind}]]")]
    for effect, table in effects.items():
        source = _NOTES.get((name, effect), "") or (_SOURCES[effect] if kind == "sensor" else "")
        texts.append("".join(_comment(source)) + _lines(table, f"[{kind}.{effect}]"))
    return "\n".join(texts)


def _comment(text: str) -> Iterator[str]:
    for line in wrap(text, 118):
        yield f"# {line}\n"


def _lines(table: Table, title: str) -> str:
    return "\n".join([title, *(f"{key} = {_value(value)}" for key, value in table.items())]) + "\n"


def _value(value: object) -> str:
    """TOML of a text, a number (six digits), a population, or a list of them."""
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
        raise TypeError(f"{value!r}: no figure of a model")
    text = f"{value:.6g}"
    return text if any(mark in text for mark in ".en") else f"{text}.0"


if __name__ == "__main__":
    sys.stdout.write(fit_text())

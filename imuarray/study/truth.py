"""What a simulation knows of its units, in the two forms that the study needs: the calibration that nobody could
better, and the law of the errors that it leaves.

Known for good are the response, the bias, its slope with temperature; drawn anew at each boot or all the time, and so
known in law alone, are turn-on bias, bias instability, common mode and white noise. Effects that the law does not have
(`OUTSIDE`) are to be left out of a simulation that it is to hold for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.stability import BIAS, Drift, Thermal, TurnOn
from imuarray.log.format import SensorHeader
from imuarray.simulate import EFFECTS
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.bias_instability import BiasInstability
from imuarray.simulate.effects.common_mode import CommonMode
from imuarray.simulate.effects.misalignment import Misalignment
from imuarray.simulate.effects.scale import Scale
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.effects.turn_on_bias import TurnOnBias
from imuarray.simulate.effects.white_noise import WhiteNoise
from imuarray.study.bound import ErrorLaw, SlowError
from imuarray.units import INERTIAL, SI_PER_UNIT

Floats = npt.NDArray[np.float64]

_INSIDE = frozenset(
    {
        "misalignment", "scale", "bias", "turn_on_bias", "thermal_bias", "bias_instability", "common_mode",
        "white_noise", "thermometer",
    }
)  # fmt: skip

OUTSIDE = tuple(name for name in EFFECTS if name not in _INSIDE)
"""Effects that the law does not describe."""


def true_calibration(headers: Sequence[SensorHeader], effects: Mapping[str, Sequence[Effect]]) -> Calibration:
    """What these units are, as a calibration: every figure that stays the same from boot to boot, without error."""
    known = {header.name: header for header in headers if header.quantity in INERTIAL}
    sensors = {name: _calibrated(header, effects.get(name, ())) for name, header in known.items()}
    return Calibration(sensors, ("the simulated units' own parameters",))


def law_of(headers: Sequence[SensorHeader], effects: Mapping[str, Sequence[Effect]]) -> ErrorLaw:
    """The law of what `true_calibration` leaves, per axis of these sensors (of one quantity), in order, in SI along the
    axes that they really have.
    """
    units = [_calibrated(header, effects.get(header.name, ())) for header in headers]
    noise = np.concatenate([unit.noise_lsb / unit.lsb_per_si for unit in units if unit.noise_lsb is not None])
    rows = np.concatenate([unit.directions_box for unit in units])
    slow: list[SlowError] = []
    shared: dict[tuple[str, int, float], Floats] = {}
    for number, header in enumerate(headers):
        per_si = SI_PER_UNIT[header.unit] / (1 + _triple(effects[header.name], Scale, "error"))
        for effect in effects[header.name]:
            time_constant_s = getattr(effect, "time_constant_s", math.inf)
            for axis in range(3) if isinstance(effect, TurnOnBias | BiasInstability | CommonMode) else ():
                loading = np.zeros(3 * len(headers))
                loading[3 * number + axis] = _triple([effect], type(effect), "rms")[axis] * per_si[axis]
                if isinstance(effect, CommonMode):
                    shared.setdefault((header.chip, axis, time_constant_s), np.zeros(len(loading)))[:] += loading
                elif loading.any():
                    slow.append(SlowError(loading, time_constant_s))
    slow += [SlowError(loading, seconds) for (_, _, seconds), loading in shared.items()]
    return ErrorLaw(rows, noise, tuple(slow))


def _calibrated(header: SensorHeader, effects: Sequence[Effect]) -> SensorCalibration:
    gains = 1 + _triple(effects, Scale, "error")
    leaning = next((each.directions for each in effects if isinstance(each, Misalignment)), np.eye(3))
    noise = header.sensitivity * _triple(effects, WhiteNoise, "rms")
    return SensorCalibration(
        name=header.name,
        quantity=header.quantity,
        unit=header.unit,
        bias_lsb=header.sensitivity * _triple(effects, Bias, "offset"),
        response_lsb_per_unit=header.sensitivity * gains[:, None] * (leaning @ np.array(header.orientation).T),
        bias_sem_lsb=np.zeros(3),
        response_sem_lsb_per_unit=np.zeros(3),
        noise_lsb=np.sqrt(noise**2 + code_span(header).step ** 2 / 12),  # rounding as noise of its own (Sheppard)
        temperature_degc=_thermal_reference(effects),
        range=header.range,
        thermal=_thermal(header, effects),
        turn_on=_turn_on(header, effects),
        drift=_drift(header, effects),
        g_sensitivity_lsb_per_g=np.zeros((3, 3)) if header.quantity == "angular_rate" else None,
        g_sensitivity_sem_lsb_per_g=np.zeros((3, 3)) if header.quantity == "angular_rate" else None,
    )


def _thermal(header: SensorHeader, effects: Sequence[Effect]) -> Thermal:
    """Slopes that are known not to be there are known too."""
    slope = header.sensitivity * _triple(effects, ThermalBias, "slope")
    quadratic = header.sensitivity * _triple(effects, ThermalBias, "quadratic")
    return Thermal(
        slope, np.zeros(3), _thermal_reference(effects), (BIAS,) * 3, "barometer", quadratic_lsb_per_degc2=quadratic
    )


def _turn_on(header: SensorHeader, effects: Sequence[Effect]) -> TurnOn:
    rms = header.sensitivity * _triple(effects, TurnOnBias, "rms")
    return TurnOn(rms, np.zeros(3), rms, np.full(3, np.nan), runs=0)


def _drift(header: SensorHeader, effects: Sequence[Effect]) -> Drift:
    rms = header.sensitivity * _triple(effects, BiasInstability, "rms")
    times = [effect.time_constant_s for effect in effects if isinstance(effect, BiasInstability)]
    return Drift(rms, np.zeros(3), times[0] if times else math.inf)


def _thermal_reference(effects: Sequence[Effect]) -> float:
    return next((each.reference_degc for each in effects if isinstance(each, ThermalBias)), 25.0)


def _triple(effects: Sequence[Effect], kind: type[Effect], name: str) -> Floats:
    """(3,) a parameter of the effects of one kind, their root sum of squares or sum; zero without any."""
    found = np.array([np.zeros(3), *(getattr(effect, name) for effect in effects if isinstance(effect, kind))])
    return np.asarray(np.sqrt((found**2).sum(axis=0)) if name == "rms" else found.sum(axis=0))

"""Calibration: parameters of each sensor from counts, and the file that stores them.

The names below are imported on first use, because SciPy is slow to import.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imuarray.callable_package import public_name

if TYPE_CHECKING:
    from imuarray.calibrate.comparison import CalibrationComparison, compare_calibrations
    from imuarray.calibrate.fits import Outlier
    from imuarray.calibrate.model import Calibration, SensorCalibration, load_calibration, nominal
    from imuarray.calibrate.noise import calibrate_noise
    from imuarray.calibrate.opposed import Cancellation, cancellation
    from imuarray.calibrate.thermal import ThermalResult, calibrate_thermal
    from imuarray.calibrate.tumble import TumbleResult, calibrate_tumble
    from imuarray.calibrate.turn_on import TurnOnResult, calibrate_turn_on, holm
    from imuarray.calibrate.turns import TurnFit

_PUBLIC = {
    "comparison": "CalibrationComparison compare_calibrations",
    "fits": "Outlier",
    "model": "Calibration SensorCalibration load_calibration nominal",
    "noise": "calibrate_noise",
    "opposed": "Cancellation cancellation",
    "thermal": "ThermalResult calibrate_thermal",
    "tumble": "TumbleResult calibrate_tumble",
    "turn_on": "TurnOnResult calibrate_turn_on holm",
    "turns": "TurnFit",
}

_FORMER_NAMES = {"Exclusion": "Outlier", "Tumble": "TumbleResult"}

__all__ = [
    "Calibration",
    "CalibrationComparison",
    "Cancellation",
    "Outlier",
    "SensorCalibration",
    "ThermalResult",
    "TumbleResult",
    "TurnFit",
    "TurnOnResult",
    "calibrate_noise",
    "calibrate_thermal",
    "calibrate_tumble",
    "calibrate_turn_on",
    "cancellation",
    "compare_calibrations",
    "holm",
    "load_calibration",
    "nominal",
]


def __getattr__(name: str) -> Any:
    """Import a public name, or a former one, on first use."""
    return public_name(__name__, _PUBLIC, _FORMER_NAMES.get(name, name))

"""From counts to parameters of each sensor, and the file that keeps them."""

from imuarray.calibrate.cancellation import Cancellation, cancellation
from imuarray.calibrate.comparison import CalibrationComparison, compare_calibrations
from imuarray.calibrate.disturbed import LeftOut
from imuarray.calibrate.model import Calibration, SensorCalibration, nominal
from imuarray.calibrate.noise import calibrate_noise
from imuarray.calibrate.stored import load_calibration
from imuarray.calibrate.thermal import ThermalResult, calibrate_thermal
from imuarray.calibrate.tumble import Tumble, calibrate_tumble
from imuarray.calibrate.turn_on import TurnOnResult, calibrate_turn_on, holm
from imuarray.calibrate.turns import TurnFit

__all__ = [
    "Calibration",
    "CalibrationComparison",
    "Cancellation",
    "LeftOut",
    "SensorCalibration",
    "ThermalResult",
    "Tumble",
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

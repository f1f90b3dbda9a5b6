"""From counts to parameters of each sensor, and the file that keeps them."""

from imuarray.calibrate.cancellation import Cancellation, cancellation
from imuarray.calibrate.model import Calibration, SensorCalibration, load_calibration, nominal
from imuarray.calibrate.noise import calibrate_noise
from imuarray.calibrate.tumble import Tumble, calibrate_tumble

__all__ = [
    "Calibration",
    "Cancellation",
    "SensorCalibration",
    "Tumble",
    "calibrate_noise",
    "calibrate_tumble",
    "cancellation",
    "load_calibration",
    "nominal",
]

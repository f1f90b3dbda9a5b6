"""The fixed plans of the emulated bench: the sensors, the experiments, the effects that an experiment cannot show, and
the severity at which a mechanism is just detectable on the full plan.

The limits were measured on development seeds in November 2026. The limits of a random world are determined for each
case (`imuarray.validation.severity`); that search starts from the values below.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

ARRAY = "martin2013"
CHIPS: Mapping[str, str] = {
    "ADXL1": "adxl345",
    "BMA1": "bma180",
    "BMA3": "bma180",
    "Gyro1": "l3g4200d",
    "Gyro3": "l3g4200d",
}
"""The sensors of the emulated array that are read, with their chips: two pairs of equal sensors, which have the same
address on two segments of the bus, and another accelerometer.
"""

PLANS: Mapping[str, tuple[str, ...]] = {
    "static": ("static",),
    "tumble": ("static", "tumble"),
    "heating": ("static", "heating"),
    "turn-on": ("static", "turn-on"),
    "full": ("static", "tumble", "heating", "turn-on", "motion"),
}
"""The experiments of each plan, as the emulator's bench names them."""

FULL = "full"
"""The plan of all cases except controls and cases that demonstrate what a shorter plan cannot show."""

AT_ONE_TEMPERATURE = ("thermal_bias", "thermal_scale", "thermal_lag")
IN_ONE_ATTITUDE = ("scale", "misalignment", "nonlinearity", "g_sensitivity", "saturation", "clock_error")
AT_REST = ("skew", "size_effect")
IN_ONE_BOOT = ("bias", "turn_on_bias", "bistable_bias")
"""Effects grouped by the condition that hides them."""

HIDDEN: Mapping[str, frozenset[str]] = {
    "static": frozenset((*AT_ONE_TEMPERATURE, *IN_ONE_ATTITUDE, *AT_REST, *IN_ONE_BOOT)),
    "tumble": frozenset((*AT_ONE_TEMPERATURE, *AT_REST)),
    "heating": frozenset((*IN_ONE_ATTITUDE, *AT_REST)),
    "turn-on": frozenset((*AT_ONE_TEMPERATURE, *IN_ONE_ATTITUDE, *AT_REST)),
}
"""The effects that a plan cannot show, because they need a second temperature, face or boot, or motion.

Effects that were detected in measurements (mechanisms at 5 limits, development seeds) are not listed: host latency is
detected from the repeated readings of gyroscopes with their own clock, a clock error from the times at which the box is
turned, and clipping on the face on which it occurs.
"""

LIMITS: Mapping[str, Mapping[str, float]] = {
    "carrier_shot_noise": {"ADXL1": math.nan, "BMA1": math.nan, "Gyro1": math.nan},
    "trapped_charges": {"ADXL1": 0.61, "BMA1": 0.16, "Gyro1": 0.3},
    "stress_relaxation": {"ADXL1": 0.17, "BMA1": 0.047, "Gyro1": 0.048},
    "single_trap": {"ADXL1": 0.29, "BMA1": 0.084, "Gyro1": 0.08},
    "output_filter": {"ADXL1": 0.089, "BMA1": 0.13, "Gyro1": 0.19},
    "mains_ripple": {"ADXL1": 0.35, "BMA1": 0.086, "Gyro1": 0.12},
    "dropped_box": {"ADXL1": 0.38, "BMA1": 0.35, "Gyro1": 0.026},
    "reference_voltage": {"ADXL1": 1.9, "BMA1": 2.1, "Gyro1": 2.7},
    "package_tilt": {"ADXL1": 1.0, "BMA1": 1.1, "Gyro1": 4.1},
    "plate_gap": {"ADXL1": 0.14, "BMA1": 0.029, "Gyro1": 0.69},
    "thermistor_bow": {"ADXL1": 0.11, "BMA1": 0.021, "Gyro1": 0.046},
    "gain_resistor": {"ADXL1": 6.2, "BMA1": 2.5, "Gyro1": 0.95},
    "board_to_die": {"ADXL1": math.nan, "BMA1": 0.17, "Gyro1": 0.1},
    "stuck_bit": {"ADXL1": 1.6, "BMA1": 3.6, "Gyro1": 1.2},
    "missing_codes": {"ADXL1": 1.9, "BMA1": 0.93, "Gyro1": 2.4},
    "soft_clipping": {"ADXL1": 5.8, "BMA1": 2.8, "Gyro1": 4.8},
    "slow_oscillator": {"ADXL1": 0.055, "BMA1": 0.074, "Gyro1": 0.053},
    "cable_bit_errors": {"ADXL1": 23.0, "BMA1": 0.073, "Gyro1": 0.088},
    "torn_reads": {"ADXL1": 0.016, "BMA1": 0.12, "Gyro1": 14.0},
    "power_on_stress": {"ADXL1": 0.24, "BMA1": 0.57, "Gyro1": 2.7},
    "converter_hold": {"ADXL1": 0.094, "BMA1": 0.043, "Gyro1": 0.035},
    "bias_current_dac": {"ADXL1": 0.22, "BMA1": 0.029, "Gyro1": 0.032},
    "brown_out": {"BMA1": 0.11},
    "loose_contact": {"ADXL1": 0.016, "BMA1": 0.016, "Gyro1": 0.016},
    "pipeline_delay": {"ADXL1": 0.062, "BMA1": 0.029, "Gyro1": 0.11},
    "rate_divider": {"ADXL1": 0.94, "BMA1": math.nan, "Gyro1": math.nan},
    "log_creep": {"ADXL1": 0.44, "BMA1": 0.13, "Gyro1": 0.11},
    "lever_arm": {"ADXL1": 0.02, "BMA1": 0.016},
    "spinning_motor": {"ADXL1": 0.28, "BMA1": 0.077, "Gyro1": 0.12},
    "one_sided_noise": {"ADXL1": 0.79, "BMA1": 0.13, "Gyro1": 0.23},
    "interleaved_converters": {"ADXL1": 0.23, "BMA1": 0.05, "Gyro1": 0.11},
    "keyed_transmitter": {"ADXL1": 0.56, "BMA1": 0.16, "Gyro1": 0.15},
    "supply_droop": {"ADXL1": 0.18, "BMA1": 0.052},
    "thermal_hysteresis": {"ADXL1": 0.14, "BMA1": 0.021, "Gyro1": 0.045},
    "vibration_rectification": {"ADXL1": 0.018, "BMA1": 0.016, "Gyro1": 0.016},
    "mux_crosstalk": {"ADXL1": math.nan, "BMA1": 0.041, "Gyro1": 0.026},
    "reference_noise": {"ADXL1": 0.3, "BMA1": 0.11, "Gyro1": 0.11},
    "drive_imbalance": {"Gyro1": 0.094},
    "host_resonator": {"": 0.16},
    "scheduler_latency": {"": 2.3},
    "supply_drift": {"": 0.016},
    "mux_hang": {"": 0.016},
}
"""Detection limits, in reference sizes, on one sensor of each chip that has the mechanism; "" for a mechanism that does
not act on a single sensor. The search covered 1/64 to 64: 0.016 is the smallest value, nan means more than the largest.
Mechanisms that are not listed have no size. Power-on stress is detected only if the scatter between runs exceeds the
usual one (`imuarray.gap.model.populations.turn_on_rms`), which is larger than the smallest visible scatter of BMA1 and
Gyro1.
"""


def limit(mechanism: str, chip: str = "") -> float:
    """Return the detection limit of a mechanism on a sensor of a chip ("": of a mechanism that does not act on a single
    sensor). nan if the mechanism is never detected; 1.0 if it is not in the table.
    """
    limits = LIMITS.get(mechanism, {})
    twin = next((name for name in limits if name and CHIPS[name] == chip), "")
    return limits.get(twin, next(iter(limits.values()), 1.0))

"""Detection limits: the severity of each mechanism, in units of its reference size, at which the full plan just shows
that something is wrong; measured by `python -m imuarray.validation.detection --seed 1`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from imuarray.validation.generator import CHIPS

LIMITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "carrier_shot_noise": {"BMA1": 0.38, "Gyro1": 0.79},
        "trapped_charges": {"BMA1": 0.15, "Gyro1": 0.29},
        "stress_relaxation": {"BMA1": 0.053, "Gyro1": 0.055},
        "single_trap": {"BMA1": 0.079, "Gyro1": 0.089},
        "output_filter": {"BMA1": 0.092, "Gyro1": 0.11},
        "mains_ripple": {"BMA1": 0.074, "Gyro1": 0.15},
        "dropped_box": {"BMA1": 0.29, "Gyro1": 0.027},
        "reference_voltage": {"BMA1": 2.1, "Gyro1": 2.2},
        "package_tilt": {"BMA1": 0.88, "Gyro1": 2.5},
        "plate_gap": {"BMA1": 0.037, "Gyro1": 0.87},
        "thermistor_bow": {"BMA1": 0.02, "Gyro1": 0.051},
        "gain_resistor": {"BMA1": 0.058, "Gyro1": 0.16},
        "board_to_die": {"BMA1": 0.18, "Gyro1": 0.12},
        "self_heating": {"BMA1": 0.11},
        "stuck_bit": {"BMA1": 2.5, "Gyro1": 2.9},
        "missing_codes": {"BMA1": 0.99, "Gyro1": 2.4},
        "soft_clipping": {"BMA1": 0.31, "Gyro1": 5.4},
        "slow_oscillator": {"BMA1": 0.047, "Gyro1": 0.046},
        "cable_bit_errors": {"BMA1": 33.0, "Gyro1": 0.021},
        "torn_reads": {"BMA1": 0.016, "Gyro1": 0.83},
        "power_on_stress": {"BMA1": 0.054, "Gyro1": 0.03},
        "converter_hold": {"BMA1": 0.033, "Gyro1": 0.047},
        "bias_current_dac": {"BMA1": 0.033, "Gyro1": 0.024},
        "brown_out": {"BMA1": 0.18},
        "range_switch": {"BMA1": 1.3, "Gyro1": 2.4},
        "loose_contact": {"BMA1": 0.016, "Gyro1": 0.016},
        "pipeline_delay": {"BMA1": 0.039, "Gyro1": 0.068},
        "rate_divider": {"BMA1": math.nan, "Gyro1": 12.0},
        "log_creep": {"BMA1": 0.13, "Gyro1": 0.12},
        "lever_arm": {"BMA1": 0.016},
        "spinning_motor": {"BMA1": 0.082, "Gyro1": 0.14},
        "one_sided_noise": {"BMA1": 0.16, "Gyro1": 0.22},
        "interleaved_converters": {"BMA1": 0.069, "Gyro1": 0.12},
        "keyed_transmitter": {"BMA1": 0.14, "Gyro1": 0.14},
        "supply_droop": {"BMA1": 0.061},
        "thermal_hysteresis": {"BMA1": 0.021, "Gyro1": 0.044},
        "vibration_rectification": {"BMA1": 0.016, "Gyro1": 0.016},
        "mux_crosstalk": {"BMA1": math.nan, "Gyro1": math.nan},
        "reference_noise": {"BMA1": 0.089, "Gyro1": 0.12},
        "drive_imbalance": {"Gyro1": 0.045},
        "host_resonator": {"": 0.03},
        "scheduler_latency": {"": 0.016},
    }
)
"""On one sensor of each chip that it can be put on, or wherever it goes (""). 0.016 is the least and nan stands for
more than the greatest that was tried, 1/64 and 64; what isn't here is there or not.
"""

FURTHEST = 64.0
"""How far severities go either way, in reference sizes."""


def limit(mechanism: str, sensors: Sequence[str]) -> float:
    """Of a mechanism on these sensors (none: wherever it goes), nan if it never shows; 1.0 for one that is not in the
    table.
    """
    found = LIMITS.get(mechanism, {})
    twin = next((name for name in found if name and sensors and CHIPS[name] == CHIPS[sensors[0]]), "")
    return found.get(twin, next(iter(found.values()), 1.0))

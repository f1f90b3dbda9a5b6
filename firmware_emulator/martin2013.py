"""The units of the paper's array, from its published tables: Martin, Groves, Newman, Faragher, ION GNSS+ 2013.

Counts are kept as printed and turned into g and dps with the data sheet's typical scale. The paper doesn't give: a
gyroscope's scale and alignment, the BMA180's filter setting, a bias in a range that was not used. Bandwidths here are
those of `configs/martin2013.toml`. Temperature slopes are Table 8's, where an axis that carries 1 g shows bias and
scale in one (section 5.2.5): all of it is taken for bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from firmware_emulator.chip import Triple
from firmware_emulator.element import Matrix, product, times

NAME = "martin2013"


@dataclass(frozen=True)
class PublishedUnit:
    """One triad of Tables 4, 8 and 10, rows x, y, z. `counts_per_unit` is the typical scale of the data sheet.

    An accelerometer's `faces` are the readings with +X, +Y, +Z, -X, -Y, -Z up; a gyroscope's `bias` and `differences`
    (Table 4) are the mean reading and what it changes from +X, +Y, +Z to -X, -Y, -Z up. `step` is the distance of codes
    that occur. `thermometer_offset_degc` makes the thermometer's mean of Table 10 come back in a room of 24 degC.
    """

    chip: str
    range: float
    counts_per_unit: float
    bandwidth_hz: float
    slope: Triple
    noise: Triple
    faces: tuple[tuple[float, ...], ...] = ()
    bias: Triple = (0.0, 0.0, 0.0)
    differences: Matrix | None = None
    step: float = 1.0
    thermometer_offset_degc: float = 0.0


ADXL345 = ("adxl345", 16.0, 256.0, 800.0)  # ADX-40; 1600 Hz, of which only even codes come (ADX-47)
BMA180_HIGH = ("bma180", 16.0, 512.0, 150.0)  # BMA-76
BMA180_LOW = ("bma180", 1.5, 5460.0, 150.0)  # BMA-71
L3G4200D_HIGH = ("l3g4200d", 2000.0, 1000 / 70, 35.0)  # L3G-42; 0.18 dps is L3G-74 over 35 Hz
L3G4200D_LOW = ("l3g4200d", 250.0, 1000 / 8.75, 35.0)  # L3G-40

TABLES: dict[str, PublishedUnit] = {
    "ADXL1": PublishedUnit(
        *ADXL345,
        slope=(-0.024, 0.019, -0.352),
        noise=(5.811277, 6.560084, 12.28892),
        faces=(
            (-253.497, 2.469027, 12.33293, 269.075, 13.12513, 2.899611),
            (13.01353, -256.075, 22.35989, 2.25853, 271.2409, -5.9701),
            (-3.95661, 4.159566, 247.2157, -11.9417, -22.4309, -262.606),
        ),
        step=2.0,
    ),
    "ADXL2": PublishedUnit(
        *ADXL345,
        slope=(-0.011, -0.067, -0.194),
        noise=(5.481664, 6.40681, 12.03305),
        faces=(
            (-253.973, 5.220675, 7.175946, 272.7924, 13.62696, 11.40376),
            (17.24602, -251.402, 14.30768, 8.269124, 275.401, 10.37481),
            (-22.7733, -18.1663, 236.3945, -15.774, -20.7224, -273.978),
        ),
        step=2.0,
    ),
    "BMA1": PublishedUnit(
        *BMA180_HIGH,
        slope=(-0.034, -0.199, 0.192),
        noise=(8.14338, 9.199038, 8.723506),
        faces=(
            (-81.7408, -604.112, -100.816, -102.087, 418.4423, -84.4824),
            (391.6477, -115.322, -134.907, -648.648, -139.155, -120.145),
            (13.09122, 7.244381, 537.0402, 10.84351, 16.37739, -515.345),
        ),
        thermometer_offset_degc=-0.47,
    ),
    "BMA2": PublishedUnit(
        *BMA180_HIGH,
        slope=(0.205, -0.258, 0.496),
        noise=(7.901824, 10.07948, 8.315939),
        faces=(
            (21.47985, 549.6836, 52.25275, 31.50906, -492.828, 3.071563),
            (425.7175, -91.8819, -86.6883, -615.501, -97.1331, -102.099),
            (69.95953, 90.44258, -451.826, 64.45256, 44.14392, 591.1872),
        ),
        thermometer_offset_degc=3.00,
    ),
    "BMA3": PublishedUnit(
        *BMA180_LOW,
        slope=(-0.548, -0.121, 4.516),
        noise=(40.04875, 51.06081, 49.97539),
        faces=(
            (144.0243, -5351.68, 515.6351, -24.0278, 5461.916, -415.383),
            (-5422.59, -77.3823, -9.89211, 5405.179, 57.58821, -21.7895),
            (20.71929, -451.205, -5522.18, -138.035, 329.0204, 5444.336),
        ),
        thermometer_offset_degc=1.76,
    ),
    "BMA4": PublishedUnit(
        *BMA180_LOW,
        slope=(0.946, -1.714, -2.235),
        noise=(46.12221, 68.80461, 56.33199),
        faces=(
            (-39.5078, 5419.983, 312.1222, 136.5785, -5306.03, -197.77),
            (-5438.93, -120.47, -66.5468, 5361.847, 47.06203, -35.0201),
            (183.5848, -161.923, 5603.323, 129.4264, 477.9277, -5340.18),
        ),
        thermometer_offset_degc=2.44,
    ),
    "Gyro1": PublishedUnit(
        *L3G4200D_HIGH,
        slope=(0.235, 0.265, 0.221),
        noise=(2.626539, 2.517964, 2.72343),
        bias=(8.389, -7.026, 12.888),
        differences=((0.006, -0.545, -0.073), (-0.160, -0.146, -0.023), (-0.094, -0.009, -0.202)),
        thermometer_offset_degc=2.15,
    ),
    "Gyro2": PublishedUnit(
        *L3G4200D_HIGH,
        slope=(0.521, 0.261, 0.187),
        noise=(2.456826, 2.432673, 3.008718),
        bias=(18.930, -4.050, 7.526),
        differences=((0.007, 0.385, -0.501), (0.236, 0.209, -0.260), (-0.221, 0.097, 0.007)),
        thermometer_offset_degc=-3.07,
    ),
    "Gyro3": PublishedUnit(
        *L3G4200D_LOW,
        slope=(0.904, 2.133, -2.782),
        noise=(19.90578, 20.25934, 19.69882),
        bias=(-10.822, 80.196, -6.116),
        differences=((-0.508, -3.315, 0.133), (1.109, 0.701, 0.694), (-0.674, -1.410, -0.206)),
        thermometer_offset_degc=3.98,
    ),
}

MOUNTED: dict[str, Matrix] = {
    "Gyro1": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "Gyro2": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "Gyro3": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""Table 1, box = matrix @ sensor; those of accelerometers follow from Table 10."""


def bias_of(published: PublishedUnit) -> Triple:
    """Mean of the six faces, or what Table 4 says, in the data sheet's unit."""
    counts = [sum(row) / 6 for row in published.faces] if published.faces else published.bias
    x, y, z = (count / published.counts_per_unit for count in counts)
    return x, y, z


def force_response(published: PublishedUnit, mounted: Matrix | None = None) -> Matrix:
    """Half differences of opposite faces: data sheet units per g, rows the sensor's axes, columns those of the sensor.

    `mounted` is the ideal orientation, box = `mounted` @ sensor; without it, the nearest one for an accelerometer.
    """
    rows = published.differences
    if rows is None:
        x, y, z = (tuple(up - down for up, down in zip(row[:3], row[3:], strict=True)) for row in published.faces)
        rows = (x[0], x[1], x[2]), (y[0], y[1], y[2]), (z[0], z[1], z[2])
    by_box_axis = times(rows, 0.5 / published.counts_per_unit)
    return product(by_box_axis, mounted or nearest_orientation(by_box_axis))


def nearest_orientation(by_box_axis: Matrix) -> Matrix:
    """The orientation along box axes, box = matrix @ sensor, that is nearest to a response."""
    columns = []
    for row in by_box_axis:
        largest = max(abs(element) for element in row)
        columns.append([math.copysign(1.0, element) if abs(element) == largest else 0.0 for element in row])
    x, y, z = zip(*columns, strict=True)
    return x, y, z


def noise_of(published: PublishedUnit) -> Triple:
    """Noise before the converter's rounding, in the data sheet's unit; rounding adds step**2 / 12 to the variance."""
    rounding = published.step**2 / 12
    x, y, z = (math.sqrt(rms**2 - rounding) / published.counts_per_unit for rms in published.noise)
    return x, y, z

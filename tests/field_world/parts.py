"""The errors of one specimen, drawn within the data sheet of its chip."""

from __future__ import annotations

import numpy as np

from tests.field_world.chips import BMA_TOL
from tests.field_world.streams import stream


def truncated(g, sd, lim, n=3):
    """Return `n` normal draws with the deviation `sd`, cut at `lim`."""
    return np.clip(g.normal(0, sd, n), -lim, lim)


class Part:
    """One specimen within its data sheet, in g, dps or gauss.

    `bias`, `scale` (relative), `misalignment` (rad), `cross_axis`, `density` (unit/√Hz; of a magnetometer the rms),
    `flicker_floor`, `turn_on` (rms from power-on to power-on), `bias_slope` and `scale_slope` (for each K from 25 °C),
    `slope_growth` (of the slope of the bias, for each K), `quadratic` and `cubic` (nonlinearity), `g_sensitivity`
    (dps/g), `clock` (relative rate), `displacement_mm` (from the drawing), `flex` (how far the board bends under the
    chip), `self_heating_k` with its time constant `lag_s`, and the thermometer's zero, slope and noise.
    """

    def __init__(self, key, s):
        g = stream(*key, s.name, "part")
        gd = stream(*key, s.die or s.name, "die")
        k = s.kind

        def u(a, b):
            return g.uniform(a, b, 3)

        self.slope_growth = np.zeros(3)  # thermal curvature, per K of the slope
        self.quadratic = np.zeros(3)
        self.cubic = np.zeros(3)
        self.g_sensitivity = np.zeros((3, 3))
        self.cross_axis = g.normal(0, 0.003, (3, 3)) * (1 - np.eye(3))
        self.misalignment = np.deg2rad(truncated(g, 0.35, 0.9))
        self.scale_slope = truncated(g, 5e-5, 1e-4)
        self.self_heating_k, self.lag_s = gd.uniform(0.4, 1.5), gd.uniform(15, 45)
        self.clock = 1.0
        self.displacement_mm = truncated(g, 0.3, 0.6)  # position error, mm
        if s.chip == "bma180":
            self.density = (
                150e-6 * u(0.92, 1.12) * (1.33 if s.low_power else 1.0) * (1 + 0.12 * max(0, np.log2(s.range / 2)))
            )
            self.bias = truncated(g, 0.018, 0.06)
            if s.range >= 8:
                self.bias = self.bias + truncated(g, 0.06, 0.3)
            self.scale = truncated(g, BMA_TOL[s.range] / 200, BMA_TOL[s.range] / 100)
            self.bias_slope = truncated(g, 0.25e-3, 0.5e-3)
            self.quadratic = truncated(g, 0.3e-3, 0.8e-3)
            self.flicker_floor, self.turn_on = 30e-6 * u(0.7, 1.5), 1.0e-3
            self.clock = 1 + float(np.clip(gd.normal(0, 0.025), -0.08, 0.08))
            self.thermometer_zero, self.thermometer_slope, self.thermometer_noise = (
                np.clip(gd.normal(0, 2.0), -5, 5),
                1.0,
                0.35,
            )
        elif s.chip == "adxl345":
            self.density = np.array([380e-6, 380e-6, 540e-6]) * u(0.85, 1.08)
            self.bias = np.concatenate([truncated(g, 0.035, 0.15, 2), truncated(g, 0.04, 0.25, 1)])
            self.scale = truncated(g, 0.009, 0.028)
            dv = (s.supply_v - 2.5) / 0.8
            self.bias = self.bias + np.array([0.025, 0.025, -0.020]) * dv
            self.scale = self.scale + np.array([0.035, 0.035, 0.0]) * dv
            self.bias_slope = np.concatenate([truncated(g, 0.25e-3, 0.5e-3, 2), truncated(g, 0.7e-3, 1.4e-3, 1)])
            self.cross_axis = g.normal(0, 0.004, (3, 3)) * (1 - np.eye(3))
            self.quadratic = truncated(g, 0.5e-3, 1.2e-3)
            self.flicker_floor, self.turn_on = 55e-6 * u(0.7, 1.5), 1.5e-3
            self.clock = 1 + float(np.clip(gd.normal(0, 0.008), -0.025, 0.025))
        elif s.chip == "l3g4200d":
            r = s.range / 250
            self.density = 0.03 * u(0.82, 1.08)
            self.bias = truncated(g, 3.0 * min(r, 3), 10 * min(r, 5))
            self.scale = truncated(g, 0.008, 0.02)
            self.bias_slope = truncated(g, 0.014, 0.03)
            self.scale_slope = truncated(g, 8e-5, 1.6e-4)
            self.cubic = truncated(g, 0.0005, 0.0012)
            self.g_sensitivity = g.normal(0, 0.004, (3, 3))
            self.flicker_floor, self.turn_on = 0.0035 * u(0.7, 1.4), 0.08
            self.clock = 1 + float(np.clip(gd.normal(0, 0.012), -0.04, 0.04))
            self.thermometer_zero, self.thermometer_slope, self.thermometer_noise = (
                gd.integers(12, 29) + gd.random(),
                -1.0,
                0.12,
            )
        elif k == "acc":  # MPU-6050 / 9150
            self.density = 400e-6 * np.array([0.8, 0.8, 1.15]) * u(0.9, 1.1)
            self.bias = np.concatenate([truncated(g, 0.02, 0.05, 2), truncated(g, 0.03, 0.08, 1)])
            self.scale = truncated(g, 0.009, 0.03)
            self.bias_slope = np.concatenate([truncated(g, 0.25e-3, 0.5e-3, 2), truncated(g, 0.45e-3, 0.85e-3, 1)])
            self.quadratic = truncated(g, 0.5e-3, 1.2e-3)
            self.flicker_floor, self.turn_on = 50e-6 * u(0.7, 1.5), 1.5e-3
        elif k == "gyro":
            self.density = 0.005 * u(0.85, 1.3)
            self.bias = truncated(g, 5.0, 20.0)
            self.scale = truncated(g, 0.009, 0.03)
            self.bias_slope = truncated(g, 0.012, 0.05)
            self.cubic = truncated(g, 0.0004, 0.001)
            self.g_sensitivity = g.normal(0, 0.004, (3, 3))
            self.flicker_floor, self.turn_on = 0.0018 * u(0.7, 1.4), 0.05
        elif k == "mag":
            self.density = np.array([1, 1, 1.1]) * 2.0e-3 / np.sqrt(s.averaged) * u(0.7, 1.0)  # rms, not a density
            self.bias = g.normal(0, 0.08, 3)  # hard iron of the box, mostly
            self.scale = truncated(g, 0.02, 0.05)
            self.bias_slope = truncated(g, 1e-4, 3e-4)
            self.scale_slope = -0.003 + truncated(g, 3e-4, 5e-4)
            self.flicker_floor, self.turn_on = 1.2e-4 * u(0.7, 1.3), 1e-3
            self.clock = 1 + float(np.clip(gd.normal(0, 0.012), -0.03, 0.03))
        if s.chip.startswith("mpu"):
            self.clock = 1 + float(np.clip(gd.normal(0, 0.005), -0.012, 0.012))
            self.thermometer_zero, self.thermometer_slope, self.thermometer_noise = (
                gd.normal(0, 1.5),
                1 + gd.normal(0, 0.01),
                0.02,
            )
        if k in ("acc", "gyro"):
            self.slope_growth = g.normal(0, 0.0015, 3)
        self.flex = truncated(g, 0.03, 0.06)  # microphonics: the board bends a little under each chip

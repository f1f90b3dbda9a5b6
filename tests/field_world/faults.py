"""What can be wrong, each fault at its place in the chain; four of them have no name in the vocabulary."""

from __future__ import annotations

import numpy as np
from scipy import signal

from tests.field_world.chips import G0
from tests.field_world.rotation import rotation_matrix
from tests.field_world.signals import flicker, interpolate, lag
from tests.field_world.streams import stream

COLUMN = {"x": 0, "y": 1, "z": 2}


class Fault:
    """A fault of one sensor: `name` is the effect's, `size` in `unit`, and each method changes one stage of the chain.

    `target` is the wanted size in standard deviations (`linear` faults are scaled to it, not below `minimum`); it
    acts from `onset` for `duration` (s), in the `logs` with these numbers. `analogue` faults act before the
    converter. `mechanism` says what it is in words, `word` is its word in the keys of random streams where that isn't
    the class's name.
    """

    name = None
    mechanism = ""
    word = ""
    unit = ""
    analogue = True  # acts before the converter
    linear = True  # size can be scaled to a wanted matched statistic

    def __init__(
        self,
        sensor,
        axis=None,
        size=1.0,
        target=None,
        onset=None,
        duration=None,
        logs=None,
        minimum=None,
        tolerance=None,
        text="",
        also_acceptable=(),
        **parameters,
    ):
        self.sensor, self.axis, self.size, self.target = sensor, axis, size, target
        self.onset, self.duration, self.logs = onset, duration, logs
        self.minimum, self.tolerance, self.text, self.also_acceptable = minimum, tolerance, text, also_acceptable
        self.parameters = parameters
        self.on = True

    def columns(self):
        """Return the columns on which the fault acts."""
        axes = self.axis if isinstance(self.axis, (list, tuple)) else [self.axis]
        return [0, 1, 2] if self.axis is None else [COLUMN[axis] for axis in axes]

    def active(self, c):
        """Return whether the fault acts in this log."""
        return self.logs is None or c.log in self.logs

    def gate(self, t):
        """Return 1 where the fault acts, and 0 elsewhere."""
        m = np.ones(len(t))
        if self.onset is not None:
            m *= t >= self.onset
            if self.duration is not None:
                m *= t < self.onset + self.duration
        return m

    def g(self, c, what=""):
        """Return the random stream of the fault."""
        return stream(*c.key, c.log, self.sensor, self.name, self.word or type(self).__name__, what)

    def chip_rate(self, c):
        """Return the rate (Hz) of the chip; None if the fault does not change it."""
        return

    def position(self, c, r):
        """Return the place of the sensor (m)."""
        return r

    def rotate(self, c, turn):
        """Return the rotation of the sensor against its mounting."""
        return turn

    def box_force(self, c, f):
        """Return the specific force of the box."""
        return f

    def before(self, c, y):
        """Return the input of the element."""
        return y

    def element(self, c, y):
        """Return the output of the element."""
        return y

    def noise(self, c, sd):
        """Return the deviation of the noise."""
        return sd

    def output(self, c, y):
        """Return the output of the filter."""
        return y

    def sensitivity(self, c, s):
        """Return the codes in one unit."""
        return s

    def register(self, c, code):
        """Return the codes."""
        return code

    def temperature_codes(self, c, tc):
        """Return the temperature codes."""
        return tc

    def read_delay(self, c, t):
        """Return the instants whose values are read."""
        return t

    def rows(self, c, d):
        """Return the rows of the log."""
        return d


class Added(Fault):
    """Something that is added before the filter; `wave` has unit size."""

    def element(self, c, y):
        if not self.active(c):
            return y
        y = y.copy()
        v = self.wave(c) * self.gate(c.t)
        for j in self.columns():
            y[:, j] += self.size * v
        return y


class Quadratic(Fault):
    """The response bends: a quadratic term."""

    name, unit = "nonlinearity", "g at 1 g"

    def before(self, c, y):
        if not self.active(c):
            return y
        y = y.copy()
        for j in self.columns():
            y[:, j] += self.size * y[:, j] ** 2
        return y


class Cubic(Fault):
    """The response bends: a cubic term of the full scale."""

    name, unit = "nonlinearity", "dps at full scale (cubic)"

    def before(self, c, y):
        y = y.copy()
        for j in self.columns():
            y[:, j] += self.size * (y[:, j] / c.s.range) ** 3
        return y


class ScaleError(Fault):
    """A scale error."""

    word = "ScaleF"
    name, unit = "scale", "relative"

    def before(self, c, y):
        if not self.active(c):
            return y
        y = y.copy()
        for j in self.columns():
            y[:, j] *= 1 + self.size * self.gate(c.t)
        return y


class GSensitivity(Fault):
    """A gyroscope feels specific force."""

    word = "GSens"
    name, unit = "g_sensitivity", "dps/g"

    def element(self, c, y):
        y = y.copy()
        for j in self.columns():
            y[:, j] += self.size * c.force[:, COLUMN[self.parameters["along"]]]
        return y


class Displacement(Fault):
    """A sensor is not at its place."""

    word = "Lever"
    name, unit = "size_effect", "mm"

    def position(self, c, r):
        v = np.array(self.parameters["direction"], float)
        return r + self.size * 1e-3 * v / np.linalg.norm(v)


class Skew(Fault):
    """The values of a sensor are older than their times."""

    name, unit = "skew", "s"

    def read_delay(self, c, t):
        return t - self.size


class LostRows(Fault):
    """Rows are lost."""

    word = "Lost"
    analogue = False
    name, unit, linear = "dropped_samples", "share of rows", False

    def rows(self, c, d):
        g = self.g(c)
        n = len(d["t"])
        lose = np.zeros(n, bool)
        want = int(self.size * n)
        while lose.sum() < want:
            a = g.integers(5, n - 10)
            lose[a : a + g.choice([1, 1, 1, 2, 3])] = True
        d["lose"] = lose
        return d


class Clipping(Fault):
    """The codes clip below the end of the range."""

    word = "Clip"
    analogue = False
    name, unit, linear = "saturation", "codes at which it clips", False

    def register(self, c, code):
        code = code.copy()
        for j in self.columns():
            L = int(self.size)
            code[:, j] = np.clip(code[:, j], -L - 1, L)
        return code


class Tone(Added):
    """A line whose frequency wanders slowly."""

    name, unit = "tone", "amplitude, sensor unit"

    def wave(self, c):
        f0 = self.parameters["hz"]
        g = self.g(c)
        n = int((c.w.dur + 4) * 4)
        wob = lag(g.standard_normal(n), 4.0, 20.0)
        wob = wob / (np.std(wob) + 1e-9) * self.parameters.get("wander", 0.01)
        ph = np.cumsum(f0 + interpolate(wob, -1.5, 4.0, c.t)) / c.f
        return np.sin(2 * np.pi * ph + g.uniform(0, 6.28))


class RandomWalk(Added):
    """The bias walks at random."""

    name, unit = "random_walk", "sensor unit / sqrt(s)"

    def wave(self, c):
        g = self.g(c)
        n = int((c.w.dur + 3) * 10)
        x = np.cumsum(g.standard_normal(n)) / np.sqrt(10)
        return interpolate(x - x[15], -1.5, 10.0, c.t)


class Flicker(Added):
    """The bias wanders like 1/f."""

    word = "Flick"
    name, unit = "bias_instability", "sensor unit (floor)"

    def wave(self, c):
        g = self.g(c)
        return interpolate(flicker(g, int((c.w.dur + 3) * 8), 8.0, 1.0, 1)[:, 0], -1.5, 8.0, c.t)


class Telegraph(Added):
    """The bias jumps between two levels at random times."""

    name, unit = "popcorn_noise", "step, sensor unit"

    def wave(self, c):
        g = self.g(c)
        t, s, e = -1.5, 0, []
        while t < c.w.dur + 1:
            t += g.exponential(self.parameters["up"] if s else self.parameters["down"])
            s = 1 - s
            e.append(t)
        return (np.searchsorted(np.array(e), c.t) % 2).astype(float)


class Misalignment(Fault):
    """A sensor is rotated against its drawing."""

    word = "Misalign"
    name, unit = "misalignment", "deg"

    def rotate(self, c, turn):
        v = np.array(self.parameters["about"], float)
        return rotation_matrix(np.deg2rad(self.size) * v / np.linalg.norm(v)) @ turn


class ThermalCurve(Added):
    """The bias is quadratic in temperature."""

    word = "ThermCurve"
    name, unit = "thermal_bias", "sensor unit per (20 K)^2"

    def wave(self, c):
        return ((c.dT + 25 - self.parameters["T0"]) / 20.0) ** 2


class ThermalLag(Added):
    """The bias follows the case, its thermometer the die."""

    word = "ThermLag"
    mechanism = (
        "The bias follows the case, the thermometer the die: slope and lag of the part itself beyond the board's."
    )
    name, unit = "thermal_lag", "sensor unit per K of lagging difference"

    def wave(self, c):
        x = lag(c.Td, c.fT, self.parameters["tau"]) - c.Td
        return interpolate(x, c.tT[0], c.fT, c.t)


class ThermalScale(Fault):
    """The scale depends on temperature."""

    word = "ThermScale"
    name, unit = "thermal_scale", "1/K"

    def before(self, c, y):
        y = y.copy()
        for j in self.columns():
            y[:, j] *= 1 + self.size * c.dT
        return y


class CoarseCodes(Fault):
    """The codes have coarser steps."""

    word = "Even"
    analogue = False
    name, unit, linear = "quantisation", "code step", False

    def register(self, c, code):
        st = int(self.size)
        code = code.copy()
        for j in self.columns():
            code[:, j] = np.floor_divide(code[:, j], st) * st
        return code


class ExchangedAxes(Fault):
    """The axes are exchanged or reversed."""

    word = "WrongAxis"
    analogue = False
    name, unit, linear = "axis_error", "", False

    def register(self, c, code):
        return code[:, self.parameters["perm"]] * np.array(self.parameters["sign"])


class MoreNoise(Fault):
    """The white noise is larger."""

    name, unit, linear = "white_noise", "factor", False

    def noise(self, c, sd):
        sd = np.array(sd, float).copy()
        sd[self.columns()] *= self.size
        return sd


class Stuck(Fault):
    """A register keeps its code."""

    analogue = False
    name, unit, linear = "stuck", "", False

    def register(self, c, code):
        if not self.active(c):
            return code
        code = code.copy()
        a = np.searchsorted(c.ty, self.onset)
        b = len(code) if self.duration is None else np.searchsorted(c.ty, self.onset + self.duration)
        for j in self.columns():
            code[a:b, j] = code[a, j]
        return code


class RangeReset(Fault):
    """A log was recorded in another range."""

    word = "OtherRange"
    name, unit, linear = "range_reset", "range", False

    def sensitivity(self, c, s):
        return s * self.parameters["ratio"] if self.active(c) else s

    def element(self, c, y):
        return y + np.array(self.parameters.get("shift", [0, 0, 0])) if self.active(c) else y


class BistableBias(Added):
    """The bias has two states."""

    word = "Bistable"
    name, unit = "bistable_bias", "sensor unit between the two states"

    def wave(self, c):
        return np.ones(len(c.t))


class TurnOnBias(Added):
    """The bias differs from power-on to power-on."""

    word = "TurnOn"
    name, unit = "turn_on_bias", "sensor unit, rms from power-on to power-on"

    def wave(self, c):
        p = self.parameters["pattern"]
        return np.full(len(c.t), p[c.log % len(p)])


class WrongRate(Fault):
    """The chip runs at another rate."""

    word = "OtherRate"
    name, unit, linear = "odr_error", "Hz", False

    def chip_rate(self, c):
        return self.size


class HeldRows(Fault):
    """Rows repeat old bytes."""

    word = "Hold"
    mechanism = "Bus trouble: the register is not fetched for some rows, the old bytes are logged again."
    analogue = False
    name, unit, linear = "stale_samples", "share of rows", False

    def rows(self, c, d):
        g = self.g(c)
        n = len(d["t"])
        want, got = self.size * n, 0
        i = d["idx"]
        while got < want:
            a, m = g.integers(20, n - 30), g.integers(2, 7)
            i[a : a + m] = i[a - 1]
            got += m
        d["idx"] = i
        return d


class TornWords(Fault):
    """The halves of a word are from two conversions."""

    word = "Torn"
    mechanism = "High byte of one conversion, low byte of the next: a single reading off by 256 codes."
    analogue = False
    name, unit, linear = "glitches", "number of readings", False

    def rows(self, c, d):
        g = self.g(c)
        cnt, i = d["counts"], d["idx"]
        for j in self.columns():
            old, new = c.codes[i - 1, j], c.codes[i, j]
            k = np.flatnonzero((old >> 8) != (new >> 8))
            k = g.choice(k[(k > 50) & (k < len(i) - 50)], int(self.size), replace=False)
            cnt[k, j] = (old[k] & ~0xFF) | (new[k] & 0xFF)
        return d


class ThermalKnee(Added):
    """The bias has a slope above a temperature."""

    word = "Knee"
    name, unit = "thermal_bias", "sensor unit per K above the knee"

    def wave(self, c):
        x = c.dT + 25 - self.parameters["T0"]
        return 1.0 * np.logaddexp(0, x / 1.0)


# ---- without a name in the vocabulary -----------------------------------------------------------------------


class Rectification(Added):
    """The mean depends on the power of the vibration."""

    word = "Rectify"
    mechanism = "Vibration rectification: the mean moves with the vibration's power."
    unit = "g per (m/s2)^2"

    def wave(self, c):
        w = c.w
        v = w.f - lag(w.f, w.fs, 0.05)
        p = lag(lag(np.sum(v * v, 1), w.fs, 0.15), w.fs, 0.1)
        return w.at(p, c.t)


class LooseBoard(Fault):
    """A resonance between box and chip."""

    mechanism = "The breakout hangs on its pin header: a resonance between box and chip."
    unit = "share of the resonance"

    def box_force(self, c, f):
        w0, Q = 2 * np.pi * self.parameters["hz"], self.parameters["Q"]
        b, a = [w0 / Q, w0**2], [1, w0 / Q, w0**2]
        bz, az = signal.bilinear(b, a, c.w.fs)
        j = COLUMN[self.parameters["box"]]
        x = f[:, j] - f[0, j]
        y = signal.lfilter(bz, az, x)
        f = f.copy()
        f[:, j] += self.size * (y - x)
        return f


class Creep(Added):
    """The bias remembers the attitude before."""

    mechanism = "Potting that creeps: the offset remembers the former attitude for a while."
    unit = "g per g"

    def wave(self, c):
        w = c.w
        x = w.f[:, COLUMN[self.parameters["box"]]] / G0
        return w.at(x - lag(x, w.fs, self.parameters["tau"]), c.t)


class Droop(Added):
    """The bias follows the load of the supply."""

    mechanism = (
        "A thermostat's heater on the same 3.3 V rail: the offset sags while it is on, "
        "in the ratio of the supply sensitivities."
    )
    unit = "g on x and y while the heater is on"

    def element(self, c, y):
        on = lag(c.w.marks["heater"].astype(float), c.w.fs, 0.05)
        return y + self.size * c.w.at(on, c.t)[:, None] * np.array([1, 1, -0.8])

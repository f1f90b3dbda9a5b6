"""The world of the box: attitude, acceleration, vibration, temperature, pressure and field over time."""

from __future__ import annotations

import numpy as np

from tests.field_world.chips import G0
from tests.field_world.rotation import about, of_vectors, product, to_box
from tests.field_world.signals import band_noise, interpolate, lag, smooth_step
from tests.field_world.streams import stream

PAD = 2.0
UP = {"z_up": "+Z", "x_up": "+X", "y_up": "+Y", "z_down": "-Z", "x_down": "-X", "y_down": "-Y"}
FACE = {
    "z_up": about([1, 0, 0], 0.0),
    "z_down": about([1, 0, 0], np.pi),
    "x_up": about([0, 1, 0], -np.pi / 2),
    "x_down": about([0, 1, 0], np.pi / 2),
    "y_up": about([1, 0, 0], np.pi / 2),
    "y_down": about([1, 0, 0], -np.pi / 2),
}


class World:
    """What the box feels, on a uniform grid of `n` instants `t` with the rate `fs`, from `PAD` before the log on.

    Attitude `q`, acceleration `a` (world, m/s²), more specific force `fv` and angular rate `wv` (box), temperature `T`
    (°C), pressure `P` (Pa), field `B` (world, gauss) and `Bextra` (box). `finish` makes of these angular rate `w`,
    angular acceleration `al`, specific force `f` and field `m` in the box. `phases` are those of the log (start, end,
    name, up).
    """

    def __init__(self, key, dur, fs, start_c=23.0):
        self.key, self.dur, self.fs = key, dur, fs
        self.t = np.arange(-PAD, dur + PAD, 1 / fs)
        n = self.n = len(self.t)
        self.q = np.tile([1.0, 0, 0, 0], (n, 1))
        self.a = np.zeros((n, 3))  # world, m/s2
        self.fv = np.zeros((n, 3))  # extra specific force, box frame
        self.wv = np.zeros((n, 3))  # extra angular rate, box frame
        self.T = np.full(n, float(start_c))
        self.P = np.full(n, 100800.0 + 900 * self.r("pressure").standard_normal())
        self.B = None  # gauss, world; set in finish
        self.Bextra = np.zeros((n, 3))  # box frame
        self.phases, self.reference, self.marks = [], None, {}

    def r(self, *k):
        """Return a random stream of this world."""
        return stream(*self.key, "world", *k)

    def noise(self, name, lo, hi, rms, c=None):
        """Return noise between `lo` and `hi` Hz."""
        return band_noise(self.r(name), self.n, self.fs, lo, hi, rms, c)

    def slow(self, name, tau, rms):
        """Return a smooth slow wander: white noise on a coarse grid behind three lags."""
        fs = 20 / tau
        m = int((self.dur + 2 * PAD) * fs) + 120
        x = self.r(name).standard_normal(m)
        for _ in range(3):
            x = lag(x, fs, tau / 2)
        x = x[80:]
        x = x / (np.std(x) + 1e-30) * rms if len(x) > 60 else x * rms * 4
        tt = np.arange(len(x)) / fs - PAD
        # smoothed twice on the fine grid: no kinks in an attitude
        return lag(lag(np.interp(self.t, tt, x), self.fs, tau / 12), self.fs, tau / 12)

    def turn(self, axis, ang):
        """Turn the box about one of its own axes."""
        self.q = product(self.q, about(axis, ang))

    def finish(self):
        """Compute what the box feels, and return the world."""
        q = self.q = self.q / np.linalg.norm(self.q, axis=1, keepdims=True)
        c = q * [1, -1, -1, -1]
        d = product(c[:-1], q[1:])
        d *= np.sign(d[:, :1] + 1e-300)
        s = np.linalg.norm(d[:, 1:], axis=1)
        ang = 2 * np.arctan2(s, d[:, 0])
        wm = d[:, 1:] * np.where(s > 1e-12, ang / np.maximum(s, 1e-12), 2.0)[:, None] * self.fs
        w = np.empty((self.n, 3))
        w[1:-1] = 0.5 * (wm[1:] + wm[:-1])
        w[0], w[-1] = wm[0], wm[-1]
        self.w = w + self.wv + to_box(q, np.array([5.0e-5, 0, 5.3e-5]) * np.ones((self.n, 1)))
        self.al = np.gradient(self.w, 1 / self.fs, axis=0)
        self.f = to_box(q, self.a + np.array([0, 0, G0 * (1 + 3e-4 * self.r("g").standard_normal())])) + self.fv
        g = self.r("B")
        if self.B is None:
            inc, F, dec = np.deg2rad(g.uniform(55, 68)), g.uniform(0.45, 0.5), g.uniform(0, 6.28)
            self.B = F * np.array([np.cos(inc) * np.cos(dec), np.cos(inc) * np.sin(dec), -np.sin(inc)])
        self.m = to_box(q, self.B * np.ones((self.n, 1))) + self.Bextra
        return self

    def at(self, x, t):
        """Return the series `x` at the instants `t`."""
        return interpolate(x, self.t[0], self.fs, t)

    # ---- surroundings -------------------------------------------------------------------------------------
    def building(self, level=1.0, walkers=0, hum_mg=0.0, hum_hz=50.0, traffic=True, mag_hum=0.0):
        """Add a building: microseisms, traffic, people who walk, hum, weather."""
        n, t = self.n, self.t
        if mag_hum:
            self.Bextra += mag_hum * 1e-3 * np.sin(2 * np.pi * 50.008 * t)[:, None] * [0.6, -0.5, 0.62]
        self.fv += self.noise("micro", 0.1, 0.4, 4e-6 * G0 * level, 3)
        day = np.exp(0.5 * self.slow("day", 60.0, 1.0))[:, None]
        self.fv += self.noise("cultural", 2.0, 30.0, 25e-6 * G0 * level, 3) * day
        g = self.r("walk")
        if traffic:
            for _ in range(g.poisson(self.dur / 150)):
                c, wd = g.uniform(0, self.dur), g.uniform(3, 8)
                self.fv += (
                    (np.exp(-0.5 * ((t - c) / wd) ** 2) * g.uniform(0.1, 0.4) * 1e-3 * G0)[:, None]
                    * band_noise(g, n, self.fs, 8, 16, 1.0, 3)
                    * [0.4, 0.4, 1]
                )
        for _ in range(walkers):
            c, wd = g.uniform(5, self.dur - 5), g.uniform(3, 6)
            f0, ring = g.uniform(1.7, 2.1), g.uniform(12, 22)
            x = np.zeros(n)
            for s in np.arange(c - 2 * wd, c + 2 * wd, 1 / f0):
                s += g.normal(0, 0.02)
                k = (t > s) & (t < s + 0.6)
                u = t[k] - s
                x[k] += (
                    np.exp(-0.5 * ((s - c) / wd) ** 2)
                    * np.exp(-u / 0.12)
                    * np.sin(2 * np.pi * ring * u)
                    * g.uniform(0.4, 1.3)
                )
            self.fv += x[:, None] * np.array([0.2, 0.2, 1.0]) * 1.2e-3 * G0
            ph = 2e-5 * np.exp(-0.5 * ((t - c) / wd) ** 2)  # the floor sags under the walker
            self.turn([g.normal(), g.normal(), 0], ph)
        if hum_mg:
            ph = np.cumsum(hum_hz + 0.02 * self.slow("mains", 40.0, 1.0)) * 2 * np.pi / self.fs
            for k, amp in ((1, 0.35), (2, 1.0), (4, 0.2)):
                if k * hum_hz < 0.4 * self.fs:
                    u = g.normal(size=3)
                    self.fv += (
                        np.sin(k * ph + g.uniform(0, 6.28))[:, None] * u / np.linalg.norm(u) * amp * hum_mg * 1e-3 * G0
                    )
        self.P += self.slow("weather", 200.0, 12.0) + self.noise("air", 0.02, 2.0, 0.6)

    def wind(self, deg=0.01):
        """Add gusts, which tilt the box and change the pressure."""
        gust = np.exp(0.7 * self.slow("gust", 15.0, 1.0))
        for i, ax in enumerate(([1, 0, 0], [0, 1, 0])):
            self.turn(ax, np.deg2rad(deg) * gust * self.noise(f"wind{i}", 0.2, 3.0, 1.0))
        self.P += gust * self.noise("windp", 0.05, 3.0, 2.5)

    def level(self, deg=0.3):
        """Tilt the table, and the box on it."""
        g = self.r("level")
        self.q = product(about([g.normal(), g.normal(), 1e-9], np.deg2rad(deg) * abs(g.normal())), self.q)
        self.q = product(self.q, about([g.normal(), g.normal(), 1e-9], np.deg2rad(0.1)))

    def tilt_slowly(self, deg):
        """Tilt the box by this angle during the log."""
        g = self.r("tiltaxis")
        a = np.deg2rad(deg) * (smooth_step((self.t + 1) / self.dur) + 0.06 * self.slow("tiltw", 60.0, 1.0))
        self.q = product(about([g.normal(), g.normal(), 1e-9], a), self.q)

    def temperature(self, kind, **k):
        """Set the course of the temperature: "room", "warmup", "sun", "profile" or "exp"."""
        t, g = self.t, self.r("temperature")
        if kind == "room":
            per = g.uniform(240, 600)
            self.T += (
                k.get("drift", 0.4) * t / 600
                + 0.15 * np.sin(2 * np.pi * t / per + g.uniform(0, 6))
                + self.slow("roomT", 80.0, 0.05)
            )
        elif kind == "warmup":  # electronics just switched on
            self.T += k.get("dT", 3.0) * (1 - np.exp(-np.maximum(t, 0) / k.get("tau", 120.0))) + self.slow(
                "roomT", 80.0, 0.05
            )
        elif kind == "sun":
            on = (t > k.get("start", 0.25) * self.dur).astype(float)
            cloud = np.clip(1 + 0.8 * self.slow("cloud", 40.0, 0.6), 0.1, 1.3)
            self.T += lag(on * cloud * k.get("dT", 9.0), self.fs, 140.0)
        elif kind == "profile":  # corner points (s, target degC), box follows with a lag
            tp, Tp = zip(*k["points"], strict=True)
            x = np.interp(t, tp, Tp)
            self.T = lag(x, self.fs, k.get("tau", 60.0)) + self.slow("fan", 25.0, 0.12)
        elif kind == "exp":
            self.T = (
                k["to"] + (k["start"] - k["to"]) * np.exp(-np.maximum(t, 0) / k["tau"]) + self.slow("air", 30.0, 0.08)
            )

    def shock(self, t0, g_, g, ring=None, tau=0.03):
        """Add a knock of `g_` g, which rings."""
        ring = ring or g.uniform(25, 70)
        k = (self.t > t0) & (self.t < t0 + 0.5)
        u = self.t[k] - t0
        d = np.array([0.3 * g.normal(), 0.3 * g.normal(), 1.0])
        self.fv[k] += g_ * G0 * (np.exp(-u / tau) * np.sin(2 * np.pi * ring * u))[:, None] * d

    def tremor(self, mask, deg=0.25, acc=0.12):
        """Add a hand that holds the box where `mask` is 1: a tremor of 7 to 12 Hz, and a slow sway."""
        m = mask[:, None]
        rv = np.deg2rad(deg) * (0.35 * self.noise("tr", 7, 12, 1.0, 3) + self.noise("sway", 0.3, 2.0, 1.0, 3))
        self.q = product(self.q, of_vectors(rv * m))
        self.a += acc * m * (self.noise("tra", 6, 12, 0.5, 3) + self.noise("swaya", 0.4, 2.5, 1.0, 3))

"""From the motion of the box to the registers of one sensor: element, noise, filter, converter, thermometer."""

from __future__ import annotations

import numpy as np
from scipy import signal

from tests.field_world.chips import G0, L3G_LPF1
from tests.field_world.rotation import rotation_matrix
from tests.field_world.signals import flicker, interpolate, lag
from tests.field_world.streams import stream


def conversion_times(s, p, key, dur, fw, odr=None):
    """Return the true instants of the conversions, their rate, and how many of them make one output."""
    odr = odr or s.rate
    if s.chip == "bma180":
        f, m = odr, 1
    elif s.chip.startswith("mpu"):
        f, m = 1000.0, max(1, round(1000.0 / odr))
    elif s.kind == "mag":
        f, m = odr, 1
    else:
        m = 1
        while m * odr < max(400.0, 0.8 * fw if s.chip == "adxl345" else 800.0):
            m *= 2
        m = max(m, 4)
        f = m * odr
    f *= p.clock
    t0 = -1.2 + stream(*key, s.name if not s.die else s.die, "phase").uniform(0, m / f)
    t = t0 + np.arange(int((dur + 1.7) * f)) / f
    return t, f, m


class Conversion:
    """What happens in one sensor during one log, as the faults see it.

    World `w`, sensor `s`, part `p`, `key` of the case and number of the `log`; instants `t` of the conversions, their
    rate `f`, `m` conversions for each output; `force` (g) that a gyroscope feels; temperature of the die `Td` at the
    instants `tT` with the rate `fT`, and `dT` from 25 °C at the conversions; outputs: instants `ty`, values before
    rounding `real`, `codes`, and temperature codes `tc`.
    """


def convert(w, s, p, key, log, faults, alt):
    """Return what the registers of sensor `s` hold during the log; `alt` is the number of the draw of its noise."""
    c = Conversion()
    c.w, c.s, c.p, c.key, c.log = w, s, p, key, log
    odr = None
    for x in faults:
        odr = x.chip_rate(c) or odr
    t, f, m = conversion_times(s, p, (*key, log), w.dur, w.fs, odr)
    c.t, c.f, c.m = t, f, m
    mounting = s.matrix
    # ---- element
    r = (np.array(s.position_mm) + p.displacement_mm) * 1e-3
    for x in faults:
        r = x.position(c, r)
    Rs = rotation_matrix(p.misalignment)
    for x in faults:
        Rs = x.rotate(c, Rs)
    M = mounting @ Rs.T
    fb = w.f
    for x in faults:
        fb = x.box_force(c, fb)
    if s.kind == "acc" and "flex" in w.marks:
        fb = fb + signal.sosfilt(signal.butter(2, 40, "high", fs=w.fs, output="sos"), fb - fb[0], axis=0) * p.flex
    if s.kind == "acc":
        y = fb + np.cross(w.al, r) + np.cross(w.w, np.cross(w.w, r))
        y = w.at(y, t) @ M / G0
    elif s.kind == "gyro":
        y = np.rad2deg(w.at(w.w, t)) @ M
    else:
        y = w.at(w.m, t) @ M
    if s.kind == "gyro":
        c.force = w.at(w.f, t) @ M / G0
    # temperature of the die
    st = max(1, int(w.fs / 10))
    Tb = w.T[::st]
    fT = w.fs / st
    tT = w.t[::st]
    heat = p.self_heating_k * (1 - np.exp(-np.maximum(tT + age_s(w, log), 0) / p.lag_s))
    Td = lag(Tb, fT, p.lag_s) + heat
    c.Td, c.tT, c.fT = Td, tT, fT
    dT = interpolate(Td, tT[0], fT, t) - 25.0
    c.dT = dT
    g = stream(*key, log, s.name, "slow", alt)
    drift = flicker(g, int((w.dur + 3) * 8), 8.0, p.flicker_floor)
    turn = stream(*key, log, s.name, "turn").normal(0, p.turn_on, 3)
    d = dT[:, None]
    y = y @ (np.eye(3) + p.cross_axis).T
    for x in faults:
        y = x.before(c, y)
    if np.any(p.quadratic):
        y = y + p.quadratic * y * y
    if np.any(p.cubic):
        y = y + p.cubic * s.range * (y / s.range) ** 3
    if s.kind == "gyro":
        y = y + c.force @ p.g_sensitivity.T
    y = y * (1 + p.scale + p.scale_slope * d) + p.bias + turn + p.bias_slope * d * (1 + p.slope_growth * d)
    y += interpolate(drift, -1.5, 8.0, t)
    for x in faults:
        y = x.element(c, y)
    # ---- noise, filter
    n = stream(*key, log, s.name, "noise", alt).standard_normal((len(t), 3))
    sd = p.density if s.kind == "mag" else p.density * np.sqrt(f / 2)
    for x in faults:
        sd = x.noise(c, sd)
    y = y + n * sd
    bw = s.bandwidth
    if s.kind == "mag":
        pass
    elif s.chip == "adxl345":
        if m > 1:
            h = signal.firwin(4 * m + 1, 0.95 / m)
            y = fir(h, y)
    elif s.chip == "bma180":
        if bw < 0.45 * f:
            y = iir(signal.butter(2, bw, fs=f, output="sos"), y)
    elif s.chip == "l3g4200d":
        y = iir(signal.butter(2, L3G_LPF1[int(odr or s.rate_setting)], fs=f, output="sos"), y)
        if s.second_filter:
            y = iir(signal.butter(2, s.bandwidth_setting, fs=f, output="sos"), y)
    else:
        b = bw
        y = iir(signal.butter(2, min(b, 0.45 * f), fs=f, output="sos"), y)
    y, t = y[m - 1 :: m], t[m - 1 :: m]
    c.ty = t
    for x in faults:
        y = x.output(c, y)
    # ---- converter, register
    sens = s.sensitivity
    for x in faults:
        sens = x.sensitivity(c, sens)
    lo, hi = s.limits
    v = np.rint(y * sens)
    code = np.clip(v, lo, hi).astype(np.int32)
    c.real = y * sens
    for x in faults:
        code = x.register(c, code)
    # ---- thermometer
    T = interpolate(Td, tT[0], fT, t)
    gT = stream(*key, log, s.die or s.name, "thermo", alt)
    tc = None
    if s.chip == "bma180":
        tc = np.rint((T - 24 + p.thermometer_zero) * 2 + p.thermometer_noise * gT.standard_normal(len(t)))
        tc = np.clip(tc, -128, 127)
    elif s.chip == "l3g4200d":
        k = np.floor(t + 5.0).astype(int)  # refreshed once a second
        k -= k[0]
        first = np.r_[0, np.flatnonzero(np.diff(k)) + 1]
        x = np.rint(p.thermometer_zero - (T[first] - 25) + p.thermometer_noise * gT.standard_normal(len(first)))
        tc = np.clip(x[np.searchsorted(first, np.arange(len(t)), "right") - 1], -128, 127)
    elif s.chip.startswith("mpu"):
        tc = np.rint(
            (T * p.thermometer_slope + p.thermometer_zero - 36.53) * 340
            + 340 * p.thermometer_noise * gT.standard_normal(len(t))
        )
    for x in faults:
        tc = x.temperature_codes(c, tc)
    c.codes, c.tc = code, tc
    return c


def age_s(w, log):
    """Return for how many seconds the electronics had been on before the log began."""
    return w.marks.get("age", 400.0)


def iir(sos, y):
    """Return `y` behind a recursive filter in its steady state."""
    zi = signal.sosfilt_zi(sos)[:, :, None] * y[:1][None]
    return signal.sosfilt(sos, y, axis=0, zi=zi)[0]


def fir(h, y):
    """Return `y` behind a filter with the coefficients `h`."""
    k = len(h)
    pad = np.repeat(y[:1], k - 1, axis=0)
    return signal.oaconvolve(np.concatenate([pad, y]), h[:, None], mode="valid", axes=0)

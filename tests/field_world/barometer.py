"""The BMP180: its calibration words, its algorithm and the inverse of it."""

from __future__ import annotations

import numpy as np

from tests.field_world.streams import stream


def calibration_words(g):
    """Return the calibration words of one specimen, near those of the data sheet\'s example."""
    base = {
        "AC1": 408,
        "AC2": -72,
        "AC3": -14383,
        "AC4": 32741,
        "AC5": 32757,
        "AC6": 23153,
        "B1": 6190,
        "B2": 4,
        "MB": -32768,
        "MC": -8711,
        "MD": 2868,
    }
    out = dict(base)
    for k, sd in (
        ("AC1", 60),
        ("AC2", 15),
        ("AC3", 60),
        ("AC4", 500),
        ("AC5", 400),
        ("AC6", 800),
        ("MC", 150),
        ("MD", 60),
    ):
        out[k] = int(base[k] + np.clip(g.normal(0, sd), -2 * sd, 2 * sd))
    return out


def compensate(c, ut, up, oss):
    """Return temperature (°C) and pressure (Pa) by the data sheet\'s algorithm."""
    ut = ut.astype(np.int64)
    up = up.astype(np.int64)
    x1 = (ut - c["AC6"]) * c["AC5"] >> 15
    x2 = (c["MC"] << 11) // (x1 + c["MD"])
    b5 = x1 + x2
    T = (b5 + 8) >> 4
    b6 = b5 - 4000
    x1 = c["B2"] * (b6 * b6 >> 12) >> 11
    x3 = x1 + (c["AC2"] * b6 >> 11)
    b3 = (((c["AC1"] * 4 + x3) << oss) + 2) >> 2
    x1 = c["AC3"] * b6 >> 13
    x2 = c["B1"] * (b6 * b6 >> 12) >> 16
    x3 = (x1 + x2 + 2) >> 2
    b4 = c["AC4"] * (x3 + 32768) >> 15
    b7 = (up - b3) * (50000 >> oss)
    pr = np.where(b7 < 0x80000000, 2 * b7 // b4, 2 * (b7 // b4))
    x1 = (pr >> 8) ** 2
    x1 = x1 * 3038 >> 16
    x2 = -7357 * pr >> 16
    return T / 10.0, (pr + ((x1 + x2 + 3791) >> 4)).astype(float)


def raw_codes(c, temperature_c, pressure_pa, oss):
    """Return the codes `ut` and `up` at which the algorithm gives these temperatures and pressures."""
    T, P = temperature_c, pressure_pa
    lo, hi = np.full(len(T), 15000), np.full(len(T), 45000)
    for _ in range(17):
        mid = (lo + hi) // 2
        # finer than 0.1 K: use the float formula
        x1 = (mid - c["AC6"]) * c["AC5"] / 32768
        tt = (x1 + c["MC"] * 2048 / (x1 + c["MD"]) + 8) / 160
        lo, hi = np.where(tt < T, mid, lo), np.where(tt < T, hi, mid)
    ut = hi
    lo, hi = np.full(len(T), 1 << oss), np.full(len(T), 65000 << oss)
    for _ in range(20):
        mid = (lo + hi) // 2
        _t, pp = compensate(c, ut, mid, oss)
        lo, hi = np.where(pp < P, mid, lo), np.where(pp < P, hi, mid)
    return ut, hi


def read_barometer(w, s, key, log, t, alt=0):
    """Return calibration words, codes, temperatures (°C) and pressures (Pa) of a BMP180 at the instants `t`."""
    g = stream(*key, s.name, "part")
    c = calibration_words(g)
    off, toff = np.clip(g.normal(-100, 50), -400, 200), np.clip(g.normal(0, 0.5), -1.5, 1.5)
    n = stream(*key, log, s.name, "noise", alt)
    rms = {0: 6.0, 1: 5.0, 2: 4.0, 3: 3.0}[s.oversampling]
    P = w.at(w.P, t) + off + rms * n.standard_normal(len(t))
    T = w.at(w.T, t) + 0.5 + toff + 0.03 * n.standard_normal(len(t))
    ut, up = raw_codes(c, T, P, s.oversampling)
    Tc, Pc = compensate(c, ut, up, s.oversampling)
    return c, np.stack([ut, up], 1).astype(np.int32), Tc, Pc

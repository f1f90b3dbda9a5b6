"""How large a fault is: its matched statistic in the rows of its sensor, in standard deviations."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tests.field_world.faults import Clipping


def spectrum(n):
    """Return the smoothed two-sided periodogram of a record of noise, by bin."""
    N = len(n)
    P = np.abs(np.fft.rfft(n - n.mean())) ** 2 / N
    edges = np.unique(np.r_[1, np.geomspace(4, len(P), 60).astype(int)])
    x, y = [], []
    for a, e in pairwise(edges):
        if e > a:
            x.append(np.sqrt(a * e))
            y.append(P[a:e].mean())
    S = np.exp(np.interp(np.log(np.arange(1, len(P)) + 0.0), np.log(x), np.log(np.maximum(y, 1e-3))))
    return np.r_[S[0], S]


def matched_statistic(d, n):
    """Return the matched statistic of the difference `d` (rows x 3) in the noise `n`: standard deviations."""
    total = 0.0
    for j in range(3):
        if not np.any(d[:, j]):
            continue
        S = spectrum(n[:, j])
        D = np.abs(np.fft.rfft(d[:, j])) ** 2 / len(d)
        weight = np.full(len(D), 2.0)
        weight[0] = 1.0
        if len(d) % 2 == 0:
            weight[-1] = 1.0
        total += float(np.sum(weight * D / S))
    return np.sqrt(total)


def statistic(readings, worlds, s, fault, others):
    """Return how large a fault is, and how that was computed.

    The rows with and without it are compared, all else equal. The noise comes from a second draw of the part's own
    noise.
    """
    if fault.name == "white_noise":
        N = sum(len(readings.poll(k, w)[0][s.name]) for k, w in enumerate(worlds))
        return abs(fault.size**2 - 1) * np.sqrt(N * len(fault.columns()) / 2), "deflection of the variance"
    if fault.name in ("dropped_samples", "odr_error"):
        return None, "not a difference at equal rows"
    total = 0.0
    for k, w in enumerate(worlds):
        if fault.logs is not None and k not in fault.logs:
            continue
        fault.on = False
        key = ("plain", s.name, k)
        if key not in readings.cache:
            a = readings.read(w, s, k, others)
            b = readings.read(w, s, k, others, alt=1)
            readings.cache[key] = (a["counts"].astype(float), a["real"], (a["counts"] - b["counts"]) / np.sqrt(2))
        codes, real, n = readings.cache[key]
        fault.on = True
        d = readings.read(w, s, k, [*others, fault])
        # a fault before the converter: the difference before rounding (a code that flips is no signal)
        d = d["real"] - real if fault.analogue else d["counts"] - codes
        if fault.name == "quantisation":
            d = d - d.mean(0)
        total += matched_statistic(d, n) ** 2
    return np.sqrt(total), "matched filter, all else known"


def size_faults(readings, worlds):
    """Scale the faults of a case to their targets; return each with its statistic and how that was computed."""
    sized = []
    case = readings.case
    for x in case.faults:
        s = next(s for s in case.sensors if s.name == x.sensor)
        others = [y for y in case.faults if y is not x and y.sensor == x.sensor]
        sd, how = statistic(readings, worlds, s, x, others)
        if x.target and isinstance(x, Clipping):
            # the clipping level at which the statistic is the wanted one: bisection on the codes
            lo, hi = 0.3 * x.size, 2.0 * x.size
            for _ in range(10):
                x.size = float(int(0.5 * (lo + hi)))
                sd, how = statistic(readings, worlds, s, x, others)
                lo, hi = (lo, x.size) if sd < x.target else (x.size, hi)
        elif x.target and x.linear and sd:
            for _ in range(2):
                x.size = float(f"{x.size * x.target / sd:.4g}")
                if x.minimum is not None and abs(x.size) < x.minimum:
                    x.size = float(np.sign(x.size) * x.minimum)
                sd, how = statistic(readings, worlds, s, x, others)
        for key in [key for key in readings.cache if key[0] == "plain"]:
            del readings.cache[key]
        sized.append((x, sd, how))
    return sized

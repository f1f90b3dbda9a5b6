"""What sensors feel besides the box's origin because they sit elsewhere on a turning box (the size effect)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]


def slope(time: Times, triad: Floats) -> Floats:
    """(n, 3) change per second of triads (n, 3): central differences, one-sided at the ends."""
    seconds = (time - time[0]) * 1e-9
    found = np.empty_like(triad)
    found[1:-1] = (triad[2:] - triad[:-2]) / (seconds[2:] - seconds[:-2])[:, None]
    found[0] = (triad[1] - triad[0]) / (seconds[1] - seconds[0])
    found[-1] = (triad[-1] - triad[-2]) / (seconds[-1] - seconds[-2])
    return found


def slopes(time: Times, triads: Floats) -> Floats:
    """(k, n, 3) the same of k windows at times (k, n)."""
    seconds = (time - time[:, :1]) * 1e-9
    found = np.empty_like(triads)
    found[:, 1:-1] = (triads[:, 2:] - triads[:, :-2]) / (seconds[:, 2:] - seconds[:, :-2])[:, :, None]
    found[:, 0] = (triads[:, 1] - triads[:, 0]) / (seconds[:, 1] - seconds[:, 0])[:, None]
    found[:, -1] = (triads[:, -1] - triads[:, -2]) / (seconds[:, -1] - seconds[:, -2])[:, None]
    return found


def lever_arms(time: Times, rate_box: Floats, positions_m: Floats, rows: Floats) -> Floats:
    """(n, m) specific force along axes `rows` (m, 3) at `positions_m` (m, 3) less that at the origin, in m/s2, of a box
    that turns at `rate_box` (n, 3) rad/s: angular acceleration x r + rate x (rate x r). Unknown rates (NaN) count as 0.
    """
    rate = np.nan_to_num(rate_box)
    turning = slope(time, rate)[:, None, :]
    spinning = rate[:, None, :]
    felt = np.cross(turning, positions_m) + np.cross(spinning, np.cross(spinning, positions_m))
    return np.asarray((felt * rows).sum(axis=2))

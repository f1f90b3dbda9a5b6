"""Stretches of a motion: their lengths, their phases, and a smooth transition from one to the next."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.log.format import Phase

FOREVER_NS = 1 << 62
"""A time later than any other: 146 years in ns."""


def nanoseconds(seconds: float) -> int:
    """Return the duration in whole ns."""
    return round(seconds * 1e9)


def positive(**values: float) -> None:
    """Raise ValueError that names the first argument that is not above 0, or whose ns exceed 64 bits."""
    for name, value in values.items():
        if not 0 < value < FOREVER_NS * 1e-9:
            limit = "" if value <= 0 else f" and below {FOREVER_NS * 1e-9:.2g} s"
            raise ValueError(f"{name}: {value}; allowed is anything above 0{limit}")


def finite(**values: float) -> None:
    """Raise ValueError that names the first argument that is not a finite number."""
    for name, value in values.items():
        if not np.isfinite(value):
            raise ValueError(f"{name}: {value}; a finite number is required")


def consecutive(*stretches: tuple[str, int, str]) -> tuple[Phase, ...]:
    """Return phases (name, ns, up) in direct succession, from time 0."""
    edges = np.cumsum([0, *(length_ns for _, length_ns, _ in stretches)]).tolist()
    return tuple(
        Phase(start, end, name, up) for start, end, (name, _, up) in zip(edges[:-1], edges[1:], stretches, strict=True)
    )


class MotionBetweenRests:
    """A motion that begins and ends at rest upright: rest for `still_s`, motion for `_moving_s`, rest again."""

    still_s: float

    @property
    def _moving_s(self) -> float:
        raise NotImplementedError

    @property
    def seconds(self) -> float:
        """The duration: rest, motion, rest."""
        return 2 * self.still_s + self._moving_s

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The phases static, motion, static."""
        still_ns, motion_ns = nanoseconds(self.still_s), nanoseconds(self._moving_s)
        return consecutive(("static", still_ns, "+Z"), ("motion", motion_ns, ""), ("static", still_ns, "+Z"))

    def moved_s(self, time_ns: Integers) -> Reals:
        """Return (n,) the elapsed time of the motion: 0 at rest before it, `_moving_s` at rest after it."""
        return np.clip(time_ns - nanoseconds(self.still_s), 0, nanoseconds(self._moving_s)) * 1e-9


def smooth_step(share: Reals) -> tuple[Reals, Reals, Reals, Reals]:
    """Return a step: 0 up to share 0, 1 from share 1 on, x^4 (35 - 84 x + 70 x^2 - 20 x^3) in between; and its three
    derivatives. It is the polynomial of least degree whose first three derivatives vanish at both ends, so that
    accelerations and their derivatives begin and end without a jump.
    """
    x = np.clip(share, 0.0, 1.0)
    u = x * (1 - x)
    slope = 140 * u**3
    bend = 420 * u**2 * (1 - 2 * x)
    return x**4 * (35 + x * (-84 + x * (70 - 20 * x))), slope, bend, 840 * u * (1 - 5 * u)


def smooth_step_area(share: Reals) -> Reals:
    """Return the integral of `smooth_step` from 0 to `share`."""
    x = np.clip(share, 0.0, 1.0)
    area: Reals = x**5 * (7 + x * (-14 + x * (10 - 2.5 * x))) + np.maximum(share - 1, 0.0)
    return area

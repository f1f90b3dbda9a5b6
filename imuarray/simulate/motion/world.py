"""A motion as the world of an emulated array: asked for one instant after the other, in plain numbers."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from imuarray.log.format import Phase
from imuarray.simulate.motion.felt import Motion

Triple = tuple[float, float, float]


class Stimulus(NamedTuple):
    """The stimulus of the box at one instant, in the box frame: specific force in m/s2, angular rate in rad/s,
    temperature, air pressure, magnetic flux density in gauss.
    """

    force_box: Triple
    rate_box: Triple
    temperature_degc: float
    pressure_pa: float
    field_box: Triple


@runtime_checkable
class Steady(Protocol):
    """A motion that knows when nothing changes."""

    def unchanged_until_ns(self, at_ns: int) -> int:
        """Return the time up to which the stimulus of `at_ns` stays the same, exclusive; `at_ns` itself if it is
        changing.
        """


class World:
    """A callable ``at_ns -> Stimulus`` that shows what `motion` shows, exactly.

    While a motion is `Steady`, and for repeated calls at one instant, the same object is given again at the cost of a
    comparison.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self._since_ns = self._until_ns = 0
        self._shown: Stimulus | None = None

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The motion's."""
        return self.motion.phases

    def __call__(self, at_ns: int) -> Stimulus:
        """Return what the box senses at `at_ns`."""
        if self._shown is not None and self._since_ns <= at_ns < self._until_ns:
            return self._shown
        until_ns = self.motion.unchanged_until_ns(at_ns) if isinstance(self.motion, Steady) else at_ns
        self._since_ns, self._until_ns = at_ns, max(until_ns, at_ns + 1)
        self._shown = _one_instant(self.motion, at_ns)
        return self._shown


def _one_instant(motion: Motion, at_ns: int) -> Stimulus:
    felt = motion.felt(np.array([at_ns], np.int64))
    vectors = (felt.force_box, felt.rate_box, felt.field_box)
    force, rate, field = ((x, y, z) for x, y, z in (vector[0].tolist() for vector in vectors))
    return Stimulus(force, rate, float(felt.temperature_degc[0]), float(felt.pressure_pa[0]), field)

"""A simulated motion as the world of an emulated array."""

from __future__ import annotations

import numpy as np

from firmware_emulator.world import WorldStimulus
from imuarray.log.format import Phase
from imuarray.simulate.motion.stimulus import Motion


class MotionWorld:
    """A callable ``at_ns -> WorldStimulus`` with exactly the values of `motion`. The same object is returned while
    the instant is the same.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self._at_ns: int | None = None
        self._stimulus = WorldStimulus()

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases of the motion."""
        return self.motion.phases

    def __call__(self, at_ns: int) -> WorldStimulus:
        """Return the stimulus of the box at `at_ns`."""
        if at_ns != self._at_ns:
            stimulus = self.motion.stimulus(np.array([at_ns], np.int64))
            vectors = (stimulus.force_box, stimulus.rate_box, stimulus.field_box)
            force, rate, field = ((x, y, z) for x, y, z in (vector[0].tolist() for vector in vectors))
            self._stimulus = WorldStimulus(
                force, rate, float(stimulus.temperature_degc[0]), float(stimulus.pressure_pa[0]), field
            )
            self._at_ns = at_ns
        return self._stimulus

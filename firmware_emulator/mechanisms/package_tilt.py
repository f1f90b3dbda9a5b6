"""The package floated on its solder and froze askew."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.attitude import seen_after_turn
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class PackageTilt(SensorMechanism):
    """A package that is turned by `tilt_deg` about an axis of the part's own (Rodrigues). Reference: 2 degrees."""

    tilt_deg: float = 2.0

    resembles: ClassVar[tuple[str, ...]] = ("misalignment",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """A larger tilt."""
        return cls(tilt_deg=cls.tilt_deg * severity)

    def put_on(self, site: Site) -> None:
        """Force, rate and field alike."""
        x, y, z = site.direction("tilt")
        length = math.sqrt(x * x + y * y + z * z)
        axis = x / length, y / length, z / length
        cosine, sine = math.cos(math.radians(self.tilt_deg)), math.sin(math.radians(self.tilt_deg))
        site.chain.felt.append(Rotation(axis, cosine, sine))


class Rotation:
    """stimulus -> stimulus, seen after a turn about `axis`; a box at rest goes on feeling the very same object."""

    def __init__(self, axis: tuple[float, float, float], cosine: float, sine: float) -> None:
        self._turn = axis, cosine, sine
        self._before: Stimulus | None = None
        self._after = Stimulus()

    def __call__(self, at_ns: int, stimulus: Stimulus) -> Stimulus:
        """The same object as long as `stimulus` is."""
        if stimulus is not self._before:
            self._before = stimulus
            self._after = stimulus._replace(
                force_box=seen_after_turn(stimulus.force_box, *self._turn),
                rate_box=seen_after_turn(stimulus.rate_box, *self._turn),
                field_box=seen_after_turn(stimulus.field_box, *self._turn),
            )
        return self._after

"""What every mechanism is: physical parameters, where it can act, and what it does to a board."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from firmware_emulator.mechanisms.site import INERTIAL, Site

if TYPE_CHECKING:
    from firmware_emulator.array import SensorLike
    from firmware_emulator.mechanisms.fitted import FittedBoard


@dataclass(frozen=True)
class Mechanism(ABC):
    """Physical parameters of one cause of difference; a subclass says in SI or data sheet units what they mean.

    `touches` are the chips on which it can be put, `place` how many sensors it takes: "sensor" (any number), "pair"
    (two of one chip), "design" (all of one chip), "host" (the whole array). `resembles` names the effects that a
    diagnosis may rightly call it, none if there is no name for it.
    """

    touches: ClassVar[tuple[str, ...]] = INERTIAL
    place: ClassVar[str] = "sensor"
    resembles: ClassVar[tuple[str, ...]] = ()

    @classmethod
    @abstractmethod
    def at(cls, severity: float) -> Self:
        """The mechanism at `severity` times its reference size, which the defaults state."""

    @abstractmethod
    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Put it to work on these sensors of the board."""

    def wherever(self, sensors: Sequence[SensorLike]) -> tuple[str, ...]:
        """Where it goes when nobody says: all on which it can be put; of a design, those of the commonest chip."""
        touched = [sensor for sensor in sensors if sensor.chip in self.touches]
        if self.place == "design":
            ((chip, _),) = Counter(sensor.chip for sensor in touched).most_common(1) or [("", 0)]
            touched = [sensor for sensor in touched if sensor.chip == chip]
        return tuple(sensor.name for sensor in touched)


@dataclass(frozen=True)
class SensorMechanism(Mechanism):
    """One that acts on every sensor by itself."""

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """On each sensor in turn."""
        for site in sites:
            self.put_on(site)

    @abstractmethod
    def put_on(self, site: Site) -> None:
        """Put it to work on one sensor."""

"""The description of an array as the emulator needs it: protocols that `imuarray.array` satisfies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from firmware_emulator.element import Matrix


class MuxLike(Protocol):
    """A multiplexer in the description of an array."""

    @property
    def chip(self) -> str:
        """The chip: only "pca9544a"."""

    @property
    def address(self) -> int:
        """The address on the trunk."""


class SensorLike(Protocol):
    """A sensor in the description of an array."""

    @property
    def name(self) -> str:
        """The name, unique in the array."""

    @property
    def chip(self) -> str:
        """A key of `CHIPS`."""

    @property
    def channel(self) -> int | None:
        """The channel of the multiplexer; None for one on a trunk."""

    @property
    def bus(self) -> str | None:
        """Another trunk than the array's own: a channel that the kernel drives."""

    @property
    def address(self) -> int:
        """Seven bits."""

    @property
    def range(self) -> float | None:
        """Full scale in g, dps or gauss; None for a chip without."""

    @property
    def orientation(self) -> Matrix:
        """box = orientation @ sensor."""


class ArrayLike(Protocol):
    """The description of an array."""

    @property
    def name(self) -> str:
        """ "martin2013" for the paper's, whose units are known."""

    @property
    def mux(self) -> MuxLike | None:
        """The multiplexer on the trunk, if any."""

    @property
    def sensors(self) -> Sequence[SensorLike]:
        """Every chip."""

"""`channel_swap`: the sensor delivers the data of another sensor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect
from imuarray.simulate.signal import Codes, Place

KINDS = ("data", "counts", "place")


@dataclass(frozen=True)
class ChannelSwap(Effect):
    """The readings are those of the sensor named by `sensor`; "" for the sensor itself. `kind` says how this happens.

    "data": each row holds the data of the other sensor. Counts, temperature and freshness are those of the other chip;
    range, sensitivity and axes remain as configured. A multiplexer that switches one transaction late causes this
    (PCA-06). In data: a sensor with the bias, noise and axes of its neighbour; two sensors with the same noise.

    "place": the sensor is mounted at the position and in the orientation of the other one. Exchanged plugs or
    multiplexer channels cause this: the chip at that place is set up and read as this sensor. In data: a sensor with
    the axes and the distance from the origin of its neighbour. An exchange needs two of these effects, one for each
    sensor.
    """

    name: ClassVar[str] = "channel_swap"
    sensor: str = field(default="")
    kind: str = field(default="data")

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown kind."""
        super().__post_init__()
        if self.kind not in KINDS:
            raise ValueError(f"kind: {self.kind!r}; allowed are {', '.join(KINDS)}")

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Return the rows of the other sensor; ValueError if there is no such sensor, naming those of the array."""
        if self.sensor in ("", at.sensor.name) or self.kind == "place":
            return codes
        try:
            neighbour = at.neighbour(self.sensor, codes.first, codes.first + len(codes.counts))
        except KeyError as error:
            raise ValueError(f"channel_swap of {at.sensor.name}: {error.args[0]}") from None
        if self.kind == "counts":
            return replace(codes, counts=neighbour.counts)
        temperature = codes.temperature_counts if neighbour.temperature_counts is None else neighbour.temperature_counts
        degrees = None if codes.temperature_counts is None else temperature
        return replace(codes, counts=neighbour.counts, temperature_counts=degrees, fresh=neighbour.fresh)

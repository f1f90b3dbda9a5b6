"""`channel_swap`: the sensor delivers the data of another sensor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect
from imuarray.simulate.signal import Codes, Place

KINDS = ("data", "place")


@dataclass(frozen=True)
class ChannelSwap(Effect):
    """The readings are those of `sensor`; "" for one's own. `kind` is how they come to be.

    "data": row for row the other's. Counts, temperature and freshness are as its chip delivers them; range, sensitivity
    and axes stay what the configuration says of this one. A switch that became active one transaction late does it
    (PCA-06). In data: a sensor with its neighbour's bias, noise and axes; two sensors whose noise is the same.

    "place": what is read here sits where the other is said to sit, and lies as that one. Plugs or channels of a
    multiplexer that are exchanged do it: what was there is set up and read as this one, and known by its name. In data:
    a sensor with its neighbour's axes and distance from the origin. An exchange takes two of these effects, one for
    each.
    """

    name: ClassVar[str] = "channel_swap"
    sensor: str = field(default="")
    kind: str = field(default="data")

    def __post_init__(self) -> None:
        """ValueError for another kind."""
        super().__post_init__()
        if self.kind not in KINDS:
            raise ValueError(f"kind: {self.kind!r}; allowed are {', '.join(KINDS)}")

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Takes the other's rows; ValueError when there is no such sensor, naming those there are."""
        if self.sensor in ("", at.sensor.name) or self.kind != "data":
            return codes
        try:
            other = at.neighbour(self.sensor, codes.first, codes.first + len(codes.counts))
        except KeyError as error:
            raise ValueError(f"channel_swap of {at.sensor.name}: {error.args[0]}") from None
        temperature = codes.temperature_counts if other.temperature_counts is None else other.temperature_counts
        kept = None if codes.temperature_counts is None else temperature
        return replace(codes, counts=other.counts, temperature_counts=kept, fresh=other.fresh)

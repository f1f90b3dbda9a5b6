"""`channel_swap`: the data of another sensor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from imuarray.simulate.effect import Effect
from imuarray.simulate.signal import Codes, Place


@dataclass(frozen=True)
class ChannelSwap(Effect):
    """The readings are those of `sensor`, row for row; "" for one's own.

    Counts, temperature and freshness are the other's as its chip delivers them; range, sensitivity and axes stay what
    the configuration says of this one. Two channels of a multiplexer exchanged in the configuration do it, or a switch
    that became active one transaction late (PCA-06). In data: a sensor with its neighbour's bias, noise and axes; two
    sensors whose noise is the same. An exchange takes two of these effects, one for each.
    """

    name: ClassVar[str] = "channel_swap"
    sensor: str = field(default="")

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Takes the other's rows; ValueError when there is no such sensor, naming those there are."""
        if self.sensor in ("", at.sensor.name):
            return codes
        try:
            other = at.neighbour(self.sensor, codes.first, codes.first + len(codes.counts))
        except KeyError as error:
            raise ValueError(f"channel_swap of {at.sensor.name}: {error.args[0]}") from None
        temperature = codes.temperature_counts if other.temperature_counts is None else other.temperature_counts
        kept = None if codes.temperature_counts is None else temperature
        return replace(codes, counts=other.counts, temperature_counts=kept, fresh=other.fresh)

"""The multiplexer acknowledges its order and does not switch, for once: twins on the other channel answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from firmware_emulator.element import stream
from firmware_emulator.mechanisms.line import Codes, Latch
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism
from firmware_emulator.mechanisms.site import WHILE_SET_UP_S, Site

if TYPE_CHECKING:
    from firmware_emulator.description import SensorLike


@dataclass(frozen=True)
class MuxHang(Mechanism):
    """A `share` of the orders is not obeyed; who has no twin at his address on the other channel is not acknowledged,
    the others are answered for, and those are its sensors in the truth. Begins `WHILE_SET_UP_S` after power-on.
    Reference: 0.5 % of the orders.
    """

    share: float = 0.005

    place: ClassVar[str] = "host"
    resembles: ClassVar[tuple[str, ...]] = ("channel_swap", "glitches")

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one that acts more often."""
        return cls(share=min(0.5, cls.share * severity))

    def wherever(self, sensors: Sequence[SensorLike]) -> tuple[str, ...]:
        """Return the sensors that have a twin: the same chip at the same address of another channel."""
        places = Counter((sensor.chip, sensor.address) for sensor in sensors if sensor.channel is not None)
        touched = [sensor for sensor in sensors if sensor.chip in self.touches]
        return tuple(sensor.name for sensor in touched if places[sensor.chip, sensor.address] > 1)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Act at the STOP of an order."""
        random, begin_ns = stream(board.seed, f"multiplexer, run {board.run}"), round(WHILE_SET_UP_S * 1e9)

        def obeys(at_ns: int) -> bool:
            if at_ns < begin_ns or random.random() >= self.share:
                return True
            board.notes.append(f"multiplexer hung at {at_ns * 1e-9:.3f} s")
            return False

        board.host.obeys.append(obeys)
        touched = board.touched.setdefault(self, set())
        for site in sites:
            site.links.latches.append(_answers(board, site, touched))


def _answers(board: FittedBoard, site: Site, touched: set[str]) -> Latch:
    """Readings of the site as they are; whoever they pass for while the switch is astray is `touched`."""
    own = board.sensors[site.name]
    twins = {
        config.channel: name
        for name, config in board.sensors.items()
        if (config.address, config.chip) == (own.address, own.chip) and config.channel is not None
    }

    def passed(at_ns: int, codes: Codes) -> Codes:
        if board.host.mux is not None and board.host.mux.astray_for in twins:
            touched.add(twins[board.host.mux.astray_for])
        return codes

    return passed

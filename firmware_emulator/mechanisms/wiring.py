"""Contacts, cables and the multiplexer."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from firmware_emulator.element import stream
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism, SensorMechanism
from firmware_emulator.mechanisms.site import WHILE_SET_UP_S, Codes, Latch, Site
from firmware_emulator.world import WorldStimulus

if TYPE_CHECKING:
    from firmware_emulator.board import SensorLike


@dataclass(frozen=True)
class CableBitErrors(SensorMechanism):
    """A cable that is too long for its pull-ups: the adapter sometimes samples a bit on the edge.

    Every bit that the chip sends is inverted with probability `per_bit`; acknowledges do not detect this.

    I2C has no checksum. Only bytes from the chip are affected: the adapter drives its own bits more strongly. It begins
    `WHILE_SET_UP_S` after power-on. Reference: 1e-5, about one in 2000 readings.
    """

    per_bit: float = 1e-5

    resembles: ClassVar[tuple[str, ...]] = ("glitches",)
    scaled: ClassVar[tuple[str, ...]] = ("per_bit",)
    largest: ClassVar[float] = 0.5

    def put_on(self, site: Site) -> None:
        """Invert bits of the received bytes."""
        random = site.run_random("bits")
        gap = int(random.geometric(self.per_bit))
        begin_ns = round(WHILE_SET_UP_S * 1e9)

        def cable(at_ns: int, sent: bytes) -> bytes:
            nonlocal gap
            if at_ns < begin_ns:
                return sent
            bits, received = 8 * len(sent), bytearray(sent)
            while gap <= bits:
                received[(gap - 1) // 8] ^= 0x80 >> (gap - 1) % 8
                gap += int(random.geometric(self.per_bit))
            gap -= bits
            return bytes(received)

        site.links.cables.append(cable)


@dataclass(frozen=True)
class LooseContact(SensorMechanism):
    """A loose plug: the chip is disconnected for short times.

    The contact is closed for `closed_s` on average and then open for `open_s` on average, both exponentially
    distributed (Gilbert 1960).

    No message is acknowledged while it is open. It begins `WHILE_SET_UP_S` after power-on. Reference: 50 ms in every 10
    s.
    """

    open_s: float = 0.05
    closed_s: float = 10.0

    resembles: ClassVar[tuple[str, ...]] = ("dropped_samples",)
    scaled: ClassVar[tuple[str, ...]] = ("open_s",)

    def put_on(self, site: Site) -> None:
        """Interrupt messages to the chip."""
        random = site.run_random("contact")
        is_open, due_ns = False, (WHILE_SET_UP_S + random.exponential(self.closed_s)) * 1e9

        def closed(at_ns: int) -> bool:
            nonlocal is_open, due_ns
            while at_ns >= due_ns:
                is_open = not is_open
                due_ns += random.exponential((self.open_s if is_open else self.closed_s) * 1e9)
            return not is_open

        site.links.contacts.append(closed)


@dataclass(frozen=True)
class MuxHang(Mechanism):
    """The multiplexer sometimes acknowledges a command without switching: a sensor with the same address on the other
    channel answers.

    A `share` of the commands has no effect. A sensor without a twin at its address on the connected channel then does
    not acknowledge; for a sensor with a twin, the twin answers. The truth names the sensors that have a twin. It begins
    `WHILE_SET_UP_S` after power-on. Reference: 0.5 % of the commands.
    """

    share: float = 0.005

    place: ClassVar[str] = "host"
    resembles: ClassVar[tuple[str, ...]] = ("channel_swap", "glitches")
    scaled: ClassVar[tuple[str, ...]] = ("share",)
    largest: ClassVar[float] = 0.5

    def wherever(self, sensors: Sequence[SensorLike]) -> tuple[str, ...]:
        """Return the sensors that have a twin: the same chip at the same address on another channel."""
        places = Counter((sensor.chip, sensor.address) for sensor in sensors if sensor.channel is not None)
        touched = [sensor for sensor in sensors if sensor.chip in self.touches]
        return tuple(sensor.name for sensor in touched if places[sensor.chip, sensor.address] > 1)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Ignore commands at their STOP, and note the affected sensors."""
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
    """Return a latch that does not change readings. If it is read while the switch hangs, it adds the sensor that
    should have been read to `touched`.
    """
    own_sensor = board.sensors[site.name]
    twins = {
        config.channel: name
        for name, config in board.sensors.items()
        if (config.address, config.chip) == (own_sensor.address, own_sensor.chip) and config.channel is not None
    }

    def passed(at_ns: int, codes: Codes) -> Codes:
        if board.host.mux is not None and board.host.mux.astray_for in twins:
            touched.add(twins[board.host.mux.astray_for])
        return codes

    return passed


LONG_AGO_NS = -(1 << 62)


@dataclass(frozen=True)
class MuxCrosstalk(Mechanism):
    """Switching of the multiplexer disturbs the supply: conversions shortly after it have an error.

    error = k exp(-t / `decay_ms`), t since the last switching, k is `kick_g` or `kick_dps`, averaged over the axes.

    It affects sensors that are read early in a segment, in frames in which the multiplexer switches to this segment.
    Reference: 20 mg or 0.6 dps, 2 ms.
    """

    kick_g: float = 20e-3
    kick_dps: float = 0.6
    decay_ms: float = 2.0
    scaled: ClassVar[tuple[str, ...]] = ("kick_g", "kick_dps")

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Connect every site to the multiplexer."""
        switched_ns = LONG_AGO_NS

        def switched(at_ns: int) -> None:
            nonlocal switched_ns
            switched_ns = at_ns

        def decay(at_ns: int, stimulus: WorldStimulus) -> float:
            since_ms = (at_ns - switched_ns) * 1e-6
            return math.exp(-since_ms / self.decay_ms) if since_ms >= 0 else 0.0

        board.host.switched.append(switched)
        for site in sites:
            site.add("kick", self.kick_g, self.kick_dps, decay)

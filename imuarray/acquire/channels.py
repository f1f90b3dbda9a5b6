"""Is the channel connected that was asked for? Chips that share an address would answer for each other without a word.

A multiplexer whose order is lost leaves the old channel connected. Where a chip has a twin, the same address on another
channel, its reading is believed only when a witness was heard after it, in the same visit: a register whose configured
value differs between the twins, or a chip that has no twin. `mark_twins` makes twins differ that are configured alike.
Where nothing can witness, the multiplexer's control byte is read back, which does not show a switch that is stuck.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from imuarray.bus.mux import MuxChannel
from imuarray.facts import pca9544a
from imuarray.facts.registers import Setting

if TYPE_CHECKING:
    from imuarray.acquire.sensor_routes import SensorRoute


class Witness(NamedTuple):
    """One register of one chip, and what it would read on the other channels: nothing where the chip has no twin."""

    route: SensorRoute
    setting: Setting
    others: frozenset[int]


class Channel:
    """One channel of a multiplexer, and who on it can tell that it is connected; `twins` have a twin elsewhere.

    The registers that can tell are asked in turn, at most `limit` of them, so that this is also a look at whether they
    are as configured: `seen` is the one that was right last time, `doubted` one that answered and was not.
    """

    def __init__(
        self, bus: MuxChannel, here: Sequence[SensorRoute], everywhere: Sequence[SensorRoute], limit: int
    ) -> None:
        self._mux = bus.mux
        self._order = (pca9544a.ENABLE(1) | pca9544a.CHANNEL(bus.number)).value
        self.twins = [route for route in here if twins_of(route, everywhere)]
        found = [witness for route in here for witness in _witnesses(route, everywhere)]
        self.witnesses = sorted(found, key=lambda witness: not witness.others)[:limit]  # a register tells most
        self.seen: Witness | None = None
        self.doubted: Witness | None = None
        self._turn = 0

    def right(self) -> bool:
        """Ask the next witness; if it doesn't say yes, the multiplexer's control byte and the other witnesses.

        A chip that was reset or is gone says neither yes nor no: it can't make a right channel wrong.
        """
        self.seen = self.doubted = None
        if self.witnesses:
            self._turn = (self._turn + 1) % len(self.witnesses)
            if self._hear(self.witnesses[self._turn]):
                return True
        if not self._read_back():
            return False
        for witness in self.witnesses:
            verdict = self._hear(witness)
            if verdict is not None:
                return verdict
        return True

    def _hear(self, witness: Witness) -> bool | None:
        """Yes, no, or None from a chip that is silent or reads neither what it should nor what its twin does."""
        registers, setting = witness.route.driver.registers, witness.setting
        try:
            register = setting.register
            block = self._mux.bus.transfer(registers.address, bytes([register.address]), register.readback_bytes)
            found = block[0] & setting.mask
        except OSError:
            return None
        if found == setting.value:
            self.seen = witness
            return True
        if found in witness.others:
            return False
        self.doubted = witness
        return None if witness.others else True

    def _read_back(self) -> bool:
        """Does the multiplexer's control byte say this channel?"""
        try:
            control = self._mux.bus.transfer(self._mux.address, read=1)[0]
        except OSError:
            return False
        return control & (pca9544a.ENABLE.mask | pca9544a.CHANNEL.mask) == self._order

    def forget(self) -> None:
        """Select anew before the next transaction."""
        self._mux.selected = None


def channel_of(here: Sequence[SensorRoute], everywhere: Sequence[SensorRoute], limit: int) -> Channel | None:
    """The channel of these routes, if anybody on it could be taken for somebody else."""
    bus = here[0].driver.registers.bus
    channel = Channel(bus, here, everywhere, limit) if isinstance(bus, MuxChannel) else None
    return channel if channel is not None and channel.twins else None


def twins_of(route: SensorRoute, everywhere: Iterable[SensorRoute]) -> list[SensorRoute]:
    """Stations at the same address of other channels."""
    if not isinstance(route.driver.registers.bus, MuxChannel):
        return []
    return [
        other
        for other in everywhere
        if other.segment != route.segment
        and isinstance(other.driver.registers.bus, MuxChannel)
        and other.sensor.address == route.sensor.address
    ]


def mark_twins(routes: Sequence[SensorRoute]) -> None:
    """Make twins that are configured alike differ in a register on which nothing depends; before they are set up."""
    alike: dict[int, SensorRoute] = {}
    for route in routes:
        twins = twins_of(route, routes)
        if twins and not _witnesses(route, routes):
            alike.update((id(one), one) for one in (route, *twins))
    for route in alike.values():
        route.driver.mark(int(route.segment or 0) + 1)


def _witnesses(route: SensorRoute, everywhere: Sequence[SensorRoute]) -> list[Witness]:
    """The watched registers in which this chip differs from all its twins, also after one of them was reset; all of
    them if it has none.
    """
    twins = twins_of(route, everywhere)
    found = []
    for setting in route.driver.watched:
        theirs = [
            {other.value for other in twin.driver.watched if other.register == setting.register}
            for twin in twins
            if twin.sensor.chip == route.sensor.chip
        ]
        mine = {setting.value, setting.register.reset & setting.mask}
        if len(theirs) == len(twins) and all(values and not values & mine for values in theirs):
            found.append(Witness(route, setting, frozenset().union(*theirs)))
    return found

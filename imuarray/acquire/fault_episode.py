"""Episodes of faults, reported by two events: one when an episode begins, one with count and duration when it is over.

An intermittent fault is one episode as well: each time it recurs soon, it must be absent for longer before the episode
ends. The number of events is therefore limited however long a fault persists: with quiet times of 1, 2, ... 512 and
then 900 seconds between its episodes, no more than 14 episodes of one kind begin in an hour.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from functools import partial
from types import MappingProxyType

from imuarray.log.format import Event
from imuarray.log.rotate import Writer

QUIET_NS = 1_000_000_000
"""Time in ns within which a fault that recurs belongs to the same episode. It doubles whenever the fault recurs later
than this, but within `RELAPSE_NS`.
"""
LONGEST_QUIET_NS = 900_000_000_000
RELAPSE_NS = 3_600_000_000_000

Report = Callable[[int, str, str], None]
"""Arguments: at_ns, kind, message."""
SensorReport = Callable[[str, int, str, str], None]
"""Arguments: sensor, at_ns, kind, message."""

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "lost": "readings lost",
        "stale": "readings",
        "late": "frames missed",
        "channel": "times",
        "link": "attempts",
        "refused": "refused",
    }
)
"""The unit that is counted, by kind; "times" for all other kinds."""


class FaultEpisode:
    """The episodes of one kind of fault of one sensor; `report` receives the events.

    Use `happened` for faults that recur and are over when they no longer occur, `begin` and `end` for faults that
    last. A fault that occurred once has no event for its end.
    """

    def __init__(self, kind: str, unit: str, report: Report) -> None:
        self.kind = kind
        self.is_open = False
        self.count = 0
        self.last_ns = 0
        self._unit = unit
        self._report = report
        self._since_ns = 0
        self._quiet_ns = QUIET_NS
        self._ended_ns: int | None = None
        self._lasts = False
        self._end = ""
        self._reported = False

    def happened(self, at_ns: int, message: str, count: int = 1, until_ns: int | None = None) -> None:
        """Note an occurrence at `at_ns`, the first or a later one; `count` of them until `until_ns`."""
        if not self.is_open:
            self.is_open, self._since_ns, self.last_ns = True, at_ns, at_ns
            relapse = self._ended_ns is not None and at_ns - self._ended_ns <= RELAPSE_NS
            self._quiet_ns = min(2 * self._quiet_ns, LONGEST_QUIET_NS) if relapse else QUIET_NS
            self._report(at_ns, self.kind, message)
        self.count += count
        self.last_ns = max(self.last_ns, at_ns if until_ns is None else until_ns)
        self._end, self._reported = "", False

    @property
    def lasts(self) -> bool:
        """True between `begin` and `end`."""
        return self._lasts

    def begin(self, at_ns: int, message: str) -> None:
        """Begin a lasting episode, until `end`."""
        self.happened(at_ns, message)
        self._lasts = True

    def end(self, at_ns: int, message: str = "", *, reported: bool = False) -> None:
        """End a lasting episode. Its end is reported at once, or after a quiet time if the fault recurs; not at all if
        the fault occurred once and another event has `reported` its end.
        """
        self._lasts, self._reported = False, reported
        if self.is_open:
            self.last_ns, self._end = max(self.last_ns, at_ns), message
            if self._quiet_ns <= QUIET_NS:
                self._close()

    def settle(self, now_ns: int) -> None:
        """Report the end if it has not occurred for long enough."""
        if self.is_open and not self._lasts and now_ns - self.last_ns > self._quiet_ns:
            self._close()

    def close(self, now_ns: int) -> None:
        """End the episode with the log."""
        if self._lasts:
            self._lasts, self.last_ns, self._end, self._reported = (
                False,
                now_ns,
                "still present when the log ended",
                False,
            )
        if self.is_open:
            self._close()

    def _close(self) -> None:
        lasted_ns = self.last_ns - self._since_ns
        if (self._end or lasted_ns > 0) and not (self._reported and self.count == 1):
            lasted = f"in {lasted_ns * 1e-9:.1f} s"
            text = f"in all {self.count} {self._unit} {lasted}"
            if self._end:
                text = f"{self._end}, {text}" if self.count > 1 else f"{self._end}, {lasted.replace('in', 'after')}"
            self._report(self.last_ns, self.kind, text)
        self.is_open, self.count, self._end = False, 0, ""
        self._ended_ns = self.last_ns


def event_writer(log: Writer, epoch_ns: int, on_event: Callable[[Event], None]) -> SensorReport:
    """Return the function that writes an event of a sensor ("": of the array) into a log that began at `epoch_ns`, and
    passes it to `on_event`.
    """

    def note(sensor: str, at_ns: int, kind: str, message: str) -> None:
        event = Event(at_ns - epoch_ns, sensor, kind, message)
        log.event(event)
        on_event(event)

    return note


class FaultEpisodes:
    """All fault episodes of a recording; `report` receives their events."""

    def __init__(self, report: SensorReport) -> None:
        self._report = report
        self._episodes: dict[tuple[str, str, Hashable], FaultEpisode] = {}

    def episode(self, sensor: str, kind: str, instance: Hashable = None) -> FaultEpisode:
        """Return the episode of this kind of `sensor` ("": the array); `instance` distinguishes several of a kind."""
        key = sensor, kind, instance
        if key not in self._episodes:
            self._episodes[key] = FaultEpisode(kind, UNITS.get(kind, "times"), partial(self._report, sensor))
        return self._episodes[key]

    def note(self, at_ns: int, kind: str, message: str) -> None:
        """Note an event of the array as a whole."""
        self.episode("", kind).happened(at_ns, message)

    def settle(self, now_ns: int) -> None:
        """See `FaultEpisode.settle`."""
        for episode in self._episodes.values():
            episode.settle(now_ns)

    def close(self, now_ns: int) -> None:
        """See `FaultEpisode.close`."""
        for episode in self._episodes.values():
            episode.close(now_ns)

"""Start-up states of sensors: the rows of the first seconds wait until a `Judge`, which knows the states, has given a
verdict.

Some chips start with a different bias each time (the paper's Gyro3 has two), or in another range, and do not report it.
The states of a sensor are in its calibration, which this package does not read; the judge does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy.typing as npt

from imuarray.acquire.sample_buffer import SampleBuffer

SECONDS = 10.0
FEWEST_READINGS = 10
"""The mean of fewer readings is too uncertain: noise could look like another state."""
ATTEMPTS = 3
"""Most attempts to configure a sensor that started wrong; after them, none of its readings are trusted."""


class StateVerdict(NamedTuple):
    """A verdict on a sensor's start: `fault` if its readings can't be used, and a sentence (or "")."""

    fault: bool
    text: str = ""


class StartVerdict(Protocol):
    """A verdict on one sensor, as `StateVerdict`."""

    @property
    def fault(self) -> bool:
        """True if its readings can't be used."""

    @property
    def text(self) -> str:
        """A sentence for the events, or "" if there is nothing to say."""


Judge = Callable[[Mapping[str, npt.NDArray[Any]]], Mapping[str, StartVerdict]]
"""Function from the counts (n, 3) of the sensors' first seconds to verdicts by name; none for sensors that can't be
judged.
"""


class StartUpCheck:
    """The sensors whose start-up state is not judged yet."""

    def __init__(self, buffers: Sequence[SampleBuffer], judge: Judge, now_ns: int) -> None:
        self._judge = judge
        self._since_ns = {id(item): now_ns for item in buffers if item.route.sensor.sensitivity}
        self._attempts: dict[int, int] = {}
        self._buffers = [item for item in buffers if id(item) in self._since_ns]

    def holds(self, buffer: SampleBuffer) -> bool:
        """Return whether the rows of this sensor must wait."""
        return id(buffer) in self._since_ns

    def again(self, buffer: SampleBuffer, now_ns: int) -> None:
        """Judge a sensor again after it was configured again because of a wrong start-up state."""
        if id(buffer) in self._attempts:
            self._since_ns[id(buffer)] = now_ns

    def verdicts(self, now_ns: int, *, last: bool = False) -> list[tuple[SampleBuffer, StartVerdict]]:
        """Return the verdicts on sensors whose first seconds are over (or all, at the end of the log, `last`)."""
        ripe = [
            item
            for item in self._buffers
            if self.holds(item)
            and (last or now_ns - self._since_ns[id(item)] >= SECONDS * 1e9)
            and (last or item.recovery is None)
        ]
        heard = {item.route.sensor.name: item.counts() for item in ripe if item.times_ns}
        readings = {name: counts for name, counts in heard.items() if len(counts) >= FEWEST_READINGS}
        verdicts = dict(self._judge(readings)) if readings else {}
        for name in heard.keys() - readings.keys():
            verdicts[name] = StateVerdict(
                False, f"not checked: {len(heard[name])} readings of at least {FEWEST_READINGS}"
            )
        judged = [(item, verdicts.get(item.route.sensor.name, StateVerdict(False))) for item in ripe]
        for item, verdict in judged:
            del self._since_ns[id(item)]
            if verdict.fault:
                self._attempts[id(item)] = self._attempts.get(id(item), 0) + 1
        return judged

    def has_given_up(self, buffer: SampleBuffer) -> bool:
        """Return whether all attempts to configure the sensor are used up."""
        return self._attempts.get(id(buffer), 0) >= ATTEMPTS

"""Recovers a sensor, one step per frame during its own visits, so that no other sensor waits for it.

The steps are: read its identity, at growing intervals while it does not answer; compare its configuration with the
intended one; if they differ, configure it from the start, and let its filters settle while the others are read.
"""

from __future__ import annotations

from collections.abc import Iterator

from imuarray.acquire.sensor_routes import SensorRoute
from imuarray.errors import SensorError

FIRST_PAUSE_NS = 100_000_000
LONGEST_PAUSE_NS = 3_200_000_000
"""Pause between two attempts to reach a sensor, doubled each time. An attempt at a silent address takes 30 us."""


class SensorRecovery:
    """The recovery of one sensor. `intact` is True if it still had its configuration, `done` when it can be read
    again.

    With `look`, its configuration is compared first; without, the chip is configured anew in any case.
    """

    def __init__(self, route: SensorRoute, now_ns: int, *, look: bool) -> None:
        self.route = route
        self.since_ns = now_ns
        self.intact = False
        self.done = False
        self.failure: Exception | None = None
        self.refusal = ""
        """The kernel driver that owns the address now, if there is one."""
        self._look = look
        self._pause_ns = FIRST_PAUSE_NS
        self._next_ns = now_ns
        self._way: Iterator[float] | None = None

    def waits(self, now_ns: int) -> bool:
        """Return whether the next step is not due yet."""
        return now_ns < self._next_ns

    @property
    def next_step_ns(self) -> int | None:
        """The time of the next step of a configuration in progress; None if none is in progress."""
        return None if self._way is None or self.done else self._next_ns

    def step(self, now_ns: int) -> None:
        """Do one step. An error is stored in `failure`, and the recovery starts again after a pause."""
        self._way = self._way or self._steps()
        self.failure = None
        try:
            self._next_ns = now_ns + round(next(self._way) * 1e9)
        except StopIteration:
            self.done = True
        except (OSError, SensorError) as error:
            cause = error.__cause__
            self.failure = cause if isinstance(cause, OSError) else error
            self._way = None
            self._next_ns = now_ns + self._pause_ns
            self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)

    def _steps(self) -> Iterator[float]:
        driver = self.route.driver
        self._claim()
        driver.identify()
        if self._look and driver.watched:
            settings = [(setting, driver.registers.read_back(setting.register)) for setting in driver.watched]
            if all(byte & setting.mask == setting.value for setting, byte in settings):
                self.intact = True
                return
        self._look = False
        yield 0.0
        yield from driver.steps()

    def _claim(self) -> None:
        try:
            self.route.claim()
        except SensorError as error:
            self.refusal = str(error)
            raise
        self.refusal = ""

"""Judges how sensors started from their first readings, by the start-up states that a calibration knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.model import Calibration
from imuarray.calibrate.runs import Ranges
from imuarray.calibrate.start_up import StartUp, in_states, in_this_pose, state_of

PARTS = 10
_RESTLESS = 25.0
"""At rest the means of parts scatter as their noise lets expect, five times as much with a wandering bias."""


class StartUpVerdict(NamedTuple):
    """Verdict on the start of a sensor: whether its readings are unusable, and a sentence ("" if there is nothing to
    say).
    """

    fault: bool
    text: str = ""


class StartUpJudge:
    """Judges the first readings of sensors (an `imuarray.acquire.start_up.Judge`): a call returns verdicts by name.

    `sentences` keeps every sentence; `tell` receives each when it is new. A box that was moved meanwhile is not judged.
    """

    def __init__(
        self, calibration: Calibration, ranges: Ranges, tell: Callable[[str], None] = lambda text: None
    ) -> None:
        """`ranges` are the sensitivities of each sensor's chip by range, by sensor (`ArrayConfig.sensitivities`)."""
        self.sentences: list[str] = []
        self._calibration, self._ranges, self._tell = calibration, ranges, tell
        self._means: dict[str, npt.NDArray[Any]] = {}
        self._starts: dict[str, StartUp] = {}

    @property
    def knows_states(self) -> bool:
        """Return whether the calibration knows the start-up states of any sensor."""
        return any(sensor.turn_on is not None for sensor in self._calibration.sensors.values())

    def in_states(self) -> Calibration:
        """The calibration with the biases of the states in which sensors started, as far as known by now."""
        return in_states(dict(self._starts), self._calibration)

    def __call__(self, readings: Mapping[str, npt.NDArray[Any]]) -> dict[str, StartUpVerdict]:
        """Verdicts by sensor; a sensor that is judged again is compared with the first readings of the others."""
        known = {name: counts for name, counts in readings.items() if name in self._calibration.sensors}
        if known and np.median([_restlessness(counts) for counts in known.values()]) > _RESTLESS:
            self._say("the box was moved in the first seconds: the states of the sensors are not known")
            return {}
        self._means.update((name, counts.mean(axis=0)) for name, counts in readings.items())
        states = state_of(self._means, self._calibration, ranges=self._ranges)
        starts = {name: start for name, start in in_this_pose(states, self._calibration).items() if name in readings}
        self._starts.update(starts)
        verdicts = {name: self._verdict(name, start) for name, start in starts.items()}
        if not any(verdict.text for verdict in verdicts.values()):
            usual = f"{len(starts)} sensors started as usual"
            self._tell(usual if states else "the calibration holds no turn-on states")
        return verdicts

    def _verdict(self, name: str, start: StartUp) -> StartUpVerdict:
        text = start.sentence(name, self._calibration)
        if text:
            self._say(text)
        return StartUpVerdict(start.fault, text)

    def _say(self, text: str) -> None:
        if text not in self.sentences:
            self.sentences.append(text)
            self._tell(text)


def _restlessness(counts: npt.NDArray[Any]) -> float:
    """How much more than by white noise the means of parts of (n, 3) counts vary, as a ratio of variances: the largest
    of the axes.
    """
    if len(counts) < 4 * PARTS:
        return 0.0
    length = len(counts) // PARTS
    parts = counts[: PARTS * length].reshape(PARTS, length, -1).astype(float)
    noise = parts.var(axis=1, ddof=1).mean(axis=0) + 1 / 12  # a code is a rounded value
    return float((parts.mean(axis=1).var(axis=0, ddof=1) / (noise / length)).max())

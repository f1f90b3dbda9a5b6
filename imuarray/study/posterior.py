"""The bound over a log, and the estimate that reaches it: the posterior mean, by dense linear algebra."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from imuarray.calibrate import Calibration
from imuarray.fuse import Frames, FusedBlock, aligned
from imuarray.fuse.frames import entries
from imuarray.fuse.optimal.readings import patterns
from imuarray.log import Log
from imuarray.study.bound import Bound, ErrorLaw, Flags, Floats, Seen, Stretch, bound, frame_weights

STRETCHES = 60
"""Of a log: 11 s each of the longest. Slow errors of the simulated array have time constants of 600 s: about its mean
over 11 s such an error scatters by 11 / 600 / 3 = 0.6 % of its variance, which itself is little beside the noise.
"""


class Posterior:
    """Bounds of both quantities over a log, whose calibration is true and whose errors follow `laws`."""

    def __init__(
        self, log: Log, calibration: Calibration, laws: Mapping[str, ErrorLaw], names: Sequence[str] = ()
    ) -> None:
        """`laws` by quantity over the axes of the log's sensors (or of those in `names`), in the log's order."""
        self._log, self._calibration, self._laws = log, calibration, laws
        chosen = {quantity: [s for s in log.of(quantity) if not names or s.name in names] for quantity in laws}
        self._sensors = {quantity: sensors for quantity, sensors in chosen.items() if sensors}
        rows = [sensor for sensors in self._sensors.values() for sensor in sensors]
        first_ns, last_ns = min(int(s.time[0]) for s in rows), max(int(s.time[-1]) for s in rows)
        self._edges = np.linspace(first_ns, last_ns + 1, STRETCHES + 1)
        self.bounds: dict[str, Bound] = {
            quantity: bound(laws[quantity], self._stretches(quantity)) for quantity in self._sensors
        }

    def blocks(self, *, smoothed: bool = False) -> Iterator[FusedBlock]:
        """The posterior mean of each frame with its covariance: what the bound is the bound of."""
        for given in self._frames():
            found = {quantity: self._estimated(quantity, part, smoothed) for quantity, part in given.items()}
            triads = {quantity: triad for quantity, (triad, _) in found.items()}
            time = next(iter(given.values())).time
            yield FusedBlock(time, triads, {quantity: covariance for quantity, (_, covariance) in found.items()})

    def _frames(self) -> Iterator[Mapping[str, Frames]]:
        names = [sensor.name for sensors in self._sensors.values() for sensor in sensors]
        return (frames for frames, _ in aligned(self._log, self._calibration, only=names))

    def _stretches(self, quantity: str) -> list[Stretch]:
        """What was seen in each stretch, pattern by pattern of the axes that had a reading."""
        sums: list[dict[bytes, tuple[int, Floats]]] = [{} for _ in range(STRETCHES)]
        for part in (frames[quantity] for frames in self._frames()):
            known, stretch = axes_known(part), self._stretch_of(part.time)
            for number in np.unique(stretch).tolist():
                for pattern, rows in _patterns(known, stretch == number):
                    count, total = sums[number].get(pattern.tobytes(), (0, np.zeros(len(pattern))))
                    read = np.where(pattern, part.values[rows], 0.0).sum(axis=0)
                    sums[number][pattern.tobytes()] = count + len(rows), total + read
        middle_s = (self._edges[:-1] + self._edges[1:]) / 2e9
        return [
            Stretch(time_s, tuple(Seen(np.frombuffer(key, bool), n, total / n) for key, (n, total) in seen.items()))
            for time_s, seen in zip(middle_s.tolist(), sums, strict=True)
        ]

    def _stretch_of(self, time: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        return np.clip(np.searchsorted(self._edges, time, side="right") - 1, 0, STRETCHES - 1)

    def _estimated(self, quantity: str, part: Frames, smoothed: bool) -> tuple[Floats, Floats]:
        law, known, stretch = self._laws[quantity], axes_known(part), self._stretch_of(part.time)
        slow = self.bounds[quantity].slow_smoothed if smoothed else self.bounds[quantity].slow_causal
        spread = self.bounds[quantity].smoothed if smoothed else self.bounds[quantity].causal
        triad = np.empty((len(stretch), 3))
        for pattern, rows in _patterns(known, np.ones(len(known), bool)):
            weights, _ = frame_weights(law, pattern)
            triad[rows] = np.where(pattern, part.values[rows] - slow[stretch[rows]], 0.0) @ weights.T
        return triad, entries(spread)[stretch]


def axes_known(part: Frames) -> Flags:
    """(n, m) axes that had a reading: valid, or off the ends of the range though another axis of the triad was not."""
    if part.clipped is None or not part.clipped.any():
        return part.valid
    triads = (part.clipped != 0).reshape(len(part.clipped), -1, 3)
    beside = triads.any(axis=2, keepdims=True) & ~triads
    return np.asarray(part.valid | beside.reshape(part.valid.shape))


def _patterns(known: Flags, chosen: Flags) -> Iterator[tuple[Flags, npt.NDArray[np.int64]]]:
    """Each pattern of known axes among the chosen frames, and the frames (their numbers) that have it."""
    rows = np.flatnonzero(chosen)
    for pattern, which in patterns(known[rows]):
        yield pattern, rows[which]

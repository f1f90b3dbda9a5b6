"""`dropped_samples`: readings are lost, alone or in bursts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Booleans, Integers
from imuarray.simulate.effect import Effect, require, scalar
from imuarray.simulate.parameters import alongside, listed
from imuarray.simulate.signal import Instants, Place
from imuarray.simulate.streams import Stream

_REACH = 64
"""Number of previous rows that are examined first; it is doubled until it suffices."""


@dataclass(frozen=True)
class DroppedSamples(Effect):
    """A two-state chain from row to row: lost after kept with probability a, kept after lost with probability b.

    b = 1 / burst_rows makes bursts geometric with that mean, a = b p / (1 - p) makes the long-run share lost p =
    `probability`; a <= 1 bounds it by burst_rows / (burst_rows + 1). The model of E. N. Gilbert (Capacity of a
    burst-noise channel, Bell System Technical Journal 39, 1960), with every row of the bad state lost. In data: rows
    are missing and the next one carries flag 8; the time between rows is a multiple of its usual value.

    One uniform number u drives each row: lost if u < a after kept, if u < 1 - b after lost. Where both say the same the
    past no longer matters, so the state of any row is found, exactly, by looking back to the last such row (coupling
    from the past): on average 1 / (1 - |1 - a - b|) rows, whatever the row's number.

    Where it is known which rows are missing, these are lost and no others: those due from each of `moments_s` on, by
    the log's clock, for as long as `lengths_s` says, in the run with that number in `runs`.
    """

    name: ClassVar[str] = "dropped_samples"
    probability: float = scalar(0.0)
    burst_rows: float = scalar(1.0, low=1.0, high=1e6)
    runs: tuple[float, ...] = listed()
    moments_s: tuple[float, ...] = listed()
    lengths_s: tuple[float, ...] = listed()

    def __post_init__(self) -> None:
        """Raise ValueError for a share of lost rows that bursts of this length cannot produce, or for lists of
        different lengths.
        """
        super().__post_init__()
        require("probability", self.probability, 0.0, self.burst_rows / (self.burst_rows + 1))
        for name, values in alongside(runs=self.runs, moments_s=self.moments_s, lengths_s=self.lengths_s).items():
            object.__setattr__(self, name, values)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Mark the lost rows as not kept."""
        if self.moments_s:
            return replace(instants, kept=instants.kept & ~self._missing(instants.stamp_ns, at.streams.boot))
        if not self.probability:
            return instants
        stream = at.streams.of_boot(at.sensor.name, self.name, width=1)  # double precision: probabilities are small
        is_lost = self._lost(instants.first, instants.first + len(instants.kept), stream)
        return replace(instants, kept=instants.kept & ~is_lost)

    def _missing(self, stamp_ns: Integers, run: int) -> Booleans:
        """Return (n,) whether rows with these stamps are lost."""
        missing = np.zeros(len(stamp_ns), bool)
        for number, moment_s, length_s in zip(self.runs, self.moments_s, self.lengths_s, strict=True):
            if number == run:
                due, end = np.searchsorted(stamp_ns, (moment_s * 1e9, (moment_s + length_s) * 1e9))
                missing[due:end] = True
        return missing

    def _lost(self, first: int, stop: int, stream: Stream) -> Booleans:
        """Return (stop - first,) whether rows are lost; row 0 is lost with the long-run probability."""
        stay = 1 - 1 / self.burst_rows
        begin = self.probability / (1 - self.probability) / self.burst_rows
        reach = _REACH
        while True:
            start = max(0, first - reach)
            draws = stream.uniform(start, stop)[:, 0]
            lost, certain = draws < min(begin, stay), (draws < min(begin, stay)) | (draws >= max(begin, stay))
            if start == 0:
                lost[0], certain[0] = draws[0] < self.probability, True
            if certain[: first - start + 1].any():
                break
            reach *= 2
        rows = np.arange(len(draws))
        last = np.maximum.accumulate(np.where(certain, rows, 0))
        turned = ((rows - last) % 2 == 1) & (begin > stay)  # where the past matters, the state is kept or inverted
        return np.asarray((lost[last] ^ turned)[first - start :])

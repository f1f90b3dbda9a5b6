"""How quiet a sensor is beside its data sheet: a filter takes noise away, a reading that is merely late does not.

The noise of a sensor is fitted, so that no statistic shows its size. What the data sheet prints is typical: units are a
third more or less, and many a part has more from elsewhere, so that it counts as much as a heavy tail lets it.
"""

from __future__ import annotations

import math

from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.model.populations import printed_noise
from imuarray.simulate.model import noise_bandwidth_hz

_TYPICAL, _TAIL = 0.3, 4.0
"""Standard deviation of the log of a part's noise about the printed one, and degrees of freedom of its tail."""

_OF_TWO_POLES = math.pi / (2 * math.sqrt(2))
"""Bandwidth of the white noise that a Butterworth filter with two poles passes, by its cutoff."""


def rarity_behind(evidence: Evidence, cutoff_hz: float) -> float:
    """Nats by which the sensor's noise is rarer if it went through a low-pass of two poles than if it did not: negative
    for one that is quieter than printed by as much, positive for one that ought to be and is not. 0 if the filter
    passes all that the chip's own does, or nothing is printed.
    """
    passed, found = passed_by(evidence, cutoff_hz), quietness(evidence)
    return 0.0 if found is None else _rare(found - math.log(passed)) - _rare(found)


def quietness(evidence: Evidence) -> float | None:
    """Log of the noise as fitted over the printed one, the mean of the axes that have any; None where none is known."""
    printed = printed_noise(evidence.header)
    if printed is None:
        return None
    pairs = zip(evidence.fitted.rms, printed, strict=True)
    known = [math.log(rms / typical) for rms, typical in pairs if rms > 0 and typical > 0]
    return sum(known) / len(known) if known else None


def passed_by(evidence: Evidence, cutoff_hz: float) -> float:
    """Share of the rms of the chip's noise that a low-pass of two poles lets through."""
    own_hz = noise_bandwidth_hz(evidence.header)
    return math.sqrt(min(1.0, _OF_TWO_POLES * cutoff_hz / own_hz)) if own_hz > 0 else 1.0


def _rare(apart: float) -> float:
    """Nats that a unit's noise loses against a typical one's."""
    return (_TAIL + 1) / 2 * math.log1p((apart / _TYPICAL) ** 2 / _TAIL)

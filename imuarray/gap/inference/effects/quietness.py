"""Noise of a sensor relative to its data sheet: a filter reduces noise, a reading that is merely late does not.

The noise of a sensor is fitted, so no statistic shows its size. The figure of the data sheet is typical: parts differ
from it by a third, and many have additional noise from elsewhere, so it enters with a heavy-tailed distribution.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.model.base_model import FittedParameters
from imuarray.gap.model.populations import printed_noise
from imuarray.simulate.model import noise_bandwidth_hz

_TYPICAL, _TAIL = 0.3, 4.0
"""Standard deviation of the log of a part's noise about the printed one, and degrees of freedom of its tail."""

_OF_TWO_POLES = math.pi / (2 * math.sqrt(2))
"""Bandwidth of the white noise that a Butterworth filter with two poles passes, by its cutoff."""

BEYOND = 3.0
"""Standard deviations by which logs of one noise differ from what was fitted to all."""

_LEAST = 0.1
"""Share of the noise that rounding leaves to the element."""


class NoiseOfLogs(NamedTuple):
    """The `noisy` and the `quiet` logs, by their numbers, and the log (3,) of the noise of each over the fitted one."""

    noisy: tuple[int, ...]
    quiet: tuple[int, ...]
    more: Floats
    less: Floats


def noise_of_logs(evidence: Evidence) -> NoiseOfLogs | None:
    """Divides the logs by their noise; None if all have the fitted one. That is the median of all, so that of the
    noisier or of the quieter logs if these are the most.
    """
    logs = sorted({phase.log for phase in evidence.still})
    alone = {log: evidence.within([log]) for log in logs}
    noisy = tuple(log for log in logs if alone[log].score("noise").max() > BEYOND)
    noisy = noisy or tuple(log for log in logs if alone[log].score("noise").min() > -BEYOND)
    if not 0 < len(noisy) < len(logs):
        return None
    quiet = tuple(log for log in logs if log not in noisy)
    more, less = (np.median([alone[log].typical("noise") for log in side], axis=0) for side in (noisy, quiet))
    return NoiseOfLogs(noisy, quiet, np.asarray(more), np.asarray(less))


def with_noise(evidence: Evidence, log_ratio: Floats) -> FittedParameters:
    """Return the fitted parameters with a noise that is `log_ratio` (3,) times larger, in logs; rounding stays as it
    is.
    """
    square = evidence.noise**2 * np.exp(2 * log_ratio)
    rounding = evidence.noise**2 - np.square(evidence.fitted.rms)
    x, y, z = np.sqrt(np.maximum(square - rounding, _LEAST**2 * square)).tolist()
    return replace(evidence.fitted, rms=(x, y, z))


def cutoff_that_passes(evidence: Evidence, share: float) -> float:
    """Cutoff of a low-pass of two poles that lets this share of the rms of the chip's noise through; 0 if unknown."""
    return share**2 * noise_bandwidth_hz(evidence.header) / _OF_TWO_POLES


def rarity_behind(evidence: Evidence, cutoff_hz: float) -> float:
    """Nats by which the sensor's noise is rarer if it went through a low-pass of two poles than if it did not: negative
    for one that is quieter than printed by as much, positive for one that ought to be and is not. 0 if the filter
    passes all that the chip's own does, or nothing is printed.
    """
    passed_share, log_ratio = passed_by(evidence, cutoff_hz), quietness(evidence)
    return 0.0 if log_ratio is None else _rare(log_ratio - math.log(passed_share)) - _rare(log_ratio)


def quietness(evidence: Evidence) -> float | None:
    """Return the log of the noise as fitted over the printed one, the mean of the axes that have any; None where none
    is known.
    """
    printed = printed_noise(evidence.header)
    if printed is None:
        return None
    pairs = zip(evidence.fitted.rms, printed, strict=True)
    known = [math.log(rms / typical) for rms, typical in pairs if rms > 0 and typical > 0]
    return sum(known) / len(known) if known else None


def passed_by(evidence: Evidence, cutoff_hz: float) -> float:
    """Return the share of the rms of the chip's noise that a low-pass of two poles lets through."""
    own_hz = noise_bandwidth_hz(evidence.header)
    return math.sqrt(min(1.0, _OF_TWO_POLES * cutoff_hz / own_hz)) if own_hz > 0 else 1.0


def _rare(apart: float) -> float:
    """Nats that a unit's noise loses against a typical one's."""
    return (_TAIL + 1) / 2 * math.log1p((apart / _TYPICAL) ** 2 / _TAIL)

"""`thermometer`: the chip's own thermometer is off, or noisy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.converters import THERMOMETERS
from imuarray.simulate.effects.thermometer import Thermometer

_OFFSET, _NOISE = "thermometer_offset", "thermometer_noise"
_BEYOND = 2.7


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """The mean difference from the reference, and what the counts vary by in segments beyond what they should."""
    yield from with_removal(evidence, Thermometer.name, _found(evidence))


def _found(evidence: Evidence) -> Iterator[Hypothesis]:
    converter = THERMOMETERS.get(evidence.header.chip)
    if converter is None or not evidence.is_odd(_OFFSET, _NOISE, beyond=_BEYOND):
        return
    offset = float(evidence.typical(_OFFSET)[0]) if evidence.is_odd(_OFFSET, beyond=_BEYOND) else 0.0
    rms = _rms_lsb(evidence) / abs(converter.lsb_per_degc) if evidence.is_odd(_NOISE, beyond=_BEYOND) else 0.0
    if offset or rms:
        yield Hypothesis((Thermometer(offset, rms),), ("offset_degc", "rms_degc"))


def _rms_lsb(evidence: Evidence) -> float:
    """Root of the variance in excess; both are logs of a variance and a twelfth of a count."""
    excess = np.exp(evidence.values[_NOISE]) - np.exp(evidence.expected[_NOISE])
    known = excess[np.isfinite(excess)]
    return float(np.sqrt(max(np.median(known), 0.0))) if len(known) else 0.0


THERMOMETER = Candidate(
    Thermometer.name,
    guesses,
    {"static": "still beside another thermometer for 5 minutes", "heating": "heat by 10 degC"},
)

"""Bias, slope and noise in the presence of missing codes, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects.codes import _moments, behind
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.conversion import Quantisation
from imuarray.simulate.effects.temperature import ThermalBias
from tests.gap.effects.evidence_of import evidence_of
from tests.selection import some


def test_moments_at_the_edge_of_the_codes_of_a_dead_bit() -> None:
    """At the edge of the missing codes half of the readings are S = 64 lower: mean S / 2 lower, and the variance that
    of a normal distribution and of two equally likely values, minus the part by which these are nearer than S: s^2 +
    S^2 / 4 - S E|n|.
    """
    sigma = 6.0
    table = _moments(lambda codes: codes & ~64, 128, sigma)
    edge = int(63.5 * len(table.shift) / 128)
    assert table.shift[edge] == pytest.approx(-32.0, abs=1e-6)
    expected = sigma**2 + 32**2 - 64 * np.sqrt(2 / np.pi) * sigma
    assert table.variance[edge] == pytest.approx(expected, rel=1e-3)


def test_moments_far_from_the_missing_codes() -> None:
    table = _moments(lambda codes: codes & ~64, 128, 2.0)
    assert table.shift[32 * 4] == pytest.approx(0.0, abs=1e-9)
    assert table.variance[32 * 4] == pytest.approx(2.0**2 + 1 / 12, rel=1e-3)
    assert table.unsure[32 * 4] == pytest.approx(2 * table.variance[32 * 4] ** 2, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("below_lsb", some([2.0, 4.0], 1, 0))
def test_the_fit_of_a_gyroscope_that_warms_up_towards_a_dead_bit(below_lsb: float) -> None:
    """Readings jump by 32 counts where the bias is near the missing codes; after a correction bias, slope and noise are
    those of the same sensor, with the same draws, without a dead bit.
    """
    sound = _heated(below_lsb)
    dead = Quantisation(dead_bits=32.0)
    evidence = _heated(below_lsb, dead)
    scale = evidence.header.sensitivity
    found = behind(evidence, dead.coded, 64, 32)
    assert found is not None
    wanted = sound.fitted
    misled = np.abs(np.subtract(evidence.fitted.slope, wanted.slope)).max() * scale
    assert np.abs(np.subtract(found.slope, wanted.slope)).max() * scale < max(0.5 * misled, 0.02)
    assert np.subtract(found.offset, wanted.offset) * scale == pytest.approx(np.zeros(3), abs=0.5)
    assert found.rms == pytest.approx(wanted.rms, rel=0.1)


@pytest.mark.slow
def test_a_sensor_without_rest_has_no_corrected_fit() -> None:
    evidence = replace(_heated(3.0), phases=())
    assert behind(evidence, lambda codes: codes, 2, 1) is None


def _heated(below_lsb: float, *effects: Quantisation) -> Evidence:
    """A heated gyroscope whose levels at 25 degC are so many counts below the codes with bit 5 set."""
    scale = evidence_of("heating", "G1").header.sensitivity
    base = evidence_of("heating", "G1").fitted.offset
    bias = Bias(tuple((31.5 - below_lsb) / scale - one for one in base))
    return evidence_of("heating", "G1", {"G1": (bias, ThermalBias((0.2 / scale,) * 3, reference_degc=25.0), *effects)})

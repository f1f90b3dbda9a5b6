"""Probabilities of causes, against closed forms of their rates."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.findings.verdict import RATES, Rates, calibrated_probability

PLAIN = Rates(0.25, 0.9, 2.0, 1.0)
SHARES = st.floats(0.0, 1.0)


def test_the_probability_of_a_sole_cause_is_its_rate() -> None:
    """0.25 + 0.65 / 4 where half is closed; a closure that cannot be measured is treated as zero. No probability
    exceeds ten thousand to one.
    """
    assert calibrated_probability(1.0, 0.0, PLAIN) == pytest.approx(0.25, rel=2e-4)
    assert calibrated_probability(1.0, 0.5, PLAIN) == pytest.approx(0.4125, rel=2e-4)
    assert calibrated_probability(1.0, 1.0, PLAIN) == pytest.approx(0.9, rel=2e-4)
    assert (
        calibrated_probability(1.0, None, PLAIN)
        == calibrated_probability(1.0, -3.0, PLAIN)
        == calibrated_probability(1.0, 0.0, PLAIN)
    )


def test_odds_against_rivals_are_raised_to_a_power() -> None:
    """8 to 1 are 2 to 1 with a third; even odds stay."""
    cubic = Rates(0.0, 1.0, 1.0, 1 / 3)
    assert calibrated_probability(8 / 9, 1.0, cubic) == pytest.approx(2 / 3)
    assert calibrated_probability(1 / 9, 1.0, cubic) == pytest.approx(1 / 3)
    assert calibrated_probability(0.5, 1.0, cubic) == pytest.approx(0.5)


@given(SHARES, SHARES, SHARES)
def test_probability_increases_with_closure_and_odds(share: float, other: float, closed: float) -> None:
    assert 0 <= calibrated_probability(share, closed) <= RATES.most
    assert (calibrated_probability(share, closed) - calibrated_probability(other, closed)) * (share - other) >= 0
    assert (calibrated_probability(closed, share) - calibrated_probability(closed, other)) * (share - other) >= 0

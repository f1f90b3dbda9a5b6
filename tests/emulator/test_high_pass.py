"""The first-order high-pass of the emulated chips against its closed form exp(-2 pi f t)."""

import math

import pytest

from firmware_emulator.chips.high_pass import HighPass

SECOND = 1_000_000_000


@pytest.mark.parametrize("steps", [1, 7])
def test_a_constant_decays_independently_of_the_number_of_reads(steps):
    high_pass = HighPass(0.5, since_ns=SECOND)
    for step in range(1, steps + 1):
        output = high_pass((1.0, -2.0, 3.0), SECOND + step * SECOND // steps)
    kept = math.exp(-math.pi)
    assert output == pytest.approx((kept, -2 * kept, 3 * kept))


def test_a_step_passes_unattenuated_and_then_decays():
    high_pass = HighPass(1.0, since_ns=0)
    high_pass((0.0, 0.0, 0.0), SECOND)
    assert high_pass((5.0, 0.0, -5.0), 2 * SECOND) == (5.0, 0.0, -5.0)
    later = high_pass((5.0, 0.0, -5.0), 2 * SECOND + SECOND // 4)
    assert later == pytest.approx((5 * math.exp(-math.pi / 2), 0.0, -5 * math.exp(-math.pi / 2)))


def test_zeroing_subtracts_the_present_input():
    high_pass = HighPass(1.0, since_ns=0)
    high_pass.zero((1.0, 2.0, 3.0), SECOND)
    assert high_pass((1.0, 2.0, 3.0), SECOND) == (0.0, 0.0, 0.0)
    assert high_pass((2.0, 2.0, 2.0), 2 * SECOND) == (1.0, 0.0, -1.0)


def test_before_it_is_switched_on_nothing_decays():
    assert HighPass(1.0, since_ns=SECOND)((1.0, 1.0, 1.0), 0) == (1.0, 1.0, 1.0)

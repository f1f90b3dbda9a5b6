"""Range and steps of the converter: quantisation, saturation."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from imuarray.simulate.converters import code_span, convert
from imuarray.simulate.effects.conversion import Quantisation, Saturation


class TestQuantisation:
    def test_a_bma180_read_with_twelve_bits_has_multiples_of_four(self, place, analog, sensor) -> None:
        """Multiples of four (BMA-61), and none beyond the last one within 14 bits."""
        ramp = np.linspace(-20, 20, 9001)[:, None]
        after = Quantisation(4).analog(analog(0, 9001, value=ramp), place())
        codes = np.unique(convert(after, code_span(sensor("bma180"))))
        assert codes.tolist() == list(range(-8192, 8189, 4))

    def test_rounding_noise_has_its_rms(self, place, analog, sensor) -> None:
        """step / sqrt(12) rms of a signal that takes every value alike."""
        ramp = np.linspace(-1, 1, 30011)[:, None]
        after = Quantisation(16).analog(analog(0, 30011, value=ramp), place())
        error = convert(after, code_span(sensor("bma180"))) - ramp * 512
        assert np.sqrt((error**2).mean()) == pytest.approx(16 / math.sqrt(12), rel=1e-3)

    @pytest.mark.parametrize(("already", "asked", "becomes"), [(1, 3, 3), (2, 2, 2), (2, 3, 6), (2, 4, 4)])
    def test_the_step_is_the_least_common_multiple(self, place, analog, already: int, asked: int, becomes: int) -> None:
        assert Quantisation(asked).analog(analog(0, 1, step=already), place()).step == becomes

    def test_each_axis_can_have_its_step(self, place, analog, sensor) -> None:
        """0.0195 g are 9.98 counts of 512 per g: 10 where codes have steps of one, 8 where they have steps of four."""
        after = Quantisation((1.0, 4.0, 2.0)).analog(analog(0, 2, value=0.0195), place())
        assert convert(after, code_span(sensor("bma180"))).tolist() == [[10, 8, 10]] * 2

    def test_a_dead_bit_is_cleared(self, place, codes) -> None:
        """Of -9 ... 9, two's complement, without the bit that counts four: codes with that bit read four lower."""
        before = codes(0, 19, np.arange(-9, 10)[:, None])
        after = Quantisation(dead_bits=4).codes(before, place()).counts[:, 0]
        assert after.tolist() == [-13, -8, -7, -6, -5, -8, -7, -6, -5, 0, 1, 2, 3, 0, 1, 2, 3, 8, 9]

    def test_missing_codes_become_the_carry_above(self, place, codes) -> None:
        """Of every eight the last three, 5, 6 and 7, become the next eight: of negative codes -3, -2 and -1."""
        before = codes(0, 19, np.arange(-9, 10)[:, None])
        after = Quantisation(carry_lsb=8, missing_lsb=3).codes(before, place()).counts[:, 0]
        assert after.tolist() == [-8, -8, -7, -6, -5, -4, 0, 0, 0, 0, 1, 2, 3, 4, 8, 8, 8, 8, 9]

    def test_an_offset_shifts_the_missing_codes(self, place, codes) -> None:
        """Of 0 ... 9 the code before 3 and 7, carries three beyond multiples of four, becomes the carry."""
        after = Quantisation(carry_lsb=4, missing_lsb=1, carry_at_lsb=3).codes(
            codes(0, 10, np.arange(10)[:, None]), place()
        )
        assert after.counts[:, 0].tolist() == [0, 1, 3, 3, 4, 5, 7, 7, 8, 9]

    def test_codes_stay_within_their_integer_type(self) -> None:
        """16 bits of a gyroscope end before the carry."""
        counts = np.array([32765, 32759], np.int16)
        assert Quantisation(carry_lsb=16, missing_lsb=4).coded(counts).tolist() == [32767, 32759]

    def test_code_ends_can_change_within_a_run(self, place, analog) -> None:
        ends = np.array([[-512.0], [-4096.0]]), np.array([[511.0], [4095.0]])
        after = Quantisation(10).analog(analog(0, 2, lowest=ends[0], highest=ends[1]), place())
        assert after.lowest.tolist() == [[-510], [-4090]]
        assert after.highest.tolist() == [[510], [4090]]


class TestSaturation:
    def test_a_sine_is_clipped_for_its_share_of_time(self, place, analog) -> None:
        """Amplitude 2, limit 1: beyond it for 1 - 2 asin(1/2) / pi = 2/3 of the time."""
        sine = 2 * np.sin(2 * np.pi * (np.arange(9000) + 0.5) / 9000)[:, None]
        after = Saturation(1.0).analog(analog(0, 9000, value=sine), place())
        clipped = np.abs(after.value) == 1
        assert clipped.mean() == pytest.approx(2 / 3, abs=1e-3)
        assert np.array_equal(after.value[~clipped], np.broadcast_to(sine, (9000, 3))[~clipped])
        assert (np.sign(after.value) == np.sign(sine)).all()

    def test_limits_are_about_the_centre(self, place, analog) -> None:
        """Limit 1 about 0.5 ends at 1.5 and -0.5; noise is clipped with the signal."""
        before = analog(0, 1, value=(2.0, -2.0, 1.4), noise=(0.0, 0.0, 0.2))
        after = Saturation(1.0, 0.5).analog(before, place())
        assert after.value.tolist() == [[1.5, -0.5, 1.5]]
        assert after.noise.tolist() == [[0.0, 0.0, 0.0]]

    def test_signal_and_noise_are_clipped_together(self, place, analog) -> None:
        before = analog(0, 1, value=(0.9, 0.9, 1.1), noise=(0.2, 0.05, -0.2))
        after = Saturation(1.0).analog(before, place())
        assert after.value.tolist() == [[1.0, 0.9, 1.1]]
        assert after.noise.tolist() == [[0.0, 0.05, -0.2]]

    def test_each_axis_can_have_its_limit(self, place, analog) -> None:
        after = Saturation((math.inf, 1.0, 3.0)).analog(analog(0, 1, value=(-2.0, -2.0, -2.0)), place())
        assert after.value.tolist() == [[-2.0, -1.0, -2.0]]

    def test_codes_are_limited_before_the_end_of_their_span(self, place, analog, sensor) -> None:
        after = Saturation(5.0).analog(analog(0, 1, value=(9, -9, 4), noise=0.3), place())
        assert convert(after, code_span(sensor("bma180"))).tolist() == [[2560, -2560, 2202]]


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: Quantisation(0), "step_lsb: 0.0; allowed is 1 to 4096"),
    (lambda: Quantisation(2.5), "step_lsb: 2.5; a whole number"),
    (lambda: Quantisation(carry_lsb=8, missing_lsb=8), "missing_lsb: 8; allowed is 0 to 7"),
    (lambda: Quantisation(missing_lsb=1), "missing_lsb: 1; allowed is 0 to 0"),
    (lambda: Saturation(-1.0), "limit: -1.0; allowed is 0 to inf"),
    (lambda: Saturation(math.nan), "limit: nan"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_invalid_parameters_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        make()

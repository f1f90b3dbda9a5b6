"""The barometer's arithmetic backwards; forwards it is checked against the data sheet's example with the driver."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from imuarray.barometer import EXAMPLE_WORDS, compensate, uncompensated


def test_the_data_sheets_example_round_trips() -> None:
    # BMP-60 ... BMP-63: UT 27898 and UP 23843 at oversampling 0 are 15.0 degC and 69964 Pa
    temperature, pressure = compensate(np.array([27898]), np.array([23843]), EXAMPLE_WORDS, 0)
    assert (temperature[0], pressure[0]) == (15.0, 69964.0)
    ut, up = uncompensated(np.array([15.0]), np.array([69964.0]), EXAMPLE_WORDS, 0)
    again = compensate(ut, up, EXAMPLE_WORDS, 0)
    assert (again[0][0], again[1][0]) == (15.0, 69964.0)


@given(st.lists(st.tuples(st.floats(-20, 65), st.floats(30_000, 110_000)), min_size=1, max_size=20))
def test_raw_words_give_the_requested_temperature_and_pressure(pairs: list[tuple[float, float]]) -> None:
    asked = np.array(pairs)
    ut, up = uncompensated(asked[:, 0], asked[:, 1], EXAMPLE_WORDS, 3)
    temperature, pressure = compensate(ut, up, EXAMPLE_WORDS, 3)
    # one step of UT is below 0.1 degC; pressure has steps of 2 Pa where B7 / B4 is doubled (BMP-60), of less than
    # 4 with what is added to it, and the word is the first that reaches what was asked for
    assert (np.abs(temperature - asked[:, 0]) <= 0.1).all()
    assert (np.abs(pressure - asked[:, 1]) < 4.0).all()

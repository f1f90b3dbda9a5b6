"""Products of many rows with a small matrix."""

import numpy as np
import pytest

from imuarray.products import multiply_rows


@pytest.mark.parametrize("count", [0, 1, 70_000])
def test_every_row_is_multiplied(count: int) -> None:
    index = np.arange(count)[:, None]
    product = multiply_rows(index * np.array([[1.0, 2.0]]), np.array([[1.0, 0.0, -1.0], [0.0, 10.0, 1.0]]))
    np.testing.assert_array_equal(product, index * np.array([[1, 20, 1]]))


def test_a_matrix_may_have_more_numbers_than_one_thread_multiplies() -> None:
    rows = np.ones((3, 600))
    np.testing.assert_array_equal(multiply_rows(rows, np.ones((600, 600))), np.full((3, 600), 600.0))

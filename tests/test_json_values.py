"""JSON values of arrays, dataclasses, and numbers that are not finite."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imuarray.json_values import json_value


@dataclass(frozen=True)
class Reading:
    name: str
    values: tuple[float, ...]


def test_arrays_dataclasses_and_infinities_are_converted() -> None:
    value = {"a": np.array([1.0, np.nan]), "b": (np.int64(3), float("inf")), "c": np.array(["x"]), "d": np.bool_(True)}
    assert json_value(value) == {"a": [1.0, None], "b": [3, None], "c": ["x"], "d": True}
    assert json_value([Reading("x", (0.5, float("-inf")))]) == [{"name": "x", "values": [0.5, None]}]


def test_long_series_of_numbers_are_copied_and_infinities_in_them_become_none() -> None:
    series = [0.5] * 1000
    assert json_value(series) == series
    assert json_value(series) is not series
    assert json_value((*series, float("nan"), 1)) == [*series, None, 1]
    assert json_value([True, None, "x", 2]) == [True, None, "x", 2]

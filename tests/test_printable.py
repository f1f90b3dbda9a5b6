"""Names in a sentence."""

from __future__ import annotations

from imuarray.printable import series


def test_names_are_joined_into_a_series() -> None:
    assert [series(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == ["", "a", "a and b", "a, b and c"]

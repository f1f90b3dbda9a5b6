"""What of a long test the quick half runs: some of its cases, and fewer examples of a property.

`.ci/run` runs all of both: the slow half has the other cases, and it repeats every property with the profile "full".
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import settings


def some(cases: Iterable[Any], quick: int) -> list[Any]:
    """Return all cases as parameters of a test, a tuple with an argument for each name; all but `quick` of them, evenly
    spread from the first to the last, are marked slow.
    """
    cases = list(cases)
    chosen = {round(place * (len(cases) - 1) / max(quick - 1, 1)) for place in range(quick)}
    arguments = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [
        pytest.param(*arguments[place], marks=() if place in chosen else pytest.mark.slow)
        for place in range(len(cases))
    ]


def examples(most: int) -> int:
    """Return how many examples a property is tested with: as many as the profile draws, at most `most`."""
    return min(most, settings().max_examples)

"""The part of a long test that the quick half runs: some of its cases, and fewer examples of a property.

`.ci/run` runs more of both: the slow half has other cases, and it repeats every property with the profile "full". The
rest is run by `.ci/campaigns`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest
from hypothesis import settings


def some(cases: Iterable[Any], quick: int, slow: int | None = None) -> list[Any]:
    """Return all cases as parameters of a test, a tuple with an argument for each name. All but `quick` of them, evenly
    spread from the first to the last, are marked slow; of those, all but `slow`, if that is given, are a campaign.
    """
    cases = list(cases)
    places = range(len(cases))
    chosen = _spread(places, quick)
    rest = [place for place in places if place not in chosen]
    kept = set(rest) if slow is None else _spread(rest, slow)
    arguments = [case if isinstance(case, tuple) else (case,) for case in cases]
    marks = {
        place: () if place in chosen else pytest.mark.slow if place in kept else pytest.mark.campaign
        for place in places
    }
    return [pytest.param(*arguments[place], marks=marks[place]) for place in places]


def _spread(places: Sequence[int], count: int) -> set[int]:
    return {places[round(number * (len(places) - 1) / max(count - 1, 1))] for number in range(min(count, len(places)))}


def examples(most: int) -> int:
    """Return how many examples a property is tested with: as many as the profile draws, at most `most`."""
    return min(most, settings().max_examples)

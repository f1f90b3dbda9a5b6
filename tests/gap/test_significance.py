"""The tree of places, on scores made by hand."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.inference.assessment import LEVELS, Localisation, localise, p_value
from imuarray.gap.model.base_model import headers_in
from imuarray.gap.statistics.catalogue import Key, statistics
from tests.gap.small_campaign import campaign_of

Floats = npt.NDArray[np.float64]

CAMPAIGN = campaign_of("static")
KEYS = statistics(CAMPAIGN).keys
"""Of two accelerometers and two gyroscopes, 60 s at rest."""


def found_by(scores: Floats, chance: Floats) -> Localisation:
    return localise(KEYS, headers_in(CAMPAIGN), scores, chance)


def places(sensor: str) -> npt.NDArray[np.intp]:
    return np.flatnonzero([key.sensor == sensor for key in KEYS])


def found_keys(found: Localisation) -> list[Key]:
    return [KEYS[at] for at in found.p_by_place]


def test_a_place_is_tested_against_its_siblings() -> None:
    """Chance reaches 3 in A2, 1 elsewhere: a 2 of A1 is beyond its own chance, not beyond that of its family."""
    chance = np.ones((40, len(KEYS)))
    chance[:, places("A2")[0]] = 3.0
    scores = np.zeros(len(KEYS))
    scores[places("G1")[5]] = 4.0
    scores[places("A1")[0]] = 2.0
    found = found_by(scores, chance)
    assert found.p == pytest.approx(1 / 41)
    assert [node.path for node in found.root.significant("sensor")] == [("l3g4200d", "G1")]
    scores[places("A1")[0]] = -3.5
    both = found_by(scores, chance)
    assert [node.path[1] for node in both.root.significant("sensor")] == ["G1", "A1"]
    assert found_keys(both) == [KEYS[places("G1")[5]], KEYS[places("A1")[0]]]
    assert list(both.p_by_place.values()) == pytest.approx([1 / 41] * 2)
    assert [child.is_significant for child in both.root.significant("chip")[1].children] == [True, False]


def test_a_sensor_that_has_been_located_does_not_hide_a_smaller_deviation() -> None:
    """Chance reaches 3 in A2, 1 elsewhere: with a 4 of A2 located, a 2 of A1 is beyond the remaining chance. Both are
    in the smallest domain, whose scores count most.
    """
    domains = Counter(key.domain for key in KEYS)
    smallest = min(domains, key=lambda domain: domains[domain])
    first, second = (next(at for at in places(name) if KEYS[at].domain == smallest) for name in ("A1", "A2"))
    chance = np.ones((40, len(KEYS)))
    chance[:, second] = 3.0
    scores = np.zeros(len(KEYS))
    scores[second], scores[first] = 4.0, 2.0
    found = found_by(scores, chance)
    assert [node.path[1] for node in found.root.significant("sensor")] == ["A2", "A1"]
    scores[second] = 2.5
    assert not found_by(scores, chance).root.significant("sensor")


def test_no_place_is_tested_without_a_gap() -> None:
    none = found_by(np.zeros(len(KEYS)), np.ones((40, len(KEYS))))
    assert (none.is_gap, none.p, none.root.children, none.p_by_place) == (False, 1.0, (), {})
    assert none.root.level == LEVELS[0]


def test_a_missing_score_gives_no_gap_and_a_missing_chance_hides_none() -> None:
    """Scores that are missing in the recording, and in all replicates."""
    scores, chance = np.full(len(KEYS), np.nan), np.full((40, len(KEYS)), np.nan)
    assert not found_by(scores, np.ones((40, len(KEYS)))).is_gap
    scores[7] = 2.0
    assert found_keys(found_by(scores, chance)) == [KEYS[7]]


def test_the_limit_is_exceeded_in_one_of_twenty() -> None:
    """The largest scores of replicates are 1 to 40: a twentieth from the top is 38."""
    chance = np.zeros((40, len(KEYS)))
    chance[:, 3] = -np.arange(1.0, 41.0)
    assert found_by(np.zeros(len(KEYS)), chance).limit == pytest.approx(38, abs=0.1)


def test_too_few_replicates_are_refused() -> None:
    with pytest.raises(ValueError, match=r"replicates: 10 were scored; a share of false alarms of 0\.05 needs 19"):
        found_by(np.zeros(len(KEYS)), np.ones((10, len(KEYS))))


def test_p_is_not_zero() -> None:
    chance = np.arange(1.0, 100.0)
    assert p_value(1000.0, chance) == pytest.approx(0.01)
    assert p_value(95.0, chance) == pytest.approx(0.06)
    assert p_value(0.0, chance) == 1.0

"""The detection limit is found from how scores go with severity."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import ConfigError
from imuarray.validation import detection, generator
from imuarray.validation.case import Put
from imuarray.validation.detection import Asked, limit_of
from imuarray.validation.thresholds import frozen


@settings(max_examples=60)
@given(limit=st.floats(0.05, 20.0), power=st.floats(0.7, 2.2), most=st.floats(15.0, 40.0))
def test_a_limit_is_found_in_five_tries(limit: float, power: float, most: float) -> None:
    """Scores over what chance reaches go with a power of severity, between 0.03 and where they are cut off."""
    asked: list[float] = []

    def beyond(one: Asked, severity: float) -> float:
        asked.append(severity)
        return min(max((severity / limit) ** power, 0.03), most)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(detection, "beyond", beyond)
        found = limit_of(Asked("anything", "", 1))
    assert len(asked) <= 5  # the last at several times the limit
    assert found == pytest.approx(limit, rel=0.6)


def test_what_never_shows_has_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detection, "beyond", lambda one, severity: 0.03)
    assert math.isnan(limit_of(Asked("anything", "", 1)))


def test_what_always_shows_has_the_least(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detection, "beyond", lambda one, severity: 17.0)
    assert limit_of(Asked("anything", "", 1)) == 1 / 64


def test_what_the_generator_refuses_is_said_in_a_line(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("cases")
    with pytest.raises(ConfigError, match=r"the generator of cases: .*nobody"):
        generator.record(folder, "static", (Put("mains_ripple", 1.0, 1.0, ("nobody",)),), 1)


def test_thresholds_are_noted_with_the_version() -> None:
    noted = frozen()
    assert noted["level of false alarms"] == 0.05
    assert str(noted["software"]).startswith("imuarray ")


def test_what_chance_alone_reaches_is_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.9 of what chance reaches in one of twenty campaigns, whatever the severity."""
    monkeypatch.setattr(detection, "beyond", lambda one, severity: 0.9)
    assert math.isnan(limit_of(Asked("anything", "", 1)))

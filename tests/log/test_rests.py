"""The rule that states which noted phases are rests."""

from __future__ import annotations

import pytest

from imuarray.log.format import Phase
from imuarray.log.rests import is_at_rest, rests_of, steady_rests


@pytest.mark.parametrize(
    ("name", "up", "is_rest"),
    [
        ("static", "", True),
        ("room", "", True),
        ("x_down", "", True),
        ("z_up_check", "", True),
        ("pose 3", "", True),
        ("run 12", "", True),
        ("warm-up", "", True),
        ("cooling", "", True),
        ("on the shelf", "-Y", True),
        ("on the shelf", "", False),
        ("motion", "+Z", False),
        ("motion", "", False),
        ("static_check", "", False),
        ("w_up", "", False),
        ("running", "", False),
        ("", "", False),
    ],
)
def test_a_phase_is_a_rest_by_its_name_or_its_noted_axis(name: str, up: str, is_rest: bool) -> None:
    assert is_at_rest(Phase(0, 9, name, up)) == is_rest


def test_several_runs_in_one_log_are_no_rests_unless_an_axis_is_noted() -> None:
    still, first, second = Phase(0, 9, "static"), Phase(9, 20, "run 1"), Phase(20, 30, "run 2")
    assert rests_of([still, first]) == [still, first]
    assert rests_of([still, first, second]) == [still]
    assert rests_of([still, first, second._replace(up="+Z")]) == [still, second._replace(up="+Z")]


def test_a_steady_rest_is_not_heated_if_there_is_another_rest() -> None:
    room, heat, motion = Phase(0, 9, "room"), Phase(9, 20, "heat", "+Z"), Phase(20, 30, "motion", "+Z")
    assert steady_rests([room, heat, motion]) == [room]
    assert steady_rests([heat, motion]) == [heat]
    assert steady_rests([motion]) == []

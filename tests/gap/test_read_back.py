"""A diagnosis read back from its JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import LogError
from imuarray.gap.findings.diagnosis import diagnosis_of
from tests.report.example_diagnoses import partial_diagnosis
from tests.selection import examples, some


def table() -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(json.dumps(partial_diagnosis().as_json()))
    return loaded


def test_all_content_of_the_json_is_read_back() -> None:
    assert diagnosis_of(table()).as_json() == partial_diagnosis().as_json()


@pytest.mark.parametrize(
    ("path", "value", "said"),
    some(
        [
            (("verdict",), "perhaps", "verdict: 'perhaps'; allowed are no gap"),
            (("gap", "before"), "much", "gap.before: 'much'"),
            (("map", "before"), [["x"]], "rows of numbers"),
            (("map", "sensors"), ["A"] * 99, "sensors by"),
            (("where",), {"a": 1}, "where: must be a list"),
            (("causes",), [3], "causes: must be an object"),
            (("seed",), True, "seed: True"),
            (("seed",), 10**400, "seed: '1000"),
            (("gap", "before"), 10**400, "gap.before: '1000"),
            (("gap", "before"), 1e300, "gap.before: '1e"),
            (("map", "before"), [[10**400]], "rows of numbers"),
            (("causes", 0, "parameters"), {"a": [10**400]}, "parameters: '1000"),
            (("pulls", 0, "pull"), "far", "pulls.pull: 'far'"),
            (("missing",), "much", "missing: must be a list"),
            (("sentence",), "\ud800", "sentence: .* contains half a character"),
            (("causes", 0, "parameters"), {"\ud800": 1}, "parameters: .* contains half a character"),
        ],
        8,
    ),
)
def test_a_wrong_field_is_named(path: tuple[str | int, ...], value: object, said: str) -> None:
    found = table()
    place: Any = found
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(LogError, match=said):
        diagnosis_of(found)


def test_a_missing_field_is_named() -> None:
    found = table()
    del found["cannot_tell"]
    with pytest.raises(LogError, match="cannot_tell is missing"):
        diagnosis_of(found)


def test_files_of_earlier_versions_have_no_pulls_and_no_missing_statistics() -> None:
    found = table()
    del found["pulls"], found["missing"]
    earlier = diagnosis_of(found)
    assert (earlier.pulls, earlier.missing) == ((), ())


def test_json_states_that_p_is_a_bound() -> None:
    """No simulation of 64 differs as much: p is at most 1/65."""
    limited = replace(partial_diagnosis(), p=1 / 65, replicates=64, p_tail=1e-9).as_json()
    assert (limited["p"], limited["p_limit"], limited["p_tail"]) == (1 / 65, 1 / 65, 1e-9)
    assert replace(partial_diagnosis(), replicates=99).as_json()["p_limit"] == 0.01


def test_json_states_the_parts_out_of_specification() -> None:
    assert [pull["is_out_of_specification"] for pull in table()["pulls"]] == [False, True, True, True]
    assert [pull["explained_by"] for pull in table()["pulls"]] == [[], [], [], ["thermal_lag"]]
    assert diagnosis_of(table()).pulls == partial_diagnosis().pulls


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda x: st.lists(x) | st.dictionaries(st.text(), x),
    max_leaves=5,
)


@given(key=st.sampled_from(sorted(partial_diagnosis().as_json())), value=_JSON)
@settings(max_examples=examples(60), deadline=None)
def test_any_value_is_read_back_or_refused_by_the_name_of_its_field(key: str, value: object) -> None:
    """A value is either read back as it is or refused with a LogError that names its field."""
    given = {**table(), key: value}
    try:
        result = diagnosis_of(given).as_json()[key]
    except LogError as error:
        assert key in str(error)
    else:
        assert json.dumps(result) in (json.dumps(value), json.dumps(table()[key]))

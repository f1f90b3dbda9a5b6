"""Effects as tables of plain numbers and texts, and back."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import Field, fields
from typing import Any

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imuarray.errors import ConfigError
from imuarray.simulate.effect import Effect, from_table, numbers, spelled, to_table
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.readings import Stuck
from imuarray.simulate.effects.response import AxisError, GSensitivity, Misalignment, Nonlinearity
from imuarray.simulate.effects.timing import ClockError
from tests.selection import examples, some

UNITS = ("g", "dps", "gauss")
TEXTS = ("", "+X+Y+Z", "-Y+X+Z", "spike", "torn", "word", "BMA2")


class TestSpelled:
    def test_keys_contain_the_units(self) -> None:
        assert list(spelled(Nonlinearity, "g")) == ["quadratic_per_g", "cubic_per_g2", "spans"]
        assert list(spelled(GSensitivity, "dps")) == ["response_dps_per_g", "spans"]
        assert list(spelled(Bias, "gauss")) == ["offset_gauss", "from_boot", "spans"]
        assert list(spelled(Stuck, "g")) == [
            "onset_s",
            "duration_s",
            "every_s",
            "kind",
            "runs",
            "moments_s",
            "lengths_s",
            "readings_g",
            "stuck_axes",
            "spans",
        ]

    @pytest.mark.parametrize("unit", UNITS)
    def test_each_parameter_has_one_key(self, unit: str) -> None:
        for name, effect in EFFECTS.items():
            result = spelled(effect, unit)
            assert [item.name for item in result.values()] == [*(item.name for item in fields(effect)[1:]), "spans"], (
                name
            )
            assert not any("{" in key for key in result), name


class TestToTable:
    @pytest.mark.parametrize(
        ("effect", "table"),
        [
            (Bias((1, 2, 3)), {"offset_g": [1.0, 2.0, 3.0]}),
            (Bias((2, 2, 2)), {"offset_g": 2.0}),
            (Nonlinearity(cubic=0.5), {"cubic_per_g2": 0.5}),
            (Misalignment((1.0,) * 6), {"angles_deg": [1.0] * 6}),
            (AxisError("-X+Y+Z"), {"axes": "-X+Y+Z"}),
            (Stuck(3), {"onset_s": 3.0}),
            (Stuck(3, 4), {"onset_s": 3.0, "duration_s": 4.0}),
        ],
    )
    def test_a_table_contains_only_values_other_than_defaults(self, effect: Effect, table: dict[str, object]) -> None:
        assert to_table(effect, "g") == table

    def test_an_effect_with_defaults_is_an_empty_table(self) -> None:
        """Infinities and nan are defaults of some: no table of JSON could hold them."""
        assert [name for name, effect in EFFECTS.items() if to_table(effect(), "g")] == []


class TestFromTable:
    def test_a_number_applies_to_three_axes(self) -> None:
        assert from_table(Bias, {"offset_dps": 1}, "dps", "here") == Bias((1.0, 1.0, 1.0))
        assert from_table(Bias, {"offset_dps": [1, 2.5, 3]}, "dps", "here") == Bias((1.0, 2.5, 3.0))

    def test_missing_parameters_have_their_defaults(self) -> None:
        assert from_table(Nonlinearity, {"cubic_per_g2": 2.0}, "g", "here") == Nonlinearity(0.0, 2.0)
        assert from_table(Stuck, {}, "g", "here") == Stuck(math.inf, math.inf)

    @pytest.mark.parametrize(
        ("kind", "table", "message"),
        [
            (Bias, {"offset": 1.0}, "offset: unknown key (did you mean 'offset_g'?); allowed are offset_g, from_boot"),
            (Bias, {"offset_dps": 1.0}, "offset_dps: unknown key (did you mean 'offset_g'?); allowed are offset_g"),
            (Nonlinearity, {"zzz": 1.0}, "zzz: unknown key; allowed are quadratic_per_g, cubic_per_g2, spans"),
            (Bias, {"offset_g": [1, 2]}, "offset_g: [1, 2]: a number, or a list of 3, is required"),
            (Bias, {"offset_g": "1"}, "offset_g: '1': a number, or a list of 3, is required"),
            (Bias, {"offset_g": [1, 2, "3"]}, "offset_g: [1, 2, '3']: a number, or a list of 3, is required"),
            (Bias, {"offset_g": math.nan}, "offset_g: nan; a number or one for each of x, y, z is required"),
            (Bias, {"offset_g": -math.inf}, "offset_g: -inf; finite numbers are required"),
            (Bias, {"offset_g": [0.0, math.inf, 0.0]}, "offset_g: [0.0, inf, 0.0]; finite numbers are required"),
            (Misalignment, {"angles_deg": 1.0}, "angles_deg: 1.0: a list of 6 numbers is required"),
            (Misalignment, {"angles_deg": [99] * 6}, "angles_deg: 99.0; allowed is -80 to 80"),
            (GSensitivity, {"response_g_per_g": [1] * 8}, "response_g_per_g: [1, 1, 1, 1, 1, 1, 1, 1]: a list of 9"),
            (GSensitivity, {"response_g_per_g": [math.nan] * 9}, "response_g_per_g: "),
            (ClockError, {"error_ppm": True}, "error_ppm: True: a number without quotes is required"),
            (ClockError, {"error_ppm": [1.0]}, "error_ppm: [1.0]: a number without quotes is required"),
            (ClockError, {"error_ppm": 1e7}, "error_ppm: 10000000.0; allowed is -500000 to 500000"),
            (AxisError, {"axes": 3}, "axes: 3: a text in quotes is required"),
            (AxisError, {"axes": "XYZ"}, "axes: 'XYZ'; each of X, Y, Z once, signed, such as '+Y+X-Z'"),
        ],
    )
    def test_a_refusal_names_place_and_key(self, kind: type[Effect], table: dict[str, object], message: str) -> None:
        with pytest.raises(ConfigError) as caught:
            from_table(kind, table, "g", "model.toml: sensor 'BMA1'")
        assert str(caught.value).startswith(f"model.toml: sensor 'BMA1': {message}")

    def test_a_long_value_is_not_printed_whole(self) -> None:
        with pytest.raises(ConfigError) as caught:
            from_table(Bias, {"offset_g": [0.0] * 1000}, "g", "here")
        assert len(str(caught.value)) < 120


def test_numbers_must_be_finite_and_of_the_required_count() -> None:
    assert numbers("angles", [1, 2], 2) == (1.0, 2.0)
    for wrong in ((1.0,), (1.0, math.inf), ((1.0, 2.0),)):
        with pytest.raises(ValueError, match=r"^angles: .*; 2 finite numbers are required$"):
            numbers("angles", wrong, 2)


def effects(name: str) -> st.SearchStrategy[Effect]:
    """The effect with any parameters that it accepts."""
    kind = EFFECTS[name]
    return st.fixed_dictionaries({}, optional={item.name: _values(kind, item) for item in fields(kind)}).flatmap(
        lambda chosen: st.just(kind(**chosen)) if _accepted(kind, chosen) else st.nothing()
    )


def _values(kind: type[Effect], item: Field[Any]) -> st.SearchStrategy[Any]:
    number = st.floats(allow_nan=False) | st.floats(0, 1) | st.floats(1, 80) | st.integers(0, 3)
    if isinstance(item.default, str):
        values: st.SearchStrategy[Any] = st.sampled_from(TEXTS)
    elif isinstance(item.default, tuple):
        several = st.tuples(*[st.floats(-80, 80)] * len(item.default))
        values = several | number if item.metadata.get("per_axis") else several
    else:
        values = number
    return values.filter(lambda value: _accepted(kind, {item.name: value}))


def _accepted(kind: type[Effect], parameters: dict[str, Any]) -> bool:
    try:
        kind(**parameters)
    except ValueError:
        return False
    return True


def same(first: Effect, other: Effect) -> bool:
    """Equal, a nan being equal to a nan."""
    pairs = [(getattr(first, item.name), getattr(other, item.name)) for item in fields(first)]
    return type(first) is type(other) and all(a == b or (a != a and b != b) for a, b in pairs)


@pytest.mark.parametrize("name", some(EFFECTS, 11))
@settings(max_examples=examples(10), suppress_health_check=[HealthCheck.filter_too_much])  # some refuse most numbers
@given(data=st.data(), unit=st.sampled_from(UNITS))
def test_parameters_round_trip_through_tables(name: str, data: st.DataObject, unit: str) -> None:
    effect = data.draw(effects(name))
    table = to_table(effect, unit)
    assert same(from_table(EFFECTS[name], table, unit, "here"), effect)
    assert same(from_table(EFFECTS[name], tomllib.loads(tomli_w.dumps(table)), unit, "here"), effect)
    assert same(from_table(EFFECTS[name], json.loads(json.dumps(table)), unit, "here"), effect)

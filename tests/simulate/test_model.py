"""Model files: the table of a sensor's effects, random draws, and the messages of refusals."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import tomli_w
from hypothesis import example, given, settings
from hypothesis import strategies as st

from imuarray.errors import ConfigError
from imuarray.log.format import SensorHeader
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.response import Scale
from imuarray.simulate.model import Model, load_model, parse_model
from imuarray.simulate.streams import Streams
from tests.selection import examples

MakeSensor = Callable[..., SensorHeader]

GOOD = """
[model]
name = "small"
about = "two accelerometers and a gyroscope"

[[design]]
chip = "bma180"
[design.bias]
offset_g = 0.1
[design.scale]
error = { sigma = 0.01, limit = 0.02 }
[design.white_noise]
rms_g = [0.01, 0.02, 0.03]

[[design]]
chip = "bma180"
range = 16
[design.bias]
offset_g = 0.16
[design.white_noise]
rms_g = 0.016

[[design]]
chip = "l3g4200d"
noise_bandwidth_hz = 50
[[design.tone]]
amplitude_dps = 1.0
frequency_hz = 50.0
phase_deg = 0.0
[[design.tone]]
amplitude_dps = { mean = 2.0, sigma = 0.1 }
frequency_hz = { mean = 100.0, sigma = 0.1 }
phase_deg = 90.0

[[sensor]]
name = "BMA1"
chip = "bma180"
[sensor.white_noise]
rms_g = 0.5
[sensor.bias]
offset_g = [1.0, 2.0, 3.0]

[[sensor]]
name = "BMA1"
chip = "bma180"
range = 16
[sensor.bias]
offset_g = [-0.18, -0.25, 0.02]
"""


def kinds(effects: tuple[Effect, ...]) -> list[str]:
    return [effect.name for effect in effects]


def effect_of(kind: type[Effect], effects: tuple[Effect, ...]) -> Effect:
    (result,) = (effect for effect in effects if isinstance(effect, kind))
    return result


def drawn(text: str, sensor: SensorHeader, seed: int = 1, **how: bool) -> tuple[Effect, ...]:
    return parse_model(text).effects(sensor, Streams(seed), **how)


@pytest.mark.parametrize(
    ("name", "range_", "population", "bias", "noise"),
    [
        ("BMA1", 16.0, False, (-0.18, -0.25, 0.02), 0.5),
        ("BMA1", 2.0, False, (1.0, 2.0, 3.0), 0.5),
        ("BMA2", 16.0, False, (0.16, 0.16, 0.16), 0.016),
        ("BMA2", 2.0, False, (0.1, 0.1, 0.1), 0.01),
        ("BMA1", 16.0, True, (0.16, 0.16, 0.16), 0.016),
        ("BMA1", 2.0, True, (0.1, 0.1, 0.1), 0.01),
    ],
)
def test_an_effect_is_taken_from_the_most_specific_table(
    sensor: MakeSensor, name: str, range_: float, population: bool, bias: object, noise: float
) -> None:
    effects = drawn(GOOD, sensor("bma180", name, range_), population=population)
    assert kinds(effects) == ["scale", "bias", "white_noise"]  # in physical order, not the file's
    assert effect_of(Bias, effects) == Bias(bias)  # type: ignore[arg-type]
    result = effect_of(WhiteNoise, effects)
    assert isinstance(result, WhiteNoise)
    assert result.rms[0] == noise


def test_a_sensor_table_applies_only_to_its_chip(sensor: MakeSensor) -> None:
    assert kinds(drawn(GOOD, sensor("l3g4200d", "BMA1"))) == ["tone", "tone"]
    assert drawn(GOOD, sensor("adxl345", "BMA1")) == ()


def test_name_text_and_tables_of_a_model_are_kept() -> None:
    model = parse_model(GOOD)
    assert (model.name, model.about, model.text) == ("small", "two accelerometers and a gyroscope", GOOD)
    assert [(part.chip, part.range) for part in model.designs] == [
        ("bma180", None),
        ("bma180", 16.0),
        ("l3g4200d", None),
    ]
    assert [(part.name, part.range) for part in model.sensors] == [("BMA1", None), ("BMA1", 16.0)]


def test_effects_of_a_kind_are_drawn_independently(sensor: MakeSensor) -> None:
    first, second = drawn(GOOD, sensor("l3g4200d", "Gyro1"))
    assert first == Tone(1.0, 50.0, 0.0)  # type: ignore[arg-type]
    assert isinstance(second, Tone)
    away = [
        (value - mean) / 0.1 for value, mean in ((second.frequency_hz, 100.0), *((a, 2.0) for a in second.amplitude))
    ]
    assert len({round(deviate, 9) for deviate in away}) == 4  # axes and parameters draw apart too
    twice = GOOD.replace("amplitude_dps = 1.0", "amplitude_dps = { mean = 2.0, sigma = 0.1 }")
    again, other = drawn(twice, sensor("l3g4200d", "Gyro1"))
    assert isinstance(again, Tone)
    assert isinstance(other, Tone)
    assert again.amplitude != other.amplitude == second.amplitude


def test_leaving_out_an_entry_changes_no_other_draw(sensor: MakeSensor) -> None:
    """Neither an effect, by name or from the file, nor another parameter, nor another sensor."""
    header = sensor("bma180", "BMA7", 2.0)
    spread = GOOD.replace("offset_g = 0.1\n", "offset_g = { sigma = 0.1 }\n")
    scale, bias, noise = drawn(spread, header)
    model = parse_model(spread)
    assert model.effects(header, Streams(1), without=frozenset({"bias"})) == (scale, noise)
    assert model.effects(header, Streams(1), without=frozenset({"scale", "white_noise"})) == (bias,)
    assert drawn(spread.replace("[design.bias]\noffset_g = { sigma = 0.1 }", ""), header) == (scale, noise)
    assert drawn(spread.split("[[sensor]]")[0], header) == (scale, bias, noise)
    assert drawn(spread, header, seed=2)[0] != scale
    assert model.effects(header, Streams(1, boot=3)) == (scale, bias, noise)  # a unit is the same in all its runs


@pytest.mark.parametrize(
    ("chip", "settings_of", "at_hz", "printed", "expected", "tolerance"),
    [
        ("bma180", {"bandwidth_hz": 1200.0}, 150, 1.8371, 5.196, 1e-3),  # BMA-110: 5.2 mg (PAP-05)
        ("bma180", {"bandwidth_hz": 150.0}, 150, 1.8371, 1.8371, 1e-9),
        ("l3g4200d", {"bandwidth_hz": 110.0}, 25, 0.15, 0.315, 2e-3),  # L3G-74
        ("adxl345", {"rate_hz": 100.0, "bandwidth_hz": 0.0}, 50, 0.75, 0.75, 1e-9),  # ADX-67
        ("adxl345", {"rate_hz": 400.0, "bandwidth_hz": 0.0}, 50, 0.75, 1.5, 1e-9),  # ADX-68
        ("adxl345", {"rate_hz": 3200.0, "bandwidth_hz": 0.0}, 50, 1.1, 6.2, 1e-2),  # ADX-68
        ("adxl345", {"rate_hz": 12.5, "bandwidth_hz": 0.0}, 50, 0.75, 0.75, 1e-9),  # ADX-68
        ("hmc5883", {"bandwidth_hz": 0.0}, 50, 2.0, 2.0, 1e-9),  # it has none that is known
    ],
)
def test_noise_scales_with_the_root_of_the_bandwidth(
    sensor: MakeSensor,
    chip: str,
    settings_of: dict[str, float],
    at_hz: float,
    printed: float,
    expected: float,
    tolerance: float,
) -> None:
    header = sensor(chip, "S", **settings_of)
    head = f'[model]\nname = "m"\n[[design]]\nchip = "{chip}"\n'
    noise = f"white_noise.rms_{header.unit} = {printed}\n"
    assert effect_of(WhiteNoise, drawn(head + noise, header)) == WhiteNoise(printed)  # type: ignore[arg-type]
    result = effect_of(WhiteNoise, drawn(head + f"noise_bandwidth_hz = {at_hz}\n" + noise, header))
    assert isinstance(result, WhiteNoise)
    assert result.rms == pytest.approx((expected,) * 3, rel=tolerance)


def changed(before: str, after: str) -> str:
    assert before in GOOD
    return GOOD.replace(before, after, 1)


REFUSED = {
    "unknown effect": (
        changed("[design.bias]", "[design.bais]"),
        r"design 1: bais: unknown key \(did you mean 'bias'\?\); allowed are chip, unit, range, noise_bandw",
    ),
    "unknown parameter": (
        changed("offset_g", "ofset_g"),
        r"design 1: bias: ofset_g: unknown key \(did you mean 'offset_g'\?\); allowed are offset_g, from_boot, spans$",
    ),
    "another sensor's unit": (
        changed("amplitude_dps", "amplitude_g"),
        r"design 3: tone: amplitude_g: unknown key \(did you mean 'amplitude_dps'\?\)",
    ),
    "unknown key of a population": (
        changed("sigma", "sigmas"),
        r"design 1: scale: error: sigma: is missing; sigmas: unknown key \(did you mean 'sigma'\?\)",
    ),
    "unknown table": (GOOD.replace("[sensor", "[sensors"), "sensors: unknown key .did you mean 'sensor'"),
    "unknown chip": (
        changed('chip = "bma180"', 'chip = "bma181"'),
        "design 1: chip 'bma181': allowed are adxl345, bma180, .*, hmc5883; another chip needs a unit",
    ),
    "another unit than the chip's": (
        changed('chip = "bma180"', 'chip = "bma180"\nunit = "dps"'),
        "design 1: unit 'dps': the bma180 measures in g$",
    ),
    "a range that nobody knows": (
        GOOD + '[[design]]\nchip = "mpu9150"\nunit = "g"\n[design.range_reset]\nrange_g = 2\n',
        "design 4: range_reset: range_g: the ranges of a mpu9150 are not known$",
    ),
    "a chip without effects": (changed('chip = "bma180"', 'chip = "bmp180"'), "design 1: chip 'bmp180': allowed are"),
    "unknown range": (
        changed("range = 16", "range = 6"),
        "design 2: range 6: allowed for bma180 are 1, 1.5, 2, 3, 4, 8, 16$",
    ),
    "no range": (changed("range = 16", "range = nan"), "design 2: range: "),
    "range to fall into": (
        changed("[design.bias]", "[design.range_reset]\nrange_g = 5\n[design.bias]"),
        "design 1: range_reset: range_g: 5: allowed for bma180 are 1, 1.5, 2",
    ),
    "no bandwidth": (changed("noise_bandwidth_hz = 50", "noise_bandwidth_hz = 0"), "design 3: noise_bandwidth_hz: "),
    "one design twice": (changed("range = 16", ""), "2 tables of design bma180 with no range; one is allowed"),
    "one unit twice": (
        GOOD + '[[sensor]]\nname = "BMA1"\nchip = "bma180"\nrange = 16\n',
        "2 tables of sensor 'BMA1' with range 16; one is allowed",
    ),
    "a unit without a name": (changed('name = "BMA1"\n', ""), "sensor 1: name: is missing"),
    "a strange name": (changed('name = "BMA1"', 'name = "BMA 1"'), "sensor 1 'BMA 1': name: "),
    "no model": (changed('[model]\nname = "small"', "[modell]"), "model: is missing; modell: unknown key"),
    "a number for an effect": (
        changed("[design.bias]\noffset_g = 0.1", "bias = 0.1"),
        r"design 1: bias: a table such as \[design.bias\] is required",
    ),
    "two numbers for three axes": (
        changed("[0.01, 0.02, 0.03]", "[0.01, 0.02]"),
        r"design 1: white_noise: rms_g: \[0.01, 0.02\]: a number, or a list of 3, is required",
    ),
    "two populations for three axes": (
        changed("[0.01, 0.02, 0.03]", "[0.01, { sigma = 0.02 }]"),
        "design 1: white_noise: rms_g: .* a list of 3",
    ),
    "a population of texts": (
        changed("[design.bias]", "[design.axis_error]\naxes = { sigma = 1.0 }\n[design.bias]"),
        "design 1: axis_error: axes: 0.0: a text in quotes is required",
    ),
    "a unit that could not be": (
        changed("[design.bias]", "[design.jitter]\nrms_s = { mean = 0.001, sigma = 0.001 }\n[design.bias]"),
        "design 1: jitter, lowest draw: rms_s: -0.002",
    ),
    "a probability that could not be": (
        changed("[design.bias]", "[design.stale_samples]\nprobability = { mean = 0.9, sigma = 0.1 }\n[design.bias]"),
        "design 1: stale_samples, highest draw: probability: 1.2",
    ),
    "not a number": (changed("offset_g = 0.16", "offset_g = nan"), "design 2: bias: offset_g: nan"),
    "huge": (changed("offset_g = 0.16", "offset_g = 1e300"), "design 2: bias: offset_g: a number beyond"),
    "huge whole number": (changed("offset_g = 0.16", f"offset_g = 1{'0' * 400}"), "design 2: bias: offset_g: a number"),
    "more digits than are read": (changed("offset_g = 0.16", f"offset_g = 1{'0' * 5000}"), "not TOML: "),
    "deep lists": (changed("offset_g = 0.16", f"offset_g = {'[' * 50_000}"), "not TOML: "),
    "deep tables": (changed("name = ", f"name{'.a' * 3_000} = "), "tables nested without end"),
    "not TOML": (changed("[[design]]", "[[design]"), "not TOML: "),
    "a line break in a key": (changed("offset_g", '"off\\nset"'), r"design 1: bias: 'off\\nset': unknown key"),
}


@pytest.mark.parametrize(("text", "complaint"), REFUSED.values(), ids=REFUSED)
def test_a_refusal_is_one_line_that_names_the_place(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_model(path)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) < 2000
    rest = re.sub(re.escape(str(path)) + r"(:\d+)?: ", "", message)
    with pytest.raises(ConfigError, match=f"^{complaint}"):
        raise ConfigError(rest)


def test_all_mistakes_in_effects_name_their_lines(tmp_path: Path) -> None:
    text = GOOD.replace("offset_g = 0.16", 'offset_g = "a"').replace("phase_deg = 90.0", "phase = 90.0")
    text = text.replace("[1.0, 2.0, 3.0]", "[1.0, 2.0]")
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        load_model(path)
    lines = text.splitlines()
    expected = {
        lines.index('offset_g = "a"') + 1: "design 2: bias: offset_g: ",
        lines.index("phase = 90.0") + 1: "design 3: tone: phase: unknown key",
        lines.index("offset_g = [1.0, 2.0]") + 1: "sensor 1 'BMA1': bias: offset_g: ",
    }
    mistakes = str(refused.value).split(f"; {path}")
    assert len(mistakes) == 3
    for mistake, (line, words) in zip(mistakes, expected.items(), strict=True):
        assert mistake.removeprefix(str(path)).startswith(f":{line}: {words}")


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, len(GOOD) - 1), st.binary(max_size=6), st.integers(0, 20))
@example(0, b"\xff\xfe", 0)
def test_a_damaged_file_is_read_or_refused(place: int, inserted: bytes, removed: int) -> None:
    """Bytes overwritten at a random place: never another exception than ours."""
    good = GOOD.encode()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "mine.toml"
        path.write_bytes(good[:place] + inserted + good[place + removed :])
        try:
            load_model(path)
        except ConfigError as error:
            assert str(error).startswith(str(path))
            assert "\n" not in str(error)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: No such file"):
        load_model(tmp_path / "none.toml")


NUMBERS = st.floats(0, 10)
SPREADS = st.fixed_dictionaries(
    {"mean": st.floats(-10, 10), "sigma": NUMBERS}, optional={"limit": NUMBERS, "shared": st.floats(0, 1)}
)
FIGURES = st.one_of(NUMBERS, SPREADS, st.lists(NUMBERS | SPREADS, min_size=3, max_size=3))
SIZES = st.one_of(NUMBERS, st.fixed_dictionaries({"mean": st.floats(5, 10), "sigma": st.floats(0, 1)}))
"""Figures that can't come out negative: within three sigma."""
TABLES = st.fixed_dictionaries(
    {"chip": st.just("bma180")},
    optional={
        "noise_bandwidth_hz": st.floats(1, 1e4),
        "bias": st.fixed_dictionaries({"offset_g": FIGURES}),
        "white_noise": st.lists(st.fixed_dictionaries({"rms_g": SIZES}), min_size=1, max_size=3),
        "tone": st.fixed_dictionaries({"frequency_hz": NUMBERS, "amplitude_g": NUMBERS}),
        "axis_error": st.just({"axes": "-X+Y+Z"}),
    },
)


@settings(max_examples=examples(50), deadline=None)
@given(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1),
    st.lists(TABLES, max_size=7),
    st.lists(TABLES, max_size=3),
)
def test_a_model_round_trips(name: str, designs: list[dict[str, object]], sensors: list[dict[str, object]]) -> None:
    ranges = (1, 1.5, 2, 3, 4, 8, 16)
    table = {
        "model": {"name": name, "about": name},
        "design": [{**design, "range": range_} for design, range_ in zip(designs, ranges, strict=False)],
        "sensor": [{**unit, "name": f"S{number}"} for number, unit in enumerate(sensors)],
    }
    model = parse_model(tomli_w.dumps(table))
    again = parse_model(model.to_toml())
    assert again == model
    assert again.to_toml() == model.to_toml()
    assert len(again.designs) == len(designs)


def test_an_empty_model_has_no_effects(sensor: MakeSensor) -> None:
    model = Model("empty", "", (), ())
    assert parse_model(model.to_toml()) == model
    assert model.effects(sensor(), Streams(0)) == ()


def test_every_effect_can_be_in_a_file(sensor: MakeSensor) -> None:
    """Without parameters each does nothing, and all come in the order of EFFECTS."""
    text = '[model]\nname = "all"\n[[design]]\nchip = "bma180"\n' + "".join(
        f"{name} = {{}}\n" for name in reversed(EFFECTS)
    )
    assert drawn(text, sensor()) == tuple(kind() for kind in EFFECTS.values())
    assert Scale() in drawn(text, sensor())

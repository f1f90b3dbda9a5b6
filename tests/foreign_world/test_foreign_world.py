"""The generator is independent, repeatable and plausible; it is checked by closed forms of the data sheets."""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.log import open_log
from tests.foreign_world.cases import HALVES, KINDS, draw_case, draw_placement, main, truth_of, write_case
from tests.foreign_world.chain import code_span, record
from tests.foreign_world.deeds import Placement, When
from tests.foreign_world.effects import DESIGN_NAMES, EFFECTS, UNKNOWN
from tests.foreign_world.parts import CHIPS, Part, Sensor
from tests.foreign_world.severity import THRESHOLD, limit
from tests.foreign_world.stimulus import FACES, Site
from tests.foreign_world.stimulus import Path as BoxPath
from tests.foreign_world.world import Experiment, World, axes_names, draw_world
from tests.selection import some

VOCABULARY = {
    "white_noise",
    "bias_instability",
    "random_walk",
    "popcorn_noise",
    "bandwidth",
    "tone",
    "bias",
    "scale",
    "misalignment",
    "axis_error",
    "nonlinearity",
    "g_sensitivity",
    "thermal_bias",
    "thermal_scale",
    "thermal_lag",
    "quantisation",
    "saturation",
    "stale_samples",
    "glitches",
    "stuck",
    "turn_on_bias",
    "bistable_bias",
    "range_reset",
    "clock_error",
    "jitter",
    "dropped_samples",
    "skew",
    "odr_error",
    "common_mode",
    "size_effect",
    "channel_swap",
    "own_clock",
    "thermometer",
}
G = 9.80665


def ideal(sensor: Sensor, density: object, order: int = 2) -> Part:
    zero = np.zeros(3)
    return Part(
        scale=zero,
        matrix=np.eye(3),
        bias=zero,
        bias_slope=zero,
        scale_slope=zero,
        quadratic=zero,
        cubic=zero,
        noise_density=np.full(3, density) if np.isscalar(density) else np.asarray(density),
        turn_on_sigma=0.0,
        clock_error=0.0,
        filter_order=order,
        thermometer_zero_k=0.0,
        thermometer_slope=0.0,
        thermometer_noise_k=0.0,
        lag_s=0.1,
        self_heating_k=0.0,
        extra={"full_scale": 1.0},
    )


def still_world(
    sensor: Sensor, density: object, rate_hz: float, seconds: float = 100.0, rise_k: float = 0.0, order: int = 2
) -> World:
    """A box that lies still on its underside where gravity is standard, with an ideal part that has only noise."""
    drawn = draw_world("still")
    path = BoxPath(np.random.default_rng(0), 0.0)
    path.hold(path.pose("+Z"), seconds, "static", "+Z")
    stimulus = path.stimulus(Site(G, 0.0, 0.5, 0.0), np.linspace(24, 24 + rise_k, path.rows))
    recorder = replace(drawn.recorder, frame_rate_hz=rate_hz, delay_chance=0.0, has_thermometers=True)
    experiment = Experiment("static", "static", stimulus, 1800.0, 0)
    return replace(
        drawn,
        sensors=(sensor,),
        parts={sensor.name: ideal(sensor, density, order)},
        recorder=recorder,
        experiments=(experiment,),
    )


def sensor_of(chip: str, range_: float, rate_hz: float, bandwidth_hz: float) -> Sensor:
    return Sensor("S", chip, 0, CHIPS[chip].addresses[0], range_, rate_hz, bandwidth_hz, "+X+Y+Z", (0.0, 0.0, 0.0))


def test_nothing_but_numpy_h5py_and_the_standard_library_is_imported() -> None:
    allowed = set(sys.stdlib_module_names) | {"numpy", "h5py"}
    modules = [path for path in Path(__file__).parent.glob("*.py") if not path.name.startswith("test_")]
    assert len(modules) >= 8
    for path in modules:
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0
                names = [node.module or ""]
            for name in names:
                assert name.split(".")[0] in allowed or name.startswith("tests.foreign_world"), f"{path.name}: {name}"
            assert not (isinstance(node, ast.Name) and node.id in ("__import__", "exec", "eval")), path.name


@pytest.mark.slow
@pytest.mark.parametrize("index", some(range(4), 1))
def test_logs_open(tmp_path: Path, index: int) -> None:
    case = draw_case("development", 0, "control", index)
    for path, experiment in zip(write_case(case, tmp_path), case.world.experiments, strict=True):
        with open_log(path) as log:
            assert set(log.sensors) >= {sensor.name for sensor in case.world.sensors}
            assert len(log.phases) == (len(experiment.stimulus.phases) if case.world.recorder.labels_phases else 0)
            assert (log.truth is not None) == (case.world.recorder.track == "truth")
            assert (log.reference is not None) == (case.world.recorder.track == "reference")
            for sensor in case.world.sensors:
                rows = log[sensor.name]
                assert (np.diff(rows.time[:]) > 0).all()
                low, high = code_span(sensor)
                assert rows.counts[:].min() >= low
                assert rows.counts[:].max() <= high
                seconds = (rows.time[-1] - rows.time[0]) / 1e9
                poll_rate = case.world.recorder.frame_rate_hz / sensor.divider
                assert (len(rows) - 1) / seconds == pytest.approx(poll_rate, rel=2e-3)


def contents(path: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, at: (
                found.update({name: bytes(repr(at[()].tolist()), "utf-8")}) if isinstance(at, h5py.Dataset) else None
            )
        )
    return found


@pytest.mark.slow
def test_a_seed_gives_the_same_data_and_the_halves_differ(tmp_path: Path) -> None:
    texts = []
    for folder, half in (("a", "development"), ("b", "development"), ("c", "sealed")):
        main(
            [
                str(tmp_path / folder),
                "--half",
                half,
                "--seed",
                "4",
                "--count",
                "1",
                "--kind",
                "effect",
                "--effect",
                "bias_step",
            ]
        )
        logs = sorted((tmp_path / folder / "000").glob("*.h5"))
        texts.append(
            (json.loads((tmp_path / folder / "sealed" / "000.json").read_text()), [contents(log) for log in logs])
        )
    assert texts[0] == texts[1]
    assert texts[0][1] != texts[2][1]
    assert HALVES == ("development", "sealed")


@pytest.mark.slow
def test_faces_show_gravity_within_the_scale_tolerance() -> None:
    seen = 0
    for number in range(12):
        world = draw_world(f"gravity {number}")
        assert 9.78 <= world.site.gravity <= 9.833
        for log, experiment in enumerate(world.experiments):
            if experiment.kind != "tumble":
                continue
            for sensor in world.inertial:
                if sensor.facts.quantity != "specific_force" or sensor.range < 2:
                    continue
                rows = record(world, sensor, log)
                means = {}
                for phase in experiment.stimulus.phases:
                    inside = (rows.stamp > phase.start_s + 0.5) & (rows.stamp < phase.end_s - 0.5)
                    means[phase.up] = rows.codes[inside].mean(axis=0) @ sensor.orientation.T / sensor.sensitivity * G
                for axis, letter in enumerate("XYZ"):
                    half = (means[f"+{letter}"] - means[f"-{letter}"])[axis] / 2
                    assert half == pytest.approx(world.site.gravity, rel=0.05), (number, sensor)
                    seen += 1
    assert seen > 10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("chip", "range_", "rate", "bandwidth", "density", "codes"),
    [
        # density * sqrt(bandwidth * pi / (2 sqrt 2)) * counts per unit, and the rounding's 1/12, worked out by hand
        ("bma180", 2, 2400, 150, 150e-6 * G, 7.94),  # 150 ug/sqrt(Hz): 1.936 mg at 4096 per g
        ("bma180", 2, 2400, 20, 150e-6 * G, 2.91),  # 0.707 mg
        ("l3g4200d", 500, 400, 50, np.radians(0.03), 12.78),  # 0.03 dps/sqrt(Hz): 0.2236 dps at 57.14 per dps
        ("adxl345", 16, 100, 50, 290e-6 * G, 0.599),  # 290 ug/sqrt(Hz) over 50 Hz: 2.051 mg, 0.525 codes
    ],
)
def test_noise_is_the_density_over_the_bandwidth(
    chip: str, range_: float, rate: float, bandwidth: float, density: float, codes: float
) -> None:
    world = still_world(sensor_of(chip, range_, rate, bandwidth), density, 100.0, 200.0)
    rows = record(world, world.sensors[0], 0)
    assert rows.codes.std(axis=0) == pytest.approx(codes, rel=0.06)


def test_one_g_is_the_typical_sensitivity() -> None:
    world = still_world(sensor_of("bma180", 2, 2400, 150), 150e-6 * G, 100.0)
    assert record(world, world.sensors[0], 0).codes.mean(axis=0) == pytest.approx([0, 0, 4096], abs=0.6)


def test_every_code_occurs_until_only_even_ones_do() -> None:
    world = still_world(sensor_of("bma180", 2, 2400, 150), 150e-6 * G, 100.0)
    codes = record(world, world.sensors[0], 0).codes
    assert set(np.unique(np.diff(np.unique(codes[:, 0]))[3:-3])) == {1.0}
    place = Placement(("S",), (0, 1, 2), When("always"), "even")
    even = record(world, world.sensors[0], 0, EFFECTS["even_codes"].acts(place, 2)["S"]).codes
    assert not (even % 2).any()


def test_a_chip_polled_twice_as_fast_repeats_every_second_reading() -> None:
    world = still_world(sensor_of("adxl345", 16, 100, 50), 290e-6 * G, 200.0)
    rows = record(world, world.sensors[0], 0)
    assert rows.stale.mean() == pytest.approx(0.5, abs=0.01)
    assert (rows.codes[1:][rows.stale[1:]] == rows.codes[:-1][rows.stale[1:]]).all()


def test_the_thermometers_count_half_kelvins_and_falling_kelvins() -> None:
    warm = still_world(sensor_of("bma180", 2, 2400, 150), 150e-6 * G, 50.0, rise_k=10.0)
    codes = record(warm, warm.sensors[0], 0).thermometer
    assert (codes[0], codes[-1]) == (0, 20)  # code 0 at 24 degC, 0.5 K per code (BMA-63)
    falling = still_world(sensor_of("l3g4200d", 500, 400, 50), 5e-4, 50.0, rise_k=10.0)
    codes = record(falling, falling.sensors[0], 0).thermometer
    assert codes[-1] - codes[0] == pytest.approx(-10, abs=1)  # -1 per kelvin (L3G-60)
    assert len(np.unique(np.floor(np.flatnonzero(np.diff(codes)) / 50))) <= 11


@pytest.mark.slow
def test_parts_are_within_their_data_sheets() -> None:
    for number in range(40):
        world = draw_world(f"parts {number}")
        for sensor in world.inertial:
            part = world.parts[sensor.name]
            if sensor.chip == "bma180":
                assert np.abs(part.scale).max() <= 0.03
                assert abs(part.thermometer_zero_k) <= 5
                assert np.abs(part.bias).max() <= (0.46 if sensor.range >= 8 else 0.06) * G
                assert abs(part.clock_error) <= 0.1
            if sensor.chip == "adxl345":
                assert np.abs(part.scale).max() <= 0.10 + 9 / 256
                assert np.abs(part.bias).max() <= 0.28 * G
            if sensor.chip == "l3g4200d":
                assert np.abs(part.bias).max() <= np.radians(75)


def test_axes_are_the_24_right_handed_ones() -> None:
    assert len(set(axes_names())) == 24
    assert "+Y+X-Z" in axes_names()
    assert set(FACES.values()) == {"+X", "-X", "+Y", "-Y", "+Z", "-Z"}


def test_known_effects_bear_names_of_the_vocabulary() -> None:
    assert set(DESIGN_NAMES.values()) <= set(VOCABULARY)
    assert len(DESIGN_NAMES) >= 25
    assert len(UNKNOWN) >= 6
    assert KINDS == ("control", "effect", "unknown", "pair")


@pytest.mark.parametrize("name", some(sorted(EFFECTS), 4))
def test_an_effect_changes_the_sensors_that_it_concerns(name: str) -> None:
    effect = EFFECTS[name]
    for attempt in range(200):
        world = draw_world(f"effect {attempt}")
        slow = [sensor for sensor in world.inertial if sensor.rate_hz <= 800]
        place = draw_placement(world, name, f"{name}:{attempt}") if slow else None
        if place is None or not {s.name for s in slow} >= set(place.sensors) or world.duration_s > 500:
            continue
        sensor = next(s for s in world.sensors if s.name == place.sensors[0])
        size = effect.start if effect.unit != "SI" else 10 * float(world.parts[sensor.name].noise_density[0])
        acts = effect.acts(place, size)[sensor.name]
        pairs = (
            (record(world, sensor, log), record(world, sensor, log, acts)) for log in range(len(world.experiments))
        )
        if any((a.codes != b.codes).any() or (a.keep != b.keep).any() for a, b in pairs):
            return
    pytest.fail(f"{name} changes nothing")


def test_the_limit_of_a_line_is_that_of_a_matched_filter() -> None:
    # Amplitude a in n rows of white noise: ratio a * sqrt(n / 2) / sigma.
    world = still_world(sensor_of("adxl345", 16, 400, 200), 290e-6 * G, 100.0)
    place = Placement(("S",), (0,), When("always"), "line")
    sigma = np.hypot(290e-6 * G * np.sqrt(200), G / 256 / np.sqrt(12))
    expected = THRESHOLD * sigma * np.sqrt(2 / 10_000)
    assert limit(world, EFFECTS["vibration_line"], place) == pytest.approx(expected, rel=0.03)


@pytest.mark.slow
def test_the_truth_of_a_case_is_complete() -> None:
    case = draw_case("development", 0, "pair", 0)
    truth = json.loads(json.dumps(truth_of(case, "development", 0, 0)))
    assert len(truth["effects"]) == 2
    for effect in truth["effects"]:
        assert effect["design_name"] in VOCABULARY
        assert effect["sensors"]
        assert effect["severity"] is None or effect["severity"] >= 4.99

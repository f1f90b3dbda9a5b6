"""Properties of every effect: a table of harmful parameters, a table of the columns that they change."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.array import parse_array
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Misalignment
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.tumble import Tumble
from imuarray.simulate.sensor import Demand, SimulatedSensor
from imuarray.simulate.signal import Analog, BoxStimulus, Codes, Instants, Place
from imuarray.simulate.simulation import Simulation, plan_of
from imuarray.simulate.streams import CHUNK, Stream, Streams
from tests.selection import some

Row = Instants | BoxStimulus | Analog | Codes

HARMFUL: Mapping[str, Mapping[str, Any]] = {
    "clock_error": {"error_ppm": 500.0},
    "own_clock": {"rate_error": 0.03, "phase_deg": math.nan},
    "skew": {"delay_s": 0.02},
    "jitter": {"rms_s": 1e-3},
    "dropped_samples": {"probability": 0.3, "burst_rows": 5.0},
    "size_effect": {"position_mm": (12.0, -4.5, 3.0)},
    "thermal_lag": {"time_constant_s": 0.5},
    "axis_error": {"axes": "+Y+X+Z"},
    "misalignment": {"angles_deg": (1.0, -2.0, 0.5, 1.0, -1.0, 3.0)},
    "nonlinearity": {"quadratic": 0.01, "cubic": (0.0, 0.02, 0.0)},
    "scale": {"error": (0.01, -0.02, 0.03)},
    "thermal_scale": {"slope": 0.001},
    "g_sensitivity": {"response": (0.01, 0.02, 0.0, 0.0, -0.01, 0.0, 0.03, 0.0, 0.0)},
    "bias": {"offset": (0.1, -0.2, 0.3)},
    "turn_on_bias": {"rms": 0.05},
    "bistable_bias": {"offset": (0.1, 0.2, -0.3), "probability": 0.5},
    "thermal_bias": {"slope": 0.002, "quadratic": 1e-4},
    "bias_instability": {"rms": 0.01, "time_constant_s": 2.0},
    "random_walk": {"density": 0.001},
    "popcorn_noise": {"amplitude": 0.02, "switches_per_s": 5.0},
    "common_mode": {"rms": 0.01, "time_constant_s": 2.0},
    "tone": {"amplitude": 0.05, "frequency_hz": 7.3},
    "white_noise": {"rms": 0.02},
    "bandwidth": {"cutoff_hz": 15.0},
    "odr_error": {"rate_hz": 50.0, "bandwidth_hz": 600.0},
    "range_reset": {"range": 2.0, "offset": 0.1, "noise_share": 0.5, "onset_s": 1.0, "probability": 0.5},
    "quantisation": {"step_lsb": 4},
    "saturation": {"limit": 0.5},
    "thermometer": {"offset_degc": 2.0, "rms_degc": 0.3},
    "adaptive_range": {"threshold": 2.0, "hold_s": 0.03},
    "stale_samples": {"probability": 0.3},
    "glitches": {"probability": 0.2, "kind": "torn"},
    "stuck": {"onset_s": 0.5, "duration_s": 400.0},
    "channel_swap": {"sensor": "S2"},
}

CHANGED: Mapping[str, set[str]] = {
    "clock_error": {"Instants.instant_ns"},
    "own_clock": {"Instants.rate_hz", "Instants.phase"},
    "skew": {"Instants.instant_ns"},
    "jitter": {"Instants.instant_ns"},
    "dropped_samples": {"Instants.kept"},
    "size_effect": {"BoxStimulus.force_box"},
    "thermal_lag": {"BoxStimulus.temperature_degc"},
    "axis_error": {"Analog.value", "Analog.force_g"},
    "misalignment": {"Analog.value"},
    "nonlinearity": {"Analog.value"},
    "scale": {"Analog.value"},
    "thermal_scale": {"Analog.value"},
    "g_sensitivity": {"Analog.value"},
    "bias": {"Analog.value"},
    "turn_on_bias": {"Analog.value"},
    "bistable_bias": {"Analog.value"},
    "thermal_bias": {"Analog.value"},
    "bias_instability": {"Analog.value"},
    "random_walk": {"Analog.value"},
    "popcorn_noise": {"Analog.value"},
    "common_mode": {"Analog.value"},
    "tone": {"Analog.value"},
    "white_noise": {"Analog.noise", "Analog.white_rms"},
    "bandwidth": {"Analog.noise"},
    "odr_error": {"Instants.rate_hz", "Analog.noise", "Analog.rate_hz"},
    "range_reset": {"Analog.value", "Analog.noise", "Analog.sensitivity"},
    "quantisation": {"Analog.step", "Analog.highest"},  # -8192 is a multiple of four, 8191 isn't
    "saturation": {"Analog.value", "Analog.noise"},
    "thermometer": {"Analog.thermometer_degc"},
    "adaptive_range": {"Codes.counts"},
    "stale_samples": {"Codes.counts", "Codes.temperature_counts", "Codes.fresh"},
    "glitches": {"Codes.counts"},
    "stuck": {"Codes.counts", "Codes.temperature_counts", "Codes.fresh"},
    "channel_swap": {"Codes.counts", "Codes.temperature_counts", "Codes.fresh"},
}

RANDOM = {
    "own_clock",
    "jitter",
    "dropped_samples",
    "turn_on_bias",
    "bistable_bias",
    "bias_instability",
    "random_walk",
    "popcorn_noise",
    "common_mode",
    "tone",
    "white_noise",
    "range_reset",
    "thermometer",
    "stale_samples",
    "glitches",
}

ROWS = 300


class NotedStreams(Streams):
    """Streams that record requests."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.asked: list[tuple[str, ...]] = []

    def of_boot(self, *name: str, **options: Any) -> Stream:
        self.asked.append(name)
        return super().of_boot(*name, **options)


@dataclass(frozen=True)
class Bench:
    """Makes places, and rows [first, stop) as the input of each stage: lively ones, the same for any stretch."""

    make_place: Callable[..., Place]
    make_instants: Callable[..., Instants]
    make_analog: Callable[..., Analog]
    make_codes: Callable[..., Codes]
    motion: Any

    def place(self, **changes: Any) -> Place:
        return self.make_place(motion=self.motion, neighbour=self._neighbour, reaching=self._reaching, **changes)

    def stages(self, first: int, stop: int, dtype: npt.DTypeLike = np.float64) -> tuple[Row, ...]:
        rows = np.arange(first, stop)
        force_g = np.stack([np.sin(rows / 7), np.cos(rows / 11), 1 + 0.1 * np.sin(rows / 5)], axis=1).astype(dtype)
        noise = 0.02 * np.sin(rows[:, None] * (12.9, 78.2, 45.1))
        analog = self.make_analog(
            first, stop, value=force_g, noise=noise, dtype=dtype, force_g=force_g[:, ::-1] * force_g.dtype.type(0.5)
        )
        warm = (25 + rows / 100).astype(dtype)
        return (
            self.make_instants(first, stop),
            self.motion.stimulus(self.make_instants(first, stop).instant_ns),
            replace(analog, temperature_degc=warm, thermometer_degc=warm),
            self._codes(first, stop),
        )

    def _codes(self, first: int, stop: int) -> Codes:
        rows = np.arange(first, stop)
        return self.make_codes(first, stop, rows[:, None] * (1, -3, 70) % 5000, temperature_counts=rows % 100)

    def _neighbour(self, name: str, first: int, stop: int) -> Codes:
        assert name == "S2"
        codes = self._codes(first + 17, stop + 17)
        return replace(codes, first=first, fresh=np.arange(first, stop) % 2 == 0)

    def _reaching(self, effect: str, row: int) -> Codes:
        assert effect == "stuck"
        return self._codes(row, row + 1)


@pytest.fixture
def bench(place, instants, analog, codes, constant) -> Bench:
    def turning(seconds):
        return np.stack([np.sin(seconds), 2 * np.cos(seconds), seconds], axis=1)

    motion = constant(turning, turning, turning, temperature_degc=lambda seconds: 25 + 5 * np.sin(seconds))
    return Bench(place, instants, analog, codes, motion)


def passed(effect: Effect, stages: tuple[Row, ...], at: Place) -> tuple[Row, ...]:
    """Each stage's rows after the effect."""
    instants, stimulus, analog, codes = stages
    return (
        effect.sampled(instants, at),
        effect.stimulus(stimulus, at),
        effect.analog(analog, at),
        effect.codes(codes, at),
    )


def columns(stages: tuple[Row, ...]) -> Iterator[tuple[str, Any]]:
    for stage in stages:
        for item in fields(stage):
            yield f"{type(stage).__name__}.{item.name}", getattr(stage, item.name)


def differing(first: tuple[Row, ...], other: tuple[Row, ...]) -> set[str]:
    """The columns that are not the same, bit for bit; a number is the same as one in every row."""
    pairs = zip(columns(first), columns(other), strict=True)
    return {name for (name, value), (_, changed) in pairs if not np.all(np.equal(value, changed))}


def harmful(name: str) -> Effect:
    assert name in HARMFUL, "no line in HARMFUL of this file"
    return EFFECTS[name](**HARMFUL[name])


def test_tables_are_complete() -> None:
    assert set(EFFECTS) - set(CHANGED) == set(), "no line in CHANGED of this file"
    assert set(EFFECTS) == set(HARMFUL) == set(CHANGED)
    assert set(EFFECTS) > RANDOM
    assert all(kind.name == name for name, kind in EFFECTS.items())


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_without_arguments_does_nothing(bench: Bench, name: str) -> None:
    before, at = bench.stages(0, ROWS), bench.place()
    assert differing(before, passed(EFFECTS[name](), before, at)) == set()
    assert EFFECTS[name]().lookback(at) == 0


@pytest.mark.parametrize("dtype", some([np.float32, np.float64], 1))
@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_changes_only_its_columns(bench: Bench, name: str, dtype: npt.DTypeLike) -> None:
    before = bench.stages(0, ROWS, dtype)
    boots = [passed(harmful(name), before, bench.place(boot=boot, dtype=dtype)) for boot in range(4)]
    assert set().union(*(differing(before, after) for after in boots)) == CHANGED[name]


@pytest.mark.parametrize("dtype", some([np.float32, np.float64], 1))
@pytest.mark.parametrize("name", EFFECTS)
def test_shapes_and_types_are_kept(bench: Bench, name: str, dtype: npt.DTypeLike) -> None:
    before = bench.stages(0, ROWS, dtype)
    after = passed(harmful(name), before, bench.place(dtype=dtype))
    for (column, old), (_, new) in zip(columns(before), columns(after), strict=True):
        if isinstance(old, np.ndarray):
            assert (new.shape, new.dtype) == (old.shape, old.dtype), column
        elif isinstance(new, np.ndarray):  # a setting of the converter that changes within the run
            assert (new.shape, new.dtype) == ((ROWS, 1), np.dtype(dtype)), column
        else:
            assert isinstance(new, type(old)), column


@pytest.mark.parametrize("name", EFFECTS)
def test_input_rows_are_not_modified(bench: Bench, name: str) -> None:
    before = bench.stages(0, ROWS)
    arrays = [value for _, value in columns(before) if isinstance(value, np.ndarray)]
    copies = [value.tobytes() for value in arrays]
    for value in arrays:
        value.flags.writeable = False
    passed(harmful(name), before, bench.place())
    assert [value.tobytes() for value in arrays] == copies


@pytest.mark.parametrize("name", some(EFFECTS, 12))
def test_random_draws_depend_only_on_seed_and_boot(bench: Bench, name: str) -> None:
    before = bench.stages(0, ROWS)

    def after(**place: int) -> tuple[Row, ...]:
        return passed(harmful(name), before, bench.place(**place))

    assert differing(after(seed=5, boot=2), after(seed=5, boot=2)) == set()
    for key in ("seed", "boot"):
        result = set().union(*(differing(after(), after(**{key: number})) for number in range(10, 20)))
        assert bool(result) == (name in RANDOM)


@pytest.mark.parametrize("name", EFFECTS)
def test_random_streams_have_the_name_of_the_effect(bench: Bench, name: str) -> None:
    """So that no other effect, present or not, can change its draws."""
    streams = NotedStreams(1)
    passed(harmful(name), bench.stages(0, ROWS), replace(bench.place(), streams=streams))
    assert {effect for _, effect, *_ in streams.asked} == ({name} if name in RANDOM else set())


@pytest.mark.parametrize("name", some(sorted(RANDOM), 6))
def test_draws_do_not_depend_on_other_effects(bench: Bench, name: str) -> None:
    before = bench.stages(0, ROWS)
    alone = passed(harmful(name), before, bench.place())
    for other in sorted(RANDOM - {name}):
        at = bench.place()
        passed(harmful(other), before, at)
        assert differing(passed(harmful(name), before, at), alone) == set(), other


@pytest.mark.parametrize("name", EFFECTS)
def test_any_block_alone_equals_that_of_the_whole(bench: Bench, name: str) -> None:
    """Rows across the border of two chunks, as in a longer block; numbers may differ by rounding, and
    by the 1e-12 that filters forget.
    """
    begin, end, at = CHUNK - 200, CHUNK + 100, bench.place()
    reach = harmful(name).lookback(at)
    whole = passed(harmful(name), bench.stages(begin - 3000, end), at)
    part = passed(harmful(name), bench.stages(begin - reach, end), bench.place())
    for (column, long), (_, short) in zip(columns(whole), columns(part), strict=True):
        if isinstance(short, np.ndarray) and len(short) > 1:
            wanted, result = long[3000:], short[reach:]
            close = np.allclose(result, wanted, rtol=1e-9, atol=1e-12) if result.dtype.kind == "f" else result == wanted
            assert np.all(close), column


@pytest.mark.parametrize("name", some([None, *EFFECTS], 2))
def test_rows_computed_alone_equal_those_of_their_chunk(name: str | None) -> None:
    """Of a box that is heated and turned, bit for bit, whether or not the effect lets them be worked out alone."""
    array = parse_array(
        '[array]\nname = "a"\n[[sensor]]\nname = "S1"\nchip = "adxl345"\naddress = 0x53\nrange = 16\nrate_hz = 400\n'
        '[[sensor]]\nname = "S2"\nchip = "adxl345"\naddress = 0x1d\nrange = 16\nrate_hz = 400\n'
    )
    effects = (WhiteNoise(0.004), Misalignment((1.0, -2.0, 0.5, 1.0, -1.0, 3.0)), ThermalBias(0.002))
    effects += (harmful(name),) if name is not None else ()
    plan = plan_of(array, 100.0, 400.0)
    cuts = [0, 5000, 7000, 7900, CHUNK + 3000, CHUNK + 4100, 40_000]
    for motion in (Tumble(50.0, 4.0), Heating(scale=400 / Heating().seconds)):
        whole, alone = (Simulation(plan, motion, {"S1": effects}, seed=2).sensors["S1"] for _ in range(2))
        assert isinstance(whole, SimulatedSensor)
        assert isinstance(alone, SimulatedSensor)
        for first, stop in itertools.pairwise(cuts):
            for wanted, result in zip(whole.block(first, stop), alone.block(first, stop, Demand.APART), strict=True):
                np.testing.assert_array_equal(result, wanted)

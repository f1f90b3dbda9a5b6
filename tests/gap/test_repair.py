"""The repaired model as a file: its content, reading it again, and its simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.array import parse_array
from imuarray.gap.diagnose import Reference, compare, explain
from imuarray.gap.findings.repair import repair_model
from imuarray.gap.inference.forward_selection import Run
from imuarray.gap.model.base_model import Base
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.model.rest import FittedParameters
from imuarray.gap.recording.recordings import recordings_of, reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import summarise_log
from imuarray.gap.statistics.split import Split
from imuarray.log import open_log
from imuarray.log.format import SensorHeader
from imuarray.simulate import Simulation
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.conversion import Quantisation, RangeReset
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.simulate.model import Model, parse_model
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.record import write_log
from imuarray.simulate.streams import Streams
from tests.gap.small_campaign import ARRAY, RATE_HZ, header, phases_of, simulation, units

TONE = Tone((0.0, 0.05, 0.0), 20.0)
FITTED = FittedParameters((0.05, 0.05, 0.05), (0.5, -0.25, 1.0), (0.05, 0.0, 0.0))

MODEL = """
[model]
name = "mine"

[[design]]
chip = "l3g4200d"
white_noise.rms_dps = 9
bias.offset_dps = { sigma = 3 }
thermal_bias = { slope_dps_per_degc = 1, quadratic_dps_per_degc2 = { sigma = 0.001 }, reference_degc = 20 }
tone.amplitude_dps = 0.3
tone.frequency_hz = 30
quantisation.step_lsb = 2

[[sensor]]
name = "G1"
chip = "l3g4200d"
stale_samples.probability = 0.1
random_walk.density_dps_per_sqrt_s = 0.01

[[sensor]]
name = "G9"
chip = "l3g4200d"
bias.offset_dps = 1
"""


def bench_with(*headers: SensorHeader, kinds: Sequence[str] = ("static",)) -> Bench:
    """A bench without simulation."""
    base = Base({one.name: one for one in headers}, {one.name: FITTED for one in headers})
    return Bench(tuple(kinds), Split(()), (), (), base, (), 0, np.zeros(0))


def gyroscope(name: str = "G1") -> SensorHeader:
    return header(name, chip="l3g4200d", bandwidth_hz=35.0, rate_hz=800.0)


def again(model: Model) -> Model:
    """The model after writing and reading."""
    found = parse_model(model.to_toml(), "repaired")
    assert found == model
    return found


def test_accepted_effects_are_in_the_file() -> None:
    bench = bench_with(gyroscope(), header("A1"), kinds=("static", "turn-on", "turn-on"))
    models = {**bench.models(), "G1": SensorModel(FITTED, (TONE, replace(TONE, frequency_hz=31.0)))}
    model = again(repair_model(bench, models, None, "fixed"))
    assert model.about == (
        "2 sensors as diagnosed from 1 static and 2 turn-on logs: the data sheets, fitted, with G1 tone."
    )
    effects = {one.name: one for one in model.effects(gyroscope(), Streams(1))}
    assert list(effects) == [
        "own_clock",
        "misalignment",
        "nonlinearity",
        "scale",
        "thermal_scale",
        "g_sensitivity",
        "bias",
        "turn_on_bias",
        "thermal_bias",
        "tone",
        "white_noise",
    ]
    assert effects["bias"] == Bias((0.5, -0.25, 1.0))
    assert effects["thermal_bias"] == ThermalBias((0.05, 0.0, 0.0))
    assert effects["white_noise"] == WhiteNoise(0.05)
    (part,) = [one for one in model.sensors if one.name == "G1"]
    assert part.effects["tone"] == (
        {"amplitude_dps": (0.0, 0.05, 0.0), "frequency_hz": 20.0},
        {"amplitude_dps": (0.0, 0.05, 0.0), "frequency_hz": 31.0},
    )
    assert part.range == 250.0
    assert not {"white_noise", "bias"} & {kind for part in model.designs for kind in part.effects}


def test_a_model_keeps_effects_that_are_not_fitted() -> None:
    """Bias, noise and slope of the model are replaced; its curve over temperature and other effects stay."""
    bench = bench_with(gyroscope("G1"), gyroscope("G2"))
    before = parse_model(MODEL)
    found = SensorModel(FITTED, (TONE,), frozenset({"quantisation", "stale_samples"}))
    model = again(repair_model(bench, {"G1": found, "G2": SensorModel(FITTED)}, before, "fixed", logs=("a.h5", "b.h5")))
    assert "from a.h5, b.h5: model mine, fitted, with G1 tone, without quantisation" in model.about
    first, second, other = model.sensors
    assert (first.name, second.name, other.name) == ("G1", "G2", "G9")
    assert model.designs == before.designs
    assert first.effects["quantisation"] == ({},)
    assert "stale_samples" not in first.effects
    assert first.effects["random_walk"] == ({"density_dps_per_sqrt_s": 0.01},)
    assert "random_walk" not in second.effects
    one, two = (model.effects(gyroscope(name), Streams(1)) for name in ("G1", "G2"))
    assert [effect.frequency_hz for effect in one if isinstance(effect, Tone)] == [30.0, 20.0]
    assert [effect.frequency_hz for effect in two if isinstance(effect, Tone)] == [30.0]
    assert [effect for effect in one if isinstance(effect, Quantisation)] == [Quantisation()]
    assert [effect for effect in two if isinstance(effect, Quantisation)] == [Quantisation(2.0)]
    assert [effect.rms for effect in one if isinstance(effect, WhiteNoise)] == [(0.05, 0.05, 0.05)]
    curves = [effect for effect in one if isinstance(effect, ThermalBias)]
    assert [effect.slope for effect in curves] == [(0.0, 0.0, 0.0), (0.05, 0.0, 0.0)]
    drawn = [effect for effect in before.effects(gyroscope(), Streams(1)) if isinstance(effect, ThermalBias)]
    assert curves[0].quadratic == drawn[0].quadratic


def test_an_effect_replaces_another_of_its_kind() -> None:
    found = SensorModel(FITTED, (TONE,), frozenset({"tone"}))
    model = again(repair_model(bench_with(gyroscope()), {"G1": found}, parse_model(MODEL), "fixed"))
    tones = [effect for effect in model.effects(gyroscope(), Streams(0)) if isinstance(effect, Tone)]
    assert [one.frequency_hz for one in tones] == [20.0]


def test_an_unknown_chip_states_its_unit() -> None:
    """Both sensors of one such chip: a design for each unit."""
    both = [header("A", chip="bma180"), header("G", chip="l3g4200d")]
    accelerometer, gyro = (replace(one, chip="mpu9150", range=1234.0) for one in both)
    bench = bench_with(accelerometer, gyro)
    model = again(repair_model(bench, bench.models(), None, "fixed"))
    assert [(part.chip, part.unit) for part in model.designs] == [("mpu9150", "g"), ("mpu9150", "dps")]
    assert [(part.name, part.unit, part.range) for part in model.sensors] == [("A", "g", 1234.0), ("G", "dps", 1234.0)]
    for one in (accelerometer, gyro):
        kinds = [effect.name for effect in model.effects(one, Streams(2))]
        stimulus = ["g_sensitivity"] if one is gyro else []
        assert kinds == [
            "own_clock",
            "misalignment",
            "scale",
            *stimulus,
            "bias",
            "turn_on_bias",
            "thermal_bias",
            "white_noise",
        ]


def test_texts_and_nan_figures_survive() -> None:
    strange = (ChannelSwap("G2"), RangeReset(2000.0, onset_s=5.0), Tone(0.1, 7.0, 90.0))
    models = {"G1": SensorModel(FITTED, strange), "G2": SensorModel(FittedParameters(*((0.0, 0.0, 0.0),) * 3))}
    model = again(repair_model(bench_with(gyroscope("G1"), gyroscope("G2")), models, None, "fixed"))
    assert set(strange) <= set(model.effects(gyroscope(), Streams(0)))
    silent = [effect for effect in model.effects(gyroscope("G2"), Streams(0)) if isinstance(effect, WhiteNoise)]
    assert silent == [WhiteNoise()]


def test_a_simulation_of_the_file_shows_the_line() -> None:
    """0.05 dps in noise of 0.05 dps at 100 rows/s over 20 s: the bin nearest to 20 Hz is far above the others."""
    bench = bench_with(gyroscope("G1"), gyroscope("G2"))
    models = {**bench.models(), "G1": SensorModel(FITTED, (TONE,))}
    model = again(repair_model(bench, models, None, "fixed"))
    motion = Still(seconds=20)
    made = Simulation.of_array(parse_array(ARRAY), motion, model, frame_rate_hz=RATE_HZ, seed=3)
    (phase,) = phases_of(motion)
    for name, is_there in (("G1", True), ("G2", False)):
        spectrum = summarise_log("static", simulated_sources(made), [phase], reference_of(motion)).of(name)[0].spectrum
        density = spectrum.density[1:, 1]
        assert (density.max() > 8 * np.median(density)) == is_there
        if is_there:
            highest_hz = spectrum.frequency_hz[1 + density.argmax()] * RATE_HZ
            assert highest_hz == pytest.approx(20.0, abs=spectrum.resolution_hz * RATE_HZ)


@pytest.mark.campaign
def test_a_second_diagnosis_has_no_gap(tmp_path: Path) -> None:
    """Without the line in the model there is a gap, with the repaired model there is none (p > 0.05 has a probability
    of 0.95; fixed seed).
    """
    motion = Still(seconds=60)
    effects = {name: (*own, *((TONE,) if name == "G1" else ())) for name, own in units(1).items()}
    write_log(simulation(motion, effects, 5001), tmp_path / "static.h5")
    recordings = recordings_of([open_log(tmp_path / "static.h5")])
    benches: list[Bench] = []

    def runs(bench: Bench) -> Run:
        benches.append(bench)
        return lambda job, items: [job(bench, item) for item in items]

    first = explain(compare(recordings, runs, seed=1, replicates=40), {})
    assert first.where
    assert first.where[0].sensor == "G1"
    (bench,) = benches
    fitted = bench.base.fitted["G1"]
    quiet = replace(fitted, rms=(fitted.rms[0], fitted.rms[2], fitted.rms[2]))
    models = {**bench.models(), "G1": SensorModel(quiet, (TONE,))}
    model = again(repair_model(bench, models, None, "fixed"))
    second = explain(compare(recordings, runs, Reference(model), seed=1, replicates=40), {})
    assert second.verdict == "no gap"
    assert second.model == "fixed"

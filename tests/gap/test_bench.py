"""A recording on its bench: keys and their places, reproducible replicates, and the effect of a change on them."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from imuarray.array import parse_array
from imuarray.gap.model.base_model import fit
from imuarray.gap.model.bench import Bench, bench_of
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.recording.recordings import Experiment, reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, summarise_log
from imuarray.gap.statistics.probes import PROBES
from imuarray.gap.statistics.split import split_of
from imuarray.simulate import Motion, Simulation, plan_of
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Scale
from imuarray.simulate.effects.timing import DroppedSamples
from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.hand_shake import HandShake
from tests.gap.small_bench import array_of, prepared, simulated, static
from tests.gap.small_campaign import ARRAY, BASE, RATE_HZ, phases_of


@pytest.fixture(scope="module")
def both() -> tuple[Bench, Campaign]:
    """Two gyroscopes, 10 s at rest and a short shaking."""
    logs: list[tuple[str, Motion]] = [("static", Still(seconds=10)), ("motion", HandShake(still_s=3, motion_s=4))]
    return prepared(logs, ["G1", "G2"])


def test_keys_of_the_training_part_are_first(both: tuple[Bench, Campaign]) -> None:
    """Both parts are halves of every log, so that both have the same keys."""
    bench, _ = both
    assert bench.keys[: bench.of_train] == bench.keys[bench.of_train :]
    np.testing.assert_array_equal(np.flatnonzero(bench.held_out), np.arange(bench.of_train, len(bench.keys)))
    assert len(bench.resolutions) == len(bench.keys)


def test_columns_of_one_or_two_sensors(both: tuple[Bench, Campaign]) -> None:
    """Columns of one sensor, of both, and without common statistics at rest; common statistics in motion stay."""
    bench, _ = both
    whole, alone = (bench.columns(["G2"], cross=cross) for cross in (True, False))
    assert {bench.keys[at].sensor for at in whole} == {"G2"}
    assert (np.diff(whole) > 0).all()
    dropped = {bench.keys[at].probe for at in set(whole.tolist()) - set(alone.tolist())}
    assert {PROBES[probe].domain for probe in dropped} == {"cross_sensor"}
    assert not dropped & {bench.keys[at].probe for at in alone}
    assert {PROBES[bench.keys[at].probe].domain for at in np.flatnonzero(bench.is_of_motion)} == {"motion"}
    assert bench.is_of_motion[alone].any()
    every = bench.columns(["G1", "G2"], cross=True)
    np.testing.assert_array_equal(every, np.arange(len(bench.keys)))
    assert len(bench.columns([], cross=True)) == 0


def test_replicates_depend_on_their_number() -> None:
    bench, _ = static()
    models = bench.models()
    one, again, other = (bench.replicate(models, number).values for number in (0, 0, 1))
    np.testing.assert_array_equal(one, again)
    assert np.nanmean(one != other) > 0.8


@pytest.mark.slow
def test_replicates_together_equal_single_ones(both: tuple[Bench, Campaign]) -> None:
    """With equal or different times of rows, and though the other sensor is simulated only once."""
    bench, _ = both
    model = bench.models()["G1"]
    gappy = replace(model, added=(DroppedSamples(0.05),))
    asked = [({"G1": one}, number) for number in (0, 1) for one in (model, gappy)]
    for found, (models, number) in zip(bench.replicates(asked), asked, strict=True):
        alone = replace(bench).replicate(models, number)
        np.testing.assert_allclose(found.values, alone.values, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.fitted["G1"].rms, alone.fitted["G1"].rms, rtol=1e-9)


def test_caches_of_a_bench_are_not_pickled(both: tuple[Bench, Campaign]) -> None:
    """A bench is sent to other processes with every job: its size does not grow with use."""
    bench, _ = both
    before = len(pickle.dumps(replace(bench)))
    bench.replicate({"G1": bench.models()["G1"]}, 0)
    assert len(pickle.dumps(bench)) <= before


@pytest.mark.slow
def test_the_training_part_alone_equals_that_of_the_whole(both: tuple[Bench, Campaign]) -> None:
    bench, _ = both
    whole = bench.replicate(bench.models(), 3)
    part = bench.replicate(bench.models(), 3, held_out=False)
    np.testing.assert_array_equal(part.values[: bench.of_train], whole.values[: bench.of_train])
    assert np.isnan(part.values[bench.of_train :]).all()
    assert part.fitted == whole.fitted


def test_a_sensor_alone_at_rest_equals_that_among_others() -> None:
    """With or without simulation of the other sensor, except for common statistics."""
    bench, _ = prepared([("static", Still(seconds=5))], ["G1", "G2"])
    models = bench.models()
    alone = bench.replicate({"G1": models["G1"]}, 4).values
    together = bench.replicate(models, 4).values
    columns, own = bench.columns(["G1"], cross=True), bench.columns(["G1"], cross=False)
    np.testing.assert_array_equal(alone[np.isin(columns, own)], together[own])
    assert np.isnan(alone[~np.isin(columns, own)]).all()


@pytest.mark.slow
def test_two_of_three_sensors_are_still_compared_with_the_third() -> None:
    """The statistics of a pair are those of the whole array, also where they are a mean over the others of the chip."""
    third = '[[sensor]]\nname = "G3"\nchip = "l3g4200d"\nchannel = 1\naddress = 0x68\nrange = 250\nrate_hz = 800\n'
    mux = 'bus = "i2c:/dev/i2c-1"\nmux = { chip = "pca9544a", address = 0x70 }'
    text = ARRAY.replace('bus = "i2c:/dev/i2c-1"', mux).replace("\naddress", "\nchannel = 0\naddress")
    motion = Still(seconds=10)
    plan = plan_of(parse_array(f"{text}{third}bandwidth_hz = 35\n"), RATE_HZ, motion.seconds)
    plan = replace(plan, sensors={name: line for name, line in plan.sensors.items() if name.startswith("G")})
    effects = {"G1": BASE["G1"], "G2": BASE["G2"], "G3": BASE["G2"]}
    split = split_of(["static"], [phases_of(motion)])
    sources = simulated_sources(Simulation(plan, motion, effects, seed=1))
    campaign = Campaign((summarise_log("static", sources, split.phases()[0], reference_of(motion)),))
    bench = bench_of(campaign, split, [Experiment(plan, motion)], fit(split.train(campaign).campaign, [motion]))
    models = bench.models()
    pair = bench.replicate({name: models[name] for name in ("G1", "G2")}, 4)
    together = bench.replicate(models, 4).values
    np.testing.assert_array_equal(pair.values, together[bench.columns(["G1", "G2"], cross=True)])


def test_added_and_removed_effects_are_simulated() -> None:
    """The draws stay the same: the fit returns an added bias exactly, and added noise as the root of squares."""
    bench, _ = static()
    (model,) = bench.models().values()
    before = bench.replicate({"G1": model}, 0, held_out=False).fitted["G1"]
    shifted = replace(model, added=(Bias((0.0, 0.3, 0.0)),))
    moved = bench.replicate({"G1": shifted}, 0, held_out=False).fitted["G1"]
    np.testing.assert_allclose(np.subtract(moved.offset, before.offset), [0.0, 0.3, 0.0], atol=1e-3)
    noisier = replace(model, added=(WhiteNoise(0.12),))
    louder = bench.replicate({"G1": noisier}, 0, held_out=False).fitted["G1"]
    np.testing.assert_allclose(louder.rms, np.hypot(before.rms, 0.12), rtol=0.15)  # 1000 rows


@pytest.mark.slow
def test_a_kind_that_is_removed_is_not_drawn() -> None:
    """Of an accelerometer on +z the scale of the population shows in z's level, and without it doesn't."""
    bench, _ = prepared([("static", Still(seconds=2))], ["A1"])
    (model,) = bench.models().values()

    def levels(model: SensorModel) -> np.ndarray:
        found = [bench.replicate({"A1": model}, number, held_out=False).fitted["A1"].offset for number in range(12)]
        return np.std(found, axis=0)

    as_drawn, without = levels(model), levels(replace(model, removed=frozenset({"scale", "misalignment"})))
    assert as_drawn[2] > 0.003  # a scale error within the data sheet, about a percent, at 1 g
    assert (without < 0.001).all()  # 0.004 g over the root of 100 rows
    known = replace(model, removed=frozenset({"scale", "misalignment"}), added=(Scale((0.0, 0.0, 0.05)),))
    shifted = bench.replicate({"A1": known}, 0, held_out=False).fitted["A1"].offset[2]
    plain = bench.replicate({"A1": replace(known, added=())}, 0, held_out=False).fitted["A1"].offset[2]
    assert shifted - plain == pytest.approx(0.05, abs=1e-3)


def test_the_recording_has_the_statistics_of_a_replicate() -> None:
    """Levels of the training half, which the fit makes zero, are zero in both. Those of the other half are relative to
    it.
    """
    bench, campaign = static()
    real = bench.observed(campaign, ["G1"])
    assert real.uses
    assert real.fitted == bench.base.fitted
    replicate = bench.replicate(bench.models(), 0)
    levels = np.array([key.probe == "mean" for key in bench.keys])
    for values in (real.values, replicate.values):
        np.testing.assert_allclose(values[levels & ~bench.held_out], 0.0, atol=1e-9)
        assert (np.abs(values[levels & bench.held_out]) > 1e-6).all()
    assert not replicate.uses


def test_a_step_between_the_halves_is_in_the_held_out_level() -> None:
    """Twelve boots, every second with 0.2 dps more on y: levels of the held-out part are relative to the training part.
    A boot has 200 rows of 0.05 dps: 0.0035 dps.
    """
    motions = [turn_on_run(run, 4.0) for run in range(1, 13)]
    split = split_of(["turn-on"] * 12, [phases_of(motion) for motion in motions])
    logs = []
    for boot, motion in enumerate(motions):
        more = (Bias((0.0, 0.2 * (boot % 2), 0.0)),)
        sources = simulated_sources(simulated(motion, ["G1"], {"G1": more}, 1, boot))
        logs.append(summarise_log("turn-on", sources, split.phases()[boot], reference_of(motion)))
    campaign = Campaign(tuple(logs))
    experiments = [Experiment(plan_of(array_of("G1"), RATE_HZ, motion.seconds), motion) for motion in motions]
    train = split.train(campaign)
    assert train.logs == (0, 2, 4, 6, 8, 10)
    base = fit(train.campaign, [motions[at] for at in train.logs])
    bench = bench_of(campaign, split, experiments, base)
    values = bench.observed(campaign, ["G1"]).values
    found = {(bench.held_out[at], key.axis): values[at] for at, key in enumerate(bench.keys) if key.probe == "mean"}
    assert found[True, "y"] == pytest.approx(0.2, abs=0.02)
    assert found[True, "x"] == pytest.approx(0.0, abs=0.02)
    assert found[False, "y"] == pytest.approx(0.0, abs=0.02)


def test_readings_of_a_queue_have_no_age(both: tuple[Bench, Campaign]) -> None:
    """Also if the queue is known from earlier recordings: it is part of the base model."""
    bench, campaign = both
    drained = bench_of(campaign, bench.split, bench.experiments, replace(bench.base, queued=frozenset({"G1"})))
    for before, after in zip(bench.experiments, drained.experiments, strict=True):
        rates_hz = {name: header.rate_hz for name, (header, _) in after.plan.sensors.items()}
        assert rates_hz == {name: header.rate_hz for name, (header, _) in before.plan.sensors.items()} | {"G1": 0.0}

"""Scores of what nothing is wrong with, and that it doesn't matter who works them out."""

from __future__ import annotations

import pickle
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from imuarray.array import parse_array
from imuarray.gap.base_model import Base, fit
from imuarray.gap.campaign import Campaign, LogSummary, summarise_log
from imuarray.gap.null import LARGEST, Experiment, Null, looks_of, null, replicate, residual_statistics, settled
from imuarray.gap.source import recorded_sources, simulated_sources
from imuarray.gap.statistics import Key, statistics
from imuarray.log import open_log
from imuarray.simulate import parse_model, plan_like, plan_of, write_log
from imuarray.simulate.effects.scale import Scale
from imuarray.simulate.effects.tone import Tone
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.motion.still import Still
from tests.gap.made import ARRAY, RATE_HZ, phases_of, simulation, temperature_of

SHORT = Still(seconds=20)


def experiments_of(*motions: Motion) -> list[Experiment]:
    return [Experiment(plan_of(parse_array(ARRAY), RATE_HZ, motion.seconds), motion) for motion in motions]


def short(seed: int = 0) -> tuple[Campaign, Base]:
    sources = simulated_sources(simulation(SHORT, {}, seed))
    campaign = Campaign((summarise_log("static", sources, phases_of(SHORT), temperature_of(SHORT)),))
    return campaign, fit(campaign, [SHORT])


@pytest.fixture(scope="module")
def made() -> Null:
    campaign, base = short()
    return null(campaign, experiments_of(SHORT), base, 80)


def same(one: Null, other: Null) -> bool:
    fields = ("location", "scale", "scores", "always", "never")
    return one.keys == other.keys and all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=name in fields[:3]) for name in fields
    )


def test_threads_change_no_bit(made: Null) -> None:
    campaign, base = short()
    heard: list[int] = []
    with ThreadPoolExecutor(3) as executor:
        again = null(campaign, experiments_of(SHORT), base, 80, executor=executor, progress=heard.append)
    assert heard == list(range(1, 81))
    assert same(made, again)


@pytest.mark.slow
def test_processes_change_no_bit(made: Null) -> None:
    campaign, base = short()
    pool: Executor
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        assert same(made, null(campaign, experiments_of(SHORT), base, 80, executor=pool))


def test_another_seed_draws_others(made: Null) -> None:
    campaign, base = short()
    other = null(campaign, experiments_of(SHORT), Base(base.headers, base.fitted, seed=1), 80)
    assert not same(made, other)
    held = np.isfinite(made.location) & (made.scale > 1e-6)
    apart = (other.location - made.location)[held] / made.scale[held]
    assert np.abs(np.median(apart)) < 0.2  # 40 replicates: medians scatter by 0.2 to 0.3


def test_scores_are_standard(made: Null) -> None:
    """About normal in the middle: 68 % within one, of 40 x 500 scores that hang together; scales of 40 replicates
    scatter by 14 %, which makes tails a little longer.
    """
    held = np.isfinite(made.location) & (made.scale > 1e-6)
    scores = made.scores[:, held]
    assert np.nanmedian(scores) == pytest.approx(0.0, abs=0.1)
    assert np.nanmean(np.abs(scores) < 1) == pytest.approx(0.68, abs=0.05)


def test_what_the_fit_makes_zero_says_nothing(made: Null) -> None:
    """One phase at one temperature: its mean is the fit."""
    campaign, _ = short(seed=5)
    scores = made.score(residual_statistics(campaign, [SHORT]).values)
    means = [score for key, score in zip(made.keys, scores, strict=True) if key.probe == "mean"]
    assert len(means) == 12
    assert np.abs(means).max() < 1e-3
    raw = statistics(campaign)
    assert raw[Key(0, "A1", "z", "static", 0, "level", "mean")] == pytest.approx(1.02, abs=1e-3)


MODEL = """
[model]
name = "known"
[[sensor]]
name = "A1"
chip = "bma180"
scale.error = 0.03
[[sensor]]
name = "G1"
chip = "l3g4200d"
tone.amplitude_dps = 0.05
tone.frequency_hz = 17.0
"""


def test_what_a_model_adds_is_not_counted_twice() -> None:
    """Of A1's 1.05 g on +z the model explains 0.03 g, 0.02 g are bias; of G1's variance 0.05^2 / 2 is the tone's, the
    rest of 0.05^2 + 0.05^2 / 2 white. 2000 rows: 5 standard errors of the rms are 10 %.
    """
    more = {"A1": (Scale(0.03),), "G1": (Tone(0.05, 17.0, float("nan")),)}
    sources = simulated_sources(simulation(SHORT, more, 8))
    campaign = Campaign((summarise_log("static", sources, phases_of(SHORT), temperature_of(SHORT)),))
    base = fit(campaign, [SHORT], model=parse_model(MODEL))
    assert base.fitted["A1"].offset[2] == pytest.approx(0.05, abs=1e-3)
    assert base.fitted["G1"].rms == pytest.approx((0.05 * 1.5**0.5,) * 3, rel=0.1)
    found = settled(campaign, experiments_of(SHORT), base).fitted
    assert found["A1"].offset == pytest.approx((0.02,) * 3, abs=1e-3)
    assert found["G1"].rms == pytest.approx((0.05,) * 3, rel=0.1)
    assert found["G2"].rms == pytest.approx(base.fitted["G2"].rms, rel=0.1)


def test_silence_where_something_is_always_said_is_the_largest_score() -> None:
    always, never = np.array([True, False, False]), np.array([False, True, False])
    some = Null((), np.array([0.0, np.nan, 0.0]), np.ones(3), np.zeros((1, 3)), always, never)
    np.testing.assert_array_equal(some.score(np.array([np.nan, 3.0, np.nan])), [LARGEST, LARGEST, np.nan])
    np.testing.assert_array_equal(some.score(np.array([-2.0, np.nan, 1e9])), [-2.0, np.nan, LARGEST])


def test_too_few_replicates_are_refused() -> None:
    campaign, base = short()
    with pytest.raises(ValueError, match="replicates: 7; at least 8"):
        null(campaign, experiments_of(SHORT), base, 7)


def test_replicates_of_a_recorded_log_are_read_when_it_was(tmp_path: object) -> None:
    """Same times, same grids, same keys; nothing of the log has to be held in memory for it."""
    path = f"{tmp_path}/log.h5"
    write_log(simulation(SHORT, {}, seed=2), path)
    with open_log(path) as log:
        motion = LikeLog(log)
        summary: LogSummary = summarise_log("static", recorded_sources(log), log.phases, temperature_of(motion))
        campaign = Campaign((summary,))
        base, experiments = fit(campaign, [motion]), [Experiment(plan_like(log), motion)]
        again = replicate(looks_of(campaign), experiments, base, 0)
        assert statistics(again).keys == statistics(campaign).keys
        for name, one in again.logs[0].phases[0].sensors.items():
            recorded = summary.phases[0].sensors[name]
            assert one.rows == recorded.rows
            np.testing.assert_array_equal(one.segments.time_s, recorded.segments.time_s)
            assert one.intervals == recorded.intervals
        assert null(campaign, experiments, base, 8).scores.shape == (4, len(statistics(campaign).keys))


def test_what_is_sent_to_processes_can_be_sent() -> None:
    campaign, base = short()
    sent = pickle.dumps((looks_of(campaign), experiments_of(SHORT), base))
    assert len(sent) < 50_000


@pytest.mark.slow
def test_processes_read_a_recorded_log_themselves(tmp_path: object) -> None:
    path = f"{tmp_path}/log.h5"
    write_log(simulation(SHORT, {}, seed=2), path)
    with open_log(path) as log:
        motion = LikeLog(log)
        campaign = Campaign(
            (summarise_log("static", recorded_sources(log), log.phases, temperature_of(motion)),),
        )
        base, experiments = fit(campaign, [motion]), [Experiment(plan_like(log), motion)]
        alone = null(campaign, experiments, base, 8)
        settled_alone = settled(campaign, experiments, base, 3)
        with ProcessPoolExecutor(2, get_context("spawn")) as pool:
            assert same(alone, null(campaign, experiments, base, 8, executor=pool))
            assert settled_alone == settled(campaign, experiments, base, 3, executor=pool)

"""A recording compared with its replicates: rate of false alarms, and detection of simulated gaps."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import binom

from imuarray.array import parse_array
from imuarray.gap.diagnose import REPLICATES, _verify
from imuarray.gap.findings.deviations import StatisticReport, where_of
from imuarray.gap.inference.assessment import LEVEL
from imuarray.gap.inference.comparison import (
    ENOUGH,
    Comparison,
    _queued_in,
    _without_flags_never_set,
    compare_with_base,
    is_decided,
    settle_bench,
)
from imuarray.gap.model.base_model import fit
from imuarray.gap.model.bench import Bench, StatisticValues
from imuarray.gap.model.workers import processes, runner
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import Pairs, pairs_of
from imuarray.gap.statistics.synthetic_likelihood import SyntheticLikelihood, likelihood_of
from imuarray.simulate import parse_model, plan_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.response import Nonlinearity, Scale
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.small_bench import LINE, SHORT, Run, prepared, static
from tests.gap.small_campaign import BASE, header, units

Floats = npt.NDArray[np.float64]
More = Mapping[str, tuple[Effect, ...]]

NAMES = tuple(BASE)


@cache
def bare(seed: int = 0) -> tuple[Bench, Campaign]:
    """All four sensors, 20 s at rest, with the effects of the base only."""
    return recorded({}, seed)


def recorded(more: More, seed: int, motion: Motion = SHORT, kind: str = "static") -> tuple[Bench, Campaign]:
    return prepared([(kind, motion)], NAMES, more, seed)


def compared(more: More, seed: int, replicates: int = 40) -> Comparison:
    """The whole comparison of a simulated recording."""
    bench, campaign = recorded(more, seed)
    return compare_with_base(bench, campaign, Run(bench), replicates)


@pytest.fixture(scope="module")
def nothing() -> Comparison:
    return compared({}, 0, 80)


@pytest.mark.parametrize(
    ("campaigns", "most"),
    [pytest.param(10, 4, marks=pytest.mark.slow), pytest.param(60, 14, marks=pytest.mark.campaign)],
)
def test_rate_of_false_alarms_with_common_replicates(nothing: Comparison, campaigns: int, most: int) -> None:
    """Campaigns, each with its own fit, compared with the 80 replicates of another one: p <= 0.05 has a probability
    of 4/81 over both; at most 4 of 10 have a probability of 0.9997, at most 14 of 60 of 0.9998 (beta-binomial: 4, 77).
    """
    bench = nothing.bench

    def known(job: Callable[[Bench, Any], Any], items: Sequence[Any]) -> list[Any]:
        return [nothing.replicates]

    alarms = 0
    for seed in range(campaigns):
        _, campaign = recorded(units(seed), 1000 + seed)
        alarms += compare_with_base(bench, campaign, known, 80).localisation.is_gap
    assert alarms <= most


@pytest.mark.campaign
def test_rate_of_false_alarms_with_own_replicates() -> None:
    """60 campaigns, 40 replicates each: p <= 0.05 has a probability of 2/41 each; at most 8 of 60 have a probability of
    0.998 (binomial).
    """
    assert sum(compared(units(seed), seed).localisation.is_gap for seed in range(60)) <= 8


@pytest.mark.slow
def test_scores_have_unit_variance(nothing: Comparison) -> None:
    """Nearly normal in the middle: 68 % within one, of 40 x 700 correlated scores, by the other 40; scales of 40
    replicates scatter by 11 %, which makes tails slightly longer. Statistics that are counts are not normal.
    """
    likelihood = likelihood_of(nothing.chance[1::2], nothing.bench.resolutions)
    chosen = np.array([key.domain in ("level", "spread", "spectrum", "allan") for key in nothing.bench.keys])
    scores = likelihood.scores(nothing.chance[::2])[
        :, chosen & np.isfinite(likelihood.location) & ~likelihood.is_silent
    ]
    assert np.nanmedian(scores) == pytest.approx(0.0, abs=0.1)
    assert np.nanmean(np.abs(scores) < 1) == pytest.approx(0.68, abs=0.05)


@pytest.mark.slow
def test_another_seed_draws_other_replicates(nothing: Comparison) -> None:
    bench = replace(nothing.bench, base=replace(nothing.bench.base, seed=77))
    other = compare_with_base(bench, nothing.campaign, Run(bench), 40)
    assert not np.array_equal(other.chance, nothing.chance[:40], equal_nan=True)
    one, two = nothing.assessment.likelihood, other.assessment.likelihood
    held = np.isfinite(one.location) & np.isfinite(two.location) & ~one.is_silent & ~two.is_silent
    apart = (two.location - one.location)[held] / one.scale[held]
    assert np.abs(np.median(apart)) < 0.2  # medians of 40 and 80 replicates scatter by 0.2 and 0.14


@pytest.mark.slow
def test_a_tone_is_detected_on_its_axis() -> None:
    """0.8 of the noise's standard deviation at 17 Hz on one axis of one gyroscope: readings correlate over many rows,
    the spectrum has a line, and means over some rows vary less.
    """
    found = compared({**units(1), "G2": (*units(1)["G2"], Tone((0.0, 0.04, 0.0), 17.0))}, 1)
    root = found.localisation.root
    assert found.localisation.is_gap
    assert found.localisation.p == pytest.approx(1 / 41)
    assert [node.path for node in root.significant("chip")][:1] == [("l3g4200d",)]
    assert [node.path for node in root.significant("axis")] == [("l3g4200d", "G2", "y")]
    domains = [node.path[-1] for node in root.significant("domain")[:3]]
    assert {"spectrum", "autocorrelation"} <= {*domains} <= {"spectrum", "autocorrelation", "allan"}
    first, *_ = found.localisation.p_by_place
    key = found.pairs.keys[first]
    assert (key.sensor, key.axis) == ("G2", "y")
    assert key.domain in ("spectrum", "autocorrelation", "allan")
    assert abs(found.assessment.scores[first]) > 5
    assert {(found.pairs.keys[at].sensor, found.pairs.keys[at].axis) for at in found.localisation.p_by_place} == {
        ("G2", "y")
    }


@pytest.mark.slow
def test_sizes_have_the_unit_of_the_statistic() -> None:
    """0.06 g per g^2 along x: the mean of the faces +x and -x has an error of 0.06 g."""
    more = {"A2": (Nonlinearity(quadratic=(0.06, 0.0, 0.0)),)}
    bench, campaign = prepared([("tumble", Tumble(4.0, 1.0))], ("A1", "A2"), more, 3)
    found = compare_with_base(bench, campaign, Run(bench), 40)
    told = where_of(
        StatisticReport(bench, campaign, found.pairs, ["tumble.h5"]),
        found.assessment,
        found.localisation.p_by_place,
        found.localisation.p_by_place,
    )
    (square,) = [one for one in told if one.statistic == "force_square"]
    assert (square.sensor, square.axis, square.unit) == ("A2", "x", "g/g^2")
    assert square.real - square.simulated == pytest.approx(0.06, abs=0.002)
    assert square.real == pytest.approx(0.06, abs=0.002)


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


@pytest.mark.slow
def test_effects_of_the_model_are_not_fitted_twice() -> None:
    """Of A1's 1.05 g on +z the model explains 0.03 g, 0.02 g are bias; of G1's variance 0.05^2 / 2 is the tone's, the
    rest of 0.05^2 + 0.05^2 / 2 white. 1000 rows: 4 standard errors of the rms are 9 %, of the remainder without the
    tone 14 %.
    """
    bench, campaign = recorded({"A1": (Scale(0.03),), "G1": (Tone(0.05, 17.0, float("nan")),)}, 8)
    base = fit(bench.split.train(campaign).campaign, [SHORT], model=parse_model(MODEL))
    assert base.fitted["A1"].offset[2] == pytest.approx(0.05, abs=1e-3)
    assert base.fitted["G1"].rms == pytest.approx((0.05 * 1.5**0.5,) * 3, rel=0.1)
    found = settle_bench(replace(bench, base=base)).base.fitted
    assert found["A1"].offset == pytest.approx((0.02,) * 3, abs=1e-3)
    assert found["G1"].rms == pytest.approx((0.05,) * 3, rel=0.14)
    assert found["G2"].rms == pytest.approx(base.fitted["G2"].rms, rel=0.1)


def test_jobs_for_processes_can_be_pickled() -> None:
    """Plain data, small compared with the simulation."""
    bench, _ = bare()
    sent = pickle.dumps(bench)
    assert len(sent) < 500_000
    assert pickle.loads(sent).keys == bench.keys  # noqa: S301


@pytest.mark.slow
def test_processes_give_identical_results() -> None:
    bench, campaign = static(LINE)
    alone = compare_with_base(bench, campaign, runner(bench), 40)
    with processes(2) as pool:
        together = compare_with_base(bench, campaign, runner(bench, pool), 40)
    np.testing.assert_array_equal(together.chance, alone.chance)
    assert together.localisation == alone.localisation


class Chances:
    """A bench whose statistics are normal numbers: those of the recording, shifted by so many standard deviations, and
    those of each replicate.
    """

    keys = tuple(
        Key(0, "G1", axis, "static", 0, "level", probe) for probe in ("mean", "noise", "wander") for axis in "xyz"
    )
    resolutions = np.zeros(9)
    together = 8
    base = SimpleNamespace(headers={"G1": header("G1")}, fitted={})

    def __init__(self, seed: int, moved: float = 0.0) -> None:
        self._drawn = np.random.default_rng(seed).normal(size=(201, 9))
        self._drawn[0] += moved
        self.asked: list[int] = []

    def pairs(self) -> Pairs:
        return pairs_of(self.keys, [False] * 9)

    def models(self) -> dict[str, Any]:
        return {}

    def observed(self, campaign: object, sensors: object) -> StatisticValues:
        return StatisticValues(self._drawn[0], {})

    def run(self, job: object, items: Sequence[Sequence[tuple[object, int]]]) -> list[list[StatisticValues]]:
        self.asked += [number for group in items for _, number in group]
        return [[StatisticValues(self._drawn[1 + number], {}) for _, number in group] for group in items]


def sequential(seed: int, moved: float = 0.0, replicates: int = 100) -> tuple[float, int]:
    """The p-value, and the number of replicates."""
    bench = Chances(seed, moved)
    found = compare_with_base(cast(Bench, bench), cast(Campaign, None), bench.run, replicates)
    assert bench.asked == list(range(len(found.replicates)))  # each once
    return found.localisation.p, len(found.replicates)


@pytest.mark.slow
@pytest.mark.parametrize("recordings", [120, pytest.param(300, marks=pytest.mark.campaign)])
def test_p_values_are_uniform_though_most_comparisons_end_early(recordings: int) -> None:
    """Of recordings without a gap at most a share a has p <= a, within three standard errors; 65 % end after 20
    replicates, 78 % after 40, within 3.3 and 3.8 standard errors. At most 37.1 are simulated on average (20 + 8 * 0.35
    + 12 * 0.28 + 24 * 0.22 + 32 * 0.16 + 4 * 0.13, standard error 1.7 for 300): fewer, since a look continues only if
    the looks before it did.
    """
    p, replicates = np.array([sequential(seed) for seed in range(recordings)]).T
    widening = np.sqrt(300 / recordings)
    for level in (0.05, 0.1, 0.2, 0.4, 0.8):
        assert np.mean(p <= level) <= level + 3 * np.sqrt(level * (1 - level) / recordings)
    assert np.mean(replicates == 20) == pytest.approx(0.65, abs=0.09 * widening)
    assert np.mean(replicates <= 40) == pytest.approx(0.78, abs=0.09 * widening)
    assert replicates.mean() < 37.1 + 3 * 1.7 * widening


def test_a_single_score_that_pooled_ones_mask_is_continued() -> None:
    """The p-value of all scores after 20 replicates, 9 of 21, would end the test; that of the single scores is below
    the limit.
    """
    assert sequential(77) == (pytest.approx(13 / 41), 40)


@pytest.mark.slow
def test_a_moderate_deviation_needs_all_replicates_and_a_clear_one_does_not() -> None:
    """2.5 standard deviations in each statistic, slightly more than the largest of all replicates; 4, some more; 40,
    ten times as much; and a limit of 40 replicates.
    """
    for seed in range(5):
        p, replicates = sequential(seed, 2.5)
        assert (p, replicates) == (pytest.approx(1 / 101), 100)
        assert sequential(seed, 4.0) == (pytest.approx(1 / 41), 40)
        assert sequential(seed, 40.0) == (pytest.approx(1 / 29), 28)
    assert sequential(0, 2.5, replicates=40)[1] == 40


def test_limits_of_a_sequential_test_do_not_rise() -> None:
    """A recording nearer to chance ends earlier; and a gap, p <= 0.05, is near the result of a continued test."""
    assert sorted(ENOUGH) == list(ENOUGH)
    limits = list(ENOUGH.values())
    assert limits == sorted(limits, reverse=True)
    given_up = [binom.sf(limit * (count + 1) - 1, count, LEVEL) for count, limit in ENOUGH.items()]
    assert sum(given_up) < 0.005
    assert min(ENOUGH) < REPLICATES


@pytest.mark.parametrize(
    ("count", "p", "largest", "decided"),
    [
        (20, 0.36, 3.0, True),  # well within chance
        (20, 0.34, 3.0, False),
        (20, 1 / 21, 40.0, False),  # so few do not show how far chance reaches
        (28, 1 / 29, 12.1, True),  # three times as far as the furthest of 4
        (28, 1 / 29, 11.9, False),
        (32, 1 / 33, 12.1, True),
        (32, 0.5, 3.0, False),  # no look at this number
        (40, 1 / 41, 6.1, True),
    ],
)
def test_few_replicates_decide_what_is_clear(count: int, p: float, largest: float, decided: bool) -> None:
    assert is_decided(count, p, largest, 4.0) == decided


@pytest.mark.parametrize(("moved", "replicates"), [(0.0, 20), (40.0, 28), (2.6, 32)])
def test_verification_ends_early_if_the_remainder_is_clear(moved: float, replicates: int) -> None:
    """No remainder; one that is ten times the largest of chance; and one that is hardly larger, which has all."""
    bench = Chances(3)
    bench._drawn[0] = moved
    first = 2_000_000

    def run(job: object, items: Sequence[Sequence[tuple[object, int]]]) -> list[list[StatisticValues]]:
        return bench.run(job, [[(models, number - first) for models, number in group] for group in items])

    usual = SyntheticLikelihood(np.zeros(9), np.ones(9), np.ones(9, bool), np.zeros(9, bool))
    comparison = SimpleNamespace(
        bench=bench,
        assessment=SimpleNamespace(likelihood=usual),
        pairs=bench.pairs(),
        real=bench.observed(None, None),
        earlier=None,
    )
    case, search = SimpleNamespace(comparison=comparison, run=run), SimpleNamespace(models={})
    verification = _verify(cast(Any, case), cast(Any, search), cast(Any, ["a cause"]))
    assert bench.asked == list(range(replicates))  # each once
    assert len(verification.replicates) == replicates
    assert (verification.after.p > 0.3) == (moved == 0)


def test_a_flag_without_rows_is_missing() -> None:
    """Shares of repeated rows of two sensors: kept if one sensor has any, since the recorder compares readings."""
    keys = [Key(0, name, "", "static", 0, "status", probe) for name in ("A", "B") for probe in ("stale", "lost")]
    nan = math.nan
    for values, known in (
        ([0.0, 0.0, 0.0, 0.0], [nan, 0.0, nan, 0.0]),
        ([0.0, 0.5, nan, 0.1], [nan, 0.5, nan, 0.1]),
        ([0.0, 0.0, 0.2, nan], [0.0, 0.0, 0.2, nan]),
    ):
        np.testing.assert_array_equal(_without_flags_never_set(keys, np.array(values)), known)


def test_a_queue_is_known_by_the_configuration_or_by_its_rows() -> None:
    """A queue may be slower than the frames, which its rows do not reveal; a log without a configuration has only
    these.
    """
    text = """[array]
name = "queue"
bus = "i2c:/dev/i2c-1"
[[sensor]]
name = "Queue"
chip = "adxl345"
address = 0x53
range = 2
rate_hz = 100
fifo = true
[[sensor]]
name = "Polled"
chip = "adxl345"
address = 0x1D
range = 2
rate_hz = 100
"""
    slow, fast = (plan_of(parse_array(text), frame_rate_hz, 10.0) for frame_rate_hz in (250.0, 25.0))
    unknown = (replace(slow, config=""), replace(fast, config=""))
    for plan, queued in zip((slow, fast, *unknown), ({"Queue"}, {"Queue"}, set(), {"Queue"}), strict=True):
        log = {name: Rows(10_000_000) for name in plan.sensors}
        recording = SimpleNamespace(experiment=SimpleNamespace(plan=plan), log=log)
        assert _queued_in(cast(Any, [recording])) == queued


class Rows:
    """A sensor with rows at equal intervals."""

    def __init__(self, interval_ns: int) -> None:
        self.time = np.arange(1000, dtype=np.int64) * interval_ns

    def __len__(self) -> int:
        return len(self.time)


@pytest.mark.parametrize(("intervals_ns", "count"), [((10_000_000, 10_200_000), 2), ((10_000_000, 10_001_000), 0)])
def test_chips_that_are_read_at_rates_of_their_own_are_not_polled(intervals_ns: tuple[int, int], count: int) -> None:
    """Both are configured to 100 Hz; an oscillator is off by 2 %. Polls by one host have the same interval."""
    sensors = {f"A{number}": (SimpleNamespace(rate_hz=100.0), SimpleNamespace(rows_per_s=100.0)) for number in (1, 2)}
    plan = SimpleNamespace(config="", sensors=sensors, frame_rate_hz=0.0)
    log = dict(zip(sensors, map(Rows, intervals_ns), strict=True))
    recording = SimpleNamespace(experiment=SimpleNamespace(plan=plan), log=log)
    assert len(_queued_in(cast(Any, [recording]))) == count

"""Each strong effect moves a probe of its domain; without effects no probe moves. Some effects are observable in one
experiment only: those that need a motion (clock_error, own_clock, skew, size_effect), several faces (scale,
misalignment, axis_error, nonlinearity, g_sensitivity: on one face all of them look like a bias), heating (thermal_bias,
thermal_scale, thermal_lag) or several boots (turn_on_bias, bistable_bias, a range that is lost at a boot). Effects that
are not observable are tested too: at rest times have no influence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from imuarray.gap.statistics.catalogue import Key, statistics
from imuarray.gap.statistics.probes import Domain
from imuarray.simulate import EFFECTS
from imuarray.simulate.effect import Effect
from tests.gap.small_campaign import PLANS, campaign_of
from tests.selection import some

pytestmark = pytest.mark.slow

REPLICATES = 30
FOUND, QUIET = 6.0, 5.0
STRONG_SEED = 1000


class Case(NamedTuple):
    """An effect at an obvious severity, the experiment that shows it, and the domain."""

    plan: str
    domain: Domain
    sensors: tuple[str, ...]
    parameters: Mapping[str, float | str | tuple[float, ...]]


CASES: Mapping[str, Case] = {
    "clock_error": Case("motion", "motion", ("A1",), {"error_ppm": 2000.0}),
    "own_clock": Case("motion", "motion", ("G1",), {"rate_error": -0.4, "phase_deg": 90.0}),
    "skew": Case("motion", "motion", ("G1",), {"delay_s": 0.005}),
    "jitter": Case("motion", "motion", ("G1",), {"rms_s": 0.002}),
    "dropped_samples": Case("static", "timing", ("A1",), {"probability": 0.01, "burst_rows": 3.0}),
    "size_effect": Case("motion", "motion", ("A1",), {"position_mm": (0.0, 50.0, 0.0)}),
    "thermal_lag": Case("heating", "temperature", ("G1",), {"time_constant_s": 1.0}),
    "axis_error": Case("tumble", "force", ("A1",), {"axes": "+Y+X-Z"}),
    "misalignment": Case("tumble", "force", ("A1",), {"angles_deg": (0.5, 0.0, 0.0, 0.0, 0.0, 0.5)}),
    "nonlinearity": Case("tumble", "force", ("A1",), {"quadratic": 0.005}),
    "scale": Case("tumble", "force", ("A1",), {"error": 0.02}),
    "thermal_scale": Case("heating", "temperature", ("A1",), {"slope": 1e-3}),
    "g_sensitivity": Case("tumble", "force", ("G1",), {"response": (0.05,) * 9}),
    "bias": Case("static", "level", ("A1",), {"offset": 0.005}),
    "turn_on_bias": Case("turn-on", "run_to_run", ("A1",), {"rms": 0.01}),
    "bistable_bias": Case("turn-on", "run_to_run", ("G1",), {"offset": (0.9, 0.4, -0.2), "probability": 0.5}),
    "thermal_bias": Case("heating", "temperature", ("G1",), {"slope": 0.02}),
    "bias_instability": Case("static", "allan", ("G1",), {"rms": 0.04, "time_constant_s": 10.0}),
    "random_walk": Case("static", "allan", ("G1",), {"density": 0.02}),
    "popcorn_noise": Case("static", "allan", ("A1",), {"amplitude": 0.01, "switches_per_s": 0.5}),
    "common_mode": Case("static", "cross_sensor", ("A1", "A2"), {"rms": 0.003, "time_constant_s": 2.0}),
    "tone": Case("static", "spectrum", ("G1",), {"amplitude": (0.0, 0.02, 0.0), "frequency_hz": 13.7}),
    "white_noise": Case("static", "spread", ("A1",), {"rms": 0.003}),
    "bandwidth": Case("static", "autocorrelation", ("G1",), {"cutoff_hz": 30.0}),
    "odr_error": Case("static", "timing", ("G1",), {"rate_hz": 50.0}),
    "range_reset": Case("turn-on", "run_to_run", ("A1",), {"range": 2.0, "probability": 0.5}),
    "quantisation": Case("static", "codes", ("A1",), {"step_lsb": 4.0}),
    "saturation": Case("static", "codes", ("A1",), {"limit": 1.02}),
    "adaptive_range": Case("motion", "timing", ("G1",), {"threshold": 50.0, "hold_s": 0.05}),
    "stale_samples": Case("static", "timing", ("A1",), {"probability": 0.05}),
    "glitches": Case("static", "distribution", ("A1",), {"probability": 0.002, "amplitude": 0.05}),
    "stuck": Case("static", "timing", ("A1",), {"onset_s": 30.0, "duration_s": 1.0}),
    "channel_swap": Case("static", "cross_sensor", ("G1",), {"sensor": "G2"}),
}

UNSEEN_AT_REST = ("clock_error", "own_clock", "skew", "size_effect", "thermal_lag")
"""A box that stands still at one temperature feels the same at any instant, anywhere."""


class Null(NamedTuple):
    keys: tuple[Key, ...]
    values: np.ndarray
    resolutions: np.ndarray

    def scores(self, values: np.ndarray) -> np.ndarray:
        """Distance from the mean in standard deviations of the replicates, or in resolutions of a chip; 0 without a
        value.
        """
        rounding = 1e-9 * np.abs(self.values).max(axis=0) + 1e-12
        scale = np.maximum(self.values.std(axis=0, ddof=1), np.maximum(self.resolutions, rounding))
        return np.nan_to_num(np.abs(values - self.values.mean(axis=0)) / scale)


@cache
def null(plan: str) -> Null:
    found = [statistics(campaign_of(plan, seed=seed)) for seed in range(REPLICATES)]
    return Null(found[0].keys, np.array([one.values for one in found]), found[0].resolutions)


def largest(name: str, plan: str) -> dict[str, float]:
    """Per domain the farthest statistic with the effect."""
    case = CASES[name]
    effect: Effect = EFFECTS[name](**case.parameters)
    more: dict[str, Sequence[Effect]] = dict.fromkeys(case.sensors, (effect,))
    strong, usual = statistics(campaign_of(plan, more, STRONG_SEED)), null(plan)
    assert strong.keys == usual.keys
    scores = usual.scores(strong.values)
    return {
        domain: max(score for key, score in zip(usual.keys, scores, strict=True) if key.domain == domain)
        for domain in {key.domain for key in usual.keys}
    }


def test_there_is_a_case_for_every_effect() -> None:
    assert set(CASES) == set(EFFECTS) - {"thermometer"}  # a nuisance quantity


@pytest.mark.parametrize("name", some(CASES, 8, 0))
def test_an_effect_moves_its_domain(name: str) -> None:
    assert largest(name, CASES[name].plan)[CASES[name].domain] > FOUND


@pytest.mark.parametrize("name", UNSEEN_AT_REST)
def test_effects_on_times_change_no_probe_at_rest(name: str) -> None:
    """All values are identical to those without the effect."""
    case = CASES[name]
    more = {sensor: (EFFECTS[name](**case.parameters),) for sensor in case.sensors}
    np.testing.assert_array_equal(
        statistics(campaign_of("static", more, 5)).values, statistics(campaign_of("static", seed=5)).values
    )


@pytest.mark.parametrize("plan", PLANS)
def test_statistics_of_replicates_have_no_outliers(plan: str) -> None:
    """No statistic has a value in some replicates only, and none is an outlier: the largest of 30 normal numbers is
    practically never beyond 5 of their standard deviations (5.3 is the maximum).
    """
    usual = null(plan)
    said = np.isfinite(usual.values)
    assert (said.all(axis=0) | ~said.any(axis=0)).all()
    assert usual.scores(usual.values).max() < QUIET


@pytest.mark.parametrize("plan", PLANS)
def test_statistics_are_nearly_normal(plan: str) -> None:
    """Pooled over everything that scatters: the shares beyond 2 and 3 standard deviations, of 30 numbers about their
    own mean 4.4 % and 0.15 % where they are normal; statistics of a few codes are excluded.
    """
    usual = null(plan)
    spread = usual.values.std(axis=0, ddof=1)
    counted = [key.domain in ("codes", "timing", "status") for key in usual.keys]
    alive = np.isfinite(spread) & (spread > np.maximum(usual.resolutions, 1e-12)) & ~np.array(counted)
    scores = usual.scores(usual.values)[:, alive]
    assert 0.037 < (scores > 2).mean() < 0.052
    assert (scores > 3).mean() < 0.004

"""The other techniques are special cases of `optimal`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.errors import FusionError
from imuarray.fuse.frames import Axis, Frames, matrices
from imuarray.fuse.optimal import AxisErrors, DesignErrors, ErrorModel, Optimal
from tests.fuse.optimal.conftest import FORCE, PERIOD_S, Floats, frames_of, model_of, times, triad
from tests.selection import examples

OPPOSITE = np.diag([-1.0, 1.0, -1.0])


def optimal_of(axes: list[Axis], model: ErrorModel | None = None) -> Optimal:
    return Optimal({FORCE: axes}, model or model_of(axes), period_s=PERIOD_S)


def test_equal_noise_alone_gives_the_mean() -> None:
    rng = np.random.default_rng(96)
    axes = [*triad("S0", np.eye(3)), *triad("S1", OPPOSITE), *triad("S2", np.eye(3))]
    values = rng.normal(size=(50, 9))
    estimate = optimal_of(axes)({FORCE: frames_of(values)})[FORCE]
    mean = (values[:, :3] + values[:, 3:6] * np.diag(OPPOSITE) + values[:, 6:]) / 3
    assert estimate.triad_box == pytest.approx(mean, abs=1e-12)
    assert matrices(estimate.covariance_box) == pytest.approx(np.tile(np.eye(3) * 0.01 / 3, (50, 1, 1)))
    assert estimate.used.all()


def test_noise_alone_gives_weights_by_inverse_variance() -> None:
    """Twice the noise is a quarter of the weight: 0.8 and 0.2, and a variance of 0.8 of that of the better sensor."""
    values = np.random.default_rng(97).normal(size=(50, 6))
    axes = [*triad("S0", np.eye(3), noise_si=0.1), *triad("S1", np.eye(3), noise_si=0.2)]
    estimate = optimal_of(axes)({FORCE: frames_of(values)})[FORCE]
    assert estimate.triad_box == pytest.approx(0.8 * values[:, :3] + 0.2 * values[:, 3:], abs=1e-12)
    assert matrices(estimate.covariance_box)[-1] == pytest.approx(np.eye(3) * 0.8 * 0.01)


def test_opposite_axes_cancel_the_common_error_of_a_design() -> None:
    """Two sensors along X, one against it: in the mean a third of the common error remains, here none after noise is
    averaged. The common error is a ramp of fifty times the noise.
    """
    rng = np.random.default_rng(98)
    axes = [*triad("S0", np.eye(3)), *triad("S1", np.diag([1.0, -1, -1])), *triad("S2", OPPOSITE)]
    common = np.linspace(0.0, 5.0, 20_000)[:, None]
    values = common + 0.1 * rng.normal(size=(20_000, 9))
    model = model_of(axes, {("a", index): DesignErrors(common=3.0, common_time_constant_s=100.0) for index in range(3)})
    estimate = optimal_of(axes, model)({FORCE: frames_of(values)})[FORCE]
    mean = (values[:, 0] + values[:, 3] - values[:, 6]) / 3
    assert mean[-1000:].mean() > 1.5
    assert np.abs(estimate.triad_box[-1000:].mean(axis=0)).max() < 0.02
    # Cancelling adds hardly any noise to that of the mean of three
    assert estimate.triad_box[-1000:].std(axis=0) == pytest.approx([0.1 / np.sqrt(3)] * 3, rel=0.1)


def test_a_bias_contradicted_by_the_others_is_learned() -> None:
    """Three equal sensors, one biased by ten times its noise with a wide prior, two with a known bias of zero."""
    rng = np.random.default_rng(99)
    axes = [axis for name in ("S0", "S1", "S2") for axis in triad(name, np.eye(3))]
    errors = {(axis.sensor, axis.index): AxisErrors(0.1, bias=2.0 if axis.sensor == "S2" else 1e-4) for axis in axes}
    values = 0.1 * rng.normal(size=(5000, 9)) + np.repeat([0.0, 0.0, 1.0], 3)
    optimal = optimal_of(axes, ErrorModel(errors))
    estimate = optimal({FORCE: frames_of(values)})[FORCE]
    assert np.abs(estimate.triad_box[1000:].mean(axis=0)).max() < 0.01
    learned = optimal.learned()[FORCE][6]
    # 1 against the mean of two, whose noise is 0.1 / sqrt(2), over 5000 frames
    sd = 0.1 * np.sqrt(1.5 / 5000)
    assert (learned.axis, learned.sd_before) == ("S2 x", 2.0)
    assert learned.bias == pytest.approx(1.0, abs=3.3 * sd)
    assert learned.sd == pytest.approx(sd, rel=0.02)
    # The smoother ends with the same estimate
    again = optimal_of(axes, ErrorModel(errors))
    for _ in again.smoothed(lambda: iter([({FORCE: frames_of(values)}, None)])):
        pass
    whole = again.learned()[FORCE][6]
    assert (whole.bias, whole.sd) == pytest.approx((learned.bias, learned.sd), rel=0.1)


def test_a_wrong_scale_factor_is_learned_from_the_motion() -> None:
    """One of four sensors has 3 % too much along X: known to 0.1 % after a motion, and the triad follows."""
    rng = np.random.default_rng(100)
    axes = [axis for name in ("S0", "S1", "S2", "S3") for axis in triad(name, np.eye(3))]
    errors = {
        (axis.sensor, axis.index): AxisErrors(0.1, bias=1e-4, response=0.05 if axis.sensor == "S3" else 1e-5)
        for axis in axes
    }
    seconds = times(6000) * 1e-9
    truth = 8 * np.sin(2 * np.pi * np.outer(seconds, [0.5, 0.3, 0.7]))
    values = np.tile(truth, 4) + 0.1 * rng.normal(size=(6000, 12))
    values[:, 9] += 0.03 * truth[:, 0]
    estimate = optimal_of(axes, ErrorModel(errors))({FORCE: frames_of(values)})[FORCE]
    error = estimate.triad_box[3000:, 0] - truth[3000:, 0]
    # in the mean it would be a quarter of 3 %
    assert abs(error @ truth[3000:, 0] / (truth[3000:, 0] @ truth[3000:, 0])) < 0.0004
    # Stated and true variance agree: 3000 squares determine a variance to 2.6 %, 99.9 % of the time within 8.5 %
    variance = estimate.covariance_box[3000:, 0].mean()
    assert np.mean(error**2) == pytest.approx(variance, rel=0.085)


def test_uncertain_directions_widen_the_covariance_with_the_signal() -> None:
    """One sensor: 2 % of 10 m/s2 along X is 0.2, of a zero rate 0; noise 0.1 along each axis."""
    axes = triad("S0", np.eye(3))
    errors = {(axis.sensor, axis.index): AxisErrors(0.1, response=0.02) for axis in axes}
    values = np.repeat([[0.0, 0, 0], [10.0, 0, 0]], 10, axis=0)
    estimate = optimal_of(axes, ErrorModel(errors))({FORCE: frames_of(values)})[FORCE]
    assert matrices(estimate.covariance_box)[0] == pytest.approx(np.eye(3) * 0.01)
    assert matrices(estimate.covariance_box)[-1] == pytest.approx(np.eye(3) * (0.01 + 0.04))


@given(seed=st.integers(0, 2**31), count=st.integers(3, 12), shared=st.booleans())
@settings(max_examples=examples(25), deadline=None)
def test_any_array_without_errors_gives_the_truth(seed: int, count: int, shared: bool) -> None:
    """Unbiased: readings without errors give triads without errors, for any error model."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(count, 3))
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    axes = [
        Axis(f"S{i // 3}", "a", i % 3, tuple(map(float, rows[i])), 1e3, float(rng.uniform(0.01, 1)))
        for i in range(count)
    ]  # type: ignore[arg-type]
    designs = {("a", index): DesignErrors(1.0, 10.0) for index in range(3)} if shared else {}
    truth = rng.normal(0.0, 10.0, (30, 3))
    model = model_of(axes, designs, bias=1.0, drift=0.1)
    estimate = optimal_of(axes, model)({FORCE: frames_of(truth @ rows.T)})[FORCE]
    solved = np.isfinite(estimate.triad_box).all(axis=1)
    assert solved.all() or np.linalg.cond(rows) > 1e3
    spread = np.sqrt(matrices(estimate.covariance_box)[solved].trace(axis1=1, axis2=2)).max(initial=0.0)
    assert np.abs(estimate.triad_box - truth)[solved].max(initial=0.0) < 1e-7 * (1 + spread)


def test_missing_or_invalid_errors_of_the_model_are_refused() -> None:
    axes = triad("S0", np.eye(3))
    with pytest.raises(FusionError, match="sensor S0 axis x: it is not in the error model"):
        Optimal({FORCE: axes}, ErrorModel({}), period_s=PERIOD_S)
    with pytest.raises(FusionError, match="frames every 0 s"):
        Optimal({FORCE: axes}, model_of(axes), period_s=0.0)
    with pytest.raises(FusionError, match="noise 0"):
        AxisErrors(0.0)
    with pytest.raises(FusionError, match="correlation 1"):
        AxisErrors(1.0, correlation=1.0)
    with pytest.raises(FusionError, match="time constant"):
        DesignErrors(common_time_constant_s=0.0)


def test_correlated_readings_determine_a_bias_less_precisely() -> None:
    """Neighbours that correlate by 1/3 have half the weight: 1000 frames determine a bias like 500 frames of white
    noise.
    """
    sds: list[Floats] = []
    for correlation, count in ((1 / 3, 1000), (0.0, 500)):
        axes = [*triad("S0", np.eye(3)), *triad("S1", np.eye(3))]
        optimal = Optimal({FORCE: axes}, model_of(axes, bias=5.0, correlation=correlation), period_s=PERIOD_S)
        for start in range(0, count, 100):
            time = times(count)[start : start + 100]
            optimal({FORCE: Frames(time, np.zeros((100, 6)), np.ones((100, 6), bool))})
        optimal({FORCE: frames_of(np.zeros((1, 6)))})
        sds.append(np.array([learned.sd for learned in optimal.learned()[FORCE]]))
    assert sds[0] == pytest.approx(sds[1], rel=0.02)


@pytest.mark.parametrize(
    "wrong",
    [{"correlation": 1.0}, {"correlation": -1.0}, {"drift_time_constant_s": 0.0}, {"bias": np.inf}, {"noise": 0.0}],
)
def test_impossible_errors_of_an_axis_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(FusionError, match="error model"):
        AxisErrors(**{"noise": 0.1, **wrong})

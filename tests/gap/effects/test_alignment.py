"""bias, scale, misalignment, axis_error: suggested from faces and from motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.response import Response, response
from imuarray.gap.recording.turns import exchanges
from imuarray.gap.statistics.probes.force import applied_g
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.response import AxisError, Misalignment, Scale
from tests.gap.effects.evidence_of import evidence_of
from tests.gap.small_campaign import SECOND
from tests.selection import some

FACES = np.concatenate([np.eye(3), -np.eye(3)])


@pytest.mark.slow
def test_a_bias_is_fitted_and_not_suggested() -> None:
    strong: Effect = Bias((0.3,) * 3)
    assert not list(CANDIDATES["bias"].guesses(evidence_of("tumble", "A1", {"A1": (strong,)})))


@pytest.mark.parametrize(("kind", "sensor", "within"), some([("tumble", "A1", 0.002), ("motion", "G1", 0.02)], 1))
def test_a_scale_error_is_suggested_at_its_size(kind: str, sensor: str, within: float) -> None:
    """Motion is compared with that of one other sensor; a part of it is beyond the range."""
    (trial,) = CANDIDATES["scale"].guesses(evidence_of(kind, sensor, {sensor: (Scale((0.05, -0.08, 0.06)),)}))
    (found,) = trial.effects
    assert isinstance(found, Scale)
    assert trial.free == ("error",)
    np.testing.assert_allclose(found.error, (0.05, -0.08, 0.06), atol=within)


@pytest.mark.slow
def test_a_scale_error_is_suggested_from_gains_along_each_axis() -> None:
    """The gain by three axes has no value, as in a rotation about a single axis; the gain along each axis alone has."""
    evidence = evidence_of("motion", "G1", {"G1": (Scale((0.06, 0.06, 0.06)),)})
    blind = replace(evidence, scores={**evidence.scores, "motion_gain": 0 * evidence.scores["motion_gain"]})
    common, each = CANDIDATES["scale"].guesses(blind)
    (effect,) = common.effects
    assert effect.error == pytest.approx((0.06, 0.06, 0.06), abs=0.02)
    assert len(set(effect.error)) == 1
    assert isinstance(each.effects[0], Scale)


@pytest.mark.slow
def test_exchanged_axes_are_suggested_from_all_motions_together() -> None:
    """Gains of single phases have no value, as for turns about single axes; the motions together determine the
    exchange.
    """
    wrong = AxisError("-Y+X+Z")
    evidence = evidence_of("motion", "G1", {"G1": (wrong,)})
    unknown = {probe: np.full_like(evidence.values[probe], np.nan) for probe in ("motion_gain", "motion_next")}
    blind = replace(evidence, **{name: {**getattr(evidence, name), **unknown} for name in ("values", "scores")})
    assert wrong in [hypothesis.effects[0] for hypothesis in CANDIDATES["axis_error"].guesses(blind)]


@pytest.mark.slow
def test_an_axis_within_the_population_has_no_suggested_error() -> None:
    (trial,) = CANDIDATES["scale"].guesses(evidence_of("tumble", "A1", {"A1": (Scale((0.05, 0.0, 0.0)),)}))
    (found,) = trial.effects
    assert isinstance(found, Scale)
    assert found.error[0] == pytest.approx(0.05, abs=0.002)
    assert found.error[1:] == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect", [Scale((0.1,) * 3, spans=(0, 17.0, 1e9)), Bias((0.0, 0.0, 0.1), spans=(0, 17.0, 1e9))]
)
def test_a_level_change_in_a_motion_suggests_a_bias_or_a_scale(effect: Effect) -> None:
    """The z axis of the box is up before and after the motion: 0.1 g of bias, or a tenth of the force along z."""
    evidence = evidence_of("motion", "A1", {"A1": (effect,)})
    trials = [
        *CANDIDATES["bias"].guesses(evidence),
        *(trial for trial in CANDIDATES["scale"].guesses(evidence) if trial.when.spans),
    ]
    sizes = [trial.effects[0].offset if trial.name == "bias" else trial.effects[0].error for trial in trials]
    assert [trial.name for trial in trials] == ["bias", "scale", "scale"]
    np.testing.assert_allclose(sizes, [(0.0, 0.0, 0.1), (0.0, 0.0, 0.1), (0.1, 0.1, 0.1)], atol=0.001)
    for trial in trials:
        (span,) = trial.when.spans
        assert (span.log, span.length_s) == (0, np.inf)
        assert trial.begin_bounds_s == pytest.approx((5.0, 25.0), abs=0.05)  # levels of the motion
        assert trial.free == ({"bias": "offset", "scale": "error"}[trial.name],)


@pytest.mark.slow
def test_a_level_change_at_rest_suggests_a_bias() -> None:
    evidence = evidence_of("static", "A1", {"A1": (Scale((0.1,) * 3, spans=(0, 15.0, 1e9)),)})
    (trial,) = CANDIDATES["bias"].guesses(evidence)
    assert trial.begin_bounds_s is None
    assert not list(CANDIDATES["scale"].guesses(evidence))


@pytest.mark.slow
def test_a_scale_change_between_two_times_on_the_same_faces() -> None:
    """By 1 % along y, 100 s after the beginning of the tumble, before it is repeated."""
    evidence = evidence_of("tumble", "A1")
    sensitivity = evidence.header.sensitivity
    again = []
    for phase in evidence.still:
        later = phase.raw.phase._replace(
            start_ns=phase.raw.phase.start_ns + 100 * SECOND, end_ns=phase.raw.phase.end_ns + 100 * SECOND
        )
        change = np.array([0.0, 0.01, 0.0]) * applied_g([phase.residual])[0] * sensitivity
        before = phase.residual.segments
        segments = replace(before, mean=before.mean + change, time_s=before.time_s + 100.0)
        again.append(
            replace(
                phase,
                raw=replace(phase.raw, phase=later),
                residual=replace(phase.residual, phase=later, segments=segments),
            )
        )
    scores = {**evidence.scores, "force_return": np.array([[0.1, 30.0, -0.2]])}
    trials = list(CANDIDATES["scale"].guesses(replace(evidence, phases=(*evidence.phases, *again), scores=scores)))
    (trial,) = [trial for trial in trials if trial.begin_bounds_s is None]
    (effect,) = trial.effects
    assert isinstance(effect, Scale)
    np.testing.assert_allclose(effect.error, [0.0, 0.01, 0.0], atol=1e-4)
    along = [phase.raw.phase for phase in evidence.still if np.abs(applied_g([phase.residual])[0][1]) > 0.5]
    (span,) = trial.when.spans
    middle_ns = (max(phase.end_ns for phase in along) + min(phase.start_ns for phase in along) + 100 * SECOND) / 2
    assert span.moment_s == pytest.approx(middle_ns * 1e-9)
    assert span.length_s == np.inf


@pytest.mark.parametrize(("kind", "sensor", "within"), some([("tumble", "A1", 0.1), ("motion", "G1", 0.5)], 1))
def test_a_misalignment_is_suggested_at_its_size(kind: str, sensor: str, within: float) -> None:
    angles = (4.0, 0.0, 0.0, 0.0, 0.0, -3.0)
    (trial,) = CANDIDATES["misalignment"].guesses(evidence_of(kind, sensor, {sensor: (Misalignment(angles),)}))
    (found,) = trial.effects
    assert isinstance(found, Misalignment)
    assert trial.free == ("angles_deg",)
    np.testing.assert_allclose(found.angles_deg, angles, atol=within)


@pytest.mark.parametrize(
    ("kind", "sensor", "axes"),
    some(
        [
            ("tumble", "A1", "+Y+X-Z"),
            ("tumble", "A2", "+Y+Z+X"),
            ("tumble", "A1", "-X+Y+Z"),
            ("motion", "G1", "-X+Y+Z"),
            ("motion", "A1", "+Z-Y+X"),
        ],
        1,
    ),
)
def test_an_axis_error_is_suggested(kind: str, sensor: str, axes: str) -> None:
    """The right orientation is suggested first."""
    trials = list(CANDIDATES["axis_error"].guesses(evidence_of(kind, sensor, {sensor: (AxisError(axes),)})))
    assert 1 <= len(trials) <= 3
    assert trials[0] == Hypothesis((AxisError(axes),))


@pytest.mark.slow
def test_an_axis_error_of_the_model_is_removed_or_replaced() -> None:
    """Removed, or replaced by an orientation that fits better."""
    swapped = AxisError("-X-Y+Z")
    evidence = evidence_of("tumble", "A1", {"A1": (AxisError("+Y+X-Z"),)}, modelled=(swapped,))
    first, second, *_ = CANDIDATES["axis_error"].guesses(evidence)
    assert first == Hypothesis((), removed="axis_error")
    assert second == Hypothesis((AxisError("+Y+X-Z"),), removed="axis_error")


@pytest.mark.slow
def test_removal_of_scale_and_misalignment_is_not_suggested() -> None:
    """Every unit has both."""
    evidence = evidence_of("tumble", "A1")
    assert {"scale", "misalignment"} <= {effect.name for effect in evidence.effects}
    assert not [*CANDIDATES["scale"].guesses(evidence), *CANDIDATES["misalignment"].guesses(evidence)]


def test_there_are_47_exchanges() -> None:
    """Signed permutations of three axes: 3! 2^3 = 48 with the nominal one; the effect has the same notation."""
    found = exchanges()
    assert len(found) == 47
    vectors = np.array([[1.0, 2.0, 3.0]])
    for axes, matrix in found.items():
        np.testing.assert_array_equal(AxisError(axes)._exchange(vectors), vectors @ matrix.T)
    hands = [round(np.linalg.det(matrix)) for matrix in found.values()]
    assert hands == [1] * 23 + [-1] * 24


@given(st.lists(st.floats(-0.3, 0.3), min_size=9, max_size=9))
def test_response_of_six_faces_is_exact(errors: list[float]) -> None:
    matrix = np.reshape(errors, (3, 3))
    found = Response(FACES, FACES @ (np.eye(3) + matrix).T)
    np.testing.assert_allclose(found.error, matrix, atol=1e-12)
    assert found.misfit(np.eye(3) + matrix) < 1e-20


def test_responses_that_two_faces_do_not_determine_are_no_error() -> None:
    """The two faces of z determine how each axis follows z, and no other response."""
    stimulus = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    error = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [0.1, 0.2, 0.3]])
    found = Response(stimulus, stimulus @ (np.eye(3) + error).T).error
    np.testing.assert_allclose(found, [[0, 0, 0.3]] * 3, atol=1e-12)


@pytest.mark.slow
def test_nothing_is_suggested_without_a_turn() -> None:
    evidence = replace(evidence_of("static", "A1"), scores={"mean": np.full((1, 3), 50.0)})
    for guesses in (CANDIDATES["scale"].guesses, CANDIDATES["misalignment"].guesses, CANDIDATES["axis_error"].guesses):
        assert not list(guesses(evidence))


@pytest.mark.slow
def test_phases_are_weighted_by_their_errors() -> None:
    """0.1 at 10 standard deviations and -0.8 at one: weights 1e4 and 1.5625. nan means unknown in a phase."""
    evidence = evidence_of("motion", "G1", seed=3)
    size = np.array([[0.1, 1e-6, 1e-6], [-0.8, 1e-6, 1e-6], [np.nan] * 3])
    score = np.array([[10.0, 1.0, 1.0], [1.0, 1.0, 1.0], [np.nan] * 3])
    values, expected, scores = dict(evidence.values), dict(evidence.expected), dict(evidence.scores)
    for probe, stimulus in (("motion_gain", 1.0), ("motion_next", 0.0), ("motion_after", 0.0)):
        expected[probe] = np.full((3, 3), stimulus)
        values[probe] = expected[probe] + (size if stimulus else np.where(np.isnan(size), np.nan, 1e-6))
        scores[probe] = score
    measured = response(replace(evidence, values=values, expected=expected, scores=scores))
    assert measured is not None
    assert measured.error[0, 0] == pytest.approx((0.1 * 1e4 - 0.8 * 1.5625) / (1e4 + 1.5625), rel=1e-4)
    assert measured.error[1, 1] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("share", "axes"), [(-1.01, ["+X-Y+Z"]), (0.9, [])])
def test_a_rotation_about_one_axis_determines_its_sign(share: float, axes: list[str]) -> None:
    """The other two axes are not determined; an axis that reads nine tenths of the rotation is not reversed."""

    def of_y(value: float) -> dict[str, np.ndarray]:
        return {"motion_along": np.array([[math.nan, value, math.nan]])}

    evidence = replace(
        evidence_of("static", "G2"), values=of_y(share), expected=of_y(1.0), scores=of_y(1000 * (share - 1))
    )
    trials = CANDIDATES["axis_error"].guesses(evidence)
    assert [effect.axes for trial in trials for effect in trial.effects if isinstance(effect, AxisError)] == axes

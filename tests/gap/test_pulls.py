"""Pulls of parts, and the causes that may explain them."""

from __future__ import annotations

from math import nan

import pytest

from imuarray.gap.findings.causes import _MOVED_BY, pulls_of
from imuarray.gap.findings.diagnosis import Cause
from imuarray.gap.model.nuisance import NuisanceEstimate
from imuarray.simulate.effects import EFFECTS


def estimate(quantity: str = "scale factor error", sensor: str = "B2", pull: float = 59.0) -> NuisanceEstimate:
    return NuisanceEstimate(quantity, sensor, "x", 0.028 * pull, "", 0.028, "data sheet")


def cause(effect: str, probability: float = 0.6, sensors: tuple[str, ...] = ("B2",)) -> Cause:
    return Cause(effect, "add", sensors, (), probability, {}, 0.9, None, ())


@pytest.mark.parametrize(
    ("quantity", "effect", "is_explained"),
    [
        ("scale factor error", "range_reset", True),
        ("scale factor error", "scale", True),  # the same statement
        ("scale factor error", "face_error", True),
        ("scale factor error", "tone", False),
        ("scale factor error", "white_noise", False),
        ("misalignment", "axis_error", True),
        ("bias", "range_reset", True),
        ("bias", "dropped_samples", False),
        ("g-sensitivity", "channel_swap", True),
        ("rate of the data clock", "odr_error", True),
        ("rate of the data clock", "range_reset", False),
        ("cutoff of the filter", "bandwidth", True),
        ("thermal slope of the bias", "thermal_scale", True),
        ("zero of the chip's thermometer", "thermal_bias", False),
    ],
)
def test_a_cause_that_moves_the_quantity_may_explain_the_pull(quantity: str, effect: str, is_explained: bool) -> None:
    (pull,) = pulls_of([estimate(quantity)], [cause(effect)])
    assert pull.explained_by == ((effect,) if is_explained else ())


def test_only_a_listed_cause_of_the_same_sensor_may_explain_a_pull() -> None:
    (pull,) = pulls_of([estimate()], [cause("scale", sensors=("B1",)), cause("range_reset", 0.04)])
    assert pull.explained_by == ()
    (pull,) = pulls_of(
        [estimate()], [cause("scale", sensors=()), cause("range_reset", 0.06), cause("range_reset", 0.05)]
    )
    assert pull.explained_by == ("scale", "range_reset")


def test_a_quantity_without_a_tolerance_has_no_pull() -> None:
    assert pulls_of([estimate()._replace(tolerance=nan)], []) == ()
    (pull,) = pulls_of([estimate(pull=2.0)], [])
    assert (pull.value, pull.pull, pull.source) == (pytest.approx(0.056), pytest.approx(2.0), "data sheet")


def test_explanations_of_pulls_are_existing_effects() -> None:
    """Or a wrong face, which is a cause in the notes of a log."""
    assert set().union(*_MOVED_BY.values()) <= {*EFFECTS, "face_error"}

"""Wrongly noted faces are detected where most accelerometers contradict the label, and only there."""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.array import parse_array
from imuarray.axes import UP_AXES, up_vector
from imuarray.gap.findings.labels import WrongLabel, cause_of, correct_labels, face_of, find_wrong_labels, note_of
from imuarray.gap.findings.text import parameters_text
from imuarray.gap.model.base_model import fit
from imuarray.gap.recording.recordings import Recording, recording_of
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.split import split_of
from imuarray.log import open_log
from imuarray.log.format import Phase
from imuarray.simulate import Simulation, plan_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.response import AxisError
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.hand_poses import written
from tests.gap.small_campaign import summarised
from tests.selection import examples, some

SENSOR = """
[[sensor]]
name = "{name}"
chip = "{chip}"
address = {address}
range = 4
{setting}
axes = "{axes}"
"""

SENSORS = [
    ("B1", "bma180", "0x40", "bandwidth_hz = 150", "+X+Y+Z"),
    ("B2", "bma180", "0x41", "bandwidth_hz = 150", "-X+Y-Z"),
    ("D1", "adxl345", "0x53", "rate_hz = 100", "+X-Y-Z"),
    ("D2", "adxl345", "0x1d", "rate_hz = 100", "-X-Y+Z"),
]

GYROSCOPE = """
[[sensor]]
name = "G1"
chip = "l3g4200d"
address = 0x68
range = 250
rate_hz = 800
bandwidth_hz = 35
axes = "+X+Y+Z"
"""

FACES = {"z_up": "+Z", "x_up": "+X", "y_up": "+Y", "x_down": "-X", "y_down": "-Y", "z_down": "-Z", "z_up_check": "+Z"}

TUMBLE = Tumble(2.0, 0.5)

Labels = Mapping[str, str]


def tumbled(
    path: Path,
    labels: Labels,
    sensors: int = 4,
    more: Mapping[str, Sequence[Effect]] | None = None,
    only: Sequence[str] = tuple(FACES),
) -> Recording:
    """The seven faces, with `labels` replacing the right notes; there is no other information on the attitude."""
    text = '[array]\nname = "accelerometers"\nbus = "i2c:/dev/i2c-1"\n' + GYROSCOPE
    for name, chip, address, setting, axes in SENSORS[:sensors]:
        text += SENSOR.format(name=name, chip=chip, address=address, setting=setting, axes=axes)
    biases = {"B1": 0.05, "B2": -0.08, "D1": 0.1, "D2": -0.06}
    effects = {
        name: (WhiteNoise(0.004), Bias((bias, -bias, bias)), *(more or {}).get(name, ()))
        for name, bias in biases.items()
    }
    simulation = Simulation(plan_of(parse_array(text), 50.0, TUMBLE.seconds), TUMBLE, effects, seed=1)
    phases = [one._replace(up=labels.get(one.name, one.up)) for one in TUMBLE.phases if one.name in only]
    return recording_of(open_log(written(path, simulation, tuple(phases))))


def found_in(*recordings: Recording) -> tuple[WrongLabel, ...]:
    return find_wrong_labels(recordings, Campaign(tuple(map(summarised, recordings))))


def told(found: Sequence[WrongLabel]) -> dict[str, tuple[str, str]]:
    return {one.phase.name: (one.phase.up, one.up) for one in found}


@pytest.mark.parametrize(
    "labels",
    some(
        [
            {},
            {"x_up": "-X"},
            {"y_down": "+Z"},
            {"x_up": "+Y", "y_up": "+X"},
            {"z_up": "-Z", "z_down": "+Z", "x_up": "-X", "x_down": "+X"},
        ],
        1,
    ),
)
def test_each_wrong_label_is_detected(tmp_path: Path, labels: Labels) -> None:
    """Two exchanged labels are both detected."""
    found = found_in(tumbled(tmp_path / "tumble.h5", labels))
    assert told(found) == {name: (noted, FACES[name]) for name, noted in labels.items()}
    for one in found:
        assert (one.log, one.name, len(one.agree), one.or_mounted) == (0, "tumble.h5", 4, False)
        assert one.probability > 0.999


@pytest.mark.slow
def test_halves_of_phases_give_the_same_labels(tmp_path: Path) -> None:
    """The campaign of a diagnosis has each phase in two parts."""
    recording = tumbled(tmp_path / "tumble.h5", {"x_up": "-X"})
    split = split_of([recording.kind], [recording.phases])
    parted = Recording("", recording.log, recording.kind, split.phases()[0], recording.experiment)
    (found,) = find_wrong_labels([recording], Campaign((summarised(parted),)))
    assert (found.phase, found.up) == (recording.phases[1], "+X")


@pytest.mark.slow
def test_an_error_of_one_sensor_is_not_a_wrong_label(tmp_path: Path) -> None:
    """An exchange of axes, or a wrong range, in one of four: it neither indicates nor hides a wrong label."""
    for number, effect in enumerate((AxisError("+Y-X+Z"), RangeReset(2.0))):
        more = {"B1": (effect,)}
        assert not found_in(tumbled(tmp_path / f"right_{number}.h5", {}, more=more))
        (found,) = found_in(tumbled(tmp_path / f"wrong_{number}.h5", {"x_up": "-X"}, more=more))
        assert (found.phase.name, found.up) == ("x_up", "+X")
        assert found.probability > 0.99


@pytest.mark.slow
def test_a_single_accelerometer_decides_if_its_mounting_is_determined(tmp_path: Path) -> None:
    """It agrees with six of seven labels, along all axes. With faces along one axis only, or with most labels
    contradicted, its axes may as well be exchanged.
    """
    (label,) = found_in(tumbled(tmp_path / "one.h5", {"x_up": "-X"}, sensors=1))
    assert (label.phase.name, label.up, label.agree) == ("x_up", "+X", ("B1",))
    parallel = ("z_up", "z_down", "x_up")
    assert not found_in(tumbled(tmp_path / "parallel.h5", {"x_up": "-X"}, sensors=1, only=parallel))
    most = {"x_up": "-X", "x_down": "+X", "y_up": "-Y", "y_down": "+Y"}
    assert not found_in(tumbled(tmp_path / "most.h5", most, sensors=1))


@pytest.mark.slow
def test_a_large_bias_does_not_hide_a_wrong_label(tmp_path: Path) -> None:
    """With a bias of 0.45 g, one of two accelerometers is 32 degrees from three of its faces, and a rotation of it
    would fit the others.
    """
    bias = {"B2": (Bias((0.45, -0.2, -0.2)),)}
    wrong = {"y_down": "-Z", "z_down": "-Y"}
    labels = found_in(tumbled(tmp_path / "log.h5", wrong, sensors=2, more=bias))
    assert told(labels) == {name: (noted, FACES[name]) for name, noted in wrong.items()}


@pytest.mark.slow
def test_two_accelerometers_decide_together(tmp_path: Path) -> None:
    (found,) = found_in(tumbled(tmp_path / "two.h5", {"x_up": "-X"}, sensors=2))
    assert found.agree == ("B1", "B2")
    assert not found_in(tumbled(tmp_path / "split.h5", {}, sensors=2, more={"B1": (AxisError("-X+Y+Z"),)}))


@pytest.mark.slow
def test_a_rotation_of_all_sensors_is_an_alternative(tmp_path: Path) -> None:
    """Half a turn about X exchanges +Y with -Y and +Z with -Z: the labels or the axes of the whole array are wrong. A
    mirror is not a rotation, and a rightly noted face in another log excludes the rotation.
    """
    turned = {"y_up": "-Y", "y_down": "+Y", "z_up": "-Z", "z_down": "+Z", "z_up_check": "-Z"}
    recording = tumbled(tmp_path / "turned.h5", turned)
    found = found_in(recording)
    assert told(found) == {name: (noted, FACES[name]) for name, noted in turned.items()}
    assert {cause_of(one).confusable_with for one in found} == {("axis_error",)}
    still = tumbled(tmp_path / "still.h5", {}, only=("z_up",))
    assert {cause_of(one).confusable_with for one in found_in(recording, still)} == {()}
    mirrored = tumbled(tmp_path / "mirrored.h5", {"y_up": "-Y", "y_down": "+Y"})
    assert {cause_of(one).confusable_with for one in found_in(mirrored)} == {()}


CROSSED = {"B1": (AxisError("-X+Y-Z"),), "B2": (AxisError("-X+Y-Z"),)}
"""As two have it whose plugs are crossed, half a turn about Y apart from each other: most of three feel it alike."""


@pytest.mark.slow
def test_several_rotated_sensors_are_not_wrong_labels(tmp_path: Path) -> None:
    """Two of three contradict five of seven labels: two sensors are rotated, or five labels are wrong and the third
    sensor is rotated. An additional wrong label is detected by all three.
    """
    assert not found_in(tumbled(tmp_path / "crossed.h5", {}, sensors=3, more=CROSSED))
    (found,) = found_in(tumbled(tmp_path / "wrong.h5", {"y_up": "-X"}, sensors=3, more=CROSSED))
    assert (found.phase.name, found.up, found.agree) == ("y_up", "+Y", ("B1", "B2", "D1"))


@pytest.mark.slow
def test_two_exchanged_sensors_are_not_wrong_labels(tmp_path: Path) -> None:
    """From 7 s on, so that three of five faces have the readings of each other: one exchange rather than three wrong
    labels. With a third accelerometer no face is contradicted by most.
    """
    spans = (0.0, 7.0, 1e9)
    exchanged = {"B1": (ChannelSwap("B2", spans=spans),), "B2": (ChannelSwap("B1", spans=spans),)}
    assert not found_in(tumbled(tmp_path / "two.h5", {}, sensors=2, more=exchanged))
    assert not found_in(tumbled(tmp_path / "three.h5", {}, sensors=3, more=exchanged))
    # Single wrong labels need no exchange, and neither do all of them.
    here_and_there = {"z_up": "-Z", "y_up": "-Y", "x_down": "+X", "z_down": "+Z"}
    assert len(found_in(tumbled(tmp_path / "labels.h5", here_and_there, sensors=2))) == len(here_and_there)


@pytest.mark.slow
def test_one_wrong_label_is_more_likely_than_three_rotated_sensors(tmp_path: Path) -> None:
    """One label: it and one sensor are wrong, or three sensors."""
    turned = {name: (AxisError("-X+Y-Z"),) for name in ("B1", "B2", "D1")}
    (found,) = found_in(tumbled(tmp_path / "one.h5", {}, more=turned, only=("z_up",)))
    assert (found.phase.name, found.up) == ("z_up", "-Z")


@pytest.mark.slow
def test_corrected_recordings_have_the_true_faces(tmp_path: Path) -> None:
    """In every phase, also in another process; a rightly noted log is unchanged."""
    wrong = tumbled(tmp_path / "wrong.h5", {"x_up": "-X", "z_down": "+Y"})
    right = tumbled(tmp_path / "right.h5", {})
    recordings = (right, wrong)
    found = found_in(*recordings)
    assert [one.log for one in found] == [1, 1]
    same, put_right = correct_labels(recordings, found)
    assert same is right
    assert put_right.phases == right.phases
    assert (put_right.kind, put_right.name) == ("tumble", "wrong.h5")
    assert put_right.notes[-2].startswith("phase 'x_up' is noted with -X up, but 4 of 4 accelerometers measure +X up")
    motion = put_right.experiment.motion
    middles = np.array([(one.start_ns + one.end_ns) // 2 for one in right.phases])
    expected = 9.80665 * np.array([up_vector(up) for up in FACES.values()])
    np.testing.assert_allclose(motion.stimulus(middles).force_box, expected, atol=9.8 * 5e-3)  # a tilt is estimated
    copy = pickle.loads(pickle.dumps(motion))  # noqa: S301
    assert np.array_equal(copy.stimulus(middles).force_box, motion.stimulus(middles).force_box)
    campaign = Campaign((summarised(put_right),))
    assert not find_wrong_labels([put_right], campaign)
    offset = fit(campaign, [motion]).fitted["B1"].offset
    np.testing.assert_allclose(offset, [0.05, -0.05, 0.05], atol=1e-3)


@pytest.mark.slow
def test_unnoted_attitudes_are_estimated_again_after_the_correction(tmp_path: Path) -> None:
    """A wrong label biases the common bias, and with it the attitude of phases without a note."""
    recording = tumbled(tmp_path / "part.h5", {"x_up": "-X", "y_up": ""})
    (found,) = found_in(recording)
    (put_right,) = correct_labels([recording], [found])
    at = np.array([(one.start_ns + one.end_ns) // 2 for one in put_right.phases])
    np.testing.assert_allclose(put_right.experiment.motion.stimulus(at).force_box[2] / 9.80665, [0, 1, 0], atol=0.03)
    assert [one.up for one in put_right.phases][:3] == ["+Z", "+X", ""]


def made(readings: Mapping[str, Sequence[float]], agree: tuple[str, ...]) -> WrongLabel:
    return WrongLabel(
        0, "a.h5", Phase(0, 10**9, "x_up", "-Z"), "+X", {k: np.array(v) for k, v in readings.items()}, agree
    )


def test_probability_and_closed_share_of_a_wrong_label() -> None:
    """A is 3-4-5: sqrt(2 (1 - 0.96)) from +X and sqrt(2 (1 + 0.28)) from -Z; B, eight times too large, the same. Two
    votes: odds (2.56 / 0.08)^2 = 1024. Chi-squared of 4: 0.48442 and 11.1433 (2.5 and 97.5 %).
    """
    found = made({"A": (0.96, 0.0, 0.28), "B": (7.68, 0.0, 2.24)}, ("A", "B"))
    assert found.true_g**2 == pytest.approx(0.08)
    assert found.noted_g**2 == pytest.approx(2.56)
    assert found.probability == pytest.approx(1024 / 1025)
    cause = cause_of(found, ("A", "B", "C"))
    assert (cause.effect, cause.action, cause.origin) == ("face_error", "add", "metadata")
    assert cause.sensors == ("A", "B", "C")
    assert cause.closed == pytest.approx(1 - 1 / 32)
    assert cause.closed_ci95 == pytest.approx((1 - 4 / 32 / 0.48442, 1 - 4 / 32 / 11.1433), rel=1e-4)
    assert parameters_text(cause.parameters) == "log a.h5; phase x_up; noted -Z; true +X"
    assert "2 of 2 accelerometers measure +X up: 1.6 g from the noted face, 0.28 g from that one" in note_of(found)


def test_a_contradicting_sensor_cancels_a_vote() -> None:
    """Three votes against one are equivalent to two."""
    three = made({"A": (0.96, 0, 0.28), "B": (0.96, 0, 0.28), "C": (0.96, 0, 0.28), "D": (0, 0, -1)}, ("A", "B", "C"))
    assert three.probability == pytest.approx(1024 / 1025)
    assert made({"A": (1.0, 0, 0), "B": (1.0, 0, 0)}, ("A", "B")).probability == 1.0


@settings(max_examples=examples(60), deadline=None)
@given(st.sampled_from(UP_AXES), st.tuples(*[st.floats(-0.2, 0.2)] * 3), st.floats(0.1, 9.0))
def test_a_face_is_recognised_with_any_usual_bias_and_scale(
    up: str, bias: tuple[float, float, float], scale: float
) -> None:
    """0.2 g on each axis turn it by at most atan(0.283 / 0.8) = 19.5 degrees."""
    assert face_of(scale * (np.array(up_vector(up)) + bias)) == up


def test_an_edge_is_not_a_face() -> None:
    assert face_of(np.array([1.0, 1.0, 0.0])) == ""
    assert face_of(np.zeros(3)) == ""

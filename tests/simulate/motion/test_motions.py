"""Properties of every motion: shapes, pure functions of time, ends, phases, rest within phases."""

from __future__ import annotations

import itertools
from dataclasses import fields

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from imuarray.simulate.experiments import EXPERIMENTS, ExperimentOptions
from imuarray.simulate.motion import HandShake, Heating, Motion, Still, Tumble, turn_on_run
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.motion.trajectory import StimulusRows, Trajectory
from imuarray.simulate.motion.vehicle import Vehicle

S = 10**9
ROWS_NS = np.arange(12) * S // 2


def wobble(scale: float, offset: float) -> npt.NDArray[np.float64]:
    at = ROWS_NS[:, None] * 1e-9 + np.array([0.0, 2.0, 4.0])
    return scale * np.sin(at + offset)


MOVES: dict[str, Motion] = {
    "still": Still("-Y", 8.0, tilt_deg=(0.5, -0.3)),
    "drift": Still(seconds=8.0, drift_degc_per_h=40.0),
    "run": turn_on_run(3, 8.0),
    "tumble": Tumble(1.0, 0.5, (25.0, 25.0, 26.0, 27.0, 27.0, 27.0, 28.0), tuple((0.1 * k, -0.2) for k in range(7))),
    "heating": Heating(scale=0.002),
    "shake": HandShake(still_s=2.0, motion_s=5.0),
    "vehicle": Vehicle(still_s=2.0, drive_s=6.0),
    "trajectory": Trajectory(ROWS_NS, ROWS_NS * 1e-9, wobble(0.1, 0.0), Rotation.from_rotvec(wobble(0.5, 1.0))),
    "rows": StimulusRows(ROWS_NS, np.full(12, 20.0), wobble(9.0, 0.0), wobble(2.0, 1.0)),
}
moving = pytest.mark.parametrize("motion", MOVES.values(), ids=MOVES.keys())


def columns(stimulus: BoxStimulus) -> dict[str, npt.NDArray[np.float64]]:
    return {item.name: np.asarray(getattr(stimulus, item.name)) for item in fields(stimulus)}


@moving
def test_columns_have_their_shapes(motion: Motion) -> None:
    for count in (0, 1, 5):
        shapes = {name: values.shape for name, values in columns(motion.stimulus(np.arange(count) * 2 * S)).items()}
        vectors = ("force_box", "rate_box", "angular_acceleration_box", "field_box")
        scalars = ("time_ns", "temperature_degc", "pressure_pa")
        assert shapes == dict.fromkeys(vectors, (count, 3)) | dict.fromkeys(scalars, (count,))


@moving
def test_any_order_and_any_part_of_times_give_the_same_bits(motion: Motion) -> None:
    times = np.arange(-S, round(motion.seconds * S) + S, 7_654_321)
    whole = columns(motion.stimulus(times))
    order = np.random.default_rng(1).permutation(len(times))
    parts = (order, slice(None, None, 7), slice(-13, None), slice(130, 133))
    for part in parts:
        for name, values in columns(motion.stimulus(times[part])).items():
            assert np.array_equal(values, whole[name][part]), name


@moving
def test_nothing_changes_before_the_begin_and_after_the_end(motion: Motion) -> None:
    end_ns = round(motion.seconds * S)
    shown = columns(motion.stimulus(np.array([-(10**15), -1, 0, end_ns, end_ns + 1, 10**18])))
    for name, values in shown.items():
        if name != "time_ns":
            assert (values[:3] == values[0]).all(), name
            assert (values[3:] == values[3]).all(), name


@moving
def test_phases_are_in_order_and_end_with_the_motion(motion: Motion) -> None:
    phases = motion.phases
    assert phases[0].start_ns == 0
    assert phases[-1].end_ns == round(motion.seconds * S)
    assert all(phase.start_ns < phase.end_ns for phase in phases)
    assert all(before.end_ns <= after.start_ns for before, after in itertools.pairwise(phases))


@moving
def test_a_phase_with_a_face_up_is_at_rest_with_gravity(motion: Motion) -> None:
    for phase in motion.phases:
        if not phase.up:
            continue
        times = np.linspace(phase.start_ns, phase.end_ns - 1, 50).astype(np.int64)
        stimulus = motion.stimulus(times)
        sign = 1.0 if phase.up[0] == "+" else -1.0
        assert stimulus.force_box[:, "XYZ".index(phase.up[1])] * sign == pytest.approx(9.80665, rel=1e-3)
        assert np.linalg.norm(stimulus.force_box, axis=1) == pytest.approx(9.80665, rel=1e-12)
        assert not stimulus.rate_box.any()
        assert not stimulus.angular_acceleration_box.any()


def test_experiments_have_their_names_phases_and_lengths() -> None:
    assert list(EXPERIMENTS) == ["static", "tumble", "heating", "turn-on", "motion"]
    names = {key: [phase.name for phase in make(ExperimentOptions()).phases] for key, make in EXPERIMENTS.items()}
    assert names == {
        "static": ["static"],
        "tumble": ["z_up", "x_up", "y_up", "x_down", "y_down", "z_down", "z_up_check"],  # paper, Table 10
        "heating": ["room", "heat", "cool", "heat", "cool"],
        "turn-on": ["run 1"],
        "motion": ["static", "motion", "static"],
    }
    assert EXPERIMENTS["turn-on"](ExperimentOptions()).seconds == 300  # section 4: five minutes
    assert EXPERIMENTS["tumble"](ExperimentOptions()).seconds == 7 * 900 + 6 * 5  # section 4: fifteen minutes a face


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Still("up"), "up"),
        (lambda: Still(seconds=0.0), "seconds"),
        (lambda: Still(seconds=float("inf")), "seconds"),
        (lambda: Still(temperature_degc=float("nan")), "temperature_degc"),
        (lambda: Still(tilt_deg=(0.0, float("nan"))), "tilt_deg"),
        (lambda: turn_on_run(0), "k"),
        (lambda: Tumble(face_s=-1.0), "face_s"),
        (lambda: Tumble(turn_s=0.0), "turn_s"),
        (lambda: Tumble(temperatures_degc=(25.0,)), "temperatures_degc: 1 given"),
        (lambda: Tumble(temperatures_degc=(float("nan"),) * 7), "temperatures_degc, z_up"),
        (lambda: Tumble(tilts_deg=((0.0, float("inf")),) * 7), "tilt_deg"),
        (lambda: Heating(scale=0.0), "scale"),
        (lambda: Heating(peaks_degc=(40.0, float("nan"))), "second_peak"),
        (lambda: HandShake(peak_g=float("nan")), "peak_g"),
        (lambda: HandShake(seed=-1), "seed"),
        (lambda: Vehicle(speed_mps=0.0), "speed_mps"),
        (lambda: Vehicle(road_mps2=-0.1), "road_mps2"),
        (lambda: Vehicle(lateral_mps2=float("inf")), "lateral_mps2"),
    ],
)
def test_impossible_motions_are_refused(make: object, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        make()  # type: ignore[operator]

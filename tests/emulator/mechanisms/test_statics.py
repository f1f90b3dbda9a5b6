"""Mechanisms of the stimulus, of temperature and of start-up, against the physics that they state."""

from __future__ import annotations

import math

import numpy as np
import pytest

from firmware_emulator.mechanisms.converter import RangeSwitch
from firmware_emulator.mechanisms.mechanism import FittedBoard, Fitting
from firmware_emulator.mechanisms.mounting import CrossedWiring, DroppedBox, LeverArm, PackageTilt, RotatedPackage
from firmware_emulator.mechanisms.power import BiasCurrentDac, LogCreep, PowerOnStress, SupplyDrift, SupplyDroop
from firmware_emulator.mechanisms.response import (
    DriveImbalance,
    PipelineDelay,
    PlateGap,
    ReferenceVoltage,
    SoftClipping,
    VibrationRectification,
)
from firmware_emulator.mechanisms.thermal import BoardToDie, GainResistor, SelfHeating, ThermalHysteresis, ThermistorBow
from firmware_emulator.world import STANDARD_GRAVITY, UPRIGHT, StillWorld, WorldStimulus
from tests.emulator.mechanisms.mechanism_bench import (
    ARRAY,
    MS,
    IdealBoard,
    S,
    board,
    errors,
    every,
    samples,
    turning,
    warm,
)


def force(x: float, y: float, z: float):
    """A world of constant specific force in g."""
    stimulus = WorldStimulus((x * STANDARD_GRAVITY, y * STANDARD_GRAVITY, z * STANDARD_GRAVITY))
    return lambda at_ns: stimulus


def reading(mechanism, name, world=None, at_ns=S, **settings):
    """A single reading (3,)."""
    return samples(board(mechanism, name, world=world, **settings), name, [at_ns])[0]


def test_a_reference_three_percent_high_reduces_all_readings():
    assert reading(ReferenceVoltage(0.03), "BMA") == pytest.approx([0, 0, 1 / 1.03])


def test_a_tilted_package_measures_the_same_force_in_rotated_axes():
    upright, sideways = reading(PackageTilt(2.0), "BMA"), reading(PackageTilt(2.0), "BMA", force(1, 0, 0))
    assert np.linalg.norm(upright) == pytest.approx(1.0)
    assert upright @ sideways == pytest.approx(0.0, abs=1e-12)
    tilts = [np.degrees(np.arccos(axis @ reading(PackageTilt(2.0), "BMA", force(*axis)))) for axis in np.eye(3)]
    assert max(tilts) <= 2.0 + 1e-6
    squares = np.sum((2 - 2 * np.cos(np.radians(tilts))) / (2 - 2 * math.cos(math.radians(2.0))))
    assert squares == pytest.approx(2.0)  # the trace of a rotation is 1 + 2 cos, for any axis


def test_a_quarter_turn_swaps_x_and_y():
    assert reading(RotatedPackage(), "BMA", force(0.3, 0.5, 0.7)) == pytest.approx([0.5, -0.3, 0.7])


def test_the_scale_grows_as_the_plate_gap_closes():
    assert reading(PlateGap(gap_g=80.0), "BMA")[2] == pytest.approx(80 / 79)
    assert reading(PlateGap(gap_g=80.0), "BMA", force(0, 0, -1))[2] == pytest.approx(-80 / 81)


def test_a_pendulous_gyroscope_is_sensitive_only_to_force_across_its_axis():
    pulls = [reading(DriveImbalance(0.3), "Gyro", force(*axis)) for axis in np.eye(3)]
    for axis, pull in zip(np.eye(3), pulls, strict=True):
        assert pull @ axis == pytest.approx(0.0, abs=1e-12)
    assert np.allclose(np.array(pulls), -np.array(pulls).T)  # a vector product is antisymmetric
    assert np.sum(np.square(pulls)) == pytest.approx(2 * 3 * 0.3**2)
    assert reading(DriveImbalance(0.3), "Gyro", force(0, 0, 2)) == pytest.approx(2 * pulls[2])


def test_the_thermistor_bow_is_even_about_room_temperature():
    at = {
        degc: reading(ThermistorBow(50e-6), "BMA", warm(lambda _, degc=degc: degc)) for degc in (5.0, 25.0, 35.0, 45.0)
    }
    assert at[25.0] == pytest.approx([0, 0, 1])
    bow = at[45.0] - [0, 0, 1]
    assert at[5.0] - [0, 0, 1] == pytest.approx(bow)
    assert (at[35.0] - [0, 0, 1]) * 4 == pytest.approx(bow)
    assert math.sqrt(np.mean(bow**2)) == pytest.approx(0.02)


def test_the_gain_resistor_raises_gain_by_the_same_factor_for_every_degree():
    got = [reading(GainResistor(1e-3), "BMA", warm(lambda _, degc=degc: degc))[2] for degc in (25.0, 35.0, 45.0)]
    assert got[0] == 1.0
    assert got[2] == pytest.approx(got[1] ** 2)
    assert got[1] == pytest.approx(math.exp(0.01))


def heated_errors(mechanism, degc, times):
    """Temperature that the bias of a unit with 1 dps/K follows, read as dps."""

    class Slope(IdealBoard):
        def unit(self, sensor):
            return super().unit(sensor).__class__(slope_per_degc=(1.0, 1.0, 1.0))

    fitted = Slope(ARRAY, warm(degc), 1, [Fitting(mechanism, ("Gyro",))])
    return samples(fitted, "Gyro", times)[:, 0] + 25.0


def test_under_a_ramp_the_die_lags_by_both_time_constants():
    late = heated_errors(BoardToDie(6.0, 2.0), lambda at_s: 25.0 + 0.1 * at_s, every(20, 5000))
    assert (25.0 + 0.1 * 99.98 - late[-1]) / 0.1 == pytest.approx(8.0, abs=0.03)


def test_after_a_step_the_die_follows_two_exponentials():
    got = heated_errors(BoardToDie(6.0, 2.0), lambda at_s: 35.0 if at_s >= 1 else 25.0, every(10, 3000))
    since = np.arange(3000) * 0.01 - 1
    wanted = np.where(since > 0, 35 - 10 * (6 * np.exp(-since / 6) - 2 * np.exp(-since / 2)) / 4, 25.0)
    assert np.abs(got - wanted).max() < 0.05


def test_the_thermometer_lags_by_the_time_constant_of_the_board():
    fitted = board(BoardToDie(6.0, 2.0), "BMA", world=warm(lambda at_s: 25.0 + 0.1 * at_s))
    element = fitted.element(fitted.sensors["BMA"])
    for at_ns in every(20, 5000):
        element.sample(at_ns, 2.0, 1.0)
    assert 25.0 + 9.998 - element.temperature(99_980 * MS) == pytest.approx(0.6, abs=0.005)


def test_self_heating_affects_only_the_chips_own_thermometer():
    fitted = board(SelfHeating(3.0, 5.0), "BMA")
    element = fitted.element(fitted.sensors["BMA"])
    got = [element.temperature(at * S) for at in (0, 5, 500)]
    assert got == pytest.approx([25.0, 28.0 - 3 / math.e, 28.0])
    assert element.sample(500 * S, 2.0, 1.0) == (0.0, 0.0, 1.0)


def test_hysteresis_depends_on_the_path_and_not_on_the_rate():
    def up_and_down(at_s: float) -> float:
        return 25.0 + (at_s if at_s < 20 else 40 - at_s)

    error = errors(ThermalHysteresis(size_dps=0.3, backlash_k=3.0), "Gyro", every(100, 400), world=warm(up_and_down))
    warming, cooling = error[150], error[350]
    assert cooling == pytest.approx(-warming)
    assert math.sqrt(np.mean(warming**2)) == pytest.approx(0.3)
    slow = errors(
        ThermalHysteresis(size_dps=0.3, backlash_k=3.0),
        "Gyro",
        every(1000, 400),
        world=warm(lambda at_s: up_and_down(at_s / 10)),
    )
    assert np.allclose(slow, error)


def test_scale_sags_with_the_battery():
    values = samples(board(SupplyDroop(0.02, 40.0), "BMA"), "BMA", [0, 40 * S, 4000 * S])[:, 2]
    assert values == pytest.approx([1.0, 1 - 0.02 * (1 - math.exp(-1)), 0.98])


def test_creep_adds_the_same_in_every_decade_and_boot():
    values = [errors(LogCreep(per_decade_dps=0.15), "Gyro", [0, 9 * S, 99 * S, 999 * S], run=run) for run in (0, 5)]
    assert np.array_equal(*values)
    assert np.allclose(values[0], np.outer([0, 1, 2, 3], values[0][1]))
    assert math.sqrt(np.mean(values[0][1] ** 2)) == pytest.approx(0.15)


@pytest.mark.slow
def test_stress_is_drawn_at_power_on_and_kept():
    runs = np.array([errors(PowerOnStress(scale_dps=0.2), "Gyro", [0, 60 * S], run=run) for run in range(400)])
    assert np.array_equal(runs[:, 0], runs[:, 1])
    drawn = np.abs(runs[:, 0].ravel())
    assert np.median(drawn) == pytest.approx(0.2 * math.log(2), rel=0.12)  # Laplace, 1200 draws
    assert drawn.mean() == pytest.approx(0.2, rel=0.12)


@pytest.mark.slow
def test_the_bias_current_starts_in_one_of_two_states():
    runs = np.array([errors(BiasCurrentDac(step_dps=0.5, share=0.4), "Gyro", [S], run=run)[0] for run in range(300)])
    states = np.unique(np.round(runs, 9), axis=0)
    assert len(states) == 2
    assert runs.any(axis=1).mean() == pytest.approx(0.4, abs=4 * math.sqrt(0.24 / 300))
    assert np.count_nonzero(states[np.abs(states).sum(axis=1) > 0]) == 3


def test_a_fall_after_the_first_recording_shifts_all_later_ones():
    runs = np.array([errors(DroppedBox(shift_dps=0.5), "Gyro", [S], run=run)[0] for run in range(4)])
    assert not runs[0].any()
    assert np.array_equal(runs[1], runs[3])
    assert math.sqrt(np.mean(runs[1] ** 2)) == pytest.approx(0.5)


def test_a_stuck_range_switch_doubles_the_codes_after_every_fourth_power_up():
    got = [samples(board(RangeSwitch(), "BMA", run=run), "BMA", [S], full_scale=16.0)[0, 2] for run in range(20)]
    wrong = [run for run, z in enumerate(got) if z != 1.0]
    assert all(got[run] == 2.0 for run in wrong)
    assert wrong[0] >= 2
    assert set(np.diff(wrong)) == {4}


@pytest.mark.parametrize(
    ("name", "asked", "in_force"),
    [("BMA", 16.0, 8.0), ("BMA", 2.0, 1.5), ("BMA", 1.0, 1.5), ("Gyro", 2000.0, 500.0), ("Gyro", 250.0, 500.0)],
)
def test_the_range_in_force_is_a_range_of_the_chip(name, asked, in_force):
    """BMA-70 to BMA-76, L3G-40 to L3G-42."""
    chain = board(RangeSwitch(every=1), name, run=9)._sites[name].chain
    assert [setting(asked) for setting in chain.full_scale] == [in_force]


def test_clipping_is_gradual_and_never_exceeds_its_limit():
    limits = SoftClipping(0.5)
    element = board(limits, "BMA", world=force(0.1, 1.0, 50.0)).element(ARRAY.sensors[1])
    x, y, z = element.sample(S, 2.0, 1.0)
    assert x == pytest.approx(0.1, rel=1e-8)
    assert y == pytest.approx(2 ** (-1 / 8))
    assert 0.99 < z <= 1.0


def test_a_delayed_chip_measures_the_earlier_value_of_a_ramp():
    world = turning(lambda at_s: (math.radians(10 * at_s), 0.0, 0.0))
    assert errors(PipelineDelay(0.02), "Gyro", [S], world=world)[0] == pytest.approx([-0.2, 0, 0])


def test_a_lever_arm_adds_centripetal_and_tangential_force():
    steady = turning(lambda at_s: (0.0, 0.0, 3.0))
    result = reading(LeverArm(0.05), "BMA", steady) * STANDARD_GRAVITY
    speeding = turning(lambda at_s: (0.0, 0.0, 4.0 * (at_s - 1.0)))
    tangential = reading(LeverArm(0.05), "BMA", speeding) * STANDARD_GRAVITY
    assert result[2] == 0.0
    across = np.linalg.norm(result) / 9.0  # the arm's part across the axis
    assert 0 < across <= 0.05
    assert np.linalg.norm(tangential) == pytest.approx(4.0 * across, rel=1e-6)
    assert tangential @ result == pytest.approx(0.0, abs=1e-9)


def test_vibration_is_rectified_by_its_mean_square():
    def shaken(at_ns: int) -> WorldStimulus:
        return UPRIGHT._replace(
            force_box=(0.5 * STANDARD_GRAVITY * math.sin(2 * math.pi * 11.0 * at_ns * 1e-9), 0.0, STANDARD_GRAVITY)
        )

    mechanism = VibrationRectification(per_g2_dps=10.0, memory_s=2.0)
    assert not errors(mechanism, "Gyro", every(10, 100)).any()
    error = errors(mechanism, "Gyro", every(7.3, 3000), world=shaken)[2000:]
    assert np.sqrt(np.mean(error.mean(axis=0) ** 2)) == pytest.approx(10.0 * 0.5**2 / 2, rel=0.03)


def test_a_drifting_supply_affects_all_chips_of_a_kind_equally():
    drift = SupplyDrift(drift_v=0.02, drift_s=0.5, per_v_dps=50.0)
    fitted = board(drift, "Gyro", "Gyro twin")
    times = every(20, 6000)
    first, twin = (samples(fitted, name, times) for name in ("Gyro", "Gyro twin"))
    axis = int(np.argmax(first.std(axis=0)))
    assert np.corrcoef(first[:, axis], twin[:, axis])[0, 1] > 0.999
    assert first.std() == pytest.approx(1.0, rel=0.25)
    lag = np.corrcoef(first[25:, axis], first[:-25, axis])[0, 1]
    assert lag == pytest.approx(math.exp(-1), abs=0.15)


def test_crossed_wires_exchange_two_units():
    fitting = Fitting(CrossedWiring(), ("BMA", "BMA twin"))
    crossed, straight = (FittedBoard(ARRAY, StillWorld(), 3, [*which], units="drawn") for which in ([fitting], []))
    for name, other in (("BMA", "BMA twin"), ("BMA twin", "BMA")):
        assert np.array_equal(samples(crossed, name, every(5, 9)), samples(straight, other, every(5, 9)))

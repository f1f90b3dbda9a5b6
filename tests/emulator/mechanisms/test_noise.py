"""Mechanisms that fluctuate, against closed forms of their statistics. Seeds are fixed; limits are 4 or more sigma."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal, stats

from firmware_emulator.mechanisms.converter import InterleavedConverters
from firmware_emulator.mechanisms.disturbances import (
    CarrierShotNoise,
    KeyedTransmitter,
    MainsRipple,
    OneSidedNoise,
    ReferenceNoise,
    SingleTrap,
    SpinningMotor,
    StressRelaxation,
    TrappedCharges,
)
from firmware_emulator.mechanisms.response import OutputFilter
from firmware_emulator.world import DelayedWorld, StillWorld
from tests.emulator.mechanisms.mechanism_bench import MS, S, board, errors, every, samples, turning


def test_shot_noise_has_twice_the_carriers_as_its_variance():
    error = errors(CarrierShotNoise(carriers=8.0, step_dps=0.5), "Gyro", every(10, 4000))
    steps = error / 0.5
    assert np.allclose(steps, np.round(steps))
    assert steps.var() == pytest.approx(16.0, rel=4 * math.sqrt(2 / 12000))
    assert abs(steps.mean()) < 4 * math.sqrt(16 / 12000)


def test_the_number_of_carriers_grows_with_the_square_of_shot_noise():
    """The charge is the same: noise twice as strong has four times the carriers, and no coarser steps."""
    assert CarrierShotNoise.at(2.0) == CarrierShotNoise(carriers=4 * CarrierShotNoise().carriers)


@pytest.mark.slow
def test_a_bank_of_traps_has_the_mean_of_its_traps_correlations():
    bank = TrappedCharges(rms_dps=1.0, traps=6, fastest_s=0.01, slowest_s=0.5)
    error = errors(bank, "Gyro", every(10, 30000))
    assert error.var() == pytest.approx(1.0, rel=0.1)
    for lag in (1, 5, 20):
        correlation = np.mean(error[lag:] * error[:-lag]) / error.var()
        assert correlation == pytest.approx(np.mean(np.exp(-0.01 * lag / np.geomspace(0.01, 0.5, 6))), abs=0.05)


@pytest.mark.slow
def test_slips_add_up_to_a_random_walk():
    walk = errors(StressRelaxation(slips_per_s=50.0, scale_dps=0.1), "Gyro", every(1000, 4000))
    increments = np.diff(walk, axis=0)
    assert increments.var() == pytest.approx(50.0 * 2 * 0.1**2, rel=0.08)
    assert np.var(walk[100:] - walk[:-100]) == pytest.approx(100 * 50.0 * 2 * 0.1**2, rel=0.5)
    assert stats.kurtosis(increments, axis=None) == pytest.approx(6 * 4 / (50 * 4), abs=0.25)  # lambda E x^4 / var^2


@pytest.mark.slow
def test_a_trap_is_full_for_its_share_of_the_time_and_on_one_axis():
    error = errors(SingleTrap(size_dps=0.4, capture_s=0.3, emission_s=0.1), "Gyro", every(10, 40000))
    assert np.count_nonzero(error.any(axis=0)) == 1
    axis = int(np.argmax(error.any(axis=0)))
    assert set(np.round(error[:, axis], 9)) == {0.0, 0.4}
    assert (error[:, axis] > 0).mean() == pytest.approx(0.25, abs=0.04)


def test_the_output_filter_answers_a_step_as_scipys_butterworth_does():
    jump = turning(lambda at_s: (1.0 if at_s >= 0.1 else 0.0, 0.0, 0.0))
    times = every(0.5, 600)
    got = np.radians(samples(board(OutputFilter(10.0), "Gyro", world=jump), "Gyro", times)[:, 0])
    _, wanted = signal.step(signal.butter(2, 2 * math.pi * 10.0, analog=True), T=np.arange(400) * 0.5e-3)
    assert np.abs(got[200:600] - wanted).max() < 0.02
    assert got.max() == pytest.approx(1.0432, abs=0.002)  # overshoot exp(-pi) of a damping of 1 / sqrt 2


def test_the_output_filter_has_its_delay_at_any_read_interval():
    """sqrt(2) / w after a rate that rises evenly: 1.0 ms at 222 Hz, read every 15 ms."""
    rising = turning(lambda at_s: (at_s, 0.0, 0.0))
    got = np.radians(samples(board(OutputFilter(222.0), "Gyro", world=rising), "Gyro", every(15, 20))[:, 0])
    late = 0.015 * np.arange(20) - got
    np.testing.assert_allclose(late[5:], math.sqrt(2) / (2 * math.pi * 222.0), rtol=1e-3)


def test_an_input_change_long_before_a_read_has_settled():
    """As when a chip is set up: its filter has settled long since, 0.8 s or 50 time constants ago."""
    shifted = turning(lambda at_s: (1.0 if at_s >= 0.05 else 0.0, 0.0, 0.0))
    times = [0, 40_000_000, 860_000_000, 880_000_000]
    got = np.radians(samples(board(OutputFilter(10.0), "Gyro", world=shifted), "Gyro", times)[:, 0])
    np.testing.assert_allclose(got, [0.0, 0.0, 1.0, 1.0], atol=1e-6)


@pytest.mark.slow
def test_the_output_filter_colours_noise_as_scipys_butterworth_does():
    values = samples(board(OutputFilter(5.0), "Gyro", noisy=True), "Gyro", every(10, 30000))
    frequencies = np.linspace(0.0, 2000.0, 400001)
    _, response = signal.freqs(*signal.butter(2, 2 * math.pi * 5.0, analog=True), worN=2 * math.pi * frequencies)
    power = np.abs(response) ** 2
    assert np.trapezoid(power, frequencies) == pytest.approx(5 * math.pi / (2 * math.sqrt(2)), rel=1e-3)
    for lag in (1, 2, 5, 10):
        wanted = np.trapezoid(power * np.cos(2 * math.pi * frequencies * 0.01 * lag), frequencies)
        got = np.mean(values[lag:] * values[:-lag]) / values.var()
        assert got == pytest.approx(wanted / np.trapezoid(power, frequencies), abs=0.03)


def test_a_filter_narrower_than_the_registers_reduces_the_noise():
    element = board(OutputFilter(5.0), "Gyro", noisy=True).element(
        next(entry for entry in board(OutputFilter(), "Gyro").sensors.values() if entry.name == "Gyro")
    )
    result = np.array([element.sample(at, 250.0, 100.0) for at in every(200, 4000)])
    density = math.sqrt(100.0 / 100.0)  # 1 rms in 1 Hz is 10 rms in 100 Hz: a density of 1
    assert result.std() == pytest.approx(density * math.sqrt(5 * 1.1107), rel=0.05)


def test_mains_show_a_line_with_harmonics_that_wanders():
    error = errors(MainsRipple(peak_dps=1.0), "Gyro", every(1, 20000))
    axis = int(np.argmax(error.std(axis=0)))
    frequencies, power = signal.periodogram(error[:, axis], 1000.0, "hann")
    lines = [math.sqrt(power[np.abs(frequencies - line) < 1].sum()) for line in (50.0, 100.0, 150.0)]
    assert lines[1] / lines[0] == pytest.approx(0.3, rel=0.02)
    assert lines[2] / lines[0] == pytest.approx(0.15, rel=0.02)
    assert abs(frequencies[np.argmax(power)] - 50.0) < 0.1
    outside = np.all([np.abs(frequencies - line) > 2 for line in (50.0, 100.0, 150.0)], axis=0)
    assert power[outside].sum() < 1e-4 * power.sum()
    assert error.std() == pytest.approx(math.sqrt((1 + 0.3**2 + 0.15**2) / 2), rel=0.03)  # axes are 1 on average


def test_one_sided_noise_is_exponential():
    error = errors(OneSidedNoise(mean_dps=0.5), "Gyro", every(10, 4000)).ravel()
    assert stats.kstest(error + 0.5, "expon", args=(0.0, 0.5)).pvalue > 1e-4


def test_two_converters_take_turns():
    error = errors(InterleavedConverters(offset_dps=0.15), "Gyro", every(15.6, 100))
    assert np.allclose(error[1:], -error[:-1])
    assert np.allclose(np.abs(error), 0.15)
    twice = errors(InterleavedConverters(offset_dps=0.15), "Gyro", [5 * MS, 5 * MS + 400_000, 20 * MS])
    assert np.allclose(twice[0], twice[1])
    assert np.allclose(twice[2], -twice[0])


def test_a_transmitter_disturbs_only_while_it_sends():
    error = errors(KeyedTransmitter(rms_dps=0.5, sending_s=1.5, period_s=9.0), "Gyro", every(10, 18000))
    active = error.any(axis=1)
    assert active.mean() == pytest.approx(1.5 / 9.0, abs=0.002)
    assert np.count_nonzero(np.diff(active.astype(int)) == 1) in (19, 20)
    assert error[active].std() == pytest.approx(0.5, rel=0.03)


def test_noise_of_the_reference_is_proportional_to_the_input():
    def spread(dps: float) -> float:
        world = turning(lambda at_s: (math.radians(dps), 0.0, 0.0))
        return float(errors(ReferenceNoise(0.01), "Gyro", every(10, 4000), world=world)[:, 0].std())

    assert spread(0.0) == 0.0
    assert spread(100.0) == pytest.approx(1.0, rel=0.06)
    assert spread(200.0) == pytest.approx(2 * spread(100.0), rel=1e-6)


def test_a_motor_spins_up_to_its_speed():
    motor = SpinningMotor(speed_hz=20.0, spin_up_s=2.0, cycle_s=40.0)
    times = np.arange(0, 40, 1e-3)
    wave = np.array([motor.wave(float(at)) for at in times])
    assert not wave[times <= 10].any()
    assert np.allclose(wave, [motor.wave(float(at) + 80.0) for at in times], atol=1e-6)
    for after, wanted in ((2.0, 20 * (1 - math.exp(-1))), (25.0, 20.0)):
        part = wave[(times > 10 + after - 0.5) & (times < 10 + after + 0.5)]
        crossings = np.count_nonzero(np.diff(np.signbit(part)))
        assert crossings / 2 == pytest.approx(wanted, abs=1.0)
    assert np.abs(wave[times > 30]).max() == pytest.approx(1.0, abs=3e-3)


def test_units_differ_in_direction_and_runs_in_random_draws():
    creep = MainsRipple(peak_dps=1.0)
    first, other = (errors(creep, name, every(3, 300)) for name in ("Gyro", "Gyro twin"))
    assert not np.allclose(first.std(axis=0), other.std(axis=0), rtol=0.01)
    again = errors(creep, "Gyro", every(3, 300), run=1)
    assert not np.allclose(first, again)
    assert np.allclose(first.std(axis=0) / first.std(), again.std(axis=0) / again.std(), rtol=0.01)
    assert np.array_equal(first, errors(creep, "Gyro", every(3, 300)))


def test_mechanisms_depend_on_the_time_since_power_on():
    begun = 7 * S
    early = errors(SpinningMotor(peak_dps=1.0), "Gyro", every(7, 3000))

    late = errors(
        SpinningMotor(peak_dps=1.0),
        "Gyro",
        [begun + at for at in every(7, 3000)],
        world=DelayedWorld(StillWorld(), begun),
    )
    assert np.allclose(early, late)

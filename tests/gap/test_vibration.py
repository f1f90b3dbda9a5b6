"""Vibrations of the surroundings: measured by several sensors at rest, and simulated again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from imuarray.arrays import Floats, Times
from imuarray.axes import Matrix
from imuarray.gap.model.vibration import VibratingBox, noise_of
from imuarray.gap.recording.vibration import Vibration, vibration_along, vibrations_of
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.simulate.streams import DrawMemory, Streams
from imuarray.units import STANDARD_GRAVITY

MG = 1e-3 * STANDARD_GRAVITY
UPRIGHT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
OPPOSED: Matrix = ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0))
HZ = 100.0
REST = Phase(0, 120_000_000_000, "static", "+Z")


@dataclass(frozen=True)
class Rows:
    """An accelerometer of 1000 counts per g."""

    time: Times
    counts: Floats
    orientation: Matrix
    quantity: str = "specific_force"
    unit: str = "g"
    sensitivity: float = 1000.0

    def __len__(self) -> int:
        return len(self.time)

    def between(self, start_ns: int, end_ns: int) -> slice:
        first, stop = np.searchsorted(self.time, [start_ns, end_ns]).tolist()
        return slice(first, stop)


def band(rows: int, low_hz: float, high_hz: float, rms: float, generator: np.random.Generator) -> Floats:
    """Noise (n, 3) of this root mean square between two frequencies."""
    waves = np.fft.rfft(generator.normal(size=(rows, 3)), axis=0)
    hertz = np.fft.rfftfreq(rows, 1 / HZ)
    waves[(hertz < low_hz) | (hertz > high_hz)] = 0.0
    values = np.fft.irfft(waves, rows, axis=0)
    return np.asarray(values / values.std(axis=0) * rms)


def read(
    vibration_box_mg: Floats, orientations: Sequence[Matrix], own_mg: Sequence[Floats | float], seed: int = 1
) -> list[tuple[Vibration, ...]]:
    """The vibrations that sensors with noise of 1 mg and further noise of their own show in one log."""
    generator = np.random.default_rng(seed)
    rows = len(vibration_box_mg)
    time = (np.arange(rows) * 1e9 / HZ).astype(np.int64)
    log = {
        f"A{at}": Rows(time, (vibration_box_mg + noise) @ np.array(turn) + generator.normal(size=(rows, 3)), turn)
        for at, (turn, noise) in enumerate(zip(orientations, own_mg, strict=True))
    }
    return list(vibrations_of([cast(Any, log)], [[REST]], [{}]))


def rms_mg(vibration: Vibration, which: str) -> Floats:
    """The root mean square (3,) of a part of a vibration."""
    density = getattr(vibration, which)
    return np.asarray(np.sqrt(np.diff(vibration.edges_hz) @ density) / MG)


def test_a_vibration_that_sensors_measure_together_is_that_of_the_surroundings() -> None:
    """0.5 mg between 10 and 20 Hz below noise of 1 mg: the cross-spectrum has its variance of 0.25 mg^2."""
    shaking = band(12_000, 10.0, 20.0, 0.5, np.random.default_rng(0))
    ((vibration, *others),) = read(shaking, [UPRIGHT, OPPOSED, UPRIGHT], [0.0, 0.0, 0.0])
    assert not others
    assert rms_mg(vibration, "common") == pytest.approx([0.5] * 3, rel=0.15)
    inside = np.array(vibration.edges_hz[1:]) > 8.0
    assert not vibration.common[~inside].any()


def test_noise_that_opposed_chips_share_along_their_own_axes_is_no_vibration() -> None:
    """A supply acts along the axes of the chips, which differ in sign for two of three sensors."""
    ripple = band(12_000, 10.0, 20.0, 0.5, np.random.default_rng(0))
    own = [ripple @ np.array(turn).T for turn in (UPRIGHT, OPPOSED, UPRIGHT)]
    for log in read(np.zeros((12_000, 3)), [UPRIGHT, OPPOSED, UPRIGHT], own):
        for vibration in log:
            assert not vibration.common[:, [0, 2]].any()


def test_noise_of_a_single_sensor_is_no_vibration() -> None:
    """The others would show it, so that they contradict it, from the beginning or from the middle on."""
    noise = band(12_000, 10.0, 20.0, 1.0, np.random.default_rng(0))
    late = np.where(np.arange(12_000)[:, None] > 6000, noise, 0.0)
    for own in (noise, late):
        assert read(np.zeros((12_000, 3)), [UPRIGHT, OPPOSED, UPRIGHT], [own, 0.0, 0.0]) == [()]


def test_quiet_sensors_show_no_vibration() -> None:
    """Ten arrays of three sensors with white noise alone."""
    for seed in range(10):
        assert read(np.zeros((12_000, 3)), [UPRIGHT, OPPOSED, UPRIGHT], [0.0, 0.0, 0.0], seed) == [()]


def test_a_vibration_begins_when_the_machine_starts() -> None:
    """In the last third of the phase only."""
    shaking = band(12_000, 10.0, 20.0, 1.5, np.random.default_rng(0))
    shaking[:8000] = 0.0
    (log,) = read(shaking, [UPRIGHT, OPPOSED], [0.0, 0.0])
    by_time = {vibration.start_ns * 1e-9: rms_mg(vibration, "common").mean() for vibration in log}
    late = [rms for second, rms in by_time.items() if second > 79]
    assert late and min(late) == pytest.approx(1.5, rel=0.15)
    assert max((rms for second, rms in by_time.items() if second < 79), default=0.0) < 0.3


def test_each_sensor_measures_a_vibration_that_is_faster_than_the_rows_for_itself() -> None:
    """Rows at other moments have independent values: the excess over the quiet third is not in the cross-spectrum."""
    generator = np.random.default_rng(3)
    is_on = np.arange(12_000)[:, None] > 4000
    own = [np.where(is_on, generator.normal(size=(12_000, 3)), 0.0) for _ in range(3)]
    (log,) = read(np.zeros((12_000, 3)), [UPRIGHT, OPPOSED, UPRIGHT], list(own))
    late = [vibration for vibration in log if vibration.start_ns * 1e-9 > 50]
    assert late and all(not vibration.common.any() for vibration in late)
    share = (50 - 2) / 50  # of white noise above 2 Hz
    for vibration in late:
        assert rms_mg(vibration, "private") == pytest.approx([math.sqrt(share)] * 3, rel=0.15)


EDGES_HZ = (2.0, 10.0, 20.0, 50.0)
ONE_BAND = np.array([[0.0] * 3, [0.1, 0.2, 0.4], [0.0] * 3])


def test_simulated_noise_has_the_densities_of_its_bands() -> None:
    """10 Hz times 0.1, 0.2 and 0.4 per Hz are variances of 1, 2 and 4; axes x and y have a correlation of 0.8."""
    coherence = np.tile(np.eye(3), (3, 1, 1))
    coherence[1, 0, 1] = coherence[1, 1, 0] = 0.8
    noise = noise_of(ONE_BAND, coherence, EDGES_HZ, 200_000, 1 / 300, np.random.default_rng(0))
    assert noise.var(axis=0) == pytest.approx([1.0, 2.0, 4.0], rel=0.05)
    assert np.corrcoef(noise.T)[0] == pytest.approx([1.0, 0.8, 0.0], abs=0.05)
    hertz = np.fft.rfftfreq(200_000, 1 / 300)
    power = np.square(np.abs(np.fft.rfft(noise, axis=0)))
    assert power[(hertz < 9.99) | (hertz > 20.01)].sum() < 1e-9 * power.sum()


class Still:
    """A box at rest."""

    phases = (REST,)
    seconds = 120.0

    def stimulus(self, time_ns: Times) -> BoxStimulus:
        columns = [np.zeros((len(time_ns), 3)) for _ in range(4)]
        return BoxStimulus(time_ns, *columns, np.zeros(len(time_ns)), np.zeros(len(time_ns)))


def test_sensors_measure_the_common_part_together_and_the_private_part_for_themselves() -> None:
    time_ns = np.arange(0, 130_000_000_000, 10_000_000)
    vibration = Vibration(
        0, REST.end_ns, "specific_force", EDGES_HZ, ONE_BAND, 2 * ONE_BAND, np.tile(np.eye(3), (3, 1, 1))
    )
    forces = [
        VibratingBox(Still(), [vibration], Streams(1), log, sensor, DrawMemory(1 << 28)).stimulus(time_ns).force_box
        for log, sensor in ((0, "A1"), (0, "A2"), (0, "A1"), (1, "A1"))
    ]
    first, second, again, other_log = (force[:12_000] for force in forces)
    assert (first == again).all()
    assert not forces[0][12_000:].any()
    assert first.var(axis=0) == pytest.approx([3.0, 6.0, 12.0], rel=0.1)
    assert (first * second).mean(axis=0) == pytest.approx([1.0, 2.0, 4.0], rel=0.25)
    assert (first * other_log).mean(axis=0) == pytest.approx([0.0] * 3, abs=0.6)


def test_the_autocovariance_along_the_axes_of_a_sensor() -> None:
    """Of noise of density S between two frequencies: S (sin 2 pi f2 t - sin 2 pi f1 t) / (2 pi t), in counts; a sensor
    that is turned about z exchanges x and y. It vibrates during half of the time.
    """
    header = SensorHeader("A", "adxl345", "specific_force", "g", 2.0, 256.0, axes="+Y-X+Z")
    vibration = Vibration(
        0, 1000, "specific_force", EDGES_HZ, ONE_BAND / 2, ONE_BAND / 2, np.tile(np.eye(3), (3, 1, 1))
    )
    waves = (math.sin(2 * math.pi * 20 * 0.01) - math.sin(2 * math.pi * 10 * 0.01)) / (2 * math.pi * 0.01)
    counts = (256 / STANDARD_GRAVITY) ** 2
    for lag_s, seconds in ((0.0, 10.0), (0.01, waves)):
        values = vibration_along(header, [vibration], 0, 2000, lag_s)
        assert values == pytest.approx(np.array([0.2, 0.1, 0.4]) * seconds * counts / 2)
    assert not vibration_along(header, [vibration], 1000, 2000).any()


def test_the_same_noise_at_a_lower_rate_of_rows_is_no_vibration() -> None:
    """At a quarter of the rate, white noise has four times the density; logs of one rate are compared with each other.
    The only accelerometer has no other that could contradict it.
    """
    generator = np.random.default_rng(5)
    logs = []
    for rate_hz in (100.0, 25.0):
        time = np.arange(0, 120e9, 1e9 / rate_hz).astype(np.int64)
        logs.append({"A": cast(Any, Rows(time, generator.normal(size=(len(time), 3)), UPRIGHT))})
    assert list(vibrations_of(logs, [[REST], [REST]], [{}, {}])) == [(), ()]


def test_a_vibration_along_one_direction_is_correlated_between_its_axes() -> None:
    """Along x and z by equal amounts, measured by the only quiet sensor or by three together."""
    course = band(12_000, 10.0, 20.0, 1.0, np.random.default_rng(0))[:, :1]
    shaking = course * [1.0, 0.0, 1.0]
    ((together,),) = read(shaking, [UPRIGHT, OPPOSED, UPRIGHT], [0.0, 0.0, 0.0])
    late = np.where(np.arange(12_000)[:, None] > 6000, 2 * shaking, 0.0)
    noise = [np.random.default_rng(seed).normal(size=(12_000, 3)) * 30 for seed in (1, 2)]
    (alone,) = read(late, [UPRIGHT, OPPOSED, UPRIGHT], [0.0, *noise])
    for vibration in (together, alone[-1]):
        at = int(np.argmax((vibration.common + vibration.private)[:, 0]))
        assert vibration.coherence[at, 0, 2] > 0.8
        assert abs(vibration.coherence[at, 0, 1]) < 0.3

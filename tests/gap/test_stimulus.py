"""Stimuli of the box are distinguished from errors of sensors: on motions that tilt and vibrate, and on errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import binom

from imuarray.array import parse_array
from imuarray.arrays import Integers
from imuarray.gap.findings.causes import lines_of, notes_of, with_origins
from imuarray.gap.findings.diagnosis import Cause
from imuarray.gap.model.base_model import headers_in
from imuarray.gap.recording.recordings import reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, summarise_log
from imuarray.gap.statistics.environment import SharedSignal, environment_of, fast_test, groups_of, slow_test
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate import Motion, Simulation, plan_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias, CommonMode, RandomWalk
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.simulate.motion.faces import Still, resting
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.stimulus import BoxStimulus
from tests.gap.small_campaign import RATE_HZ, header, phases_of
from tests.selection import some

ARRAY = """
[array]
name = "two families"
bus = "i2c:/dev/i2c-1"
"""

SENSOR = """
[[sensor]]
name = "{name}"
chip = "{chip}"
address = {address}
range = {range}
{setting}
axes = "{axes}"
"""

SENSORS = [
    ("B1", "bma180", "0x40", 4, "bandwidth_hz = 150", "+X+Y+Z"),
    ("B2", "bma180", "0x41", 4, "bandwidth_hz = 150", "-X-Y+Z"),
    ("D1", "adxl345", "0x53", 4, "rate_hz = 100", "+Y-X+Z"),
    ("D2", "adxl345", "0x1d", 4, "rate_hz = 100", "+X-Y-Z"),
    ("G1", "l3g4200d", "0x68", 250, "rate_hz = 800\nbandwidth_hz = 35", "+X+Y+Z"),
    ("G2", "l3g4200d", "0x69", 250, "rate_hz = 800\nbandwidth_hz = 35", "+X-Y-Z"),
]

TEXT = ARRAY + "".join(
    SENSOR.format(name=name, chip=chip, address=address, range=span, setting=setting, axes=axes)
    for name, chip, address, span, setting, axes in SENSORS
)

SECONDS = 120.0


@dataclass(frozen=True)
class Pushed:
    """At rest but for specific force (m/s2) along the box's `axis`: sines (amplitude, Hz)."""

    sines: tuple[tuple[float, float], ...]
    axis: int
    seconds: float = SECONDS

    @property
    def phases(self) -> tuple[Phase, ...]:
        return (Phase(0, round(self.seconds * 1e9), "static", "+Z"),)

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        rest = resting(time_ns, np.eye(3), 25.0)
        force = np.array(rest.force_box)
        for amplitude, hertz in self.sines:
            force[:, self.axis] += amplitude * np.sin(2 * np.pi * hertz * 1e-9 * time_ns + 1)
        return replace(rest, force_box=force)


MRAD = 9.80665e-3
"""What a tilt by 1 mrad adds to a level axis."""

TILTING = Pushed(((MRAD, 0.021), (0.6 * MRAD, 0.057)), 0)
VIBRATING = Pushed(((5 * MRAD, 13.0),), 1)
STILL = Still(seconds=SECONDS)


def campaign(motion: Motion, more: Mapping[str, Sequence[Effect]] | None = None, seed: int = 0) -> Campaign:
    noises = {name: 0.05 if name.startswith("G") else 0.004 for name, *_ in SENSORS}
    effects = {name: (WhiteNoise(rms), Bias(2 * rms), *(more or {}).get(name, ())) for name, rms in noises.items()}
    simulation = Simulation(plan_of(parse_array(TEXT), RATE_HZ, motion.seconds), motion, effects, seed=seed)
    log = summarise_log("static", simulated_sources(simulation), phases_of(motion), reference_of(motion))
    return Campaign((log,))


HEADERS = headers_in(campaign(Still(seconds=2.0)))


def told(found: Sequence[SharedSignal]) -> set[tuple[str, str, str]]:
    return {(one.quantity, one.pace, one.axis) for one in found}


@pytest.mark.slow
def test_a_phase_without_common_segments_has_no_stimulus() -> None:
    """The segments of the sensors are at different times, like after a gap of one of them; the thermometers warm up."""
    (log,) = campaign(Heating()).logs
    crosses = [part.cross for part in log.phases]
    phases = [
        replace(part, cross=replace(cross, slow=cross.slow[:0], windows=0))
        for part, cross in zip(log.phases, crosses, strict=True)
        if cross is not None
    ]
    assert phases
    assert environment_of(Campaign((replace(log, phases=tuple(phases)),))) == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_tilt_is_a_stimulus(seed: int) -> None:
    (one,) = environment_of(campaign(TILTING, seed=seed))
    assert (one.log, one.phase, one.quantity, one.pace, one.axis) == (0, "static", "specific_force", "slow", "X")
    assert set(one.sensors) == {"B1", "B2", "D1", "D2"}
    assert one.correlation > 0.8


def test_a_continuous_tilt_is_a_stimulus() -> None:
    """4 mrad in two minutes: a drift by the same amount in four groups of sensors."""
    drifting = Pushed(((30 * MRAD, 1 / (8 * SECONDS)),), 1)
    (one,) = environment_of(campaign(drifting))
    assert (one.pace, one.axis) == ("slow", "Y")


def test_a_vibration_is_a_stimulus() -> None:
    """In means of five rows 5 mg at 13 Hz, 12.5 mg^2, become sin(5 a)^2 / (5 sin(a))^2 = 0.201 of that, a = 0.13 pi,
    with noise of 16 / 5 mg^2, and half of the sensors round to 3.9 mg: 2.52 of 5.84.
    """
    (one,) = environment_of(campaign(VIBRATING))
    assert (one.quantity, one.pace, one.axis) == ("specific_force", "fast", "Y")
    assert one.correlation == pytest.approx(2.52 / 5.84, abs=0.05)


OF_SENSORS: dict[str, dict[str, tuple[Effect, ...]]] = {
    "common mode of a chip": {name: (CommonMode(0.003, 10.0),) for name in ("B1", "B2")},
    "common mode of each chip": {name: (CommonMode(0.003, 10.0),) for name, *_ in SENSORS[:4]},
    "fast common mode": {name: (CommonMode(0.01, 0.1),) for name, *_ in SENSORS[:4]},
    "tone in one": {"D1": (Tone(0.02, 13.0),)},
    "a line of a chip": {name: (Tone((0.0, 0.2, 0.0), 11.0),) for name in ("G1", "G2")},
    "tones in two": {"B1": (Tone(0.02, 13.0),), "D1": (Tone(0.02, 14.0),)},
    "wander of one": {"B2": (RandomWalk(0.002),)},
    "wander of all": {name: (RandomWalk(0.02 if name[0] == "G" else 0.002),) for name, *_ in SENSORS},
}


@pytest.mark.parametrize("what", some(OF_SENSORS, 3))
def test_errors_of_sensors_are_not_a_stimulus(what: str) -> None:
    assert not environment_of(campaign(STILL, OF_SENSORS[what]))


@pytest.mark.slow
def test_a_thermal_drift_is_not_a_stimulus() -> None:
    """Each sensor has its own slope, chosen here so that all are equal in the box frame."""
    x, y = (0.001, 0.0, 0.0), (0.0, 0.001, 0.0)
    slopes = {"B1": x, "B2": tuple(-np.array(x)), "D1": tuple(-np.array(y)), "D2": x}
    more = {name: (ThermalBias(slope),) for name, slope in slopes.items()}
    assert not environment_of(campaign(Heating(scale=0.05), more))
    assert environment_of(campaign(TILTING, more))


def wandering(rng: np.random.Generator, kind: str) -> np.ndarray:
    """64 means of one group of sensors."""
    noise = rng.normal(size=64)
    if kind == "walk":
        return np.asarray(np.cumsum(noise))
    if kind == "drift":
        return np.asarray(noise + rng.normal(0, 30) * np.linspace(0, 1, 64))
    return np.asarray(noise + rng.normal(0, 20) * np.exp(-np.arange(64) / 10))


@pytest.mark.slow
@pytest.mark.parametrize("kind", some(["walk", "drift", "warming up"], 1))
@pytest.mark.parametrize("groups", some([2, 4], 1))
def test_slow_errors_look_like_a_stimulus_at_the_stated_rate(kind: str, groups: int) -> None:
    """At 5 % of 400; the limit is passed by a rate of exactly 5 % once in a thousand."""
    rng = np.random.default_rng(groups)
    tests = [slow_test(np.stack([wandering(rng, kind) for _ in range(groups)], axis=1)) for _ in range(400)]
    assert sum(p < 0.05 for _, p in tests) <= binom.ppf(0.999, 400, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("factor", some([0.0, 0.5, 0.9], 1))
def test_fast_errors_look_like_a_stimulus_at_the_stated_rate(factor: float) -> None:
    """First-order processes of three groups; rows have the weight (1 - r^2) / (1 + r^2), at 5 % of 400 as above."""
    rng = np.random.default_rng(1)
    found = 0
    for _ in range(400):
        rows = rng.normal(size=(600, 3))
        for at in range(1, 600):
            rows[at] += factor * rows[at - 1]
        effective = np.full((3, 3), 600 * (1 - factor**2) / (1 + factor**2))
        found += fast_test(np.cov(rows.T), effective)[1] < 0.05
    assert found <= binom.ppf(0.999, 400, 0.05)


def test_a_common_error_of_two_of_four_groups_is_not_a_stimulus() -> None:
    covariance = np.eye(4)
    covariance[0, 1] = covariance[1, 0] = 0.6
    assert fast_test(covariance, np.full((4, 4), 500.0)) == (pytest.approx(0.1), 1.0)
    assert fast_test(np.eye(4) + 0.6, np.full((4, 4), 500.0))[1] < 1e-20


def test_groups_have_a_common_chip_axis_and_sign() -> None:
    sensors = [header("A", "-X-Y+Z"), header("B", "-X-Y+Z"), header("C", "+Y-X+Z"), header("D", "+X+Y+Z")]
    groups = groups_of([*sensors, header("G", chip="l3g4200d")], "specific_force", 0)
    assert [tuple(group) for group in groups] == [(("A", "B"), 0, -1.0), (("C",), 1, -1.0), (("D",), 0, 1.0)]


def tone(sensor: str, hertz: float, *amplitude: float) -> Cause:
    parameters = {f"amplitude_{HEADERS[sensor].unit}": list(amplitude), "frequency_hz": hertz}
    return cause("tone", parameters, sensor)


def cause(effect: str, parameters: Mapping[str, object], *sensors: str) -> Cause:
    each = dict.fromkeys(sensors, parameters)
    return Cause(effect, "add", sensors, (), 0.9, parameters, None, None, (), each=each)


def origins(
    causes: Sequence[Cause], shared: Sequence[SharedSignal] = (), headers: Mapping[str, SensorHeader] = HEADERS
) -> list[str]:
    return [one.origin for one in with_origins(causes, headers, shared)]


ALONG_Y = [tone("B1", 13.0, 0, 5e-3, 0), tone("D1", 13.05, 6e-3, 0, 0), tone("D2", 12.95, 0, 4.5e-3, 1e-3)]
"""D1's x lies along Y."""


def test_a_line_in_two_chips_is_of_the_box() -> None:
    assert origins(ALONG_Y) == ["environment"] * 3
    gyroscopes = [tone("G1", 13.0, 0.2, 0, 0), tone("G2", 13.0, 0.2, 0, 0)]
    assert origins([ALONG_Y[0], ALONG_Y[2], *gyroscopes]) == ["environment"] * 4
    lines = lines_of(ALONG_Y, HEADERS)
    assert notes_of(lines) == (
        "B1, D1 and D2 have the same line at 13.0 Hz along the box axis Y: a vibration of the box, not a "
        "fault of the sensors.",
    )


@pytest.mark.parametrize(
    "causes",
    [
        [tone("B1", 13.0, 0, 5e-3, 0)],
        [tone("B1", 13.0, 0, 5e-3, 0), tone("D1", 13.0, 0, 5e-3, 0)],
        [tone("B1", 13.0, 0, 5e-3, 0), tone("D2", 13.0, 0, 9e-3, 0)],
        [tone("B1", 13.0, 0, 5e-3, 0), tone("D2", 13.3, 0, 5e-3, 0)],
        [tone("B1", 13.0, 0, 5e-3, 0), tone("B2", 13.0, 0, 5e-3, 0)],
        [tone("D2", 13.0, 0, 5e-3, 0), tone("G1", 13.0, 0.1, 0, 0)],
    ],
    ids=["one sensor", "other axis", "larger", "other frequency", "one chip", "a quarter of the accelerometers"],
)
def test_other_lines_are_of_the_sensors(causes: list[Cause]) -> None:
    assert origins(causes) == ["sensor"] * len(causes)
    assert not lines_of(causes, HEADERS)


def test_the_mounting_decides_for_an_array_of_one_chip() -> None:
    """A common line along own axes may be of the design, like the line on the L3G4200D's y axis; along box axes it is
    of the box.
    """
    axes = {"B1": "+X+Y+Z", "B2": "-X-Y+Z", "D1": "+Y-X+Z"}
    parallel_axes = {name: replace(HEADERS[name], chip="bma180", axes=text) for name, text in axes.items()}
    design = [tone(name, 13.0, 0, 5e-3, 0) for name in parallel_axes]
    assert origins(design, headers=parallel_axes) == ["sensor"] * 3
    box = [*design[:2], tone("D1", 13.0, 5e-3, 0, 0)]
    assert origins(box, headers=parallel_axes) == ["environment"] * 3
    parallel = {name: replace(one, axes="+X+Y+Z" if name != "B2" else "-X-Y+Z") for name, one in parallel_axes.items()}
    assert origins(design, headers=parallel) == ["sensor"] * 3


def test_a_wander_along_axes_with_a_stimulus_is_of_the_box() -> None:
    tilt = SharedSignal(0, "static", "slow", "specific_force", "X", ("B1", "B2", "D1", "D2"), 0.97, 1e-9)
    along = cause("random_walk", {"density_g_per_sqrt_s": [2e-4, 1e-5, 0.0]}, "B1", "B2")
    assert origins([along], [tilt]) == ["environment"]
    assert origins([along]) == ["sensor"]
    assert origins([along], [replace(tilt, pace="fast")]) == ["sensor"]
    assert origins([cause("random_walk", {"density_g_per_sqrt_s": [1e-5, 2e-4, 0.0]}, "B1")], [tilt]) == ["sensor"]
    assert origins([cause("bias_instability", {"rms_g": [0.0, 1e-3, 0.0]}, "D1")], [tilt]) == ["environment"]
    assert origins([cause("bias_instability", {"rms_dps": 1e-3}, "G1")], [tilt]) == ["sensor"]
    assert origins([cause("scale", {"error": 0.01}, "B1")], [tilt]) == ["sensor"]
    assert notes_of((), [tilt]) == (
        "B1, B2, D1 and D2 wander together along the box axis X in phase 'static' (correlation 0.97), whatever "
        "their mounting: motion of the box, not a fault of the sensors.",
    )

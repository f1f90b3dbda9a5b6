"""Two independent ways from one motion to counts: our effects, and registers polled from the emulated bus.

The emulated array is driven by our motions and recorded through the drivers; then the same log is simulated, at the
recorded times, with the parameters of the emulated units turned into effects. The parameters of a unit are shared; the
derivation of a reading is not: the emulator has its own chips, converters, clocks, queues and noise, and no word of
ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from firmware_emulator.array import open_array
from firmware_emulator.units import unit_of
from imuarray.acquire import record
from imuarray.array import ArrayConfig, SensorConfig, load_array, parse_array
from imuarray.log import Log, open_log
from imuarray.log.format import Phase
from imuarray.simulate import BoxStimulus, Motion, Simulation, plan_like, write_log
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import GSensitivity, Misalignment, Scale
from imuarray.simulate.effects.temperature import ThermalBias, ThermalScale, Thermometer
from imuarray.simulate.effects.timing import OwnClock, Skew
from imuarray.simulate.motion import HandShake, Heating, Tumble
from tests.selection import some
from tests.simulate.motion_world import MotionWorld

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
SEED = 4
INERTIAL = ("ADXL1", "ADXL2", "BMA1", "BMA2", "BMA3", "BMA4", "Gyro1", "Gyro2", "Gyro3")


def effects_of_unit(array: ArrayConfig, sensor: SensorConfig) -> tuple[Effect, ...]:
    """The parameters of an emulated unit as effects."""
    unit = unit_of(array.name, sensor.name, sensor.chip, sensor.range or 0.0, SEED)
    response = np.array(unit.response)
    lean = np.degrees(np.arctan(response / np.diag(response)[:, None]))
    shifted = (sensor.range or 0.0) >= unit.shift_from
    bias = np.array(unit.bias) + shifted * np.array(unit.shift)
    bandwidth_hz = sensor.chip_rate_hz / 2 if sensor.chip == "adxl345" else sensor.chip_bandwidth_hz
    share = math.sqrt(bandwidth_hz / unit.noise_bandwidth_hz) if bandwidth_hz else 1.0
    share *= ((sensor.range or 1.0) / unit.noise_full_scale) ** unit.noise_exponent
    angles = (lean[0, 1], lean[0, 2], lean[1, 0], lean[1, 2], lean[2, 0], lean[2, 1])
    return (
        Misalignment(angles),  # type: ignore[arg-type]
        Scale(tuple(np.linalg.norm(response, axis=1) - 1)),
        ThermalScale((unit.scale_slope_per_degc,) * 3),
        GSensitivity(tuple(np.array(unit.g_sensitivity).ravel())),
        Bias(tuple(bias)),
        ThermalBias(unit.slope_per_degc),
        WhiteNoise(tuple(share * np.array(unit.noise))),
        Thermometer(unit.thermometer_offset_degc),
    )


@dataclass(frozen=True)
class Later:
    """A motion that began `by_ns` before the log: the array was set up in the meantime."""

    motion: Motion
    by_ns: int

    @property
    def phases(self) -> tuple[Phase, ...]:
        moved = [phase._replace(start_ns=phase.start_ns - self.by_ns, end_ns=phase.end_ns - self.by_ns)
                 for phase in self.motion.phases]  # fmt: skip
        return tuple(phase._replace(start_ns=max(phase.start_ns, 0)) for phase in moved if phase.end_ns > 0)

    @property
    def seconds(self) -> float:
        return self.motion.seconds

    def stimulus(self, time_ns: Any) -> BoxStimulus:
        return self.motion.stimulus(time_ns + self.by_ns)


def both(motion: Motion, folder: Path) -> tuple[Log, Log]:
    """The emulated array recorded, and simulated."""
    array = load_array(CONFIG)
    with open_array(array, world=MotionWorld(motion), seed=SEED) as bus:
        record(array, bus, folder / "emulated.h5", rate_hz=48.0, seconds=motion.seconds, phases=motion.phases)
    emulated = open_log(folder / "emulated.h5")
    later = Later(motion, motion.phases[0].end_ns - emulated.phases[0].end_ns)
    effects = {sensor.name: effects_of_unit(array, sensor) for sensor in array.sensors if sensor.spec.sensitivity}
    write_log(Simulation(plan_like(emulated), later, effects, seed=9), folder / "simulated.h5")
    return emulated, open_log(folder / "simulated.h5")


MOTIONS: dict[str, Motion] = {
    "tumble": Tumble(face_s=8.0, turn_s=1.5),
    "heating": Heating(scale=0.013),
    "hand": HandShake(peak_g=1.0, peak_dps=60.0, still_s=9.0, motion_s=15.0),
}


@pytest.fixture(scope="module", params=some(MOTIONS, 1, 0))
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    emulated, simulated = both(MOTIONS[request.param], tmp_path_factory.mktemp(request.param))
    yield emulated, simulated
    emulated.close()
    simulated.close()


def still(log: Log) -> list[Any]:
    return [phase for phase in log.phases if phase.up]


@pytest.mark.slow
def test_means_and_spreads_agree_in_every_still_phase(pair: tuple[Log, Log]) -> None:
    emulated = pair[0]
    means, spreads = [], []
    for name in INERTIAL:
        for phase in still(emulated):
            rows = emulated[name].between(phase.start_ns + 500_000_000, phase.end_ns)
            theirs, ours = (np.asarray(log[name].counts[rows], float) for log in pair)
            n = len(ours)
            # the temperature may change within a phase: differences row by row take it out of the spread
            spread = [np.diff(values, axis=0).std(axis=0) / math.sqrt(2) for values in (theirs, ours)]
            means.append((theirs.mean(axis=0) - ours.mean(axis=0)) / np.hypot(*spread) * math.sqrt(n))
            # spread of successive differences: variance of its logarithm about 3 / (4 n) for white noise
            spreads.append(np.log(spread[0] / spread[1]) / math.sqrt(2 * 3 / (4 * n)))
    for z in (np.concatenate(means), np.concatenate(spreads)):
        # all of them together, at an error rate of 1e-4 a motion, and none further off than one in a million allows
        assert stats.chi2.sf((z**2).sum(), len(z)) > 1e-4
        assert np.abs(z).max() < stats.norm.isf(1e-6 / len(z))


@pytest.mark.slow
def test_moving_readings_of_both_paths_agree(pair: tuple[Log, Log]) -> None:
    for name in INERTIAL:
        theirs, ours = (np.asarray(log[name].counts, float) for log in pair)
        swing = theirs.std(axis=0)
        noise = np.diff(theirs, axis=0)[: 7 * 48].std(axis=0)
        apart = (theirs - ours).std(axis=0)
        # two noises, and a chip's reading up to one of its periods younger or older than ours: a little of a swing
        assert (apart < 1.1 * noise + 0.05 * swing).all(), name


@pytest.mark.slow
def test_thermometers_agree(pair: tuple[Log, Log]) -> None:
    for name in ("BMA1", "BMA3", "Gyro1", "Gyro3"):
        theirs, ours = (np.asarray(log[name].temperature_counts, float) for log in pair)
        # BMA180: half a degree a count; L3G4200D: refreshed once a second (L3G-60), while a hairdryer heats fast
        assert np.abs(theirs - ours).mean() < 0.75, name


@pytest.mark.slow
def test_flags_agree(pair: tuple[Log, Log]) -> None:
    for name in INERTIAL:
        theirs, ours = (np.asarray(log[name].status) for log in pair)
        assert abs((theirs != 0).mean() - (ours != 0).mean()) < 0.01, name


SLOW_CHIPS = """
[array]
name = "slow chips"
bus = "i2c:/dev/i2c-1"

[[sensor]]
name = "A"
chip = "adxl345"
address = 0x53
range = 16
rate_hz = 100

[[sensor]]
name = "G"
chip = "l3g4200d"
address = 0x68
range = 2000
rate_hz = 100
bandwidth_hz = 25
"""
POLLED_HZ = 64.0


@pytest.fixture(scope="module", params=[-0.04, 0.0, 0.03])
def slow_chips(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A log of emulated chips whose readings are up to 10 ms old, in a box that is shaken; what makes counts of one of
    them in a simulation of that log; by how much each chip's oscillator is off (the emulated ADXL345's never is).
    """
    motion = HandShake(peak_g=3.0, peak_dps=900.0, still_s=4.0, motion_s=12.0)
    array, path = parse_array(SLOW_CHIPS), tmp_path_factory.mktemp("slow") / "emulated.h5"
    switches = {"G": {"rate_error": request.param}}
    with open_array(array, world=MotionWorld(motion), seed=SEED, switches=switches) as bus:
        record(array, bus, path, rate_hz=POLLED_HZ, seconds=motion.seconds, phases=motion.phases)
    log = open_log(path)
    later = Later(motion, motion.phases[0].end_ns - log.phases[0].end_ns)
    units = {sensor.name: effects_of_unit(array, sensor) for sensor in array.sensors}

    def simulated(name: str, *when: Effect) -> Any:
        made = Simulation(plan_like(log, [name]), later, {name: (*units[name], *when)}, seed=9).sensors[name]
        return np.asarray(made.block(0, made.rows).counts, float)

    yield log, simulated, {"A": 0.0, "G": request.param}
    log.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["A", "G"])
def test_ages_of_readings_are_those_of_the_chips_own_clock(slow_chips: Any, name: str) -> None:
    """With the right rate there is a phase at which only two noises remain, in all rows of the motion; half a
    period beside it, or with another rate, far more remains at any phase.

    Of x alone, whose first byte comes 27 clocks after the stamp: a conversion that ends within the burst tears y and z
    off.
    """
    log, simulated, rate_errors = slow_chips
    right = rate_errors[name]
    theirs = np.asarray(log[name].counts[:, 0], float)
    still, moved = (log[name].between(log.phases[at].start_ns, log.phases[at].end_ns) for at in (0, 1))

    def residual(rate_error: float, phase_deg: float) -> float:
        """Variance that is left in motion, over that at rest: of 768 and 256 rows."""
        apart = theirs - simulated(name, OwnClock(rate_error, phase_deg), Skew(-27 / 400e3))[:, 0]
        return float(apart[moved].var() / apart[still].var())

    around = np.arange(15.0, 375.0, 15.0)
    near = min(around, key=lambda phase_deg: residual(right, phase_deg))
    best = min(near + np.arange(-10.0, 10.0), key=lambda phase_deg: residual(right, phase_deg))
    assert residual(right, best) < 1.5  # five standard errors of such a ratio, each root(2 / 768 + 2 / 256)
    assert residual(right, best + 180.0) > 50
    assert min(residual(right + 0.02, phase_deg) for phase_deg in around) > 50

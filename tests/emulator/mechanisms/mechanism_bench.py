"""A bench for single mechanisms: ideal units in a world of the test's own, so that only the mechanism has an effect."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.element import UnitDeviations
from firmware_emulator.mechanisms.mechanism import FittedBoard, Fitting, Mechanism
from firmware_emulator.world import UPRIGHT, StillWorld, World, WorldStimulus

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
MS = 10**6
S = 10**9


def sensor(name: str, chip: str, address: int, channel: int, range_: float) -> SimpleNamespace:
    return SimpleNamespace(
        name=name, chip=chip, channel=channel, bus=None, address=address, range=range_, orientation=IDENTITY
    )


ARRAY = SimpleNamespace(
    name="bench",
    mux=SimpleNamespace(chip="pca9544a", address=0x70),
    sensors=(
        sensor("ADXL", "adxl345", 0x53, 0, 16),
        sensor("BMA", "bma180", 0x40, 0, 2),
        sensor("BMA twin", "bma180", 0x40, 1, 2),
        sensor("Gyro", "l3g4200d", 0x68, 0, 250),
        sensor("Gyro twin", "l3g4200d", 0x68, 1, 250),
    ),
)
NOISE = {"g": 0.01, "dps": 0.1}


class IdealBoard(FittedBoard):
    """Every unit is perfect and, unless `noisy`, silent."""

    noisy = False

    def unit(self, sensor: Any) -> UnitDeviations:
        return UnitDeviations(noise=(1.0, 1.0, 1.0)) if self.noisy else UnitDeviations()


class NoisyBoard(IdealBoard):
    """Every unit is perfect but for white noise of 1 rms on each axis, in a bandwidth of 1 Hz."""

    noisy = True


def board(
    mechanism: Mechanism, *names: str, world: World | None = None, seed: int = 1, run: int = 0, noisy: bool = False
) -> FittedBoard:
    kind = NoisyBoard if noisy else IdealBoard
    return kind(ARRAY, world or StillWorld(), seed, [Fitting(mechanism, names)], run=run)


def of(name: str) -> Any:
    return next(sensor for sensor in ARRAY.sensors if sensor.name == name)


def samples(
    fitted: FittedBoard, name: str, times_ns: Sequence[int], full_scale: float = 250.0, bandwidth_hz: float = 1.0
) -> npt.NDArray[np.float64]:
    """Converter inputs (n, 3) at these times."""
    element = fitted.element(of(name))
    return np.array([element.sample(int(at_ns), full_scale, bandwidth_hz) for at_ns in times_ns])


def errors(
    mechanism: Mechanism,
    name: str,
    times_ns: Sequence[int],
    *,
    world: World | None = None,
    seed: int = 1,
    run: int = 0,
    noisy: bool = False,
    full_scale: float = 250.0,
) -> npt.NDArray[np.float64]:
    """The difference that the mechanism makes to the same sensor, (n, 3) in g or dps."""
    there = board(mechanism, name, world=world, seed=seed, run=run, noisy=noisy)
    kind = NoisyBoard if noisy else IdealBoard
    plain = kind(ARRAY, world or StillWorld(), seed, run=run)
    return samples(there, name, times_ns, full_scale) - samples(plain, name, times_ns, full_scale)


def every(ms: float, count: int) -> list[int]:
    """Instants."""
    return [round(index * ms * MS) for index in range(count)]


def warm(degc: Callable[[float], float]) -> World:
    """A box at rest whose temperature is a function of seconds."""
    return lambda at_ns: UPRIGHT._replace(temperature_degc=degc(at_ns * 1e-9))


def turning(rate_box: Callable[[float], tuple[float, float, float]]) -> World:
    """A box without weight that turns."""
    return lambda at_ns: WorldStimulus((0.0, 0.0, 0.0), rate_box(at_ns * 1e-9))


@contextmanager
def bus_with(mechanism: Mechanism, *names: str, seed: int = 1, **settings: Any) -> Iterator[EmulatedBus]:
    """The whole array, ideal but for the mechanism; channel 0 is selected."""
    fitting = Fitting(mechanism, names or mechanism.wherever(ARRAY.sensors))
    with open_array(
        ARRAY,
        seed=seed,
        board=lambda array, world, key: IdealBoard(ARRAY, world, key, [fitting]),
        **settings,
    ) as bus:
        bus.transfer(0x70, b"\x04")
        yield bus


def words(data: bytes) -> list[int]:
    """Signed little-endian words."""
    return np.frombuffer(data, "<i2").tolist()

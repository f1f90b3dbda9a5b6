"""The paper's experiments on the simulated array: statistics of every sensor's readings, window by window; rows are not
stored.

The stimulus is as printed: Table 10's face temperatures, Table 11's mean temperatures and their deviations (a linear
drift within the continuous run; from run to run the shape of BMA1's own thermometer in Table 6), the profile of the
heating, and the logging rates that follow from standard deviation and standard error. The states in which Gyro3 and
BMA1 started are also as printed (Tables 6, 7, 10, 11): each experiment uses the first unused switch-on in the required
state. The number of switch-ons in each state among the first `BOOTS` is a separate statistic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import count
from operator import call
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from imuarray.array import ArrayConfig, load_array
from imuarray.arrays import Floats
from imuarray.log.writer import Block
from imuarray.shipped import configs
from imuarray.simulate.model import Model, load_model
from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.motion.tumble import Tumble
from imuarray.simulate.simulation import Simulation
from imuarray.studies.paper.array_model import PARTS, WINDOW_S, high_rate_degc
from imuarray.studies.paper.tables import DEGC, FACES_DEGC, number_in, table
from imuarray.studies.paper.variation import HIGH_RATE_HZ, bias_states, boot_faults, logging_rate

Spans = Sequence[tuple[int, int]]

_BLOCK = 1 << 16


class Triad(Protocol):
    """Readings of a simulated sensor."""

    rows: int

    def block(self, start: int, stop: int) -> Block:
        """Return rows start ... stop - 1."""


class Window(NamedTuple):
    """A stretch of one sensor: number of readings, mean and standard deviation of x, y, z and its thermometer (4,)."""

    rows: int
    mean: Floats
    std: Floats


class Series(NamedTuple):
    """Every reading of a sensor: ns since the run began (n,), counts (n, 3)."""

    time_ns: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int16]


class StoredSensor:
    """A sensor that stores its readings, so that a figure needs no second simulation."""

    def __init__(self, sensor: Triad) -> None:
        self.rows = sensor.rows
        self._sensor = sensor
        self._blocks: list[Block] = []

    def block(self, start: int, stop: int) -> Block:
        """Return rows start ... stop - 1 of the sensor."""
        self._blocks.append(self._sensor.block(start, stop))
        return self._blocks[-1]

    @property
    def series(self) -> Series:
        """Return the readings so far, in their order."""
        return Series(*(np.concatenate(column) for column in zip(*(b[:2] for b in self._blocks), strict=True)))


class TemperatureLine(NamedTuple):
    """A straight line per axis: LSB per degC and LSB at 0 degC (3,)."""

    slope: Floats
    intercept: Floats


def blocks(sensor: Triad) -> Iterator[Block]:
    """Yield all rows of a sensor, stretch by stretch."""
    for start in range(0, sensor.rows, _BLOCK):
        yield sensor.block(start, min(start + _BLOCK, sensor.rows))


def windows(sensor: Triad, spans: Spans) -> list[Window]:
    """Return the window of a sensor's readings in each span (from, until) in ns; the end is excluded."""
    sums = np.zeros((3, len(spans), 4))
    centre: Floats | None = None
    for block in blocks(sensor):
        temperature_counts = block.temperature_counts
        column = np.full(len(block.time), np.nan) if temperature_counts is None else temperature_counts
        rows = np.column_stack([block.counts, column]).astype(float)  # int16 squares would overflow
        centre = rows[0] if centre is None else centre
        for index, (start, stop) in enumerate(spans):
            part = rows[slice(*np.searchsorted(block.time, (start, stop)))] - centre
            sums[:, index] += np.stack([np.full(4, len(part)), part.sum(axis=0), (part**2).sum(axis=0)])
    return [_window(count, total, squares, centre) for count, total, squares in sums.transpose(1, 0, 2)]


def _window(count: Floats, total: Floats, squares: Floats, centre: Floats | None) -> Window:
    mean = total / count
    std = np.sqrt(np.maximum(squares - count * mean**2, 0) / (count - 1))
    return Window(int(count[0]), mean + (0.0 if centre is None else centre), std)


def line(sensor: Triad, motion: Motion) -> TemperatureLine:
    """Fit counts to the box's temperature by least squares."""
    moments = np.zeros((2, 5))
    for block in blocks(sensor):
        degc = motion.stimulus(block.time).temperature_degc
        with_one = np.stack([np.ones(len(degc)), degc])
        moments += with_one @ np.column_stack([with_one.T, block.counts])
    intercept, slope = np.linalg.solve(moments[:, :2], moments[:, 2:])
    return TemperatureLine(slope, intercept)


Progress = Callable[[int, int, str], None]

BOOTS = 150
"""Number of switch-ons that are examined."""
SENSORS = tuple(row["sensor"] for row in table(1))
WARMED = ("ADXL1", "Gyro1", "Gyro2")
"""The sensors of Figures 8 to 10."""
_PEEK_S = 4.0


class HighRate(NamedTuple):
    """The high-rate experiment of Gyro1: the whole stretch as a window, and its counts (n, 3)."""

    window: Window
    counts: npt.NDArray[np.int16]


@dataclass(frozen=True)
class ExperimentData:
    """All simulated data, by sensor: `faces` seven windows in Table 10's order, `parts` and `runs` fifteen, `heated`
    the straight-line fits, `high_rate` by range as Table 9 prints it; `even` the share of even counts; the numbers of
    switch-ons among `BOOTS` after which BMA1 was faulty and Gyro3 was in its second state. For figures: every reading
    of the continuous run (`still`) and of the sensors `WARMED` while heated (`warm`).
    """

    faces: Mapping[str, Sequence[Window]]
    parts: Mapping[str, Sequence[Window]]
    runs: Mapping[str, Sequence[Window]]
    heated: Mapping[str, TemperatureLine]
    high_rate: Mapping[str, HighRate]
    even: Mapping[str, float]
    faulty: int
    second: int
    still: Mapping[str, Series]
    warm: Mapping[str, Series]


class State(NamedTuple):
    """The states in which the two odd sensors started."""

    faulty: bool
    second: bool


def observe(seed: int, executor: Executor | None = None, progress: Progress | None = None) -> ExperimentData:
    """Return all experiments; `progress` receives (number completed, all, name) after each."""
    states = [state(seed, boot) for boot in range(1, BOOTS + 1)]
    jobs = list(_jobs(seed))
    results: Iterator[Any] = (executor.map if executor else map)(call, [job for _, job in jobs])
    observed = []
    for number, ((name, _), result) in enumerate(zip(jobs, results, strict=True), start=1):
        observed.append(result)
        if progress:
            progress(number, len(jobs), name)
    faces, (parts, still), (heated, warm), slow, fast, even, *runs = observed
    by_run = {name: [run[name][0] for run in runs] for name in SENSORS}
    high_rate = {"250dps": slow, "2k dps": fast}
    counts = (sum(state.faulty for state in states), sum(state.second for state in states))
    return ExperimentData(faces, parts, by_run, heated, high_rate, even, *counts, still, warm)


@lru_cache(maxsize=1024)
def state(seed: int, boot: int) -> State:
    """Return the states of the two odd sensors, determined from a few seconds after switch-on."""
    short = _simulation(seed, boot, Still(seconds=_PEEK_S), 50.0, ("BMA1", "Gyro3"))
    means = {name: sensor.block(0, sensor.rows).counts.mean(axis=0) for name, sensor in short}
    first, second = (np.array(bias_state.centre) for bias_state in bias_states())
    towards = second - first
    return State(bool(means["BMA1"][2] > 2000), bool((means["Gyro3"] - (first + second) / 2) @ towards > 0))


def run_temperatures() -> Floats:
    """Return the temperatures (15,) of the runs in degC: BMA1's thermometer (Table 6; its faulty run is interpolated),
    scaled to the mean and standard deviation of the independent thermometer in Table 11.
    """
    codes = np.array([float(number_in(row, "temp_int")) for row in table(6)])
    for fault in boot_faults():
        codes[fault.run - 1] = (codes[fault.run - 2] + codes[fault.run]) / 2
    shape = (codes - codes.mean()) / codes.std(ddof=1)
    return np.asarray(DEGC[11, "runs_mean"] + DEGC[11, "runs_std_of_means"] * shape)


def high_rate_s(range_name: str) -> float:
    """Return the duration in s of a high-rate experiment, from Table 9's (std / sem)^2 readings at 350 Hz: 1379 s at
    250 dps, but 987 s at 2000 dps, although the text states about 1400 s for both.
    """
    rows = [row for row in table(9) if row["range"] == range_name]
    counts = [(float(number_in(row, "std_lsb")) / float(number_in(row, "sem_lsb"))) ** 2 for row in rows]
    return float(np.mean(counts)) / HIGH_RATE_HZ


def _jobs(seed: int) -> Iterator[tuple[str, Callable[[], object]]]:
    seeds_used: set[int] = set()

    def boot(faulty: bool, second: bool) -> int:
        number = next(n for n in count(1) if n not in seeds_used and state(seed, n) == (faulty, second))
        seeds_used.add(number)
        return number

    yield "faces", partial(_faces, seed, boot(False, True))
    yield "parts of a run", partial(_parts, seed, boot(False, False))
    yield "heating", partial(_heating, seed, boot(False, False))
    for name in ("250dps", "2k dps"):
        yield f"Gyro1 at {name}", partial(_high_rate, seed, boot(False, False), name)
    yield "even codes", partial(_even, seed, boot(False, False))
    faults, second = {fault.run for fault in boot_faults()}, bias_states()[1].runs
    for run in range(1, PARTS + 1):
        yield f"run {run}", partial(_run, seed, boot(run in faults, run in second), run)


@cache
def _model() -> Model:
    return load_model(configs() / "models" / "martin2013.toml")


@cache
def _array() -> ArrayConfig:
    return load_array(configs() / "martin2013.toml")


def _simulation(
    seed: int, boot: int, motion: Motion, rate_hz: float, names: tuple[str, ...] = SENSORS
) -> Iterator[tuple[str, Triad]]:
    """Yield the sensors one after the other; the memory of a sensor's rows is released with it."""
    sensors = Simulation.of_array(
        _array().only(names), motion, _model(), frame_rate_hz=rate_hz, seed=seed, boot=boot
    ).sensors
    for name in names:
        yield name, sensors.pop(name)


def array_rate_hz(number: int) -> float:
    """Return the array's logging rate by Table 10 or 11."""
    return float(logging_rate()[f"table{number}_hz"]["mean"])


def _faces(seed: int, boot: int) -> dict[str, list[Window]]:
    motion = Tumble(temperatures_degc=FACES_DEGC)
    spans = [(phase.start_ns, phase.end_ns) for phase in motion.phases]
    return {n: windows(s, spans) for n, s in _simulation(seed, boot, motion, array_rate_hz(10))}


def _parts(seed: int, boot: int) -> tuple[dict[str, list[Window]], dict[str, Series]]:
    """Return fifteen consecutive windows, and the stored readings. A linear drift by d per window has a standard
    deviation of d sqrt(15 16 / 12).
    """
    drift = DEGC[11, "cont_std_of_means"] / np.sqrt(PARTS * (PARTS + 1) / 12)
    start = DEGC[11, "cont_mean"] - drift * PARTS / 2
    motion = Still("+Z", PARTS * WINDOW_S, float(start), drift_degc_per_h=float(drift) * 3600 / WINDOW_S)
    step = round(WINDOW_S * 1e9)
    spans = [(part * step, (part + 1) * step) for part in range(PARTS)]
    means, still = {}, {}
    for name, sensor in _simulation(seed, boot, motion, array_rate_hz(11)):
        recorded = StoredSensor(sensor)
        means[name], still[name] = windows(recorded, spans), recorded.series
    return means, still


def _run(seed: int, boot: int, run: int) -> dict[str, list[Window]]:
    motion = turn_on_run(run, WINDOW_S, float(run_temperatures()[run - 1]))
    whole = [(0, round(WINDOW_S * 1e9))]
    return {n: windows(s, whole) for n, s in _simulation(seed, boot, motion, array_rate_hz(11))}


def _heating(seed: int, boot: int) -> tuple[dict[str, TemperatureLine], dict[str, Series]]:
    motion = Heating()
    lines, warm = {}, {}
    for name, sensor in _simulation(seed, boot, motion, array_rate_hz(10)):
        recorded = StoredSensor(sensor) if name in WARMED else sensor
        lines[name] = line(recorded, motion)
        if isinstance(recorded, StoredSensor):
            warm[name] = recorded.series
    return lines, warm


def _high_rate(seed: int, boot: int, range_name: str) -> HighRate:
    """Return the high-rate experiment: 400 Hz and 110 Hz were set (appendix A.1), +X was up (section 4)."""
    seconds = high_rate_s(range_name)
    motion = Still("+X", seconds, high_rate_degc(range_name))
    dps = 250.0 if range_name == "250dps" else 2000.0
    gyro = _array()["Gyro1"].model_copy(update={"range": dps, "rate_hz": 400.0, "bandwidth_hz": 110.0})
    array = _array().model_copy(update={"sensors": (gyro,)})
    simulation = Simulation.of_array(array, motion, _model(), frame_rate_hz=HIGH_RATE_HZ, seed=seed, boot=boot)
    sensor = simulation.sensors["Gyro1"]
    counts = np.concatenate([block.counts for block in blocks(sensor)])
    return HighRate(windows(sensor, [(0, 2**62)])[0], counts)


def _even(seed: int, boot: int) -> dict[str, float]:
    sensors = _simulation(seed, boot, Still(seconds=WINDOW_S), array_rate_hz(11), ("ADXL1", "ADXL2"))
    return {name: float(np.mean(sensor.block(0, sensor.rows).counts % 2 == 0)) for name, sensor in sensors}

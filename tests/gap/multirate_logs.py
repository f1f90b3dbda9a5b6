"""Logs written by hand with NumPy alone: two or three experiments at different rates, with an effect that is visible at
some rates, at some times or in some units only. The simulator's effects are not used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from imuarray.array import parse_array
from imuarray.gap.recording.recordings import Recording, recordings_of
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, STALE, Phase, SensorHeader
from imuarray.log.writer import Block, LogWriter
from imuarray.simulate import plan_of

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

NOISE_DPS, NOISE_G = 0.06, 0.004
_SETTLED = 64
"""Rows that are left out until filters have settled."""

_FACE = {"+X": (1, 0, 0), "-X": (-1, 0, 0), "+Y": (0, 1, 0), "-Y": (0, -1, 0), "+Z": (0, 0, 1), "-Z": (0, 0, -1)}

_SENSOR = """
[[sensor]]
name = "{name}"
chip = "{chip}"
address = {address}
{settings}
axes = "{axes}"
"""
# noise is white from row to row: the cutoffs are too high to be visible in the rows
_SETTINGS = {
    "l3g4200d": "range = 250\nrate_hz = 800\nbandwidth_hz = 110",
    "bma180": "range = 4\nbandwidth_hz = 150",
    "adxl345": "range = 4\nrate_hz = 800",
}
_CHIPS = {"G": "l3g4200d", "A": "bma180", "D": "adxl345"}
_ADDRESSES = {"l3g4200d": (0x68, 0x69), "bma180": (0x40, 0x41), "adxl345": (0x1D, 0x53)}
_AXES = ("+X+Y+Z", "-X+Y-Z", "+X-Y-Z")


class Experiment(NamedTuple):
    """A log at rest: rows per second, seconds on each of these faces."""

    rate_hz: float
    face_s: float
    faces: tuple[str, ...] = ("+Z",)


FAST, SLOW = Experiment(200.0, 60.0), Experiment(48.0, 20.0, ("+Z", "+X", "+Y", "-X", "-Y", "-Z"))


@dataclass
class Rows:
    """One sensor in one log: `time_s` (n,), `signal` and `noise` (n, 3) in the sensor's unit, which an effect changes
    before they are converted to `counts`; it changes these, `kept` and `stale` (n,) afterwards. Rows after lost rows
    have a flag if the recorder `flags_losses`.
    """

    log: int
    sensor: str
    rate_hz: float
    time_s: Floats
    signal: Floats
    noise: Floats
    counts: npt.NDArray[np.int64]
    kept: Bools
    stale: Bools
    rng: np.random.Generator
    flags_losses: bool = True


def _nothing(rows: Rows) -> None:
    """Change nothing."""


class Change(NamedTuple):
    """The change by an effect before and after the conversion to counts."""

    analog: Callable[[Rows], None] = _nothing
    digital: Callable[[Rows], None] = _nothing


def recorded(
    folder: Path,
    changes: Mapping[str, Change],
    experiments: Sequence[Experiment] = (FAST, SLOW),
    names: Sequence[str] = ("G1", "G2", "G3"),
    seed: int = 1,
) -> tuple[Recording, ...]:
    """Logs of these sensors (G: gyroscopes, A and D: accelerometers of two chips), with `changes` by sensor."""
    logs = []
    biases = {name: np.random.default_rng((seed, 77, at)).normal(0, 0.02, 3) for at, name in enumerate(names)}
    for number, one in enumerate(experiments):
        path = folder / f"log{number}.h5"
        _write(path, number, one, names, changes, biases, seed)
        logs.append(open_log(path))
    return recordings_of(logs)


def _write(
    path: Path,
    number: int,
    experiment: Experiment,
    names: Sequence[str],
    changes: Mapping[str, Change],
    biases: Mapping[str, Floats],
    seed: int,
) -> None:
    seconds = experiment.face_s * len(experiment.faces)
    array = parse_array(_array(names))
    plan = plan_of(array, experiment.rate_hz, seconds)
    headers = [replace(header, has_temperature=False) for header, _ in plan.sensors.values()]
    epoch = "2026-01-01T00:00:00.000000Z"
    with LogWriter(path, headers, source="i2c", epoch=epoch) as log:
        for at, face in enumerate(experiment.faces):
            begin, end = (round((at + more) * experiment.face_s * 1e9) for more in (0, 1))
            log.phase(Phase(begin, end, "static" if len(experiment.faces) == 1 else f"face_{at}", face))
        for place, header in enumerate(headers):
            rng = np.random.default_rng((seed, number, place))
            log.append(header.name, _block(number, experiment, header, changes.get(header.name, Change()), biases, rng))


def _array(names: Sequence[str]) -> str:
    parts = ['[array]\nname = "by hand"\nbus = "i2c:/dev/i2c-1"\n']
    for place, name in enumerate(names):
        chip, number = _CHIPS[name[0]], int(name[1:])
        bus = "" if number < 3 else 'bus = "i2c:/dev/i2c-2"'
        address = _ADDRESSES[chip][(number - 1) % 2]
        settings = _SETTINGS[chip] + (f"\n{bus}" if bus else "")
        parts.append(_SENSOR.format(name=name, chip=chip, address=address, settings=settings, axes=_AXES[place % 3]))
    return "".join(parts)


def _block(
    number: int,
    experiment: Experiment,
    header: SensorHeader,
    change: Change,
    biases: Mapping[str, Floats],
    rng: np.random.Generator,
) -> Block:
    seconds = experiment.face_s * len(experiment.faces)
    count = int(seconds * experiment.rate_hz) - 1
    time_s = np.asarray((np.arange(count) + 0.5) / experiment.rate_hz, np.float64)
    turn = np.array(header.orientation)
    signal = np.zeros((count, 3))
    if header.quantity == "specific_force":
        ups = np.array([_FACE[face] for face in experiment.faces], float)
        signal += ups[np.minimum((time_s / experiment.face_s).astype(int), len(ups) - 1)] @ turn
    signal += biases[header.name] * (10 if header.quantity == "angular_rate" else 1)
    noise = rng.normal(0, NOISE_DPS if header.quantity == "angular_rate" else NOISE_G, (count, 3))
    nothing = np.zeros(count, bool)
    rows = Rows(
        number,
        header.name,
        experiment.rate_hz,
        time_s,
        signal,
        noise,
        np.zeros((count, 3), np.int64),
        ~nothing,
        nothing,
        rng,
    )
    change.analog(rows)
    rows.counts = np.rint((rows.signal + rows.noise) * header.sensitivity).astype(np.int64)
    change.digital(rows)
    status = np.where(rows.stale, STALE, 0).astype(np.uint16)
    lost_before = np.concatenate([[False], ~rows.kept[:-1]]) & rows.flags_losses
    status |= np.where(lost_before, LOST_BEFORE, 0).astype(np.uint16)
    kept = rows.kept
    return Block(np.rint(time_s[kept] * 1e9).astype(np.int64), rows.counts[kept].astype(np.int16), status[kept], None)


def low_pass(cutoff_hz: float) -> Change:
    """Noise after a low-pass of one pole, sampled 16 times as finely as rows."""

    def analog(rows: Rows) -> None:
        fine = 16
        decay = np.exp(-2 * np.pi * cutoff_hz / (rows.rate_hz * fine))
        white = rows.rng.normal(0, 1, ((len(rows.time_s) + _SETTLED) * fine, 3))
        smooth = lfilter([1 - decay], [1, -decay], white, axis=0)[_SETTLED * fine :: fine]
        rows.noise = smooth / np.sqrt((1 - decay) / (1 + decay)) * rows.noise.std()

    return Change(analog)


def low_pass_since(cutoff_hz: float, since_s: float, log: int = 0) -> Change:
    """White noise passes a filter of one pole from a moment on, row by row, and becomes smaller."""

    def analog(rows: Rows) -> None:
        if rows.log == log:
            decay = np.exp(-2 * np.pi * cutoff_hz / rows.rate_hz)
            late = rows.time_s >= since_s
            rows.noise[late] = lfilter([1 - decay], [1, -decay], rows.noise[late], axis=0)

    return Change(analog)


def line(
    frequency_hz: float, amplitude: float, axis: int = 1, since_s: float = 0.0, logs: Sequence[int] = (0, 1)
) -> Change:
    """A sine on one axis, from a moment on, in these logs."""

    def analog(rows: Rows) -> None:
        if rows.log in logs:
            phase = rows.rng.uniform(0, 2 * np.pi)
            wave = amplitude * np.sin(2 * np.pi * frequency_hz * rows.time_s + phase)
            rows.signal[:, axis] += np.where(rows.time_s >= since_s, wave, 0.0)

    return Change(analog)


def shifted(by: float, since_s: float, end_s: float = np.inf, axis: int = 0, log: int = 0) -> Change:
    """Another level of one axis for a part of the time of a log."""

    def analog(rows: Rows) -> None:
        if rows.log == log:
            rows.signal[:, axis] += np.where((rows.time_s >= since_s) & (rows.time_s < end_s), by, 0.0)

    return Change(analog)


def held(new_hz: float, since_s: float = 0.0, end_s: float = np.inf) -> Change:
    """The chip has so many new readings per second, for a part of the time: faster rows are repeats."""

    def digital(rows: Rows) -> None:
        if new_hz >= rows.rate_hz:
            return
        shown = np.floor(rows.time_s * new_hz + 0.37)
        inside = (rows.time_s >= since_s) & (rows.time_s < end_s)
        first = np.concatenate([[True], np.diff(shown) > 0]) | ~inside
        source = np.maximum.accumulate(np.where(first, np.arange(len(shown)), 0))
        rows.counts = rows.counts[source]
        rows.stale = ~first

    return Change(digital=digital)


def even_codes(begin_s: float, end_s: float, logs: Sequence[int] = (0,)) -> Change:
    """Codes are even for a part of the time."""

    def digital(rows: Rows) -> None:
        if rows.log in logs:
            inside = (rows.time_s >= begin_s) & (rows.time_s < end_s)
            rows.counts = np.where(inside[:, None], 2 * np.floor(rows.counts / 2).astype(np.int64), rows.counts)

    return Change(digital=digital)


def in_fours(axis: int, logs: Sequence[int]) -> Change:
    """Codes of one axis are multiples of four in some logs."""

    def digital(rows: Rows) -> None:
        if rows.log in logs:
            rows.counts[:, axis] = 4 * np.rint(rows.counts[:, axis] / 4).astype(np.int64)

    return Change(digital=digital)


def shared_noise(
    rms: float, sign: int = 1, seed: int = 5, since_s: float = 0.0, logs: Sequence[int] = (0, 1)
) -> Change:
    """White noise that is the same in every unit with this change, along their own axes, except for its sign; from a
    moment on, in these logs.
    """

    def analog(rows: Rows) -> None:
        noise = sign * np.random.default_rng((seed, rows.log)).normal(0, rms, rows.signal.shape)
        if rows.log in logs:
            rows.signal += np.where(rows.time_s[:, None] >= since_s, noise, 0.0)

    return Change(analog)


def lost(moments_s: Sequence[float], log: int = 0, *, flagged: bool = True) -> Change:
    """Single readings that are lost, with or without the flag."""

    def digital(rows: Rows) -> None:
        rows.flags_losses = flagged
        if rows.log == log:
            rows.kept[np.searchsorted(rows.time_s, moments_s)] = False

    return Change(digital=digital)


def repeated(moments_s: Sequence[float], log: int = 0) -> Change:
    """Single readings that repeat the previous one."""

    def digital(rows: Rows) -> None:
        if rows.log == log:
            at = np.searchsorted(rows.time_s, moments_s)
            rows.counts[at] = rows.counts[at - 1]
            rows.stale[at] = True

    return Change(digital=digital)


def off(moments_s: Sequence[float], jump_lsb: int, log: int = 0) -> Change:
    """Single readings of one axis with an error."""

    def digital(rows: Rows) -> None:
        if rows.log == log:
            rows.counts[np.searchsorted(rows.time_s, moments_s), 2] += jump_lsb

    return Change(digital=digital)


def scaled(error: float, logs: Sequence[int]) -> Change:
    """Another scale in some logs."""

    def analog(rows: Rows) -> None:
        if rows.log in logs:
            rows.signal *= 1 + error
            rows.noise *= 1 + error

    return Change(analog)


def more_noise(by: float, logs: Sequence[int] = (0,), since_s: float = 0.0, end_s: float = np.inf) -> Change:
    """More noise in some logs, or for a part of the time."""

    def analog(rows: Rows) -> None:
        if rows.log in logs:
            inside = (rows.time_s >= since_s) & (rows.time_s < end_s)
            rows.noise = np.where(inside[:, None], rows.noise * by, rows.noise)

    return Change(analog)

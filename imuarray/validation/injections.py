"""Real recordings as cases: an effect of known size is injected into a recorded log; the unchanged log is the control.

    python -m imuarray.validation.injections RUN.h5... -o FOLDER --seed 1

A recording of real sensors has unknown effects of its own; only the injected effect is known. A case is therefore
scored by the causes that are reported for it and not for its control. The folder has the form of
`imuarray.validation.case_folder`. Sizes are in detection limits (`imuarray.validation.severity`).

An effect of the signal acts before its conversion to codes. The recording has only the codes: the signal before the
conversion is drawn within the width of its code, the effect is added, and the sum is converted again. Without an effect
no code changes, however coarse the codes are; a small effect changes few of them.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from zlib import crc32

import click
import h5py
import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.log import Log, SensorLog, open_log
from imuarray.log.row_timing import even_rows, row_timing
from imuarray.units import INERTIAL
from imuarray.validation.case_folder import write_truth
from imuarray.validation.severity import find_severity, matched_statistic

LIMITS = 5.0
"""Default size of an injected effect in detection limits."""
WANDER_S = 30.0
"""Correlation time of a wandering offset in s."""
_LEVEL_ROWS = 64
_MOVES = {"g": 0.5, "dps": 20.0}
"""Change of the mean of `_LEVEL_ROWS` rows above which a sensor is considered to have moved, by unit."""


class Rows(NamedTuple):
    """Rows of one sensor: the times at which they were read (n,) s since the log's first row, stamps (n,) ns, counts
    (n, 3), and which of the log's rows they are.
    """

    at_s: Floats
    time: Integers
    counts: Floats
    arriving: Any = slice(None)


@dataclass(frozen=True)
class Injection:
    """An effect that can be injected into a recording. `act` returns changed rows for rows, axis, size and generator.
    `names` are the correct effect names, `first` the size at which the search for the detection limit starts, in counts
    unless `unit` says otherwise; 0 if the effect has no size. `needs_motion`: it cannot be detected in a recording at
    rest; `needs_every_code`: it cannot be detected in a sensor whose codes already have a step other than 1.
    """

    act: Callable[[Rows, int, float, np.random.Generator], Rows]
    names: tuple[str, ...]
    first: float
    unit: str = "counts"
    is_of_axis: bool = False
    is_of_all: bool = False
    needs_motion: bool = False
    needs_every_code: bool = False


def _wander(rows: Rows, axis: int, size: float, random: np.random.Generator) -> Rows:
    """Add a first-order Gauss-Markov process of `size` counts rms."""
    remaining = np.exp(-np.diff(rows.at_s, prepend=rows.at_s[0]) / WANDER_S)
    steps = random.standard_normal(len(rows.at_s)) * np.sqrt(1 - remaining**2)
    path, value = np.empty(len(rows.at_s)), float(random.standard_normal())
    for row, (share, step) in enumerate(zip(remaining.tolist(), steps.tolist(), strict=True)):
        value = share * value + step
        path[row] = value
    return _add_to_axis(rows, axis, size * path, random)


def _line(rows: Rows, axis: int, size: float, random: np.random.Generator) -> Rows:
    """Add a sine of `size` counts at a frequency between a tenth and nine tenths of the Nyquist frequency."""
    half_hz = 0.5 / float(np.median(np.diff(rows.at_s)))
    hz, phase = random.uniform(0.1, 0.9) * half_hz, random.uniform(0, 2 * np.pi)
    return _add_to_axis(rows, axis, size * np.sin(2 * np.pi * hz * rows.at_s + phase), random)


def _drop(rows: Rows, axis: int, size: float, random: np.random.Generator) -> Rows:
    """Drop this share of the rows at random."""
    arriving = random.random(len(rows.at_s)) >= size
    return Rows(rows.at_s[arriving], rows.time[arriving], rows.counts[arriving], arriving)


def _even(rows: Rows, axis: int, size: float, random: np.random.Generator) -> Rows:
    """Double the step between codes."""
    step = 2 * _step_of(rows.counts)
    return rows._replace(counts=np.round(rows.counts / step) * step)


def _clock(rows: Rows, axis: int, size: float, random: np.random.Generator) -> Rows:
    """Make the clock fast by this share."""
    first = rows.time[0]
    return rows._replace(time=first + np.round((rows.time - first) * (1 + size)).astype(np.int64))


def _swap(rows: Rows, axis: int, size: float, random: np.random.Generator) -> Rows:
    """Exchange an axis with the next one and reverse the sign of one of them."""
    other, swapped = (axis + 1) % 3, rows.counts.copy()
    swapped[:, axis], swapped[:, other] = rows.counts[:, other], -rows.counts[:, axis]
    return rows._replace(counts=swapped)


INJECTIONS: Mapping[str, Injection] = {
    "wandering_offset": Injection(_wander, ("bias_instability", "random_walk"), 1.0, is_of_axis=True),
    "line": Injection(_line, ("tone",), 1.0, is_of_axis=True),
    "dropped_rows": Injection(_drop, ("dropped_samples",), 0.01, "share of rows"),
    "even_codes": Injection(_even, ("quantisation",), 0.0, "", needs_every_code=True),
    "clock_off": Injection(_clock, ("clock_error",), 0.02, "1", is_of_all=True, needs_motion=True),
    "swapped_axis": Injection(_swap, ("axis_error",), 0.0, "", needs_motion=True),
}


class _Target(NamedTuple):
    """The place of an injection: an axis of a sensor in the log at `path`, and the seed of its randomness."""

    path: Path
    sensor: str
    axis: int
    seed: int


def write_cases(
    logs: Sequence[Path],
    folder: Path,
    seed: int,
    *,
    names: Sequence[str] = tuple(INJECTIONS),
    limits: float = LIMITS,
) -> list[str]:
    """Write the control, and one case for each injection into the first of the `logs`, which all belong to one
    recording. Return the numbers of the cases, that of the control first; they continue the numbers in the folder.
    Injections that do not reach the required size are omitted.
    """
    folder.mkdir(parents=True, exist_ok=True)
    first = len([place for place in folder.glob("[0-9]*") if place.is_dir()])
    numbers = [f"{first:03d}"]
    with ExitStack() as stack:
        plain = [stack.enter_context(open_log(path)) for path in logs]
        sensors = {name: sensor for name, sensor in plain[0].sensors.items() if sensor.is_triad and len(sensor)}
        chips = {name: sensor.chip for name, sensor in sensors.items()}
        about = {"world": "real", "sensors": chips, "experiments": [path.stem for path in logs]}
        _copy_logs(logs, folder / numbers[0])
        write_truth(folder, numbers[0], {**about, "kind": "control", "effects": []})
        for name in names:
            random = np.random.default_rng([seed, crc32(name.encode())])
            targets = _targets(INJECTIONS[name], sensors)
            if not targets:
                continue
            sensor, axis = str(random.choice(targets)), int(random.integers(3))
            target = _Target(logs[0], sensor, axis, int(random.integers(2**31)))
            fit = _find_size(INJECTIONS[name], target, plain[0], limits, stack)
            if fit is None:
                continue
            size, measured = fit
            number = f"{first + len(numbers):03d}"
            _copy_logs(logs, folder / number)
            touched = list(sensors) if INJECTIONS[name].is_of_all else [sensor]
            for touched_name in touched:
                inject(folder / number / logs[0].name, INJECTIONS[name], touched_name, axis, size, target.seed)
            effect = {
                "effect": name,
                "design_name": INJECTIONS[name].names[0],
                "size": size,
                "also_called": list(INJECTIONS[name].names[1:]),
                "unit": INJECTIONS[name].unit,
                "sensors": touched,
                "severity": None if measured is None else limits,
                "measured": measured,
                "axes": ["xyz"[axis]] if INJECTIONS[name].is_of_axis else ["x", "y", "z"],
            }
            write_truth(folder, number, {**about, "kind": "effect", "effects": [effect], "control": numbers[0]})
            numbers.append(number)
    return numbers


def inject(path: Path, injection: Injection, sensor: str, axis: int, size: float, seed: int) -> None:
    """Inject an effect into a log, in place. Counts remain integers within their data type."""
    with open_log(path) as log:
        at_s = _reading_times_s(log[sensor])
    with h5py.File(path, "r+") as file:
        group = file[f"sensors/{sensor}"]
        time, counts = group["time"][:], group["counts"][:]
        rows = injection.act(Rows(at_s, time, counts.astype(float)), axis, size, np.random.default_rng(seed))
        span = np.iinfo(counts.dtype)
        columns = {"time": rows.time, "counts": np.clip(np.round(rows.counts), span.min, span.max).astype(counts.dtype)}
        for name, dataset in group.items():
            if isinstance(dataset, h5py.Dataset) and len(dataset) == len(time):
                values = columns[name] if name in columns else dataset[:][rows.arriving]
                dataset.resize(len(rows.time), axis=0)
                dataset[:] = values


def _reading_times_s(sensor: SensorLog) -> Floats:
    """Return the times (n,) at which the rows were read, in s since the first one. If rows arrive in bursts, these are
    not their stamps.
    """
    is_stamped_late = row_timing(sensor).kind == "bursts"
    time_ns = even_rows(sensor).stamps(0, len(sensor)) if is_stamped_late else np.asarray(sensor.time[:], np.int64)
    return np.asarray((time_ns - time_ns[0]) * 1e-9)


def _targets(injection: Injection, sensors: Mapping[str, SensorLog]) -> list[str]:
    """Return the sensors in which the effect can be detected: the inertial ones if there are any, otherwise all."""
    inertial = {name: sensor for name, sensor in sensors.items() if sensor.quantity in INERTIAL}
    if injection.needs_motion and not any(map(_moves, inertial.values())):
        return []
    return [
        name
        for name, sensor in (inertial or sensors).items()
        if not injection.needs_every_code or _step_of(np.asarray(sensor.counts[:])) == 1
    ]


def _moves(sensor: SensorLog) -> bool:
    """Return whether the level of an inertial sensor changes by more than its offset can change."""
    rows = len(sensor) // _LEVEL_ROWS
    levels = sensor.counts[: rows * _LEVEL_ROWS].reshape(rows, _LEVEL_ROWS, 3).mean(axis=1) / sensor.sensitivity
    return bool(rows and np.ptp(levels, axis=0).max() > _MOVES[sensor.unit])


def _step_of(counts: Floats | Integers) -> int:
    """Return the step between the codes of a sensor: 1, or more if lower bits never change."""
    return max(1, int(np.gcd.reduce(np.abs(counts - counts[0]).astype(int), axis=None)))


def _add_to_axis(rows: Rows, axis: int, added: Floats, random: np.random.Generator) -> Rows:
    """Add to the signal of an axis before its conversion to codes."""
    counts, step, changed = rows.counts, _step_of(rows.counts), rows.counts.copy()
    signal = counts[:, axis] + step * random.uniform(-0.5, 0.5, len(counts)) + added
    changed[:, axis] = counts[0, axis] + step * np.round((signal - counts[0, axis]) / step)
    return rows._replace(counts=changed)


def _copy_logs(logs: Sequence[Path], folder: Path) -> None:
    folder.mkdir(parents=True)
    for path in logs:
        shutil.copyfile(path, folder / path.name)


def _find_size(
    injection: Injection, target: _Target, plain: Log, limits: float, stack: ExitStack
) -> tuple[float, float | None] | None:
    """Return the size that amounts to `limits` detection limits in this log, and the limits that were measured there
    (None for an effect without size); None if the size cannot be reached.
    """
    if not injection.first:
        return 1.0, None

    def statistic(severity: float) -> float:
        copy = Path(stack.enter_context(TemporaryDirectory())) / target.path.name
        shutil.copyfile(target.path, copy)
        inject(copy, injection, target.sensor, target.axis, severity * injection.first, target.seed)
        return matched_statistic([plain], [stack.enter_context(open_log(copy))])

    fit = find_severity(statistic, limits, 1.0)
    return (fit.severity * injection.first, fit.limits) if isfinite(fit.limits) else None


@click.command()
@click.argument("logs", type=click.Path(exists=True, dir_okay=False, path_type=Path), nargs=-1, required=True)
@click.option(
    "-o", "--output", type=click.Path(file_okay=False, path_type=Path), required=True, help="folder for the cases"
)
@click.option("--seed", type=int, default=0, show_default=True, help="seed of the sensors, axes and random numbers")
@click.option("--limits", type=float, default=LIMITS, show_default=True, help="size of effects in detection limits")
def program(logs: tuple[Path, ...], output: Path, seed: int, limits: float) -> None:
    """Write cases for `imuarray gap validate --cases`: effects of known size injected into recorded LOGS.

    Every log is a separate recording; the log without an effect is its control.
    """
    for number, path in enumerate(logs):
        for name in write_cases([path], output, 1000 * seed + number, limits=limits):
            click.echo(output / name)


if __name__ == "__main__":
    program()

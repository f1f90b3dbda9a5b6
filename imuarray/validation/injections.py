"""Real recordings as cases: an effect of known size put into a recorded log, the untouched log as control.

    python -m imuarray.validation.injections RUN.h5... -o FOLDER --seed 1

A recording that was made of real sensors has whatever it has; what was put into it is known. So a case counts as told
rightly by what is said of it and not of its control. The folder is one of `imuarray.validation.case_folder`. Sizes are
in detection limits as everywhere (`imuarray.validation.severity`).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any
from zlib import crc32

import click
import h5py
import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.log import Log, open_log
from imuarray.validation.case_folder import write_truth
from imuarray.validation.severity import sized

LIMITS = 5.0
"""Detection limits of what is put in, unless another size is asked for."""
WANDER_S = 30.0
"""Correlation time of an offset that wanders."""


@dataclass(frozen=True)
class Injection:
    """What can be put into a recording: `act` (times (n,) s since the log's first row, time (n,) ns, counts (n, 3),
    axis, size, generator) -> rows kept, time, counts. `names` are what it may be called, `first` the size at which the
    search for the limit begins, in counts if not said; 0: it is there or not.
    """

    act: Callable[[Floats, Integers, Floats, int, float, np.random.Generator], tuple[Any, Integers, Floats]]
    names: tuple[str, ...]
    first: float
    unit: str = "counts"
    is_of_axis: bool = False
    is_of_all: bool = False


def _wander(
    at_s: Floats, time: Integers, counts: Floats, axis: int, size: float, random: np.random.Generator
) -> tuple[Any, Integers, Floats]:
    """A first-order Gauss-Markov process of `size` counts rms."""
    kept = np.exp(-np.diff(at_s, prepend=at_s[0]) / WANDER_S)
    steps = random.standard_normal(len(at_s)) * np.sqrt(1 - kept**2)
    path, value = np.empty(len(at_s)), float(random.standard_normal())
    for row, (share, step) in enumerate(zip(kept.tolist(), steps.tolist(), strict=True)):
        value = share * value + step
        path[row] = value
    return slice(None), time, _with(counts, axis, size * path)


def _line(
    at_s: Floats, time: Integers, counts: Floats, axis: int, size: float, random: np.random.Generator
) -> tuple[Any, Integers, Floats]:
    """A sine of `size` counts between a tenth and nine tenths of half the rate."""
    half_hz = 0.5 / float(np.median(np.diff(at_s)))
    hz, phase = random.uniform(0.1, 0.9) * half_hz, random.uniform(0, 2 * np.pi)
    return slice(None), time, _with(counts, axis, size * np.sin(2 * np.pi * hz * at_s + phase))


def _drop(
    at_s: Floats, time: Integers, counts: Floats, axis: int, size: float, random: np.random.Generator
) -> tuple[Any, Integers, Floats]:
    """So large a share of the rows never came."""
    kept = random.random(len(at_s)) >= size
    return kept, time[kept], counts[kept]


def _even(
    at_s: Floats, time: Integers, counts: Floats, axis: int, size: float, random: np.random.Generator
) -> tuple[Any, Integers, Floats]:
    """Codes in steps that are twice those of before."""
    step = 2 * max(1, int(np.gcd.reduce(np.abs(counts - counts[0]).astype(int), axis=None)))
    return slice(None), time, np.round(counts / step) * step


def _clock(
    at_s: Floats, time: Integers, counts: Floats, axis: int, size: float, random: np.random.Generator
) -> tuple[Any, Integers, Floats]:
    """A clock that is fast by so large a share."""
    return slice(None), time[0] + np.round((time - time[0]) * (1 + size)).astype(np.int64), counts


def _swap(
    at_s: Floats, time: Integers, counts: Floats, axis: int, size: float, random: np.random.Generator
) -> tuple[Any, Integers, Floats]:
    """An axis with the next one, one of them with its sign turned."""
    other, swapped = (axis + 1) % 3, counts.copy()
    swapped[:, axis], swapped[:, other] = counts[:, other], -counts[:, axis]
    return slice(None), time, swapped


INJECTIONS: Mapping[str, Injection] = MappingProxyType(
    {
        "wandering_offset": Injection(_wander, ("bias_instability", "random_walk"), 1.0, is_of_axis=True),
        "line": Injection(_line, ("tone",), 1.0, is_of_axis=True),
        "dropped_rows": Injection(_drop, ("dropped_samples",), 0.01, "share of rows"),
        "even_codes": Injection(_even, ("quantisation",), 0.0, ""),
        "clock_off": Injection(_clock, ("clock_error",), 0.02, "1", is_of_all=True),
        "swapped_axis": Injection(_swap, ("axis_error",), 0.0, ""),
    }
)


def write_cases(
    logs: Sequence[Path],
    folder: Path,
    seed: int,
    *,
    names: Sequence[str] = tuple(INJECTIONS),
    limits: float = LIMITS,
    documented: Sequence[Mapping[str, Any]] = (),
) -> list[str]:
    """Write the control and a case of each injection into the first of the `logs`, all of which belong to a recording;
    the numbers of the cases, the control's first, which go on where the folder ends. What a limit is not reached for is
    left out. `documented`: effects (as a truth has them) that the recording is known to have.
    """
    folder.mkdir(parents=True, exist_ok=True)
    first = len([place for place in folder.glob("[0-9]*") if place.is_dir()])
    numbers = [f"{first:03d}"]
    with ExitStack() as stack:
        plain = [stack.enter_context(open_log(path)) for path in logs]
        sensors = {name: one for name, one in plain[0].sensors.items() if one.is_triad and len(one)}
        chips = {name: one.chip for name, one in sensors.items()}
        about = {"world": "real", "sensors": chips, "experiments": [path.stem for path in logs]}
        _copied(logs, folder / numbers[0])
        control = "effect" if documented else "control"
        write_truth(folder, numbers[0], {**about, "kind": control, "effects": list(documented)})
        for name in names:
            random = np.random.default_rng([seed, crc32(name.encode())])
            inertial = [one for one in sensors if sensors[one].unit in ("g", "dps")]
            sensor = str(random.choice(inertial))
            axis, key = int(random.integers(3)), int(random.integers(2**31))
            found = _size(INJECTIONS[name], logs[0], plain[0], sensor, axis, key, limits, stack)
            if found is None:
                continue
            size, measured = found
            number = f"{first + len(numbers):03d}"
            _copied(logs, folder / number)
            touched = list(sensors) if INJECTIONS[name].is_of_all else [sensor]
            for one in touched:
                inject(folder / number / logs[0].name, INJECTIONS[name], one, axis, size, key)
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
    """Put it into a log, in place; counts stay whole numbers within their code span."""
    with h5py.File(path, "r+") as file:
        group = file[f"sensors/{sensor}"]
        time, counts = group["time"][:], group["counts"][:]
        at_s = (time - time[0]) * 1e-9
        kept, new_time, new_counts = injection.act(
            at_s, time, counts.astype(float), axis, size, np.random.default_rng(seed)
        )
        span = np.iinfo(counts.dtype)
        columns = {"time": new_time, "counts": np.clip(np.round(new_counts), span.min, span.max).astype(counts.dtype)}
        for name, dataset in group.items():
            if isinstance(dataset, h5py.Dataset) and len(dataset) == len(time):
                values = columns[name] if name in columns else dataset[:][kept]
                dataset.resize(len(new_time), axis=0)
                dataset[:] = values


def _with(counts: Floats, axis: int, added: Floats) -> Floats:
    changed = counts.copy()
    changed[:, axis] += added
    return changed


def _copied(logs: Sequence[Path], folder: Path) -> None:
    folder.mkdir(parents=True)
    for path in logs:
        shutil.copyfile(path, folder / path.name)


def _size(
    injection: Injection,
    path: Path,
    plain: Log,
    sensor: str,
    axis: int,
    seed: int,
    limits: float,
    stack: ExitStack,
) -> tuple[float, float | None] | None:
    """The size of so many detection limits in this log, and what was measured if it has a size; None if it doesn't get
    so far.
    """
    if not injection.first:
        return 1.0, None

    def logs_at(severity: float) -> list[Log]:
        copy = Path(stack.enter_context(TemporaryDirectory())) / path.name
        shutil.copyfile(path, copy)
        inject(copy, injection, sensor, axis, severity * injection.first, seed)
        return [stack.enter_context(open_log(copy))]

    found = sized(logs_at, [plain], limits, 1.0)
    return (found.severity * injection.first, found.limits) if isfinite(found.limits) else None


@click.command()
@click.argument("logs", type=click.Path(exists=True, dir_okay=False, path_type=Path), nargs=-1, required=True)
@click.option("-o", "--output", type=click.Path(file_okay=False, path_type=Path), required=True)
@click.option("--seed", type=int, default=0, show_default=True, help="of sensors, axes and chance")
@click.option("--limits", type=float, default=LIMITS, show_default=True, help="size in detection limits")
def program(logs: tuple[Path, ...], output: Path, seed: int, limits: float) -> None:
    """Write cases of each log, which is a recording of its own."""
    for number, path in enumerate(logs):
        for name in write_cases([path], output, 1000 * seed + number, limits=limits):
            click.echo(output / name)


if __name__ == "__main__":
    program()

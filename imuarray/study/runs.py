"""One run of the study: an experiment simulated with one seed, fused by every technique, measured against the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.array import ArrayConfig
from imuarray.calibrate import Calibration
from imuarray.calibrate.start_up import came_up
from imuarray.fuse import OPTIMAL, Coasting, ErrorFrames, FusedBlock, coasting, error_frames, fuse, technique_names
from imuarray.fuse.compare import both
from imuarray.fuse.consistency import consistency
from imuarray.fuse.fuse import AVERAGE
from imuarray.fuse.gains import ten_second_means
from imuarray.log import Log, open_log
from imuarray.log.format import SensorHeader
from imuarray.simulate import Simulation, write_log
from imuarray.simulate.experiments import EXPERIMENTS as MOTIONS
from imuarray.simulate.experiments import Wanted
from imuarray.study.arrays import ARRAYS, SETS
from imuarray.study.bound import ErrorLaw
from imuarray.study.calibrations import FAULTS, NO_SLOPES, RANGES, SLOPES, TRUE, measured, simulated
from imuarray.study.posterior import Posterior
from imuarray.study.truth import OUTSIDE, law_of, true_calibration
from imuarray.units import INERTIAL

Floats = npt.NDArray[np.float64]

CAUSAL, SMOOTHED = "bound, causal", "bound, smoothed"
"""The posterior mean beside the techniques: it reaches the bound on the very readings that they are given."""

OPTIMAL_CAUSAL = "optimal, causal"
"""`optimal` as a live log is fused; `optimal` itself sees the whole log."""

BOX_AXES = ("X", "Y", "Z", "XYZ")
COASTING = ("heading", "velocity")


@dataclass(frozen=True)
class Experiment:
    """What happens to the box (`imuarray.simulate.experiments`), for how long, how often it is switched on, and whether
    the bound holds.

    It does not under a motion that is fast for the chips' converters: a reading is up to a converter's period old, of
    which the bound knows nothing.
    """

    motion: str
    seconds: float
    drive: str = "hand"
    boots: int = 1
    is_bounded: bool = True


EXPERIMENTS: Mapping[str, Experiment] = MappingProxyType(
    {
        "static": Experiment("static", 300.0),
        "tumble": Experiment("tumble", 300.0),
        "heating": Experiment("heating", 660.0),
        "turn-on": Experiment("turn-on", 75.0, boots=4),
        "motion": Experiment("motion", 120.0, "vehicle"),
        "shaking": Experiment("motion", 120.0, "hand", is_bounded=False),
    }
)
"""By name. "heating" is the paper's profile at a tenth of its time, with all of its 28 degC."""


_BOOTS_APART = 100
"""From one experiment's first boot to that of the next: none draws what another one drew."""


@dataclass(frozen=True)
class Measured:
    """Mean squares of one run: what was fused how, of which quantity ("" for coasting), and by `measure` and box axis
    the mean square in SI (deg, m/s for coasting). `bound`, the same of the bound ("rms" alone); `normalised`, the mean
    error squared by its covariance, and whether that holds.
    """

    experiment: str
    calibration: str
    sensors: str
    technique: str
    quantity: str
    replicate: tuple[int, int]
    squares: Mapping[tuple[str, str], float]
    bound: Mapping[str, float] = field(default_factory=dict)
    normalised: float | None = None
    holds: bool | None = None


def run(name: str, seed: int, seconds: float | None = None) -> list[Measured]:
    """Everything about one experiment with one seed; `seconds` instead of its own length."""
    rows: list[Measured] = []
    with TemporaryDirectory(prefix="imuarray_study_") as folder:
        for array_name, make in ARRAYS.items():
            array = make()
            (place := Path(folder) / array_name).mkdir()
            known = measured(array_name, seed)
            first = _BOOTS_APART * list(EXPERIMENTS).index(name)
            for boot in range(first, first + EXPERIMENTS[name].boots):
                rows += _of_boot(name, seed, boot, seconds, array, known, place)
    return rows


def _of_boot(
    name: str,
    seed: int,
    boot: int,
    seconds: float | None,
    array: ArrayConfig,
    known: Mapping[str, Calibration],
    folder: Path,
) -> Iterator[Measured]:
    """One log of all effects and one of those that the law has."""
    about = EXPERIMENTS[name]
    motion = MOTIONS[about.motion](Wanted(seconds=seconds or about.seconds, drive=about.drive))
    sets = {chosen: names for chosen, (whose, names) in SETS.items() if whose == array.name}
    kinds = ((FAULTS, "all.h5"), (OUTSIDE, "law.h5"))
    for without, file in kinds if about.is_bounded else kinds[:1]:
        simulation = simulated(array, motion, seed, boot, without)
        write_log(simulation, folder / file, force=True)
        with open_log(folder / file) as log:
            ranges = {sensor.name: RANGES[sensor.chip] for sensor in log.sensors.values()}
            for sensors, names in sets.items():
                label = partial(Measured, name, sensors=sensors, replicate=(seed, boot))
                if file == "all.h5":
                    wanted = (SLOPES, NO_SLOPES) if name == "heating" else (SLOPES,)
                    for which in wanted:
                        calibration, _ = came_up(log, known[which], ranges)
                        yield from _compared(log, calibration, names, partial(label, calibration=which))
                else:
                    yield from _beside_bound(log, simulation, names, partial(label, calibration=TRUE))


Label = Callable[..., Measured]


def _compared(log: Log, calibration: Calibration, names: tuple[str, ...], label: Label) -> Iterator[Measured]:
    for technique, blocks in _results(log, calibration, names).items():
        yield from _measured(error_frames(log, blocks()), partial(label, technique=technique), {})


def _results(
    log: Log, calibration: Calibration, names: tuple[str, ...]
) -> dict[str, Callable[[], Iterator[FusedBlock]]]:
    """What makes the result of every technique."""
    made: dict[str, Callable[[], Iterator[FusedBlock]]] = {
        technique: partial(fuse, log, calibration, technique, only=names) for technique in technique_names()
    }
    made[OPTIMAL_CAUSAL] = partial(fuse, log, calibration, OPTIMAL, only=names, causal=True)
    return made


def _beside_bound(log: Log, simulation: Simulation, names: tuple[str, ...], label: Label) -> Iterator[Measured]:
    """The techniques with the true calibration, and the posterior mean, each beside the bound."""
    headers = {
        quantity: [
            sensor.header for sensor in simulation.sensors.values() if _is_chosen(sensor.header, quantity, names)
        ]
        for quantity in INERTIAL
    }
    effects = {name: sensor.effects for name, sensor in simulation.sensors.items()}
    laws: dict[str, ErrorLaw] = {quantity: law_of(chosen, effects) for quantity, chosen in headers.items() if chosen}
    calibration = true_calibration([header for chosen in headers.values() for header in chosen], effects)
    posterior = Posterior(log, calibration, laws, names)
    causal = {quantity: bound.causal_rms**2 for quantity, bound in posterior.bounds.items()}
    smoothed = {quantity: bound.smoothed_rms**2 for quantity, bound in posterior.bounds.items()}
    results = _results(log, calibration, names)
    results[CAUSAL] = posterior.blocks
    results[SMOOTHED] = partial(posterior.blocks, smoothed=True)
    for technique, blocks in results.items():
        least = smoothed if technique in (OPTIMAL, SMOOTHED) else causal
        yield from _measured(error_frames(log, blocks()), partial(label, technique=technique), least)


def _is_chosen(header: SensorHeader, quantity: str, names: tuple[str, ...]) -> bool:
    return header.quantity == quantity and (not names or header.name in names)


def _measured(found: Mapping[str, ErrorFrames], label: Label, least: Mapping[str, Floats]) -> Iterator[Measured]:
    for quantity, frames in found.items():
        held = consistency(frames.errors, frames.covariances)
        yield label(
            quantity=quantity,
            squares=_squares(frames),
            bound=_by_axis(least[quantity]) if quantity in least else {},
            normalised=None if held is None else held.normalised,
            holds=None if held is None else held.holds,
        )
    if len(found) == len(INERTIAL):
        coast = coasting(both(found))
        if len(coast.begins_s):
            yield label(quantity="", squares=_coasting_squares(coast))


def _squares(frames: ErrorFrames) -> dict[tuple[str, str], float]:
    """Mean squares by measure and box axis: of the errors, of their changes from frame to frame (halved), of ten-second
    means less the first of them.
    """
    errors = frames.errors
    rows = {
        "rms": errors,
        "noise": np.diff(errors, axis=0) / np.sqrt(2),
        "drift": ten_second_means(frames.time, errors)[1:],
    }
    return {
        (measure, axis): value
        for measure, part in rows.items()
        if len(part)
        for axis, value in _by_axis(np.mean(part**2, axis=0)).items()
    }


def _coasting_squares(coast: Coasting) -> dict[tuple[str, str], float]:
    ends = zip(COASTING, (coast.heading_deg, coast.velocity_mps), strict=True)
    return {(measure, ""): float(np.mean(values**2)) for measure, values in ends}


def _by_axis(squares: Floats) -> dict[str, float]:
    """Of each box axis, and their sum: of the length of the error."""
    return dict(zip(BOX_AXES, [*squares.tolist(), float(squares.sum())], strict=True))


__all__ = ["AVERAGE", "CAUSAL", "EXPERIMENTS", "SMOOTHED", "Experiment", "Measured", "run"]

"""The errors of a heated box over time, technique by technique, for a drawing."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.start_up import came_up
from imuarray.errors import LogError
from imuarray.fuse import errors_of, fuse, technique_names
from imuarray.fuse.gains import ten_second_means
from imuarray.log import open_log
from imuarray.simulate import write_log
from imuarray.simulate.experiments import EXPERIMENTS as MOTIONS
from imuarray.simulate.experiments import Wanted
from imuarray.study.arrays import ARRAY, ARRAYS
from imuarray.study.calibrations import FAULTS, NO_SLOPES, RANGES, measured, simulated
from imuarray.study.runs import EXPERIMENTS

Floats = npt.NDArray[np.float64]


_NOTHING = 1e-6
"""Of a rate in rad/s: techniques that differ by less are drawn once."""


class Heated(NamedTuple):
    """Time (n,) s; by technique the angular rate's ten-second means less the first (n, 3) rad/s; time and temperature
    (k,) of the box in degC.
    """

    time_s: Floats
    errors: dict[str, Floats]
    temperature: tuple[Floats, Floats]


def heated(seed: int = 1, seconds: float | None = None) -> Heated:
    """One heating of the paper's array, fused with a calibration that knows no slopes; techniques that give the same as
    the average are left out.
    """
    about = EXPERIMENTS["heating"]
    motion = MOTIONS[about.motion](Wanted(seconds=seconds or about.seconds))
    found: dict[str, Floats] = {}
    with TemporaryDirectory(prefix="imuarray_study_") as folder:
        path = Path(folder) / "heating.h5"
        write_log(simulated(ARRAYS[ARRAY](), motion, seed, 0, FAULTS), path)
        with open_log(path) as log:
            ranges = {sensor.name: RANGES[sensor.chip] for sensor in log.sensors.values()}
            calibration, _ = came_up(log, measured(ARRAY, seed)[NO_SLOPES], ranges)
            for technique in technique_names():
                time, errors = errors_of(log, fuse(log, calibration, technique))["angular_rate"]
                means = ten_second_means(time, errors)
                if not any(np.allclose(means, other, rtol=0, atol=_NOTHING) for other in found.values()):
                    found[technique] = means
            truth = log.truth
            if truth is None or truth.temperature is None:
                raise LogError(f"{path}: a simulated log without a truth")
            warm = (truth.time[:] * 1e-9, np.asarray(truth.temperature[:], float))
    time_s: Floats = np.arange(5.0, 10.0 * len(next(iter(found.values()))), 10.0)
    return Heated(time_s, found, warm)

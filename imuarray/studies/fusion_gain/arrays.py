"""The simulated arrays of the study, the sensors that are fused together, and their calibrations.

The calibrations are those that `calibrate` makes from simulated logs of the same units, recorded at other switch-ons
than the logs that are fused.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

import tomli_w

from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.calibrate import Calibration, calibrate_noise, calibrate_thermal, calibrate_tumble, calibrate_turn_on
from imuarray.chips import CHIPS
from imuarray.log import Log, open_log
from imuarray.shipped import configs
from imuarray.simulate import Motion, Simulation, effects_of, load_model, plan_of, write_log
from imuarray.simulate.experiments import EXPERIMENTS, ExperimentOptions

ARRAY = "martin2013"


def martin2013() -> ArrayConfig:
    """Return the paper's array."""
    return load_array(configs() / f"{ARRAY}.toml")


def perpendicular() -> ArrayConfig:
    """Return the paper's ADXL345, ADXL2's board stood up: its z, twice as noisy as x and y, lies along X instead of Z,
    and its x along Z (the paper's section 2.2; its own boards lie in parallel).
    """
    table = tomllib.loads(martin2013().text)
    table["array"]["name"] = "perpendicular"
    table["sensor"] = [entry for entry in table["sensor"] if entry["chip"] in ("adxl345", "bmp180")]
    next(entry for entry in table["sensor"] if entry["name"] == "ADXL2")["axes"] = "+Z-Y+X"
    return parse_array(tomli_w.dumps(table), "perpendicular")


ARRAYS: Mapping[str, Callable[[], ArrayConfig]] = MappingProxyType(
    {"martin2013": martin2013, "perpendicular": perpendicular}
)
"""Arrays by name."""

SETS: Mapping[str, tuple[str, tuple[str, ...]]] = MappingProxyType(
    {
        "all": ("martin2013", ()),
        "4 BMA180": ("martin2013", ("BMA1", "BMA2", "BMA3", "BMA4")),
        "2 ADXL345": ("perpendicular", ("ADXL1", "ADXL2")),
    }
)
"""A set of sensors that is fused: the array and the names of its sensors (none: all). The angular rate of "all" is that
of Gyro1, Gyro2 and Gyro3, and its specific force that of all six accelerometers.
"""


RATE_HZ = 48.0
"""Frames per second: the paper's array was read about as often. At a rate of 50 Hz the gyroscopes' 50 Hz tone would
stand still.
"""

TUMBLE_S, HEATING_S, BOOT_S = 300.0, 900.0, 30.0
BOOTS = 12
_FIRST_BOOT = 1000
"""Boots of calibrating logs are numbered from here: none of them is one that is fused."""

FAULTS = ("range_reset",)
"""Left out everywhere: a unit that came up in another range is a fault to be found, not an error to be averaged."""

SLOPES = "measured"
NO_SLOPES = "no slopes"
TRUE = "true"

RANGES: Mapping[str, Mapping[float, float]] = MappingProxyType({name: spec.sensitivity for name, spec in CHIPS.items()})

Steps = Callable[[Sequence[Log]], Calibration]


def simulated(array: ArrayConfig, motion: Motion, seed: int, boot: int, without: Collection[str]) -> Simulation:
    """Return the array with the units of the model `martin2013`, polled `RATE_HZ` times a second."""
    model = load_model(configs() / "models" / "martin2013.toml")
    plan = plan_of(array, RATE_HZ, motion.seconds)
    return Simulation(plan, motion, effects_of(plan, model, seed, without=without), seed=seed, boot=boot)


@lru_cache(maxsize=4)
def measured(array_name: str, seed: int) -> Mapping[str, Calibration]:
    """Return the calibrations by name: "no slopes", biases and responses from the six faces with noise and turn-on;
    "measured", the same with slopes from a heating log. Kept: all experiments with one seed are of the same units.
    """
    with TemporaryDirectory(prefix="imuarray_study_") as folder:
        return MappingProxyType(_measured(ARRAYS[array_name](), seed, Path(folder)))


def _measured(array: ArrayConfig, seed: int, folder: Path) -> dict[str, Calibration]:
    def recorded(experiment: str, seconds: float, boot: int) -> Path:
        motion = EXPERIMENTS[experiment](ExperimentOptions(seconds=seconds, run=max(boot, 1)))
        path = folder / f"calibrating_{experiment}_{boot}.h5"
        write_log(simulated(array, motion, seed, _FIRST_BOOT + boot, FAULTS), path)
        return path

    known = _from([recorded("tumble", TUMBLE_S, 0)], _tumble, _noise)
    boots = [recorded("turn-on", BOOT_S, boot) for boot in range(1, BOOTS + 1)]
    known = known.merged(_from(boots, _turn_on))
    heated = [recorded("heating", HEATING_S, BOOTS + 1)]
    slopes = _from(heated, _thermal)
    return {NO_SLOPES: known, SLOPES: known.merged(slopes)}


def _tumble(logs: Sequence[Log]) -> Calibration:
    return calibrate_tumble(*logs).calibration


def _noise(logs: Sequence[Log]) -> Calibration:
    return calibrate_noise(*logs)


def _turn_on(logs: Sequence[Log]) -> Calibration:
    return calibrate_turn_on(logs, RANGES)[0]


def _thermal(logs: Sequence[Log]) -> Calibration:
    return calibrate_thermal(*logs).calibration


def _from(paths: Sequence[Path], *steps: Steps) -> Calibration:
    """Apply the steps to these logs, one after the other."""
    with ExitStack() as stack:
        logs = [stack.enter_context(open_log(path)) for path in paths]
        known = Calibration()
        for step in steps:
            known = known.merged(step(logs))
    return known

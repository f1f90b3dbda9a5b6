"""The arrays of the study and the sensors that are fused together."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from types import MappingProxyType

import tomli_w

from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.shipped import configs

ARRAY = "martin2013"


def martin2013() -> ArrayConfig:
    """The paper's array."""
    return load_array(configs() / f"{ARRAY}.toml")


def perpendicular() -> ArrayConfig:
    """The paper's ADXL345, ADXL2's board stood up: its z, twice as noisy as x and y, lies along X instead of Z, and its
    x along Z (the paper's section 2.2; its own boards lie in parallel).
    """
    table = tomllib.loads(martin2013().text)
    table["array"]["name"] = "perpendicular"
    table["sensor"] = [entry for entry in table["sensor"] if entry["chip"] in ("adxl345", "bmp180")]
    next(entry for entry in table["sensor"] if entry["name"] == "ADXL2")["axes"] = "+Z-Y+X"
    return parse_array(tomli_w.dumps(table), "perpendicular")


ARRAYS: Mapping[str, Callable[[], ArrayConfig]] = MappingProxyType(
    {"martin2013": martin2013, "perpendicular": perpendicular}
)
"""By name."""

SETS: Mapping[str, tuple[str, tuple[str, ...]]] = MappingProxyType(
    {
        "all": ("martin2013", ()),
        "4 BMA180": ("martin2013", ("BMA1", "BMA2", "BMA3", "BMA4")),
        "2 ADXL345": ("perpendicular", ("ADXL1", "ADXL2")),
    }
)
"""What is fused together: the array, and its sensors (none named: all). The angular rate of "all" is that of Gyro1,
Gyro2 and Gyro3, and its specific force that of all six accelerometers.
"""

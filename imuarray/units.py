"""Quantities, their units in data sheets and recordings, and the factors to SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, get_args

Quantity = Literal["specific_force", "angular_rate", "magnetic_field", "pressure", "temperature"]

QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)

INERTIAL: tuple[Quantity, ...] = ("specific_force", "angular_rate")
"""The quantities of accelerometers and gyroscopes."""

TRIADS: tuple[Quantity, ...] = (*INERTIAL, "magnetic_field")
"""Quantities that have three axes."""

UNIT_OF: Mapping[str, str] = MappingProxyType(
    {"specific_force": "g", "angular_rate": "dps", "magnetic_field": "gauss", "pressure": "Pa", "temperature": "degC"}
)
"""The unit of each quantity in data sheets, configurations and logs."""

STANDARD_GRAVITY = 9.80665
"""m/s2 in one g; 3rd CGPM (1901)."""

MAINS_HZ = (50.0, 60.0)
"""Nominal frequencies of the mains in the world's grids; IEC 60196."""

SI_PER_UNIT: Mapping[str, float] = MappingProxyType(
    {"g": STANDARD_GRAVITY, "dps": math.pi / 180, "gauss": 1e-4, "Pa": 1.0, "degC": 1.0}
)
"""Factor from a sensor's unit to SI (m/s2, rad/s, T, Pa); degrees Celsius are not converted."""

UNITS_OF: Mapping[Quantity, Mapping[str, float]] = MappingProxyType(
    {
        "specific_force": MappingProxyType(
            {
                "g": 1.0,
                "mg": 1e-3,
                "m/s2": 1 / STANDARD_GRAVITY,
                "mm/s2": 1e-3 / STANDARD_GRAVITY,
                "gal": 1e-2 / STANDARD_GRAVITY,
                "ft/s2": 0.3048 / STANDARD_GRAVITY,
            }
        ),
        "angular_rate": MappingProxyType(
            {
                "dps": 1.0,
                "deg/s": 1.0,
                "mdps": 1e-3,
                "rad/s": 180 / math.pi,
                "mrad/s": 0.18 / math.pi,
                "deg/h": 1 / 3600,
                "rpm": 6.0,
            }
        ),
        "magnetic_field": MappingProxyType(
            {"gauss": 1.0, "mgauss": 1e-3, "T": 1e4, "mT": 10.0, "uT": 1e-2, "nT": 1e-5}
        ),
    }
)
"""Every allowed unit of a triad in a foreign recording, with its factor to the unit of that quantity in a log. The unit
in a log is the first one of each quantity.
"""

_SPELLINGS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "specific_force": {
            "g": ("G", "gee"),
            "mg": ("mG", "milli-g", "millig"),
            "m/s2": (
                "m/s^2", "m/s\u00b2", "m/s**2", "m/s/s", "m/sec2", "m/sec^2", "mps2",
                "ms-2", "m.s-2", "m s-2", "m s^-2",
            ),
            "mm/s2": ("mm/s^2", "mm/s\u00b2", "mm/s/s"),
            "gal": ("Gal", "cm/s2", "cm/s^2", "cm/s\u00b2"),
            "ft/s2": ("ft/s^2", "ft/s\u00b2", "ft/s/s", "ft/sec^2", "fps2"),
        },
        "angular_rate": {
            "dps": ("deg/sec", "degree/s", "degrees/s", "degrees/sec", "deg s-1", "\u00b0/s", "\u00ba/s", "\u00b0/sec"),
            "mdps": ("mdeg/s", "m\u00b0/s"),
            "rad/s": ("rad/sec", "rads/s", "radps", "rad s-1", "rad s^-1", "rad.s-1"),
            "mrad/s": ("mrad/sec",),
            "deg/h": ("deg/hr", "deg/hour", "degree/h", "degrees/h", "degrees/hour", "\u00b0/h", "\u00b0/hr", "dph"),
            "rpm": ("RPM", "rev/min", "r/min", "1/min"),
        },
        "magnetic_field": {
            "gauss": ("Gauss", "G", "Gs"),
            "mgauss": ("mGauss", "mG", "milligauss"),
            "T": ("Tesla", "tesla"),
            "uT": ("\u00b5T", "\u03bcT", "ut", "microtesla"),
        },
    }
)  # fmt: skip


def standard_unit(unit: str, quantity: str) -> str:
    """Return the spelling in `UNITS_OF` of a unit of a quantity, or `unit` itself if it is not a spelling of one.

    >>> standard_unit("m/s^2", "specific_force"), standard_unit("G", "magnetic_field"), standard_unit("N", "pressure")
    ('m/s2', 'gauss', 'N')
    """
    spellings = _SPELLINGS.get(quantity, {})
    text = unit.strip()
    return next((known for known, others in spellings.items() if text in others), text)


SI_NAME: Mapping[str, str] = MappingProxyType(
    {"g": "m s-2", "dps": "rad s-1", "gauss": "T", "Pa": "Pa", "degC": "degC"}
)
"""The SI unit in the spelling of CF conventions."""

READABLE: Mapping[str, tuple[float, str]] = MappingProxyType({"g": (1e3, "mg"), "dps": (1.0, "dps")})
"""Factor from an inertial sensor's unit to the unit in which small values are shown, and the name of that unit."""

READABLE_SI: Mapping[str, tuple[float, str]] = MappingProxyType(
    {"specific_force": (1e3 / STANDARD_GRAVITY, "mg"), "angular_rate": (180 / math.pi, "dps")}
)
"""The same factors from SI, by quantity."""

"""Drive, log, calibrate and fuse an array of low-cost MEMS inertial sensors, and diagnose why a simulator differs from
it.

Words: an *array* is all sensors of one box; a *frame* is one pass over it; a *log* holds counts, the raw signed
register values; specific force (m/s2) and angular rate (rad/s) are given in the box frame.

The names below are loaded when first used. `calibrate_tumble`, `calibrate_noise`, `calibrate_thermal`,
`calibrate_turn_on`, `characterise`, `fuse`, `simulate` and `diagnose` do the same as the commands, in one call each
(`imuarray.analysis`); `fuse`, `simulate` and `characterise` are also packages that contain their parts.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imuarray.analysis import (
        calibrate_noise,
        calibrate_thermal,
        calibrate_tumble,
        calibrate_turn_on,
        characterise,
        fuse,
        simulate,
    )
    from imuarray.array import load_array
    from imuarray.bus import open_bus
    from imuarray.calibrate import load_calibration
    from imuarray.fuse.fused_result import load_fused
    from imuarray.gap.diagnose import diagnose
    from imuarray.log import open_log

__version__ = "0.1.0"

_PUBLIC = {
    "calibrate_noise": "imuarray.analysis",
    "calibrate_thermal": "imuarray.analysis",
    "calibrate_tumble": "imuarray.analysis",
    "calibrate_turn_on": "imuarray.analysis",
    "diagnose": "imuarray.gap.diagnose",
    "load_array": "imuarray.array",
    "load_calibration": "imuarray.calibrate",
    "load_fused": "imuarray.fuse.fused_result",
    "open_bus": "imuarray.bus",
    "open_log": "imuarray.log",
}

_CALLABLE_PACKAGES = ("characterise", "fuse", "simulate")

__all__ = [
    "__version__",
    "calibrate_noise",
    "calibrate_thermal",
    "calibrate_tumble",
    "calibrate_turn_on",
    "characterise",
    "diagnose",
    "fuse",
    "load_array",
    "load_calibration",
    "load_fused",
    "open_bus",
    "open_log",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that `import imuarray` alone is fast."""
    if name in _CALLABLE_PACKAGES:
        return import_module(f"imuarray.{name}")
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return list(__all__)

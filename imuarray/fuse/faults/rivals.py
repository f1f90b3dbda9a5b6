"""Which of several sensors that parity can't tell apart is the one: by what only a faulty sensor does by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from imuarray.fuse.faults.hypotheses import Suspect
from imuarray.fuse.faults.kinds import QUIET, Beside, beside
from imuarray.fuse.faults.normal import Normal
from imuarray.fuse.faults.parity import Spaces
from imuarray.fuse.faults.window import Look, Window, look

Flags = npt.NDArray[np.bool_]

Resets = Callable[[Beside, int], tuple[float, float] | None]
"""The range (and factor) that explains how a sensor (number) reads beside the others."""

_WILD = 6.0
"""A sensor whose changes from reading to reading have so many times their usual mean square is noisy, ..."""

_CALM = 2.0
"""... if those of all others have less than this: the box is at rest."""


def told_apart(suspect: Suspect, window: Window, seen: Look, normal: Normal, resets: Resets) -> Suspect | None:
    """The suspect, or one of its rivals, as a whole sensor, if it alone stands still, reads as if in another range of
    its chip, or is noisy while all others are as ever; None if that is true of none or of several.
    """
    views = {}
    for sensor in (suspect.axes[0] // 3, *suspect.rivals):
        members = np.arange(3 * sensor, 3 * sensor + 3)
        rest = seen.included.copy()
        rest[members] = False
        without = look(window, normal, seen.rows, rest, Spaces(seen.rows))
        view = None if without is None else beside(without, window, normal, members.tolist())
        if view is None:
            return None
        views[sensor] = view
    tests: tuple[Callable[[int], bool], ...] = (
        lambda sensor: views[sensor].stale or views[sensor].quiet < QUIET,
        lambda sensor: resets(views[sensor], sensor) is not None,
        lambda sensor: _wild(views[sensor].quiet, [views[other].quiet for other in views if other != sensor]),
    )
    for test in tests:
        found = [sensor for sensor in views if test(sensor)]
        if len(found) == 1:
            axes = tuple(range(3 * found[0], 3 * found[0] + 3))
            return replace(suspect, axes=axes, rivals=())
    return None


def _wild(own: float, others: list[float]) -> bool:
    """Noisy while the others are calm."""
    return own > _WILD and max(others) < _CALM

"""How far each axis has slowly departed from where it began: drift may go so far, a walk-off goes farther."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.fuse.faults.hypotheses import Suspect
from imuarray.fuse.faults.normal import Normal
from imuarray.fuse.faults.parity import Spaces
from imuarray.units import STANDARD_GRAVITY

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

DRIFT_SI: Mapping[str, float] = MappingProxyType(
    {"specific_force": 0.1 * STANDARD_GRAVITY, "angular_rate": np.radians(3.0)}
)
"""How far an axis may drift in a run: twice what the worst axis of the paper's Table 8 does over its 28 degC
(1.4 mg and 0.05 dps per degC)."""

_SETTLED = 3
_SIGMAS = 4.0
_CLEARLY = 0.7
"""Another sensor that departs by more than this share of the worst one's departure might be the one as well."""


class Baseline:
    """Where each axis began, and how far it is from there."""

    def __init__(self, rows: Floats, quantity: str) -> None:
        self._spaces = Spaces(rows)
        self._limit = DRIFT_SI[quantity]
        self._seen = np.zeros(len(rows))
        self._state: Floats | None = None
        self._covariance: Floats | None = None

    def departed(self, included: Flags, usual: Floats, normal: Normal) -> tuple[Suspect | None, float]:
        """Of the axes `included` (m,), whose mean regressors are `usual` (m, 5): the one that has walked off farthest,
        beyond what drift allows, and how far in SI; None if none has.

        To be asked at equal intervals: an axis is settled after `_SETTLED` of them.
        """
        self._settle(included, normal)
        begun = included & (self._seen >= _SETTLED)
        space = self._spaces(begun.astype(float))
        if space is None or self._state is None or self._covariance is None:
            return None, 0.0
        moved = np.where(begun, ((normal.state - self._state) * usual).sum(axis=1), 0.0)
        unknown = np.einsum("mi,mij,mj->m", usual, self._covariance, usual)
        deleted = space.deleted
        departure = deleted @ moved
        allowed = self._limit + _SIGMAS * np.sqrt(deleted**2 @ np.where(begun, unknown, 0.0))
        share = np.where(space.told, np.abs(departure) / allowed, 0.0)
        worst = int(share.argmax())
        if share[worst] < 1:
            return None, 0.0
        sensors = share.reshape(-1, 3).max(axis=1) > _CLEARLY * share[worst]
        sensors[worst // 3] = False
        gain = float((departure[worst] / allowed[worst] * _SIGMAS) ** 2)
        return Suspect((worst,), gain, "mean", tuple(np.flatnonzero(sensors).tolist())), float(departure[worst])

    def send_back(self, axis: int, normal: Normal) -> None:
        """Forgets what `normal` learnt of an axis since it began: its walk is no calibration."""
        if self._state is not None and self._covariance is not None:
            normal.state[axis], normal.covariance[axis] = self._state[axis], self._covariance[axis]

    def _settle(self, included: Flags, normal: Normal) -> None:
        """Notes the state of each axis when it has been in use for long enough."""
        self._seen += included
        if self._state is None or self._covariance is None:
            self._state, self._covariance = normal.state.copy(), normal.covariance.copy()
        now = included & (self._seen == _SETTLED)
        self._state[now], self._covariance[now] = normal.state[now], normal.covariance[now]

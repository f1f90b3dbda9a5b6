"""A fused log in memory: one specific force and one angular rate per frame with their covariances, events of sensors,
and errors if the truth is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from imuarray.arrays import Floats, Times
from imuarray.errors import FusionError, LogError
from imuarray.figures import time_series_figure
from imuarray.fuse.evaluation import Error
from imuarray.fuse.faults import FaultEvent
from imuarray.fuse.frames import ENTRIES, FusedBlock
from imuarray.fuse.fused_file import UNITS, FusedEvent, read_fused, read_fused_events, read_fused_head, write_fused
from imuarray.fuse.pipeline import FusionNotes
from imuarray.log.datasets import BOX_AXIS, dataset, table
from imuarray.units import READABLE_SI

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def load_fused(path: str | PathLike[str]) -> FusedResult:
    """Read a fused file, as `imuarray fuse -o`, `imuarray log --fuse` and `FusedResult.save` write it, also while it is
    being written. LogError for a missing, damaged or hostile file.

    The file contains neither the errors against the truth nor the notes of the technique.

    >>> fused = load_fused("fused.h5")
    >>> fused.technique, fused.specific_force.shape[1]
    ('optimal', 3)
    """
    head = read_fused_head(path)
    blocks = list(read_fused(path))
    if not blocks:
        raise LogError(f"{path}: no frame was fused yet")
    return FusedResult(
        FusedBlock.joined(blocks),
        head.epoch,
        head.technique,
        head.sensors,
        log=head.log,
        calibration=head.calibration,
        events=read_fused_events(path),
    )


@dataclass(frozen=True, repr=False)
class FusedResult:
    """The fused `frames` of a log by `technique`, with the `epoch` of their times.

    `sensors` are the names of the fused sensors, per quantity; `events` are failures and recoveries; `remarks` are
    sentences on the sensors and the calibration, `notes` the estimates of the technique on the sensors. `errors`, per
    quantity, are with respect to the log's truth or reference; empty without one. `log` and `calibration` are the paths
    of the inputs ("": data-sheet values).
    """

    frames: FusedBlock
    epoch: str
    technique: str
    sensors: Mapping[str, Sequence[str]]
    log: str = ""
    calibration: str = ""
    events: tuple[FaultEvent | FusedEvent, ...] = ()
    notes: FusionNotes = field(default_factory=FusionNotes)
    remarks: tuple[str, ...] = ()
    errors: Mapping[str, Error] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def time(self) -> Times:
        """Time (n,) of the frames in ns since the epoch."""
        return self.frames.time

    @property
    def specific_force(self) -> Floats:
        """Specific force (n, 3), m/s2, box frame; NaN where too few axes were valid. FusionError if none was fused."""
        return self._triad("specific_force")

    @property
    def angular_rate(self) -> Floats:
        """Angular rate (n, 3), rad/s, box frame; NaN where too few axes were valid. FusionError if none was fused."""
        return self._triad("angular_rate")

    def standard_error(self, quantity: str) -> Floats:
        """Return the standard error (n, 3) of the estimate along the box axes in SI; NaN if not known."""
        covariance = self.frames.covariances.get(quantity)
        return np.full_like(self._triad(quantity), np.nan) if covariance is None else np.sqrt(covariance[:, :3])

    def save(self, path: str | PathLike[str], *, force: bool = False) -> int:
        """Write a fused file, as `imuarray fuse -o` does, and return the number of frames. OutputExistsError,
        OutputError.
        """
        return write_fused(
            path,
            [self.frames],
            sensors=self.sensors,
            events=self.events,
            force=force,
            epoch=self.epoch,
            technique=self.technique,
            log=self.log,
            calibration=self.calibration,
        )

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` over time: triads, covariances, sensors used; MissingExtraError without xarray."""
        variables: dict[str, Any] = {}
        for quantity, triad in self.frames.triads.items():
            variables[quantity] = ("time", BOX_AXIS), triad, {"units": UNITS[quantity]}
            if (covariance := self.frames.covariances.get(quantity)) is not None:
                name = f"{quantity}_covariance"
                variables[name] = ("time", "entry"), covariance, {"units": UNITS[name]}
            if (used := self.frames.used.get(quantity)) is not None:
                about = {"units": "1", "long_name": "axes of each sensor in use: 1 x, 2 y, 4 z"}
                variables[f"{quantity}_used"] = ("time", f"{quantity}_sensor"), used, about
        attributes = {"technique": self.technique, "log": self.log, "calibration": self.calibration}
        labelled = dataset(self.time, self.epoch, variables, {**attributes, "epoch": self.epoch})
        labels = {"entry": ENTRIES} | {f"{quantity}_sensor": names for quantity, names in self.sensors.items()}
        coordinates = {name: list(values) for name, values in labels.items() if labelled.sizes.get(name) == len(values)}
        return labelled.assign_coords(coordinates)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` indexed by time, one column per number; MissingExtraError without pandas."""
        return table(self.to_xarray())

    def plot(self) -> Figure:
        """Plot both quantities over time in the box frame; MissingExtraError without matplotlib."""
        time_s, panels = self.time * 1e-9, {}
        for quantity, triad in self.frames.triads.items():
            factor, unit = READABLE_SI[quantity]
            panels[f"{quantity.replace('_', ' ')} ({unit})"] = time_s, factor * triad
        return time_series_figure(panels, title=f"fused by {self.technique}", height=2.4)

    def _triad(self, quantity: str) -> Floats:
        if quantity not in self.frames.triads:
            raise FusionError(f"no {quantity} was fused; the result has {', '.join(self.frames.triads) or 'nothing'}")
        return self.frames.triads[quantity]

    def __repr__(self) -> str:
        used = "; ".join(f"{quantity} of {', '.join(names)}" for quantity, names in self.sensors.items() if names)
        return f"<FusedResult by {self.technique}: {len(self.time)} frames, {used}>"

    def _repr_html_(self) -> str:
        """Return a table of mean, standard error and (if the truth is known) rms error by axis, for notebooks."""
        from imuarray.html_table import html_table, number

        rows = []
        for quantity, triad in self.frames.triads.items():
            factor, unit = READABLE_SI[quantity]
            is_finite = np.isfinite(triad).all(axis=1)
            mean = triad[is_finite].mean(axis=0) if is_finite.any() else np.full(3, np.nan)
            variance = self.standard_error(quantity)[is_finite] ** 2
            sem = np.sqrt(variance.mean(axis=0)) if is_finite.any() else np.full(3, np.nan)
            rms = self.errors[quantity].rms if quantity in self.errors else np.full(3, np.nan)
            for axis in range(3):
                cells = (number(factor * values[axis]) for values in (mean, sem, rms))
                rows.append((f"{quantity.replace('_', ' ')} {'XYZ'[axis]}", unit, *cells))
        heading = ("box axis", "unit", "mean", "estimated standard error, rms", "rms error")
        return html_table(f"{len(self.time)} frames fused by {self.technique}", heading, rows)

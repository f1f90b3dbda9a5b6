"""Fault isolation for one quantity: which sensors are excluded in each decision window, why, and when they are
readmitted.

The decisions use the hypotheses of `imuarray.fuse.faults.hypotheses` and two kinds of evidence from single sensors.
`Silence` counts the windows in which a sensor is missing or excluded by the log's flags, until they are reported.
`Stillness` detects triads whose readings do not change: stuck, or so coarse that their noise has vanished.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imuarray.arrays import Booleans, Floats, Times
from imuarray.calibrate.runs import Ranges
from imuarray.fuse.faults.exclusions import Exclusion, FaultReport, agreeing, needs
from imuarray.fuse.faults.fast_path import COMPILED, QUIETEST, DriftCheck, WindowSeries
from imuarray.fuse.faults.hypotheses import (
    AXIS_GAIN,
    QUIET,
    Baseline,
    FaultKind,
    Suspect,
    TriadComparison,
    compare_triad,
    disagreement,
    fault_kind,
    reset_to,
    separate_rivals,
    strongest,
    unresolved_motion,
)
from imuarray.fuse.faults.window import DecisionWindow, NormalModel, Spaces, WindowResiduals, window_residuals
from imuarray.fuse.frames import Axis
from imuarray.fuse.least_squares import noise_of, spans
from imuarray.units import SI_PER_UNIT, UNIT_OF

SILENT_S = 1.0


class Silence:
    """Counts windows without valid readings, by sensor."""

    def __init__(self, sensors: int, window_s: float) -> None:
        self._window_s = window_s
        self._patience = max(1, round(SILENT_S / window_s))
        self._absent = np.zeros(sensors, int)
        self._heard = np.zeros(sensors, int)
        self._reported = np.zeros(sensors, bool)

    @property
    def any(self) -> bool:
        """True if any sensor is reported as silent."""
        return bool(self._reported.any())

    def all_present(self, windows: int) -> None:
        """Count windows in which every sensor has enough readings, if none is silent."""
        self._absent[:] = 0
        self._heard += windows

    def __call__(self, present: Booleans, time_ns: int, report: FaultReport) -> None:
        """Process the next window, with the axes (m,) that have enough readings in it."""
        present_sensors = present.reshape(-1, 3).any(axis=1)
        self._absent = np.where(present_sensors, 0, self._absent + 1)
        self._heard = np.where(present_sensors, self._heard + 1, 0)
        for sensor in np.flatnonzero(~self._reported & (self._absent >= self._patience)).tolist():
            report.silent(sensor, self._patience * self._window_s, time_ns)
            self._reported[sensor] = True
        for sensor in np.flatnonzero(self._reported & (self._heard >= self._patience)).tolist():
            report.note_return(sensor, time_ns)
            self._reported[sensor] = False


_KNOWN_WINDOWS = 20
"""Fewest windows before a standstill can be detected."""

_RARE = 1e-3
"""Largest share of windows without changes in normal operation of a sensor whose standstill is detected: if the noise
is less than a count, windows without a change are normal; so are stale ones if a chip is slower than the frames."""

_SHORT = 3
"""Longest run of windows without changes in normal operation."""


class Stillness:
    """Sensors that stand still in two consecutive windows; their normal behaviour is estimated from earlier windows."""

    def __init__(self, sensors: int) -> None:
        self._quiet, self._stale = _Runs(sensors), _Runs(sensors)

    @property
    def standing(self) -> Booleans:
        """The sensors (s,) without a change in the last window."""
        return np.asarray((self._quiet.length > 0) | (self._stale.length > 0))

    def __call__(self, window: DecisionWindow, normal: NormalModel) -> Booleans:
        """Process a window and return (s,) the sensors that stood still in it and in the one before."""
        usual = np.minimum(normal.change, 2 * normal.variance)  # after a shake `change` is too large for a rest
        share = (window.changes / usual).reshape(-1, 3).mean(axis=1)
        whole: Booleans = np.asarray(window.valid.reshape(len(window.valid), -1, 3).all(axis=(0, 2)))
        stale: Booleans = np.zeros(len(share), bool)
        if window.stale is not None:
            stale = np.asarray(window.stale.reshape(len(window.valid), -1, 3).all(axis=(0, 2)))
        return self._quiet(whole & (share < QUIET), whole) | self._stale(whole & stale, whole)

    @property
    def any(self) -> bool:
        """True if any sensor stood still in the window before."""
        return self._quiet.any or self._stale.any

    def count_moving(self, windows: int) -> None:
        """Count windows in which no sensor stands still; nor did any in the window before."""
        self._quiet.count(windows)
        self._stale.count(windows)


class _Runs:
    """Runs of windows with an unusual property, by sensor, and the share of windows in which it is normal."""

    def __init__(self, sensors: int) -> None:
        self.length = np.zeros(sensors, int)
        self.any = False
        self._windows = np.zeros(sensors)
        self._by_itself = np.zeros(sensors)

    def count(self, windows: int) -> None:
        """Count windows in which no sensor has the property; nor did any in the window before."""
        self._windows += windows

    def __call__(self, shows: Booleans, judged: Booleans) -> Booleans:
        """Process a window and return (s,) the sensors that show the property in it and in the one before, if that is
        unusual for them.
        """
        usual = self._by_itself > _RARE * self._windows
        ended = ~shows & judged
        self._by_itself += np.where(ended & ((self.length <= _SHORT) | usual), self.length, 0)
        self.length = np.where(shows, self.length + 1, np.where(judged, 0, self.length))
        self.any = bool(self.length.any())
        self._windows += judged & ~shows
        return np.asarray(~usual & (self._windows >= _KNOWN_WINDOWS) & (self.length == 2))


_MOST = 4
"""Largest number of faults in one window."""

_DOUBTFUL_WINDOWS = 3
"""Number of windows with a fault after which it is reported as not isolated."""

_BASELINE_WINDOWS = 10
"""Interval of the tests for drift beyond its limit, in windows."""

_FORGOTTEN_WINDOWS = 50
"""Number of windows without a fault after which an ambiguous fault is reported again."""

_STUCK_GAIN = 100.0
"""Gain of a standstill: ten standard deviations, a lower limit for two windows without a change."""


class FaultIsolation:
    """Fault isolation of one quantity: the normal model, the exclusions, and the events."""

    def __init__(
        self, axes: Sequence[Axis], rows: Floats, quantity: str, window: int, period_s: float, ranges: Ranges
    ) -> None:
        self._axes, self._rows, self._ranges = axes, rows, ranges
        self._unit_si = SI_PER_UNIT[UNIT_OF[quantity]]
        self._window_s = window * period_s
        self._normal = NormalModel(noise_of(axes), quantity, window, period_s)
        self._baseline = Baseline(rows, quantity)
        self._spaces = Spaces(rows)
        names = [axis.sensor for axis in axes[::3]]
        self._still = Stillness(len(names))
        self._silence = Silence(len(names), self._window_s)
        self.report = FaultReport(names, quantity)
        self._out: list[Exclusion] = []
        self._offences = np.zeros(len(axes), int)
        self._doubts: dict[int, tuple[int, int]] = {}
        self._blind = False
        self._count = 0

    @property
    def disagreement_s(self) -> float:
        """Total time in which all sensors disagree, so that none is suspected."""
        return self.report.disagreements * self._window_s

    @property
    def out(self) -> Booleans:
        """The excluded axes (m,)."""
        mask = np.zeros(len(self._axes), bool)
        for exclusion in self._out:
            mask[list(exclusion.axes)] = True
        return mask

    def stretch(self, time: Times, values: Floats) -> WindowSeries | None:
        """Return the fast path for windows, time (k, n) ns and values (k, n, m), in which every reading is present and
        none is stale; None if it does not apply now, and without compiled code.
        """
        out = self.out
        if not COMPILED or not self._normal.settled:
            return None
        white = self._spaces(np.where(out, 0.0, 1 / self._normal.variance))
        if white is None:
            return None
        observable = white.observable[~out]
        no_redundancy = not observable.any() and (self._blind or not self._out)  # reported once, by the full path
        if not (observable.all() or no_redundancy):
            return None
        return WindowSeries(time, values, out, white, self._rows, self._normal.variance)

    def advance(self, stretch: WindowSeries, windows: range) -> int:
        """Process the next windows, which have these numbers in `stretch`, up to the first unusual one, and return
        their number: 0 if the first is unusual.
        """
        if self._silence.any or self._still.any or not all(exclusion.named for exclusion in self._out):
            return 0
        before_baseline = _BASELINE_WINDOWS - 1 - self._count % _BASELINE_WINDOWS
        limits = self._baseline.limits(stretch.included)
        if limits is None:  # an axis may settle, which is decided window by window
            windows = windows[:before_baseline]
        check = None if limits is None else DriftCheck(limits, windows.start + before_baseline, _BASELINE_WINDOWS)
        waiting = [exclusion.axes for exclusion in self._out]
        passed = stretch.advance(windows, self._normal, waiting, check) if windows else 0
        if passed:
            checks = (self._count + passed) // _BASELINE_WINDOWS - self._count // _BASELINE_WINDOWS
            self._baseline.stayed(stretch.included, checks)
            self._count += passed
            self._silence.all_present(passed)
            self._still.count_moving(passed)
            for exclusion in self._out:
                exclusion.agreed = 0
        return passed

    def __call__(self, window: DecisionWindow, masks: Sequence[Booleans]) -> None:
        """Process the next window; set the excluded axes to True in `masks` (m,): the last mask is that of this window,
        the one before it that of the window before.
        """
        if not self._normal.begun:
            self._normal.begin(window.changes)
        self._count += 1
        before, time_ns = self.out, int(window.time[0])
        self._silence(window.present, time_ns, self.report)
        self._normal.age(~before)
        for sensor in np.flatnonzero(self._still(window, self._normal)).tolist():
            self._exclude(Suspect(_members(sensor), _STUCK_GAIN, "energy"), time_ns)
        self._decide(window, masks, before)

    def _decide(self, window: DecisionWindow, masks: Sequence[Booleans], before: Booleans) -> None:
        """Exclude sensors in addition to those `before`, and readmit others."""
        time_ns = int(window.time[0])
        waiting = [e for e in self._out if not e.named and before[list(e.axes)].any()]
        residuals, doubted = self._search(window, time_ns)
        if residuals is not None:
            for exclusion in waiting:
                if any(exclusion is each for each in self._out):  # else it has become part of another one
                    self._name(exclusion, residuals, window)
            self._learn(residuals, window, doubted)
        new = self.out & ~before
        for mask in masks:
            mask |= new
        if residuals is not None and self._out:
            self._readmit(residuals, window.present, time_ns)
        masks[-1][self.out] = True

    def close(self) -> None:
        """Report the exclusions of the last window."""
        for exclusion in self._out:
            if not exclusion.named:
                self.report.isolated(exclusion, exclusion.first)

    def _search(self, window: DecisionWindow, time_ns: int) -> tuple[WindowResiduals | None, Booleans]:
        """Exclude one suspect after the other until the other axes agree. Return the residuals of the window by the
        axes in use (None: these are too few), and the axes (m,) of sensors with a fault that is not isolated.
        """
        none = np.zeros(len(self._axes), bool)
        for _ in range(_MOST):
            residuals = self._residuals(window)
            if residuals is None:
                return None, none
            suspect, drifted = strongest(residuals, self._normal), 0.0
            shared = 0.0
            if suspect is not None:
                shared = max(disagreement(residuals, self._normal), unresolved_motion(window, residuals))
            if shared > 0:
                suspect = strongest(residuals, self._normal, shared)
                if suspect is None:
                    self.report.count_disagreement()
                    return residuals, ~none
            if suspect is None and self._count % _BASELINE_WINDOWS == 0:
                suspect, drifted = self._baseline.departed(residuals.included, residuals.usual, self._normal)
            if suspect is None:
                return residuals, none
            if suspect.rivals:
                suspect = separate_rivals(suspect, window, residuals, self._normal, self._reset) or suspect
            if suspect.rivals or not self._exclude(suspect, time_ns, drifted, window):
                return residuals, self._doubt(suspect, residuals, window, drifted)
        return self._residuals(window), none

    def _residuals(self, window: DecisionWindow) -> WindowResiduals | None:
        """Return the residuals of the window by the axes in use; report once if these can't check each other."""
        residuals = self._residuals_by(~self.out, window)
        if (
            self._out
            and self._out[-1].named
            and not self._blind
            and (residuals is None or not residuals.white.observable[residuals.included].any())
        ):
            self._blind = True
            self.report.blind(self._out[-1].sensor, int(window.time[0]))
        return residuals

    def _residuals_by(self, included: Booleans, window: DecisionWindow) -> WindowResiduals | None:
        """Return the residuals of the window by the axes `included`."""
        return window_residuals(window, self._normal, self._rows, window.present & included, self._spaces)

    def _exclude(
        self, suspect: Suspect, time_ns: int, drifted: float = 0.0, window: DecisionWindow | None = None
    ) -> bool:
        """Exclude axes; False if the others would not determine a triad."""
        out = self.out
        axes = [axis for axis in suspect.axes if not out[axis]]
        out[axes] = True
        if not axes or not spans(self._rows[~out].T @ self._rows[~out]):
            return False
        self._offences[axes] += 1
        wait = needs(int(self._offences[axes].max()), self._window_s)
        exclusion = Exclusion(axes[0] // 3, tuple(axes), time_ns, suspect.gain, wait, drifted_si=drifted)
        self._out.append(exclusion)
        for axis in axes if drifted else ():
            self._baseline.reset(axis, self._normal)
        residuals = None if window is None else self._residuals_by(~out, window)
        if window is not None and residuals is not None:
            exclusion.first = self._kind(exclusion.sensor, exclusion.axes, drifted, residuals, window)
        return True

    def _kind(
        self, sensor: int, axes: Sequence[int], drifted: float, residuals: WindowResiduals, window: DecisionWindow
    ) -> FaultKind | None:
        """Return the kind of fault that a window shows; None if it shows none."""
        if drifted:
            return FaultKind("random_walk", drifted)
        view = compare_triad(residuals, window, self._normal, _members(sensor))
        return None if view is None else fault_kind(view, [axis % 3 for axis in axes], self._reset(view, sensor))

    def _reset(self, view: TriadComparison, sensor: int) -> tuple[float, float] | None:
        """Return the range that explains the comparison of a sensor with the others."""
        return reset_to(view, self._axes[3 * sensor], self._ranges, self._unit_si)

    def _name(self, exclusion: Exclusion, residuals: WindowResiduals, window: DecisionWindow) -> None:
        """Determine and report the kind of a fault one window after its detection, when it fills a window. A sensor
        that is stuck or measures in another range is excluded as a whole.
        """
        agrees = agreeing(residuals, self._normal, window.present)[list(exclusion.axes)].all()
        is_over = agrees and not self._still.standing[exclusion.sensor]
        now = None if is_over else self._kind(exclusion.sensor, exclusion.axes, exclusion.drifted_si, residuals, window)
        exclusion.kind = now or exclusion.first
        if exclusion.kind is not None and exclusion.kind.whole:
            out = self.out
            out[list(exclusion.axes)] = False
            out[list(_members(exclusion.sensor))] = True
            if spans(self._rows[~out].T @ self._rows[~out]):
                self._out = [each for each in self._out if each.sensor != exclusion.sensor or each is exclusion]
                exclusion.axes = _members(exclusion.sensor)
        self.report.isolated(exclusion, exclusion.kind)

    def _doubt(self, suspect: Suspect, residuals: WindowResiduals, window: DecisionWindow, drifted: float) -> Booleans:
        """Count the windows with a fault that is not isolated, and report it if it lasts. Return the axes (m,) of the
        sensors that may have it.
        """
        sensor = suspect.axes[0] // 3
        candidates = sorted({sensor, *suspect.rivals})
        count, last = self._doubts.get(candidates[0], (0, -_FORGOTTEN_WINDOWS))
        count = count + 1 if self._count - last < _FORGOTTEN_WINDOWS else 1
        self._doubts[candidates[0]] = (count, self._count)
        if count == _DOUBTFUL_WINDOWS:
            others = ~self.out
            others[list(suspect.axes)] = False
            by_others = self._residuals_by(others, window) or residuals
            kind = self._kind(sensor, suspect.axes, drifted, by_others, window)
            self.report.doubted(suspect.axes, suspect.rivals, int(window.time[0]), kind, suspect.gain)
        doubted = np.zeros(len(self._axes), bool)
        doubted.reshape(-1, 3)[candidates] = True
        return doubted

    def _learn(self, residuals: WindowResiduals, window: DecisionWindow, doubted: Booleans) -> None:
        """Update the normal model from the readings of axes without a fault."""
        gains = residuals.slow.axis_gains(residuals.means)
        sound = residuals.included & ~doubted & ~self.out & (gains < AXIS_GAIN / 2)
        self._normal.learn(residuals.regressors, residuals.residual, sound)
        whole = sound & (residuals.counts == len(residuals.triad)) & residuals.white.observable
        whole &= window.changes > QUIETEST * self._normal.change
        share = residuals.white.matrix.diagonal() * self._normal.variance
        self._normal.learn_noise(residuals.residual, residuals.means, share, residuals.counts, whole)

    def _readmit(self, residuals: WindowResiduals, present: Booleans, time_ns: int) -> None:
        """Readmit axes that have agreed for long enough."""
        agrees = agreeing(residuals, self._normal, present) & ~np.repeat(self._still.standing, 3)
        for exclusion in list(self._out):
            if exclusion.update(agrees):
                self._out.remove(exclusion)
                self._blind = False
                self.report.readmitted(exclusion, time_ns)


def _members(sensor: int) -> tuple[int, int, int]:
    """Return the axes of a sensor."""
    return 3 * sensor, 3 * sensor + 1, 3 * sensor + 2

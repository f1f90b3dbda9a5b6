"""Readings that a program has processed: filtered, averaged, resampled or freed of gravity. A simulated chip does none
of this, and noise after it is not that of the sensor.

The attribute `resolution` of a log's sensor states whether imported values are on a grid of codes. Resampling is
searched for only in values that are not. A chip may filter its own codes: a filter of codes is reported only if their
spectrum falls more steeply than that of a chip's filter.

Rows that a program interpolated between readings (`find_interpolation`) are on the straight line between their
neighbours, while the readings scatter by many counts. Phones and recorders resample in this way; the noise of such rows
is not that of the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.log import SensorLog
from imuarray.log.format import ASSUMED, RESOLUTION, SATURATED
from imuarray.series import true_runs

FEWEST_ROWS = 2000
_MOST_ROWS = 1 << 16
_WINDOW_ROWS = 256
FEWEST_WINDOWS = 6
_AT_REST = 2.5
"""Factor over the scatter of the quietest window up to which windows are evaluated for noise."""

_REST_WINDOWS = 3
"""Number of consecutive windows at rest in which resampling is detected more reliably than in all rows, which motion
disturbs.
"""

_LEAST_MOTION = {"g": 0.03, "dps": 1.0, "gauss": 0.02}
"""Scatter of a window, by unit, above which the box moves. The spectrum of motion falls like that of a filter."""

DEPLETED = 0.1
"""Density of the noise in the highest fifth of the band, relative to that at low frequencies, below which a filter has
removed it. A first-order filter with a cutoff of a quarter of the rate leaves more.
"""

CHIP_ORDER = 3
"""Highest order of the filters that chips have after their converters (ICM-42688-P: first to third)."""

_BEYOND_ORDER = 0.5
"""Factor on the density that a filter of `CHIP_ORDER` leaves one octave above its cutoff. A filter that leaves less is
steeper.
"""

_LOW, _HIGH = (0.03, 0.15), (0.8, 1.0)
"""Frequency bands that are compared, relative to half the rate."""

BEAT = 25.0
"""Least power of a line in the squared second differences, in medians of their periodogram and on all axes at once,
that shows resampling: the noise then varies with the phase between two rates. One axis exceeds it by chance in one of
3e7 bins.
"""

_LINE = 20.0
"""A fifth of the power, in medians of the bins near it, from which on a line of the readings themselves explains a line
at twice its frequency in the squared second differences.
"""

HELD = 0.15
"""Share of repeated values on each axis above which repetition is not due to chance, in noise of many counts."""

_BEYOND = 2.5
"""Multiple of the share expected by chance above which repeated values are not due to chance."""

NO_GRAVITY = 0.3
"""Length of specific force at rest in g below which gravity has been removed."""


def find_processing(sensor: SensorLog) -> list[str]:
    """Return the processing of a triad's readings by a program, as predicates; [] if none is detected. Reads at most
    `_MOST_ROWS` rows, and all of them once for interpolation.
    """
    if not sensor.is_triad or len(sensor) < FEWEST_ROWS:
        return []
    predicates = [find_missing_gravity(sensor), *find_filters(sensor)]
    if find_interpolation(sensor) is not None:
        predicates.append("is interpolated by a program")
    return [text for text in predicates if text]


def find_missing_gravity(sensor: SensorLog) -> str:
    """Return the predicate of an accelerometer without gravity; "" of one with it, or of unknown sensitivity."""
    if sensor.quantity != "specific_force" or sensor.unit != "g" or len(sensor) < FEWEST_ROWS or not sensor.sensitivity:
        return ""
    values, _, _ = _middle_rows(sensor)
    count = len(values) // _WINDOW_ROWS
    means = values[: count * _WINDOW_ROWS].reshape(count, _WINDOW_ROWS, 3).mean(axis=1)
    length = float(np.median(np.linalg.norm(means, axis=1))) / sensor.sensitivity
    return f"has no gravity ({length:.3g} g at rest): a program has subtracted it" if length < NO_GRAVITY else ""


def find_filters(sensor: SensorLog) -> Iterator[str]:
    """Yield the filters of a program that are detected in the readings of a triad at rest, as predicates."""
    if not sensor.is_triad or len(sensor) < FEWEST_ROWS:
        return
    values, clipped, rate_hz = _middle_rows(sensor)
    most = _LEAST_MOTION.get(sensor.unit, 0.0) * sensor.sensitivity
    windows, rest = _windows(values, most, clipped), _longest_rest(values, most)
    is_seen = len(windows) >= FEWEST_WINDOWS
    if is_seen and (share := _share_of_held_axes(windows)):
        yield (
            f"repeats single axes ({100 * share:.0f} % of their values): a program made them by a running median or a"
            " dead band"
        )
    if not rate_hz:
        return
    low_pass = _low_pass(windows, rate_hz) if is_seen and not sensor.bandwidth_hz else None
    if low_pass is not None and low_pass.is_steep:
        yield (
            f"is low-passed to about {low_pass.cutoff_hz:.2g} Hz, by a program: its spectrum falls more steeply than"
            " with the filter of a chip"
        )
        return
    if sensor.attributes.get(RESOLUTION) != ASSUMED:
        return
    if beat_hz := _beat_hz(values if len(rest) < _REST_WINDOWS * _WINDOW_ROWS else rest, rate_hz):
        rates = f"about {rate_hz - beat_hz:.4g} or {rate_hz + beat_hz:.4g}"
        yield (
            f"is resampled by a program, from {rates} readings a second: its noise comes and goes {beat_hz:.3g} times a"
            " second"
        )
    elif low_pass is not None:
        yield (
            f"is low-passed to about {low_pass.cutoff_hz:.2g} Hz, by a program or by its chip (if by the chip, state"
            " bandwidth_hz in the map)"
        )


def _middle_rows(sensor: SensorLog) -> tuple[Floats, Booleans, float]:
    """Return the counts (n, 3) of the middle of a recording, which rows (n,) are flagged as saturated (their codes
    repeat), and the rate.
    """
    count = min(len(sensor), _MOST_ROWS)
    first = (len(sensor) - count) // 2
    rows = slice(first, first + count)
    seconds = (int(sensor.time[rows.stop - 1]) - int(sensor.time[first])) * 1e-9
    clipped = np.asarray((np.asarray(sensor.status[rows]) & SATURATED) != 0)
    return np.asarray(sensor.counts[rows], float), clipped, (count - 1) / seconds if seconds > 0 else 0.0


def _share_of_held_axes(windows: Floats) -> float:
    """Return the share of values that repeat the one before on single axes, beyond chance; 0 if all axes repeat
    together, as they do when a reading is read twice.
    """
    same = np.diff(windows, axis=1) == 0
    shares = same.mean(axis=(0, 1))
    steps = np.diff(windows, axis=1)
    codes = np.array([_usual_code(axis) for axis in steps.reshape(-1, 3).T])
    together = float(same.all(axis=2).mean())
    by_chance = 0.4 * codes / np.maximum(steps.std(axis=1).mean(axis=0), 1e-9)  # the density of normal steps at 0
    apart = float(np.prod(shares))
    are_together = together > min(2 * apart, (apart + float(shares.min())) / 2)
    if (shares < HELD).any() or (shares < _BEYOND * by_chance).any() or are_together:
        return 0.0
    return float(shares.mean())


def _usual_code(steps: Floats) -> float:
    """Return the distance of neighbouring codes of an axis in counts, from its changes (n,)."""
    changes = np.abs(steps[steps != 0])
    return float(np.quantile(changes, _LEAST_CHANGES)) if len(changes) else 1.0


_LEAST_CHANGES = 0.02
"""Share of the smallest changes of an axis, which are those by one code."""


def _windows(values: Floats, most: float, clipped: Booleans) -> Floats:
    """Return the windows at rest (w, rows, 3), which scatter by less than `most`, without `clipped` rows (n,)."""
    windows, is_still = _still_windows(values, most)
    is_clipped = clipped[: len(windows) * _WINDOW_ROWS].reshape(len(windows), _WINDOW_ROWS).any(axis=1)
    return np.asarray(windows[is_still & ~is_clipped])


def _longest_rest(values: Floats, most: float) -> Floats:
    """Return the rows (n, 3) of the longest run of windows at rest."""
    _, is_still = _still_windows(values, most)
    begins, ends = true_runs(is_still)
    if not len(begins):
        return values[:0]
    longest = int(np.argmax(ends - begins))
    return values[begins[longest] * _WINDOW_ROWS : ends[longest] * _WINDOW_ROWS]


def _still_windows(values: Floats, most: float) -> tuple[Floats, Booleans]:
    count = len(values) // _WINDOW_ROWS
    windows = values[: count * _WINDOW_ROWS].reshape(count, _WINDOW_ROWS, 3)
    spread = windows.std(axis=1).max(axis=1)
    return windows, (spread <= _AT_REST * np.quantile(spread, 0.1)) & (spread < most)


def _densities(windows: Floats) -> Floats:
    """Return the mean periodogram (f, 3) of windows without their slopes."""
    rows = np.arange(windows.shape[1]) - (windows.shape[1] - 1) / 2
    slopes = np.einsum("wra,r->wa", windows, rows) / float(rows @ rows)
    level = windows - windows.mean(axis=1, keepdims=True) - slopes[:, None, :] * rows[None, :, None]
    shape = np.hanning(windows.shape[1])[None, :, None]
    return np.asarray((np.abs(np.fft.rfft(level * shape, axis=1)) ** 2).mean(axis=0))


class _LowPass(NamedTuple):
    """A low-pass: the frequency above which noise is missing. `is_steep`: an octave above it, less remains than a
    chip's filter leaves.
    """

    cutoff_hz: float
    is_steep: bool


def _low_pass(windows: Floats, rate_hz: float) -> _LowPass | None:
    """Return the low-pass filter that is detected in the noise of the quiet windows; None without one."""
    density = np.median(_densities(windows), axis=1)
    place = np.linspace(0, 1, len(density))
    low, high = (float(np.median(density[(place >= begin) & (place <= end)])) for begin, end in (_LOW, _HIGH))
    if not high < DEPLETED * low:
        return None
    in_stopband = np.flatnonzero((density < low / 2) & (place > _LOW[0]))
    if not len(in_stopband):
        return None
    cutoff = float(place[in_stopband[0]])
    near = density[(place >= 1.9 * cutoff) & (place <= 2.1 * cutoff)]
    is_steep = bool(len(near)) and cutoff < _OCTAVE_BELOW_END and float(near.mean()) < low * _octave_above(cutoff)
    return _LowPass(cutoff * rate_hz / 2, is_steep)


_OCTAVE_BELOW_END = 0.42
"""Highest cutoff, relative to half the rate, for which one octave above it lies in the band."""


def _octave_above(cutoff: float) -> float:
    """Return the density an octave above a cutoff (relative to half the rate) below which a filter has a higher order
    than `CHIP_ORDER`: that of a Butterworth filter by the bilinear transform, with frequencies tan(pi f / rate).
    """
    ratio = math.tan(math.pi * cutoff) / math.tan(math.pi * cutoff / 2)
    return _BEYOND_ORDER / (1 + ratio ** (2 * CHIP_ORDER))


def _beat_hz(values: Floats, rate_hz: float) -> float:
    """Return the frequency at which the noise level of all axes varies, as it does in readings that were interpolated
    from another rate; 0 if it does not vary.
    """
    bends = np.diff(values, n=2, axis=0)
    scale = np.abs(bends).mean(axis=0)
    if (scale == 0).any():
        return 0.0
    size = np.minimum((bends / scale) ** 2, 25.0)  # limits the weight of a knock
    power = np.abs(np.fft.rfft((size - size.mean(axis=0)) * np.hanning(len(size))[:, None], axis=0)) ** 2
    power /= np.median(power, axis=0)
    lowest = max(8, len(power) // 500)
    at = int(power[lowest:].min(axis=1).argmax()) + lowest
    if float(power[at].min()) < BEAT:
        return 0.0
    lines = np.abs(np.fft.rfft((values - values.mean(axis=0)) * np.hanning(len(values))[:, None], axis=0)) ** 2
    for half in (at / 2, len(power) - 1 - at / 2):
        place = round(half / len(power) * len(lines))
        near = lines[max(place - 100, 0) : place + 100]
        if len(near) and (near.max(axis=0) > _LINE * np.median(near, axis=0) * 5).all():
            return 0.0
    return float(at / (len(power) - 1) * rate_hz / 2)


ROUNDED = 2
"""Largest second difference of three rounded values on a straight line, in counts."""

SCATTER = 6.0
"""Minimum second difference (median of the rows that are off the line, of the axis with the largest one) in counts.
With this noise a twentieth of the readings is on a line by chance, on three axes at once.
"""

LEAST_SHARE = 0.3
"""Least share of rows on a line; with two rows per reading it is a half."""

_FEWEST_BENDS = 200


@dataclass(frozen=True)
class Interpolation:
    """Interpolated rows: the `share` of the rows on the line between their neighbours, and the readings per second."""

    share: float
    rate_hz: float

    @property
    def sentence(self) -> str:
        """The interpolation as a sentence."""
        return (
            f"{100 * self.share:.0f} % of its rows are on the line between their neighbours: a program interpolated"
            f" them from about {self.rate_hz:.3g} readings per second, and their noise is not that of the sensor"
        )


def find_interpolation(sensor: SensorLog) -> Interpolation | None:
    """Return how a triad's rows were interpolated; None if they were not. Reads the rows once."""
    rows = len(sensor)
    if rows < _FEWEST_BENDS or not sensor.is_triad:
        return None
    straight = compared = 0
    scatter = []
    for block in sensor.blocks():
        counts = np.asarray(sensor.counts[max(block.start - 2, 0) : block.stop])
        if len(counts) < 3:
            continue
        steps = np.diff(counts.T.astype(np.int64, order="C"))  # contiguous axes, along which numpy is faster
        bends = np.abs(np.diff(steps)).max(axis=0)
        off_line = bends > ROUNDED
        size = np.abs(steps).max(axis=0)
        is_coarse = np.maximum(size[1:], size[:-1]) <= ROUNDED  # on a line because of the rounding
        straight += len(bends) - int(np.count_nonzero(off_line | is_coarse))
        compared += len(bends)
        if off_line.any():
            scatter.append(float(np.median(bends[off_line])))
    if not scatter or not compared:
        return None
    share = straight / compared
    if share < LEAST_SHARE or float(np.median(scatter)) < SCATTER:
        return None
    seconds = (int(sensor.time[rows - 1]) - int(sensor.time[0])) * 1e-9
    return Interpolation(share, (1 - share) * (rows - 1) / seconds)

"""Spectral lines of the noise of a sensor at rest.

A steady line is detected in the mean spectrum of all stretches, where it is most significant. A line with a wandering
frequency (for example an interference between two clocks that warm up independently) is smeared there. It is therefore
detected in windows, and a line in one window continues the line at a nearby frequency in the window before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.model import NoiseLine
from imuarray.calibrate.pose_readings import SEGMENT_ROWS, ReadingInterval, Stretches, readings, runs_of
from imuarray.characterise.lines import SpectralLine, find_lines
from imuarray.characterise.spectrum import SEGMENT, Spectrum, Welch

MOST_LINES = 8
"""Largest number of lines per axis; the strongest are kept."""

_AVERAGED = 16
"""Number of segments that a spectrum averages, if the stretches are long enough."""

_WINDOW_ROWS = 1024
_WINDOWS = 12
_WINDOW_SEGMENTS = 4
"""Shortest window in rows, largest number of windows, and number of spectrum segments in a long window."""

_FEWEST_WINDOWS = 4
_LEAST_SHARE = 0.25
"""Least share of all rows in which a wandering line is present, in addition to the least number of windows."""

_NEAR = 3.0
"""Largest change of a line's frequency from one window to the next, in bins."""


@dataclass
class _Track:
    """A line over successive windows: its frequencies, the sum of squared amplitudes times rows, and the rows in which
    it is present.
    """

    frequencies_hz: list[float] = field(default_factory=list)
    squares: float = 0.0
    rows: int = 0

    def add(self, line: SpectralLine, rows: int) -> None:
        """Add the line as measured in the next window."""
        self.frequencies_hz.append(line.frequency_hz)
        self.squares += line.amplitude**2 * rows
        self.rows += rows


def noise_lines(
    stretches: Stretches, clock: ReadingInterval, rms_lsb: Floats, false_alarm: float
) -> tuple[NoiseLine, ...]:
    """Return the lines of every axis of one sensor at rest, strongest first, from the spectrum of all `stretches` and
    those of windows; none if no stretch is long enough. The share of a line is the variance of its sine over
    ``rms_lsb^2``.

    `false_alarm` is the probability that an axis without lines shows one.
    """
    whole = _whole_spectrum(stretches, clock)
    if whole is None:
        return ()
    tracks = _tracks(_windows(stretches), clock, false_alarm)
    results: list[NoiseLine] = []
    for index, rms in enumerate(rms_lsb):
        steady = [_steady(index, line, rms) for line in find_lines(whole, index, false_alarm).lines]
        wandering = [
            line
            for line in (_wandering(index, track, rows, rms) for track, rows in tracks[index])
            if (line.range_hz is not None and float(np.ptp(line.range_hz)) > whole.resolution_hz)
        ]
        steady = [line for line in steady if not any(_covers(other, line, whole.resolution_hz) for other in wandering)]
        results += sorted([*steady, *wandering], key=lambda line: -line.share)[:MOST_LINES]
    return tuple(results)


def _whole_spectrum(stretches: Stretches, clock: ReadingInterval) -> Spectrum | None:
    """Return the spectrum of all stretches; None if none is long enough."""
    lengths = [rows.stop - rows.start for _, rows in stretches]
    longest = min(max(lengths), max(SEGMENT_ROWS, sum(lengths) // _AVERAGED), SEGMENT)
    if clock.rate_hz <= 0 or longest < SEGMENT_ROWS:
        return None
    return _spectrum(stretches, clock, _power_of_two(longest))


def _power_of_two(rows: float) -> int:
    return int(2 ** np.floor(np.log2(rows)))


def _spectrum(stretches: Stretches, clock: ReadingInterval, segment_rows: int) -> Spectrum:
    """Return the spectrum of the valid readings of the stretches."""
    welch = Welch(clock.rate_hz, segment_rows, columns=3)
    for sensor, rows in stretches:
        for part in readings(sensor, rows, clock.limit_ns):
            for is_first, run in runs_of(part):
                if is_first:
                    welch.end_run()
                welch.update(run)
        welch.end_run()
    return welch.result()


def _windows(stretches: Stretches) -> Stretches:
    """Divide the stretches into windows; of many windows, select some at regular intervals."""
    width = max(_WINDOW_ROWS, -(-sum(rows.stop - rows.start for _, rows in stretches) // _WINDOWS))
    cut = []
    for sensor, rows in stretches:
        length = rows.stop - rows.start
        if length >= SEGMENT_ROWS:
            edges = np.linspace(rows.start, rows.stop, max(1, length // width) + 1).astype(int).tolist()
            cut += [(sensor, slice(first, last)) for first, last in pairwise(edges)]
    indices = np.unique(np.linspace(0, len(cut) - 1, min(_WINDOWS, len(cut))).round().astype(int))
    return [cut[index] for index in indices.tolist()]


def _tracks(windows: Stretches, clock: ReadingInterval, false_alarm: float) -> Sequence[Sequence[tuple[_Track, int]]]:
    """Return per axis every line that is present in enough windows, and the number of rows in all windows."""
    if len(windows) < _FEWEST_WINDOWS:
        return ((), (), ())
    tracks: list[list[_Track]] = [[], [], []]
    total = 0
    for sensor, window in windows:
        rows = window.stop - window.start
        segment = min(max(_power_of_two(rows / _WINDOW_SEGMENTS), SEGMENT_ROWS), _WINDOW_ROWS)
        spectrum = _spectrum([(sensor, window)], clock, segment)
        total += rows
        for index in range(3):
            for line in find_lines(spectrum, index, false_alarm).lines:
                _find_track(tracks[index], line, _NEAR * spectrum.resolution_hz).add(line, rows)
    return [
        [
            (track, total)
            for track in axis
            if len(track.frequencies_hz) >= _FEWEST_WINDOWS and track.rows > _LEAST_SHARE * total
        ]
        for axis in tracks
    ]


def _find_track(tracks: list[_Track], line: SpectralLine, near_hz: float) -> _Track:
    """Return the track that the line continues, or a new one."""
    close = [track for track in tracks if abs(track.frequencies_hz[-1] - line.frequency_hz) <= near_hz]
    if close:
        return min(close, key=lambda track: abs(track.frequencies_hz[-1] - line.frequency_hz))
    tracks.append(_Track())
    return tracks[-1]


def _share(square: float, rms: float) -> float:
    return min(1.0, square / 2 / rms**2)


def _steady(index: int, line: SpectralLine, rms: float) -> NoiseLine:
    return NoiseLine(
        "xyz"[index],
        line.frequency_hz,
        line.amplitude,
        _share(line.amplitude**2, rms),
        line.frequency_error_hz,
        line.amplitude_error,
    )


def _wandering(index: int, track: _Track, rows: int, rms: float) -> NoiseLine:
    """Return a wandering line; its amplitude is the rms over all rows, including those without it."""
    square = track.squares / rows
    low, high = min(track.frequencies_hz), max(track.frequencies_hz)
    middle = float(np.mean(track.frequencies_hz))
    return NoiseLine("xyz"[index], middle, float(np.sqrt(square)), _share(square, rms), range_hz=np.array([low, high]))


def _covers(wandering: NoiseLine, line: NoiseLine, resolution_hz: float) -> bool:
    if wandering.range_hz is None:
        return False
    low, high = wandering.range_hz
    return bool(low - 2 * resolution_hz <= line.frequency_hz <= high + 2 * resolution_hz)

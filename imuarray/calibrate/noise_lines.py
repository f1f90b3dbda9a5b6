"""Periodic parts of a sensor's noise: lines of its spectrum, steady ones and ones that wander.

A steady line is looked for in the mean spectrum of all stretches, where it stands out most. One that wanders (an
interference between two clocks that warm up apart, say) is smeared there: it is looked for window by window, and what
is found in one window continues what was found near by in the one before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.sound_readings import SEGMENT_ROWS, Clock, Stretches, readings, runs_of
from imuarray.calibrate.stability import NoiseLine
from imuarray.characterise.lines import Line, find_lines
from imuarray.characterise.spectrum import SEGMENT, Spectrum, Welch

Floats = npt.NDArray[np.float64]

MOST_LINES = 8
"""Lines of an axis that are kept, the strongest."""

_AVERAGED = 16
"""A spectrum's segments are so short that the readings fill this many of them, if they can be."""

_WINDOW_ROWS = 1024
_WINDOWS = 12
_WINDOW_SEGMENTS = 4
"""Windows are at least so long, so many at most are looked at, and have so many segments or more if they are long."""

_FEWEST_WINDOWS = 4
_SEEN = 0.25
"""A line that wanders is in at least so many windows, and in this share of all rows."""

_NEAR = 3.0
"""... no more than so many bins from where it was before."""


@dataclass
class _Track:
    """A line, window after window: frequencies, and the sum of squared amplitudes times rows; rows it was seen in."""

    frequencies_hz: list[float] = field(default_factory=list)
    squares: float = 0.0
    rows: int = 0

    def add(self, line: Line, rows: int) -> None:
        """The line as the next window shows it."""
        self.frequencies_hz.append(line.frequency_hz)
        self.squares += line.amplitude**2 * rows
        self.rows += rows


def noise_lines(stretches: Stretches, clock: Clock, rms_lsb: Floats, false_alarm: float) -> tuple[NoiseLine, ...]:
    """The lines of every axis, strongest first; a line's share is that of its sine in the variance `rms_lsb`^2.

    `false_alarm` is the chance that an axis without lines shows one.
    """
    lengths = [rows.stop - rows.start for _, rows in stretches]
    longest = min(max(lengths), max(SEGMENT_ROWS, sum(lengths) // _AVERAGED), SEGMENT)
    if clock.rate_hz <= 0 or longest < SEGMENT_ROWS:
        return ()
    whole = _spectrum(stretches, clock, _power_of_two(longest))
    tracks = _tracks(_windows(stretches), clock, false_alarm)
    found: list[NoiseLine] = []
    for index, rms in enumerate(rms_lsb):
        steady = [_steady(index, line, rms) for line in find_lines(whole, index, false_alarm).lines]
        wandering = [
            line
            for line in (_wandering(index, track, rows, rms) for track, rows in tracks[index])
            if _smears(line, whole.resolution_hz)
        ]
        steady = [line for line in steady if not any(_covers(other, line, whole.resolution_hz) for other in wandering)]
        found += sorted([*steady, *wandering], key=lambda line: -line.share)[:MOST_LINES]
    return tuple(found)


def _power_of_two(rows: float) -> int:
    return int(2 ** np.floor(np.log2(rows)))


def _spectrum(stretches: Stretches, clock: Clock, segment_rows: int) -> Spectrum:
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
    """The stretches, cut into windows; of many, some that are spread from the first to the last."""
    width = max(_WINDOW_ROWS, -(-sum(rows.stop - rows.start for _, rows in stretches) // _WINDOWS))
    cut = []
    for sensor, rows in stretches:
        length = rows.stop - rows.start
        if length >= SEGMENT_ROWS:
            edges = np.linspace(rows.start, rows.stop, max(1, length // width) + 1).astype(int).tolist()
            cut += [(sensor, slice(first, last)) for first, last in pairwise(edges)]
    chosen = np.unique(np.linspace(0, len(cut) - 1, min(_WINDOWS, len(cut))).round().astype(int))
    return [cut[index] for index in chosen.tolist()]


def _tracks(windows: Stretches, clock: Clock, false_alarm: float) -> Sequence[Sequence[tuple[_Track, int]]]:
    """Per axis, every line that is in enough windows, and the rows of all windows."""
    if len(windows) < _FEWEST_WINDOWS:
        return ((), (), ())
    tracks: list[list[_Track]] = [[], [], []]
    total = 0
    for window in windows:
        rows = window[1].stop - window[1].start
        segment = min(max(_power_of_two(rows / _WINDOW_SEGMENTS), SEGMENT_ROWS), _WINDOW_ROWS)
        spectrum = _spectrum([window], clock, segment)
        total += rows
        for index in range(3):
            for line in find_lines(spectrum, index, false_alarm).lines:
                _continued(tracks[index], line, _NEAR * spectrum.resolution_hz).add(line, rows)
    return [
        [
            (track, total)
            for track in axis
            if len(track.frequencies_hz) >= _FEWEST_WINDOWS and track.rows > _SEEN * total
        ]
        for axis in tracks
    ]


def _continued(tracks: list[_Track], line: Line, near_hz: float) -> _Track:
    """The track that the line continues, a new one if there is none."""
    close = [track for track in tracks if abs(track.frequencies_hz[-1] - line.frequency_hz) <= near_hz]
    if close:
        return min(close, key=lambda track: abs(track.frequencies_hz[-1] - line.frequency_hz))
    tracks.append(_Track())
    return tracks[-1]


def _share(square: float, rms: float) -> float:
    return min(1.0, square / 2 / rms**2)


def _steady(index: int, line: Line, rms: float) -> NoiseLine:
    return NoiseLine(
        "xyz"[index],
        line.frequency_hz,
        line.amplitude,
        _share(line.amplitude**2, rms),
        line.frequency_error_hz,
        line.amplitude_error,
    )


def _wandering(index: int, track: _Track, rows: int, rms: float) -> NoiseLine:
    """Its amplitude over all rows, those without it too."""
    square = track.squares / rows
    low, high = min(track.frequencies_hz), max(track.frequencies_hz)
    middle = float(np.mean(track.frequencies_hz))
    return NoiseLine("xyz"[index], middle, float(np.sqrt(square)), _share(square, rms), range_hz=np.array([low, high]))


def _smears(line: NoiseLine, resolution_hz: float) -> bool:
    """Whether it wanders by more than a bin of the mean spectrum, in which it can't be read then."""
    return line.range_hz is not None and float(np.ptp(line.range_hz)) > resolution_hz


def _covers(wandering: NoiseLine, line: NoiseLine, resolution_hz: float) -> bool:
    if wandering.range_hz is None:
        return False
    low, high = wandering.range_hz
    return bool(low - 2 * resolution_hz <= line.frequency_hz <= high + 2 * resolution_hz)

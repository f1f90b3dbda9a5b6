"""When a sensor reads otherwise than in the rest of a log: stretches told by running statistics of its rows.

A log's phases at rest are cut into windows; in each the codes' low bits, rows that repeat, rows that are missing, and
noise by frequency bands are told. A stretch of windows in which one of these has another mean than in the others is
found by comparing all stretches (a single change in the mean and its end: A. Sen and M. S. Srivastava, Ann. Statist. 3,
1975), and others of the same step after it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.gap.recording.source import Source
from imuarray.log.format import Phase

Stretches = tuple[tuple[float, float], ...]
"""From when until when, in seconds since the log's epoch."""

_WINDOWS, _WINDOW_ROWS = 64, 64
"""So many windows of a log at most, of so many rows at least: of fewer no band of a spectrum says anything."""

_FEWEST_WINDOWS = 8
_BAND_BINS, _BESIDE = 5, 17
"""Of a spectrum, in a band, and in a neighbourhood above which a line stands."""

_ROUNDING = 1e-2
"""Least power, in squared counts: readings that are all alike have a noise too."""

_LEAST = 2
"""A stretch is of so many windows at least, and so are those beside it."""

_EACH, _CLEAR = 3.0, 15.0
"""Nats by which two means explain a statistic better than one for it to count, and by which all statistics of a stretch
have to, over these: in normal noise the clearest of all stretches is beyond in one of twenty logs.
"""

_STRETCHES = 8
"""So many of one kind in a log are told at most."""

_ALIKE = 0.5
"""A further stretch is of the same kind if its step is that share of the first one's, or more."""

_SAME = 0.8
"""Two sets of stretches are the same if they have so much of the time in common."""

_NEAR, _EDGE_ROWS = 4, 32
"""A moment of change is told by rows of the windows on either side, beside those of three more of each side; of so many
rows each at least."""

_SETS = 2
"""So many sets of stretches of a log are told at most, the clearest."""

_FAR = 6.0
"""A step from one window to the next counts as so many times the median one at most: four standard deviations."""


class _Windows(NamedTuple):
    """(w,) from when until when in s, and what is told in each (w, f), nan where nothing is; `least` (f,) the least
    scatter that means anything.
    """

    begin_s: Floats
    end_s: Floats
    told: Floats
    least: Floats


class _Found(NamedTuple):
    """Which windows (w,), and by how many nats."""

    inside: Booleans
    nats: float


def stretches_of(source: Source, phases: Sequence[Phase]) -> tuple[Stretches, ...]:
    """Sets of stretches in which a sensor reads otherwise in these phases, at rest; the clearest first, each followed
    by the rest of the time: which of the two is the odd one isn't told here.
    """
    windows = _windows(source, phases)
    if windows is None:
        return ()
    kept: list[_Found] = []
    for one in sorted(_changes(windows), key=lambda one: -one.nats):
        if all(_apart(one.inside, other.inside) for other in kept) and len(kept) < _SETS:
            kept.append(one)
    found = [(one.inside, _edges(source, windows, one.inside)) for one in kept]
    return tuple(_joined(edges_s, side) for inside, edges_s in found for side in (inside, ~inside))


def _windows(source: Source, phases: Sequence[Phase]) -> _Windows | None:
    total = sum(source.rows(phase.start_ns, phase.end_ns) for phase in phases)
    rows = max(_WINDOW_ROWS, -(-total // _WINDOWS))
    parts = [part for phase in phases if (part := _of_phase(source, phase, rows)) is not None]
    if sum(len(part.begin_s) for part in parts) < _FEWEST_WINDOWS:
        return None
    begin_s, end_s, told = (np.concatenate(column) for column in list(zip(*parts, strict=True))[:3])
    return _Windows(begin_s, end_s, told, parts[0].least)


def _of_phase(source: Source, phase: Phase, rows: int) -> _Windows | None:
    blocks = list(source.blocks(phase.start_ns, phase.end_ns))
    if not blocks:
        return None
    time_ns = np.concatenate([block.time for block in blocks])
    counts = np.concatenate([block.counts for block in blocks]).astype(np.int64)
    windows = len(time_ns) // rows
    if not windows:
        return None
    time = time_ns[: windows * rows].reshape(windows, rows) * 1e-9
    counts = counts[: windows * rows].reshape(windows, rows, 3)
    return _Windows(time[:, 0], np.append(time[1:, 0], phase.end_ns * 1e-9), *_told(time, counts))


def _told(time_s: Floats, counts: Integers) -> tuple[Floats, Floats]:
    """(w, f) of windows of equally many rows, and (f,) the least scatter that means anything."""
    rows = counts.shape[1]
    share = 0.5 / np.sqrt(rows)
    repeats = (np.diff(counts, axis=1) == 0).all(axis=2).mean(axis=1)
    span = time_s[:, -1] - time_s[:, 0]
    centred = counts - counts.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred * np.hanning(rows)[:, None], axis=1)[:, 1:]) ** 2
    parts = np.array_split(np.arange(power.shape[1]), max(power.shape[1] // _BAND_BINS, 1))
    bands = [power[:, part].mean(axis=1) for part in parts]
    columns = [
        *((counts & 1).mean(axis=1).T, share),
        *((counts >> 1 & 1).mean(axis=1).T, share),
        *(repeats[None], share / 2),
        *(np.log(span / np.median(span))[None], 1 / rows),
        *(np.log(np.concatenate(bands, axis=1).T + _ROUNDING), 1 / np.sqrt(_BAND_BINS)),
        *(np.log(_line(power) + _ROUNDING), 1 / np.sqrt(_BAND_BINS)),
    ]
    tables, scatter = columns[::2], columns[1::2]
    told = np.concatenate(tables).T
    least = np.concatenate([np.full(len(table), one) for table, one in zip(tables, scatter, strict=True)])
    return told, least


def _line(power: Floats) -> Floats:
    """(3, w) of the spectra (w, b, 3) of windows at the highest line that all of them together have on each axis."""
    total = power.mean(axis=0)
    floor = median_filter(total, size=(min(_BESIDE, len(total)), 1), mode="mirror")
    highest = (total / np.maximum(floor, _ROUNDING)).argmax(axis=0)
    beside = np.clip(highest + np.arange(-1, 2)[:, None], 0, len(total) - 1)  # a window spreads it over three bins
    return np.asarray(power[:, beside, np.arange(3)].mean(axis=1).T)


def _changes(windows: _Windows) -> Iterator[_Found]:
    """Stretches that differ, the clearest first, those of one kind together."""
    scatter = np.maximum(_scatter(windows.told), windows.least)
    left = (windows.told - np.median(windows.told, axis=0)) / scatter
    inside, first, nats = np.zeros(len(left), bool), np.zeros(left.shape[1]), 0.0
    for _ in range(_STRETCHES):
        begin, end, gain, step = _clearest(left)
        if gain < _CLEAR:
            break
        if first.any() and step @ first < _ALIKE * (first @ first):
            yield _Found(inside, nats)
            inside, first, nats = np.zeros(len(left), bool), np.zeros(left.shape[1]), 0.0
        inside[begin:end] = True
        left[begin:end] -= step
        first, nats = first if first.any() else step, max(nats, gain)
    if inside.any():
        yield _Found(inside, nats)


def _scatter(told: Floats) -> Floats:
    """(f,) from window to window, those left out between which something changes."""
    steps = np.abs(np.diff(told, axis=0))
    return np.asarray(np.sqrt((np.minimum(steps, _FAR * np.median(steps, axis=0)) ** 2).mean(axis=0) / 2))


def _clearest(scores: Floats) -> tuple[int, int, float, Floats]:
    """(begin, end) of the stretch whose means differ most from those of the rest, by how many nats in all, and by how
    much (f,): the statistics that don't tell of it are left out.
    """
    count = len(scores)
    upto = np.concatenate([np.zeros((1, scores.shape[1])), np.cumsum(scores, axis=0)])
    begin, end = np.triu_indices(count + 1, _LEAST)
    rows = end - begin
    usable = (rows <= count - _LEAST) & ((begin == 0) | (begin >= _LEAST)) & ((end == count) | (end <= count - _LEAST))
    begin, end, rows = begin[usable], end[usable], rows[usable, None]
    inner = upto[end] - upto[begin]
    step = inner / rows - (upto[-1] - inner) / (count - rows)
    gains = rows * (count - rows) / count * step**2 / 2
    total = np.maximum(gains - _EACH, 0.0).sum(axis=1)
    at = int(total.argmax())
    return int(begin[at]), int(end[at]), float(total[at]), np.where(gains[at] > _EACH, step[at], 0.0)


def _apart(one: Booleans, other: Booleans) -> bool:
    """Whether neither it nor the rest of the time is the same as the other."""
    alike = float((one == other).mean())
    return 1 - _SAME < alike < _SAME


def _edges(source: Source, windows: _Windows, inside: Booleans) -> Floats:
    """(w + 1,) where each window begins, and the last one ends, s; those at which something changes by the rows near
    them.
    """
    edges = np.append(windows.begin_s, windows.end_s[-1])
    for at in (np.flatnonzero(np.diff(inside.astype(np.int8))) + 1).tolist():
        first, last = max(at - _NEAR, 0), min(at + _NEAR, len(inside))
        sides = slice(first, at), slice(at, last)
        if all((inside[side] == inside[side][0]).all() and side.stop - side.start > 2 for side in sides):
            edges[at] = _edge_s(source, edges[first], edges[at - 1], edges[at + 1], edges[last], edges[at])
    return edges


def _edge_s(source: Source, first_s: float, low_s: float, high_s: float, last_s: float, usual_s: float) -> float:
    """The moment between two others at which rows change from those before to those after; the usual one if no row
    tells. Of each row its low bits, whether it repeats, and its step are compared with the means on either side.
    """
    blocks = list(source.blocks(round(first_s * 1e9), round(last_s * 1e9)))
    time_s = np.concatenate([block.time for block in blocks]) * 1e-9
    counts = np.concatenate([block.counts for block in blocks]).astype(np.int64)
    steps = np.diff(counts, axis=0, prepend=counts[:1])
    size = np.log(np.abs(steps) + 0.5)
    told = np.concatenate([counts & 1, counts >> 1 & 1, (steps == 0).all(axis=1)[:, None], size], axis=1)
    before, after = told[time_s < low_s], told[time_s >= high_s]
    middle = told[(time_s >= low_s) & (time_s < high_s)]
    if min(len(before), len(after), len(middle)) < _EDGE_ROWS:
        return usual_s
    means = before.mean(axis=0), after.mean(axis=0)
    variance = np.maximum((before.var(axis=0) + after.var(axis=0)) / 2, 1e-3)
    error = variance * (1 / len(before) + 1 / len(after))
    tells = (means[0] - means[1]) ** 2 > 2 * _CLEAR * error
    if not tells.any():
        return usual_s
    gains = ((middle - means[1]) ** 2 - (middle - means[0]) ** 2)[:, tells] / variance[tells]
    row = int(np.concatenate([[0.0], np.cumsum(gains.sum(axis=1))]).argmax())
    times = time_s[(time_s >= low_s) & (time_s < high_s)]
    row_s = float(np.median(np.diff(times)))
    return float(times[row] - row_s / 2) if row < len(times) else high_s


def _joined(edges_s: Floats, inside: Booleans) -> Stretches:
    """Windows one after the other as one stretch; what begins with the first one, or ends with the last, has always
    been so, and stays.
    """
    edges = np.diff(np.concatenate([[0], inside.astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    return tuple(
        (0.0 if begin == 0 else float(edges_s[begin]), np.inf if end == len(inside) else float(edges_s[end]))
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
    )

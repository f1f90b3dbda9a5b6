"""Stretches of a log in which a sensor reads differently from the rest, detected by running statistics of its rows.

The phases at rest are cut into windows. In each window the low bits of the codes, repeated rows, missing rows and the
noise by frequency band are computed. All stretches of windows are compared with the rest, and the one whose mean
differs most is detected (one change of the mean and its end: A. Sen and M. S. Srivastava, Ann. Statist. 3, 1975).
Further stretches with the same step are then added to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from imuarray.arrays import Booleans, Floats, Integers
from imuarray.gap.recording.source import Source
from imuarray.log.format import Phase

try:
    from imuarray.gap import _stretches
except ImportError:  # installed without a C compiler
    COMPILED = False
else:
    COMPILED = True

Stretches = tuple[tuple[float, float], ...]
"""(begin, end) of each stretch, in seconds since the log's epoch."""

_WINDOWS, _WINDOW_ROWS = 64, 64
"""Largest number of windows of a log, and fewest rows of a window: fewer rows do not determine a band of the spectrum.
"""

_FEWEST_WINDOWS = 8
_BAND_BINS, _NEIGHBOURHOOD = 5, 17
"""Number of bins of a spectral band, and of the neighbourhood whose median is the noise floor of a line."""

_ROUNDING = 1e-2
"""Added to the power of a band, in squared counts, before the logarithm: constant readings have the noise of rounding.
"""

_FEWEST_STRETCH_WINDOWS = 2
"""Fewest windows of a stretch, and of the rest on either side."""

_EACH_NATS, _TOTAL_NATS = 3.0, 15.0
"""Log-likelihood ratios in nats. A statistic counts if its ratio exceeds the first value. A stretch is detected if the
sum over its statistics, each less the first value, exceeds the second one, which normal noise does in one of twenty
logs.
"""

_PARTLY_NATS = 10.0
"""Least gain, in nats, of a line in a stretch over a line in the whole phase. The best of 2000 stretches of 64 windows
gains 7 by chance.
"""

_FINER = 4
"""Number of frequencies in each bin of the spectrum at which a line is looked for: a line between two bins would not
add up in phase.
"""

_MOST_LINE_ROWS = 1 << 20
"""Largest number of rows of a phase in which a line is looked for. The windows of a longer phase are long enough to
show a faint line themselves.
"""

_LINE_NEIGHBOURS = 32
"""Number of bins on either side of a line from which the noise around it is estimated."""

_MOST_STRETCHES = 8
"""Largest number of stretches that are detected in a log, of all kinds together."""

_SAME_STEP = 0.5
"""Least ratio of a further stretch's step to the first one's at which both are of the same kind. A stretch inside
another one with the opposite step is a hole in it.
"""

_SAME_SET = 0.8
"""Share of the time in which two sets of stretches have to agree to be regarded as the same."""

_EDGE_WINDOWS, _EDGE_ROWS = 4, 32
"""The moment of a change is estimated from the rows of this many windows on either side. Each side, and the part
between them, needs at least the second number of rows.
"""

_MOST_SETS = 2
"""Largest number of sets of stretches that are reported for a log, the clearest first."""

_NEARLY, _MOST_LIKELY = 1e-6, 64
"""Relative difference allowed between the gains of compiled code and those of NumPy, and the largest number of
stretches that gain nearly as much as the clearest one.
"""

_LARGEST_STEP = 6.0
"""Limit of the steps from one window to the next, as a multiple of the median step (four standard deviations)."""


class _WindowTable(NamedTuple):
    """Windows of a log: begin and end (w,) in s, and the `statistics` (w, f) of each, nan where a window has none;
    `least` (f,) is the least meaningful scatter of each statistic.
    """

    begin_s: Floats
    end_s: Floats
    statistics: Floats
    least: Floats


class ChangedWindows(NamedTuple):
    """The mask `inside` (w,) of the windows of a kind of stretch, and its log-likelihood ratio in `nats`."""

    inside: Booleans
    nats: float


def stretches_of(source: Source, phases: Sequence[Phase]) -> tuple[Stretches, ...]:
    """Return the sets of stretches in which a sensor at rest reads differently in these phases, the clearest first.

    Each set is followed by its complement: this function does not decide which of the two is the exception. If a line
    is on in a part of the longest phase only, that stretch is the last set.
    """
    windows = _window_table(source, phases)
    if windows is None:
        return ()
    distinct_changes: list[ChangedWindows] = []
    for change in sorted(changes(windows.statistics, windows.least), key=lambda change: -change.nats):
        if (
            all(_are_distinct(change.inside, other.inside) for other in distinct_changes)
            and len(distinct_changes) < _MOST_SETS
        ):
            distinct_changes.append(change)
    edged = [(change.inside, _edges(source, windows, change.inside)) for change in distinct_changes]
    sets = tuple(_joined(edges_s, side) for inside, edges_s in edged for side in (inside, ~inside))
    line = _stretch_of_line(source, max(phases, key=lambda phase: phase.end_ns - phase.start_ns))
    return sets if line is None else (*sets, (line,))


def _stretch_of_line(source: Source, phase: Phase) -> tuple[float, float] | None:
    """Return the stretch in which the highest line of a phase is on, if it is off for a part of the phase; None
    otherwise.

    A line that is too faint to be seen in a single window adds up in phase as long as it is on. Let z_k be the sums
    over windows of the rows, less their mean and rotated back by the phase of the line, and p the power per row of the
    noise around the line. A stretch of n rows with the line gains |sum z_k|^2 / (n p) nats (Rife and Boorstyn, IEEE
    Trans. Inf. Theory 20, 1974).
    """
    if source.rows(phase.start_ns, phase.end_ns) > _MOST_LINE_ROWS:
        return None
    blocks = list(source.blocks(phase.start_ns, phase.end_ns))
    if not blocks:
        return None
    time_s = np.concatenate([block.time for block in blocks]) * 1e-9
    window_rows = max(_WINDOW_ROWS, -(-len(time_s) // _WINDOWS))
    windows = len(time_s) // window_rows
    if windows < _FEWEST_WINDOWS:
        return None
    rows = windows * window_rows
    counts = np.concatenate([block.counts for block in blocks])[:rows].astype(float)
    counts -= counts.mean(axis=0)
    power = np.abs(np.fft.rfft(counts, _FINER * rows, axis=0)) ** 2
    lowest = 2 * _FINER * windows  # the statistics of the windows show lines with less than two periods in a window
    power[:lowest] = 0.0
    line, axis = (int(at) for at in np.unravel_index(int(power.argmax()), power.shape))
    neighbours = power[max(line - _FINER * _LINE_NEIGHBOURS, lowest) : line + _FINER * _LINE_NEIGHBOURS + 1, axis]
    floor = float(np.median(neighbours)) / np.log(2) / rows
    if floor <= 0:
        return None
    turned = counts[:, axis] * np.exp(-2j * np.pi * line / (_FINER * rows) * np.arange(rows))
    upto = np.concatenate([[0.0], np.cumsum(turned.reshape(windows, window_rows).sum(axis=1))])
    begin, end = np.triu_indices(windows + 1, _FEWEST_STRETCH_WINDOWS)
    gains = np.abs(upto[end] - upto[begin]) ** 2 / ((end - begin) * window_rows * floor)
    best, best_at_end = int(gains.argmax()), int(np.where((begin == 0) | (end == windows), gains, 0.0).argmax())
    if gains[best] - gains[best_at_end] < _EACH_NATS:  # one change explains the rows as well as a begin and an end
        best = best_at_end
    if gains[best] < _TOTAL_NATS or gains[best] - abs(upto[-1]) ** 2 / (rows * floor) < _PARTLY_NATS:
        return None
    first, last = int(begin[best]) * window_rows, int(end[best]) * window_rows
    begin_s = 0.0 if first == 0 else float(time_s[first])
    return begin_s, np.inf if last >= rows else float(time_s[last])


def _window_table(source: Source, phases: Sequence[Phase]) -> _WindowTable | None:
    total = sum(source.rows(phase.start_ns, phase.end_ns) for phase in phases)
    rows = max(_WINDOW_ROWS, -(-total // _WINDOWS))
    parts = [part for phase in phases if (part := _of_phase(source, phase, rows)) is not None]
    if sum(len(part.begin_s) for part in parts) < _FEWEST_WINDOWS:
        return None
    begin_s, end_s, values = (np.concatenate(column) for column in list(zip(*parts, strict=True))[:3])
    return _WindowTable(begin_s, end_s, values, parts[0].least)


def _of_phase(source: Source, phase: Phase, rows: int) -> _WindowTable | None:
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
    return _WindowTable(time[:, 0], np.append(time[1:, 0], phase.end_ns * 1e-9), *_window_statistics(time, counts))


def _window_statistics(time_s: Floats, counts: Integers) -> tuple[Floats, Floats]:
    """Return the statistics (w, f) of windows of equally many rows, and the least meaningful scatter (f,) of each."""
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
    values = np.concatenate(tables).T
    least = np.concatenate(
        [np.full(len(table), share_of_table) for table, share_of_table in zip(tables, scatter, strict=True)]
    )
    return values, least


def _line(power: Floats) -> Floats:
    """Return the power (3, w) of the spectra (w, b, 3) of windows, at the highest line of their mean on each axis."""
    total = power.mean(axis=0)
    floor = median_filter(total, size=(min(_NEIGHBOURHOOD, len(total)), 1), mode="mirror")
    highest = (total / np.maximum(floor, _ROUNDING)).argmax(axis=0)
    bins = np.clip(highest + np.arange(-1, 2)[:, None], 0, len(total) - 1)  # Hann spreads a line over three bins
    return np.asarray(power[:, bins, np.arange(3)].mean(axis=1).T)


def changes(statistics: Floats, least: Floats) -> Iterator[ChangedWindows]:
    """Yield the kinds of stretches of windows with statistics (w, f) that differ from the rest, in the order of
    detection.

    `least` (f,) is the least meaningful scatter. A statistic without scatter, such as that of a sensor that is stuck
    for most of the time, has no score.
    """
    scatter = np.maximum(_scatter(statistics), least)
    scatter[scatter == 0] = np.inf
    scores = (statistics - np.median(statistics, axis=0)) / scatter
    inside, first, nats = np.zeros(len(scores), bool), np.zeros(scores.shape[1]), 0.0
    for _ in range(_MOST_STRETCHES):
        begin, end, gain, step = _clearest(scores)
        if gain < _TOTAL_NATS:
            break
        likeness = float(step @ first) / float(first @ first) if first.any() else 1.0
        is_hole = likeness < -_SAME_STEP and bool(inside[begin:end].all())
        if likeness < _SAME_STEP and not is_hole:
            yield ChangedWindows(inside, nats)
            inside, first, nats = np.zeros(len(scores), bool), np.zeros(scores.shape[1]), 0.0
        inside[begin:end] = not is_hole
        scores[begin:end] -= step
        first, nats = first if first.any() else step, max(nats, gain)
    if inside.any():
        yield ChangedWindows(inside, nats)


def _scatter(values: Floats) -> Floats:
    """Return the scatter (f,) from window to window; the steps at changes are limited."""
    steps = np.abs(np.diff(values, axis=0))
    return np.asarray(np.sqrt((np.minimum(steps, _LARGEST_STEP * np.median(steps, axis=0)) ** 2).mean(axis=0) / 2))


def _clearest(scores: Floats) -> tuple[int, int, float, Floats]:
    """Return the stretch [begin, end) whose means differ most from those of the rest, the difference in nats, and the
    step (f,) of each statistic, 0 for statistics that do not show it.
    """
    count = len(scores)
    upto = np.concatenate([np.zeros((1, scores.shape[1])), np.cumsum(scores, axis=0)])
    begin, end = _likely_stretches(upto)
    rows = (end - begin)[:, None]
    inner = upto[end] - upto[begin]
    step = inner / rows - (upto[-1] - inner) / (count - rows)
    gains = rows * (count - rows) / count * step**2 / 2
    total = np.maximum(gains - _EACH_NATS, 0.0).sum(axis=1)
    at = int(total.argmax())
    return int(begin[at]), int(end[at]), float(total[at]), np.where(gains[at] > _EACH_NATS, step[at], 0.0)


def _likely_stretches(upto: Floats) -> tuple[Integers, Integers]:
    """Return the begins and ends of the stretches of w windows that may be the clearest one. Compiled code returns
    those that gain nearly as much as the best; without it, or if they are too many, all stretches are returned. `upto`
    (w + 1, f) are the sums of the windows before each edge.
    """
    count = len(upto) - 1
    if COMPILED and count >= 2 * _FEWEST_STRETCH_WINDOWS and np.isfinite(upto).all():
        rows = np.arange(1, count)
        weights = np.concatenate([[0.0], count / (2 * rows * (count - rows)), [0.0]])
        places = np.empty((_MOST_LIKELY, 2), np.int64)
        arrays = np.ascontiguousarray(upto.T, float), weights, np.empty((2, count + 1)), places
        sizes = count, upto.shape[1], _FEWEST_STRETCH_WINDOWS, _MOST_LIKELY
        likely = _stretches.clearest(arrays, sizes, _EACH_NATS, 1 - _NEARLY)
        if likely <= _MOST_LIKELY:
            return places[:likely, 0], places[:likely, 1]
    begin, end = np.triu_indices(count + 1, _FEWEST_STRETCH_WINDOWS)
    usable = (
        (end - begin <= count - _FEWEST_STRETCH_WINDOWS)
        & ((begin == 0) | (begin >= _FEWEST_STRETCH_WINDOWS))
        & ((end == count) | (end <= count - _FEWEST_STRETCH_WINDOWS))
    )
    return begin[usable], end[usable]


def _are_distinct(first: Booleans, other: Booleans) -> bool:
    """Return whether a set differs from another and from its complement."""
    agreement = float((first == other).mean())
    return 1 - _SAME_SET < agreement < _SAME_SET


def _edges(source: Source, windows: _WindowTable, inside: Booleans) -> Floats:
    """Return the begins of the windows and the end of the last one (w + 1,) in s. The edges at which something changes
    are refined by the rows near them.
    """
    edges = np.append(windows.begin_s, windows.end_s[-1])
    for at in (np.flatnonzero(np.diff(inside.astype(np.int8))) + 1).tolist():
        first, last = max(at - _EDGE_WINDOWS, 0), min(at + _EDGE_WINDOWS, len(inside))
        sides = slice(first, at), slice(at, last)
        if all((inside[side] == inside[side][0]).all() and side.stop - side.start > 2 for side in sides):
            edges[at] = _edge_s(source, edges[first], edges[at - 1], edges[at + 1], edges[last], edges[at])
    return edges


def _edge_s(source: Source, first_s: float, low_s: float, high_s: float, last_s: float, usual_s: float) -> float:
    """Return the moment in s between `low_s` and `high_s` at which the rows change; `usual_s` if no statistic shows it.

    The low bits of each row, whether it repeats the row before, and its step are compared with the means on either
    side.
    """
    blocks = list(source.blocks(round(first_s * 1e9), round(last_s * 1e9)))
    time_s = np.concatenate([block.time for block in blocks]) * 1e-9
    counts = np.concatenate([block.counts for block in blocks]).astype(np.int64)
    steps = np.diff(counts, axis=0, prepend=counts[:1])
    size = np.log(np.abs(steps) + 0.5)
    values = np.concatenate([counts & 1, counts >> 1 & 1, (steps == 0).all(axis=1)[:, None], size], axis=1)
    before, after = values[time_s < low_s], values[time_s >= high_s]
    middle = values[(time_s >= low_s) & (time_s < high_s)]
    if min(len(before), len(after), len(middle)) < _EDGE_ROWS:
        return usual_s
    means = before.mean(axis=0), after.mean(axis=0)
    variance = np.maximum((before.var(axis=0) + after.var(axis=0)) / 2, 1e-3)
    error = variance * (1 / len(before) + 1 / len(after))
    is_clear = (means[0] - means[1]) ** 2 > 2 * _TOTAL_NATS * error
    if not is_clear.any():
        return usual_s
    gains = ((middle - means[1]) ** 2 - (middle - means[0]) ** 2)[:, is_clear] / variance[is_clear]
    row = int(np.concatenate([[0.0], np.cumsum(gains.sum(axis=1))]).argmax())
    times = time_s[(time_s >= low_s) & (time_s < high_s)]
    row_s = float(np.median(np.diff(times)))
    return float(times[row] - row_s / 2) if row < len(times) else high_s


def _joined(edges_s: Floats, inside: Booleans) -> Stretches:
    """Join windows to stretches. A stretch that includes the first window begins at 0, one that includes the last ends
    at infinity.
    """
    edges = np.diff(np.concatenate([[0], inside.astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    return tuple(
        (0.0 if begin == 0 else float(edges_s[begin]), np.inf if end == len(inside) else float(edges_s[end]))
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
    )

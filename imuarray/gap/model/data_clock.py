"""The rate error of a chip's data clock, estimated from readings that are repeated or missed.

A recorder polls a chip at about the rate at which the chip measures. If the chip's clock has a rate error, polls find
no new reading, or miss one, at regular intervals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import brentq

from imuarray.arrays import Floats
from imuarray.chips import die_of
from imuarray.gap.model.populations import clock_tolerance
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.intervals import Intervals
from imuarray.gap.statistics.probes.probe import once
from imuarray.gap.statistics.probes.timing import tells_repetitions
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.simulate.sensor import NO_READY_BIT

_HELD = 6
"""Number of rows beyond the longest run that a clock can cause, above which the reading was held: repeats by chance do
not make runs of this length.
"""

_SLIPS = 4.0
"""Least excess of repeated rows over chance, in standard deviations, that indicates a slow data clock."""

_SAME_CLOCK = 0.3
"""Relative difference between the errors of phases up to which one clock error is assumed for all of them; a larger
difference is accepted if it can be due to chance.
"""

_UNEVEN = 1.5
"""Difference between missed and repeated readings per phase that is attributed to the ends of the phase, and not to a
rate error.
"""

_MOST_FAST = 4.0
"""Upper limit of the rate of a clock with repeats: its excess over the rate of the polls, relative, in relative
standard deviations of the intervals.
"""

_OVERSAMPLED = 1.05
"""Number of polls per reading above which the chip counts as polled faster than it measures: readings are regularly
repeated, and can be read three times if the polls jitter.
"""

_RARELY_EQUAL = 1e-3
"""Probability that two new readings are equal below which repeats in motion are attributed to the clock."""

_SKIPPED = 2.5
"""Longest gap, in usual intervals, in which only a single row is missing."""


def clock_errors(
    campaign: Campaign, headers: Mapping[str, SensorHeader], noise_counts: Mapping[str, Floats]
) -> dict[str, float]:
    """Return, by sensor, the relative rate error of the chip's data clock (positive if it is fast) if it is within its
    tolerance; nan if the rows do not determine it. `noise_counts` (3,) is the noise of a reading in counts.

    Rows that are equal by chance are mistaken for repeats. At rest their share is estimated and subtracted; phases in
    motion are also used if rows are flagged, or if the noise makes equal rows rare. Two sensors in one chip have the
    same clock.
    """
    errors = {}
    for name, header in headers.items():
        is_flagged = flags_repeats(campaign, header)
        rests = [rest for log in campaign.logs for rest in log.still(name)]
        everything = [phase for log in campaign.logs for phase in log.of(name)]
        errors[name] = _clock_error(everything if is_flagged else rests, header, is_flagged)
        if math.isnan(errors[name]) and not is_flagged and _equal_by_noise(noise_counts[name]) < _RARELY_EQUAL:
            errors[name] = _clock_error(everything, header, is_flagged)
    for name, header in headers.items():
        known = [errors[other] for other in headers if _share_a_chip(header, headers[other])]
        if math.isnan(errors[name]):
            errors[name] = next((error for error in known if math.isfinite(error)), math.nan)
    return errors


def _share_a_chip(first: SensorHeader, other: SensorHeader) -> bool:
    """Return whether these are two sensors of a six-axis chip: they have the same name except for its last part, the
    same die, position and axes, and measure different quantities.
    """
    stems = {header.name.rpartition("_")[0] for header in (first, other)}
    is_same_die = die_of(first.chip) == die_of(other.chip)
    is_same_place = (first.position_mm, first.axes) == (other.position_mm, other.axes)
    return is_same_die and is_same_place and first.quantity != other.quantity and len(stems) == 1 and stems != {""}


def _equal_by_noise(noise_counts: Floats) -> float:
    """Return the probability that two readings with this noise (3,), in counts, are equal on all axes."""
    return float(np.prod(np.minimum(1 / (2 * math.sqrt(math.pi) * np.maximum(noise_counts, 1e-9)), 1.0)))


def _clock_error(summaries: Sequence[Summary], header: SensorHeader, is_flagged: bool) -> float:
    """Return the relative error of the clock from these phases; nan if they do not determine it.

    A host that polls faster than the chip measures repeats some readings at regular intervals; the numbers of rows of
    any two readings differ by at most one. The rate of the chip is then the rate of the polls multiplied by the share
    of new readings. Longer runs of repeats have another cause (nan), except that a phase in which a reading is held for
    a long time is skipped. An error beyond the tolerance of the chip is not a nuisance quantity (nan).

    Rows that the recorder flags as stale are repeats, however many rows are equal by chance. Before each row that it
    flags as overrun one reading was missed. The rate of each phase is estimated as follows:

    - If the polls are much faster than the chip, from the share of repeats and the intervals between polls
      (`_readings_between_polls`).
    - If too many stale flags are doubtful (`tells_repetitions`), since readings are often updated while they are read,
      from the number of slips: each slip of one clock against the other is a run of one or a few flagged rows.
    - If missed readings are flagged, from the difference between missed and repeated readings.
    - Otherwise from the share of repeats and the intervals between polls (`_readings_per_s`).

    If missed and repeated readings are equally frequent, up to one or two in a phase, the error is 0. A poll that is
    early or late when a new reading is due finds none or two; if no single rate explains the flags of all phases, the
    chip is therefore assumed to be polled at its nominal rate (0).
    """
    phases = [phase for phase in summaries if phase.intervals.count]
    if header.rate_hz <= 0 or not phases:
        return math.nan
    readings_per_s, weight, slips = [], [], 0
    tolerance = clock_tolerance(header)
    equal_in_a_row = _equal_in_a_row(_equal_by_chance(phases, is_flagged), sum(phase.rows for phase in phases))
    flags_missed = any(phase.flags["overrun"] for phase in phases)
    for phase in phases:
        rows_per_s, repeats = _polls_per_s(phase, header.rate_hz), phase.repeats
        by_chance = _equal_neighbours(phase)
        excess = (repeats.repeat_share - by_chance) * math.sqrt(phase.rows / max(by_chance, 1 / phase.rows))
        longest = math.ceil(rows_per_s / (header.rate_hz * (1 - tolerance))) + equal_in_a_row
        longest += rows_per_s > _OVERSAMPLED * header.rate_hz  # a late poll may come just before the next reading
        if rows_per_s < (1 - tolerance) * header.rate_hz:
            continue
        if repeats.longest > longest + _HELD:
            continue
        if repeats.longest > longest:
            return math.nan
        slips += phase.flags["stale"] > 0 or excess >= _SLIPS
        repeated = repeated_share(phase, is_flagged)
        if rows_per_s > _OVERSAMPLED * header.rate_hz:
            readings_per_s.append(_readings_between_polls(phase.intervals, repeated))
        elif not tells_repetitions(phase):
            is_slow = phase.flags["stale"] + phase.flags["doubtful"] >= phase.flags["overrun"]
            readings_per_s.append(rows_per_s * (1 + (-1 if is_slow else 1) * phase.slips / phase.rows))
        elif is_flagged and flags_missed:
            readings_per_s.append(rows_per_s * (1 - repeated + phase.flags["overrun"] / phase.rows))
        else:
            readings_per_s.append(_readings_per_s(phase.intervals, repeated))
        weight.append(phase.rows)
    if not slips:
        return math.nan
    error = float(np.average(readings_per_s, weights=weight)) / header.rate_hz - 1
    if is_flagged and flags_missed and abs(error) * sum(weight) <= _UNEVEN * len(weight):
        return 0.0
    apart = np.abs(np.array(readings_per_s) / header.rate_hz - 1 - error)
    unsure = _SLIPS * np.sqrt(np.abs(error) / np.array(weight))
    is_one_clock = bool((apart <= np.maximum(_SAME_CLOCK * abs(error), unsure)).all())
    if is_one_clock and abs(error) <= tolerance:
        return error
    return 0.0 if is_flagged and abs(error) <= tolerance else math.nan


def _polls_per_s(phase: Summary, rate_hz: float) -> float:
    """Return the number of polls per second in a phase without its gaps. If a chip is polled more often than it
    measures, the recorder may regularly skip single rows without losing a reading; gaps of two intervals are then
    included.
    """
    intervals = phase.intervals
    rows_per_s = 1 / intervals.mean_s
    if rows_per_s < _OVERSAMPLED * rate_hz or intervals.longest_s > _SKIPPED * intervals.mean_s:
        return rows_per_s
    return rows_per_s * (intervals.count + intervals.gaps) / (intervals.count + 2 * intervals.gaps)


def _readings_per_s(intervals: Intervals, repeated: float) -> float:
    """Return the number of readings of the chip per second, if it is polled about as often as it measures and the share
    `repeated` of the polls finds no new reading.

    For a random phase of the clocks a poll finds no new reading with the probability 1 - d f, where d is the interval
    since the previous poll and f the rate, if d is shorter than the period 1 / f, and otherwise 0. The mean is computed
    over the histogram of intervals, since some polls of a busy host are late by many times the usual scatter.
    """
    if repeated <= 0:
        return 1 / intervals.mean_s
    counts, sums_s = intervals.lengths
    most = (1 + _MOST_FAST * intervals.std_s / intervals.mean_s) / intervals.mean_s

    def excess(readings_per_s: float) -> float:
        return float(np.maximum(counts - readings_per_s * sums_s, 0.0).sum() / counts.sum()) - repeated

    return float(brentq(excess, 0.0, most)) if excess(most) < 0 else most


def _readings_between_polls(intervals: Intervals, repeated: float) -> float:
    """Return the number of readings of the chip per second, if it is polled more often than it measures and the share
    `repeated` of the polls finds no new reading.

    For a random phase of the clocks a poll finds no new reading with the probability 1 - d f, where d is the interval
    since the previous poll and f the rate, if d is shorter than the period, and otherwise 0. The mean over the shorter
    intervals determines f. The number of readings missed in longer intervals is not used; it is uncertain if readings
    are updated while they are read.
    """
    share = intervals.shorter / (intervals.count + intervals.gaps)
    return (share - repeated) / (share * intervals.shorter_s) if share > repeated else math.nan


def _equal_in_a_row(by_chance: float, rows: int) -> int:
    """Return the length of the run of new readings, each equal to the previous one by chance, that occurs about once in
    `rows` rows.
    """
    if by_chance >= 1:
        return rows
    return math.ceil(math.log(rows) / -math.log(by_chance)) if by_chance > 1 / rows else 0


def _equal_by_chance(phases: Sequence[Summary], is_flagged: bool) -> float:
    """Return the share of new readings that equal the previous one, in all phases together, since short phases
    determine it poorly. If repeats are flagged, it is counted without them.
    """
    if not is_flagged:
        return float(
            np.average([_equal_neighbours(phase) for phase in phases], weights=[phase.rows for phase in phases])
        )
    equal = sum(phase.repeats.repeat_share * phase.rows for phase in phases)
    repeated = sum(phase.flags["stale"] for phase in phases)
    fresh = sum(phase.rows for phase in phases) - repeated
    return max(float(equal - repeated) / fresh, 0.0) if fresh else 1.0


def repeated_share(phase: Summary, is_flagged: bool) -> float:
    """Return the share of the rows that are not a new reading: from the recorder's flags if it sets them, otherwise
    from the share of equal rows beyond chance.
    """
    if is_flagged:
        return phase.flags["stale"] / phase.rows
    by_chance = _equal_neighbours(phase)
    if by_chance >= 1:
        return 0.0  # a sensor without noise
    return float(np.nan_to_num((phase.repeats.repeat_share - by_chance) / (1 - by_chance)))


def flags_repeats(campaign: Campaign, header: SensorHeader) -> bool:
    """Return whether the recorder flags rows of this sensor that are not a new reading.

    If it flags rows of any chip with a data-ready bit, it is assumed to do so for all of these chips; a sensor without
    flagged rows then has no repeats.
    """
    if header.chip in NO_READY_BIT:
        return False
    summaries = (summary for log in campaign.logs for phase in log.phases for summary in phase.sensors.values())
    return any(summary.flags["stale"] for summary in summaries if summary.header.chip not in NO_READY_BIT)


@once
def _equal_neighbours(phase: Summary) -> float:
    """Return the share of new readings that equal the previous one: that of readings far apart, increased if
    neighbouring readings are correlated by rho, since the standard deviation of each axis's difference is smaller by
    the root of 1 - rho.
    """
    repeats = phase.repeats
    far = float(np.nan_to_num(repeats.chance_share))
    again = float(np.nan_to_num(1 - repeats.new_share))
    rho = np.clip((np.nan_to_num(phase.correlation[1]) - again) / max(1 - again, 0.1), 0.0, 0.9)
    return min(far / math.sqrt(float(np.prod(1 - rho))), repeats.repeat_share)

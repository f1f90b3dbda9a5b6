"""The error of rate of a chip's data clock, by readings that are read again or missed.

A recorder polls a chip at about the rate at which the chip measures. As the chip's clock is off by a share of its rate,
polls find no new reading, or a second one, at regular intervals.
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
"""Rows beyond the longest run of a clock from which on a reading is held: repeats by chance have no such runs."""

_SLIPS = 4.0
"""Excess of repeated rows over chance, in standard deviations, that shows a slow data clock."""

_SAME_CLOCK = 0.3
"""Relative difference of phases, beside chance, within which one clock error explains them all."""

_UNEVEN = 1.5
"""Readings of a phase that are missed or repeated at its ends: a poll begins or ends between the two."""

_MOST_FAST = 4.0
"""The fastest clock that repeats show, in standard deviations of the intervals."""

_OVERSAMPLED = 1.05
"""Polls for each reading from which on readings come twice as a rule, and three times where polls jitter."""

_RARELY_EQUAL = 1e-3
"""Probability that new readings are equal below which repeats in motion are those of the clock."""

_SKIPPED = 2.5
"""Longest gap, in usual intervals, that lacks a single row."""


def clock_errors(
    campaign: Campaign, headers: Mapping[str, SensorHeader], noise_counts: Mapping[str, Floats]
) -> dict[str, float]:
    """Return by sensor how much slower or faster than it should the chip's data clock runs, a share, within its
    tolerance; nan where nothing tells it. `noise_counts` (3,) is the noise of a reading.

    Rows that are equal by chance hide repeats. At rest their share is counted; where the box moves and the noise makes
    equal rows rare, repeats tell the clock as well. Two sensors in one chip have one clock.
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
    """Return whether these are two sensors of a six-axis chip: of one name but for its last part, die, place and
    axes.
    """
    stems = {header.name.rpartition("_")[0] for header in (first, other)}
    is_same_die = die_of(first.chip) == die_of(other.chip)
    is_same_place = (first.position_mm, first.axes) == (other.position_mm, other.axes)
    return is_same_die and is_same_place and first.quantity != other.quantity and len(stems) == 1 and stems != {""}


def _equal_by_noise(noise_counts: Floats) -> float:
    """Return the probability that two readings with this noise (3,) are equal in all axes."""
    return float(np.prod(np.minimum(1 / (2 * math.sqrt(math.pi) * np.maximum(noise_counts, 1e-9)), 1.0)))


def _clock_error(summaries: Sequence[Summary], header: SensorHeader, is_flagged: bool) -> float:
    """Return the error of the clock by these phases; nan where they do not tell it.

    A host that polls faster than the chip measures reads some readings again, at regular intervals and each as
    often as any other, to one: the share of new readings, times the rate of the polls, is that of the chip. Repeats
    that come in longer runs have another reason, and those of a chip that is off by more than its tolerance are no
    nuisance. A phase in which a reading is held for long tells nothing of the clock, which the other phases may
    tell. Rows that the recorder flags as no new reading are repeats, however many rows are equal by chance; of
    those flagged as overrun there was one reading more than was read, and where polls are much faster than the chip
    the intervals between them tell the rest (`_readings_between_polls`). Polls that are early or late at the moment
    of a new reading find none or two: flags that no single rate explains are those of a chip that is polled at its
    nominal rate. If many readings come while they are read, the polls that find none are no count of what is
    missing, but one or a few in a row are each slip of one clock against the other. Where no missed reading is
    flagged, the share of repeats and the intervals between polls tell the rate (`_readings_per_s`). Where as many
    readings are missed as are repeated, to one or two in a phase, the chip keeps its nominal rate. Flags tell this
    while the box moves, too.
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
        longest += rows_per_s > _OVERSAMPLED * header.rate_hz  # a late poll may come just before the next one
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
    """Return rows in a second of a phase without its gaps. Polls of a chip that is polled more often than it measures
    may skip single rows again and again, in which no reading is lost: such gaps, of two intervals, count.
    """
    intervals = phase.intervals
    rows_per_s = 1 / intervals.mean_s
    if rows_per_s < _OVERSAMPLED * rate_hz or intervals.longest_s > _SKIPPED * intervals.mean_s:
        return rows_per_s
    return rows_per_s * (intervals.count + intervals.gaps) / (intervals.count + 2 * intervals.gaps)


def _readings_per_s(intervals: Intervals, repeated: float) -> float:
    """Return readings of the chip in a second, if it is polled about as often as it measures and a share of polls
    `repeated` finds no new one.

    A poll finds none with the probability 1 - d f, d the interval since the poll before and f the rate, if d is shorter
    than the period 1 / f, and 0 else, whatever the phase of the clocks. Some polls of a busy host are late by many
    times what the others scatter by, so that the mean is over the intervals themselves.
    """
    if repeated <= 0:
        return 1 / intervals.mean_s
    counts, sums_s = intervals.lengths
    most = (1 + _MOST_FAST * intervals.std_s / intervals.mean_s) / intervals.mean_s

    def excess(readings_per_s: float) -> float:
        return float(np.maximum(counts - readings_per_s * sums_s, 0.0).sum() / counts.sum()) - repeated

    return float(brentq(excess, 0.0, most)) if excess(most) < 0 else most


def _readings_between_polls(intervals: Intervals, repeated: float) -> float:
    """Return readings of the chip in a second, if it is polled more often than it measures and a share of polls
    `repeated` finds no new one.

    A poll finds none with the probability 1 - d f, d the interval since the poll before and f the rate, if d is shorter
    than the period, and 0 else, whatever the phase of the clocks: the mean over the intervals gives f. How many
    readings were missed in longer intervals does not matter; a reading that comes while it is read may hide that.
    """
    share = intervals.shorter / (intervals.count + intervals.gaps)
    return (share - repeated) / (share * intervals.shorter_s) if share > repeated else math.nan


def _equal_in_a_row(by_chance: float, rows: int) -> int:
    """New readings that equal the one before, one after the other, at most: once in so many rows."""
    if by_chance >= 1:
        return rows
    return math.ceil(math.log(rows) / -math.log(by_chance)) if by_chance > 1 / rows else 0


def _equal_by_chance(phases: Sequence[Summary], is_flagged: bool) -> float:
    """Return the share of new readings that equal the one before, in all phases together: short ones show it poorly.
    Flags tell the repeats from readings that are equal by chance.
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
    """Return the share of the rows that are no new reading: by the recorder's flags if it sets any, otherwise by
    equality.
    """
    if is_flagged:
        return phase.flags["stale"] / phase.rows
    by_chance = _equal_neighbours(phase)
    if by_chance >= 1:
        return 0.0  # a sensor without noise
    return float(np.nan_to_num((phase.repeats.repeat_share - by_chance) / (1 - by_chance)))


def flags_repeats(campaign: Campaign, header: SensorHeader) -> bool:
    """Return whether the recorder flags rows of this sensor that are no new reading.

    A recorder that does so for any chip that says when a reading is new does so for all of these: one without a flag
    has no such rows.
    """
    if header.chip in NO_READY_BIT:
        return False
    summaries = (summary for log in campaign.logs for phase in log.phases for summary in phase.sensors.values())
    return any(summary.flags["stale"] for summary in summaries if summary.header.chip not in NO_READY_BIT)


@once
def _equal_neighbours(phase: Summary) -> float:
    """Return the share of new readings that equal the one before: that of readings far apart, and more where they
    correlate, since the scatter of each axis's difference is smaller by the root of 1 - rho.
    """
    repeats = phase.repeats
    far = float(np.nan_to_num(repeats.chance_share))
    again = float(np.nan_to_num(1 - repeats.new_share))
    rho = np.clip((np.nan_to_num(phase.correlation[1]) - again) / max(1 - again, 0.1), 0.0, 0.9)
    return min(far / math.sqrt(float(np.prod(1 - rho))), repeats.repeat_share)

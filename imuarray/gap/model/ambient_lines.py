"""Lines of the surroundings, which sensors measure at rest: a fan or an engine shakes the box, a transformer hums.

A line in a sensor's spectrum is a nuisance quantity if another sensor of the quantity has it too, with the same
amplitude along the axes of the box. A faint line of an accelerometer is one as long as the others do not contradict it:
those that would show it, by their noise and their rate, do. A line that only one of several sensors has, and a strong
one that no other confirms, is left to the effects.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.characterise.spectrum import Spectrum
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.lines import HALF_WIDTH, Line, highest_lines, pool_spectra
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.noise import Tone
from imuarray.units import SI_PER_UNIT, STANDARD_GRAVITY

MOST_G = 6e-4
"""Largest usual amplitude along an axis of the box, in g: tables in rooms with machines shake by some tenths of a
thousandth of g.
"""

MOST_FACTOR = 1.6
"""A replicate's amplitude is between 0 and this times the mean one: machines switch on and off."""

_LINES = 4
"""Lines of one rate that are looked at, the highest first: a machine has harmonics."""

_HIGH = 5.0
"""Standard deviations by which a line stands above its neighbours."""

_CONTRADICTED, _SURE = 0.25, 4.0
"""Another accelerometer contradicts a line if it shows less than this share of its power, by so many standard
deviations.
"""

_CONFIRMED = 2.0
"""Ratio of powers within which another sensor shows the same line: chips differ in bandwidth and scale."""

_SAME_RATE = 0.01
"""Relative difference of rates of rows at which lines are at the same frequency."""


@dataclass(frozen=True)
class AmbientLine:
    """A line at `frequency_hz`, as rows show it, with amplitudes `amplitude_box` (3,) in SI units along the axes of the
    box, and the sensors that measure it.
    """

    frequency_hz: float
    amplitude_box: tuple[float, float, float]
    sensors: tuple[str, ...]

    def tone(self, header: SensorHeader, factor: float) -> Tone:
        """Return the line as one of the sensors shows it, with amplitudes multiplied by `factor`."""
        own = np.abs(np.array(header.orientation)).T @ np.array(self.amplitude_box)
        x, y, z = (own * factor / SI_PER_UNIT[header.unit]).tolist()
        return Tone((x, y, z), self.frequency_hz)


def fit_ambient_lines(campaign: Campaign, headers: Mapping[str, SensorHeader]) -> tuple[AmbientLine, ...]:
    """Return the lines at rest that several sensors of a quantity have, and the faint ones of accelerometers that no
    other contradicts.
    """
    return tuple(line for group in _groups(campaign, headers) for line in _ambient_lines(group))


class _Spectrum(NamedTuple):
    """The pooled spectrum of a sensor at rest, in counts, and the rate of its rows."""

    header: SensorHeader
    spectrum: Spectrum
    rows_per_s: float

    @property
    def counts_per_unit(self) -> float:
        """Counts per SI unit."""
        return self.header.sensitivity / SI_PER_UNIT[self.header.unit]

    def power(self, place: float) -> tuple[Floats, Floats]:
        """Power (3,) above the floor at a bin, along its own axes, and its standard deviation by chance."""
        density, rows = self.spectrum.density, self.spectrum.segment_rows
        near = np.abs(np.arange(len(density)) - place) <= HALF_WIDTH
        floor = np.median(density[2:], axis=0)
        power = np.maximum(density[near] - floor, 0.0).sum(axis=0) / rows
        chance = floor / rows * np.sqrt(2 * near.sum() / self.spectrum.freedom[near].mean())
        return power / self.counts_per_unit**2, chance / self.counts_per_unit**2


def _groups(campaign: Campaign, headers: Mapping[str, SensorHeader]) -> list[list[_Spectrum]]:
    """Return the spectra of sensors of one quantity whose rows come at the same rate, and have the same bins."""
    groups: list[list[_Spectrum]] = []
    for name, header in headers.items():
        rests = [rest for log in campaign.logs for rest in log.still(name) if rest.intervals.count]
        spectrum = pool_spectra([rest.spectrum for rest in rests])
        if spectrum is None or not header.sensitivity:
            continue
        longest = max(rests, key=lambda rest: rest.rows)
        member = _Spectrum(header, spectrum, 1 / longest.intervals.mean_s)
        for group in groups:
            first = group[0]
            is_same_rate = abs(member.rows_per_s / first.rows_per_s - 1) < _SAME_RATE
            is_same_grid = is_same_rate and spectrum.segment_rows == first.spectrum.segment_rows
            if is_same_grid and header.quantity == first.header.quantity:
                group.append(member)
                break
        else:
            groups.append([member])
    return groups


def _ambient_lines(group: Sequence[_Spectrum]) -> Iterator[AmbientLine]:
    known: list[float] = []
    lines = [
        (member, line)
        for member in group
        for line in highest_lines(member.spectrum, _LINES)
        if line.height.max() > _HIGH
    ]
    for member, line in sorted(lines, key=lambda item: -float(item[1].height.max())):
        if any(abs(line.bin - place) <= HALF_WIDTH + 1 for place in known):
            continue
        known.append(line.bin)
        amplitude_box = _amplitude_box(member, line)
        others = [other for other in group if other is not member]
        if any(_contradicts(other, line.bin, amplitude_box) for other in others):
            continue
        is_confirmed = any(_confirms(other, line.bin, amplitude_box) for other in others)
        is_faint = member.header.quantity == "specific_force" and amplitude_box.max() <= MOST_G * STANDARD_GRAVITY
        if is_confirmed or is_faint:
            x, y, z = amplitude_box.tolist()
            hertz = line.bin * member.rows_per_s / member.spectrum.segment_rows
            yield AmbientLine(hertz, (x, y, z), tuple(item.header.name for item in group))


def _amplitude_box(member: _Spectrum, line: Line) -> Floats:
    """Amplitudes (3,) in SI units along the box axes by one sensor."""
    power = np.maximum(line.power, 0.0) / member.counts_per_unit**2
    return np.asarray(np.abs(np.array(member.header.orientation)) @ np.sqrt(2 * power))


def _confirms(other: _Spectrum, place: float, amplitude_box: Floats) -> bool:
    """Return whether a sensor has the line too: along the axis along which it is strongest, and as strong there."""
    expected = (np.abs(np.array(other.header.orientation)).T @ amplitude_box) ** 2 / 2
    power, chance = other.power(place)
    axis = int(np.argmax(expected))
    is_there = power[axis] > _HIGH * chance[axis]
    return bool(is_there and expected[axis] / _CONFIRMED < power[axis] < expected[axis] * _CONFIRMED)


def _contradicts(other: _Spectrum, place: float, amplitude_box: Floats) -> bool:
    """Return whether a sensor that would show the line does not."""
    expected = (np.abs(np.array(other.header.orientation)).T @ amplitude_box) ** 2 / 2
    power, chance = other.power(place)
    axis = int(np.argmax(expected / np.where(chance > 0, chance, np.inf)))
    in_phase = 2 * expected[axis] / math.sqrt(max(other.spectrum.segments, 1))  # noise in phase with the line
    scatter = math.sqrt(chance[axis] * (chance[axis] + in_phase))
    is_less = expected[axis] - power[axis] > _SURE * scatter
    return bool(is_less and power[axis] < _CONTRADICTED * expected[axis])

"""Spectral lines from the surroundings that sensors measure at rest, for example of a fan, an engine or a transformer.

A line in a sensor's spectrum is a nuisance quantity if another sensor of the same quantity measures it too, with the
same amplitude along the axes of the box. A faint line of an accelerometer is also a nuisance quantity unless another
sensor, or all others together, contradict it, which means that their noise and rate would show the line but do not. If
the others would not show it, a line of some milli-g counts as faint: its origin cannot be determined. A line that
others contradict, and a strong line that no other sensor confirms, is not modelled here; it can be explained by an
effect. A faint line of any sensor at a frequency of the mains, or at its alias, is a nuisance quantity of this sensor
alone, since wires pick it up; so is a faint line of a magnetometer, which measures every current nearby. The broad
maximum of a wander that sensors share, as of a supply, at the lowest frequencies of a spectrum is no line.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.characterise.spectrum import Spectrum
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.lines import (
    HALF_WIDTH,
    Line,
    floor_of,
    highest_lines,
    multiples_of_mains,
    pool_spectra,
)
from imuarray.log.format import SensorHeader
from imuarray.simulate.effects.noise import Tone
from imuarray.units import SI_PER_UNIT, STANDARD_GRAVITY

MOST_G = 6e-4
"""Largest usual amplitude along an axis of the box, in g: tables in rooms with machines vibrate with some tenths of a
milli-g.
"""

MOST_ALONE_G = 3e-3
"""The same if no other sensor would show the line. A fan or a compressor on the same table causes some milli-g, and a
single accelerometer does not tell them from an error of its own.
"""

MOST_FACTOR = 1.6
"""Largest ratio of the amplitude in a replicate to the measured one; the least is 0, since machines switch on and off.
"""

MOST_PICKED_UP = 0.15
"""Largest usual amplitude of a line that a single sensor picks up, as a share of the standard deviation of its
noise.
"""

_LINES = 4
"""Number of lines of each sensor that are considered, the highest first: a machine has harmonics."""

_HIGH = 5.0
"""Least height of a line above its neighbours, in standard deviations."""

_CONTRADICTED, _SURE = 0.25, 4.0
"""Another sensor contradicts a line if it measures less than this share of its power, and if the power is lower than
expected by at least this number of standard deviations.
"""

_CONFIRMED = 2.0
"""Largest ratio of powers at which another sensor confirms a line: chips differ in bandwidth and scale."""

_LOWEST = 6
"""Number of the lowest bins, in which the width of a line does not show on its lower side."""

_BROAD = 0.12
"""Share of the excess at the peak that the excess beyond the width of a line may have at the lowest frequencies. That
of a line is 0, of a first-order wander 0.14 to 0.45.
"""

_SAME_RATE = 0.01
"""Relative difference of row rates below which bins of spectra have the same frequency."""


@dataclass(frozen=True)
class AmbientLine:
    """A line at `frequency_hz`, possibly an alias at the rate of the rows, with amplitudes `amplitude_box` (3,) in SI
    units along the axes of the box, and the sensors that it is simulated for.
    """

    frequency_hz: float
    amplitude_box: tuple[float, float, float]
    sensors: tuple[str, ...]

    def tone(self, header: SensorHeader, factor: float) -> Tone:
        """Return the line as one of the sensors measures it, with amplitudes multiplied by `factor`."""
        own = np.abs(np.array(header.orientation)).T @ np.array(self.amplitude_box)
        x, y, z = (own * factor / SI_PER_UNIT[header.unit]).tolist()
        return Tone((x, y, z), self.frequency_hz)


def fit_ambient_lines(campaign: Campaign, headers: Mapping[str, SensorHeader]) -> tuple[AmbientLine, ...]:
    """Return the lines at rest that several sensors of a quantity have in common, and the faint lines of accelerometers
    that no other sensor contradicts, and the mains that one sensor picks up.
    """
    return tuple(line for group in _groups(campaign, headers) for line in _ambient_lines(group))


class _Peak(NamedTuple):
    """The peak of a line: `bins` (n,) of the spectrum, and their `shares` (n,) of its power."""

    bins: Indices
    shares: Floats


class _Spectrum(NamedTuple):
    """The pooled spectrum of a sensor at rest, in counts, and the rate of its rows."""

    header: SensorHeader
    spectrum: Spectrum
    rows_per_s: float

    @property
    def counts_per_unit(self) -> float:
        """Counts per SI unit."""
        return self.header.sensitivity / SI_PER_UNIT[self.header.unit]

    def power(self, peak: _Peak) -> tuple[Floats, Floats]:
        """Return the power (3,) of a line along the sensor's own axes, in squared SI units, by least squares over the
        bins of its peak, and its standard deviation for noise alone.
        """
        density, rows = self.spectrum.density, self.spectrum.segment_rows
        floor, square = np.median(density[2:], axis=0), peak.shares @ peak.shares
        power = np.maximum(peak.shares @ (density[peak.bins] - floor) / square, 0.0) / rows
        chance = floor / rows * np.sqrt(2 / (square * self.spectrum.freedom[peak.bins].mean()))
        return power / self.counts_per_unit**2, chance / self.counts_per_unit**2


def _groups(campaign: Campaign, headers: Mapping[str, SensorHeader]) -> list[list[_Spectrum]]:
    """Group the spectra of sensors of one quantity that have the same row rate and the same bins."""
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
        if _is_wander(member.spectrum, line):
            known += range(_LOWEST)
            continue
        hertz = line.bin * member.rows_per_s / member.spectrum.segment_rows
        if (picked_up := _picked_up(member, line, hertz)) is not None:  # other sensors have lines of their own there
            yield picked_up
            continue
        known.append(line.bin)
        peak, others = _peak(member.spectrum, line), [other for other in group if other is not member]
        amplitude_box = _amplitude_box(member, peak)
        if any(_contradict(some, peak, amplitude_box) for some in (others, *([other] for other in others))):
            continue
        is_confirmed = any(_confirms(other, peak, amplitude_box) for other in others)
        is_alone = not _joint_power(others, peak, amplitude_box).would_show
        most_g = MOST_ALONE_G if is_alone else MOST_G
        is_faint = member.header.quantity == "specific_force" and amplitude_box.max() <= most_g * STANDARD_GRAVITY
        if is_confirmed or is_faint:
            x, y, z = amplitude_box.tolist()
            yield AmbientLine(hertz, (x, y, z), tuple(item.header.name for item in group))


def _picked_up(member: _Spectrum, line: Line, hertz: float) -> AmbientLine | None:
    """Return a faint line that only one sensor measures, of the mains or of a current near a magnetometer; None if the
    line is another one.
    """
    bin_hz = member.rows_per_s / member.spectrum.segment_rows
    amplitude_box = _amplitude_box(member, _peak(member.spectrum, line))
    own = np.abs(np.array(member.header.orientation)).T @ amplitude_box
    noise = np.sqrt(member.spectrum.density[1:].mean(axis=0)) / member.counts_per_unit
    is_magnetic = member.header.quantity == "magnetic_field"
    if (own > MOST_PICKED_UP * noise).any():
        return None
    if not is_magnetic and not multiples_of_mains(hertz, bin_hz, member.rows_per_s):
        return None
    x, y, z = amplitude_box.tolist()
    return AmbientLine(hertz, (x, y, z), (member.header.name,))


def _is_wander(spectrum: Spectrum, line: Line) -> bool:
    """Return whether a line among the lowest bins, where only the higher frequencies show its width, is broad."""
    peak, width = round(line.bin), HALF_WIDTH + 1
    if peak >= _LOWEST or len(spectrum.density) < peak + 2 * width:
        return False
    excess = spectrum.density - floor_of(spectrum.density)
    beyond = excess[peak + width : peak + 2 * width].mean(axis=0)
    return bool(beyond @ excess[peak] > _BROAD * excess[peak] @ excess[peak])


def _peak(spectrum: Spectrum, line: Line) -> _Peak:
    """Return the peak of a line along the axis along which it is highest."""
    bins = np.flatnonzero(np.abs(np.arange(len(spectrum.density)) - line.bin) <= HALF_WIDTH)
    excess = np.maximum(spectrum.density - floor_of(spectrum.density), 0.0)[bins, int(line.height.argmax())]
    return _Peak(bins, excess / excess.sum())


def _amplitude_box(member: _Spectrum, peak: _Peak) -> Floats:
    """Return the amplitudes (3,) of a line in SI units along the box axes, measured by one sensor."""
    power, _ = member.power(peak)
    return np.asarray(np.abs(np.array(member.header.orientation)) @ np.sqrt(2 * power))


def _confirms(other: _Spectrum, peak: _Peak, amplitude_box: Floats) -> bool:
    """Return whether a sensor measures the same line, with a power within `_CONFIRMED`, along the axis along which it
    is strongest.
    """
    expected = (np.abs(np.array(other.header.orientation)).T @ amplitude_box) ** 2 / 2
    power, chance = other.power(peak)
    axis = int(np.argmax(expected))
    is_there = power[axis] > _HIGH * chance[axis]
    return bool(is_there and expected[axis] / _CONFIRMED < power[axis] < expected[axis] * _CONFIRMED)


def _contradict(others: Sequence[_Spectrum], peak: _Peak, amplitude_box: Floats) -> bool:
    """Return whether sensors together do not measure the line although it would be significant."""
    joint = _joint_power(others, peak, amplitude_box)
    return bool(1 - joint.measured > _SURE * joint.scatter and joint.measured < _CONTRADICTED)


class _JointPower(NamedTuple):
    """Power of a line in all axes of some sensors together, as a share of that expected from its amplitude: `measured`,
    its standard deviation with the line, `scatter`, and with `noise` alone.
    """

    measured: float
    scatter: float
    noise: float

    @property
    def would_show(self) -> bool:
        """True if the sensors would show the line."""
        return self.noise * _SURE < 1


def _joint_power(others: Sequence[_Spectrum], peak: _Peak, amplitude_box: Floats) -> _JointPower:
    """Return the power of a line with amplitudes (3,) along the axes of the box in the spectra of sensors, with the
    weights of least squares.
    """
    square = product = variance = 0.0
    for other in others:
        expected = (np.abs(np.array(other.header.orientation)).T @ amplitude_box) ** 2 / 2
        power, chance = other.power(peak)
        known = chance > 0
        weight = np.divide(expected, chance**2, out=np.zeros(3), where=known)
        in_phase = 2 * expected / math.sqrt(max(other.spectrum.segments, 1))  # noise in phase with the line
        square += float(weight @ expected)
        product += float(weight @ power)
        variance += float(weight**2 @ (chance * (chance + in_phase)))
    if not square > 0:
        return _JointPower(math.nan, math.nan, math.inf)
    return _JointPower(product / square, math.sqrt(variance) / square, 1 / math.sqrt(square))

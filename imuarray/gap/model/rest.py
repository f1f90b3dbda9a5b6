"""What one sensor's phases at rest say of it: noise, offset, slope with temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.effects.white_noise import WhiteNoise
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.signal import Triple
from imuarray.units import SI_PER_UNIT

Floats = npt.NDArray[np.float64]

REFERENCE_DEGC = 25.0
"""Biases hold here, as those of the data sheets do."""

_LEAST_ROWS = 4
"""Segments of fewer rows say nothing of a variance."""

_LEAST_DEGC = 1.0
"""A smaller span of temperatures, all on one face in one log, says nothing of a slope."""

_ADDED, _LARGEST = 0.3, 64.0
"""Share of a variance that has to be left if something was added to it; largest change of one that was scaled."""

_TOLD = 0.02
"""Two variances so far apart, as a share of the larger one, tell what a simulation makes of a third."""

_COLUMN = {"specific_force": "force_box", "angular_rate": "rate_box", "magnetic_field": "field_box"}


@dataclass(frozen=True)
class FittedParameters:
    """One sensor's parameters in its unit along its own axes: `rms` without that of rounding, `offset` at 25 degC,
    `slope` per degC; all zero for one that never was at rest.
    """

    rms: Triple
    offset: Triple
    slope: Triple

    def effects(self) -> tuple[Effect, ...]:
        """As the simulator has them."""
        return WhiteNoise(self.rms), Bias(self.offset), ThermalBias(self.slope, reference_degc=REFERENCE_DEGC)

    def moved(self, wanted: FittedParameters, came: Sequence[FittedParameters]) -> FittedParameters:
        """These parameters, changed by what fits of their simulations, which `came`, lack on average of `wanted`.

        What is missing of the noise's variance is added, unless that leaves little or nothing of it: then the
        simulation scales the noise, and it is scaled back. Offsets are taken to come out larger by as much as it does.
        """
        own, mean = np.square(self.rms), np.mean([np.square(one.rms) for one in came], axis=0)
        gain = np.clip(np.divide(mean, own, out=np.ones(3), where=own > 0), 1 / _LARGEST, _LARGEST)
        added = own + np.square(wanted.rms) - mean
        ratio = np.divide(np.square(wanted.rms), mean, out=np.ones(3), where=mean > 0)
        is_added = added > _ADDED * own
        squares = np.where(is_added, added, own * np.clip(ratio, 1 / _LARGEST, _LARGEST))
        gain = np.where(is_added, 1.0, gain)
        offset = np.subtract(wanted.offset, np.mean([one.offset for one in came], axis=0)) / np.sqrt(gain)
        slope = np.subtract(wanted.slope, np.mean([one.slope for one in came], axis=0)) / np.sqrt(gain)
        return FittedParameters(
            _triple(np.sqrt(np.maximum(squares, 0.0))),
            _triple(np.add(self.offset, offset)),
            _triple(np.add(self.slope, slope)),
        )

    def between(
        self,
        wanted: FittedParameters,
        came: Sequence[FittedParameters],
        before: FittedParameters,
        came_before: Sequence[FittedParameters],
    ) -> FittedParameters:
        """`moved` once more, the noise by a straight line through both simulations, of these parameters and of those
        `before`: whatever the simulation adds to the noise's variance and scales it by.
        """
        own, last = np.square(self.rms), np.square(before.rms)
        mean, mean_before = (np.mean([np.square(one.rms) for one in some], axis=0) for some in (came, came_before))
        told = np.abs(own - last) > _TOLD * np.maximum(own, last)
        gain = np.divide(mean - mean_before, own - last, out=np.ones(3), where=told)
        gain = np.clip(gain, 1 / _LARGEST, _LARGEST)
        squares = np.maximum(own + (np.square(wanted.rms) - mean) / gain, own / _LARGEST**2)
        found = self.moved(wanted, came)
        return replace(found, rms=_triple(np.sqrt(np.where(told, squares, np.square(found.rms)))))

    def noise(self, header: SensorHeader) -> Floats:
        """(3,) standard deviation of readings, rounding included."""
        return np.asarray(np.sqrt(np.square(self.rms) + rounding_lsb2(header) / header.sensitivity**2))

    def adds(self, summary: Summary) -> Floats:
        """(s, 3) what the sensor adds to what is felt in each segment, in its unit."""
        warm = (summary.segments.temperature_degc - REFERENCE_DEGC)[:, None]
        return np.asarray(np.array(self.offset) + warm * np.array(self.slope))

    def felt_by(self, summary: Summary) -> Floats:
        """(3,) mean of the readings without what the sensor adds."""
        part = summary.segments
        held = part.rows > 0
        apart = part.mean[held] / summary.header.sensitivity - self.adds(summary)[held]
        return np.asarray(np.average(apart, axis=0, weights=part.rows[held]))


@dataclass(frozen=True)
class Rest:
    """The segments of one phase at rest that hold rows: (s,) rows, temperatures; (s, 3) readings less what is felt, in
    the sensor's unit, and their variances in counts. Phases of one `group` are of one log and face, or pose.
    """

    group: tuple[int, str]
    rows: npt.NDArray[np.int64]
    degc: Floats
    apart: Floats
    variance: Floats


def felt(summary: Summary, motion: Motion, force_box: Floats | None) -> Floats:
    """(s, 3) what the nominal axes feel at the segments' mean times, in the sensor's unit; the force is `force_box`
    (3,), if that is given.
    """
    if force_box is not None and summary.header.quantity == "specific_force":
        return _along(np.broadcast_to(force_box, (len(summary.segments.rows), 3)), summary.header)
    kept: dict[str, tuple[Motion, Floats]] = vars(summary)  # a fit asks, and who takes off what it predicts
    if "felt" not in kept or kept["felt"][0] is not motion:
        kept["felt"] = (motion, _felt(summary, motion))
    return kept["felt"][1]


def _felt(summary: Summary, motion: Motion) -> Floats:
    part = summary.segments
    at_ns = np.rint(np.where(part.rows > 0, part.time_s, 0.0) * 1e9).astype(np.int64)
    return _along(np.asarray(getattr(motion.felt(at_ns), _COLUMN[summary.header.quantity]), float), summary.header)


def _along(vectors_box: Floats, header: SensorHeader) -> Floats:
    unit = 1.0 if header.quantity == "magnetic_field" else 1 / SI_PER_UNIT[header.unit]  # a field comes in gauss
    return np.asarray(vectors_box @ np.array(header.orientation) * unit)


def fitted_to(header: SensorHeader, phases: Sequence[Rest]) -> FittedParameters:
    """What the phases of one sensor say: noise is the median of their segments' variances; offset the mean of readings
    less what is felt, faces weighted alike; slope that over temperature. All zero without phases.
    """
    if not phases:
        return FittedParameters(*((0.0, 0.0, 0.0),) * 3)
    slope = _slope(phases)
    warm = [phase.apart - (phase.degc - REFERENCE_DEGC)[:, None] * slope for phase in phases]
    faces: dict[str, list[Floats]] = {}
    for phase, apart in zip(phases, warm, strict=True):
        faces.setdefault(phase.group[1], []).append(np.average(apart, axis=0, weights=phase.rows))
    offset = np.mean([np.mean(means, axis=0) for means in faces.values()], axis=0)
    return FittedParameters(_triple(_rms_lsb(header, phases) / header.sensitivity), _triple(offset), slope)


def _rms_lsb(header: SensorHeader, phases: Sequence[Rest]) -> Floats:
    """Root of the median over segments of the variance, less step^2 / 12 of rounding (Sheppard's correction).

    The median of a variance of nu degrees of freedom is (1 - 2 / (9 nu))^3 of its mean (Wilson and Hilferty, PNAS 17,
    1931); few glitches or jumps don't move it.
    """
    rows = np.concatenate([phase.rows for phase in phases])
    variance = np.concatenate([phase.variance for phase in phases])
    held = rows >= _LEAST_ROWS
    if not held.any():
        return np.zeros(3)
    freedom = rows[held, None] - 1.0
    unbiased = variance[held] * rows[held, None] / freedom / (1 - 2 / (9 * freedom)) ** 3
    return np.asarray(np.sqrt(np.maximum(np.median(unbiased, axis=0) - rounding_lsb2(header), 0.0)))


def _slope(phases: Sequence[Rest]) -> Triple:
    """Per degC; 0 where no face of a log was at temperatures that differ enough."""
    products, squares = np.zeros(3), 0.0
    for group in dict.fromkeys(phase.group for phase in phases):
        members = [phase for phase in phases if phase.group == group]
        rows, degc, apart = (
            np.concatenate([getattr(phase, name) for phase in members]) for name in ("rows", "degc", "apart")
        )
        if np.ptp(degc) >= _LEAST_DEGC:
            warm = degc - np.average(degc, weights=rows)
            products += (rows * warm) @ apart
            squares += float(rows @ warm**2)
    return _triple(products / squares) if squares > 0 else (0.0, 0.0, 0.0)


def rounding_lsb2(header: SensorHeader) -> float:
    """Variance of rounding to the codes that come, step^2 / 12."""
    return code_span(header).step ** 2 / 12


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z

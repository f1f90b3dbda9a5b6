"""The base model: what a simulation has before anything is blamed, its few parameters fitted to a campaign's summaries.

Every sensor has `white_noise`, `bias` and a linear `thermal_bias`, fitted; `scale` and `misalignment` are drawn anew
for every replicate from the population of its chip, since no log in one attitude tells them from a bias.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from imuarray.gap.campaign import Campaign, LogSummary, PhaseSummary
from imuarray.gap.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.shipped import configs
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.effects.white_noise import WhiteNoise
from imuarray.simulate.model import Model, Part, load_model
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.population import Recipe, Spread
from imuarray.simulate.signal import Triple
from imuarray.simulate.streams import Streams
from imuarray.units import SI_PER_UNIT

Floats = npt.NDArray[np.float64]

REFERENCE_DEGC = 25.0
"""Biases hold here, as those of the data sheets do."""

SCALE_SIGMA, ANGLE_SIGMA_DEG = 0.01, 0.5
"""Population of a chip whose data sheet names none."""

_POPULATION = ("scale", "misalignment")
_FITTED = frozenset({"white_noise", "bias", "thermal_bias"})
_LEAST_ROWS = 4
"""Segments of fewer rows say nothing of a variance."""

_LEAST_DEGC = 1.0
"""A smaller span of temperatures, all on one face in one log, says nothing of a slope."""

_COLUMN = {"specific_force": "force_box", "angular_rate": "rate_box", "magnetic_field": "field_box"}


@dataclass(frozen=True)
class Fitted:
    """One sensor's parameters in its unit along its own axes: `rms` without that of rounding, `offset` at 25 degC,
    `slope` per degC; all zero for one that never was at rest.
    """

    rms: Triple
    offset: Triple
    slope: Triple

    def effects(self) -> tuple[Effect, ...]:
        """As the simulator has them."""
        return WhiteNoise(self.rms), Bias(self.offset), ThermalBias(self.slope, reference_degc=REFERENCE_DEGC)

    def moved(self, wanted: Fitted, came: Sequence[Fitted]) -> Fitted:
        """These parameters, changed by what fits of their simulations, which `came`, lack on average of `wanted`."""
        squares = np.square(self.rms) + np.square(wanted.rms) - np.mean([np.square(one.rms) for one in came], axis=0)
        offset = np.add(self.offset, wanted.offset) - np.mean([one.offset for one in came], axis=0)
        slope = np.add(self.slope, wanted.slope) - np.mean([one.slope for one in came], axis=0)
        return Fitted(_triple(np.sqrt(np.maximum(squares, 0.0))), _triple(offset), _triple(slope))

    def noise(self, header: SensorHeader) -> Floats:
        """(3,) standard deviation of readings, rounding included."""
        return np.asarray(np.sqrt(np.square(self.rms) + rounding_lsb2(header) / header.sensitivity**2))


@dataclass(frozen=True)
class Base:
    """The fitted sensors by name; `model` has the rest of their effects (None: the data sheets' scale and misalignment
    are all), of which populations are drawn; `seed` keys the draws.
    """

    headers: Mapping[str, SensorHeader]
    fitted: Mapping[str, Fitted]
    model: Model | None = None
    seed: int = 0

    def effects(self, replicate: int) -> dict[str, tuple[Effect, ...]]:
        """The effects of every sensor; `replicate` 0, 1, ... numbers the units that are drawn."""
        units = Streams(replicate_seed(self.seed, replicate))
        return {
            name: (*self._drawn(self.headers[name], units), *fitted.effects()) for name, fitted in self.fitted.items()
        }

    def _drawn(self, header: SensorHeader, units: Streams) -> tuple[Effect, ...]:
        """What isn't fitted."""
        if self.model is None:
            return tuple(_typical(header, units))
        return self.model.effects(header, units, without=_FITTED)


def fit(campaign: Campaign, motions: Sequence[Motion], *, model: Model | None = None, seed: int = 0) -> Base:
    """The base model of a campaign in whose logs the box did `motions`, one for each log.

    From the segments of the phases at rest: noise is the median of their variances; offset the mean of readings less
    what the nominal axes feel, faces weighted alike (opposite ones cancel an error of scale); slope that of the means
    over temperature, each log and face about its own mean. A `model` gives the other effects; what these add to noise
    or level is in the fitted figures as well (`imuarray.gap.null.settled` takes it out).
    """
    headers = headers_in(campaign)
    fitted = {name: _fitted(header, list(_at_rest(campaign, motions, name))) for name, header in headers.items()}
    return Base(headers, fitted, model, seed)


def headers_in(campaign: Campaign) -> dict[str, SensorHeader]:
    """What is known of each sensor of a campaign."""
    phases = (phase for log in campaign.logs for phase in log.phases)
    return {name: summary.header for phase in phases for name, summary in phase.sensors.items()}


def residual(campaign: Campaign, motions: Sequence[Motion], base: Base) -> Campaign:
    """The campaign with what `base` predicts of the phases at rest taken from the means of their segments: what is
    left of a level, a slope or a face is what the fit doesn't explain, whatever its parameters are.
    """
    return Campaign(
        tuple(_without(log, motion, base) for log, motion in zip(campaign.logs, motions, strict=True)),
    )


def rounding_lsb2(header: SensorHeader) -> float:
    """Variance of rounding to the codes that come, step^2 / 12."""
    return code_span(header).step ** 2 / 12


def replicate_seed(seed: int, replicate: int) -> int:
    """64 bits for each replicate that no small seed has."""
    high, low = np.random.SeedSequence((seed, replicate)).generate_state(2).tolist()
    return int(high) << 32 | int(low) | 1 << 63


@dataclass(frozen=True)
class _Rest:
    """The segments of one phase at rest that hold rows: (s,) rows, temperatures; (s, 3) readings less what is felt, in
    the sensor's unit, and their variances in counts. Phases of one `group` are of one log and face.
    """

    group: tuple[int, str]
    rows: npt.NDArray[np.int64]
    degc: Floats
    apart: Floats
    variance: Floats


def _at_rest(campaign: Campaign, motions: Sequence[Motion], sensor: str) -> Iterator[_Rest]:
    for number, (log, motion) in enumerate(zip(campaign.logs, motions, strict=True)):
        for summary in log.still(sensor):
            part = summary.segments
            held = part.rows > 0
            if held.any():
                apart = part.mean[held] / summary.header.sensitivity - _felt(summary, motion)[held]
                group = (number, summary.phase.up)
                yield _Rest(
                    group, part.rows[held], part.temperature_degc[held], apart, summary.segments.steady_variance[held]
                )


def _fitted(header: SensorHeader, phases: Sequence[_Rest]) -> Fitted:
    if not phases:
        return Fitted(*((0.0, 0.0, 0.0),) * 3)
    slope = _slope(phases)
    warm = [phase.apart - (phase.degc - REFERENCE_DEGC)[:, None] * slope for phase in phases]
    faces: dict[str, list[Floats]] = {}
    for phase, apart in zip(phases, warm, strict=True):
        faces.setdefault(phase.group[1], []).append(np.average(apart, axis=0, weights=phase.rows))
    offset = np.mean([np.mean(means, axis=0) for means in faces.values()], axis=0)
    return Fitted(_triple(_rms_lsb(header, phases) / header.sensitivity), _triple(offset), slope)


def _rms_lsb(header: SensorHeader, phases: Sequence[_Rest]) -> Floats:
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


def _slope(phases: Sequence[_Rest]) -> Triple:
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


def _felt(summary: Summary, motion: Motion) -> Floats:
    """(s, 3) what the nominal axes feel at the segments' mean times, in the sensor's unit."""
    header = summary.header
    at_ns = np.rint(np.nan_to_num(summary.segments.time_s) * 1e9).astype(np.int64)
    vectors = np.asarray(getattr(motion.felt(at_ns), _COLUMN[header.quantity]), float)
    unit = 1.0 if header.quantity == "magnetic_field" else 1 / SI_PER_UNIT[header.unit]  # a field comes in gauss
    return np.asarray(vectors @ np.array(header.orientation) * unit)


def _without(log: LogSummary, motion: Motion, base: Base) -> LogSummary:
    return replace(log, phases=tuple(_left(phase, motion, base) if phase.is_still else phase for phase in log.phases))


def _left(phase: PhaseSummary, motion: Motion, base: Base) -> PhaseSummary:
    sensors = {name: _less(summary, motion, base.fitted[name]) for name, summary in phase.sensors.items()}
    return replace(phase, sensors=sensors)


def _less(summary: Summary, motion: Motion, fitted: Fitted) -> Summary:
    warm = (summary.segments.temperature_degc - REFERENCE_DEGC)[:, None]
    predicted = _felt(summary, motion) + np.array(fitted.offset) + warm * np.array(fitted.slope)
    mean = summary.segments.mean - predicted * summary.header.sensitivity
    return replace(summary, segments=replace(summary.segments, mean=mean))


def _typical(header: SensorHeader, units: Streams) -> Iterator[Effect]:
    """A draw from the population of the chip, or where its data sheet names none, from the usual one."""
    sheets = data_sheets()
    for kind in _POPULATION:
        model = sheets if kind in sheets.parts(header, population=True) else _usual(header)
        yield from (effect for effect in model.effects(header, units, population=True) if effect.name == kind)


@cache
def data_sheets() -> Model:
    """The shipped model of units as the data sheets describe them."""
    return load_model(configs() / "models" / "datasheet.toml")


def _usual(header: SensorHeader) -> Model:
    effects: Mapping[str, tuple[Recipe, ...]] = {
        "scale": ({"error": Spread(sigma=SCALE_SIGMA)},),
        "misalignment": ({"angles_deg": Spread(sigma=ANGLE_SIGMA_DEG)},),
    }
    return Model("usual", "A chip of which nothing is known.", (Part(header.chip, effects=effects),), ())


def _triple(values: Floats) -> Triple:
    x, y, z = values.tolist()
    return x, y, z

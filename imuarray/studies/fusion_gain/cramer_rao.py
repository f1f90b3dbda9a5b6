"""The Bayesian Cramer-Rao bound of an array whose errors have a known distribution, and the estimate that reaches it.

Reading i of axis k is ``d_k . u(t_i) + c_k(t_i) + w_k(t_i)``. u is unknown in every frame (a flat prior, independent in
time); the slow errors c are jointly normal, the noise w is white. The model is linear and normal, so the bound (Van
Trees, Detection, Estimation, and Modulation Theory, Part I, 1968, section 2.4) equals the posterior covariance and is
reached.

Let N = R^-1/2 whiten the noise, let the columns of V be an orthonormal basis of the complement of the range of N D (the
parity space: m - 3 directions), and let G = (D' R^-1 D)^-1 D' R^-1 be the weights of a single frame. Then::

    y = V' N z = V' N c + unit noise           depends on c and not on u; contains all information on c
    cov u(t)   = (D' R^-1 D)^-1 + G cov(c(t) | y) G'

because G w and V' N w are uncorrelated. Over a stretch in which c is constant, L frames of y are equivalent to their
mean with noise of variance 1 / L, so frames are aggregated without loss, at any rate of the log. c at all stretches is
one normal vector (T m,), which is conditioned on one stretch after the other by dense linear algebra, without a
state-space form or a filter.

The causal bound of a stretch is conditioned on its own and all earlier readings; because these include all readings of
the stretch, it is below the error of a filter within the stretch. The smoothed bound is conditioned on all readings.

`true_calibration` and `law_of` give the true parameters of simulated units: the constant errors (response, bias and its
temperature slope) as a calibration, and the distribution of the errors that change at each switch-on or continuously
(turn-on bias, bias instability, common mode, white noise). The bound holds only for simulations without the effects in
`OUTSIDE`. `Posterior` computes bound and posterior mean over a log.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import BIAS, Drift, Thermal, TurnOn
from imuarray.errors import FusionError
from imuarray.fuse import Frames, FusedBlock, aligned
from imuarray.fuse.frames import entries
from imuarray.fuse.optimal.geometry import patterns
from imuarray.log import Log
from imuarray.log.format import SensorHeader
from imuarray.simulate import EFFECTS
from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias, BiasInstability, CommonMode, TurnOnBias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Misalignment, Scale
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.units import INERTIAL, SI_PER_UNIT


@dataclass(frozen=True)
class SlowError:
    """A slow error ``loading x(t)`` of the m axes, x ~ N(0, 1) at any time, loading (m,) in SI. It belongs to one axis
    or is shared by several. The correlation of x is ``exp(-|t| / time_constant_s)`` (first-order Gauss-Markov; inf: a
    constant, such as turn-on bias). With `per_degc` it is a slope: x is multiplied by the difference of the temperature
    from this reference, in degC.
    """

    loading: Floats
    time_constant_s: float = math.inf
    per_degc: float | None = None


@dataclass(frozen=True)
class ErrorLaw:
    """The law of m axes of one quantity: directions_box (m, 3) unit vectors, noise_si (m,) white noise of a reading
    (including rounding), and their slow errors, independent of each other.
    """

    directions_box: Floats
    noise_si: Floats
    slow: tuple[SlowError, ...] = ()


@dataclass(frozen=True)
class StretchReadings:
    """`frames` frames of one stretch in which the same axes `known` (m,) had a reading; `mean_si` (m,) is the mean of
    their readings, if it is needed.
    """

    known: Booleans
    frames: int
    mean_si: Floats | None = None


@dataclass(frozen=True)
class BoundStretch:
    """Frames around `time_s` in which slow errors and temperature are assumed to be constant."""

    time_s: float
    seen: tuple[StretchReadings, ...]
    temperature_degc: float = 25.0


@dataclass(frozen=True)
class Bound:
    """Posterior covariances of u, means over the frames of each of T stretches: causal and smoothed (T, 3, 3) in SI;
    `frames` (T,). The slow errors have their posterior means (T, m), zero without readings.
    """

    causal: Floats
    smoothed: Floats
    frames: npt.NDArray[np.int64]
    slow_causal: Floats
    slow_smoothed: Floats

    @property
    def causal_rms(self) -> Floats:
        """The smallest rms error (3,) for each box axis of an estimator without future readings."""
        return _rms(self.causal, self.frames)

    @property
    def smoothed_rms(self) -> Floats:
        """The smallest rms error (3,) for each box axis of any estimator."""
        return _rms(self.smoothed, self.frames)


def bound(law: ErrorLaw, stretches: Sequence[BoundStretch]) -> Bound:
    """Return the bound over a log; FusionError if the axes with readings in some frame don't span space."""
    axes, count = len(law.noise_si), len(stretches)
    covariance = slow_covariance(law, stretches)
    mean = np.zeros(count * axes)
    causal, past = np.empty((count, 3, 3)), np.empty((count, axes))
    for number, stretch in enumerate(stretches):
        block = slice(number * axes, (number + 1) * axes)
        for readings in stretch.seen:
            _condition(covariance, mean, block, law, readings)
        causal[number] = _motion_covariance(law, stretch.seen, covariance[block, block])
        past[number] = mean[block]
    blocks = [slice(k * axes, (k + 1) * axes) for k in range(count)]
    smoothed = [
        _motion_covariance(law, stretch.seen, covariance[b, b]) for b, stretch in zip(blocks, stretches, strict=True)
    ]
    frames = np.array([sum(readings.frames for readings in stretch.seen) for stretch in stretches])
    return Bound(causal, np.array(smoothed), frames, past, mean.reshape(count, axes))


def slow_covariance(law: ErrorLaw, stretches: Sequence[BoundStretch]) -> Floats:
    """Return the prior covariance (T m, T m) of the slow errors, stretch after stretch."""
    time_s = np.array([stretch.time_s for stretch in stretches])
    degc = np.array([stretch.temperature_degc for stretch in stretches])
    size = len(time_s) * len(law.noise_si)
    total = np.zeros((size, size))
    for slow in law.slow:
        kernel = np.exp(-np.abs(time_s[:, None] - time_s) / slow.time_constant_s)
        if slow.per_degc is not None:
            kernel *= np.outer(degc - slow.per_degc, degc - slow.per_degc)
        total += np.kron(kernel, np.outer(slow.loading, slow.loading))
    return total


def frame_weights(law: ErrorLaw, present: Booleans) -> tuple[Floats, Floats]:
    """Return the weights G (3, m) of one frame alone, zero for axes without a reading, and its covariance (3, 3);
    FusionError if the axes don't span space.
    """
    rows = law.directions_box / law.noise_si[:, None] * present[:, None]
    normal = rows.T @ rows
    if not np.linalg.cond(normal) < 1e9:
        raise FusionError(f"{int(present.sum())} of {len(present)} axes known in a frame: they don't span space")
    covariance: Floats = np.asarray(np.linalg.inv(normal), float)
    return np.asarray(covariance @ rows.T / law.noise_si), covariance


def _condition(covariance: Floats, mean: Floats, block: slice, law: ErrorLaw, readings: StretchReadings) -> None:
    """Condition the slow errors on the parity space of some frames, in place."""
    whitened = law.directions_box[readings.known] / law.noise_si[readings.known, None]
    basis = np.linalg.svd(whitened)[0][:, 3:]
    if readings.frames == 0 or basis.shape[1] == 0:
        return
    parity = np.zeros((basis.shape[1], len(law.noise_si)))
    parity[:, readings.known] = basis.T / law.noise_si[readings.known]
    cross = covariance[:, block] @ parity.T
    expected = parity @ cross[block] + np.eye(len(parity)) / readings.frames
    gain = np.linalg.solve(expected, cross.T).T
    if readings.mean_si is not None:
        means = np.where(readings.known, readings.mean_si, 0.0)
        mean += gain @ (parity @ (means - mean[block]))
    covariance -= gain @ cross.T


def _motion_covariance(law: ErrorLaw, several: Sequence[StretchReadings], slow: Floats) -> Floats:
    """Return (3, 3) covariance of u, a mean over the frames, for the covariance `slow` (m, m) of the slow errors."""
    total = np.zeros((3, 3))
    for readings in several:
        weights, alone = frame_weights(law, readings.known)
        total += readings.frames * (alone + weights @ slow @ weights.T)
    return np.asarray(total / max(sum(readings.frames for readings in several), 1))


def _rms(covariances: Floats, frames: npt.NDArray[np.int64]) -> Floats:
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    return np.asarray(np.sqrt(frames @ variances / frames.sum()))


_INSIDE = frozenset(
    {
        "misalignment", "scale", "bias", "turn_on_bias", "thermal_bias", "bias_instability", "common_mode",
        "white_noise", "thermometer",
    }
)  # fmt: skip

OUTSIDE = tuple(name for name in EFFECTS if name not in _INSIDE)
"""Effects that the law does not describe."""


def true_calibration(headers: Sequence[SensorHeader], effects: Mapping[str, Sequence[Effect]]) -> Calibration:
    """Return the true parameters of these units as a calibration: all parameters that are the same in every boot,
    without error.
    """
    inertial = {header.name: header for header in headers if header.quantity in INERTIAL}
    sensors = {name: _calibrate(header, effects.get(name, ())) for name, header in inertial.items()}
    return Calibration(sensors, ("the simulated units' own parameters",))


def law_of(headers: Sequence[SensorHeader], effects: Mapping[str, Sequence[Effect]]) -> ErrorLaw:
    """Return the law of the errors that `true_calibration` does not remove, per axis of these sensors (of one
    quantity), in order, in SI along their true axes.
    """
    units = [_calibrate(header, effects.get(header.name, ())) for header in headers]
    noise = np.concatenate([unit.noise_lsb / unit.lsb_per_si for unit in units if unit.noise_lsb is not None])
    rows = np.concatenate([unit.directions_box for unit in units])
    slow: list[SlowError] = []
    shared: dict[tuple[str, int, float], Floats] = {}
    for number, header in enumerate(headers):
        per_si = SI_PER_UNIT[header.unit] / (1 + _triple(effects[header.name], Scale, "error"))
        for effect in effects[header.name]:
            times_s: tuple[float, ...] = (getattr(effect, "time_constant_s", math.inf),)
            if isinstance(effect, BiasInstability):  # independent processes of equal variance
                times_s = effect.time_constants_s
            axes = range(3) if isinstance(effect, TurnOnBias | BiasInstability | CommonMode) else ()
            for axis, time_s in product(axes, times_s):
                loading = np.zeros(3 * len(headers))
                rms = _triple([effect], type(effect), "rms")[axis] / math.sqrt(len(times_s))
                loading[3 * number + axis] = rms * per_si[axis]
                if isinstance(effect, CommonMode):
                    shared.setdefault((header.chip, axis, time_s), np.zeros(len(loading)))[:] += loading
                elif loading.any():
                    slow.append(SlowError(loading, time_s))
    slow += [SlowError(loading, seconds) for (_, _, seconds), loading in shared.items()]
    return ErrorLaw(rows, noise, tuple(slow))


def _calibrate(header: SensorHeader, effects: Sequence[Effect]) -> SensorCalibration:
    gains = 1 + _triple(effects, Scale, "error")
    leaning = next((each.directions for each in effects if isinstance(each, Misalignment)), np.eye(3))
    noise = header.sensitivity * _triple(effects, WhiteNoise, "rms")
    reference_degc = next((each.reference_degc for each in effects if isinstance(each, ThermalBias)), 25.0)
    slope, quadratic = (header.sensitivity * _triple(effects, ThermalBias, name) for name in ("slope", "quadratic"))
    turn_on, drift = (header.sensitivity * _triple(effects, kind, "rms") for kind in (TurnOnBias, BiasInstability))
    time_constant_s = next((each.time_constant_s for each in effects if isinstance(each, BiasInstability)), math.inf)
    return SensorCalibration(
        name=header.name,
        quantity=header.quantity,
        unit=header.unit,
        bias_lsb=header.sensitivity * _triple(effects, Bias, "offset"),
        response_lsb_per_unit=header.sensitivity * gains[:, None] * (leaning @ np.array(header.orientation).T),
        bias_sem_lsb=np.zeros(3),
        response_sem_lsb_per_unit=np.zeros(3),
        noise_lsb=np.sqrt(noise**2 + code_span(header).step ** 2 / 12),  # rounding as independent noise (Sheppard)
        temperature_degc=reference_degc,
        range=header.range,
        thermal=Thermal(
            slope, np.zeros(3), reference_degc, (BIAS,) * 3, "barometer", quadratic_lsb_per_degc2=quadratic
        ),
        turn_on=TurnOn(turn_on, np.zeros(3), turn_on, np.full(3, np.nan), runs=0),
        drift=Drift(drift, np.zeros(3), time_constant_s),
        g_sensitivity_lsb_per_g=np.zeros((3, 3)) if header.quantity == "angular_rate" else None,
        g_sensitivity_sem_lsb_per_g=np.zeros((3, 3)) if header.quantity == "angular_rate" else None,
    )


def _triple(effects: Sequence[Effect], kind: type[Effect], name: str) -> Floats:
    """Return a parameter (3,) of the effects of one kind: their root sum of squares or their sum; zero without any."""
    result = np.array([np.zeros(3), *(getattr(effect, name) for effect in effects if isinstance(effect, kind))])
    return np.asarray(np.sqrt((result**2).sum(axis=0)) if name == "rms" else result.sum(axis=0))


STRETCHES = 60
"""Number of stretches of a log; those of the longest log last 11 s. Slow errors of the simulated array have time
constants of 600 s. About its mean over 11 s, this error has 11 / 600 / 3 = 0.6 % of its variance, which is itself small
compared with the noise.
"""


class Posterior:
    """The bounds of both quantities over a log with a true calibration, whose errors follow `laws`."""

    def __init__(
        self, log: Log, calibration: Calibration, laws: Mapping[str, ErrorLaw], names: Sequence[str] = ()
    ) -> None:
        """`laws` by quantity over the axes of the log's sensors (or of those in `names`), in the log's order."""
        self._log, self._calibration, self._laws = log, calibration, laws
        selected = {quantity: log.of(quantity, names) for quantity in laws}
        self._sensors = {quantity: sensors for quantity, sensors in selected.items() if sensors}
        rows = [sensor for sensors in self._sensors.values() for sensor in sensors]
        first_ns, last_ns = min(int(s.time[0]) for s in rows), max(int(s.time[-1]) for s in rows)
        self._edges = np.linspace(first_ns, last_ns + 1, STRETCHES + 1)
        self.bounds: dict[str, Bound] = {
            quantity: bound(laws[quantity], self._stretches(quantity)) for quantity in self._sensors
        }

    def blocks(self, *, smoothed: bool = False) -> Iterator[FusedBlock]:
        """Yield the posterior mean of each frame with its covariance, the bound."""
        for frames in self._frames():
            result = {quantity: self._estimate(quantity, part, smoothed) for quantity, part in frames.items()}
            triads = {quantity: triad for quantity, (triad, _) in result.items()}
            time = next(iter(frames.values())).time
            yield FusedBlock(time, triads, {quantity: covariance for quantity, (_, covariance) in result.items()})

    def _frames(self) -> Iterator[Mapping[str, Frames]]:
        names = [sensor.name for sensors in self._sensors.values() for sensor in sensors]
        return (frames for frames, _ in aligned(self._log, self._calibration, only=names))

    def _stretches(self, quantity: str) -> list[BoundStretch]:
        """Return the readings of each stretch, separately for each pattern of axes that had a reading."""
        sums: list[dict[bytes, tuple[int, Floats]]] = [{} for _ in range(STRETCHES)]
        for part in (frames[quantity] for frames in self._frames()):
            present, stretch = axes_known(part), self._stretch_of(part.time)
            for number in np.unique(stretch).tolist():
                for pattern, rows in _patterns(present, stretch == number):
                    count, total = sums[number].get(pattern.tobytes(), (0, np.zeros(len(pattern))))
                    sums_si = np.where(pattern, part.values[rows], 0.0).sum(axis=0)
                    sums[number][pattern.tobytes()] = count + len(rows), total + sums_si
        middle_s = (self._edges[:-1] + self._edges[1:]) / 2e9
        return [
            BoundStretch(
                time_s,
                tuple(StretchReadings(np.frombuffer(key, bool), n, total / n) for key, (n, total) in readings.items()),
            )
            for time_s, readings in zip(middle_s.tolist(), sums, strict=True)
        ]

    def _stretch_of(self, time: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        return np.clip(np.searchsorted(self._edges, time, side="right") - 1, 0, STRETCHES - 1)

    def _estimate(self, quantity: str, part: Frames, smoothed: bool) -> tuple[Floats, Floats]:
        law, present, stretch = self._laws[quantity], axes_known(part), self._stretch_of(part.time)
        slow = self.bounds[quantity].slow_smoothed if smoothed else self.bounds[quantity].slow_causal
        covariances = self.bounds[quantity].smoothed if smoothed else self.bounds[quantity].causal
        triad = np.empty((len(stretch), 3))
        for pattern, rows in _patterns(present, np.ones(len(present), bool)):
            weights, _ = frame_weights(law, pattern)
            triad[rows] = np.where(pattern, part.values[rows] - slow[stretch[rows]], 0.0) @ weights.T
        return triad, entries(covariances)[stretch]


def axes_known(part: Frames) -> Booleans:
    """Return (n, m) whether an axis had a reading: it is valid, or it is within its range while another axis of its
    triad is beyond.
    """
    if part.clipped is None or not part.clipped.any():
        return part.valid
    triads = (part.clipped != 0).reshape(len(part.clipped), -1, 3)
    neighbours = triads.any(axis=2, keepdims=True) & ~triads
    return np.asarray(part.valid | neighbours.reshape(part.valid.shape))


def _patterns(known: Booleans, chosen: Booleans) -> Iterator[tuple[Booleans, npt.NDArray[np.int64]]]:
    """Yield each pattern of known axes among the chosen frames, and the frames (their numbers) that have it."""
    rows = np.flatnonzero(chosen)
    for pattern, which in patterns(known[rows]):
        yield pattern, rows[which]

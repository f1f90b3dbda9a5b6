"""Change of calibrated responses (scale and direction) from the calibration to a motion: one model for all techniques.

A calibrated response holds for the temperature and the rates of its calibration. In another motion each of its elements
differs by nonlinearity and temperature. `response_shares` adds the variance of that change to what the calibration
leaves unknown, in the covariance of every technique and in the prior of `optimal`. Its size is that of the
calibration's `response_change`, else `RESPONSE_CHANGE`.

A log in which the box turns shows the size: sensors whose responses changed disagree in proportion to the stimulus.
`with_response_change` estimates it. Windows of `WINDOW_S` have mean readings y (m,) along calibrated directions S::

    y = (S + D) u + bias + noise,        z = B y,   B S = 0,   B (covariance of noise) S' = 0

D (m, 3) are the relative errors of the responses and z the parities, whose noise is independent of that of the weighted
least-squares u. Least squares of z over u and its derivative (which different delays add) yields B D. Its covariance is
that of the calibration, transformed by B, plus ``change^2 B B'`` and that of noise; the mean of ``change^2`` under
this likelihood and the prior is the estimate (C. M. Bishop, Pattern Recognition and Machine Learning, 2006, section
3.5). z contains no error that all sensors share. Accelerometers at different positions measure different forces in a
rotation: for them, only windows in which gyroscopes show rest are used.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.response_transfer import Calibrated
from imuarray.log import Log
from imuarray.robust import MEDIAN_SQUARE
from imuarray.units import INERTIAL, STANDARD_GRAVITY

RESPONSE_CHANGE = 2e-3
"""Standard deviation by which each element of a response (scale or direction, relative to the scale) differs in a
motion from what was calibrated, if nothing else is known: nonlinearity (L3G-73: 0.2 % of the range; BMA-117: 0.15 to
0.75 %; ADX-65: 0.5 %) and another temperature.

Without it `optimal` amplifies errors of responses. Calibrations leave the same combination u of elements uncertain for
every sensor, for example the axes x and z about Y, by 1 %; other combinations are uncertain by 1e-5. The parities do
not contain an error c that all sensors share along u: they show ``c_i u_i - c_j u_j``. But the fitted u_i of the
sensors differ by some 1e-3, so the parities seem to determine c, as the difference of two sensors over ``u_i - u_j``,
and an unmodelled difference of 5e-4 becomes an error of 5 % of the angular rate.

A response whose standard errors are all 0 is exact, as in a study that knows the truth, and does not change.
"""

_STRETCHES = 5
_STRETCH_S = 60.0
"""Number, and length in s, of the parts of a log that are read; their biases and temperatures count as constant."""

_FEWEST = 100
"""Least number of windows for an estimate."""

_EXCITED = 1000.0
"""Least variance of the stimulus along a direction, in variances of its noise: in a slower motion, a change of
`RESPONSE_CHANGE` is hidden by noise.
"""

_OUTLIER_SIGMAS, _OUTLIER_SHARE = 6.0, 0.05
"""Limit of the parities of a window, as a multiple of their noise plus a share of the stimulus: windows above it
contain a fault and not a change of the response.
"""

_TAIL = 4.0
"""Degrees of freedom of the prior of a change, a Student's t with the standard deviation `RESPONSE_CHANGE`."""

_CHANGES = np.geomspace(1e-5, 0.05, 120)
"""Changes at which the likelihood is evaluated."""


def response_shares(known: SensorCalibration) -> Floats | None:
    """Return the covariance (9, 9) of a sensor's response row by row, relative to the axes' scale factors, including
    its change since the calibration; None if the response was not measured.
    """
    shares = _calibrated_shares(known)
    if shares is None or not shares.any():
        return shares
    change = RESPONSE_CHANGE if known.response_change is None else known.response_change
    return shares + change**2 * np.eye(9)


def _calibrated_shares(known: SensorCalibration) -> Floats | None:
    """Return `response_shares` without a change."""
    covariance = known.response_covariance()
    if covariance is None:
        return None
    scale = np.repeat(known.scale_lsb_per_unit, 3)
    return np.asarray(covariance / np.outer(scale, scale))


def with_response_change(log: Log, calibration: Calibration, only: Collection[str] = ()) -> Calibration:
    """Return the calibration with the change of responses that the sensors of `log` (`only` these; empty: all) show,
    one for each quantity. Calibrations that state a change keep theirs; without motion nothing is estimated.
    """
    known = [
        (sensor, calibration.or_nominal(sensor))
        for quantity in INERTIAL
        for sensor in log.of(quantity)
        if sensor.name in calibration.sensors and len(sensor) and (not only or sensor.name in only)
    ]
    changing = {
        quantity: [pair for pair in known if pair[0].quantity == quantity and _may_have_changed(pair[1])]
        for quantity in INERTIAL
    }
    stretches = list(_stretches(known)) if any(len(pairs) > 1 for pairs in changing.values()) else []
    sensors = dict(calibration.sensors)
    for pairs in changing.values():
        change = _estimate_change(pairs, stretches) if len(pairs) > 1 else None
        if change is not None:
            sensors.update({sensor.name: replace(each, response_change=change) for sensor, each in pairs})
    return replace(calibration, sensors=sensors)


def _may_have_changed(known: SensorCalibration) -> bool:
    """Return whether a response was measured, is not exact, and its change is not stated."""
    return known.response_change is None and bool(np.any(_calibrated_shares(known)))


def _estimate_change(sensors: Sequence[Calibrated], stretches: Sequence[_Windows]) -> float | None:
    """Return the rms change of the responses of at least two sensors; None if their log does not determine it."""
    geometry = _geometry(sensors)
    if geometry is None:
        return None
    names = [sensor.name for sensor, _ in sensors]
    values = [stretch.of(names, is_slow=sensors[0][0].quantity == "specific_force") for stretch in stretches]
    windows = [_sound_windows(each, geometry) for each in values if len(each) >= _FEWEST_OF_STRETCH]
    if sum(len(each.parities) for each in windows) < _FEWEST:
        return None
    parities, stimulus, slopes = (np.concatenate(columns) for columns in zip(*windows, strict=True))
    excited = _excited_directions(stimulus, geometry.stimulus_covariance * np.mean(_noise_of(parities) ** 2))
    directions = excited.shape[1]
    if not directions:
        return None
    regressors = np.concatenate([stimulus @ excited, slopes], axis=1)
    inverse = np.linalg.pinv(regressors.T @ regressors)
    fit = inverse @ regressors.T @ parities
    residuals = parities - regressors @ fit
    noise = residuals.T @ residuals / (len(parities) - regressors.shape[1])
    design = np.kron(geometry.parity, excited.T)
    covariance = np.zeros((3 * 3 * len(sensors),) * 2)
    for index, (_, known) in enumerate(sensors):
        part = slice(9 * index, 9 * index + 9)
        covariance[part, part] = _calibrated_shares(known)
    unchanged = design @ covariance @ design.T + np.kron(noise, inverse[:directions, :directions])
    return _expected_change(fit[:directions].T.ravel(), unchanged, design @ design.T)


class _Geometry(NamedTuple):
    """Matrices of m axes: `parity` (m - 3, m) and `gain` (3, m) of weighted least squares, from readings in SI, and
    the covariance (3, 3) of the triad, for parities with noise of unit variance.
    """

    parity: Floats
    gain: Floats
    stimulus_covariance: Floats


def _geometry(sensors: Sequence[Calibrated]) -> _Geometry | None:
    """Return the geometry of the sensors' axes, weighted by the noise of window means if all is known; None if they do
    not span space.
    """
    noises = [
        None if known.noise_lsb is None else known.noise_lsb / known.lsb_per_si / np.sqrt(sensor.rate_hz or 1.0)
        for sensor, known in sensors
    ]
    scatter = np.concatenate([np.ones(3) if noise is None else noise for noise in noises])
    if any(noise is None for noise in noises) or not scatter.min() > 0:
        scatter = np.ones(len(scatter))
    white = np.concatenate([known.directions_box for _, known in sensors]) / scatter[:, None]
    vectors, sizes, _ = np.linalg.svd(white)
    if sizes[2] < _FLAT * sizes[0]:
        return None
    return _Geometry(vectors[:, 3:].T / scatter, np.linalg.pinv(white) / scatter, np.linalg.inv(white.T @ white))


_FLAT = 1e-3
"""Least singular value of the axes' directions, as a share of the largest, with which they span space."""


class _Windows(NamedTuple):
    """Windows of a part of the log: mean readings (n, 3) in SI along the calibrated directions by sensor, and whether a
    sensor has sound rows in each (n,); `is_slow` (n,): the box hardly rotates.
    """

    values: Mapping[str, Floats]
    is_sound: Mapping[str, Booleans]
    is_slow: Booleans

    def of(self, names: Sequence[str], is_slow: bool) -> Floats:
        """Return the readings (n, m) of sensors in the windows in which all are sound and, with `is_slow`, the box
        hardly rotates, because accelerometers at different positions measure different forces in a rotation.
        """
        used = np.all([self.is_sound[name] for name in names], axis=0) & (self.is_slow | (not is_slow))
        return np.asarray(np.concatenate([self.values[name] for name in names], axis=1)[used])


def _stretches(known: Sequence[Calibrated]) -> Iterator[_Windows]:
    """Yield windows in parts of the log in which all sensors have rows, evenly spread."""
    from imuarray.calibrate.response_transfer import WINDOW_S, window_means, without_force  # slow to import

    begin_ns = max(int(sensor.time[0]) for sensor, _ in known)
    end_ns = min(int(sensor.time[-1]) for sensor, _ in known)
    width_ns, length_ns = round(WINDOW_S * 1e9), round(_STRETCH_S * 1e9)
    spare_ns = max(0, end_ns - begin_ns - length_ns * _STRETCHES)
    for index in range(_STRETCHES):
        start_ns = begin_ns + index * (length_ns + spare_ns // (_STRETCHES - 1))
        count = (min(start_ns + length_ns, end_ns) - start_ns) // width_ns
        if count < _FEWEST_OF_STRETCH:
            return
        means = {sensor.name: window_means(sensor, start_ns, width_ns, count) for sensor, _ in known}
        forces_g = [
            each.stimulus_box(means[sensor.name][0]) / STANDARD_GRAVITY
            for sensor, each in known
            if sensor.quantity == "specific_force"
        ]
        force_g = np.mean(forces_g, axis=0) if forces_g else None
        values = {
            sensor.name: (without_force(means[sensor.name][0], each, force_g) - each.bias_lsb) / each.lsb_per_si
            for sensor, each in known
        }
        rates = [
            values[sensor.name] @ each.directions_box for sensor, each in known if sensor.quantity == "angular_rate"
        ]
        is_slow = np.zeros(count, bool)
        if rates:
            still = np.linalg.norm(np.mean(rates, axis=0), axis=1) < _SLOW_RATE
            is_slow[1:-1] = still[:-2] & still[1:-1] & still[2:]
        yield _Windows(values, {name: is_sound for name, (_, is_sound) in means.items()}, is_slow)


_SLOW_RATE = 0.1
"""Largest angular rate in rad/s, in a window and in its neighbours, at which accelerometers that are some centimetres
apart differ by less than a ten-thousandth of gravity.
"""

_FEWEST_OF_STRETCH = 20
"""Least number of windows of a part of the log that is used."""


class _SoundWindows(NamedTuple):
    """Windows of a part of the log: parities (n, m - 3), stimulus (n, 3) and its change (n, 3) from window to window,
    less their means.
    """

    parities: Floats
    stimulus: Floats
    slopes: Floats


def _sound_windows(values: Floats, geometry: _Geometry) -> _SoundWindows:
    """Return the windows of readings (n, m) in SI that contain no fault."""
    stimulus, parities = values @ geometry.gain.T, values @ geometry.parity.T
    parities = parities - np.median(parities, axis=0)
    allowed = _OUTLIER_SIGMAS * _noise_of(parities) + _OUTLIER_SHARE * np.linalg.norm(
        stimulus @ np.linalg.cholesky(np.linalg.inv(geometry.stimulus_covariance)), axis=1, keepdims=True
    )
    sound = (np.abs(parities) < allowed).all(axis=1)
    columns = (parities[sound], stimulus[sound], np.gradient(stimulus, axis=0)[sound])
    return _SoundWindows(*(column - column.mean(axis=0) if len(column) else column for column in columns))


def _noise_of(parities: Floats) -> Floats:
    """Return the standard deviations of the noise of parities (n, k), by second differences, which slow motion does not
    affect.
    """
    return np.asarray(np.sqrt(np.median(np.diff(parities, 2, axis=0) ** 2, axis=0) / MEDIAN_SQUARE / 6))


def _excited_directions(stimulus: Floats, noise_covariance: Floats) -> Floats:
    """Return the directions (3, k) along which the stimulus (n, 3) varies more than `_EXCITED` times its noise."""
    white = np.linalg.inv(np.linalg.cholesky(noise_covariance))
    sizes, directions = np.linalg.eigh(white @ (stimulus.T @ stimulus / len(stimulus)) @ white.T)
    across = white.T @ directions[:, sizes > _EXCITED]
    return np.asarray(across / np.linalg.norm(across, axis=0))


def _expected_change(shown: Floats, unchanged: Floats, per_change2: Floats) -> float:
    """Return the root of the expected square of a change, if `shown` (p,) is normal with covariance ``unchanged +
    change^2 per_change2``.
    """
    size = np.sqrt(np.diag(unchanged + RESPONSE_CHANGE**2 * per_change2))
    scale = np.outer(size, size)
    covariances = (unchanged + _CHANGES[:, None, None] ** 2 * per_change2) / scale
    covariances += 1e-9 * np.eye(len(shown))
    squares = np.einsum("i,gi->g", shown / size, np.linalg.solve(covariances, (shown / size)[None, :, None])[:, :, 0])
    likelihood = -(np.linalg.slogdet(covariances)[1] + squares) / 2
    width = RESPONSE_CHANGE * np.sqrt((_TAIL - 2) / _TAIL)
    prior = -(_TAIL + 1) / 2 * np.log1p((_CHANGES / width) ** 2 / _TAIL) + np.log(_CHANGES)  # evenly spaced logarithms
    share = np.exp(likelihood + prior - (likelihood + prior).max())
    return float(np.sqrt(share @ _CHANGES**2 / share.sum()))

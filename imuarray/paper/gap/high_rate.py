"""Appendix A.1: Gyro1's readings 1/350 s apart correlate by 0.4, and its y axis has a line near 50 Hz."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import exp, hypot, isfinite, log, pi, sqrt

import numpy as np

from imuarray.chips import CHIPS
from imuarray.paper.gap.candidate import Candidate, Discrepancy, discrepancy, scored, with_checks
from imuarray.paper.gap.fast import AROUND
from imuarray.paper.gap.sensor import Array, data_sheet_array, fast_noise, printed
from imuarray.paper.noise import HIGH_RATE_HZ
from imuarray.paper.replica.experiments import high_rate_s
from imuarray.paper.replica.spread import noise_residual
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.tables import number_in, table
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.odr_error import OdrError
from imuarray.simulate.effects.stale_samples import StaleSamples
from imuarray.simulate.effects.tone import Tone

NEIGHBOURS, NEIGHBOURS_SD = 0.4, 0.1 * AROUND
"""Figure 13: "around 0.4", the same for three axes, so good to 0.06 for all of them together."""
_SEEN = 3.0
"""Deviations at which a ripple is clearly seen."""
_GYROS = ("Gyro1", "Gyro2", "Gyro3")


def correlation(array: Array) -> Discrepancy:
    """Correlation of neighbours, with `bandwidth`, `stale_samples` and `odr_error` as candidates."""
    cutoff_hz = -log(NEIGHBOURS) * HIGH_RATE_HZ / (2 * pi)
    error_hz = NEIGHBOURS_SD / NEIGHBOURS * HIGH_RATE_HZ / (2 * pi)
    slower = [_slower(array, rate) for rate in CHIPS["l3g4200d"].rates_hz if rate < HIGH_RATE_HZ]
    filtered = scored(array, ("bandwidth",), _all(Bandwidth(cutoff_hz)), 1, _correlates)
    stale = scored(array, ("stale_samples",), {"Gyro1": (StaleSamples(NEIGHBOURS),)}, 1, _correlates)
    candidates = [
        replace(filtered, error={"cutoff_hz": error_hz}, leaves=""),
        replace(stale, leaves="the correlation that the 110 Hz filter makes by itself"),
        *slower,
        scored(array, (), {}, 0, _correlates, leaves="all of it"),
    ]
    found = discrepancy(array, "correlation", "A.1, Figure 13: neighbours correlate", candidates, 12, _is_correlation)
    return with_checks(found, [_foretold_by_noise()])


def line(array: Array) -> Discrepancy:
    """The line on y only, with `tone` and no cause as candidates."""
    low, high = amplitude_interval_dps()
    hz, error_hz = _frequency()
    amplitude = sqrt(low * high) if high > low else low
    tone = Tone((0.0, amplitude, 0.0), hz)
    candidates = [
        replace(
            scored(array, ("tone",), _all(tone), 2, _is_line, leaves="amplitude known within bounds only"),
            error={"frequency_hz": error_hz, "amplitude_dps": [low, high]},
        ),
        scored(array, (), {}, 0, _is_line, leaves="all of it"),
    ]
    found = discrepancy(array, "line", "A.1, Figure 14: a line near 50 Hz, y only", candidates, 5, _is_line)
    return with_checks(replace(found, axes=("y",)), [*_other_gyros(amplitude), _period()])


def _all(effect: Bandwidth | Tone) -> dict[str, tuple[Bandwidth | Tone]]:
    return dict.fromkeys(_GYROS, (effect,))


def _correlates(row: Statistic) -> bool:
    """Noise is in the likelihood too: some candidates change it."""
    return _is_correlation(row) or (row.table == "Table 9" and row.statistic == "std_lsb")


def _is_correlation(row: Statistic) -> bool:
    return row.statistic == "correlation of neighbours"


def _is_line(row: Statistic) -> bool:
    return row.table == "Figure 14" or row.statistic == "period, samples"


def _slower(array: Array, rate_hz: float) -> Candidate:
    """A chip at this rate gives readings twice, through the widest filter that it has there."""
    widest = max(CHIPS["l3g4200d"].allowed_bandwidths_hz(rate_hz))
    configured = array["Gyro1"].header.bandwidth_hz
    effect = OdrError(rate_hz, configured * widest / 110)  # the noise of Table 9 is reckoned for 110 Hz
    found = scored(array, ("odr_error",), {"Gyro1": (effect,)}, 1, _correlates)
    return replace(found, leaves=f"noise of Table 9: {widest:g} Hz is the widest filter at {rate_hz:g} Hz")


def noise_bandwidth_hz() -> tuple[float, float]:
    """(Hz, standard error) over which Table 9's noise has the data sheet's density (L3G-74), mean of six deviations."""
    sheet = data_sheet_array()["Gyro1"]
    per_root_hz = float(fast_noise(sheet)[0]) * sheet.lsb / sqrt(110.0)
    rows = [row for row in table(9) if not row["output"].endswith("t")]
    bands = [(float(number_in(row, "std_dps")) / per_root_hz) ** 2 for row in rows]
    return float(np.mean(bands)), float(np.std(bands, ddof=1)) / sqrt(len(bands))


def _foretold_by_noise() -> Mapping[str, object]:
    """Noise of that bandwidth correlates by itself: one pole (least) or a steep filter (most) bracket it."""
    band, error = noise_bandwidth_hz()
    one_pole = exp(-2 * pi * (2 * band / pi) / HIGH_RATE_HZ)
    steep = float(np.sinc(2 * band / HIGH_RATE_HZ))
    return {
        "check": "the bandwidth told from Table 9's noise foretells the correlation: one pole, and a steep filter",
        "noise_bandwidth_hz": band,
        "error_hz": error,
        "foretold": [one_pole, steep],
        "printed": NEIGHBOURS,
        "sd": NEIGHBOURS_SD,
        "within": bool(one_pole - 2 * NEIGHBOURS_SD <= NEIGHBOURS <= steep + 2 * NEIGHBOURS_SD),
    }


def _excess(y: float, x: float, z: float) -> float:
    """Variance of y over the mean of x and z."""
    return y**2 - (x**2 + z**2) / 2


def _array_excess_dps2(name: str) -> list[float]:
    lsb = data_sheet_array()[name].lsb
    columns = ((10, "std_lsb"), (11, "runs_std"), (11, "cont_std"))
    return [_excess(*(printed(number, f"{name} {axis}", column) * lsb for axis in "yxz")) for number, column in columns]


def amplitude_interval_dps() -> tuple[float, float]:
    """Amplitude of the line: no less than a ripple of the correlation by three sampling errors, no more than leaves y
    as little noise as three gyroscopes have on y (95 %).

    Axes differ in noise by more than a line adds: the upper end comes from how they do.
    """
    rows = [row for row in table(9) if row["range"] == "250dps" and not row["output"].endswith("t")]
    x, y, z = (float(number_in(row, "std_dps")) for row in rows)
    count = HIGH_RATE_HZ * high_rate_s("250dps")
    low = sqrt(2 * _SEEN / sqrt(count)) * y
    between = abs(log(x / z)) / sqrt(2)  # what axes without a line differ by
    most = _excess(y * exp(1.645 * between), x, z)
    return low, sqrt(2 * most) if most > 0 else low


def _frequency() -> tuple[float, float]:
    """Hz and standard error from "~50 Hz" (Figure 14) and "around 6 samples" (Figure 13), weighted."""
    spectrum, period = (50.0, 10 * AROUND), (HIGH_RATE_HZ / 6, HIGH_RATE_HZ / 36 * AROUND)
    weights = [1 / error**2 for _, error in (spectrum, period)]
    mean = (spectrum[0] * weights[0] + period[0] * weights[1]) / sum(weights)
    return mean, sqrt(1 / sum(weights))


def _period() -> Mapping[str, object]:
    """The line in the spectrum foretells the ripple of the correlation."""
    error = hypot(HIGH_RATE_HZ / 50.0**2 * 10 * AROUND, AROUND)
    foretold = HIGH_RATE_HZ / 50.0
    return {
        "check": "50 Hz (Figure 14) foretells the period of Figure 13",
        "foretold": foretold,
        "printed": 6.0,
        "sd": error,
        "z": (foretold - 6.0) / error,
        "unit": "samples",
    }


def _other_gyros(amplitude: float) -> Iterator[Mapping[str, object]]:
    """y over x and z in the array runs: the line would add amplitude^2 / 2 there."""
    for name in _GYROS:
        excess = _array_excess_dps2(name)
        noise = (
            float(np.mean([printed(10, f"{name} {axis}", "std_lsb") for axis in "xz"])) * data_sheet_array()[name].lsb
        )
        spread = 2 * noise**2 * max(noise_residual(f"{name} y"), 1e-9) + _between_axes(name)
        z = (float(np.mean(excess)) - amplitude**2 / 2) / spread
        if isfinite(z):
            yield {
                "check": f"the line's power on {name} y, Tables 10 and 11",
                "foretold": amplitude**2 / 2,
                "printed": float(np.mean(excess)),
                "sd": spread,
                "z": -z,
                "unit": "dps^2",
            }


def _between_axes(name: str) -> float:
    """Difference of the two lineless axes' variances."""
    lsb = data_sheet_array()[name].lsb
    x, z = (printed(10, f"{name} {axis}", "std_lsb") * lsb for axis in "xz")
    return abs(x**2 - z**2) / sqrt(2)

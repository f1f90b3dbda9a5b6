"""Appendix A.2 and Tables 10 and 11: the ADXL345 gives even codes only, and more noise than 400 Hz explain.

A data sheet's typical noise holds for no single part. So an axis' noise is what the candidate foretells, times e^u for
its plane (x and y, or z), times e^v for the axis; u and v are normal with deviations estimated from these very numbers,
u only where the candidate changes `white_noise`. A candidate that foretells more of the noise needs smaller ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import exp, isnan, log, sqrt
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from imuarray.chips import CHIPS
from imuarray.paper.gap.acting import with_effects
from imuarray.paper.gap.candidate import Candidate, Discrepancy, discrepancy, with_checks
from imuarray.paper.gap.sensor import Array, Floats, printed
from imuarray.paper.replica.spread import noise_residual
from imuarray.paper.replica.statistic import Statistic
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.odr_error import OdrError
from imuarray.simulate.effects.quantisation import Quantisation
from imuarray.simulate.effects.white_noise import WhiteNoise

_NAMES = ("ADXL1", "ADXL2")
_STDS = ((10, "std_lsb"), (11, "runs_std"), (11, "cont_std"))
_YES_OR_NO = 9.0
"""z^2 of a sensor whose even codes are not explained: three deviations."""
_NUMBERS = 8
"""Six axes and two sensors' codes."""


class _Scatter(NamedTuple):
    """-2 ln L of noise ratios, and the deviations of u and v that make it least."""

    value: float
    plane: float
    axis: float


def even_codes(array: Array) -> Discrepancy:
    """ADXL1 and ADXL2, with `odr_error` at every rate of the chip, `quantisation` to even codes, `white_noise`, and
    their combinations as candidates.
    """
    rates = [rate for rate in CHIPS["adxl345"].rates_hz if rate > array["ADXL1"].header.rate_hz]
    even = Quantisation(2)
    kinds: list[tuple[tuple[str, ...], tuple[Effect, ...]]] = [((), ()), (("quantisation",), (even,))]
    kinds += [(("odr_error",), (OdrError(rate),)) for rate in rates]
    candidates = [_candidate(array, *kind, own) for kind in kinds for own in (False, True)]
    candidates.append(_free_bandwidth(array))
    found = discrepancy(array, "even codes", "A.2, Tables 10, 11: even codes and noise", candidates, _NUMBERS, _belongs)
    return with_checks(found, _held_out(array, found), noise_over_foretold=_ratios_by_candidate(array, found))


def _belongs(row: Statistic) -> bool:
    noise = row.statistic in ("std_lsb", "runs_std", "cont_std") and row.channel.startswith("ADXL")
    return row.table == "Appendix A.2" or (noise and row.table in ("Table 10", "Table 11"))


def found_noise(name: str) -> Floats:
    """(3,) what Tables 10 and 11 print, quadratic mean of three experiments, counts."""
    squares = [[printed(number, f"{name} {axis}", column) ** 2 for number, column in _STDS] for axis in "xyz"]
    return np.asarray(np.sqrt(np.mean(squares, axis=1)))


def log_ratios(array: Array, effects: Sequence[Effect]) -> Floats:
    """(2, 3) ln of the noise found over that foretold with these effects."""
    there = with_effects(array, {name: tuple(effects) for name in _NAMES})
    return np.array([np.log(found_noise(name) / there[name].rounded_noise) for name in _NAMES])


def _candidate(array: Array, names: tuple[str, ...], effects: tuple[Effect, ...], own_noise: bool) -> Candidate:
    ratios = log_ratios(array, effects)
    scatter = _scatter(ratios, own_noise)
    step = with_effects(array, {"ADXL1": effects})["ADXL1"].step
    value = scatter.value + (0.0 if step == 2 else 2 * _YES_OR_NO)
    plane, z = exp(ratios[:, :2].mean()), exp(ratios[:, 2].mean())
    leaves = f"noise x{plane:.2f} in x, y and x{z:.2f} in z" + ("" if step == 2 else ", even codes")
    free = len(effects) + 1 + int(own_noise)  # the step or rate; the deviations of v and u
    if not own_noise:
        return Candidate(names, dict.fromkeys(_NAMES, effects) if effects else {}, free, value, leaves)
    adds = {name: (*effects, _own_noise(array, name, effects)) for name in _NAMES}
    error = {"rms_share": [noise_residual(f"ADXL1 {axis}") for axis in "xyz"]}
    return Candidate((*names, "white_noise"), adds, free, value, f"unforetold {leaves}", error)


def _own_noise(array: Array, name: str, effects: tuple[Effect, ...]) -> WhiteNoise:
    """The noise that is left once rounding is taken out."""
    there = with_effects(array, {name: effects})[name]
    rms = np.sqrt(found_noise(name) ** 2 - there.step**2 / 12) * there.lsb
    return WhiteNoise(tuple(rms.tolist()))


def _free_bandwidth(array: Array) -> Candidate:
    """`odr_error` with the bandwidth that the noise asks for, whatever the chip can."""
    fastest = max(CHIPS["adxl345"].rates_hz)
    factor = exp(float(log_ratios(array, (OdrError(fastest),)).mean()))
    wanted = fastest / 2 * factor**2
    effect = OdrError(fastest, wanted)
    ratios = log_ratios(array, (effect,))
    why = f"{wanted:.0f} Hz wanted, the chip has {fastest / 2:.0f} at most"
    adds = dict.fromkeys(_NAMES, (effect,))
    return Candidate(("odr_error",), adds, 3, _scatter(ratios, False).value, "noise of z against x, y", impossible=why)


def _scatter(ratios: Floats, own_noise: bool) -> _Scatter:
    """Least -2 ln L over the deviations of u (0 unless `own_noise`) and v, experiments' own scatter included."""
    least = float(np.mean([noise_residual(f"ADXL1 {axis}") for axis in "xyz"]))
    if not own_noise:
        axis = max(sqrt(float(np.mean(ratios**2))), least)
        return _Scatter(_likelihood(ratios, 0.0, axis), 0.0, axis)
    start = (log(0.5), log(0.1))
    bounds = [(log(1e-3), log(10.0)), (log(least), log(10.0))]
    found = minimize(lambda x: _likelihood(ratios, exp(x[0]), exp(x[1])), start, bounds=bounds, method="L-BFGS-B")
    return _Scatter(float(found.fun), exp(found.x[0]), exp(found.x[1]))


def _likelihood(ratios: Floats, plane: float, axis: float) -> float:
    """-2 ln L of six normal numbers, those of a plane with a common part."""
    total = 0.0
    for group in (ratios[:, :2].ravel(), ratios[:, 2]):
        covariance = axis**2 * np.eye(len(group)) + plane**2
        total += float(group @ np.linalg.solve(covariance, group)) + float(np.linalg.slogdet(covariance)[1])
    return total


def _held_out(array: Array, found: Discrepancy) -> Iterator[Mapping[str, object]]:
    """ADXL2's noise from ADXL1 alone: -2 ln L of what each candidate foretells, deviations told from ADXL1."""
    least = float(np.mean([noise_residual(f"ADXL1 {axis}") for axis in "xyz"]))
    for one in found.ranked:
        names, adds = one.candidate.names, one.candidate.adds
        effects = [effect for effect in adds.get("ADXL1", ()) if effect.name != "white_noise"]
        known, new = log_ratios(array, effects)
        centre = np.zeros(3)
        if "white_noise" in names:
            centre = np.array([known[:2].mean(), known[:2].mean(), known[2]])
        deviation = max(float(np.sqrt(np.mean((known - centre) ** 2))), least)
        yield {
            "check": f"ADXL1 foretells ADXL2's noise by {one.candidate.label}{_rate(effects)}",
            "rms_log_error": float(np.sqrt(np.mean((new - centre) ** 2))),
            "minus_twice_log_likelihood": float((((new - centre) / deviation) ** 2 + 2 * np.log(deviation)).sum()),
        }


def _rate(effects: Sequence[Effect]) -> str:
    rates = [effect for effect in effects if isinstance(effect, OdrError)]
    free = ["" if isnan(one.bandwidth_hz) else f", bandwidth {one.bandwidth_hz:.0f} Hz" for one in rates]
    return "".join(f" at {one.rate_hz:g} Hz{band}" for one, band in zip(rates, free, strict=True))


def _ratios_by_candidate(array: Array, found: Discrepancy) -> dict[str, list[float]]:
    """Found over foretold noise, x, y, z, mean of both sensors, before any `white_noise` of their own."""
    table = {}
    for one in found.ranked:
        effects = [effect for effect in one.candidate.adds.get("ADXL1", ()) if effect.name != "white_noise"]
        label = " + ".join(effect.name for effect in effects) + _rate(effects)
        table[label or "as configured"] = np.exp(log_ratios(array, effects).mean(axis=0)).tolist()
    return table

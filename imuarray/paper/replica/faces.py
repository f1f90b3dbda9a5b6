"""Tables 3, 4 and 10: the tumbling cube, statistic by statistic.

The model has the mean and the half-differences of six faces from Table 10. What its faces still differ by is what pairs
of opposite faces disagree by; the simulated box adds its own turn-on bias (common to all faces), in-run wander and
white noise. The repeated face was not fitted to: it has a face's whole variance and the fit's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import sqrt

from imuarray.paper.accelerometers import READINGS
from imuarray.paper.noise import FACE_SECONDS
from imuarray.paper.replica.spread import (
    axis_of,
    face_residual,
    noise_residual,
    own,
    printed,
    thermometer_residual,
)
from imuarray.paper.replica.statistic import Statistic, linear, logarithmic
from imuarray.paper.replica.tabulate import Table
from imuarray.paper.tables import number_in, table
from imuarray.paper.wander import variance_of_mean


def faces(ten: Table) -> Iterator[Statistic]:
    """Table 10."""
    for row in table(10):
        channel = row["channel"]
        for face in READINGS:
            yield _face(channel, face, ten[channel][face])
        for column in ("sem_lsb", "std_lsb"):
            at = ("Table 10", channel, column)
            values = printed(10, channel, column), ten[channel][column]
            deviation = logarithmic(at, *values, {"between experiments": noise_residual(channel)})
            yield replace(deviation, derived=column == "sem_lsb", fitted=True)


def accelerometers(three: Table) -> Iterator[Statistic]:
    """Table 3, without the bias once more in mg; scale factors without the sign, an artefact of the paper's."""
    for row in table(3):
        channel = row["channel"]
        wander, sem = _wander(channel), printed(10, channel, "sem_lsb")
        found = three[channel]
        values = {column: (abs(float(number_in(row, column))), found[column]) for column in ("sem_lsb", _SCALE)}
        yield _drift("Table 3", channel, float(number_in(row, "drift_lsb")), found["drift_lsb"])
        sem_parts = {"between experiments": noise_residual(channel)}
        yield _derived(logarithmic(("Table 3", channel, "sem_lsb"), *values["sem_lsb"], sem_parts), fitted=True)
        yield _bias("Table 3", channel, float(number_in(row, "bias_lsb")), found["bias_lsb"])
        parts = {"in-run": wander / sqrt(2), "sem": sem / sqrt(2), "rounding": 0.005 / sqrt(3)}
        yield _derived(linear(("Table 3", channel, _SCALE), *values[_SCALE], parts), fitted=True)


_SCALE = "scale_lsb_per_g"


def gyroscopes(four: Table) -> Iterator[Statistic]:
    """Table 4 in LSB; its columns in dps are the same numbers in another unit."""
    for row in table(4):
        channel, found = row["channel"], four[row["channel"]]
        yield _bias("Table 4", channel, float(number_in(row, "bias_lsb")), found["bias_lsb"])
        for column in ("dbias_x_lsb", "dbias_y_lsb", "dbias_z_lsb"):
            parts = {"in-run": _wander(channel) * sqrt(2), "sem": printed(10, channel, "sem_lsb") * sqrt(2)}
            values = float(number_in(row, column)), found[column]
            yield _derived(linear(("Table 4", channel, column), *values, parts), fitted=True)
        yield _drift("Table 4", channel, float(number_in(row, "drift_lsb")), found["drift_lsb"])


def _face(channel: str, face: str, simulated: float) -> Statistic:
    published, at = printed(10, channel, face), ("Table 10", channel, face)
    repeated = face == READINGS[-1]
    residual = face_residual(channel) * (sqrt(5) if repeated else 1.0)  # s^2 (1 + 2/3) against s^2 / 3
    if axis_of(channel) == 3:
        days = thermometer_residual(channel)
        parts = {"day-to-day": days, "face repeatability": face_residual(channel) * sqrt(3)}
        found = linear(at, published, simulated, parts)
        return replace(found, group=f"{channel}, Table 10", shared=(days / found.uncertainty) ** 2, fitted=True)
    turn_on = own(channel, lambda unit: unit.turn_on)
    parts = {"turn-on": turn_on, "in-run": _wander(channel), "sem": printed(10, channel, "sem_lsb")}
    found = linear(at, published, simulated, parts | {"face repeatability": residual})
    share = (turn_on / found.uncertainty) ** 2
    return replace(found, group=f"{channel}, Table 10", shared=share, fitted=not repeated)


def _bias(name: str, channel: str, published: float, simulated: float) -> Statistic:
    sem = printed(10, channel, "sem_lsb") / sqrt(6)
    parts = {"turn-on": own(channel, lambda unit: unit.turn_on), "in-run": _wander(channel) / sqrt(6), "sem": sem}
    if name == "Table 4":  # the repeated face is in its mean
        parts["face repeatability"] = face_residual(channel) * sqrt(5) / 7
    return _derived(linear((name, channel, "bias_lsb"), published, simulated, parts), fitted=True)


def _drift(name: str, channel: str, published: float, simulated: float) -> Statistic:
    parts = {
        "face repeatability": face_residual(channel) * sqrt(6),
        "in-run": _wander(channel) * sqrt(2),
        "sem": printed(10, channel, "sem_lsb") * sqrt(2),
    }
    return _derived(linear((name, channel, "drift_lsb"), published, simulated, parts))


def _derived(statistic: Statistic, *, fitted: bool = False) -> Statistic:
    return replace(statistic, derived=True, fitted=fitted)


def _wander(channel: str) -> float:
    """In-run wander of the mean over a face, counts."""
    return own(channel, lambda unit: unit.in_run) * sqrt(variance_of_mean(FACE_SECONDS))

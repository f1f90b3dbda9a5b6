"""Noise from Tables 9, 10 and 11: blending two ranges, in-plane against out-of-plane axes, and the logging rate.

Blending. Two readings of one quantity with independent noise s_low and s_high are best averaged with weights
proportional to 1 / s^2; the mean then has 1 / s^2 = 1 / s_low^2 + 1 / s_high^2. The plain average has sqrt(s_low^2 +
s_high^2) / 2.

Logging rate. A table that prints a standard deviation and the standard error of the mean tells how many samples there
were, n = (std / sem)^2; over a known duration that is a rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from imuarray.paper.cells import RecomputedRow
from imuarray.paper.tables import (
    Row,
    channels,
    design_of,
    is_inertial,
    mean,
    milli_g,
    number_in,
    physical,
    table,
)

FACE_SECONDS = 900
"""Each face of the six-position experiment was logged for 15 minutes (section 4)."""
SAMPLE_SECONDS = 300
"""Each sample of the turn-on experiment lasted five minutes (section 4)."""
HIGH_RATE_HZ = 350
"""The rate of the single-sensor experiments (section 5.1)."""
TRIADS = 12
"""The factor by which logging the whole array was slower (section 4)."""


@dataclass(frozen=True)
class Blend:
    """Noise of a low-range and a high-range sensor, alone and combined, in mg."""

    low_mg: Decimal
    high_mg: Decimal

    @property
    def weight_low(self) -> Decimal:
        """The low range's inverse-variance weight; the high range has the rest."""
        low, high = 1 / self.low_mg**2, 1 / self.high_mg**2
        return low / (low + high)

    @property
    def plain_mg(self) -> Decimal:
        """Noise of the plain average."""
        return self.noise_mg(Decimal("0.5"))

    @property
    def weighted_mg(self) -> Decimal:
        """Noise with the inverse-variance weights, the least that any weights give."""
        return self.noise_mg(self.weight_low)

    def noise_mg(self, weight_low: Decimal) -> Decimal:
        """Noise of the weighted mean with any weight of the low range."""
        return ((weight_low * self.low_mg) ** 2 + ((1 - weight_low) * self.high_mg) ** 2).sqrt()

    def as_json(self) -> dict[str, Any]:
        """The blend with noise to a thousandth of a mg and the two gains in per cent."""
        return {
            "sensor": "BMA180",
            "low_range": "1.5g",
            "high_range": "16g",
            "low_mg": round(float(self.low_mg), 3),
            "high_mg": round(float(self.high_mg), 3),
            "weight_low": round(float(self.weight_low), 4),
            "weight_high": round(float(1 - self.weight_low), 4),
            "weighted_mg": round(float(self.weighted_mg), 3),
            "plain_average_mg": round(float(self.plain_mg), 3),
            "gain_over_plain_average_percent": round(100 * float(1 - self.weighted_mg / self.plain_mg), 1),
            "gain_over_low_range_percent": round(100 * float(1 - self.weighted_mg / self.low_mg), 1),
        }


def bma180_blend() -> Blend:
    """The BMA180's noise per range, each the mean of Table 10's six channels with the typical sensitivity."""
    low, high = (
        mean([milli_g(row, number_in(row, "std_lsb")) for row in channels(10, "BMA", name)]) for name in ("1.5g", "16g")
    )
    return Blend(low, high)


PLANE_COLUMNS: dict[str, tuple[int, str]] = {
    "noise": (10, "std_lsb"),
    "thermal_slope": (8, "slope_lsb_per_degc"),
    "in_run": (11, "cont_std_of_means"),
    "turn_on": (11, "runs_std_of_means"),
}
"""What is compared between the out-of-plane and the in-plane axes of a sensor: table and column."""


def plane_ratio(sensor: str, quantity: str) -> Decimal:
    """|z| over the mean of |x| and |y| of one sensor, for a key of `PLANE_COLUMNS`."""
    number, column = PLANE_COLUMNS[quantity]
    rows = {row["channel"]: abs(number_in(row, column)) for row in table(number) if is_inertial(row)}
    return rows[f"{sensor} z"] / mean([rows[f"{sensor} x"], rows[f"{sensor} y"]])


def planes() -> list[dict[str, Any]]:
    """Out-of-plane over in-plane ratio of every triad: noise, temperature slope, in-run and turn-on variation."""
    sensors = [row["sensor"] for row in table(1)]
    return [
        {"sensor": sensor, "design": design_of(sensor)}
        | {f"{what}_z_over_xy": round(float(plane_ratio(sensor, what)), 3) for what in PLANE_COLUMNS}
        for sensor in sensors
    ]


def rate_hz(deviation: Decimal, standard_error: Decimal, seconds: int) -> Decimal:
    """Samples per second that a standard deviation and a standard error imply over `seconds`."""
    return (deviation / standard_error) ** 2 / seconds


def table10_rates() -> tuple[Decimal, ...]:
    """The logging rate that each inertial channel of Table 10 implies, in Hz."""
    return tuple(_row_rate(row) for row in table(10) if is_inertial(row))


def _row_rate(row: Row) -> Decimal:
    return rate_hz(number_in(row, "std_lsb"), number_in(row, "sem_lsb"), FACE_SECONDS)


def table11_rates() -> tuple[Decimal, ...]:
    """The logging rate in Hz that each inertial channel of Table 11 implies: separate runs, then the continuous one."""
    return tuple(
        rate_hz(number_in(row, f"{half}_std"), number_in(row, f"{half}_sem"), SAMPLE_SECONDS)
        for half in ("runs", "cont")
        for row in table(11)
        if is_inertial(row)
    )


def logging_rate() -> dict[str, Any]:
    """The array's logging rate in Hz by Tables 10 and 11, beside what section 4's factor of twelve makes of 350 Hz."""
    return {
        "table10_hz": _summary(table10_rates()),
        "table11_hz": _summary(table11_rates()),
        "stated_hz": round(HIGH_RATE_HZ / TRIADS, 1),
        "samples_per_face": round(mean(table10_rates()) * FACE_SECONDS),
    }


def _summary(rates: Sequence[Decimal]) -> dict[str, float]:
    return {
        "mean": round(float(mean(rates)), 2),
        "smallest": round(float(min(rates)), 2),
        "largest": round(float(max(rates)), 2),
    }


def table10() -> tuple[RecomputedRow, ...]:
    """Table 10 with each channel's implied logging rate and its noise in physical units (typical sensitivity)."""
    return tuple(RecomputedRow(row, (), _extra(row)) for row in table(10))


def _extra(row: Row) -> dict[str, Any]:
    extra: dict[str, Any] = {"rate_hz": round(float(_row_rate(row)), 2)}
    if is_inertial(row):
        extra["noise"] = round(float(physical(row, number_in(row, "std_lsb"))), 4)
        extra["unit"] = "dps" if design_of(row["channel"]) == "Gyro" else "mg"
    return extra

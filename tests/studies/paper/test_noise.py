"""Blending, planes and logging rate: findings as literals, and the blend against a scan of all weights."""

from __future__ import annotations

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.studies.paper.variation import RangeNoise, bma180_blend, logging_rate, plane_ratio, planes, table10

sizes = st.decimals(Decimal("0.1"), 100, places=2)


def test_the_blend_of_bma180_ranges() -> None:
    result = bma180_blend().as_json()
    assert result["low_mg"] == pytest.approx(9.53, abs=0.005)
    assert result["high_mg"] == pytest.approx(17.05, abs=0.006)
    assert result["weight_low"] == pytest.approx(0.76, abs=0.005)
    assert result["weight_high"] == pytest.approx(0.24, abs=0.005)
    assert result["weighted_mg"] == pytest.approx(8.32, abs=0.005)
    assert result["plain_average_mg"] == pytest.approx(9.77, abs=0.006)
    assert result["gain_over_plain_average_percent"] == pytest.approx(15, abs=0.5)
    assert result["gain_over_low_range_percent"] == pytest.approx(13, abs=0.5)


@given(low=sizes, high=sizes)
def test_the_blend_has_the_best_weight(low: Decimal, high: Decimal) -> None:
    blend = RangeNoise(low, high)
    weights = np.linspace(0, 1, 1001)
    scanned = np.hypot(weights * float(low), (1 - weights) * float(high))
    assert float(blend.weighted_mg) <= scanned.min() * (1 + 1e-12)
    assert float(blend.weight_low) == pytest.approx(weights[scanned.argmin()], abs=1.1e-3)
    assert float(blend.plain_mg) == pytest.approx(scanned[500])


def test_blended_noise_of_drawn_numbers() -> None:
    """200 000 draws: the relative standard error is 0.16 %; four of them are allowed (1 in 16 000)."""
    blend = bma180_blend()
    low, high = np.random.default_rng(7).normal(size=(2, 200_000)) * [[float(blend.low_mg)], [float(blend.high_mg)]]
    mixed = float(blend.weight_low) * low + (1 - float(blend.weight_low)) * high
    assert mixed.std() == pytest.approx(float(blend.weighted_mg), rel=4 * 0.0016)


def test_adxl345_z_is_twice_as_noisy() -> None:
    for sensor in ("ADXL1", "ADXL2"):
        assert float(plane_ratio(sensor, "noise")) == pytest.approx(2, abs=0.05)
    assert float(plane_ratio("ADXL1", "in_run")) == pytest.approx(0.105 / ((0.044 + 0.043) / 2))
    assert len(planes()) == 9


def test_the_logging_rate_follows_from_standard_errors() -> None:
    rate = logging_rate()
    assert 47.85 < rate["table10_hz"]["smallest"] <= rate["table10_hz"]["largest"] < 48.0
    assert rate["table10_hz"]["mean"] == pytest.approx(47.9, abs=0.05)
    assert rate["table11_hz"]["mean"] == pytest.approx(49, abs=0.5)
    assert rate["stated_hz"] == 29.2
    assert rate["samples_per_face"] > 40_000  # section 5.2


def test_table_10_has_additional_columns_of_rate_and_noise() -> None:
    rows = {row.row["channel"]: row.as_json() for row in table10()}
    assert rows["ADXL1 x"]["rate_hz"] == 47.96
    assert rows["ADXL1 z"]["noise"] == pytest.approx(12.28892 / 256 * 1000, abs=1e-4)
    assert rows["Gyro3 x"]["noise"] == pytest.approx(19.90578 * 0.00875, abs=1e-4)
    assert "noise" not in rows["BMA1 t"]

"""`odr_error`: noise, step and rate of a chip that runs at other settings than configured."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from imuarray.simulate.converters import hold_readings
from imuarray.simulate.effects.conversion import OdrError
from imuarray.simulate.signal import Analog, Codes, Instants
from tests.simulate.conftest import MakePlace, header

MakeAnalog = Callable[..., Analog]


@pytest.mark.parametrize(
    ("chip", "configured", "real", "factor"),
    [
        ("adxl345", {"rate_hz": 400.0}, OdrError(1600.0), 2.0),  # bandwidth is half the rate: ADX-35
        ("adxl345", {"rate_hz": 100.0}, OdrError(400.0), 2.0),  # 0.75 LSB become 1.5: ADX-67, ADX-68
        ("adxl345", {"rate_hz": 1600.0}, OdrError(400.0), 0.5),
        ("adxl345", {"rate_hz": 100.0}, OdrError(12.5), 1.0),  # no quieter below 100 Hz: ADX-68
        ("adxl345", {"rate_hz": 25.0}, OdrError(400.0), 2.0),
        ("adxl345", {"rate_hz": 400.0}, OdrError(1600.0, 50.0), 0.5),  # as stated
        ("bma180", {"bandwidth_hz": 150.0}, OdrError(bandwidth_hz=600.0), 2.0),
        ("bma180", {"bandwidth_hz": 150.0}, OdrError(1200.0), 1.0),  # its filter does not depend on its rate
        ("l3g4200d", {"rate_hz": 400.0, "bandwidth_hz": 110.0}, OdrError(400.0, 27.5), 0.5),
        ("hmc5883l", {"rate_hz": 15.0}, OdrError(75.0), 1.0),
    ],
)
def test_noise_follows_the_root_of_the_bandwidth(
    place: MakePlace, analog: MakeAnalog, chip: str, configured: dict[str, float], real: OdrError, factor: float
) -> None:
    at = place(header(chip, **configured))
    rows = real.analog(analog(0, 4, value=1.0, noise=3.0), at)
    np.testing.assert_allclose(rows.noise, 3.0 * factor)
    assert (rows.value == 1.0).all()


@pytest.mark.parametrize(
    ("configured_hz", "real_hz", "step", "highest"),
    [(400.0, 800.0, 1, 4095), (400.0, 1600.0, 2, 4094), (400.0, 3200.0, 2, 4094), (1600.0, 400.0, 1, 4095)],
)
def test_a_fast_adxl345_has_even_codes(
    place: MakePlace, analog: MakeAnalog, configured_hz: float, real_hz: float, step: int, highest: int
) -> None:
    """ADX-46, ADX-47: at 16 g; the highest even code is 4094."""
    configured = {"step": 2, "highest": 4094} if configured_hz >= 1600 else {"step": 1, "highest": 4095}
    rows = analog(0, 3, rate_hz=configured_hz, lowest=-4096, **configured)
    after = OdrError(real_hz).analog(rows, place(header("adxl345", rate_hz=configured_hz)))
    assert (after.step, after.lowest, after.highest, after.rate_hz) == (step, -4096, highest, real_hz)


def test_a_bandwidth_alone_does_not_change_the_rate(place: MakePlace, analog: MakeAnalog) -> None:
    rows = OdrError(bandwidth_hz=300.0).analog(analog(0, 3, rate_hz=2400.0), place(header(bandwidth_hz=150.0)))
    assert (rows.rate_hz, rows.step, rows.lowest, rows.highest) == (2400.0, 1, -8192, 8191)
    assert OdrError(bandwidth_hz=300.0).lookback(place()) == 0


@pytest.mark.parametrize(("rate_hz", "rows"), [(25.0, 5), (30.0, 5), (100.0, 0), (400.0, 0), (0.4, 251)])
def test_the_lookback_is_sufficient(place: MakePlace, codes: Callable[..., Codes], rate_hz: float, rows: int) -> None:
    """All rows that share a reading, and the one before them: the readings in rows 700 ... are the same."""
    back = OdrError(rate_hz).lookback(place(rows_per_s=100.0))
    assert back == rows
    if back:
        whole, alone = (hold_readings(codes(first, 1000), rate_hz) for first in (0, 700 - back))
        np.testing.assert_array_equal(alone.counts[back:], whole.counts[700:])
        np.testing.assert_array_equal(alone.fresh[back:], whole.fresh[700:])


def test_a_slow_oscillator_keeps_codes_and_noise(place: MakePlace, analog: MakeAnalog) -> None:
    """Set to 1600 Hz it makes a twentieth of that; its codes stay even, its noise as large."""
    at, effect = place(header("adxl345", rate_hz=1600.0), rows_per_s=100.0), OdrError(clock_ratio=0.05)
    stamps = np.arange(5, dtype=np.int64) * 10_000_000
    instants = effect.sampled(Instants(0, stamps, stamps, np.ones(5, bool), 1600.0), at)
    assert instants.rate_hz == pytest.approx(80.0)
    rows = analog(0, 5, noise=3.0, rate_hz=instants.rate_hz, lowest=-4096, highest=4094, step=2)
    after = effect.analog(rows, at)
    assert (after.step, after.highest, after.rate_hz) == (2, 4094, pytest.approx(80.0))
    np.testing.assert_array_equal(after.noise, rows.noise)
    assert effect.lookback(at) == 3
    wider = OdrError(bandwidth_hz=math.nan, rate_hz=200.0, clock_ratio=0.5)
    assert wider.sampled(instants, at).rate_hz == pytest.approx(100.0)
    assert (wider.analog(rows, at).step, wider.analog(rows, at).rate_hz) == (1, pytest.approx(100.0))


def test_single_precision_is_kept(place: MakePlace, analog: MakeAnalog) -> None:
    rows = OdrError(bandwidth_hz=300.0).analog(analog(0, 3, noise=1.0, dtype=np.float32), place(dtype=np.float32))
    assert rows.noise.dtype == np.float32


def test_defaults_do_nothing_and_invalid_parameters_are_refused(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 10)
    assert OdrError().analog(rows, place()) is rows
    assert OdrError().lookback(place()) == 0
    with pytest.raises(ValueError, match=r"rate_hz: 0(\.0)?; allowed is 0\.001 to 1e\+06"):
        OdrError(0.0)
    with pytest.raises(ValueError, match="bandwidth_hz: inf"):
        OdrError(math.nan, math.inf)
    with pytest.raises(ValueError, match=r"bandwidth_hz: 20; M1 \(hmc5883l\) has none configured"):
        OdrError(bandwidth_hz=20.0).analog(rows, place(header("hmc5883l", "M1")))

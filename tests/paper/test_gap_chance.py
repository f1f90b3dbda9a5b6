"""Closed forms of `imuarray.paper.gap` against numbers drawn and simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from imuarray.paper.gap import even_codes
from imuarray.paper.gap.acting import with_effects
from imuarray.paper.gap.candidate import capped, extra_scatter
from imuarray.paper.gap.chance import heated_line, log_deviation, windows
from imuarray.paper.gap.expected import expected
from imuarray.paper.gap.misfit import closed, squares
from imuarray.paper.gap.sensor import Sensor, data_sheet_array
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.wander import TIME_CONSTANT_S
from imuarray.simulate.effects.quantisation import Quantisation
from imuarray.simulate.effects.white_noise import WhiteNoise
from imuarray.simulate.motion.heating import Heating

RNG_KEY = 20130916


def generator() -> np.random.Generator:
    return np.random.Generator(np.random.Philox(RNG_KEY))


def test_covariance_of_windows_of_a_random_walk_and_a_wander() -> None:
    rows, parts, seconds, step = 4000, 5, 300.0, 5.0
    per = round(seconds / step)
    normal = generator().standard_normal((rows, parts * per))
    walk = np.cumsum(normal * np.sqrt(step), axis=1)
    kept = np.exp(-step / TIME_CONSTANT_S)
    wander = np.empty_like(normal)
    wander[:, 0] = normal[:, 0]
    for k in range(1, parts * per):
        wander[:, k] = kept * wander[:, k - 1] + np.sqrt(1 - kept**2) * normal[:, k]
    for series, known in ((walk, windows(parts, seconds).walk), (wander, windows(parts, seconds).wander)):
        means = series.reshape(rows, parts, per).mean(axis=2)
        # a variance over 4000 rows has a relative error of sqrt(2 / 4000) = 2.2 %: 4.5 of these
        assert np.cov(means.T) == pytest.approx(known, rel=0.1, abs=0.02 * known.max())


def test_logarithm_of_a_deviation_about_steady_differences() -> None:
    rng, count, draws = generator(), 15, 20000
    covariance = np.eye(count) * 0.3 + 0.2 * np.exp(-np.abs(np.subtract.outer(range(count), range(count))) / 2)
    steady = np.linspace(-1, 1, count)
    deviation, spread = log_deviation(covariance, steady)
    drawn = rng.multivariate_normal(steady, covariance, size=draws).std(axis=1, ddof=1)
    assert np.sqrt(np.mean(drawn**2)) == pytest.approx(deviation, rel=0.01)
    assert np.log(drawn).std() == pytest.approx(spread, rel=0.05)


def test_slope_of_a_line_through_wander() -> None:
    motion = Heating()
    seconds = np.arange(0.0, motion.seconds, 30.0)
    degc = np.asarray(motion.felt((seconds * 1e9).astype(np.int64)).temperature_degc, float)
    covariance = np.exp(-np.abs(np.subtract.outer(seconds, seconds)) / TIME_CONSTANT_S)
    drawn = generator().multivariate_normal(np.zeros(len(seconds)), covariance, size=4000, method="cholesky")
    slopes = np.polyfit(degc, drawn.T, 1)[0]
    assert slopes.std() == pytest.approx(np.sqrt(heated_line().slope[1]), rel=0.05)  # one deviation: 1.1 %
    assert heated_line().degc == pytest.approx(degc.mean())


def test_faces_scatter_as_the_populations_say() -> None:
    sensor = replace(data_sheet_array()["BMA3"], slope_sd=np.zeros(3), squared_sd=np.zeros((3, 3)), noise=np.zeros(3))
    rows = {
        (row.channel, row.statistic): row for row in expected({"BMA3": sensor, **_others()}) if row.table == "Table 10"
    }
    # 0.5 degrees of 1 g across the axis, 1 % along it; at 1.5 g 5460 counts per g
    assert rows["BMA3 x", "x_up"].uncertainty == pytest.approx(np.radians(0.5) * 5460, rel=0.01)
    assert rows["BMA3 x", "y_up"].uncertainty == pytest.approx(0.01 * 5460, rel=0.01)
    assert rows["BMA3 x", "y_up"].simulated == pytest.approx(55.08 - 5460, abs=0.1)  # Table 3's bias, "-Y"


def _others() -> dict[str, Sensor]:
    return {name: sensor for name, sensor in data_sheet_array().items() if name != "BMA3"}


def test_effects_act_on_noise_and_codes() -> None:
    array = with_effects(data_sheet_array(), {"ADXL1": (WhiteNoise((0.01, 0.02, 0.03)), Quantisation(2))})
    assert array["ADXL1"].step == 2
    assert array["ADXL1"].rounded_noise == pytest.approx(np.sqrt((np.array([1, 2, 3]) * 2.56) ** 2 + 4 / 12))
    assert array["ADXL2"] is data_sheet_array()["ADXL2"]


def test_likelihood_of_six_axes_with_a_common_part() -> None:
    ratios = generator().standard_normal((2, 3)) * 0.3
    plane, axis = 0.4, 0.1
    together = np.zeros((6, 6))
    for i in range(6):
        for j in range(6):
            same_plane = (i % 3 == 2) == (j % 3 == 2)
            together[i, j] = plane**2 * same_plane + axis**2 * (i == j)
    known = -2 * multivariate_normal(np.zeros(6), together).logpdf(ratios.ravel()) - 6 * np.log(2 * np.pi)
    assert even_codes._likelihood(ratios, plane, axis) == pytest.approx(known)


def statistic(published: float, uncertainty: float = 1.0, table: str = "Table 6", channel: str = "BMA1 x") -> Statistic:
    return Statistic(table, channel, f"{published}", published, 0.0, uncertainty, "")


def test_extra_scatter_is_what_deviations_lack() -> None:
    drawn = generator().standard_normal(4000) * 5
    rows = [statistic(float(value), 3.0) for value in drawn]
    assert extra_scatter(rows) == pytest.approx(4.0, rel=0.05)


def test_misfit_is_capped_and_closed_by_what_is_gone() -> None:
    assert capped([statistic(1e6), statistic(2.0)]) == pytest.approx((100 + 4) / 2)
    before = [statistic(5.0, channel=f"BMA1 {i}") for i in range(8)]
    after = [replace(row, simulated=4.0) for row in before]  # one deviation left of five: what a right model has
    whole = closed(squares(before, after), 1)
    assert (whole.share, whole.low, whole.high) == (1.0, 1.0, 1.0)
    half = [*after[:4], *before[4:]]
    part = closed(squares(before, half), 1)
    assert part.share == pytest.approx(0.5)
    assert part.low is not None and part.high is not None
    assert part.low < 0.5 < part.high
    assert closed(squares(after, after), 1).ci95 is None

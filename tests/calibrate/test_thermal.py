"""Slopes with temperature: valid intervals in correlated noise, lag, bias against scale, and opposing pairs."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.stats import binom

from imuarray.calibrate import load_calibration
from imuarray.calibrate.opposed import compare_opposed
from imuarray.calibrate.segments import (
    CorrelatedNoise,
    SegmentMeans,
    TemperatureSeries,
    products,
    regress,
    segment_means,
)
from imuarray.calibrate.thermal import ThermalResult, _determines_curvature, calibrate_thermal, fit_axes
from imuarray.cli import main
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, Stimulus, open_log
from imuarray.log.format import Phase, SensorHeader
from imuarray.studies.paper.systematic import pair_of
from tests.calibrate.conftest import EPOCH, Floats, accelerometer, gyroscope, ideal
from tests.selection import some

STEP_S = 10.0
TIME_S = np.arange(0, 2400, STEP_S)
ROOM_HEAT_COOL = np.interp(TIME_S, [0, 300, 600, 900, 1200, 2400], [24.0, 24, 42, 33, 50, 26])


def first_order_lag(degc: Floats, step_s: float, lag_s: float) -> Floats:
    """A temperature after a first-order lag, by small Euler steps: independent of the closed form under test."""
    fine = 200
    inside = np.interp(np.arange(len(degc) * fine) / fine, np.arange(len(degc)), degc)
    lagged = np.empty(len(inside))
    state = inside[0]
    for i, value in enumerate(inside.tolist()):
        lagged[i] = state
        state += (value - state) * step_s / fine / lag_s
    return lagged[::fine]


LAGGED = first_order_lag(ROOM_HEAT_COOL, STEP_S, 60.0)


def gauss_markov(rng: np.random.Generator, rows: int, step_s: float, rms: float, correlation_s: float) -> Floats:
    kept = np.exp(-step_s / correlation_s)
    drawn = rng.normal(0, rms, rows)
    for i in range(1, rows):
        drawn[i] = kept * drawn[i - 1] + np.sqrt(1 - kept**2) * drawn[i]
    return drawn


@pytest.mark.slow
def test_intervals_cover_the_slope_at_their_stated_rate() -> None:
    """201 intervals of 95 %, white noise, wander of 100 s and of 300 s, each with drift: 90 % to 98 % cover the slope.
    With a true coverage of 95 %, less than 1 % of all seeds give fewer than 90 % or more than 98.5 %.
    """
    assert binom.cdf(180, 201, 0.95) + binom.sf(198, 201, 0.95) < 0.01
    rng = np.random.default_rng(2)
    thermometer, slopes = TemperatureSeries("barometer", TIME_S, ROOM_HEAT_COOL), np.array([0.1, -0.2, 0.3])
    held, lags = [], []
    for _ in range(67):
        noise = rng.normal(0, [1.0, 0.7, 0.3], (len(TIME_S), 3))
        noise[:, 1] += gauss_markov(rng, len(TIME_S), STEP_S, 0.7, 100.0)
        noise[:, 2] += gauss_markov(rng, len(TIME_S), STEP_S, 1.0, 300.0)
        drift = np.array([0.0, 1e-4, -5e-4]) * TIME_S[:, None]
        fit = fit_axes(SegmentMeans(TIME_S, 50 + slopes * LAGGED[:, None] + drift + noise), thermometer, 30.0)
        held.append(np.abs(fit.slope_lsb_per_degc - slopes) < 1.96 * fit.slope_sem_lsb_per_degc)
        lags.append(fit.lag_interval_s[0] <= 60 <= fit.lag_interval_s[1])
    assert 0.90 <= np.mean(held) <= 0.985
    assert np.mean(lags) >= 0.88  # 95 % less three standard errors of 67


RAMP_S = np.arange(0, 2160, STEP_S)
RAMP = 29.0 - 19.0 * np.exp(-RAMP_S / 319.0)
"""A cold box in a warm room: half of the time within half a degree of its end."""


@pytest.mark.slow
def test_intervals_on_a_curved_ramp_cover_the_slope_in_its_middle() -> None:
    """One warming, three axes: a clear parabola, a parabola at the limit of detection, a straight line; with white
    noise, drift, and a wander of 200 s. The slope is that at the middle of the temperatures, where it equals the slope
    of the chord. 210 intervals of 95 %: 89 % to 98.5 % cover it; with a true coverage of 95 %, less than 1 % of all
    seeds give fewer or more. A wander that is half of the white noise, as here, is the hardest to detect.
    """
    assert binom.cdf(186, 210, 0.95) + binom.sf(206, 210, 0.95) < 0.01
    middle = 0.5 * (RAMP[0] + RAMP[-1])
    curvatures, slopes = np.array([1.5, 0.1, 0.0]), np.array([-28.2, 4.0, 0.5])
    rng, thermometer = np.random.default_rng(5), TemperatureSeries("chip", RAMP_S, RAMP)
    above = (RAMP - middle)[:, None]
    held, curves = [], []
    for _ in range(70):
        noise = rng.normal(0, 2.0, (len(RAMP_S), 3))
        noise += np.stack([gauss_markov(rng, len(RAMP_S), STEP_S, 1.0, 200.0) for _ in range(3)], axis=1)
        noise += rng.normal(0, 1e-3, 3) * RAMP_S[:, None]
        fit = fit_axes(SegmentMeans(RAMP_S, 100 + slopes * above + curvatures * above**2 + noise), thermometer, middle)
        held.append(np.abs(fit.slope_lsb_per_degc - slopes) < 1.96 * fit.slope_sem_lsb_per_degc)
        curves.append(fit.quadratic_lsb_per_degc2)
    assert 0.89 <= np.mean(held) <= 0.985
    detected = np.mean(np.array(curves) != 0, axis=0)
    assert detected[0] == 1 and 0 < detected[1] < 1 and detected[2] < 0.05
    assert np.array(curves)[:, 0] == pytest.approx(np.full(70, 1.5), abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "degc",
    [
        RAMP,
        pytest.param(
            np.interp(RAMP_S, [0, 300, 600, 900, 1200, 2160], [24.0, 24, 42, 33, 50, 27]),
            marks=pytest.mark.campaign,
            id="hair dryer",
        ),
    ],
)
def test_intervals_cover_the_slope_in_white_noise_and_random_walks(degc: Floats) -> None:
    """One warming, and a hair dryer; means of 10 s with white noise of 1 alone, and with a random walk that ends at
    0.7, at 2 and at 7 times it. Of 300 intervals of 95 % each in white noise 92.5 % to 99 % cover the slope, in all
    walks together 91 % at least: a true coverage of 95 to 97 % (93 %) misses these limits in less than 3 % of all
    seeds. Walks that end at the noise of a few means are the hardest: no likelihood distinguishes them from white
    noise.
    """
    assert binom.cdf(277, 300, 0.95) < 0.03 and binom.sf(297, 300, 0.97) < 0.02 and binom.cdf(818, 900, 0.93) < 0.01
    middle = 0.5 * (degc.min() + degc.max())
    slopes, curvatures = np.array([-3.0, 1.0, 0.0]), np.array([0.05, 0.0, 0.0])
    rng, thermometer = np.random.default_rng(12), TemperatureSeries("chip", RAMP_S, degc)
    above = (degc - middle)[:, None]

    def held(end: float) -> float:
        inside = []
        for _ in range(100):
            noise = rng.normal(0, 1.0, (len(RAMP_S), 3))
            noise += np.cumsum(rng.normal(0, end / np.sqrt(len(RAMP_S)), noise.shape), axis=0)
            fit = fit_axes(
                SegmentMeans(RAMP_S, 100 + slopes * above + curvatures * above**2 + noise), thermometer, middle
            )
            inside.append(np.abs(fit.slope_lsb_per_degc - slopes) < 1.96 * fit.slope_sem_lsb_per_degc)
        return float(np.mean(inside))

    assert 0.925 <= held(0.0) <= 0.99
    assert np.mean([held(0.7), held(2.0), held(7.0)]) >= 0.91


def test_the_slope_is_that_of_the_chord(write: Write) -> None:
    """A parabola through a log that was warm most of the time: the change from its coldest to its warmest over the
    degrees between them, with curvature 0.05 about 25 degC and slope 0.25 there.
    """
    warm = 48.0 - 24.0 * np.exp(-NS * 1e-9 / 200.0)
    path = write([(gyroscope("G"), (0.25, 0.25, 0.25))], warm=warm, curvature=0.05)
    result = run(path).calibration.sensors["G"].thermal
    assert result is not None
    chord = 0.25 + 0.05 * ((48.0 - 25.0) + (24.0 - 25.0))
    assert result.reference_degc == pytest.approx(36.0, abs=0.2)
    assert np.abs(result.slope_lsb_per_degc - chord).max() < 4 * result.slope_sem_lsb_per_degc.max() < 0.2
    assert result.quadratic_sem_lsb_per_degc2 is not None
    assert result.quadratic_lsb_per_degc2 == pytest.approx([0.05] * 3, abs=4 * result.quadratic_sem_lsb_per_degc2.max())


def test_errors_in_a_wander_exceed_those_in_white_noise() -> None:
    """A wander of 300 s over 2400 s: ordinary least squares would state several times less."""
    rng = np.random.default_rng(4)
    counts = np.stack([gauss_markov(rng, len(TIME_S), STEP_S, 1.0, 300.0) for _ in range(3)], axis=1)
    fit = fit_axes(SegmentMeans(TIME_S, counts), TemperatureSeries("barometer", TIME_S, ROOM_HEAT_COOL), 30.0)
    ordinary = counts.std() / np.sqrt(len(TIME_S)) / ROOM_HEAT_COOL.std()
    assert (fit.slope_sem_lsb_per_degc > 2 * ordinary).all()


def test_slope_curvature_and_lag_are_recovered_without_noise() -> None:
    quadratic = np.array([0.0, 0.01, -0.02])
    warm = (LAGGED - 30.0)[:, None]
    exact = (
        [100, 0, -50]
        + np.array([0.5, -1, 2]) * warm
        + quadratic * warm**2
        + np.array([0, 1e-3, -2e-3]) * TIME_S[:, None]
    )
    noise = np.random.default_rng(1).normal(0, 1e-3, exact.shape)
    fit = fit_axes(SegmentMeans(TIME_S, exact + noise), TemperatureSeries("barometer", TIME_S, ROOM_HEAT_COOL), 30.0)
    assert fit.lag_s == pytest.approx(60, rel=0.15)
    assert fit.slope_lsb_per_degc == pytest.approx([0.5, -1, 2], abs=0.03)
    assert fit.quadratic_lsb_per_degc2 == pytest.approx(quadratic, abs=2e-3)
    assert fit.quadratic_lsb_per_degc2[0] == 0


def test_a_lag_follows_its_differential_equation() -> None:
    lagged = TemperatureSeries("barometer", TIME_S, ROOM_HEAT_COOL).lagged(TIME_S, [0.0, 60.0, 1e9])
    assert lagged[:, 0] == pytest.approx(ROOM_HEAT_COOL)
    assert lagged[:, 1] == pytest.approx(LAGGED, abs=0.01)
    assert lagged[:, 2] == pytest.approx(np.full(len(TIME_S), 24.0), abs=1e-4)


def test_products_equal_those_of_the_full_covariance() -> None:
    rng = np.random.default_rng(3)
    time, columns = np.sort(rng.uniform(0, 100, 30)), rng.normal(size=(30, 3))
    for noise in (CorrelatedNoise(20.0, 0.3), CorrelatedNoise(500.0, 0.9), CorrelatedNoise(1.0, 1.0)):
        whole = (1 - noise.white) * np.exp(-np.abs(time[:, None] - time) / noise.correlation_s) + noise.white * np.eye(
            30
        )
        result, determinant = products(columns, np.diff(time), noise)
        assert result == pytest.approx(columns.T @ np.linalg.solve(whole, columns))
        assert determinant == pytest.approx(np.linalg.slogdet(whole)[1])


def test_least_squares_from_products_equals_numpy() -> None:
    rng = np.random.default_rng(6)
    design, series = rng.normal(size=(40, 3)), rng.normal(size=40)
    columns = np.column_stack([series, design])
    covariance, _ = regress(columns.T @ columns, np.zeros(()), 40)
    _, left, _, _ = np.linalg.lstsq(design, series, rcond=None)
    assert covariance == pytest.approx(np.linalg.inv(design.T @ design) * left[0] / 37)


# Whole logs: 20 minutes at 5 Hz.
ROWS = 6000
NS = np.arange(ROWS, dtype=np.int64) * 200_000_000
WARM = np.interp(NS * 1e-9, [0, 200, 500, 1200], [24.0, 24.0, 50.0, 30.0])

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a heating: sensors, their slopes (3,) in counts/degC at 25 degC, and the up direction in the box frame."""

    def made(
        sensors: Sequence[tuple[SensorHeader, Sequence[float]]],
        up: str = "+Z",
        *,
        name: str = "heat.h5",
        phases: Sequence[Phase] | None = None,
        scale_slopes: Mapping[str, Sequence[float]] = {},
        thermometer: str = "barometer",
        warm: Floats = WARM,
        curvature: float = 0.0,
        seed: int = 1,
    ) -> Path:
        rng = np.random.default_rng(seed)
        gravity = np.zeros(3)
        gravity["XYZ".index(up[1])] = 1 if up[0] == "+" else -1
        headers = [header for header, _ in sensors]
        barometer = SensorHeader(
            "P", "bmp180", "pressure", "Pa", 0.0, 0.0, columns=("ut", "up"), compensated=("temperature", "pressure")
        )
        extra = [barometer] if thermometer == "barometer" else []
        with LogWriter(tmp_path / name, [*headers, *extra], source="simulated", epoch=EPOCH) as writer:
            for header, slopes in sensors:
                above = (warm - 25.0)[:, None]
                felt = ideal(header.axes, header.sensitivity) @ gravity * (header.quantity == "specific_force")
                swollen = 1 + above * np.array(scale_slopes.get(header.name, (0.0, 0.0, 0.0)))
                counts = (
                    10
                    + felt * swollen
                    + above * np.array(slopes)
                    + above**2 * curvature
                    + rng.normal(0, 2.0, (ROWS, 3))
                )
                own = {"bma180": 2 * (warm - 24), "l3g4200d": 45 - warm}.get(header.chip, warm)
                block = Block(
                    NS,
                    np.rint(counts).astype(np.int16),
                    np.zeros(ROWS, np.uint16),
                    np.rint(own).astype(np.int16) if header.has_temperature else None,
                )
                writer.append(header.name, block)
            if extra:
                air = {"temperature": np.round(warm, 1), "pressure": np.full(ROWS, 1e5)}
                writer.append("P", Block(NS, np.zeros((ROWS, 2), np.int32), np.zeros(ROWS, np.uint16), None, air))
            if thermometer == "reference":
                nothing = np.zeros((ROWS, 3))
                writer.stimulus("reference", Stimulus(NS, nothing, nothing, warm))
            for phase in [Phase(0, 10**13, "heat", up)] if phases is None else phases:
                writer.phase(phase)
        return tmp_path / name

    return made


def run(*paths: Path) -> ThermalResult:
    logs = [open_log(path) for path in paths]
    try:
        return calibrate_thermal(*logs)
    finally:
        for log in logs:
            log.close()


def with_thermometer(header: SensorHeader) -> SensorHeader:
    return SensorHeader(**{**vars(header), "has_temperature": True})


@pytest.mark.slow
def test_one_orientation_cannot_separate_bias_from_scale(write: Write) -> None:
    accelerometer_slopes, gyroscope_slopes = (0.2, -0.3, 0.5), (0.25, 0.1, -2.0)
    path = write([(accelerometer("A", "+Y+X-Z"), accelerometer_slopes), (gyroscope("G"), gyroscope_slopes)])
    result = run(path)
    box, spun = result.calibration.sensors["A"].thermal, result.calibration.sensors["G"].thermal
    assert box is not None and spun is not None
    assert box.meaning == ("bias", "bias", "bias or scale")
    assert spun.meaning == ("bias", "bias", "bias")
    assert box.scale_slope_per_degc is None
    for outcome, truth in ((box, accelerometer_slopes), (spun, gyroscope_slopes)):
        error = np.abs(outcome.slope_lsb_per_degc - truth) / outcome.slope_sem_lsb_per_degc
        assert (error < 4).all()  # four standard errors of six slopes: 4e-4
        assert (outcome.slope_sem_lsb_per_degc < 0.02).all()
        assert outcome.thermometer == "barometer"
    assert [(np.abs(heating.gravity_g) > 0.5).tolist() for heating in result.heatings] == [[False, False, True]] * 2
    origin = result.calibration.sensors["A"].provenance["thermal"]
    assert origin.logs == (str(path),) and origin.epoch == EPOCH


def test_opposite_faces_separate_bias_from_scale(write: Write, tmp_path: Path) -> None:
    """A scale factor that changes by 1e-4 per degC gives 0.2048 counts per degC under 1 g; the bias 0.5."""
    sensors, swelling = [(accelerometer("A", "+Y+X-Z"), (0.2, -0.3, 0.5))], {"A": (0.0, 0.0, 1e-4)}
    paths = [write(sensors, up, name=f"{i}.h5", scale_slopes=swelling, seed=i) for i, up in enumerate(("+Z", "-Z"))]
    alone = run(paths[0]).calibration.sensors["A"].thermal
    assert alone is not None
    assert alone.slope_lsb_per_degc[2] == pytest.approx(0.5 - 0.2048, abs=0.03)
    both = run(*paths)
    result = both.calibration.sensors["A"].thermal
    assert (
        result is not None and result.scale_slope_per_degc is not None and result.scale_slope_sem_per_degc is not None
    )
    assert result.meaning == ("bias", "bias", "bias")
    assert np.abs(result.slope_lsb_per_degc - [0.2, -0.3, 0.5]).max() < 4 * result.slope_sem_lsb_per_degc.max()
    assert np.isnan(result.scale_slope_per_degc[:2]).all()
    assert abs(result.scale_slope_per_degc[2] - 1e-4) < 4 * result.scale_slope_sem_per_degc[2] < 2e-5
    both.calibration.save(tmp_path / "cal.toml")
    again = load_calibration(tmp_path / "cal.toml").sensors["A"].thermal
    assert again is not None and again.scale_slope_per_degc == pytest.approx(result.scale_slope_per_degc, nan_ok=True)


def test_the_accelerometers_determine_up_where_phases_are_missing(write: Write) -> None:
    result = run(write([(accelerometer("A", "+Y+X-Z"), (0.2, 0.2, 0.2))], "-X", phases=()))
    thermal = result.calibration.sensors["A"].thermal
    assert thermal is not None and thermal.meaning == ("bias", "bias or scale", "bias")


@pytest.mark.parametrize(("chip", "kind"), some([("bma180", "chip"), ("l3g4200d", "relative"), ("adxl345", "chip")], 2))
def test_chip_temperatures_replace_a_missing_thermometer(write: Write, chip: str, kind: str) -> None:
    """BMA180: 24 degC and half a degree a count (BMA-63). L3G4200D: a count less per degree, without zero (L3G-60). An
    ADXL345 has no thermometer: it uses that of its neighbour.
    """
    own = SensorHeader("S", chip, "specific_force", "g", 16.0, 512.0, has_temperature=chip != "adxl345")
    neighbour = with_thermometer(accelerometer("N"))
    result = run(write([(own, (0.5, 0.3, 0.1)), (neighbour, (0.1, 0.1, 0.1))], thermometer="none"))
    outcome = result.calibration.sensors["S"].thermal
    assert outcome is not None and outcome.thermometer == kind
    assert outcome.slope_lsb_per_degc[:2] == pytest.approx([0.5, 0.3], abs=0.02)
    coldest, warmest = result.heatings[0].span_degc
    assert warmest - coldest == pytest.approx(26, abs=1)
    if kind == "chip":
        assert coldest == pytest.approx(24, abs=0.5)


def test_a_reference_thermometer_is_used(write: Write) -> None:
    result = run(write([(gyroscope("G"), (0.5, 0.3, 0.1))], thermometer="reference")).calibration.sensors["G"].thermal
    assert result is not None and result.thermometer == "reference"
    assert result.slope_lsb_per_degc == pytest.approx([0.5, 0.3, 0.1], abs=0.02)


@pytest.mark.slow
def test_opposing_gyroscopes_of_table_8_cancel_their_slopes(write: Write) -> None:
    """Gyro1 and Gyro2: y and z oppose each other, x are parallel; Gyro3 has another range."""
    slopes = {"Gyro1": (0.235, 0.265, 0.221), "Gyro2": (0.521, 0.261, 0.187), "Gyro3": (0.904, 2.133, -2.782)}
    axes = {"Gyro1": "+X+Y+Z", "Gyro2": "+X-Y-Z", "Gyro3": "-X-Y+Z"}
    sensors = [
        (
            SensorHeader(
                name, "l3g4200d", "angular_rate", "dps", 250 if name == "Gyro3" else 2000, 1 / 0.07, axes=axes[name]
            ),
            slope,
        )
        for name, slope in slopes.items()
    ]
    pairs = run(write(sensors)).pairs
    assert [(pair.first, pair.second, pair.box_axis) for pair in pairs] == [
        ("Gyro1 y", "Gyro2 y", "Y"),
        ("Gyro1 z", "Gyro2 z", "Z"),
    ]
    for pair, axis in zip(pairs, "yz", strict=True):
        printed = float(pair_of(f"Gyro1 {axis}", f"Gyro2 {axis}").fused_slope)
        assert abs(pair.half_difference - printed) < 4 * pair.sem
        assert pair.sem < 0.008
        assert pair.p_cancels < 1e-6 and pair.is_bias
        assert pair.reduction > 5


@pytest.mark.parametrize(
    ("slopes", "sems", "half", "sem", "reduction", "cancels", "nothing_left"),
    [
        # One-sided tails of 2, 3 and 1 standard errors: 0.02275, 0.00135, 0.15866; two-sided of 0 is 1.
        ((0.2, 0.3), (0.1, 0.1), -0.05, np.sqrt(0.02) / 2, 5.0, 0.02275, 0.47950),
        ((-0.2, -0.2), (0.1, 0.1), 0.0, np.sqrt(0.02) / 2, np.inf, 0.02275, 1.0),
        ((0.2, -0.1), (0.1, 0.1), 0.15, np.sqrt(0.02) / 2, 1.0, 0.84134, 0.03389),
    ],
)
def test_cancellation_of_a_pair_by_hand(
    slopes: tuple[float, float],
    sems: tuple[float, float],
    half: float,
    sem: float,
    reduction: float,
    cancels: float,
    nothing_left: float,
) -> None:
    result = compare_opposed(*slopes, *sems)
    assert result == pytest.approx((half, sem, reduction, cancels, nothing_left), abs=1e-5)


def test_false_alarms_of_cancellation_are_rare() -> None:
    """One axis drifts, its opponent does not at all: 5 % of 4000 tests, three binomial standard errors."""
    rng = np.random.default_rng(8)
    called = [compare_opposed(5.0, slope, 0.1, 0.1)[3] < 0.05 for slope in rng.normal(0, 0.1, 4000)]
    assert np.mean(called) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 4000)


def test_cancellation_of_the_papers_pair() -> None:
    """0.265 and 0.261 LSB/degC cancel to 0.002, 131.5 times less."""
    half, _, reduction, _, _ = compare_opposed(0.265, 0.261, 0.001, 0.001)
    assert (half, reduction) == (pytest.approx(0.002), pytest.approx(131.5))


def test_segments_are_means_of_valid_rows(write: Write) -> None:
    path = write([(gyroscope("G"), (0.0, 0.0, 0.0))])
    with open_log(path) as log:
        segments = segment_means(log["G"], 100.0, [Phase(0, 200 * 10**9, "motion")])
        counts = np.asarray(log["G"].counts, float)
    assert segments.time_s == pytest.approx(np.arange(249.9, 1200, 100.0))
    assert segments.mean == pytest.approx(counts.reshape(12, 500, 3).mean(axis=1)[2:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    some(
        [
            ({"warm": np.full(ROWS, 25.0)}, r"G: the temperature changed by 0\.0 degC"),
            ({"warm": 24 + NS * 1e-11}, "G: the temperature changed so steadily"),
            ({"thermometer": "none"}, "G: no thermometer"),
            ({"phases": [Phase(0, 1, "z_up", "+Z"), Phase(1, 2, "x_up", "+X")]}, r"its phases have up \+X, \+Z"),
            ({"phases": [Phase(0, 1190 * 10**9, "motion")]}, "G: 2 segments of 5 s"),
        ],
        2,
    ),
)
def test_unsuitable_logs_are_refused(write: Write, options: dict[str, object], message: str) -> None:
    path = write([(gyroscope("G"), (0.1, 0.1, 0.1))], **options)
    with pytest.raises(CalibrationError, match=message):
        run(path)


@pytest.mark.slow
def test_logs_of_different_settings_are_refused(write: Write) -> None:
    one = write([(gyroscope("G"), (0.1, 0.1, 0.1))], name="one.h5")
    other = write([(gyroscope("G", "-X-Y+Z"), (0.1, 0.1, 0.1))], name="other.h5")
    with pytest.raises(CalibrationError, match=r"other\.h5, sensor G: range or axes differ from .*one\.h5"):
        run(one, other)


@pytest.mark.slow
def test_a_sensor_stuck_in_two_logs_has_no_slope(write: Write) -> None:
    paths = [write([(gyroscope("G"), (0.0, 0.0, 0.0))], name=f"{i}.h5") for i in (1, 2)]
    for path in paths:
        with h5py.File(path, "r+") as file:
            file["sensors/G/counts"][:] = 7
    thermal = run(*paths).calibration.sensors["G"].thermal
    assert thermal is not None and thermal.slope_lsb_per_degc == pytest.approx([0, 0, 0], abs=1e-9)


def test_two_temperatures_do_not_determine_a_curvature() -> None:
    """A step: the square of the temperature is a linear function of the temperature."""
    step = np.where(TIME_S < 1200, 20.0, 40.0)
    counts = np.random.default_rng(9).normal(size=(len(TIME_S), 3)) + 0.5 * step[:, None]
    fit = fit_axes(SegmentMeans(TIME_S, counts), TemperatureSeries("reference", TIME_S, step), 30.0)
    assert (fit.quadratic_lsb_per_degc2 == 0).all()
    assert (np.abs(fit.slope_lsb_per_degc - 0.5) < 4 * fit.slope_sem_lsb_per_degc).all()


def test_a_log_without_inertial_sensors_is_refused(write: Write) -> None:
    with pytest.raises(CalibrationError, match="no inertial sensor"):
        run(write([]))


RECORDING = (
    Path(os.environ.get("IMUARRAY_RECORDINGS") or Path(__file__).parents[3] / "shared" / "data")
    / "freeimu_thermal"
    / "thermal.csv.gz"
)


@pytest.mark.slow
@pytest.mark.skipif(not RECORDING.exists(), reason="the published recording is not here")
def test_slopes_of_a_published_curved_ramp(tmp_path: Path) -> None:
    """An MPU-6050 that warmed up from 10.6 to 28.9 degC (freeimu_thermal): the z axis of its accelerometer changes by
    -28.2 LSB per degC by a straight line through all of it, and by -32.9 in the middle of its temperatures by numpy's
    parabola through means of 5 s, each as heavy as the next. Two standard errors cover that, and the straight line's
    slope lies between those in the middle and at the warm end.
    """
    data = tmp_path / "thermal.csv"
    data.write_bytes(gzip.decompress(RECORDING.read_bytes()))
    mapping = Path(__file__).parents[2] / "configs" / "imports" / "freeimu_thermal.toml"
    assert main(["import", str(data), "--map", str(mapping), "-o", str(tmp_path / "run.h5")]) == 0
    thermal = run(tmp_path / "run.h5").calibration.sensors["Acc"].thermal
    assert thermal is not None and thermal.quadratic_lsb_per_degc2 is not None
    slope, sem = thermal.slope_lsb_per_degc[2], thermal.slope_sem_lsb_per_degc[2]
    assert thermal.reference_degc == pytest.approx(19.75, abs=0.1)
    assert sem < 3 and abs(slope + 32.9) < 2 * sem
    assert thermal.quadratic_lsb_per_degc2[2] > 0
    assert slope < -28.2 < slope + 2 * thermal.quadratic_lsb_per_degc2[2] * (28.9 - thermal.reference_degc)


@pytest.mark.slow
@pytest.mark.skipif(not RECORDING.exists(), reason="the published recording is not here")
def test_straight_lines_through_the_published_ramp_agree_with_its_notes(tmp_path: Path) -> None:
    """Slopes by straight lines through means of 500 rows, as the recording's notes state them (0.281, -0.094 and -1.721
    mg per degC at 16384 LSB per g; the gyroscope's in LSB): numpy computes the same, and the straight lines of the
    calibration agree within two standard errors. In the middle of the temperatures the slopes are others: 4.25 instead
    of 4.60 LSB per degC and -0.031 instead of -0.061 by numpy's parabola with drift.
    """
    noted = {"Acc": (0.281 * 16.384, -0.094 * 16.384, -1.721 * 16.384), "Gyro": (-0.061, 0.455, -0.037)}
    rows = np.genfromtxt(RECORDING, delimiter=",", skip_header=1)
    means = rows[: len(rows) // 500 * 500].reshape(-1, 500, rows.shape[1]).mean(axis=1)
    degc, clock = means[:, 9] / 340 + 36.53, means[:, -1] - means[:, -1].mean()
    above = degc - 19.75
    straight = np.linalg.lstsq(np.column_stack([np.ones(len(above)), above]), means[:, :6], rcond=None)[0][1]
    assert straight == pytest.approx(np.concatenate([noted["Acc"], noted["Gyro"]]), rel=0.01)
    parabola = np.linalg.lstsq(np.column_stack([np.ones(len(above)), above, above**2, clock]), means[:, :6], rcond=None)
    data = tmp_path / "thermal.csv"
    data.write_bytes(gzip.decompress(RECORDING.read_bytes()))
    mapping = Path(__file__).parents[2] / "configs" / "imports" / "freeimu_thermal.toml"
    assert main(["import", str(data), "--map", str(mapping), "-o", str(tmp_path / "run.h5")]) == 0
    for heating, middle in zip(run(tmp_path / "run.h5").heatings, np.split(parabola[0][1], 2), strict=True):
        fit = heating.fit
        assert (np.abs(fit.line_lsb_per_degc - noted[heating.sensor]) < 2 * fit.line_sem_lsb_per_degc).all()
        assert (np.abs(fit.slope_lsb_per_degc - middle) < 2 * fit.slope_sem_lsb_per_degc).all()


@pytest.mark.slow
def test_intervals_on_a_curved_ramp_cover_slopes_in_flicker_noise() -> None:
    """The ramp of the published recording, three curves, and white noise with flicker noise that is half of it in each
    octave of 20 s to 5120 s. 240 intervals of 95 %: 90 to 99.6 % cover the slope in the middle, and as many the slope
    of numpy's straight line through the true curve; a true coverage of 95 to 98 % misses these limits in less than 1 %
    of all seeds.
    """
    assert binom.cdf(215, 240, 0.95) < 0.01 and binom.sf(239, 240, 0.98) < 0.01
    middle = 0.5 * (RAMP[0] + RAMP[-1])
    above = (RAMP - middle)[:, None]
    slopes, curvatures = np.array([-28.2, 4.0, 0.5]), np.array([1.5, 0.05, 0.0])
    truth = slopes * above + curvatures * above**2
    lines = np.polyfit(RAMP, truth, 1)[0]
    rng, thermometer = np.random.default_rng(21), TemperatureSeries("chip", RAMP_S, RAMP)
    held: dict[str, list[Floats]] = {"slope": [], "line": []}
    for _ in range(80):
        noise = rng.normal(0, 2.0, truth.shape)
        for octave in range(9):
            walks = [gauss_markov(rng, len(RAMP_S), STEP_S, 1.0, 20.0 * 2**octave) for _ in range(3)]
            noise += np.stack(walks, axis=1)
        fit = fit_axes(SegmentMeans(RAMP_S, 100 + truth + noise), thermometer, middle)
        for name, values in (("slope", slopes), ("line", lines)):
            value, sem = (getattr(fit, f"{name}_{part}lsb_per_degc") for part in ("", "sem_"))
            held[name].append(np.abs(value - values) < 1.96 * sem)
    for name, each in held.items():
        assert 0.9 <= np.mean(each) < 0.996, name


@pytest.mark.parametrize("span_degc", [0.01, 1.0, 100.0])
def test_curvature_needs_more_than_two_temperatures_in_any_unit(span_degc: float) -> None:
    """Squares of two levels are a straight line in them; those of a sine in time are not, in any unit."""
    clock = np.linspace(-1, 1, 101)
    assert not _determines_curvature(clock, span_degc * (clock > 0.3))
    assert _determines_curvature(clock, span_degc * np.sin(3 * clock))

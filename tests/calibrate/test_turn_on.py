"""Repeated power-up: boot faults, states, turn-on bias and noise are distinguished."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import f

from imuarray.calibrate import Calibration, SensorCalibration, load_calibration
from imuarray.calibrate.model import BiasState, TurnOn
from imuarray.calibrate.runs import SensorRuns, best_split, explained_range, isolated_runs, two_states
from imuarray.calibrate.segments import mean_of_series
from imuarray.calibrate.start_up import RestMean, states_of
from imuarray.calibrate.turn_on import TurnOnResult, calibrate_turn_on, compare_runs, holm
from imuarray.chips import CHIPS
from imuarray.errors import CalibrationError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from imuarray.studies.paper.tables import number_in, numbers_in, table
from tests.calibrate.conftest import EPOCH, Floats, accelerometer, gyroscope, ideal
from tests.selection import some

RANGES = {name: spec.sensitivity for name, spec in CHIPS.items()}
BMA180 = RANGES["bma180"]
STATES_OF_TABLE_7 = ((1, 2, 6, 8, 9, 12, 14), (3, 4, 5, 7, 10, 11, 13, 15))


def printed_runs(number: int, degc: tuple[float, float]) -> SensorRuns:
    """Table 6 (BMA1) or 7 (Gyro3) as runs of known means; degrees at count 0, and per count."""
    means = np.array(
        [[float(value) for value in numbers_in(row, ("x_lsb", "y_lsb", "z_lsb"))] for row in table(number)]
    )
    warm = degc[0] + degc[1] * np.array([float(number_in(row, "temp_int")) for row in table(number)])
    numbers = tuple(int(row["run"]) for row in table(number))
    if number == 6:
        up = np.array([0.0, 0.0, 512.0])
        return SensorRuns("BMA1", "specific_force", "g", 16.0, 512.0, numbers, means, warm, gravity_lsb=up)
    return SensorRuns("Gyro3", "angular_rate", "dps", 250.0, 1 / 0.00875, numbers, means, warm)


def test_run_10_of_table_6_started_in_the_2_g_range() -> None:
    result = compare_runs(printed_runs(6, (24.0, 0.5)), BMA180)
    assert [(fault.run, fault.range) for fault in result.apart] == [(10, 2.0)]
    assert result.apart[0].ratio == pytest.approx(4308.719 / 536.5055)  # the median run of the fifteen
    assert str(result.apart[0]) == "run 10: 8.03 times the usual reading: started at 2 g"
    assert len(result.states) == 1
    assert result.states[0].runs == (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15)


def test_run_10_is_isolated_without_known_ranges() -> None:
    result = compare_runs(printed_runs(6, (24.0, 0.5)))
    assert [(fault.run, fault.range) for fault in result.apart] == [(10, None)]
    assert "unexplained" in str(result.apart[0])


@pytest.mark.parametrize("known", some([True, False], 1))
def test_table_7_has_two_states(known: bool) -> None:
    runs = printed_runs(7, (0.0, -1.0))
    result = compare_runs(runs if known else SensorRuns(**{**vars(runs), "temperature_degc": None}))
    assert result.apart == ()
    assert tuple(state.runs for state in result.states) == STATES_OF_TABLE_7
    assert [state.share for state in result.states] == pytest.approx([7 / 15, 8 / 15])
    assert result.p_states < 0.001
    # The paper's section 5.2.4 gives the two as (0, 69, 2) and (-13, 75, 0); the means of its printed runs:
    for state, numbers in zip(result.states, STATES_OF_TABLE_7, strict=True):
        members = [numbers_in(row, ("x_lsb", "y_lsb", "z_lsb")) for row in table(7) if int(row["run"]) in numbers]
        assert state.bias_lsb == pytest.approx(np.array(members, float).mean(axis=0))


def test_turn_on_of_adxl345_in_table_11_is_not_significant() -> None:
    """15 runs against 15 parts of one run, all channels except BMA1 and Gyro3, 5 % for all of them together."""
    rows = [row for row in table(11) if row["range"] != "int" and row["channel"].split()[0] not in ("BMA1", "Gyro3")]
    spreads = np.array([[float(row["runs_std_of_means"]), float(row["cont_std_of_means"])] for row in rows])
    allowed = holm(f.sf((spreads[:, 0] / spreads[:, 1]) ** 2, 14, 14))
    significant = {row["channel"] for row, p in zip(rows, allowed, strict=True) if p < 0.05}
    assert not {channel for channel in significant if channel.startswith("ADXL")}
    assert {f"{gyro} {axis}" for gyro in ("Gyro1", "Gyro2") for axis in "xyz"} <= significant


def test_holm_by_hand() -> None:
    """0.01 x 3, then the larger of that and 0.02 x 2, then 0.9; an unknown p-value does not count."""
    assert holm([0.9, 0.01, np.nan, 0.02]) == pytest.approx([0.9, 0.03, np.nan, 0.04], nan_ok=True)
    assert holm([0.04, 0.03]) == pytest.approx([0.06, 0.06])


# One state, 15 runs, at a level of 0.01.
DATASETS = 1000
FALSE_ALARMS = 0.01 + 3 * np.sqrt(0.01 * 0.99 / DATASETS)


@pytest.mark.slow
@pytest.mark.parametrize("tails", some(["normal", "student 3", "laplace"], 1))
def test_false_alarms_of_two_states_are_rare(tails: str) -> None:
    """1000 series of correlated axes: no more false alarms than 1 % and three binomial standard errors (1.9 %)."""
    rng = np.random.default_rng(12)
    mixing = rng.normal(size=(3, 3))
    shape = (DATASETS, 15, 3)
    draws = {
        "normal": rng.normal(size=shape),
        "student 3": rng.standard_t(3, shape),
        "laplace": rng.laplace(size=shape),
    }
    called = [two_states(series @ mixing, None, 1)[1] < 0.01 for series in draws[tails]]
    assert np.mean(called) <= FALSE_ALARMS


@pytest.mark.slow
def test_a_warm_up_is_not_reported_as_a_state() -> None:
    """Biases that follow a temperature which rises and settles: two groups at first sight."""
    rng = np.random.default_rng(13)
    warm = 30 - 8 * np.exp(-np.arange(15) / 2)
    series = rng.normal(0, 0.2, (DATASETS, 15, 3)) + warm[:, None] * np.array([1.0, 0.5, -1.0])
    assert np.mean([two_states(means, warm, 1)[1] < 0.01 for means in series]) <= FALSE_ALARMS


@pytest.mark.slow
def test_states_ten_spreads_apart_are_detected() -> None:
    """50 series, 6 of 15 runs in the other state, along a direction oblique to the sensor's axes: nine of ten are
    detected.
    """
    rng = np.random.default_rng(14)
    result = 0
    for _ in range(50):
        second = rng.permutation(15) < 6
        means = rng.normal(size=(15, 3)) + np.where(second, 10.0, 0.0)[:, None] * np.array([0.6, 0.0, -0.8])
        split, p = two_states(means, None, 1)
        result += bool(p < 0.01 and (split == (second ^ second[0])).all())
    assert result >= 45


@pytest.mark.slow
def test_the_best_split_equals_exhaustive_search() -> None:
    """Ten points in two dimensions: every split into two groups of three or more is tried."""
    rng = np.random.default_rng(15)
    for _ in range(30):
        points = np.linalg.svd(rng.normal(size=(10, 2)) - 0.0, full_matrices=False)[0]
        points = np.linalg.qr(points - points.mean(axis=0))[0]
        best = 0.0
        for code in range(1 << 9):
            group = np.array([code >> bit & 1 for bit in range(10)], bool)
            if 3 <= group.sum() <= 7:
                apart = points[group].mean(axis=0) - points[~group].mean(axis=0)
                best = max(best, float(group.sum() * (~group).sum() / 10 * apart @ apart))
        share, members = best_split(points[None], np.zeros(10))
        assert share[0] <= best + 1e-12
        assert share[0] > 0.93 * best  # not every direction is tried
        assert 3 <= members.sum() <= 7


@pytest.mark.parametrize(
    ("z", "range_g"), [(4308.7, 2.0), (1073.0, 8.0), (536.0, None), (700.0, None), (-4308.7, None), (8586.0, 1.0)]
)
def test_the_range_that_explains_a_reading(z: float, range_g: float | None) -> None:
    ratio, result = explained_range(np.array([0.0, 0, z]), np.array([-100.0, -134, 536.5]), 512.0, BMA180)
    assert result == range_g
    assert ratio == pytest.approx(z / 536.5)


def test_no_range_is_explained_without_gravity_on_an_axis() -> None:
    ratio, result = explained_range(np.array([100.0, 160, 0]), np.array([12.0, 20, 0]), 512.0, BMA180)
    assert np.isnan(ratio) and result is None


def test_a_gyroscope_is_not_explained_by_another_range() -> None:
    """A bias of 70 counts and one of 140: twice the usual reading, as a range of half the size would give gravity."""
    means = np.array([70.0] * 8 + [140.0])[:, None] + np.random.default_rng(18).normal(size=(9, 3))
    runs = SensorRuns("G", "angular_rate", "dps", 500.0, 57.0, tuple(range(1, 10)), means)
    assert [(fault.run, fault.range) for fault in compare_runs(runs, RANGES["l3g4200d"]).apart] == [(9, None)]


def test_a_single_run_is_isolated_but_a_smaller_state_is_not() -> None:
    rng = np.random.default_rng(16)
    means = rng.normal(size=(15, 3))
    means[[3, 8, 11]] += 40.0
    assert not isolated_runs(means, np.zeros(3)).any()
    means[5] -= 60.0
    assert np.flatnonzero(isolated_runs(means, np.zeros(3))).tolist() == [5]


def wandering(rng: np.random.Generator, runs: int, parts: int, rms: float, correlation_s: float) -> Floats:
    """Runs (r, n) of white noise of 0.3 and a Gauss-Markov wander, every 5 s."""
    kept = np.exp(-5.0 / correlation_s)
    wander = rng.normal(0, rms, (runs, parts))
    for i in range(1, parts):
        wander[:, i] = kept * wander[:, i - 1] + np.sqrt(1 - kept**2) * wander[:, i]
    return np.asarray(wander + rng.normal(0, 0.3, (runs, parts)))


@pytest.mark.slow
@pytest.mark.parametrize("correlation_s", some([30.0, 100.0], 1, 0))
def test_a_wander_within_runs_is_not_reported_as_turn_on(correlation_s: float) -> None:
    """60 series of 15 runs that differ by their wander alone: p-values below 5 % in 5 % of them and three standard
    errors at most. A test for white noise would report a difference almost always.
    """
    rng = np.random.default_rng(17)
    gaps_s = np.full(15 * 60 - 1, 5.0)
    gaps_s[59::60] = np.inf
    honest, naive = [], []
    for _ in range(60):
        series = wandering(rng, 15, 60, 1.0, correlation_s)
        sd = float(series.mean(axis=1).std(ddof=1))
        honest.append(mean_of_series(series.ravel(), gaps_s, np.arange(0, 900, 60)).chance_of(sd**2, 14) < 0.05)
        naive.append(f.sf(sd**2 / (series.var(axis=1, ddof=1).mean() / 60), 14, 15 * 59) < 0.05)
    assert np.mean(honest) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 60)
    assert np.mean(naive) > 0.5


def test_the_scatter_within_runs_is_subtracted() -> None:
    """Runs scatter by 5, within runs by 3: 4 remains; its error to first order is sqrt(2 5^4 / 14 + 2 3^4 / 50) / 8."""
    runs = printed_runs(7, (0.0, -1.0))
    flat = (BiasState(np.zeros(3), 1.0, runs.numbers),)
    five, three = np.full(3, 5.0), np.full(3, 3.0)
    result = TurnOnResult(runs, (), flat, 1.0, None, five, 14, three, np.full(3, 50.0), np.zeros(3))
    outcome = result.turn_on()
    assert outcome.rms_lsb == pytest.approx([4.0] * 3)
    assert outcome.rms_sem_lsb == pytest.approx([np.sqrt(2 * 625 / 14 + 2 * 81 / 50) / 8] * 3)
    assert outcome.spread_lsb.tolist() == [5.0] * 3


# Whole logs: a run of 60 s at 20 Hz.
NS = np.arange(1200, dtype=np.int64) * 50_000_000
Write = Callable[..., list[Path]]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes one log per run (or one log of all, `together`): sensors and their biases (r, 3)."""

    def made(
        sensors: Sequence[tuple[SensorHeader, Floats]],
        *,
        together: bool = False,
        warm: Sequence[float] = (),
        sensitivity: Sequence[float] = (),
        seed: int = 1,
    ) -> list[Path]:
        rng = np.random.default_rng(seed)
        count = len(sensors[0][1])
        barometer = SensorHeader(
            "P", "bmp180", "pressure", "Pa", 0.0, 0.0, columns=("ut", "up"), compensated=("temperature", "pressure")
        )
        headers = [*(header for header, _ in sensors), *([barometer] if warm else [])]
        paths = [tmp_path / ("all.h5" if together else f"{k}.h5") for k in range(1, 2 if together else count + 1)]
        for first, path in enumerate(paths):
            with LogWriter(path, headers, source="simulated", epoch=EPOCH, force=True) as writer:
                for run in range(count) if together else [first]:
                    start = run * 10**11 if together else 0
                    for header, biases in sensors:
                        scale = sensitivity[run] if sensitivity else header.sensitivity
                        felt = ideal(header.axes, scale)[:, 2] * (header.quantity == "specific_force")
                        counts = felt + biases[run] + rng.normal(0, 3.0, (len(NS), 3))
                        whole = np.rint(counts).astype(np.int16)
                        writer.append(header.name, Block(start + NS, whole, np.zeros(len(NS), np.uint16)))
                    if warm:
                        air = {"temperature": np.full(len(NS), warm[run]), "pressure": np.full(len(NS), 1e5)}
                        raw = np.zeros((len(NS), 2), np.int32)
                        writer.append("P", Block(start + NS, raw, np.zeros(len(NS), np.uint16), None, air))
                    if together:
                        writer.phase(Phase(start, start + 10**11, f"run {run + 1}", "+Z"))
        return paths

    return made


def run(paths: Sequence[Path], **options: object) -> tuple[Calibration, dict[str, TurnOnResult]]:
    logs = [open_log(path) for path in paths]
    try:
        calibration, results = calibrate_turn_on(logs, RANGES, **options)  # type: ignore[arg-type]
    finally:
        for log in logs:
            log.close()
    return calibration, {result.runs.sensor: result for result in results}


@pytest.mark.slow
@pytest.mark.parametrize("together", some([False, True], 1))
def test_a_turn_on_bias_is_estimated_and_a_steady_bias_is_not_reported(write: Write, together: bool) -> None:
    """12 runs. A changes by 2 counts rms, S not at all: noise of 3 counts makes 3 / sqrt(1200) = 0.087 of a mean."""
    rng = np.random.default_rng(20)
    changing, steady = rng.normal(0, 2.0, (12, 3)), np.zeros((12, 3))
    sensors = [(gyroscope("A"), changing), (gyroscope("S"), steady)]
    calibration, results = run(write(sensors, together=together))
    assert results["A"].runs.numbers == tuple(range(1, 13))
    assert (results["A"].p_value < 1e-4).all()
    assert (holm(results["S"].p_value) > 0.05).all()
    assert results["S"].in_run_sd_lsb == pytest.approx([3 / np.sqrt(1200)] * 3, rel=0.5)
    result = calibration.sensors["A"].turn_on
    assert result is not None and result.gravity_lsb is None
    assert np.abs(result.rms_lsb - changing.std(axis=0, ddof=1)).max() < 0.3
    assert (np.abs(result.rms_lsb - 2.0) < 4 * result.rms_sem_lsb).all()
    assert len(calibration.sensors["A"].provenance["turn_on"].logs) == (1 if together else 12)


@pytest.mark.slow
def test_a_warm_up_is_not_a_turn_on_bias(write: Write) -> None:
    """Three counts per degree and nothing else: with the barometer a slope, without it a turn-on bias."""
    warm = (30 - 6 * np.exp(-np.arange(10) / 4)).round(2)
    sensors = [(gyroscope("G"), 3.0 * (warm - 25)[:, None] * np.ones(3))]
    _, results = run(write(sensors, warm=warm.tolist()))
    assert results["G"].slope_lsb_per_degc == pytest.approx([3.0] * 3, abs=0.2)
    assert (holm(results["G"].p_value) > 0.05).all()
    _, untold = run(write(sensors, seed=2)[:10])
    assert untold["G"].slope_lsb_per_degc is None
    assert (untold["G"].p_value < 1e-4).all()


@pytest.mark.slow
def test_faults_and_states_are_saved_and_recognised_in_the_next_run(write: Write, tmp_path: Path) -> None:
    """An accelerometer that starts in the 2 g range once, and a gyroscope of two biases; the next run is recognised."""
    rng = np.random.default_rng(21)
    second = np.array([k in (2, 3, 5, 8, 9) for k in range(12)])
    states = np.array([[0.0, 70.0, 2.0], [-12.6, 75.0, 0.7]])
    biases = states[second.astype(int)] + rng.normal(0, 0.5, (12, 3))
    bma = SensorHeader("BMA1", "bma180", "specific_force", "g", 16.0, 512.0)
    offsets = np.array([-100.0, -134.0, 25.0]) + rng.normal(0, 0.2, (12, 3))
    scales = [4096.0 if k == 6 else 512.0 for k in range(12)]
    calibration, results = run(write([(bma, offsets), (gyroscope("Gyro3"), biases)], sensitivity=scales))
    assert [(fault.run, fault.range) for fault in results["BMA1"].apart] == [(7, 2.0)]
    assert [state.runs for state in results["Gyro3"].states] == [(1, 2, 5, 7, 8, 11, 12), (3, 4, 6, 9, 10)]
    calibration.save(tmp_path / "cal.toml")
    known = load_calibration(tmp_path / "cal.toml")
    gyro, box = known.sensors["Gyro3"].turn_on, known.sensors["BMA1"].turn_on
    assert gyro is not None and box is not None
    assert np.array([state.bias_lsb for state in gyro.states]) == pytest.approx(states, abs=1.0)
    assert box.apart == (7,) and box.runs == 11
    assert box.gravity_lsb is not None and np.linalg.norm(box.gravity_lsb) == pytest.approx(512.0)
    today = {"Gyro3": states[1] + 0.4, "BMA1": np.array([-100.0, -134.0, 25.0 + 4096.0])}
    result = states_of({name: at_rest(mean) for name, mean in today.items()}, known, {"BMA1": BMA180})
    assert (result["Gyro3"].state, result["Gyro3"].fault) == (1, False)
    assert result["BMA1"].fault and "started at 2 g" in result["BMA1"].explanation


def at_rest(mean: Sequence[float] | Floats, error: float = 0.0) -> RestMean:
    return RestMean(np.asarray(mean, float), np.full(3, error))


def started(**values: object) -> Calibration:
    plain = TurnOn(np.ones(3), np.ones(3), np.array([0.5, 1.0, 2.0]), np.zeros(3), 15)
    states = (BiasState(np.zeros(3), 0.5), BiasState(np.array([10.0, 0.0, 0.0]), 0.5))
    turn_on = TurnOn(**{**vars(plain), "states": states, **values})  # type: ignore[arg-type]
    sensor = SensorCalibration("G", "angular_rate", "dps", np.zeros(3), 114 * np.eye(3), range=250.0, turn_on=turn_on)
    return Calibration({"G": sensor})


@pytest.mark.parametrize(
    ("means", "state", "distance", "fault"),
    [
        ((0.5, 1.0, 2.0), 0, 1.0, False),
        ((9.0, 0.0, 0.0), 1, 2 / np.sqrt(3), False),
        ((0.0, 30.0, 0.0), 0, 30 / np.sqrt(3), True),
        ((np.nan, 0.0, 0.0), 0, np.nan, True),
    ],
)
def test_the_distance_of_a_start_from_the_states_by_hand(
    means: tuple[float, float, float], state: int, distance: float, fault: bool
) -> None:
    result = states_of({"G": at_rest(means), "other": at_rest((0, 0, 0))}, started(), {})
    assert list(result) == ["G"]
    assert (result["G"].state, result["G"].fault) == (state, fault)
    assert result["G"].distance == pytest.approx(distance, nan_ok=True)
    assert bool(result["G"].explanation) is fault


def test_the_standard_error_of_a_short_rest_counts_in_the_distance() -> None:
    """A spread of 1 count and an error of 3: 30 counts along one axis are a distance of 30 / sqrt(3 (1 + 9)) = 5.5."""
    start = states_of({"G": at_rest((0.0, 30.0, 0.0), 3.0)}, started(), {})["G"]
    assert (start.distance, start.fault) == (pytest.approx(30 / np.sqrt(30)), False)


def test_a_slight_tilt_is_not_a_fault() -> None:
    """Gravity of 512 counts, a pose known to 0.02 g (2.28 counts of 114): 15 counts are less than 8 spreads, of 1 count
    and 2.28 together; they are 8.7 spreads of 1 count (rms over three axes) where no gravity tells of a pose.
    """
    tilted = started(gravity_lsb=np.array([0.0, 0.0, 512.0]))
    assert not states_of({"G": at_rest((0.0, 15.0, 512.0))}, tilted, {})["G"].fault
    assert states_of({"G": at_rest((0.0, 15.0, 0.0))}, started(), {})["G"].fault


@pytest.mark.slow
def test_too_few_or_duplicate_runs_are_refused(write: Write) -> None:
    paths = write([(gyroscope("G"), np.zeros((4, 3)))])
    with pytest.raises(CalibrationError, match="sensor G: 2 sound runs, at least 3 are required"):
        run(paths[:2])
    with pytest.raises(CalibrationError, match="no log"):
        calibrate_turn_on([])
    together = write([(gyroscope("G"), np.zeros((4, 3)))], together=True)
    with pytest.raises(CalibrationError, match="run 1 occurs twice"):
        run([*together, *together])


@pytest.mark.slow
def test_a_run_without_valid_readings_is_isolated(write: Write) -> None:
    paths = write([(gyroscope("G"), np.zeros((5, 3))), (accelerometer("A"), np.zeros((5, 3)))])
    with LogWriter(
        paths[2], [gyroscope("G"), accelerometer("A")], source="simulated", epoch=EPOCH, force=True
    ) as writer:
        for name in ("G", "A"):
            writer.append(name, Block(NS, np.zeros((len(NS), 3), np.int16), np.full(len(NS), 32, np.uint16)))
    _, results = run(paths)
    for result in results.values():
        assert [fault.run for fault in result.apart] == [3]
        assert result.states[0].runs == (1, 2, 4, 5)

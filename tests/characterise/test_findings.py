"""Findings in sentences, on simulated logs whose effects are known."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from imuarray.array import parse_array
from imuarray.characterise import characterise_log
from imuarray.characterise.findings import findings
from imuarray.characterise.imu_noise import imu_files
from imuarray.log import open_log
from imuarray.printable import listed
from imuarray.simulate import EFFECTS, Simulation, plan_of, write_log
from imuarray.simulate.motion import HandShake, Still
from tests.selection import some

ARRAY = parse_array(
    '[array]\nname = "a"\n[[sensor]]\nname = "G"\nchip = "l3g4200d"\naddress = 0x68\nrange = 250\nrate_hz = 800\n'
)
Characterise = Callable[..., dict[str, Any]]


@pytest.fixture
def characterised(tmp_path: Path) -> Characterise:
    def made(*effects: tuple[str, dict[str, Any]], seconds: float = 200.0, rate_hz: float = 350.0) -> dict[str, Any]:
        chain = [EFFECTS[name](**parameters) for name, parameters in effects]
        path = tmp_path / "run.h5"
        write_log(Simulation(plan_of(ARRAY, rate_hz, seconds), Still(), {"G": chain}, seed=2), path, force=True)
        with open_log(path) as log:
            return characterise_log(log)

    return made


NOISE = ("white_noise", {"rms": 0.18})


@pytest.mark.slow
def test_a_sound_sensor_has_no_findings(characterised: Characterise) -> None:
    assert findings(characterised(NOISE)) == []


@pytest.mark.slow
def test_line_and_correlation_of_the_papers_gyroscope(characterised: Characterise) -> None:
    """Appendix A: neighbours correlate by 0.4 at 350 Hz, and y alone has a line near 50 Hz (Figures 13 and 14).

    After a filter of 51 Hz samples of 400 Hz correlate by 0.449, and by 0.201 two apart, which one of seven rows is:
    0.41.
    """
    shaped = ("bandwidth", {"cutoff_hz": 51.0})
    sentences = findings(characterised(NOISE, shaped, ("tone", {"amplitude": (0.0, 0.06, 0.0), "frequency_hz": 50.0})))
    line = next(text for text in sentences if "a line at 50 Hz" in text)
    assert line.startswith("G y: a line at 50 Hz (or an alias of 300, 400, ... Hz)")
    assert "G x, z: neighbouring readings correlate by 0.41" in sentences


@pytest.mark.slow
def test_mains_lines_are_named_with_their_alias(characterised: Characterise) -> None:
    """50.02 Hz at 76.93 Hz appears at 26.91 Hz, and 60 Hz at 350 Hz at 60 Hz; a line at 21 Hz is neither."""
    hum = ("tone", {"amplitude": (0.0, 0.05, 0.0), "frequency_hz": 50.02})
    other = ("tone", {"amplitude": (0.05, 0.0, 0.0), "frequency_hz": 21.0})
    texts = [text for text in findings(characterised(NOISE, hum, other, rate_hz=76.93)) if " line at " in text]
    assert [text.endswith(", possibly aliased 50 Hz mains") for text in texts] == [False, True]
    assert "26.91 Hz" in texts[1]
    hum = ("tone", {"amplitude": (0.0, 0.05, 0.0), "frequency_hz": 60.0})
    (text,) = (text for text in findings(characterised(NOISE, hum)) if " line at " in text)
    assert text.endswith(", possibly 60 Hz mains")


@pytest.mark.slow
def test_codes_repeats_and_losses_are_reported(characterised: Characterise) -> None:
    coarse = ("quantisation", {"step_lsb": 4})
    sentences = findings(characterised(NOISE, coarse, ("stale_samples", {"probability": 0.3})))
    assert "G x, y, z: only every 4th code" in sentences
    (slow,) = (
        text for text in sentences if text.startswith("G: is read 350 times a second, but measures only 24")
    )  # 0.7 * 350
    assert re.search(r"only 24\d(\.\d)? times; the same reading occurs up to \d+ times in a row", slow)
    (seldom,) = findings(characterised(NOISE, ("stale_samples", {"probability": 0.03})))
    share = re.fullmatch(r"G: (.*) % of the rows repeat the previous row without new readings", seldom)
    assert share is not None and float(share[1]) == pytest.approx(3, abs=0.3)  # of 70,000 rows: four standard errors
    lossy = findings(characterised(NOISE, ("dropped_samples", {"probability": 0.01, "burst_rows": 50.0})))
    assert any("gaps" in text and "s after" in text for text in lossy)


def test_even_codes_of_a_fast_adxl345_are_reported(tmp_path: Path) -> None:
    array = parse_array(
        '[array]\nname = "a"\n[[sensor]]\nname = "A"\nchip = "adxl345"\naddress = 0x53\nrange = 16\nrate_hz = 1600\n'
    )
    noise = EFFECTS["white_noise"](rms=0.02)  # type: ignore[call-arg]
    write_log(Simulation(plan_of(array, 100.0, 100.0), Still(), {"A": [noise]}), tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert "A x, y, z: only even codes" in findings(characterise_log(log))  # ADX-47


@pytest.mark.slow
def test_the_kalibr_file_has_the_true_figures_in_si(characterised: Characterise) -> None:
    """0.18 dps rms at 350 Hz: 0.18 pi / 180 / sqrt(350) rad/s/sqrt(Hz); walk 0.002 dps/sqrt(s)."""
    result = characterised(NOISE, ("random_walk", {"density": 0.002}), seconds=1500.0)
    (name, text), = imu_files(result).items()  # fmt: skip
    assert name == "imu_G.yaml"
    lines = [line.split("#")[0] for line in text.splitlines() if not line.startswith("#")]
    texts = dict(line.split(": ") for line in lines)
    assert texts.pop("rostopic") == "/sensors/G"
    values = {name: float(value) for name, value in texts.items()}
    assert values["gyroscope_noise_density"] == pytest.approx(0.18 * 3.14159265 / 180 / 350**0.5, rel=0.01)
    assert values["gyroscope_random_walk"] == pytest.approx(0.002 * 3.14159265 / 180, rel=0.5)
    assert values["update_rate"] == pytest.approx(350, rel=1e-3)
    assert set(values) == {"gyroscope_noise_density", "gyroscope_random_walk", "update_rate"}


SIX_AXIS = parse_array(
    '[array]\nname = "a"\n[[sensor]]\nname = "G"\nchip = "icm42688"\naddress = 0x68\nrange = 500\nrate_hz = 1000\n'
)


@pytest.mark.parametrize("hold_s", some([0.0, 0.0015], 1))
def test_an_adaptive_range_is_reported(tmp_path: Path, hold_s: float) -> None:
    """A gyroscope that is turned by hand, up to 286 dps, in a log of every sample."""
    effects = [
        EFFECTS["white_noise"](rms=0.03),
        EFFECTS["adaptive_range"](threshold=100.0, hold_s=hold_s),
    ]
    path = tmp_path / "run.h5"
    plan = plan_of(SIX_AXIS, 1000.0, 10.0)
    write_log(Simulation(plan, HandShake(still_s=2.0, motion_s=6.0, peak_dps=300.0), {"G": effects}, seed=2), path)
    with open_log(path) as log:
        result = characterise_log(log)
    stalls = result["sensors"][0]["stalls"]
    assert stalls["passages"] >= 10
    sentences = [sentence for sentence in findings(result) if "adaptive range" in sentence]
    assert bool(sentences) == bool(hold_s)
    if hold_s:
        assert re.search(
            r"G: its readings freeze at \d+ of \d+ passages of 100 dps in the log: its adaptive range is on",
            sentences[0],
        )


def axis_of(name: str, **known: Any) -> dict[str, Any]:
    """An axis without findings except those in `known`."""
    nothing = {"correlation": [1.0, 0.0], "error": [0.0, 0.01]}
    return {
        "axis": name, "unit_per_count": 0.1, "counts": {"std": 10.0}, "codes": None, "fit": None, "lines": [],
        "autocorrelation": nothing,
    } | known  # fmt: skip


def line_of(frequency_hz: float, amplitude: float, width_hz: float = 0.0) -> dict[str, Any]:
    return {
        "frequency_hz": frequency_hz, "frequency_error_hz": 0.001, "amplitude": amplitude, "amplitude_error": 0.01,
        "width_hz": width_hz, "aliases_hz": [frequency_hz], "fundamental_hz": None,
    }  # fmt: skip


def result_of(axes: dict[str, list[dict[str, Any]]], **known: Any) -> dict[str, Any]:
    steady = {
        "pattern": {"kind": "steady", "usual_s": 0.01, "sentence": ""}, "gaps": 0,
        "repeats": {"new_share": 1.0, "update_rate_hz": 100.0, "longest": 1},
    }  # fmt: skip
    sensors = [
        {"name": name, "unit": "dps", "unit_per_count": 0.1, "rate_hz": 100.0, "timing": steady, "rails": None,
         "spectrum": {"resolution_hz": 0.02}, "axes": these} | known
        for name, these in axes.items()
    ]  # fmt: skip
    return {"stretch": {"remark": "", "phase": None}, "sensors": sensors}


def test_sensors_with_the_same_finding_share_a_sentence() -> None:
    """Correlations 0.2 and 0.3 of four units; the unit with only one such axis is listed separately."""
    correlated = {"autocorrelation": {"correlation": [1.0, 0.2], "error": [0.0, 0.01]}}
    more = {"autocorrelation": {"correlation": [1.0, 0.3], "error": [0.0, 0.01]}}
    axes = {f"G{number}": [axis_of("x", **correlated), axis_of("y", **more)] for number in (1, 2, 3)}
    axes["G7"] = [axis_of("x"), axis_of("y", **more)]
    assert findings(result_of(axes)) == ["G1 to G3 x, y; G7 y: neighbouring readings correlate by 0.20 to 0.30"]


def test_one_line_of_several_axes_is_one_sentence_by_strength() -> None:
    """Of 100 counts of variance, amplitudes 10, 5 and 2 are 50, 12.5 and 2 %; 50.03 Hz is another line at 0.02 Hz."""
    axes = {
        "A": [axis_of("x", lines=[line_of(31.0, 5.0)])],
        "B": [axis_of("x", lines=[line_of(50.0, 10.0)]), axis_of("y", lines=[line_of(50.01, 5.0)])],
        "C": [axis_of("x", lines=[line_of(50.03, 2.0)])],
    }
    assert findings(result_of(axes)) == [
        "B x, y: a line at 50 Hz, amplitude 0.5 to 1 dps, 12 to 50 % of the variance, possibly 50 Hz mains",
        "A x: a line at 31 Hz, amplitude 0.5 +- 0.001 dps, 12 % of the variance",
        "C x: a line at 50.03 Hz, amplitude 0.2 +- 0.001 dps, 2 % of the variance, possibly 50 Hz mains",
    ]


def test_a_slow_change_of_the_mean_is_reported() -> None:
    """A variance of 100 counts squared, of which the spectrum of 1 Hz times 25 a bin has 25 % or all."""
    drifting = axis_of("z", density=[0.0, *[25.0] * 100])
    steady = axis_of("x", density=[0.0, *[100.0] * 100])
    spectrum = {"resolution_hz": 0.02, "segments": 20, "frequency_hz": [0.01 * number for number in range(101)]}
    result = result_of({"A": [steady, drifting], "B": [drifting]}, spectrum=spectrum)
    assert findings(result) == []  # a log that may contain motion
    result["stretch"]["phase"] = "pose 1"
    (text,) = findings(result)
    assert text.startswith("A, B z: 75 % of the variance is a slow change of the mean")


def test_clipping_at_a_known_rail_is_one_sentence() -> None:
    end = {"code": 2047, "share": 0.01, "p_value": 0.0}
    none = {"code": -1900, "share": 0.0, "p_value": None}
    codes = {"step": 1, "usual_step": 1, "even_share": 0.5, "missing": [], "low_end": none, "high_end": end}
    rails = {"low": [None], "high": [2047.0], "rows": [30], "flagged": 30}
    (text,) = findings(result_of({"A": [axis_of("x", codes=codes)]}, rails=rails))
    assert text == "A x: clips at 2047; 30 readings of the sensor are flagged as saturated in the log"
    (text,) = findings(result_of({"A": [axis_of("x", codes=codes)]}))
    assert text == "A x: readings accumulate at code 2047: clipped"


def test_rows_of_equal_time_are_reported() -> None:
    burst = {"kind": "bursts", "usual_s": 1e-9, "gap_s": 0.02, "sentence": "rows arrive in bursts, 1e-06 ms apart"}
    result = result_of({"A": [axis_of("x")]})
    result["sensors"][0]["timing"]["pattern"] = burst
    (text,) = findings(result)
    assert text.startswith("A: several rows have the same time, and the next time is 0.02 s later: the clock is coarse")


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["A1", "A2", "A3"], "A1 to A3"),
        (["A1", "A2"], "A1, A2"),
        (["A9", "A10", "A11", "B"], "A9 to A11, B"),
        (["IMU1_acc", "IMU2_acc", "IMU3_acc", "IMU5_acc"], "IMU1_acc to IMU3_acc, IMU5_acc"),
        (["A1", "B2", "C3"], "A1, B2, C3"),
        (["a1b1", "a1b2", "a1b3"], "a1b1, a1b2, a1b3"),
        ([], ""),
    ],
)
def test_consecutive_names_are_abbreviated(names: list[str], text: str) -> None:
    assert listed(names) == text

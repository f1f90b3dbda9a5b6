"""Diagnosis of published recordings: an MPU-6050 that warms up, read by a program that stalls, and an MPU-6050 and an
HMC5883L at rest whose rows a busy host stamped. Skipped where the recordings are absent.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import imuarray
from imuarray.gap.findings.deviations import lines_shown
from imuarray.gap.findings.diagnosis import Cause, Diagnosis
from imuarray.gap.inference.comparison import prepare
from imuarray.gap.recording.recordings import Recording, recording_of
from imuarray.importers.table import import_table
from imuarray.log import open_log
from imuarray.log.row_timing import row_timing
from tests.gap.small_campaign import where

RECORDINGS = Path(os.environ.get("IMUARRAY_RECORDINGS") or Path(__file__).parents[3] / "shared" / "data")
MAPS = Path(__file__).parents[2] / "configs" / "imports"
SOURCES = {
    "freeimu_thermal": RECORDINGS / "freeimu_thermal" / "thermal.csv.gz",
    "sunsided_mpu": RECORDINGS / "sunsided" / "mpu.csv.gz",
    "sunsided_mag": RECORDINGS / "sunsided" / "mag.csv.gz",
}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not all(source.exists() for source in SOURCES.values()), reason="the recordings are not here"),
]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Recording]]:
    """Each recording imported by the map of the package."""
    folder = tmp_path_factory.mktemp("recordings")
    for name, source in SOURCES.items():
        import_table(source, MAPS / f"{name}.toml", folder / f"{name}.h5")
    logs = {name: open_log(folder / f"{name}.h5") for name in SOURCES}
    yield {name: recording_of(log) for name, log in logs.items()}
    for log in logs.values():
        log.close()


@pytest.mark.parametrize("name", SOURCES)
def test_maps_have_twenty_lines_at_most(name: str) -> None:
    assert len((MAPS / f"{name}.toml").read_text().splitlines()) <= 20


@pytest.mark.parametrize("name", SOURCES)
def test_a_box_without_motion_has_one_attitude(recordings: dict[str, Recording], name: str) -> None:
    """The sensor that warms by 18 degC in it is heated, though slowly; the two of the other box rest in a room."""
    recording = recordings[name]
    (phase,) = recording.phases
    length_s = {"freeimu_thermal": 2158}.get(name, 655)
    assert recording.kind == {"freeimu_thermal": "heating"}.get(name, "static")
    assert (phase.end_ns - phase.start_ns) * 1e-9 == pytest.approx(length_s, abs=4)  # ends may be cut by 3 s


def test_stalls_are_measured(recordings: dict[str, Recording]) -> None:
    """2.83 s after every 51 rows, 1071 s of 2158."""
    found = recordings["freeimu_thermal"]
    timing = row_timing(found.log["Acc"])
    assert (timing.kind, timing.period_rows, timing.gaps) == ("stalls", 51, 378)
    assert timing.gap_s == pytest.approx(2.833, abs=0.001)
    assert timing.gaps_s == pytest.approx(1071, abs=1)
    assert any("Acc, Gyro: rows stall for 2.83 s after every 51 rows" in note for note in found.notes)


@pytest.mark.parametrize(("name", "sensor", "rate_hz"), [("sunsided_mpu", "Acc", 99.3), ("sunsided_mag", "Mag", 76.93)])
def test_bursts_are_recognised(recordings: dict[str, Recording], name: str, sensor: str, rate_hz: float) -> None:
    timing = row_timing(recordings[name].log[sensor])
    assert timing.kind == "bursts"
    assert timing.rate_hz == pytest.approx(rate_hz, abs=0.03)


def test_the_temperature_of_the_die_is_used(recordings: dict[str, Recording]) -> None:
    """10.4 to 28.9 degC; the chip of a nearby barometer was 0.9 degC colder throughout."""
    found = recordings["freeimu_thermal"]
    degc = found.experiment.motion.stimulus(np.array([17, 300, 2174], np.int64) * 10**9).temperature_degc
    assert degc[[0, 2]] == pytest.approx([10.5, 28.9], abs=0.5)
    assert any("taken from a chip's own thermometer" in note for note in found.notes)


@pytest.mark.parametrize(
    ("name", "sensor", "axis", "said"),
    [
        ("sunsided_mag", "Mag", "yz", "yz 26.93 Hz, an alias of 50 Hz, the mains (76.9 rows a second)"),
        ("sunsided_mag", "Mag", "xyz", "xyz 24.40 Hz"),
        ("sunsided_mpu", "Gyro", "z", "z 31.4"),
    ],
)
def test_lines_are_measured(recordings: dict[str, Recording], name: str, sensor: str, axis: str, said: str) -> None:
    _, campaign = prepare([recordings[name]], None, 0)
    (told,) = lines_shown(campaign, [where(sensor, axis[-1])], ())
    assert said in told


DiagnosisOf = Callable[[str], Diagnosis]


@pytest.fixture(scope="module")
def diagnosis_of(recordings: dict[str, Recording]) -> DiagnosisOf:
    """Return the function that gives the diagnosis of a recording, made when a test first needs it."""
    return cache(lambda name: imuarray.diagnose([recordings[name].log], replicates=60))


def named(found: Diagnosis, effect: str, sensor: str) -> Cause:
    """The most probable cause of this effect: the gyroscope has a weak line at 19.9 Hz in addition to
    that at 31.4 Hz.
    """
    return next(cause for cause in found.causes if cause.effect == effect and sensor in cause.sensors)


@pytest.mark.campaign
def test_even_codes_and_the_slope_of_the_bias_are_stated(diagnosis_of: DiagnosisOf) -> None:
    """Slope by R scripts of the source's authors and by block means: -1.72 mg/degC, beyond the data sheet."""
    found = diagnosis_of("freeimu_thermal")
    assert named(found, "quantisation", "Acc").parameters["step_lsb"] == 2
    (slope,) = (
        pull
        for pull in found.pulls
        if (pull.sensor, pull.axis, pull.quantity) == ("Acc", "z", "thermal slope of the bias")
    )
    assert slope.is_out_of_specification
    assert slope.value == pytest.approx(-1.72e-3, rel=0.2)
    assert not any(one.effect == "random_walk" and "Acc" in one.sensors for one in found.causes)


@pytest.mark.campaign
def test_the_curvature_over_temperature_is_named(diagnosis_of: DiagnosisOf) -> None:
    found = diagnosis_of("freeimu_thermal")
    heat = named(found, "thermal_bias", "Acc").each["Acc"]
    assert heat["slope_g_per_degc"][2] == pytest.approx(-1.72e-3, rel=0.2)
    assert heat["quadratic_g_per_degc2"][2] > 1e-5


def test_codes_in_fours_and_the_line_of_the_gyroscope_are_named(diagnosis_of: DiagnosisOf) -> None:
    found = diagnosis_of("sunsided_mpu")
    assert named(found, "quantisation", "Acc").parameters["step_lsb"] == 4
    assert named(found, "tone", "Gyro").parameters["frequency_hz"] == pytest.approx(31.4, abs=0.15)


def test_the_lines_of_the_magnetometer_are_named(diagnosis_of: DiagnosisOf) -> None:
    found = diagnosis_of("sunsided_mag")
    lines_hz = [cause.parameters["frequency_hz"] for cause in found.causes if cause.effect == "tone"]
    assert any(hertz == pytest.approx(24.4, abs=0.05) for hertz in lines_hz)
    assert any("an alias of 50 Hz, the mains" in note for note in found.notes)
    assert any("The true rate is 76.93 Hz" in note for note in found.notes)

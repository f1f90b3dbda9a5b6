"""Published recordings, each imported by the map of the package, with the known properties in the report. The whole
recordings are skipped where they are absent; extracts are in tests/data.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.log import open_log
from imuarray.log.format import ARRIVAL

ROOT = Path(__file__).parents[2]
MAPS = ROOT / "configs" / "imports"
RECORDINGS = Path(os.environ.get("IMUARRAY_RECORDINGS") or ROOT.parent / "shared" / "data")
FILES = {
    "freeimu_thermal": "freeimu_thermal/thermal.csv.gz",
    "sunsided_mpu": "sunsided/mpu.csv.gz",
    "sunsided_mag": "sunsided/mag.csv.gz",
    "mimu4444": "mimu4444/exp_1.bin",
}
EXTRACTS = {
    "freeimu_thermal": "freeimu_thermal/thermal_extract.csv.gz",
    "mimu4444": "mimu4444/exp_1_extract.bin",
}

whole = pytest.mark.skipif(not (RECORDINGS / "sunsided").is_dir(), reason="the recordings are not here")

Capture = pytest.CaptureFixture[str]


def said_of(source: Path, name: str, run: Path, capsys: Capture) -> str:
    """The report of an import by the map of that name."""
    assert main(["import", str(source), "--map", name, "-o", str(run)]) == 0
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("name", FILES)
def test_maps_have_twenty_lines_at_most(name: str) -> None:
    assert len((MAPS / f"{name}.toml").read_text().splitlines()) <= 20


def test_the_report_of_an_extract_of_the_thermal_ramp(tmp_path: Path, capsys: Capture) -> None:
    source = ROOT / "tests" / "data" / EXTRACTS["freeimu_thermal"]
    text = said_of(source, "freeimu_thermal", tmp_path / "run.h5", capsys)
    assert "Acc, Gyro: rows stall for 2.83 s after every 51 rows" in text
    assert "Acc: only even codes" in text
    assert "Acc: measures 0.99" in text
    assert "Acc: its thermometer reads 10.38 to 16.49 degC" in text
    assert "?" not in text


@pytest.mark.slow
def test_the_report_of_an_extract_of_the_board(tmp_path: Path, capsys: Capture) -> None:
    source = ROOT / "tests" / "data" / EXTRACTS["mimu4444"]
    text = said_of(source, "mimu4444", tmp_path / "run.h5", capsys)
    assert "xyz clips at -32768 (-1998 dps) and 32767 (1998 dps); " in text
    assert "g at rest" in text
    assert "lost: 20" in text
    assert "bursts" not in text  # the packets are numbered: the extract lacks some, and none is late
    assert "?" not in text


@whole
@pytest.mark.slow
def test_the_report_of_the_thermal_ramp(tmp_path: Path, capsys: Capture) -> None:
    """Stalls of 2.83 s after 51 rows, 1071 of 2158 s in all; even codes; the die from 10.4 to 28.9 degC."""
    text = said_of(RECORDINGS / FILES["freeimu_thermal"], "freeimu_thermal", tmp_path / "run.h5", capsys)
    assert "63792 rows each over 2158.0 s" in text
    assert "rows stall for 2.83 s after every 51 rows: no rows in 1071 of 2158 s" in text
    assert "only even codes" in text
    assert "Acc: its thermometer reads 10.38 to " in text


@whole
@pytest.mark.slow
@pytest.mark.parametrize(("name", "rate"), [("sunsided_mpu", "99.32"), ("sunsided_mag", "76.93")])
def test_the_report_of_ten_minutes_at_rest(name: str, rate: str, tmp_path: Path, capsys: Capture) -> None:
    """Codes in fours, temperature in steps of 32, arrival times in bursts, 3 % of the compass's frames stale."""
    run = tmp_path / "run.h5"
    text = said_of(RECORDINGS / FILES[name], name, run, capsys)
    assert f"rows arrive in bursts, 2.{'03' if name == 'sunsided_mpu' else '35'} ms apart" in text
    assert f"The true rate is {rate} Hz" in text
    if name == "sunsided_mpu":
        assert "Acc: only every 4th code" in text
        assert "in steps of 32 counts (0.094 degC)" in text
        assert "Acc: measures 1.037 g at rest" in text
    else:
        assert "Mag: 2.7 % of the rows repeat the previous row" in text
    assert "?" not in text


@whole
@pytest.mark.slow
def test_the_compass_is_characterised_over_all_its_rows(tmp_path: Path, capsys: Capture) -> None:
    """Lines at 24.40 Hz and 76.93 - 50.01 = 26.92 Hz, the mains' alias; no row is excluded for its
    arrival in a burst.
    """
    run = tmp_path / "run.h5"
    said_of(RECORDINGS / FILES["sunsided_mag"], "sunsided_mag", run, capsys)
    assert main(["characterise", str(run), "--json"]) == 0
    (sensor,) = json.loads(capsys.readouterr().out)["sensors"]
    assert sensor["rate_hz"] == pytest.approx(76.93, abs=0.01)
    assert (sensor["gaps"], sensor["allan_run"]["left_out_share"]) == (0, 0)
    assert sensor["timing"]["pattern"]["kind"] == "bursts"
    lines_hz = [line["frequency_hz"] for line in sensor["axes"][1]["lines"]]
    assert any(hertz == pytest.approx(24.40, abs=0.03) for hertz in lines_hz)
    assert any(hertz == pytest.approx(26.92, abs=0.03) for hertz in lines_hz)
    assert main(["characterise", str(run)]) == 0
    assert "2.7 % of the rows repeat the previous row" in " ".join(capsys.readouterr().out.split())


@whole
@pytest.mark.slow
def test_wide_lines_are_detected(tmp_path: Path, capsys: Capture) -> None:
    """The gyroscope's z at 31.4 Hz; x of unit 4, whose frequency varies between 8.7 and 12.9 Hz."""
    for name, sensor, axis, low_hz, high_hz in (
        ("sunsided_mpu", "Gyro", 2, 31.3, 31.5),
        ("mimu4444", "IMU4_acc", 0, 8.7, 12.9),
    ):
        run = tmp_path / f"{name}.h5"
        said_of(RECORDINGS / FILES[name], name, run, capsys)
        assert main(["characterise", str(run), "--sensor", sensor, "--json"]) == 0
        (result,) = json.loads(capsys.readouterr().out)["sensors"]
        strongest = result["axes"][axis]["lines"][0]
        assert low_hz < strongest["frequency_hz"] < high_hz and strongest["width_hz"] > 0.3


@whole
@pytest.mark.slow
def test_regularised_times_of_the_compass(tmp_path: Path, capsys: Capture) -> None:
    """Mean intervals of 13 ms, and the raw times in addition, to the nanosecond."""
    source = RECORDINGS / FILES["sunsided_mag"]
    text = (MAPS / "sunsided_mag.toml").read_text().replace('unit = "s"', 'unit = "s", stamps = "arrival"')
    (tmp_path / "map.toml").write_text(text)
    said_of(source, "sunsided_mag", tmp_path / "raw.h5", capsys)
    assert "Mag: reading times reconstructed at 76.9" in said_of(
        source, str(tmp_path / "map.toml"), tmp_path / "even.h5", capsys
    )
    with open_log(tmp_path / "raw.h5") as raw, open_log(tmp_path / "even.h5") as even:
        time = np.asarray(even["Mag"].time)
        assert np.std(np.diff(time)) < 1e-4 * 1e9
        delay_ns = np.rint(np.asarray(even["Mag"].compensated(ARRIVAL)) * 1e9).astype(np.int64)
        np.testing.assert_array_equal(time + delay_ns, raw["Mag"].time[:])


@whole
@pytest.mark.slow
def test_the_report_of_the_board(tmp_path: Path, capsys: Capture) -> None:
    text = said_of(RECORDINGS / FILES["mimu4444"], "mimu4444", tmp_path / "run.h5", capsys)
    assert "16 sensors" in text and "0 lost" in text
    assert "g at rest" in text and "xyz clips at" in text
    assert "?" not in text


@whole
@pytest.mark.slow
@pytest.mark.parametrize("name", ["freeimu_thermal", "sunsided_mpu", "sunsided_mag"])
def test_a_guessed_map_imports_unchanged(name: str, tmp_path: Path, capsys: Capture) -> None:
    """Unknown entries are marked: ranges of gyroscopes, the scale of a thermometer. A scale that no rotation shows is
    the only doubt after the import.
    """
    source = RECORDINGS / FILES[name]
    assert main(["import", str(source), "--guess", "-o", str(tmp_path / "map.toml")]) == 0
    text = said_of(source, str(tmp_path / "map.toml"), tmp_path / "run.h5", capsys)
    unknown = "? Gyro: the scale of the gyroscope is a guess, and no rotation shows it; if it is true, remove"
    assert text.count("?") == text.count(unknown) == (name != "sunsided_mag")
    guessed = (tmp_path / "map.toml").read_text()
    assert "# ?" in guessed
    assert ("sensitivity = 16384" in guessed) == (name != "sunsided_mag")

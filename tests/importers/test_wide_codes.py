"""Codes of more than 16 bits are kept in a log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.errors import SourceError
from imuarray.export import export
from imuarray.importers import importer_of
from imuarray.importers.guess import guess_map
from imuarray.importers.plausibility import report_of
from imuarray.importers.table import import_table
from imuarray.log import SensorLog, open_log
from tests.importers.recordings import G, joined, lines_of, walk
from tests.selection import some

HEAD = "t,ax,ay,az"
MAP = """
[time]
column = "t"
unit = "s"

[[sensor]]
name = "Acc"
chip = "adxl355"
quantity = "specific_force"
columns = ["ax", "ay", "az"]
unit = "g"
"""
ADXL355 = MAP + "range = 2.048\nsensitivity = 256000\n"


def write(folder: Path, values: np.ndarray, form: str, head: str = HEAD) -> Path:
    path = folder / "recording.csv"
    path.write_bytes(joined([head, *lines_of(np.arange(len(values)) * 0.01, values, form)]))
    return path


def imported(folder: Path, source: Path, map_text: str) -> tuple[SensorLog, tuple[str, ...]]:
    (folder / "map.toml").write_text(map_text)
    summary = import_table(source, folder / "map.toml", folder / "run.h5", force=True)
    return open_log(folder / "run.h5")["Acc"], summary.remarks


def codes_of_20_bits() -> np.ndarray:
    """All of the lowest bits and both ends occur; 256000 counts per g (ADXL355 data sheet, table 1)."""
    rng = np.random.default_rng(355)
    codes = np.rint((walk(600).force_g + rng.normal(0, 1e-4, (600, 3))) * 256_000).astype(int)
    codes[:2] = [[-524_288, 524_287, 1], [65_537, -65_537, 2]]
    return codes


def test_codes_of_20_bits_are_kept(tmp_path: Path) -> None:
    codes = codes_of_20_bits()
    sensor, remarks = imported(tmp_path, write(tmp_path, codes, "{:d}"), ADXL355)
    assert sensor.count_bits == 20
    assert np.array_equal(np.asarray(sensor.counts[:]), codes)
    assert np.asarray(sensor.status[:2]).tolist() == [4, 0]  # saturated: both ends of 20 bits
    assert remarks[0] == (
        "Acc: 256000 counts per g, range 2.048 g, as the map says, stored without loss as counts of 20 bits"
    )


def test_twos_complement_of_24_bits_read_as_unsigned_is_restored(tmp_path: Path) -> None:
    codes = codes_of_20_bits() * 16
    source = write(tmp_path, codes % (1 << 24), "{:d}")
    sensor, _ = imported(tmp_path, source, MAP + "range = 2.048\nsensitivity = 4096000\nbits = 24\n")
    assert sensor.count_bits == 24
    assert np.array_equal(np.asarray(sensor.counts[:]), codes)


def test_a_wide_range_of_the_map_alone_gives_no_wide_counts(tmp_path: Path) -> None:
    codes = np.rint(walk(600).force_g * 4096).astype(int)
    sensor, _ = imported(tmp_path, write(tmp_path, codes, "{:d}"), MAP + "range = 16\nsensitivity = 4096\n")
    assert sensor.count_bits == 16
    assert np.asarray(sensor.counts[:]).dtype == np.int16


def test_a_code_beyond_the_bits_is_refused_with_the_remedy(tmp_path: Path) -> None:
    source = write(tmp_path, codes_of_20_bits(), "{:d}")
    with pytest.raises(SourceError, match=r"allowed are -32768 to 32767; .* for codes of more than 16 bits, bits"):
        imported(tmp_path, source, MAP + "range = 2\nsensitivity = 16384\n")


def test_values_on_the_grid_of_a_wide_chip_are_its_codes(tmp_path: Path) -> None:
    codes = codes_of_20_bits()
    sensor, _ = imported(tmp_path, write(tmp_path, codes / 256_000, "{:.8f}"), MAP)
    assert (sensor.count_bits, sensor.sensitivity, sensor.range) == (20, 256_000.0, 2.048)
    assert np.array_equal(np.asarray(sensor.counts[:]), codes)
    assert "resolution" not in sensor.attributes


def test_noise_below_a_count_of_16_bits_keeps_the_digits(tmp_path: Path) -> None:
    """1 ug of noise: 16 bits over 2 g have 61 ug each. The text has seven decimals of m/s2."""
    rng = np.random.default_rng(7)
    values = np.round((np.array([0.01, -0.02, 1.0]) + rng.normal(0, 1e-6, (600, 3))) * G, 7)
    sensor, _ = imported(tmp_path, write(tmp_path, values, "{:.7f}"), MAP.replace('"g"', '"m/s2"'))
    kept = np.asarray(sensor.counts[:]) / sensor.sensitivity * G
    assert float(np.abs(kept - values).max()) < 1e-9
    assert sensor.attributes["resolution"] == "digits"


def test_fine_values_without_a_grid_are_rounded_to_a_sixteenth_of_their_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    values = np.array([0.01, -0.02, 1.0]) + rng.normal(0, 1e-6, (600, 3))
    np.savez(tmp_path / "recording.npz", t=np.arange(600) * 0.01, acc=values)
    map_text = MAP.replace('["ax", "ay", "az"]', '["acc[0]", "acc[1]", "acc[2]"]')
    sensor, remarks = imported(tmp_path, tmp_path / "recording.npz", map_text)
    kept = np.asarray(sensor.counts[:]) / sensor.sensitivity
    assert float(np.abs(kept - values).max()) < 1e-6 / 16
    assert sensor.attributes["resolution"] == "assumed"
    assert "assumed so that" in remarks[0]


def test_coarse_noise_stays_in_16_bits(tmp_path: Path) -> None:
    """5 mg of noise are 82 counts of 16 bits over 2 g: digits of a text do not widen the counts."""
    sensor, _ = imported(tmp_path, write(tmp_path, walk(600).force_g, "{:.7f}"), MAP)
    assert sensor.count_bits == 16


@pytest.mark.parametrize("suffix", some(["npz", "csv", "parquet"], 1))
def test_exported_counts_are_imported_unchanged(tmp_path: Path, suffix: str) -> None:
    codes = codes_of_20_bits()
    imported(tmp_path, write(tmp_path, codes, "{:d}"), ADXL355)
    target = tmp_path / f"again.{suffix}"
    export(tmp_path / "run.h5", target)
    read = importer_of(target)
    assert read is not None
    read(target, tmp_path / "again.h5")
    with open_log(tmp_path / "again.h5") as log:
        assert log["Acc"].count_bits == 20
        assert np.array_equal(np.asarray(log["Acc"].counts[:]), codes)


@pytest.mark.slow
def test_guess_names_the_scale_of_wide_codes(tmp_path: Path) -> None:
    """ADIS16470: 52428800 counts per g and 655360 counts per dps in 32 bits (data sheet, tables of the outputs)."""
    recording = walk(4000)
    codes = np.rint(np.hstack([recording.force_g * 52_428_800, recording.rate_dps * 655_360])).astype(int)
    source = write(tmp_path, codes, "{:d}", "t,ax,ay,az,gx,gy,gz")
    proposed = guess_map(source)
    assert "sensitivity = 52428800 " in proposed
    assert "sensitivity = 655360 " in proposed
    (tmp_path / "map.toml").write_text(proposed)
    import_table(source, tmp_path / "map.toml", tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert np.array_equal(np.asarray(log["Gyro"].counts[:]), codes[:, 3:])
        assert report_of(log).doubts == ()

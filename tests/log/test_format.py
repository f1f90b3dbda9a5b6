"""The file as read by h5py alone: names, types and attributes as the format is described; and in xarray."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from imuarray.errors import LogError
from imuarray.log import open_log
from imuarray.log.format import SensorHeader
from imuarray.log.reader import verify

EPOCH = "2013-09-16T08:30:00.000000Z"


def test_the_root_has_its_attributes_and_groups(small: Path) -> None:
    with h5py.File(small) as file:
        attrs = dict(file.attrs)
        assert (attrs["format"], attrs["format_version"], attrs["epoch"], attrs["source"]) == (
            "imuarray-log",
            1,
            EPOCH,
            "simulated",
        )
        assert attrs["config"] == "# toml"
        assert attrs["software"].startswith("imuarray ")
        assert set(file) == {"sensors", "events", "phases", "truth", "plots"}
        assert set(file["sensors"]) == {"Acc", "Gyro", "Baro"}


def test_a_triad_has_its_attributes(small: Path) -> None:
    with h5py.File(small) as file:
        attrs = dict(file["sensors/Acc"].attrs)
        assert (attrs["chip"], attrs["quantity"], attrs["unit"]) == ("bma180", "specific_force", "g")
        assert (attrs["range"], attrs["sensitivity"], attrs["rate_hz"], attrs["bandwidth_hz"]) == (16, 512, 2400, 150)
        assert attrs["axes"] == "+Y+X-Z"
        np.testing.assert_array_equal(attrs["orientation"], [[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        np.testing.assert_array_equal(attrs["position_mm"], [1.0, -2.0, 3.5])
        assert list(attrs["columns"]) == ["x", "y", "z"]
        assert "delay_ns" not in attrs
        assert file["sensors/Gyro"].attrs["delay_ns"] == 1_500_000


def test_columns_have_their_types_and_shapes(small: Path) -> None:
    with h5py.File(small) as file:
        shapes = {
            name: {
                column: (dataset.dtype, dataset.shape)
                for column, dataset in file["sensors"][name].items()
                if column != "axis"
            }
            for name in ("Acc", "Gyro", "Baro")
        }
        i2, i4, i8, u2, f8 = (np.dtype(kind) for kind in ("int16", "int32", "int64", "uint16", "float64"))
        assert shapes["Acc"] == {
            "time": (i8, (5,)),
            "counts": (i2, (5, 3)),
            "status": (u2, (5,)),
            "temperature_counts": (i2, (5,)),
        }
        assert shapes["Gyro"] == {"time": (i8, (3,)), "counts": (i2, (3, 3)), "status": (u2, (3,))}
        assert shapes["Baro"] == {
            "time": (i8, (2,)),
            "counts": (i4, (2, 2)),
            "status": (u2, (2,)),
            "temperature": (f8, (2,)),
            "pressure": (f8, (2,)),
        }
        assert file["sensors/Acc/time"].attrs["units"] == f"nanoseconds since {EPOCH}"


def test_the_barometers_words_are_attributes(small: Path) -> None:
    with h5py.File(small) as file:
        attrs = file["sensors/Baro"].attrs
        assert list(attrs["columns"]) == ["ut", "up"]
        assert (attrs["AC1"], attrs["MD"]) == (408, 2868)


def test_phases_and_events_are_tables(small: Path) -> None:
    with h5py.File(small) as file:
        assert {name: file["phases"][name][:].tolist() for name in file["phases"]} == {
            "start": [0, 20_000_000],
            "end": [20_000_000, 50_000_000],
            "name": [b"z_up", b"motion"],
            "up": [b"+Z", b""],
        }
        assert file["events"]["time"][:].tolist() == [30_000_000]
        assert set(file["events"]) == {"time", "sensor", "kind", "message"}
        assert file["phases"]["start"].dtype == file["events"]["time"].dtype == np.dtype("int64")


def test_the_truth_has_its_columns(small: Path) -> None:
    with h5py.File(small) as file:
        assert {name: dataset.shape for name, dataset in file["truth"].items()} == {
            "time": (5,),
            "specific_force": (5, 3),
            "angular_rate": (5, 3),
            "temperature": (5,),
            "axis": (3,),
        }


def test_long_logs_are_compressed_in_chunks(small: Path) -> None:
    with h5py.File(small) as file:
        counts = file["sensors/Acc/counts"]
        assert counts.compression == "gzip"
        assert counts.chunks is not None
        assert counts.maxshape[0] is None


class TestXarray:
    @pytest.fixture(autouse=True)
    def _needs(self) -> None:
        pytest.importorskip("xarray")
        pytest.importorskip("h5netcdf")

    @pytest.mark.slow
    def test_opens_in_physical_units_and_datetimes(self, small: Path) -> None:
        import xarray

        with xarray.open_dataset(small, engine="h5netcdf", group="sensors/Acc") as acc:
            assert acc.counts.dims == ("time", "axis")
            np.testing.assert_allclose(acc.counts[0], [9.80665, -4.903325, 0.0])  # 512 counts are one g
            assert acc.counts.attrs["units"] == "m s-2"
            assert acc.time.dtype == np.dtype("datetime64[ns]")
            assert acc.time.values[1] == np.datetime64("2013-09-16T08:30:00.010000000")
            assert list(acc.axis.values) == ["x", "y", "z"]
            assert acc.status.dims == ("time",)
        with xarray.open_dataset(small, engine="h5netcdf", group="sensors/Gyro") as gyro:
            np.testing.assert_allclose(gyro.counts[0], np.radians([8.75, 0.0, -8.75]))  # 8.75 mdps per count: L3G-40
            assert gyro.counts.attrs["units"] == "rad s-1"
            text = "readers that apply scale_factor (xarray) show rad s-1. unit, dps, is that of range and sensitivity"
            assert text in gyro.attrs["comment"]
        with xarray.open_dataset(small, engine="h5netcdf", group="sensors/Baro") as baro:
            np.testing.assert_array_equal(baro.pressure, [69963.0, 69970.0])
            np.testing.assert_array_equal(baro.counts, [[27898, 190744], [27900, 190750]])
            assert (baro.pressure.attrs["units"], baro.temperature.attrs["units"]) == ("Pa", "degC")

    def test_is_sliced_lazily(self, small: Path) -> None:
        import xarray

        with xarray.open_dataset(small, engine="h5netcdf", group="sensors/Acc") as acc:
            assert not acc.counts.variable._in_memory
            part = acc.sel(time=slice("2013-09-16T08:30:00.010", "2013-09-16T08:30:00.030"))
            assert part.sizes["time"] == 3
            assert not acc.counts.variable._in_memory

    def test_truth_opens_with_its_times(self, small: Path) -> None:
        import xarray

        with xarray.open_dataset(small, engine="h5netcdf", group="truth") as truth:
            assert truth.specific_force.dims[0] == "time"


def test_the_factory_adjustment_divides_the_counts_per_unit() -> None:
    """(ASA + 128) / 256: 128 is none, 0 half, 255 almost one and a half (AKM-16). Invalid values are no adjustment."""

    def header(**words: Any) -> SensorHeader:
        return SensorHeader("HMC", "ak8963", "magnetic_field", "gauss", 49.12, 667.0, extra=words)

    assert header(asa_x=128, asa_y=0, asa_z=255).adjustment == pytest.approx((1.0, 2.0, 0.66840731))
    assert header(asa_x=-1, asa_y=256, asa_z="176").adjustment == (1.0, 1.0, 1.0)
    assert header().adjustment == (1.0, 1.0, 1.0)
    assert header(asa_x=128, asa_y=0, asa_z=255).axis_sensitivity == pytest.approx((667.0, 1334.0, 445.827569))


def test_a_finished_log_has_nothing_to_report(small: Path) -> None:
    with open_log(small) as log:
        assert (log.state, log.has_journal, log.damaged_commits, log.is_rebuilt) == ("finished", True, 0, False)
    verdict = verify(small)
    assert (verdict.problems, verdict.remarks) == ((), ())


def test_a_barometer_needs_no_range(small: Path) -> None:
    """Its words have no scale; a triad is not read without its sensitivity."""
    with h5py.File(small, "r+") as file:
        for attribute in ("range", "sensitivity", "bandwidth_hz"):
            del file["sensors/Baro"].attrs[attribute]
    with open_log(small) as log:
        assert (log["Baro"].range, log["Baro"].sensitivity) == (0.0, 0.0)
    with h5py.File(small, "r+") as file:
        del file["sensors/Acc"].attrs["sensitivity"]
    with (
        pytest.raises(LogError, match="sensor Acc: attribute sensitivity is missing, a number is required"),
        open_log(small),
    ):
        pass

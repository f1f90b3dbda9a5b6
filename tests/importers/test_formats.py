"""Counts survive every unit, offset and format: written like another program, imported, and exported again."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.cli import main
from imuarray.errors import SourceError
from imuarray.importers.table import import_table
from imuarray.log import open_log
from imuarray.log.format import ARRIVAL, SATURATED
from tests.selection import examples, some

Columns = Mapping[str, np.ndarray]
Write = Callable[[Path, Columns], Path]

SENSOR = """
[[sensor]]
name = "S"
chip = "any"
quantity = "{quantity}"
columns = ["x", "y", "z"]
unit = "{unit}"
range = {range}
{how}
"""
SI = {  # of one unit: the definitions of g (CGPM 1901), degree, gauss
    "g": 9.80665, "mg": 9.80665e-3, "m/s2": 1.0, "dps": np.pi / 180, "deg/s": np.pi / 180, "mdps": np.pi / 180e3,
    "ft/s2": 0.3048, "deg/h": np.pi / 180 / 3600, "rpm": 2 * np.pi / 60, "rad/s": 1.0, "mrad/s": 1e-3,
    "gauss": 1e-4, "mgauss": 1e-7, "T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9,
}  # fmt: skip
QUANTITIES = {
    "specific_force": (("g", "mg", "m/s2", "ft/s2"), 2048.0, "g"),
    "angular_rate": (("dps", "deg/s", "mdps", "rad/s", "mrad/s", "deg/h", "rpm"), 16.4, "dps"),
    "magnetic_field": (("gauss", "mgauss", "T", "mT", "uT", "nT"), 1090.0, "gauss"),
}


def write_csv(folder: Path, columns: Columns) -> Path:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    text = ",".join(columns) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    (folder / "data.csv").write_text(text)
    return folder / "data.csv"


def write_gzip(folder: Path, columns: Columns) -> Path:
    data = gzip.compress(write_csv(folder, columns).read_bytes())
    (folder / "data.csv.gz").write_bytes(data)
    return folder / "data.csv.gz"


def write_npz(folder: Path, columns: Columns) -> Path:
    arrays: dict[str, Any] = dict(columns)
    np.savez(folder / "data.npz", **arrays)
    return folder / "data.npz"


def write_npy(folder: Path, columns: Columns) -> Path:
    rows = np.empty(len(columns["t"]), [(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    np.save(folder / "data.npy", rows)
    return folder / "data.npy"


def write_mat5(folder: Path, columns: Columns) -> Path:
    from scipy.io import savemat

    savemat(folder / "data.mat", dict(columns), oned_as="column")
    return folder / "data.mat"


def write_mat73(folder: Path, columns: Columns) -> Path:
    """Write like MATLAB: a block of 512 bytes before HDF5, a column is 1 by n."""
    path = folder / "data73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, column in columns.items():
            file[name] = column[np.newaxis, :]
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: ".ljust(124) + b"\x00\x02IM")
    return path


def write_parquet(folder: Path, columns: Columns) -> Path:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(
        pyarrow.table({name: pyarrow.array(column) for name, column in columns.items()}), folder / "d.pq"
    )
    return folder / "d.pq"


FORMATS: dict[str, Write] = {
    "csv": write_csv,
    "gzip": write_gzip,
    "npz": write_npz,
    "npy": write_npy,
    "mat 5": write_mat5,
    "mat 7.3": write_mat73,
    "parquet": write_parquet,
}

TIME = '[time]\ncolumn = "t"\nunit = "ns"\n'
COUNT = st.integers(-32768, 32767)
TRIADS = st.lists(st.tuples(COUNT, COUNT, COUNT), min_size=3, max_size=20)


def exported(folder: Path, source: Path, table_map: str) -> tuple[np.ndarray, np.ndarray]:
    """Counts and times after an import to a log and `imuarray export`."""
    (folder / "map.toml").write_text(table_map)
    import_table(source, folder / "map.toml", folder / "run.h5", force=True)
    assert main(["export", str(folder / "run.h5"), "-o", str(folder / "run.npz"), "--force"]) == 0
    with np.load(folder / "run.npz") as file:
        (counts,) = (file[name] for name in file.files if name.endswith("counts"))
        (time,) = (file[name] for name in file.files if name.endswith("time"))
    return counts, time


@pytest.mark.parametrize(("form", "unit"), some(list(zip(("csv", "npz", "mat 5", "parquet"), SI, strict=False)), 2))
def test_every_format_keeps_counts_and_times(form: str, unit: str, tmp_path: Path) -> None:
    """The quick half of the property tests below."""
    quantity = next(name for name, (units, _, _) in QUANTITIES.items() if unit in units)
    counts = np.array([[-32768, 32767, 0], [1, -1, 2], [12345, -1, 0]])
    per_unit = QUANTITIES[quantity][1] * SI[unit] / SI[QUANTITIES[quantity][2]]
    how = f"sensitivity = {per_unit!r}\nvalues = 'physical'"
    sensor = SENSOR.format(quantity=quantity, unit=unit, range=32768 / per_unit, how=how)
    result, _ = exported(tmp_path, FORMATS[form](tmp_path, columns_of(counts / per_unit)), TIME + sensor)
    np.testing.assert_array_equal(result, counts)


def columns_of(values: np.ndarray) -> dict[str, np.ndarray]:
    time = np.arange(len(values), dtype=np.int64) * 10_000_000 + 1_367_400_000_123_456_789
    return {"t": time, "x": values[:, 0], "y": values[:, 1], "z": values[:, 2]}


@pytest.mark.slow
@settings(max_examples=examples(30), deadline=None)
@given(TRIADS, st.sampled_from(list(FORMATS)), st.integers(-100_000, 100_000))
def test_codes_with_any_offset_are_kept(triads: list[tuple[int, int, int]], form: str, offset: int) -> None:
    counts = np.array(triads, np.int64)
    sensor = SENSOR.format(quantity="specific_force", unit="g", range=16, how=f"sensitivity = 2048\noffset = {offset}")
    with TemporaryDirectory() as name:
        columns = columns_of(counts + offset)
        result, time = exported(Path(name), FORMATS[form](Path(name), columns), TIME + sensor)
    np.testing.assert_array_equal(result, counts)
    np.testing.assert_array_equal(time, columns["t"])


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None)
@given(
    TRIADS,
    st.sampled_from(list(FORMATS)),
    st.sampled_from([(q, u) for q, (us, _, _) in QUANTITIES.items() for u in us]),
)
def test_values_in_any_unit_give_their_counts(
    triads: list[tuple[int, int, int]], form: str, which: tuple[str, str]
) -> None:
    quantity, unit = which
    _, per_log_unit, log_unit = QUANTITIES[quantity]
    counts = np.array(triads, np.int64)
    per_unit = per_log_unit * SI[unit] / SI[log_unit]
    how = f"sensitivity = {per_unit!r}\nvalues = 'physical'"
    sensor = SENSOR.format(quantity=quantity, unit=unit, range=32768 / per_unit, how=how)
    with TemporaryDirectory() as name:
        folder = Path(name)
        result, _ = exported(folder, FORMATS[form](folder, columns_of(counts / per_unit)), TIME + sensor)
        with open_log(folder / "run.h5") as log:
            assert log["S"].unit == log_unit
            assert log["S"].sensitivity == pytest.approx(per_log_unit, rel=1e-12)
            assert log["S"].range == pytest.approx(32768 / per_log_unit, rel=1e-12)
    np.testing.assert_array_equal(result, counts)


@pytest.mark.slow
@settings(max_examples=examples(20), deadline=None)
@given(TRIADS, st.integers(8, 32))
def test_twos_complement_read_as_unsigned_is_restored(triads: list[tuple[int, int, int]], bits: int) -> None:
    counts = np.array(triads, np.int64) >> max(16 - bits, 0) << max(bits - 16, 0)
    counts += np.arange(counts.size).reshape(counts.shape) % (1 << max(bits - 16, 0))  # the lowest bits occur, too
    sensor = SENSOR.format(quantity="angular_rate", unit="mdps", range=1e6, how=f"scale = 61.0\nbits = {bits}")
    with TemporaryDirectory() as name:
        result, _ = exported(Path(name), write_csv(Path(name), columns_of(counts % (1 << bits))), TIME + sensor)
        with open_log(Path(name) / "run.h5") as log:
            assert log["S"].sensitivity == pytest.approx(1000 / 61.0)
    np.testing.assert_array_equal(result, counts)


@pytest.mark.parametrize("unit", ["m/s2", *(pytest.param(unit, marks=pytest.mark.slow) for unit in ("g", "mg"))])
def test_the_grid_of_the_values_determines_the_counts(tmp_path: Path, unit: str) -> None:
    """An MPU-6050 at +-4 g has 8192 counts per g; a driver multiplied them and rounded to six digits."""
    counts = np.rint(np.random.default_rng(5).normal(0, 3000, (4000, 3))).astype(np.int64)
    values = counts / 8192 * SI["g"] / SI[unit]
    columns = {name: np.round(column, 6) if name != "t" else column for name, column in columns_of(values).items()}
    sensor = (
        f'[[sensor]]\nname = "S"\nchip = "any"\nquantity = "specific_force"\ncolumns = ["x", "y", "z"]\nunit = "{unit}"'
    )
    result, _ = exported(tmp_path, write_csv(tmp_path, columns), f"{TIME}{sensor}\n")
    np.testing.assert_array_equal(result, counts)
    with open_log(tmp_path / "run.h5") as log:
        assert (log["S"].sensitivity, log["S"].range) == (8192, 2)


def test_values_without_a_grid_are_rounded_to_16_bits(tmp_path: Path) -> None:
    values = np.random.default_rng(5).normal(0, 2.0, (4000, 3))
    sensor = (
        '[[sensor]]\nname = "S"\nchip = "any"\nquantity = "angular_rate"\ncolumns = ["x", "y", "z"]\nunit = "rad/s"'
    )
    result, _ = exported(tmp_path, write_npz(tmp_path, columns_of(values)), f"{TIME}{sensor}\n")
    with open_log(tmp_path / "run.h5") as log:
        per_unit = log["S"].sensitivity
        assert log["S"].range == 500  # dps: the next that chips have above 8 rad/s
    assert np.abs(np.radians(result / per_unit) - values).max() <= np.radians(0.5 / per_unit) * 1.000001
    assert per_unit == pytest.approx(32767 / 500)


def test_arrays_of_several_columns_are_imported(tmp_path: Path) -> None:
    """A matrix in a struct, sensors of different lengths with their own times."""
    from scipy.io import savemat

    acc, gyro = np.arange(30).reshape(10, 3), -np.arange(60).reshape(20, 3)
    imu = {"acc": acc, "gyro": gyro.T, "ta": np.arange(10) * 0.02, "tg": np.arange(20) * 0.01}
    savemat(tmp_path / "data.mat", {"imu": imu, "note": "x"})
    table_map = '[time]\ncolumn = "imu.ta"\nunit = "s"\n' + "".join(
        SENSOR.format(quantity=quantity, unit=unit, range=2, how="sensitivity = 100")
        .replace('"S"', f'"{name}"')
        .replace('["x", "y", "z"]', f'["imu.{name}[0]", "imu.{name}[1]", "imu.{name}[2]"]')
        for name, quantity, unit in (("acc", "specific_force", "g"), ("gyro", "angular_rate", "dps"))
    )
    (tmp_path / "map.toml").write_text(table_map)
    with pytest.raises(
        SourceError, match=r"columns of different lengths: .*; does each sensor have its own time_column"
    ):
        import_table(tmp_path / "data.mat", tmp_path / "map.toml", tmp_path / "run.h5")
    (tmp_path / "map.toml").write_text(table_map + 'time_column = "imu.tg"\n')
    import_table(tmp_path / "data.mat", tmp_path / "map.toml", tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        np.testing.assert_array_equal(log["acc"].counts[:], acc)
        np.testing.assert_array_equal(log["gyro"].counts[:], gyro)
        assert log["gyro"].time[1] == 10_000_000


def imu_messages(rows: int) -> list[tuple[int, np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(1)
    force = np.rint(rng.normal([0, 0, 4096], 40, (rows, 3))) / 4096 * 9.80665
    rate = np.radians(np.rint(rng.normal(0, 30, (rows, 3))) / 131)
    return [(1_700_000_000_000_000_000 + 5_000_000 * row, force[row], rate[row]) for row in range(rows)]


def write_bag(path: Path, kind: str) -> Path:
    """Write a bag like ROS 1 or ROS 2 (SQLite or MCAP)."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    types: Any = store.types
    extra = {"seq": 0} if kind == "ros1" else {}
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Writer1(path) if kind == "ros1" else Writer2(path, version=8, storage_plugin=plugin)
    with writer:
        connection = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for stamp_ns, force, rate in imu_messages(300):
            stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu", **extra)
            vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
            message = types["sensor_msgs/msg/Imu"](
                header,
                types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1),
                zeros,
                vector(*rate),
                zeros,
                vector(*force),
                zeros,
            )
            raw = store.serialize_ros1(message, "sensor_msgs/msg/Imu") if kind == "ros1" else None
            raw = store.serialize_cdr(message, "sensor_msgs/msg/Imu") if raw is None else raw
            writer.write(connection, stamp_ns + 700_000, raw)
    return path


BAG_MAP = """
time = { column = "stamp", unit = "ns" }
[[sensor]]
name = "Acc"
chip = "any"
quantity = "specific_force"
columns = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]
unit = "m/s2"
[[sensor]]
name = "Gyro"
chip = "any"
quantity = "angular_rate"
columns = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"]
unit = "rad/s"
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ros1", "ros2", "mcap", "mcap alone"])
def test_bags_are_imported(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rosbags")
    name = "run.bag" if kind == "ros1" else "run"
    source = write_bag(tmp_path / name, kind.removesuffix(" alone"))
    if kind == "mcap alone":
        (source,) = source.glob("*.mcap")
    (tmp_path / "map.toml").write_text(BAG_MAP)
    assert main(["import", str(source), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]) == 0
    assert "Acc: 4096 counts per g, range 2 g, as the grid of its values says" in capsys.readouterr().out
    with open_log(tmp_path / "run.h5") as log:
        times, force, _ = zip(*imu_messages(300), strict=True)
        np.testing.assert_array_equal(log["Acc"].time[:], times)
        np.testing.assert_allclose(log["Acc"].counts[:] / 4096 * 9.80665, force, atol=1e-9)
        assert log["Gyro"].sensitivity == 131
    assert main(["import", str(source), "--guess", "-o", str(tmp_path / "guess.toml")]) == 0
    text = (tmp_path / "guess.toml").read_text()
    assert 'kind = "/imu/data"' in text and 'unit = "m/s2"' in text and 'unit = "rad/s"' in text
    assert main(["import", str(source), "--map", str(tmp_path / "guess.toml"), "-o", str(tmp_path / "2.h5")]) == 0


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.npz", b"PK\x03\x04" + b"\0" * 99),
        ("a.mat", b"MATLAB 5.0 MAT-file".ljust(200)),
        ("a.mat", b"MATLAB 7.3 MAT-file".ljust(600)),
        ("a.h5", b"\x89HDF\r\n\x1a\n" + b"\0" * 99),
        ("a.parquet", b"PAR1" + b"\0" * 99),
        ("a.bag", b"#ROSBAG V2.0\n" + b"\0" * 99),
        ("a.mcap", b"\x89MCAP0\r\n" + b"\0" * 99),
        ("a.db3", b"SQLite format 3\0" + b"\0" * 99),
    ],
)
def test_damaged_files_are_refused_in_one_line(
    name: str, data: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(data)
    (tmp_path / "map.toml").write_text(BAG_MAP)
    assert (
        main(["import", str(tmp_path / name), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "r.h5")]) == 2
    )
    captured = capsys.readouterr()
    assert captured.err.startswith(f"imuarray: {tmp_path / name}: ") and captured.err.count("\n") == 1
    assert not (tmp_path / "r.h5").exists()


@pytest.mark.slow
def test_times_in_bursts_are_regularised_and_raw_times_kept(tmp_path: Path) -> None:
    """A chip at 100 Hz whose clock has an error of 200 ppm and drifts, read by a host in bursts of a dozen rows."""
    rng = np.random.default_rng(9)
    rows = 20_000
    read_ns = np.cumsum(np.full(rows, 1e7) * (1 + 2e-4 + 1e-4 * np.arange(rows) / rows)).astype(np.int64)
    ends = np.cumsum(rng.integers(4, 20, rows // 4))
    burst = np.searchsorted(ends, np.arange(rows), side="right")
    last = np.minimum(ends[burst] - 1, rows - 1)
    arrived = read_ns[last] + 1_000_000 + (np.arange(rows) - last + 40) * 20_000
    counts = np.rint(rng.normal(0, 20, (rows, 3))).astype(np.int64)
    source = write_npz(tmp_path, columns_of(counts) | {"t": arrived})
    sensor = SENSOR.format(quantity="specific_force", unit="g", range=16, how="sensitivity = 2048")
    (tmp_path / "map.toml").write_text(
        TIME + 'stamps = "arrival"\n' + sensor + '[[phase]]\nname = "z_up"\nrows = [0, 9999]\n'
    )
    import_table(source, tmp_path / "map.toml", tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        time = np.asarray(log["S"].time)
        delay = np.asarray(log["S"].compensated(ARRIVAL))
        np.testing.assert_array_equal(time + np.rint(delay * 1e9).astype(np.int64), arrived)
        late = (time - read_ns) * 1e-9
        assert np.ptp(late) < 5e-3  # a constant delay remains, since it is not observable
        assert np.ptp(late[2000:-2000]) < 3e-3
        (phase,) = log.phases
        assert (phase.start_ns, phase.end_ns) == (time[0], time[9999] + 1)
    assert main(["verify", str(tmp_path / "run.h5")]) == 0
    assert main(["export", str(tmp_path / "run.h5"), "-o", str(tmp_path / "run.npz")]) == 0
    assert main(["import", str(tmp_path / "run.npz"), "-o", str(tmp_path / "again.h5")]) == 0
    with open_log(tmp_path / "again.h5") as log:
        np.testing.assert_array_equal(log["S"].compensated(ARRIVAL)[:], delay)


@pytest.mark.parametrize(
    ("at", "flagged"),
    [
        (16384, True),
        pytest.param(12345, True, marks=pytest.mark.slow),
        pytest.param(32767, True, marks=pytest.mark.slow),
    ],
)
def test_clipping_is_flagged(at: int, flagged: bool, tmp_path: Path) -> None:
    """At the range (8 g of 2048 counts), at an unknown limit, and at the ends of the code."""
    counts = np.rint(np.random.default_rng(2).normal(0, 0.7 * at, (5000, 3))).clip(-at, at).astype(np.int64)
    sensor = SENSOR.format(quantity="specific_force", unit="g", range=8, how="sensitivity = 2048")
    (tmp_path / "map.toml").write_text(TIME + sensor)
    summary = import_table(write_npz(tmp_path, columns_of(counts)), tmp_path / "map.toml", tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        status = np.asarray(log["S"].status)
    np.testing.assert_array_equal(status != 0, (np.abs(counts) >= at).any(axis=1) & flagged)
    assert set(status.tolist()) == {0, SATURATED}
    assert any(f"xyz clips at -{at} " in text for text in summary.remarks)


def test_a_coarse_sensor_at_rest_is_not_flagged_as_clipped(tmp_path: Path) -> None:
    """31 counts per g, without noise: on every face all readings have the same code, without motion."""
    faces = np.repeat(31 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]]), 300, axis=0)
    sensor = SENSOR.format(quantity="specific_force", unit="g", range=16, how="sensitivity = 31")
    (tmp_path / "map.toml").write_text(TIME + sensor)
    import_table(write_npz(tmp_path, columns_of(faces)), tmp_path / "map.toml", tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert not np.asarray(log["S"].status).any()

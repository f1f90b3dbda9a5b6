"""Bags of ROS 2: read by the readers of mcap-ros2-support and of rosbags, written as rosbags writes, imported again."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from imuarray.cli import main
from imuarray.errors import ExportError
from imuarray.export import export
from imuarray.export.ros2_messages import DEFINITIONS
from imuarray.importers.guess import guess_map
from imuarray.importers.table import import_table
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Event, SensorHeader
from tests.export.conftest import ACC, BARO, EPOCH, EPOCH_NS, GYRO, MESSAGE, MS
from tests.selection import examples, some

STORE = get_typestore(Stores.ROS2_HUMBLE)


def read(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Messages (time, message) by topic, by Foxglove's reader of ROS 2."""
    reader = pytest.importorskip("mcap_ros2.reader")
    result: dict[str, list[tuple[int, Any]]] = {}
    for message in reader.read_ros2_messages(str(path)):
        result.setdefault(message.channel.topic, []).append((message.log_time_ns, message.ros_msg))
    return result


def raw_messages(path: Path) -> Iterator[tuple[str, str, bytes]]:
    """Topic, type and bytes of each message, by the reader of MCAP."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            yield channel.topic, schema.name, message.data


def triad(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


@pytest.fixture
def bag(run: Path) -> Path:
    export(run, run.with_name("r.mcap"), tool="ros2")
    return run.with_name("r.mcap")


@pytest.mark.skipif(version("rosbags") < "0.11", reason="an older one opens no file without the folder of a bag")
def test_each_sensor_has_a_topic(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        kinds = {connection.topic: (connection.msgtype, connection.msgcount) for connection in reader.connections}
    assert kinds == {
        "/sensors/Acc": ("sensor_msgs/msg/Imu", 5),
        "/sensors/Acc/temperature": ("sensor_msgs/msg/Temperature", 5),
        "/sensors/Gyro": ("sensor_msgs/msg/Imu", 3),
        "/sensors/Baro": ("sensor_msgs/msg/FluidPressure", 1),  # the other is nan: a missing reading
        "/sensors/Baro/temperature": ("sensor_msgs/msg/Temperature", 2),
        "/truth": ("sensor_msgs/msg/Imu", 5),
        "/truth/temperature": ("sensor_msgs/msg/Temperature", 5),
        "/events": ("rcl_interfaces/msg/Log", 2),
        "/phases": ("rcl_interfaces/msg/Log", 4),
    }  # the gyroscope's thermometer has no zero, so no temperature


def test_values_are_si_in_the_box_frame(bag: Path) -> None:
    messages = read(bag)
    at_ns, first = messages["/sensors/Acc"][0]
    assert at_ns == EPOCH_NS
    assert (first.header.stamp.sec, first.header.stamp.nanosec) == (EPOCH_NS // 10**9, 250_000_000)
    assert first.header.frame_id == "box"
    np.testing.assert_allclose(triad(first.linear_acceleration), [-0.5 * 9.80665, 9.80665, 0])  # x along box Y
    assert first.linear_acceleration_covariance == [0.0] * 9  # not known
    assert (first.angular_velocity_covariance[0], first.orientation_covariance[0]) == (-1, -1)  # no such estimate
    at_ns, gyro = messages["/sensors/Gyro"][0]
    assert at_ns == EPOCH_NS + 10 * MS + 1
    assert gyro.angular_velocity.x == pytest.approx(8.75 * np.pi / 180)
    assert gyro.linear_acceleration_covariance[0] == -1
    assert [message.temperature for _, message in messages["/sensors/Acc/temperature"][:2]] == [25.0, 23.5]
    assert messages["/sensors/Baro"][0][1].fluid_pressure == 69963.0
    events = [(message.level, message.name, message.msg) for _, message in messages["/events"]]
    assert events == [(20, "array", "simulated: "), (30, "Acc", f"lost: {MESSAGE}")]  # 20 is INFO, 30 WARN


def test_a_magnetometer_is_a_magnetic_field(tmp_path: Path) -> None:
    header = SensorHeader("Mag", "hmc5883", "magnetic_field", "gauss", 1.3, 1090.0)
    with LogWriter(tmp_path / "m.h5", [header], source="simulated", epoch=EPOCH) as log:
        log.append("Mag", Block(np.array([0]), np.array([[1090, 0, -545]]), np.zeros(1, np.uint16)))
    export(tmp_path / "m.h5", tmp_path / "m.mcap", tool="ros2")
    ((_, message),) = read(tmp_path / "m.mcap")["/sensors/Mag"]
    np.testing.assert_allclose(triad(message.magnetic_field), [1e-4, 0, -0.5e-4], rtol=1e-12)  # tesla
    assert message.magnetic_field_covariance == [0.0] * 9


def test_a_fused_result_has_its_covariances(fused: Path) -> None:
    export(fused, fused.with_name("f.mcap"), tool="ros2")
    messages = [message for _, message in read(fused.with_name("f.mcap"))["/fused"]]
    nine = [1.0, 0.25, 0.5, 0.25, 2.0, 0.75, 0.5, 0.75, 3.0]  # row by row of xx yy zz xy xz yz = 1 2 3 0.25 0.5 0.75
    assert messages[0].linear_acceleration_covariance == nine
    assert triad(messages[0].linear_acceleration) == [0.0, 0.5, 9.8]
    assert messages[0].angular_velocity_covariance == [0.0] * 9
    assert messages[2].linear_acceleration_covariance == [-1.0, *[0.0] * 8]  # no force in this frame
    assert triad(messages[2].linear_acceleration) == [0.0] * 3
    assert messages[2].angular_velocity.x == 1 / 7


def test_every_message_equals_that_of_rosbags_byte_for_byte(bag: Path, fused: Path) -> None:
    export(fused, fused.with_name("f.mcap"), tool="ros2")
    for path in (bag, fused.with_name("f.mcap")):
        for topic, kind, raw in raw_messages(path):
            assert bytes(STORE.serialize_cdr(STORE.deserialize_cdr(raw, kind), kind)) == raw, topic


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_definitions_are_those_of_ros(kind: str) -> None:
    text, _ = STORE.generate_msgdef(kind, ros_version=2)
    assert DEFINITIONS[kind].strip() == text.strip()


def test_the_file_is_of_the_ros2_profile(bag: Path) -> None:
    from mcap.reader import make_reader

    with bag.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert len({schema.name for schema in summary.schemas.values()}) == len(summary.schemas)


@pytest.mark.slow
@pytest.mark.parametrize("apart_ns", some([0, 1], 1))
def test_halves_of_a_six_axis_chip_read_together_are_one_imu(tmp_path: Path, apart_ns: int) -> None:
    """Kalibr and others require force and rate of a chip in one message."""
    headers = [
        SensorHeader("IMU1_acc", "mpu9150", "specific_force", "g", 2.0, 16384.0),
        SensorHeader("IMU1_gyro", "mpu9150", "angular_rate", "dps", 250.0, 131.0),
    ]
    time = np.arange(20_000) * MS
    with LogWriter(tmp_path / "s.h5", headers, source="imported", epoch=EPOCH) as log:
        for header, delay in zip(headers, (0, apart_ns), strict=True):
            late = np.where(time == time[-1], delay, 0)
            log.append(header.name, Block(time + late, np.full((20_000, 3), 131), np.zeros(20_000, np.uint16)))
    export(tmp_path / "s.h5", tmp_path / "s.mcap", tool="ros2")
    listed = list(raw_messages(tmp_path / "s.mcap"))
    topics = {topic for topic, _, _ in listed}
    assert topics == ({"/sensors/IMU1_acc", "/sensors/IMU1_gyro"} if apart_ns else {"/sensors/IMU1"})
    first = STORE.deserialize_cdr(listed[0][2], "sensor_msgs/msg/Imu")
    assert first.linear_acceleration.x == pytest.approx(131 / 16384 * 9.80665)
    assert (first.angular_velocity.x != 0) == (apart_ns == 0)


def test_names_of_topics_are_valid_in_ros(tmp_path: Path) -> None:
    """Letters, digits, single underscores, no digit first; names that become alike are numbered."""
    names = ["Acc 1", "Acc-1", "9", "a__b"]
    headers = [SensorHeader(name, "bma180", "specific_force", "g", 2.0, 4096.0) for name in names]
    with LogWriter(tmp_path / "n.h5", headers, source="imported", epoch=EPOCH) as log:
        for name in names:
            log.append(name, Block(np.array([1]), np.ones((1, 3)), np.zeros(1, np.uint16)))
    export(tmp_path / "n.h5", tmp_path / "n.mcap", tool="ros2")
    assert set(read(tmp_path / "n.mcap")) == {"/sensors/Acc_1", "/sensors/Acc_1_2", "/sensors/s9", "/sensors/a_b"}


def test_unsupported_options_and_times_are_refused(run: Path, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="messages of ROS 2 are in SI"):
        export(run, tmp_path / "x.mcap", tool="ros2", units="sensor")
    with pytest.raises(ExportError, match=r"tool 'ros': allowed for .mcap are foxglove, ros2.*did you mean"):
        export(run, tmp_path / "x.mcap", tool="ros")
    with pytest.raises(ExportError, match=r"tool 'ros2': allowed for .npz are none"):
        export(run, tmp_path / "x.npz", tool="ros2")
    with LogWriter(tmp_path / "late.h5", [ACC], source="imported", epoch="2038-01-19T03:14:07Z") as log:
        log.append("Acc", Block(np.array([0, 10**9]), np.ones((2, 3)), np.zeros(2, np.uint16), np.zeros(2)))
    with pytest.raises(ExportError, match="ROS 2 has times from 1970 to 2038-01-19"):
        export(tmp_path / "late.h5", tmp_path / "x.mcap", tool="ros2")
    with LogWriter(tmp_path / "early.h5", [ACC], source="imported", epoch="1970-01-01T00:00:00Z") as log:
        log.event(Event(-1, "", "imported", ""))
    with pytest.raises(ExportError, match="ROS 2 has times from 1970 to 2038-01-19"):
        export(tmp_path / "early.h5", tmp_path / "x.mcap", tool="ros2")
    assert not (tmp_path / "x.mcap").exists()


MAP = """
time = { column = "stamp", unit = "ns" }
[[sensor]]
name = "Acc"
kind = "/sensors/Acc"
chip = "bma180"
quantity = "specific_force"
columns = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]
unit = "m/s2"
values = "physical"
range = 156.9064
sensitivity = 52.209470104674896  # 512 / 9.80665
[[sensor]]
name = "Gyro"
kind = "/sensors/Gyro"
chip = "l3g4200d"
quantity = "angular_rate"
columns = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"]
unit = "rad/s"
values = "physical"
range = 4.363
sensitivity = 6548.089044441348  # 180 / pi / 0.00875
[[barometer]]
name = "Baro"
kind = "/sensors/Baro"
column = "fluid_pressure"
"""

COUNTS = st.lists(st.lists(st.integers(-(2**15), 2**15 - 1), min_size=3, max_size=3), min_size=1, max_size=6)
PRESSURES = st.lists(st.floats(1.0, 2e5), min_size=1, max_size=4)


@pytest.mark.slow
@settings(max_examples=examples(15), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(force=COUNTS, rate=COUNTS, pressures=PRESSURES)
def test_any_counts_round_trip(
    tmp_path: Path, force: list[list[int]], rate: list[list[int]], pressures: list[float]
) -> None:
    """Counts, times and pressures, exactly; axes that permute the box's are imported in the box's order."""
    source, bag = tmp_path / "run.h5", tmp_path / "run.mcap"
    headers = [ACC.__class__(**{**vars_of(ACC), "axes": "+Y+Z+X", "has_temperature": False}), GYRO, BARO]
    with LogWriter(source, headers, source="simulated", epoch=EPOCH, force=True) as log:
        for header, counts in ((headers[0], force), (GYRO, rate)):
            time, none = np.arange(len(counts)) * 7 + 3, np.zeros(len(counts), np.uint16)
            warm = np.zeros(len(counts)) if header.has_temperature else None
            log.append(header.name, Block(time, np.array(counts), none, warm))
        made = {"temperature": np.full(len(pressures), 20.0), "pressure": np.array(pressures)}
        time, none = np.arange(len(pressures)) * 11, np.zeros(len(pressures), np.uint16)
        log.append("Baro", Block(time, np.ones((len(pressures), 2)), none, None, made))
    export(source, bag, tool="ros2", force=True)
    (tmp_path / "map.toml").write_text(MAP)
    import_table(bag, tmp_path / "map.toml", tmp_path / "back.h5", force=True)
    with open_log(tmp_path / "back.h5") as log:
        assert log["Acc"].counts[:].tolist() == [[z, x, y] for x, y, z in force]  # x of the chip along y of the box
        assert log["Gyro"].counts[:].tolist() == rate
        assert log["Baro"].compensated("pressure")[:].tolist() == pressures
        assert (log["Acc"].time[:] - EPOCH_NS).tolist() == (np.arange(len(force)) * 7 + 3).tolist()


def vars_of(header: SensorHeader) -> dict[str, Any]:
    return {name: getattr(header, name) for name in header.__dataclass_fields__}


@pytest.mark.slow
def test_a_guessed_map_restores_the_counts(tmp_path: Path) -> None:
    """Units and names are those of ROS, sensitivities those of the values' grid; halves without values are none."""
    rng = np.random.default_rng(3)
    time, none = np.arange(500) * 2 * MS, np.zeros(500, np.uint16)
    counts = rng.integers(-300, 300, (500, 3))
    force = np.rint(counts / 10).astype(int) + np.array([0, 0, 512])  # one g
    with LogWriter(tmp_path / "run.h5", [ACC, GYRO, BARO], source="simulated", epoch=EPOCH) as log:
        log.append("Acc", Block(time, force, none, np.zeros(500)))
        log.append("Gyro", Block(time, counts, none, np.zeros(500)))
        made = {"temperature": np.full(500, 20.0), "pressure": rng.normal(99_000, 3, 500)}
        log.append("Baro", Block(time, np.ones((500, 2)), none, None, made))
    export(tmp_path / "run.h5", tmp_path / "run.mcap", tool="ros2")
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "run.mcap"))
    assert (
        main(["import", str(tmp_path / "run.mcap"), "--map", str(tmp_path / "map.toml"), "-o", f"{tmp_path}/b.h5"]) == 0
    )
    with open_log(tmp_path / "b.h5") as log:
        assert set(log.sensors) == {"Acc", "Acc_temperature", "Gyro", "Baro", "Baro_temperature"}
        assert log["Acc"].counts[:].tolist() == np.stack([force[:, 1], force[:, 0], -force[:, 2]], axis=1).tolist()
        assert log["Gyro"].counts[:].tolist() == counts.tolist()
        assert log["Gyro"].sensitivity == pytest.approx(1 / 0.00875, rel=1e-12)
        np.testing.assert_array_equal(log["Baro"].compensated("pressure")[:], made["pressure"])
        assert (log["Baro"].counts[:, 0] == np.rint(made["pressure"])).all()
    assert main(["verify", f"{tmp_path}/b.h5"]) == 0


@pytest.mark.slow
def test_a_guessed_map_omits_the_truth(tmp_path: Path) -> None:
    """It would be two more sensors of the array."""
    words = ["simulate", "martin2013", "--only", "ADXL1,Gyro1", "--seconds", "5", "-o", f"{tmp_path}/run.h5"]
    assert main(words) == 0
    export(tmp_path / "run.h5", tmp_path / "run.mcap", tool="ros2")
    proposed = guess_map(tmp_path / "run.mcap")
    assert "left out: /truth, /truth, /truth/temperature: a truth or a reference" in proposed
    assert [line for line in proposed.splitlines() if line.startswith("kind = ")] == [
        'kind = "/sensors/ADXL1"',
        'kind = "/sensors/Gyro1"',
    ]

"""MCAP by its own reader: channels, schemas that every message keeps, order, values."""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.errors import ExportError, MissingExtraError
from imuarray.export import export
from imuarray.export.content import open_content
from imuarray.export.formats import ExportRequest
from imuarray.export.mcap_file import _digits, _NumberTexts
from imuarray.export.mcap_schemas import table_message
from imuarray.log import Block, LogWriter
from imuarray.wall_time import unix_ns
from tests.export.conftest import ACC, BARO, EPOCH_NS, GYRO, MESSAGE, MS
from tests.selection import some

Read = tuple[dict[str, Any], dict[str, list[tuple[int, dict[str, Any]]]]]


def read(path: Path) -> Read:
    """Schemas and messages (time, value) by topic; the reader checks every checksum."""
    from mcap.reader import make_reader

    schemas: dict[str, Any] = {}
    messages: dict[str, list[tuple[int, dict[str, Any]]]] = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            schemas[channel.topic] = json.loads(schema.data) | {"registered as": schema.name}
            messages[channel.topic].append((message.log_time, json.loads(message.data)))
    return schemas, messages


def misses(value: Any, schema: Mapping[str, Any], place: str = "") -> list[str]:
    """Where a value violates a JSON Schema, for the keywords that our schemas use (json-schema.org, draft 2020-12)."""
    if "oneOf" in schema:
        return [] if sum(value == entry["const"] for entry in schema["oneOf"]) == 1 else [place]
    kinds = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float)}
    if not isinstance(value, kinds[schema["type"]]) or isinstance(value, bool):
        return [place]
    result = [place for bound in ("minimum", "minItems") if bound in schema and _size(value) < schema[bound]]
    result += [place for bound in ("maximum", "maxItems") if bound in schema and _size(value) > schema[bound]]
    if schema["type"] == "array":
        return result + [miss for item in value for miss in misses(item, schema["items"], f"{place}[]")]
    if schema["type"] == "object":
        result += [f"{place}.{name}" for name in schema["required"] if name not in value]
        result += [f"{place}.{name}" for name in value if name not in schema["properties"]]
        inner = [(name, schema["properties"][name]) for name in value if name in schema["properties"]]
        result += [miss for name, entry in inner for miss in misses(value[name], entry, f"{place}.{name}")]
    return result


def _size(value: Any) -> float:
    return len(value) if isinstance(value, list) else value


@pytest.mark.slow
@pytest.mark.parametrize("units", some([None, "counts", "sensor"], 2))
def test_every_message_keeps_its_schema(run: Path, units: str | None) -> None:
    export(run, run.with_name("r.mcap"), units=units)
    schemas, messages = read(run.with_name("r.mcap"))
    assert set(messages) == {"/sensors/Acc", "/sensors/Gyro", "/sensors/Baro", "/truth", "/events", "/phases"}
    for topic, listed in messages.items():
        assert schemas[topic]["type"] == "object"
        assert [miss for _, value in listed for miss in misses(value, schemas[topic])] == [], topic


def test_the_checker_of_schemas_detects_violations() -> None:
    schema = {"type": "object", "required": ["a"], "properties": {"a": {"type": "integer", "minimum": 0}}}
    assert misses({"a": 1}, schema) == []
    assert misses({"a": -1}, schema) == [".a"]
    assert misses({"a": 0.5}, schema) == [".a"]
    assert misses({"b": 1}, schema) == [".a", ".b"]


def test_values_are_si_in_the_box_frame(run: Path) -> None:
    export(run, run.with_name("r.mcap"))
    _, messages = read(run.with_name("r.mcap"))
    at_ns, first = messages["/sensors/Acc"][0]
    assert at_ns == EPOCH_NS
    assert first["timestamp"] == {"sec": EPOCH_NS // 10**9, "nsec": 250_000_000}
    assert first["frame_id"] == "box"
    force = first["specific_force"]
    np.testing.assert_allclose([force["x"], force["y"], force["z"]], [-0.5 * 9.80665, 9.80665, 0])  # x along box Y
    assert first["temperature"] == 25.0
    at_ns, gyro = messages["/sensors/Gyro"][0]
    assert at_ns == EPOCH_NS + 10 * MS + 1
    assert gyro["angular_rate"]["x"] == pytest.approx(8.75 * np.pi / 180)
    second = messages["/sensors/Baro"][1][1]
    assert second["temperature"] == 0.1 + 0.2
    assert "pressure" not in second  # nan, which JSON has not


def test_messages_are_in_the_order_of_their_times(run: Path) -> None:
    from mcap.reader import make_reader

    export(run, run.with_name("r.mcap"))
    with run.with_name("r.mcap").open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert times == sorted(times)
    assert len(times) == 5 + 3 + 2 + 5 + 2 + 4


def log_of(path: Path, rows: int) -> Path:
    """Two sensors at rates that have nothing in common, and a barometer with holes: several chunks, odd numbers."""
    rng = np.random.default_rng(1)
    with LogWriter(path, [ACC, GYRO, BARO], source="simulated", epoch="2013-09-16T08:30:00Z") as log:
        for header, count, step in ((ACC, rows, 1_000_003), (GYRO, rows // 2, 2_100_001), (BARO, rows // 9, 9_000_000)):
            time = np.arange(count) * step + rng.integers(0, 1000, count)
            counts = rng.integers(-300, 300, (count, len(header.columns) or 3))
            made = {"temperature": rng.normal(size=count), "pressure": rng.normal(1e5, 1, count)}
            made["pressure"][::3], made["temperature"][::2] = np.nan, -0.0
            warm = rng.integers(-128, 128, count) if header.has_temperature else None
            none = np.zeros(count, np.uint16)
            log.append(header.name, Block(time, counts, none, warm, made if header is BARO else {}))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("units", some(["counts", "si"], 1))
def test_every_message_equals_that_of_a_row_by_row_writer(tmp_path: Path, units: str) -> None:
    """Values to the last bit, and every message's number and time."""
    from mcap.reader import make_reader

    source = log_of(tmp_path / "long.h5", 6000)
    export(source, tmp_path / "long.mcap", units=units)
    wanted: list[tuple[int, str, int, str]] = []
    with open_content(ExportRequest(source, units=units)) as content:
        zero_ns = unix_ns(content.epoch) or 0
        for table in content.tables:
            columns = [column.read(slice(None)).tolist() for column in table.columns]
            for number, (at, *row) in enumerate(zip(*columns, strict=True)):
                frame = "sensor" if units == "counts" else "box"
                text = table_message(at + zero_ns, frame, table.columns[1:], row)
                wanted.append((at + zero_ns, f"/{table.name}", number, json.dumps(text)))
    with (tmp_path / "long.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        result = [
            (message.log_time, channel.topic, message.sequence, json.dumps(json.loads(message.data)))
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        statistics = reader.get_summary().statistics
    assert result == sorted(wanted, key=lambda message: message[0])
    assert statistics.message_count == len(wanted)
    assert statistics.chunk_count > 1
    assert (statistics.message_start_time, statistics.message_end_time) == (result[0][0], result[-1][0])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:(start|end)_time is deprecated")  # the lowest version has no other name
def test_a_time_range_is_read_by_the_index(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    source = log_of(tmp_path / "long.h5", 6000)
    export(source, tmp_path / "long.mcap")
    with (tmp_path / "long.mcap").open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(topics=["/sensors/Gyro"])]
        file.seek(0)
        begin, end = times[1000], times[1500]
        part = make_reader(file).iter_messages(topics=["/sensors/Gyro"], start_time=begin, end_time=end)
        assert [message.log_time for _, _, message in part] == times[1000:1500]


def test_events_are_for_the_log_panel(run: Path) -> None:
    export(run, run.with_name("r.mcap"))
    schemas, messages = read(run.with_name("r.mcap"))
    assert schemas["/events"]["registered as"] == "foxglove.Log"
    assert [(value["level"], value["name"], value["message"]) for _, value in messages["/events"]] == [
        (2, "array", "simulated: "),
        (3, "Acc", f"lost: {MESSAGE}"),
    ]  # 2 is INFO, 3 WARNING
    texts = [value["message"] for _, value in messages["/phases"]]
    assert texts == ["z_up begins, +Z up", "motion begins", "z_up ends", "motion ends"]


def test_a_fused_result_has_covariances_as_in_ros(fused: Path) -> None:
    export(fused, fused.with_name("f.mcap"))
    schemas, messages = read(fused.with_name("f.mcap"))
    values = [value for _, value in messages["/fused"]]
    assert [miss for value in values for miss in misses(value, schemas["/fused"])] == []
    assert values[0]["linear_acceleration"] == {"x": 0.0, "y": 0.5, "z": 9.8}
    nine = [1.0, 0.25, 0.5, 0.25, 2.0, 0.75, 0.5, 0.75, 3.0]  # row by row of xx yy zz xy xz yz = 1 2 3 0.25 0.5 0.75
    assert values[0]["linear_acceleration_covariance"] == nine
    assert values[0]["angular_velocity_covariance"] == [0.0] * 9  # not known
    assert values[0]["orientation_covariance"][0] == -1
    assert "linear_acceleration" not in values[2]
    assert values[2]["linear_acceleration_covariance"][0] == -1
    assert values[2]["angular_velocity"]["x"] == 1 / 7


def test_metadata_and_configuration_of_the_log_are_exported(run: Path) -> None:
    from mcap.reader import make_reader

    export(run, run.with_name("r.mcap"))
    with run.with_name("r.mcap").open("rb") as file:
        reader = make_reader(file)
        (metadata,) = list(reader.iter_metadata())
        assert (metadata.name, metadata.metadata["source"]) == ("imuarray", "simulated")
        (attached,) = list(reader.iter_attachments())
        assert (attached.name, attached.data.decode()) == ("array.toml", "[array]\nname = 'µ'\n")


def test_times_before_1970_are_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.h5", [ACC], source="imported", epoch="1970-01-01T00:00:00Z") as log:
        log.append("Acc", Block(np.array([-1]), np.ones((1, 3)), np.zeros(1, np.uint16), np.zeros(1)))
    with pytest.raises(ExportError, match="-1 ns since 1970; MCAP has no such times"):
        export(tmp_path / "a.h5", tmp_path / "a.mcap")
    with LogWriter(tmp_path / "b.h5", [ACC], source="imported", epoch="yesterday") as log:
        pass
    with pytest.raises(ExportError, match="the epoch 'yesterday' is not a date"):
        export(tmp_path / "b.h5", tmp_path / "b.mcap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.h5", "b.h5"]


def test_a_missing_package_is_named(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mcap_file", "mcap_container"):
        monkeypatch.delitem(sys.modules, f"imuarray.export.{name}")
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'imuarray\[export\]'"):
        export(run, run.with_name("r.mcap"))


@pytest.mark.parametrize("values", [[0], [7, 0], [9999, 10_000], [123, 0, 999_999_999, 10_000, 99_999_999], [2**40, 1]])
def test_integers_are_right_aligned_to_one_width(values: list[int]) -> None:
    width = len(str(max(values)))
    texts = _digits(np.array(values, np.int64))
    assert [bytes(text).decode() for text in texts] == [f"{value:>{width}}" for value in values]


def test_texts_of_numbers_do_not_depend_on_earlier_blocks() -> None:
    rng = np.random.default_rng(3)
    few, many = rng.integers(-9, 9, 500) * 0.0383, rng.normal(size=2000)
    texts_of = _NumberTexts()
    for block in (few[:300], few[300:], np.array([0.0, -0.0, 1e-300]), many, few[:300], np.full(4, 2.5), few[300:]):
        lines = [bytes(text).decode() for text in texts_of(block)]
        assert [line.rstrip() for line in lines] == [json.dumps(value) for value in block.tolist()]
        assert len(lines[0]) == max(len(json.dumps(value)) for value in block.tolist())


def test_texts_of_integers_do_not_depend_on_earlier_blocks() -> None:
    texts_of = _NumberTexts()
    for values in ([7, -12, 7], [7, 30000, -32768], [0, 0], [-12, 7]):
        lines = [bytes(text).decode() for text in texts_of(np.array(values, np.int16))]
        assert [line.rstrip() for line in lines] == [json.dumps(value) for value in values]

"""Noise figures for Kalibr and others from a log, a fused result and a result of `characterise`, read by parsers of
YAML and XML.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from scipy.signal import lfilter

from imuarray.characterise import characterise_log
from imuarray.errors import ExportError, OutputExistsError
from imuarray.export import export
from imuarray.fuse import FusedBlock, write_fused
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from tests.export.conftest import EPOCH
from tests.selection import some

yaml = pytest.importorskip("yaml")

RATE_HZ, ROWS, SIGMA = 200, 12_000, 12.0
ACC = SensorHeader("A", "bma180", "specific_force", "g", 2.0, 4096.0)
GYRO = SensorHeader("G", "l3g4200d", "angular_rate", "dps", 250.0, 114.3)


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of white noise of 12 counts on every axis of an accelerometer and a gyroscope."""
    path = tmp_path_factory.mktemp("kalibr") / "still.h5"
    rng = np.random.default_rng(8)
    time = np.arange(ROWS) * (1_000_000_000 // RATE_HZ)
    with LogWriter(path, [ACC, GYRO], source="simulated", epoch=EPOCH) as log:
        for header in (ACC, GYRO):
            counts = np.rint(rng.normal(0, SIGMA, (ROWS, 3))).astype(np.int16)
            log.append(header.name, Block(time, counts, np.zeros(ROWS, np.uint16)))
        log.phase(Phase(0, int(time[-1]) + 1, "static"))
    return path


@pytest.mark.slow
def test_an_accelerometer_and_a_gyroscope_are_one_imu(still: Path, tmp_path: Path) -> None:
    """White noise of sigma at a rate f has the density sigma / sqrt(f); three axes of 12000 rows, the largest: 5 %."""
    written = export(still, tmp_path / "imu.yaml")
    assert written.files == (tmp_path / "imu.yaml",)
    figures = yaml.safe_load((tmp_path / "imu.yaml").read_text())
    assert figures["update_rate"] == pytest.approx(RATE_HZ)
    density = SIGMA / np.sqrt(RATE_HZ)
    assert figures["accelerometer_noise_density"] == pytest.approx(density * 9.80665 / 4096, rel=0.05)
    assert figures["gyroscope_noise_density"] == pytest.approx(density * np.radians(1 / 114.3), rel=0.05)
    # White noise alone: of a random walk there is a bound, which is no figure for a program to read.
    text = (tmp_path / "imu.yaml").read_text()
    for name in ("accelerometer", "gyroscope"):
        assert f"{name}_random_walk" not in figures
        assert f"# {name}_random_walk: not significant, at most " in text


@pytest.mark.slow
def test_a_random_walk_significant_on_one_axis_is_exported(still: Path, tmp_path: Path) -> None:
    """The value of the axis in which it is significant, though another's bound is larger."""
    with open_log(still) as log:
        result = characterise_log(log)
    for sensor in result["sensors"]:
        for index, axis in enumerate(sensor["axes"]):
            seen = {"value": 3.0, "low": 2.0, "high": 4.0, "significant": True}
            unseen = {"value": 1.0, "low": 0.0, "high": 9.0, "significant": False}
            axis["fit"]["terms"]["random walk"] = seen if index == 1 else unseen
    (tmp_path / "c.json").write_text(json.dumps(result))
    export(tmp_path / "c.json", tmp_path / "i.yaml")
    figures = yaml.safe_load((tmp_path / "i.yaml").read_text())
    assert figures["accelerometer_random_walk"] == pytest.approx(3.0 * 9.80665 / 4096)
    assert figures["gyroscope_random_walk"] == pytest.approx(3.0 * np.radians(1 / 114.3), rel=1e-5)


@pytest.mark.slow
def test_each_of_several_sensors_has_a_file(still: Path, tmp_path: Path) -> None:
    """From a characterisation that contains the accelerometer twice."""
    with open_log(still) as log:
        result = characterise_log(log)
    first = result["sensors"][0]
    result["sensors"].append(first | {"name": "B"})
    (tmp_path / "characterise.json").write_text(json.dumps(result))
    written = export(tmp_path / "characterise.json", tmp_path / "i.yaml")
    assert [file.name for file in written.files] == ["i_A.yaml", "i_G.yaml", "i_B.yaml"]
    file_b, file_a = (yaml.safe_load((tmp_path / f"i_{name}.yaml").read_text()) for name in "BA")
    assert file_b | {"rostopic": ""} == file_a | {"rostopic": ""}
    with pytest.raises(OutputExistsError, match=r"i_A\.yaml"):
        export(tmp_path / "characterise.json", tmp_path / "i.yaml")
    export(tmp_path / "characterise.json", tmp_path / "b.yaml", sensors=["B", "G"])
    assert set(yaml.safe_load((tmp_path / "b.yaml").read_text())) > {"gyroscope_noise_density", "update_rate"}
    assert file_b["rostopic"] == "/sensors/B"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "not a result of `imuarray characterise`"),
        ('{"sensors": [{"name": "A"}]}', "not a result of `imuarray characterise`"),
        ("[" * 100_000, "not a result of `imuarray characterise`"),
        ('{"sensors": []}', "no inertial sensor whose noise could be fitted"),
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(ExportError, match=message):
        export(tmp_path / "c.json", tmp_path / "i.yaml")
    with pytest.raises(ExportError, match="noise figures are in SI"):
        export(tmp_path / "c.json", tmp_path / "i.yaml", units="counts")
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]


KALIBR = (
    "accelerometer_noise_density",
    "accelerometer_random_walk",
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "update_rate",
)
"""What `ImuParameters` in kalibr_common/ConfigReader.py reads, each above 0; and `rostopic`, a text."""

WALK_RATE_HZ, DENSITY, WALK = (
    20,
    {"specific_force": 0.01, "angular_rate": 1e-3},
    {"specific_force": 2e-3, "angular_rate": 2e-4},
)
"""In SI: white noise N / sqrt(Hz), and walks K / sqrt(Hz) that are as large after N / K = 5 s."""


def noise(rng: np.random.Generator, rows: int, quantity: str) -> np.ndarray:
    """Values (rows, 3) of white noise and a random walk, by their definitions: N sqrt(f), and K / sqrt(f) a step."""
    white = rng.normal(0, DENSITY[quantity] * WALK_RATE_HZ**0.5, (rows, 3))
    return white + np.cumsum(rng.normal(0, WALK[quantity] / WALK_RATE_HZ**0.5, (rows, 3)), axis=0)


def write_walking(path: Path, names: tuple[str, str] = ("IMU1_acc", "IMU1_gyro"), rows: int = 20_000) -> Path:
    """The log of a six-axis chip whose biases walk, for 1000 s."""
    rng, time = np.random.default_rng(4), np.arange(rows) * (1_000_000_000 // WALK_RATE_HZ)
    headers = [
        SensorHeader(names[0], "mpu6050", "specific_force", "g", 2.0, 16384.0),
        SensorHeader(names[1], "mpu6050", "angular_rate", "dps", 250.0, 131.0),
    ]
    per_si = {"specific_force": 16384 / 9.80665, "angular_rate": 131 * 180 / np.pi}
    with LogWriter(path, headers, source="simulated", epoch=EPOCH) as log:
        for header in headers:
            counts = np.rint(noise(rng, rows, header.quantity) * per_si[header.quantity]).astype(np.int16)
            log.append(header.name, Block(time, counts, np.zeros(rows, np.uint16)))
        log.phase(Phase(0, int(time[-1]) + 1, "static"))
    return path


def write_walking_fused(path: Path, rows: int = 20_000) -> Path:
    rng = np.random.default_rng(5)
    triads = {quantity: noise(rng, rows, quantity) for quantity in DENSITY}
    triads["specific_force"][100] = np.nan  # a frame without a force: the noise is that of the rest
    time = np.arange(rows) * (1_000_000_000 // WALK_RATE_HZ)
    block = FusedBlock(time, triads, {}, {})
    write_fused(path, [block], epoch=EPOCH, technique="mean", log="run.h5", sensors={})
    return path


def kalibr_accepts(figures: Mapping[str, Any]) -> None:
    """The checks of Kalibr's reader."""
    for key in KALIBR:
        assert isinstance(figures[key], float | int), key
        assert figures[key] > 0, key
    assert isinstance(figures["rostopic"], str)


@pytest.fixture(scope="module")
def walking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walking")
    write_walking(folder / "log.h5")
    write_walking_fused(folder / "fused.h5")
    return folder


@pytest.mark.parametrize(("name", "topic"), some([("log.h5", "/sensors/IMU1"), ("fused.h5", "/fused")], 1))
def test_an_imu_has_every_key_of_kalibr(walking: Path, tmp_path: Path, name: str, topic: str) -> None:
    """The walk is the largest of three axes over 1000 s: within 40 %."""
    written = export(walking / name, tmp_path / "imu.yaml")
    assert (written.files, written.notes) == ((tmp_path / "imu.yaml",), ())
    figures = yaml.safe_load((tmp_path / "imu.yaml").read_text())
    kalibr_accepts(figures)
    assert set(figures) == {*KALIBR, "rostopic"}
    assert (figures["rostopic"], figures["update_rate"]) == (topic, pytest.approx(WALK_RATE_HZ))
    assert figures["accelerometer_noise_density"] == pytest.approx(DENSITY["specific_force"], rel=0.1)
    assert figures["gyroscope_noise_density"] == pytest.approx(DENSITY["angular_rate"], rel=0.1)
    assert figures["accelerometer_random_walk"] == pytest.approx(WALK["specific_force"], rel=0.4)
    assert figures["gyroscope_random_walk"] == pytest.approx(WALK["angular_rate"], rel=0.4)
    assert "inflate" in (tmp_path / "imu.yaml").read_text()


@pytest.mark.slow
def test_the_topic_is_that_of_the_bag(walking: Path, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    export(walking / "log.h5", tmp_path / "imu.yaml")
    export(walking / "log.h5", tmp_path / "bag.mcap", tool="ros2")
    with (tmp_path / "bag.mcap").open("rb") as file:
        topics = {channel.topic for channel in reader.make_reader(file).get_summary().channels.values()}
    assert yaml.safe_load((tmp_path / "imu.yaml").read_text())["rostopic"] in topics


@pytest.mark.slow
def test_openvins_has_the_same_figures_below_imu0(walking: Path, tmp_path: Path) -> None:
    """Keys as in config/euroc_mav/kalibr_imu_chain.yaml of rpng/open_vins; its first line is OpenCV's."""
    for tool in ("kalibr", "openvins"):
        export(walking / "log.h5", tmp_path / f"{tool}.yaml", tool=tool)
    first, rest = (tmp_path / "openvins.yaml").read_text().split("\n", 1)
    assert first == "%YAML:1.0"
    figures = yaml.safe_load(rest)["imu0"]
    own = {"T_i_b", "time_offset", "model", "Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC", "Tg"}
    assert set(figures) == own | {*KALIBR, "rostopic"}
    assert {key: figures[key] for key in (*KALIBR, "rostopic")} == yaml.safe_load(
        (tmp_path / "kalibr.yaml").read_text()
    )
    assert figures["T_i_b"] == np.eye(4).tolist()
    assert figures["Tw"] == figures["Ta"] == np.eye(3).tolist()
    assert figures["Tg"] == np.zeros((3, 3)).tolist()


@pytest.mark.slow
def test_vins_fusion_has_standard_deviations_at_the_rate(walking: Path, tmp_path: Path) -> None:
    """Its preintegration multiplies noise and walk by the interval, so that both are a density times sqrt(rate)."""
    for tool in ("kalibr", "vins-fusion"):
        export(walking / "log.h5", tmp_path / f"{tool}.yaml", tool=tool)
    kalibr = yaml.safe_load((tmp_path / "kalibr.yaml").read_text())
    figures = yaml.safe_load((tmp_path / "vins-fusion.yaml").read_text().split("\n", 1)[1])
    assert set(figures) == {"imu", "imu_topic", "acc_n", "gyr_n", "acc_w", "gyr_w", "g_norm"}
    pairs = {"acc_n": KALIBR[0], "acc_w": KALIBR[1], "gyr_n": KALIBR[2], "gyr_w": KALIBR[3]}
    for key, other in pairs.items():
        assert figures[key] == pytest.approx(kalibr[other] * WALK_RATE_HZ**0.5, rel=1e-5)
    assert (figures["imu"], figures["imu_topic"], figures["g_norm"]) == (1, "/sensors/IMU1", 9.80665)


@pytest.mark.slow
def test_opencv_reads_the_files_of_openvins_and_vins_fusion(walking: Path, tmp_path: Path) -> None:
    """Both read their configuration by `cv::FileStorage`."""
    cv2 = pytest.importorskip("cv2")
    for tool in ("kalibr", "openvins", "vins-fusion"):
        export(walking / "log.h5", tmp_path / f"{tool}.yaml", tool=tool)
    kalibr = yaml.safe_load((tmp_path / "kalibr.yaml").read_text())
    storage = cv2.FileStorage(str(tmp_path / "openvins.yaml"), cv2.FILE_STORAGE_READ)
    openvins = storage.getNode("imu0")
    assert [openvins.getNode(key).real() for key in KALIBR] == [kalibr[key] for key in KALIBR]
    assert openvins.getNode("rostopic").string() == kalibr["rostopic"]
    rows = [openvins.getNode("T_i_b").at(row) for row in range(4)]
    assert [[row.at(column).real() for column in range(4)] for row in rows] == np.eye(4).tolist()
    vins = cv2.FileStorage(str(tmp_path / "vins-fusion.yaml"), cv2.FILE_STORAGE_READ)
    assert vins.getNode("imu_topic").string() == kalibr["rostopic"]
    assert vins.getNode("acc_n").real() == pytest.approx(kalibr[KALIBR[0]] * WALK_RATE_HZ**0.5, rel=1e-5)


@pytest.mark.slow
def test_gazebo_has_a_sensor_with_noise_on_every_axis(walking: Path, tmp_path: Path) -> None:
    """SDFormat: standard deviation of a reading; the dynamic bias is driven by the walk (GaussianNoiseModel)."""
    for name in ("kalibr.yaml", "imu.sdf"):
        export(walking / "log.h5", tmp_path / name)
    kalibr = yaml.safe_load((tmp_path / "kalibr.yaml").read_text())
    sensor = ElementTree.parse(tmp_path / "imu.sdf").getroot()  # noqa: S314, our own file
    assert (sensor.tag, sensor.get("type"), sensor.findtext("topic")) == ("sensor", "imu", "/sensors/IMU1")
    assert float(sensor.findtext("update_rate", "")) == pytest.approx(WALK_RATE_HZ)
    for part, prefix in (("linear_acceleration", "accelerometer"), ("angular_velocity", "gyroscope")):
        for axis in "xyz":
            element = sensor.find(f"imu/{part}/{axis}/noise")
            assert element is not None
            assert element.get("type") == "gaussian"
            spread = kalibr[f"{prefix}_noise_density"] * WALK_RATE_HZ**0.5
            assert float(element.findtext("stddev", "")) == pytest.approx(spread, rel=1e-5)
            walk = float(element.findtext("dynamic_bias_stddev", ""))
            assert walk == pytest.approx(kalibr[f"{prefix}_random_walk"], rel=1e-5)


@pytest.mark.slow
def test_px4_has_a_plugin_with_the_figures_of_kalibr(walking: Path, tmp_path: Path) -> None:
    """Elements as gazebo_imu_plugin.cpp reads them."""
    export(walking / "log.h5", tmp_path / "kalibr.yaml")
    export(walking / "log.h5", tmp_path / "px4.sdf", tool="px4")
    kalibr = yaml.safe_load((tmp_path / "kalibr.yaml").read_text())
    plugin = ElementTree.parse(tmp_path / "px4.sdf").getroot()  # noqa: S314, our own file
    assert plugin.get("filename") == "libgazebo_imu_plugin.so"
    result = {child.tag: child.text for child in plugin if isinstance(child.tag, str)}
    for prefix in ("accelerometer", "gyroscope"):
        assert float(result[f"{prefix}NoiseDensity"] or "") == pytest.approx(kalibr[f"{prefix}_noise_density"])
        assert float(result[f"{prefix}RandomWalk"] or "") == pytest.approx(kalibr[f"{prefix}_random_walk"])


@pytest.mark.slow
@pytest.mark.parametrize("suffix", some(["yaml", "sdf"], 1))
@pytest.mark.parametrize("second", [False, True])
def test_a_bound_is_a_comment_and_never_a_value(still: Path, tmp_path: Path, suffix: str, second: bool) -> None:
    """White noise alone: no walk is significant, which every file states in a comment; the summary names the missing
    keys.
    """
    tools = {"yaml": ("openvins", "vins-fusion"), "sdf": ("gazebo", "px4")}[suffix]
    written = export(still, tmp_path / f"imu.{suffix}", tool=tools[second])
    text = (tmp_path / f"imu.{suffix}").read_text()
    bare = "".join(part.split("-->")[-1] for part in text.split("<!--"))
    bare = "\n".join(line.split("#")[0] for line in bare.splitlines())
    for word in ("random_walk", "acc_w", "gyr_w", "RandomWalk", "dynamic_bias"):
        assert word not in bare
    assert text.count("not significant, at most ") == (6 if tools[second] == "gazebo" else 2)
    (note,) = written.notes
    assert note.endswith("imu." + suffix + ": without accelerometer_random_walk, gyroscope_random_walk")


@pytest.mark.parametrize("tool", some(["px4", "gazebo", "kalibr"], 1))
def test_coloured_noise_is_not_exported_as_a_random_walk(tool: str, tmp_path: Path) -> None:
    """Noise that a first-order filter coloured fits no sum of white noise, flicker and walk."""
    white = np.random.default_rng(9).normal(0, 5, (ROWS, 3))
    counts = np.rint(lfilter([1.0], [1.0, -0.95], white, axis=0)).astype(np.int16)
    time = np.arange(ROWS) * (1_000_000_000 // RATE_HZ)
    with LogWriter(tmp_path / "run.h5", [GYRO], source="simulated", epoch=EPOCH) as log:
        log.append("G", Block(time, counts, np.zeros(ROWS, np.uint16)))
        log.phase(Phase(0, int(time[-1]) + 1, "static"))
    suffix = "yaml" if tool == "kalibr" else "sdf"
    (path,) = export(tmp_path / "run.h5", tmp_path / f"imu.{suffix}", tool=tool).files
    text = path.read_text()
    if tool == "gazebo":  # without a density there is no noise
        assert "dynamic_bias_stddev>" not in text
    else:
        key = "# gyroscope_random_walk" if tool == "kalibr" else "<!-- gyroscopeRandomWalk"
        assert f"{key}: not determined, because the noise is of another kind" in text


def test_a_fused_result_in_motion_is_refused(tmp_path: Path) -> None:
    time = np.arange(2000) * 50_000_000
    swing = np.sin(time * 1e-9)[:, None] * np.ones(3)
    block = FusedBlock(time, {"angular_rate": swing}, {}, {})
    write_fused(tmp_path / "f.h5", [block], epoch=EPOCH, technique="mean", log="run.h5", sensors={})
    with pytest.raises(ExportError, match="moves in 100 % of its frames; noise is measured at rest"):
        export(tmp_path / "f.h5", tmp_path / "f.yaml")


def test_noise_of_a_fused_result_is_that_at_rest(tmp_path: Path) -> None:
    """The box is turned after 60 % of the time: its noise is that of the rest before."""
    write_walking_fused(tmp_path / "still.h5", rows=2000)
    with h5py.File(tmp_path / "still.h5", "r+") as file:
        file["fused/angular_rate"][1200:1300] += 1.0
        file["fused/specific_force"][1300:, 0] += 9.8
    written = export(tmp_path / "still.h5", tmp_path / "f.yaml")
    assert written.rows["fused"] in range(1060, 1201)  # a frame without a force parts what is before the turn
    figures = yaml.safe_load((tmp_path / "f.yaml").read_text())
    assert figures["accelerometer_noise_density"] == pytest.approx(DENSITY["specific_force"], rel=0.15)
    assert figures["gyroscope_noise_density"] == pytest.approx(DENSITY["angular_rate"], rel=0.15)


def test_a_short_fused_result_is_refused(fused: Path) -> None:
    """Four frames, of which the third has no force."""
    with pytest.raises(ExportError, match="no inertial sensor whose noise could be fitted"):
        export(fused, fused.with_name("f.yaml"))

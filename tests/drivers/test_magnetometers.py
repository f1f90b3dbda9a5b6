"""Current magnetometers: their drivers read the emulated chips, from any state that an earlier program left."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_array
from firmware_emulator.chips import CHIPS
from firmware_emulator.units import unit_of
from firmware_emulator.world import StillWorld
from imuarray.acquire.bus_segment import connect
from imuarray.acquire.detection import distinguish_alike, explore, propose
from imuarray.acquire.recorder import record
from imuarray.array import ArrayConfig, SensorConfig, parse_array
from imuarray.bus import open_bus
from imuarray.bus.serial_link import Request
from imuarray.drivers.unattended import visits_of
from imuarray.errors import SensorError
from imuarray.log import open_log
from imuarray.log.format import OVERRUN, STALE
from tests.acquire.streams import stream
from tests.bus.serial_bench import Bench

FIELD = (0.21, -0.33, 0.45)
OVERRUNS = ("lis3mdl", "ak8963")
"""Chips that say that a reading is old, or that some were lost."""
GAUSS = {"lis3mdl": (4.0, 8.0, 12.0, 16.0), "mmc5983": (8.0,), "ak8963": (49.12,), "ak8975": (12.29,)}
ADDRESSES = {"lis3mdl": 0x1C, "mmc5983": 0x30, "ak8963": 0x0C, "ak8975": 0x0C}
RATES_HZ = {"lis3mdl": (0.625, 5.0, 80.0, 155.0), "ak8963": (8.0, 100.0), "ak8975": (100.0,)}
LEFT_BEHIND = {
    "lis3mdl": ((0x05, 0x40), (0x08, 0x10), (0x20, 0x02), (0x21, 0x60), (0x23, 0x02), (0x22, 0x22)),
    "ak8963": ((0x0C, 0x40), (0x0A, 0x0F)),
    "ak8975": ((0x0C, 0x40), (0x0A, 0x0F)),
    "mmc5983": ((0x0A, 0x1F), (0x0C, 0x02), (0x09, 0x10), (0x0B, 0x0F)),
}
"""What an earlier program wrote: offsets, another rate, range, byte order, low power; axes off, current, RESET."""


def sensor(chip: str, **settings: Any) -> SensorConfig:
    given = {"range": min(GAUSS[chip]), **settings}
    return SensorConfig(name="M", chip=chip, address=ADDRESSES[chip], **given)


def fields(made: Any, count: int = 4) -> np.ndarray:
    """Fresh readings (count, 3) in gauss."""
    readings: list[np.ndarray] = []
    for _ in range(50 * count):
        made.wait(0.5 / made.driver.rate_hz)
        decoded = made.read()
        if not decoded.status[0] & STALE:
            factors = getattr(made.driver, "factors", 1.0)  # the AK8963's own adjustment: AKM-16
            readings.append(decoded.counts[0] * factors / made.sensor.sensitivity)
        if len(readings) == count:
            break
    return np.array(readings)


def bridge(made: Any) -> np.ndarray:
    """Offsets of the bridges in gauss, from the header; 0 for chips that have none."""
    header = made.driver.header()
    return np.array([header.get(f"bridge_{axis}", 0.0) for axis in "xyz"]) / made.sensor.sensitivity


@pytest.mark.parametrize(("chip", "gauss"), [(chip, gauss) for chip, ranges in GAUSS.items() for gauss in ranges])
def test_every_range_reads_the_field(bench: Callable[..., Any], chip: str, gauss: float) -> None:
    made = bench(CHIPS[chip], sensor(chip, range=gauss), vector=FIELD)
    made.driver.identify()
    made.driver.configure()
    assert fields(made).mean(axis=0) - bridge(made) == pytest.approx(FIELD, abs=1 / made.sensor.sensitivity)


@pytest.mark.parametrize(("chip", "rate_hz"), [(chip, rate) for chip, rates in RATES_HZ.items() for rate in rates])
def test_every_rate_gives_its_number_of_readings(bench: Callable[..., Any], chip: str, rate_hz: float) -> None:
    """A sample during a burst, after its status byte, is read without its flag: the bus takes 0.3 ms for a burst."""
    made = bench(CHIPS[chip], sensor(chip, rate_hz=rate_hz), vector=FIELD)
    made.driver.configure()
    made.read()
    begun_ns, fresh = made.clock.now_ns(), 0
    while made.clock.now_ns() < begun_ns + round(20e9 / rate_hz):
        made.wait(0.1 / rate_hz)
        fresh += not made.read().status[0] & STALE
    assert -1 <= 20 - fresh <= 1 + 20 * 0.3e-3 / (0.1 / rate_hz + 0.3e-3)


@pytest.mark.parametrize("poll_s", [0.0008, 0.0033, 0.0097])
def test_a_slower_measurement_of_an_ak8975_is_awaited(
    bench: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, poll_s: float
) -> None:
    """Sources say 9 ms or 10 ms at the most (AKM-25); a new measurement would end the one in progress (DEC-235)."""
    monkeypatch.setattr("firmware_emulator.chips.akm.AK8975_NS", 10_000_000)
    made = bench(CHIPS["ak8975"], sensor("ak8975"), vector=FIELD)
    made.driver.configure()
    begun_ns, fresh = made.clock.now_ns(), 0
    while made.clock.now_ns() < begun_ns + 400_000_000:
        made.wait(poll_s)
        fresh += not made.read().status[0] & STALE
    assert 18 <= fresh <= 40


@pytest.mark.parametrize("chip", GAUSS)
def test_settings_of_an_earlier_program_are_replaced(bench: Callable[..., Any], chip: str) -> None:
    made = bench(CHIPS[chip], sensor(chip), vector=FIELD)
    made.write(*LEFT_BEHIND[chip])
    made.driver.configure()
    assert fields(made).mean(axis=0) - bridge(made) == pytest.approx(FIELD, abs=1 / made.sensor.sensitivity)


@pytest.mark.parametrize("chip", OVERRUNS)
def test_old_and_lost_readings_are_flagged(bench: Callable[..., Any], chip: str) -> None:
    made = bench(CHIPS[chip], sensor(chip), vector=FIELD)
    made.driver.configure()
    made.read()
    assert made.read().status[0] & STALE
    made.wait(3.5 / made.driver.rate_hz)
    status = made.read().status[0]
    assert not status & STALE
    assert status & OVERRUN


def test_a_lis3mdl_measures_its_temperature(bench: Callable[..., Any]) -> None:
    made = bench(CHIPS["lis3mdl"], sensor("lis3mdl"), vector=FIELD)
    made.chip.element.temperature_degc = 41.0
    made.driver.configure()
    assert made.read().temperature_counts.tolist() == [128]  # 8 a degC, 0 at 25 degC: LIS-20


@pytest.mark.slow
def test_a_microcontroller_reads_a_lis3mdl_twice_in_a_frame(tmp_path: Path) -> None:
    """The temperature is a separate transaction (LIS-18): no frame is left out for it, and it is that of the room."""
    array = parse_array(
        '[array]\nname = "one"\n[[sensor]]\nname = "M"\nchip = "lis3mdl"\naddress = 0x1C\nrange = 4\nrate_hz = 80'
    )
    first, second = visits_of(array["M"])
    assert [visit.requests for visit in (first, second)] == [
        (Request(0x1C, b"\xae", 2),),
        (Request(0x1C, b"\xa7", 7),),
    ]
    for rate_hz in (5.0, 50.0):
        stream(Bench(array), array, tmp_path / f"{rate_hz:g}.h5", rate_hz=rate_hz, seconds=4)
        with open_log(tmp_path / f"{rate_hz:g}.h5") as log:
            assert len(log["M"]) == pytest.approx(4 * rate_hz, abs=1)
            assert np.abs(np.asarray(log["M"].temperature_counts)).max() <= 8  # of 8 a degC, 0 at 25 degC: LIS-20


def test_a_mark_is_kept_and_verified(bench: Callable[..., Any]) -> None:
    made = bench(CHIPS["lis3mdl"], sensor("lis3mdl"), vector=FIELD)
    assert made.driver.mark(21)
    made.driver.configure()
    assert made.register(0x32) == 21
    for setting in made.driver.watched:
        made.driver.registers.verify(setting)


@pytest.mark.parametrize(
    ("chip", "identity", "message"),
    [
        ("lis3mdl", 0x3C, "identity 3c, an LSM303DLHC or LSM303DLM, expected 3d"),  # LIS-02
        ("lis3mdl", 0x00, "identity 00, expected 3d"),
        ("ak8975", 0x49, "identity 49, expected 48"),
        ("ak8963", 0x49, "identity 49, expected 48"),
        ("mmc5983", 0x0A, "identity 0a, expected 30"),
    ],
)
def test_another_chip_is_named(bench: Callable[..., Any], chip: str, identity: int, message: str) -> None:
    made = bench(CHIPS[chip], sensor(chip), identity=identity)
    with pytest.raises(SensorError, match=rf"M \({chip}\) at trunk address {ADDRESSES[chip]:#04x}: {message}"):
        made.driver.identify()


def test_set_and_reset_measure_the_offset_of_the_bridges(bench: Callable[..., Any]) -> None:
    """MMC-14: (m_set + m_reset) / 2, within a code; counts are not corrected."""
    made = bench(CHIPS["mmc5983"], sensor("mmc5983"), vector=FIELD, bridge=(0.3, -0.4, 0.05))
    made.driver.configure()
    header = made.driver.header()
    assert [header[f"bridge_{axis}"] for axis in "xyz"] == pytest.approx([4915.2, -6553.6, 819.2], abs=1)
    assert made.read().counts[0] == pytest.approx(16384 * np.add(FIELD, (0.3, -0.4, 0.05)), abs=1)
    assert made.read().counts.dtype == np.int32


def test_the_lowest_two_of_18_bits_are_decoded(bench: Callable[..., Any]) -> None:
    codes = []
    for step in range(8):
        made = bench(CHIPS["mmc5983"], sensor("mmc5983"), vector=(step / 16384, 0.0, -step / 16384), bridge=(0, 0, 0))
        made.driver.configure()
        codes.append(made.read().counts[0].tolist())
    assert codes == [[step, 0, -step] for step in range(8)]


def test_a_chip_that_does_not_measure_is_reported(bench: Callable[..., Any]) -> None:
    made = bench(CHIPS["mmc5983"], sensor("mmc5983"), vector=FIELD)
    made.tap.drops = lambda register: register == 0x09
    with pytest.raises(SensorError, match="a measurement is not done after 9 ms"):
        made.driver.configure()


@pytest.mark.parametrize(
    ("field", "bridge", "passed"),
    [
        ((0.2, 0.0, 0.45), (0.1, -0.1, 0.2), True),
        ((0.01, 0.0, 0.0), (0.1, 0.0, 0.0), None),  # too weak to decide
        ((0.2, 0.0, 0.45), (1.4, 0.0, 0.0), False),
        ((5.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),  # magnetised, or near a magnet
    ],
)
def test_the_self_test_of_an_mmc5983_judges_field_and_bridge(
    bench: Callable[..., Any], field: Any, bridge: Any, passed: bool | None
) -> None:
    made = bench(CHIPS["mmc5983"], sensor("mmc5983"), vector=field, bridge=bridge)
    assert made.driver.self_test().passed is passed


# The AK8963 behind an MPU-9250 ----------------------------------------------------------------------------------------

BEHIND = """
[array]
name = "a"
mux = { chip = "pca9544a", address = 0x70 }
[[sensor]]
name = "Mag"
chip = "ak8963"
channel = 1
address = 0x0C
range = 49.12
axes = "+Y+X-Z"
[[sensor]]
name = "Acc"
chip = "mpu9250"
channel = 1
address = 0x69
range = 4
"""
"""The magnetometer's x lies along the accelerometer's y, its y along x, its z against z: AKM-03."""


@pytest.fixture(params=[True, False])
def mpu9250_array(request: Any) -> ArrayConfig:
    """Behind a multiplexer, and without one."""
    text = BEHIND if request.param else BEHIND.replace("channel = 1\n", "").replace("mux =", "# mux =")
    return parse_array(text)


def test_a_magnetometer_answers_only_while_the_bypass_of_its_mpu9250_is_open(mpu9250_array: ArrayConfig) -> None:
    with open_array(mpu9250_array) as bus:
        if mpu9250_array.mux is not None:
            bus.transfer(0x70, b"\x05")
        with pytest.raises(OSError, match="no acknowledge from 0x0c"):
            bus.transfer(0x0C, b"\x00", 1)
        bus.transfer(0x69, b"\x37\x02")
        assert bus.transfer(0x0C, b"\x00", 1) == b"\x48"
        bus.transfer(0x69, b"\x6a\x20")  # the MPU's own master has the bus: INV-97
        with pytest.raises(OSError, match="no acknowledge from 0x0c"):
            bus.transfer(0x0C, b"\x00", 1)
        bus.transfer(0x69, b"\x6a\x00")
        assert bus.transfer(0x0C, b"\x00", 1) == b"\x48"
        bus.transfer(0x69, b"\x6b\x80")  # a reset closes it
        with pytest.raises(OSError, match="no acknowledge from 0x0c"):
            bus.transfer(0x0C, b"\x00", 1)


def test_the_driver_opens_the_bypass_and_reads_the_field_in_the_axes_of_the_box(mpu9250_array: ArrayConfig) -> None:
    """Counts, adjusted by the fuse ROM, are the field at the orientation of this part; mean of 25 at 4.4 sigma."""
    with open_array(mpu9250_array, switches={"Mag": {"adjustment": (190, 140, 100)}}) as bus:
        magnetometer, _ = (route.driver for route in connect(mpu9250_array, bus))
        bursts = b""
        for _ in range(25):
            bus.clock.sleep_until(bus.clock.now_ns() + 12_000_000)
            bursts += magnetometer.fetch()
        counts = magnetometer.decode(np.frombuffer(bursts, np.uint8).reshape(25, -1)).counts.mean(axis=0)
        header = magnetometer.header()
        assert header == {"asa_x": 190, "asa_y": 140, "asa_z": 100}
        field = counts * (np.array(list(header.values())) + 128) / 256 / mpu9250_array["Mag"].sensitivity
        true = np.array(StillWorld()(0).field_box)
        unit = unit_of("a", "Mag", "ak8963", 49.12)  # this part's zero and scale
        felt = np.array(unit.response) @ (np.array(mpu9250_array["Mag"].orientation).T @ true) + unit.bias
        assert field == pytest.approx(felt, abs=4.4 * 3e-3 / 5)
        assert magnetometer.self_test().passed


@pytest.mark.slow
def test_a_reset_mpu9250_is_reported_and_its_bypass_opened_again(mpu9250_array: ArrayConfig, tmp_path: Path) -> None:
    faults, path = tmp_path / "faults.toml", tmp_path / "run.h5"
    faults.write_text('[[fault]]\nkind = "reset"\nsensor = "Acc"\nat_s = 2.0\n')
    with open_bus(f"emulated:?faults={faults}", mpu9250_array) as bus:
        record(mpu9250_array, bus, path, rate_hz=50.0, seconds=5.0)
    with open_log(path) as log:
        assert {"lost", "back"} <= {event.kind for event in log.events if event.sensor == "Mag"}
        late = np.asarray(log["Mag"].time[:]) > 4_000_000_000
        assert np.count_nonzero(late) > 40


def test_two_mpu9250_with_magnetometers_on_one_bus_are_refused() -> None:
    second = '[[sensor]]\nname = "Acc2"\nchip = "mpu9250"\nchannel = 1\naddress = 0x68\nrange = 4\n'
    array = parse_array(BEHIND + second)
    with open_array(array) as bus, pytest.raises(SensorError, match="two MPU-9250 are on this bus"):
        connect(array, bus)


# The AK8975 behind an MPU-9150, whose six-axis half is an MPU-6050's --------------------------------------------------

BEHIND_9150 = BEHIND.replace('"ak8963"', '"ak8975"').replace("49.12", "12.29").replace('"mpu9250"', '"mpu6050"')


def test_the_magnetometer_of_an_mpu9150_is_read_behind_its_bypass() -> None:
    """As of the MPU-9250: the field at this part; mean of 25 at 4.4 sigma and a count."""
    array = parse_array(BEHIND_9150)
    with open_array(array) as bus:
        bus.transfer(0x70, b"\x05")
        with pytest.raises(OSError, match="no acknowledge from 0x0c"):
            bus.transfer(0x0C, b"\x00", 1)
        magnetometer, _ = (route.driver for route in connect(array, bus))
        bursts = b""
        for _ in range(25):
            bus.clock.sleep_until(bus.clock.now_ns() + 12_000_000)
            bursts += magnetometer.fetch()
        decoded = magnetometer.decode(np.frombuffer(bursts, np.uint8).reshape(25, -1))
        assert not (decoded.status & STALE).any()
        counts = decoded.counts.mean(axis=0)
        factors = (np.array(list(magnetometer.header().values())) + 128) / 256
        field = counts * factors / array["Mag"].sensitivity
        unit = unit_of("a", "Mag", "ak8975", 12.29)
        felt = (
            np.array(unit.response) @ (np.array(array["Mag"].orientation).T @ np.array(StillWorld()(0).field_box))
            + unit.bias
        )
        assert field == pytest.approx(felt, abs=4.4 * 3e-3 / 5 + 0.5 / array["Mag"].sensitivity)


@pytest.mark.parametrize(("text", "chip"), [(BEHIND, "ak8963"), (BEHIND_9150, "ak8975")])
def test_ak8963_and_ak8975_are_distinguished_by_their_self_test(text: str, chip: str) -> None:
    with open_array(parse_array(text.replace("channel = 1\n", "").replace("mux =", "# mux ="))) as bus:
        bus.transfer(0x69, b"\x37\x02")
        listed = explore(bus)
        assert [line.found for line in listed if line.address == 0x0C] == ["ak8963 or ak8975"]
        distinct = distinguish_alike(listed, bus)
        assert [line.found for line in distinct if line.address == 0x0C] == [chip]
        assert [sensor.chip for sensor in parse_array(propose(distinct, "spi:")).sensors].count(chip) == 1


def test_two_mpu9150_with_magnetometers_on_one_bus_are_refused() -> None:
    second = '[[sensor]]\nname = "Acc2"\nchip = "mpu6050"\nchannel = 1\naddress = 0x68\nrange = 4\n'
    array = parse_array(BEHIND_9150 + second)
    with open_array(array) as bus, pytest.raises(SensorError, match="two MPU-9150 are on this bus"):
        connect(array, bus)


def test_a_microcontroller_reads_and_restarts_an_ak8975_in_one_visit() -> None:
    (visit,) = visits_of(sensor("ak8975"))
    assert visit.requests == (Request(0x0C, b"\x02", 8), Request(0x0C, b"\x0a\x01", 0))


@pytest.mark.slow
def test_an_ak8975_is_logged_at_the_rate_of_the_frames(tmp_path: Path) -> None:
    array, path = parse_array(BEHIND_9150), tmp_path / "run.h5"
    with open_bus("emulated:", array) as bus:
        record(array, bus, path, rate_hz=50.0, seconds=2.0)
    with open_log(path) as log:
        assert len(log["Mag"]) == pytest.approx(100, abs=2)
        assert not (log["Mag"].status[:] & STALE).any()
        assert {log["Mag"].attributes[f"asa_{axis}"] for axis in "xyz"} == {176, 178, 167}

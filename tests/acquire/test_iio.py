"""Sensors that the kernel serves: configured, captured and logged from a tree like sysfs, or refused."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.acquire import connect, record
from imuarray.acquire.detection import detect, explore
from imuarray.acquire.doctor import Machine, examine
from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.bus import open_bus
from imuarray.bus.iio import IioBus
from imuarray.cli import main
from imuarray.errors import BusUrlError, ConfigError, SensorError
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, OVERRUN, SATURATED, STALE
from tests.bus.iio_machine import ACCEL, KernelDevice, KernelMachine, scan

START_NS = 5_000_000_000
PERIOD_NS = 20_000_000


class SteppedClock:
    """A clock that only sleeping advances; `passed(now_ns)` is called whenever it has."""

    def __init__(self, passed: Callable[[int], None] = lambda now_ns: None) -> None:
        self.time_ns = START_NS
        self.passed = passed

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until(self, at_ns: int) -> None:
        self.time_ns = max(self.time_ns, at_ns)
        self.passed(self.time_ns)


def sensor(name: str, keys: str) -> str:
    return f'[[sensor]]\nname = "{name}"\n{keys}\n'


def array_of(*sensors: str) -> ArrayConfig:
    return parse_array('[array]\nname = "a"\nbus = "iio:"\n' + "".join(sensors))


ACC = 'chip = "kx023"\nquantity = "specific_force"\nbus = "iio:kx023"\nrate_hz = 50\n'
BUFFERED = ACC + "fifo = true\n"


@pytest.fixture
def machine(tmp_path: Path) -> KernelMachine:
    return KernelMachine(tmp_path)


def played(
    device: KernelDevice, scans: Callable[[int], bytes], *, leave_out: range = range(0)
) -> Callable[[int], None]:
    """Let scan k wait from its time on, START + (k + 0.5) periods, while the buffer is enabled."""
    given = [0]

    def passed(now_ns: int) -> None:
        while START_NS + (given[0] + 0.5) * PERIOD_NS <= now_ns:
            if device.read("buffer/enable") == "1" and given[0] not in leave_out:
                device.feed(scans(given[0]))
            given[0] += 1

    return passed


def time_of(k: int) -> int:
    return START_NS + round((k + 0.5) * PERIOD_NS)


def counts_of(k: int) -> tuple[int, int, int]:
    return 100 + k, -200 - k, 16384 - 3 * k


def small_scan(k: int) -> bytes:
    return scan([*((value, 2, "little") for value in counts_of(k)), (time_of(k), 8, "little")])


def log_of(machine: KernelMachine, array: ArrayConfig, clock: SteppedClock, seconds: float = 1.2) -> Path:
    path = machine.root / "run.h5"
    with IioBus(machine.root, clock=clock) as bus:
        record(array, bus, path, rate_hz=10, seconds=seconds)
    return path


def test_a_buffer_is_logged_count_by_count_at_the_kernels_times(machine: KernelMachine) -> None:
    device = machine.add("kx023", "i2c-1/1-001e", ACCEL)
    path = log_of(machine, array_of(sensor("A", BUFFERED)), SteppedClock(played(device, small_scan)))
    assert device.read("buffer/enable") == "0"
    assert device.read("current_timestamp_clock") == "monotonic"
    assert int(device.read("buffer/length")) >= 100
    with open_log(path) as log:
        assert log.source == "iio"
        rows = log["A"]
        number = np.round((rows.time[:] + START_NS - time_of(0)) / PERIOD_NS).astype(int)
        assert (np.diff(number) == 1).all()
        assert len(number) >= 55
        assert rows.time[:].tolist() == [time_of(k) - START_NS for k in number.tolist()]
        assert rows.counts[:].tolist() == [list(counts_of(k)) for k in number.tolist()]
        assert rows.counts[:].dtype == np.int16
        assert not (rows.status[:] & (STALE | OVERRUN | LOST_BEFORE | SATURATED)).any()
        assert rows.sensitivity == pytest.approx(9.80665 / 0.000598205)
        assert rows.range == pytest.approx(32768 * 0.000598205 / 9.80665)
        assert (rows.chip, rows.unit, rows.rate_hz) == ("kx023", "g", 50)
        assert rows.attributes["iio_name"] == "kx023"
        assert rows.time_uncertainty is None  # the kernel states none of its own times
        assert rows.attributes["iio_place"] == "1-001e"
        assert rows.attributes["time_source"] == "CLOCK_MONOTONIC of the kernel's driver"
        assert rows.temperature_counts is None


def test_the_nul_at_the_end_of_an_attribute_is_ignored(machine: KernelMachine) -> None:
    """As that of current_timestamp_clock does (Linux 6.1)."""
    device = machine.add("kx023", "i2c-1/1-001e", ACCEL)
    (device.folder / "current_timestamp_clock").write_bytes(b"monotonic\n\0")
    (device.folder / "name").write_bytes(b"kx023\n\0")
    connected(machine, array_of(sensor("A", BUFFERED)))
    assert (device.folder / "current_timestamp_clock").read_bytes() == b"monotonic\n\0"


@pytest.mark.slow
def test_samples_that_the_buffer_dropped_are_flagged(machine: KernelMachine) -> None:
    device = machine.add("kx023", "i2c-1/1-001e", ACCEL)
    clock = SteppedClock(played(device, small_scan, leave_out=range(30, 33)))
    with open_log(log_of(machine, array_of(sensor("A", BUFFERED)), clock)) as log:
        number = np.round((log["A"].time[:] + START_NS - time_of(0)) / PERIOD_NS).astype(int)
        assert set(range(10, 50)) - set(number.tolist()) == {30, 31, 32}
        assert number[(log["A"].status[:] & OVERRUN) != 0].tolist() == [33]
        assert any(event.kind == "overrun" for event in log.events)


IMU = {
    "in_accel_x_scale": "0.00119641",
    "in_accel_y_scale": "0.00119641",
    "in_accel_z_scale": "0.00119641",
    "in_accel_x_offset": "-2048",
    "in_accel_y_offset": "-2048",
    "in_accel_z_offset": "-2048",
    "in_anglvel_scale": "0.000133231",
    "in_temp_scale": "2.941176",
    "in_temp_offset": "12420",
    "mount_matrix": "0, 1, 0; -1, 0, 0; 0, 0, 1",
    "sampling_frequency": "50.000000",
    "current_timestamp_clock": "monotonic",
    "trigger/current_trigger": "imu-dev0",
    **{f"in_{kind}_{axis}_raw": "0" for kind in ("accel", "anglvel") for axis in "xyz"},
    **{f"buffer0/{name}": text for name, text in {"enable": "0", "length": "2", "watermark": "1"}.items()},
    **{
        f"buffer0/{name}_{key}": text
        for name, index, kind in (
            ("in_anglvel_y", 1, "be:s16/16>>0"),
            ("in_anglvel_z", 0, "be:s16/16>>0"),
            ("in_anglvel_x", 4, "be:s20/32>>12"),
            ("in_temp", 6, "le:s16/16>>0"),
            ("in_accel_z", 11, "le:u12/16>>4"),
            ("in_accel_x", 12, "le:u12/16>>4"),
            ("in_accel_y", 13, "le:u12/16>>4"),
            ("in_timestamp", 20, "le:s64/64>>0"),
            ("in_voltage0", 2, "le:u8/8>>0"),
        )
        for key, text in {"en": "1" if name == "in_voltage0" else "0", "index": str(index), "type": kind}.items()
    },
}
IMU_ACC = 'chip = "bmi"\nquantity = "specific_force"\nbus = "iio:imu@spi0.0"\nrate_hz = 50\nfifo = true\n'
IMU_GYRO = (
    'chip = "bmi"\nquantity = "angular_rate"\nbus = "iio:imu@spi0.0"\nrate_hz = 50\nfifo = true\naxes = "+X-Y-Z"\n'
)


def imu_scan(k: int) -> bytes:
    """In the order of indices: z, y and x of the rate, temperature, z, x and y of unsigned acceleration, time."""
    return scan(
        [
            (-k, 2, "big"),
            (2 * k, 2, "big"),
            ((500_000 - k) << 12 | 0xABC, 4, "big"),
            (-521 + k, 2, "little"),
            ((2048 + 512) << 4 | 5, 2, "little"),
            (k << 4, 2, "little"),
            ((4095 - k) << 4 | 15, 2, "little"),
            (time_of(k), 8, "little"),
        ]
    )


def test_two_sensors_of_one_device_share_its_buffer(machine: KernelMachine) -> None:
    """Other orders, widths, signs and byte orders; axes from the mounting matrix, or from the configuration."""
    device = machine.add("imu", "spi0/spi0.0", IMU)
    machine.add("imu", "spi0/spi0.1", IMU)
    array = array_of(sensor("Acc", IMU_ACC), sensor("Gyro", IMU_GYRO))
    with open_log(log_of(machine, array, SteppedClock(played_in(device, imu_scan)))) as log:
        acc, gyro = log["Acc"], log["Gyro"]
        number = np.round((acc.time[:] + START_NS - time_of(0)) / PERIOD_NS).astype(int)
        assert len(number) >= 55
        assert acc.time[:].tolist() == [time_of(k) - START_NS for k in number.tolist()]
        assert acc.counts[:].tolist() == [[k - 2048, 2047 - k, 512] for k in number.tolist()]
        assert acc.counts[:].dtype == np.int16
        assert acc.range == pytest.approx(2048 * 0.00119641 / 9.80665)
        assert gyro.counts[: len(number)].tolist() == [[500_000 - k, 2 * k, -k] for k in number.tolist()]
        assert gyro.counts[:1].dtype == np.int32
        assert (gyro.count_bits, acc.count_bits) == (20, 16)
        assert gyro.sensitivity == pytest.approx(np.radians(1) / 0.000133231)
        assert acc.temperature_counts is not None
        assert acc.temperature_counts[:].tolist() == [-521 + k for k in number.tolist()]
        assert acc.thermometer is not None
        assert acc.thermometer.zero_degc == pytest.approx(36.53, abs=0.01)
        assert acc.thermometer.lsb_per_degc == pytest.approx(340, abs=0.1)
        assert (acc.axes, gyro.axes) == ("-Y+X+Z", "+X-Y-Z")
        assert np.array_equal(acc.orientation, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        assert acc.attributes["mount_matrix"] == gyro.attributes["mount_matrix"] == IMU["mount_matrix"]
    assert device.read("buffer0/in_voltage0_en") == "0"


def played_in(device: KernelDevice, scans: Callable[[int], bytes]) -> Callable[[int], None]:
    """As `played`, of a device whose buffer is in buffer0."""
    device.write("buffer/enable", "1")
    play = played(device, scans)

    def passed(now_ns: int) -> None:
        device.write("buffer/enable", device.read("buffer0/enable"))
        play(now_ns)

    return passed


def test_without_fifo_the_attributes_are_read_in_each_frame(machine: KernelMachine) -> None:
    device = machine.add("kx023", "i2c-1/1-001e", ACCEL)

    def passed(now_ns: int) -> None:
        device.write("in_accel_x_raw", str((now_ns - START_NS) // 10_000_000))

    with open_log(log_of(machine, array_of(sensor("A", ACC + "range = 4\n")), SteppedClock(passed))) as log:
        rows = log["A"]
        assert rows.counts[5].tolist() == [50, -2, 16384]
        assert len(rows) == 12
        assert rows.range == 4
        assert rows.sensitivity == pytest.approx(9.80665 / 0.00119641)
        assert rows.attributes["time_source"] == "CLOCK_MONOTONIC of the reader"
    assert device.read("in_accel_scale") == "0.001196410"
    assert device.read("buffer/enable") == "0"


@pytest.mark.slow
def test_counts_beyond_sixteen_bits_are_clipped_and_flagged_where_no_type_is_stated(machine: KernelMachine) -> None:
    keys = {name: text for name, text in ACCEL.items() if not name.startswith(("scan_elements", "buffer"))}
    device = machine.add("kx023", "i2c-1/1-001e", keys)

    def passed(now_ns: int) -> None:
        device.write("in_accel_y_raw", str(32700 + (now_ns - START_NS) // 10_000_000))

    with open_log(log_of(machine, array_of(sensor("A", ACC)), SteppedClock(passed))) as log:
        y = log["A"].counts[:, 1].tolist()
        assert (y[0], y[5], y[11]) == (32700, 32750, 32767)
        assert ((log["A"].status[:] & SATURATED) != 0).tolist() == [value == 32767 for value in y]
        assert log["A"].counts[:].dtype == np.int16


@pytest.mark.slow
def test_a_buffer_without_times_is_timed_by_its_counts(machine: KernelMachine) -> None:
    keys = {name: text for name, text in ACCEL.items() if "timestamp" not in name}
    device = machine.add("kx023", "i2c-1/1-001e", keys)
    clock = SteppedClock(played(device, lambda k: scan([(value, 2, "little") for value in counts_of(k)])))
    with open_log(log_of(machine, array_of(sensor("A", BUFFERED)), clock, 4.0)) as log:
        rows = log["A"]
        number = rows.counts[:, 0].astype(int) - 100
        assert (np.diff(number) == 1).all()
        late_ns = rows.time[100:] + START_NS - np.array([time_of(k) for k in number.tolist()])[100:]
        assert np.abs(late_ns).max() < PERIOD_NS
        assert rows.attributes["time_source"].startswith("counts")
        assert rows.time_uncertainty is not None
        true_ns = np.array([time_of(k) for k in number.tolist()])
        assert (np.abs(rows.time[:] + START_NS - true_ns) <= 1e9 * rows.time_uncertainty[:]).all()


@pytest.mark.slow
def test_a_device_that_is_removed_and_returns_is_logged_again(machine: KernelMachine) -> None:
    device = machine.add("kx023", "i2c-1/1-001e", ACCEL)
    play = played(device, small_scan)
    target = device.link.readlink()

    def passed(now_ns: int) -> None:
        s = (now_ns - START_NS) / 1e9
        if 1.0 <= s < 2.0 and device.link.is_symlink():
            device.link.unlink()
            device.file.unlink()
        elif s >= 2.0 and not device.link.is_symlink():
            device.write("buffer/enable", "0")
            device.link.symlink_to(target)
            os.mkfifo(device.file)
        if device.link.is_symlink():
            play(now_ns)

    with open_log(log_of(machine, array_of(sensor("A", BUFFERED)), SteppedClock(passed), 5.0)) as log:
        time_s = log["A"].time[:] * 1e-9
        assert ((time_s > 0.2) & (time_s < 0.8)).sum() > 25
        assert not ((time_s > 1.3) & (time_s < 2.0)).any()
        assert (time_s > 4.0).sum() > 40


# What can't be done is refused in one line -------------------------------------------------------------------------


def connected(machine: KernelMachine, array: ArrayConfig) -> None:
    with IioBus(machine.root, clock=SteppedClock()) as bus:
        connect(array, bus)


@pytest.mark.parametrize(
    ("changes", "keys", "message"),
    [
        ({}, BUFFERED.replace("kx023", "kx022"), r"iio:kx022: no such device; allowed are iio:kx023@1-001e"),
        ({}, BUFFERED.replace("rate_hz = 50", "rate_hz = 60"), r"rate_hz 60: allowed are 10, 50, 100, 200"),
        ({}, BUFFERED + "range = 17\n", r"range 17: allowed are up to 1.999, 3.998, 7.995, 15.99 g"),
        ({}, BUFFERED.replace("specific_force", "angular_rate"), r"has no in_anglvel_x, .*; it has specific_force"),
        ({}, BUFFERED + 'trigger = "t0"\n', r"trigger 't0': this device samples by itself"),
        ({"trigger/current_trigger": ""}, BUFFERED, r"no trigger starts its samples; give trigger"),
        ({"in_accel_scale": "0"}, ACC, r"in_accel_scale is 0; a positive number is required"),
        ({"in_accel_scale": "-1"}, ACC, r"in_accel_scale is -1; a positive number is required"),
        ({"in_accel_scale": "nan"}, ACC, r"in_accel_scale is 'nan': a finite number is required"),
        ({"in_accel_scale": "\x1b[2J" + "9" * 9000}, ACC, r"a finite number is required"),
        ({"in_accel_scale_available": "1e999 2"}, ACC + "range = 4\n", r"a finite number is required"),
        ({"in_accel_offset": "1e30"}, ACC, r"in_accel_offset is 1e.30; counts of a log are below 2.31"),
        ({"in_accel_offset": "2e9"}, ACC, r"counts of 32 bits; a log holds at most 31"),
        ({"mount_matrix": "0.6, 0.8, 0; -0.8, 0.6, 0; 0, 0, 1"}, ACC, r"not a rotation by quarter turns; give axes"),
        ({"mount_matrix": "1, 0, 0; 0, 1, 0; 0, 0, -1"}, ACC, r"not a rotation by quarter turns"),
        ({"mount_matrix": "1;2"}, ACC, r"not a rotation by quarter turns"),
        ({"scan_elements/in_accel_y_type": "le:s16/24>>0"}, BUFFERED, r"in_accel_y_type is 'le:s16/24>>0': allowed is"),
        ({"scan_elements/in_accel_y_index": "0"}, BUFFERED, r"in_accel_x_index and in_accel_y_index are both 0"),
        ({"scan_elements/in_accel_x_type": "le:s64/64>>0"}, BUFFERED, r"counts of 64 bits; a log holds at most 31"),
    ],
)
def test_a_configuration_that_the_device_cannot_meet_is_refused(
    machine: KernelMachine, changes: Any, keys: str, message: str
) -> None:
    machine.add("kx023", "i2c-1/1-001e", {**ACCEL, **changes})
    with pytest.raises(SensorError, match=message) as raised:
        connected(machine, array_of(sensor("A", keys)))
    text = str(raised.value)
    assert text.startswith(("A (kx02", "iio:"))
    assert "\n" not in text
    assert "\x1b" not in text


@pytest.mark.parametrize(
    ("chip", "quantity", "scale", "sensitivity"),
    [
        ("l3g4200d", "angular_rate", "0.000305", 1 / 0.0175),  # as Linux prints it; L3G-41
        ("l3g4200d", "angular_rate", "0.000306", 1 / 0.0175),
        ("l3g4200d", "angular_rate", "0.000310", np.radians(1) / 0.00031),
        ("mpu6050", "specific_force", "0.001196", 8192.0),  # INV-40
        ("other", "angular_rate", "0.000305", np.radians(1) / 0.000305),
    ],
)
def test_a_rounded_scale_is_replaced_by_that_of_the_data_sheet(
    machine: KernelMachine, chip: str, quantity: str, scale: str, sensitivity: float
) -> None:
    kind = {"angular_rate": "in_anglvel", "specific_force": "in_accel"}[quantity]
    machine.add("dev", "i2c-1/1-0069", {f"{kind}_scale": scale, **{f"{kind}_{axis}_raw": "1" for axis in "xyz"}})
    keys = f'chip = "{chip}"\nquantity = "{quantity}"\nbus = "iio:dev"\nrate_hz = 100\n'
    with IioBus(machine.root, clock=SteppedClock()) as bus:
        (route,) = connect(array_of(sensor("A", keys)), bus)
        assert route.header.sensitivity == pytest.approx(sensitivity, rel=1e-12)


def test_a_device_with_two_axes_is_refused(machine: KernelMachine) -> None:
    machine.add("kx023", "i2c-1/1-001e", {name: text for name, text in ACCEL.items() if "accel_z" not in name})
    with pytest.raises(SensorError, match="has no in_accel_z; it has specific_force"):
        connected(machine, array_of(sensor("A", BUFFERED)))


def test_a_trigger_and_its_rate_are_set(machine: KernelMachine) -> None:
    """The chip's own rate is then the slowest that is not below it."""
    device = machine.add("kx023", "i2c-1/1-001e", {**ACCEL, "trigger/current_trigger": ""})
    for number, name in enumerate(("sysfstrig1", "hr0")):
        folder = machine.root / f"sys/bus/iio/devices/trigger{number}"
        folder.mkdir()
        (folder / "name").write_text(f"{name}\n")
    (folder / "sampling_frequency").write_text("100\n")
    keys = BUFFERED.replace("rate_hz = 50", "rate_hz = 62.5")
    with pytest.raises(SensorError, match=r"trigger 'hr1': allowed are sysfstrig1, hr0$"):
        connected(machine, array_of(sensor("A", keys + 'trigger = "hr1"\n')))
    with pytest.raises(SensorError, match=r"give trigger, one of sysfstrig1, hr0, or leave out fifo"):
        connected(machine, array_of(sensor("A", BUFFERED)))
    connected(machine, array_of(sensor("A", keys + 'trigger = "hr0"\n')))
    assert device.read("trigger/current_trigger") == "hr0"
    assert device.read("sampling_frequency") == "100"
    assert (folder / "sampling_frequency").read_text() == "62.5"


def test_axes_of_different_scales_are_refused(machine: KernelMachine) -> None:
    scales = {f"in_accel_{axis}_scale": text for axis, text in zip("xyz", ("0.1", "0.1", "0.2"), strict=True)}
    machine.add("kx023", "i2c-1/1-001e", {**{k: v for k, v in ACCEL.items() if "_scale" not in k}, **scales})
    with pytest.raises(SensorError, match=r"in_accel_scale of x, y, z is 0.1, 0.1, 0.2; a log has one"):
        connected(machine, array_of(sensor("A", ACC)))


def test_two_devices_of_one_name_are_distinguished_by_their_place(machine: KernelMachine) -> None:
    for address in ("1-001e", "1-001f"):
        machine.add("kx023", f"i2c-1/{address}", ACCEL)
    with pytest.raises(SensorError, match="2 devices have this name; allowed are iio:kx023@1-001e, iio:kx023@1-001f"):
        connected(machine, array_of(sensor("A", ACC)))
    connected(machine, array_of(sensor("A", ACC.replace("iio:kx023", "iio:kx023@1-001f"))))
    connected(machine, array_of(sensor("A", ACC.replace("iio:kx023", "iio:device1"))))


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (
            errno.EBUSY,
            r"A \(kx023\) at iio:kx023: .*/dev/iio:device0: Device or resource busy; another program captures",
        ),
        (errno.EACCES, r"A \(kx023\) at iio:kx023: .*/dev/iio:device0: Permission denied; give your group"),
    ],
)
def test_a_buffer_that_cannot_be_opened_is_named(
    machine: KernelMachine, monkeypatch: pytest.MonkeyPatch, number: int, message: str
) -> None:
    machine.add("kx023", "i2c-1/1-001e", ACCEL)
    opened = os.open

    def refuse(path: Any, *words: Any, **more: Any) -> int:
        if "/dev/iio:" in str(path):
            raise OSError(number, os.strerror(number), str(path))
        return opened(path, *words, **more)

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(SensorError, match=message):
        connected(machine, array_of(sensor("A", BUFFERED)))


def test_a_tree_without_sysfs_or_devices_is_refused(tmp_path: Path) -> None:
    array = array_of(sensor("A", ACC))
    with pytest.raises(BusUrlError, match="it contains no folder sys"):
        open_bus(f"iio:{tmp_path}", array)
    (tmp_path / "sys").mkdir()
    with (
        open_bus(f"iio:{tmp_path}", array) as bus,
        pytest.raises(SensorError, match="there is no device in /sys/bus/iio/devices; load the kernel module"),
    ):
        connect(array, bus)
    with open_bus("spi:", array) as bus, pytest.raises(BusUrlError, match="A: iio:kx023 is served by the kernel"):
        connect(array, bus)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (ACC + "address = 0x1e\n", "address: the kernel's driver has it"),
        (ACC.replace("rate_hz = 50", ""), "rate_hz is missing"),
        (
            ACC.replace('quantity = "specific_force"', ""),
            "quantity is missing: allowed are specific_force, angular_rate",
        ),
        (ACC.replace("kx023", "bmp280", 1), "read for triads only"),
        (ACC.replace("kx023", "lsm6dso_gyro", 1), "quantity 'specific_force': the lsm6dso_gyro measures angular_rate"),
        (ACC.replace("iio:kx023", "iio:../x"), 'allowed are "iio:NAME" and "iio:NAME@PLACE"'),
        (ACC + 'trigger = "t"\n', "trigger: only with fifo = true"),
        (ACC + "range = -1\n", "range -1: a positive number"),
        (
            'chip = "bma180"\naddress = 0x40\nrange = 2\ntrigger = "t"\n',
            "trigger: only for a sensor that the kernel serves",
        ),
    ],
)
def test_invalid_configurations_are_refused(keys: str, message: str) -> None:
    with pytest.raises(ConfigError) as raised:
        array_of(sensor("A", keys))
    assert message in str(raised.value)


def test_sensors_of_one_device_must_have_the_same_rate() -> None:
    with pytest.raises(ConfigError, match=r"'Acc' and 'Gyro' are both of iio:imu@spi0.0: rate_hz is the same for both"):
        array_of(sensor("Acc", IMU_ACC), sensor("Gyro", IMU_GYRO.replace("50", "100")))
    with pytest.raises(ConfigError, match=r"2 sensors are the specific_force of iio:imu@spi0.0"):
        array_of(sensor("Acc", IMU_ACC), sensor("Acc2", IMU_ACC))


def test_the_quantity_selects_the_half_of_a_die() -> None:
    array = array_of(sensor("G", 'chip = "mpu6050"\nquantity = "angular_rate"\nbus = "iio:mpu6050"\nrate_hz = 50\n'))
    assert array["G"].chip == "mpu6050_gyro"
    assert array["G"].spec.unit == "dps"


def test_detect_lists_the_devices_of_the_kernel(machine: KernelMachine, capsys: pytest.CaptureFixture[str]) -> None:
    machine.add("kx023", "i2c-1/1-001e", ACCEL)
    array = array_of(sensor("A", ACC), sensor("B", ACC.replace("iio:kx023", "iio:gone")))
    with IioBus(machine.root) as bus:
        lines = {line.sensor: line for line in detect(array, bus)}
    assert lines["A"].ok
    assert not lines["B"].ok
    assert "allowed are iio:kx023@1-001e" in lines["B"].found


def test_detect_without_a_configuration_lists_what_the_kernel_serves(machine: KernelMachine) -> None:
    machine.add("kx023", "i2c-1/1-001e", ACCEL)
    machine.add("imu", "spi0/spi0.0", IMU)
    machine.add("bmp280", "i2c-1/1-0076", {"in_pressure_input": "101.3"})
    with IioBus(machine.root) as bus:
        lines = [(line.place, line.found) for line in explore(bus)]
    assert lines == [
        ("iio:bmp280@1-0076", "read: no triad"),
        ("iio:imu@spi0.0", "captured or read: specific_force, angular_rate"),
        ("iio:kx023@1-001e", "captured or read: specific_force"),
    ]


def test_detect_writes_a_configuration_that_logs(machine: KernelMachine, capsys: pytest.CaptureFixture[str]) -> None:
    machine.add("imu", "spi0/spi0.0", {**IMU, "sampling_frequency": "62.5"})
    machine.add("mag", "i2c-1/1-001e", {**{f"in_magn_{axis}_raw": "3" for axis in "xyz"}, "in_magn_scale": "0.001"})
    path, url = machine.root / "found.toml", f"iio:{machine.root}"
    assert main(["detect", "--bus", url, "-o", str(path)]) == 0
    sensors = {sensor.name: sensor for sensor in load_array(path).sensors}
    assert {name: (sensor.bus, sensor.spec.quantity, sensor.rate_hz) for name, sensor in sensors.items()} == {
        "IIO1_acc": ("iio:imu@spi0.0", "specific_force", 62.5),
        "IIO1_gyro": ("iio:imu@spi0.0", "angular_rate", 62.5),
        "IIO2_mag": ("iio:mag@1-001e", "magnetic_field", 50.0),
    }
    assert main(["detect", str(path)]) == 0
    assert main(["simulate", str(path), "--experiment", "static", "-o", str(machine.root / "s.h5")]) == 2
    assert (
        "IIO1_acc: only the kernel knows the scale of its counts; record it and use --like" in capsys.readouterr().err
    )
    for device in machine.root.glob("sys/bus/iio/devices/iio:device*"):
        device.unlink()
    assert main(["detect", "--bus", url, "-o", str(machine.root / "none.toml")]) == 2
    assert "the kernel serves no accelerometer, gyroscope or magnetometer" in capsys.readouterr().err


def test_the_doctor_checks_the_device_and_its_file(machine: KernelMachine) -> None:
    device = machine.add("kx023", "i2c-1/1-001e", ACCEL)
    device.file.chmod(0o600)
    owner = Machine(root=machine.root, user=device.file.stat().st_uid, groups=frozenset())
    stranger = Machine(root=machine.root, user=12345, groups=frozenset({54321}))
    for who, allowed in ((owner, True), (stranger, False)):
        checks = examine(array_of(sensor("A", BUFFERED)), "iio:", machine.root, 50.0, machine=who)
        device_check, file_check = checks[:2]
        assert (device_check.name, device_check.ok) == ("device", True)
        assert device_check.found == "iio:kx023: kx023 at 1-001e"
        assert (file_check.name, file_check.ok) == ("permission", allowed)
        assert file_check.found.startswith("/dev/iio:device0: ")
    assert 'KERNEL=="iio:device*", GROUP="iio"' in file_check.advice
    gone = examine(array_of(sensor("A", ACC.replace("iio:kx023", "iio:x"))), "iio:", machine.root, 50.0, machine=owner)
    assert not gone[0].ok
    assert "detect --bus iio:" in gone[0].advice


def test_the_command_logs_a_device(machine: KernelMachine, tmp_path: Path) -> None:
    machine.add("kx023", "i2c-1/1-001e", ACCEL)
    config = tmp_path / "array.toml"
    config.write_text('[array]\nname = "a"\n' + sensor("A", ACC))
    words = ["log", str(config), "--bus", f"iio:{tmp_path}", "--seconds", "0.1", "--rate-hz", "100"]
    assert main([*words, "-o", str(tmp_path / "run.h5")]) == 0
    with open_log(tmp_path / "run.h5") as log:
        assert log["A"].counts[0].tolist() == [1, -2, 16384]

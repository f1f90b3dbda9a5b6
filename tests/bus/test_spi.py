"""SPI: the first byte of each chip, spidev's system calls, configuration, and every chip read over it as over I2C."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_array
from firmware_emulator.device_file import replace_everywhere, with_address
from imuarray.acquire import connect
from imuarray.acquire.detection import detect
from imuarray.acquire.doctor import Machine, examine
from imuarray.array import load_array, parse_array
from imuarray.bus import open_bus
from imuarray.bus.spi import LinuxSpiPort, SpiChip, SpiTransfer
from imuarray.chips import CHIPS
from imuarray.cli import main
from imuarray.errors import BusUrlError, ConfigError, SensorError
from imuarray.log import open_log

CONFIGS = Path(__file__).parents[2] / "configs"
IDENTITIES = {  # by chip: request of its identity, and the answer: ADX-10, BMA-10, L3G-10, INV-70, TDK-02, LSM-02
    "adxl345": ("8000", "ffe5"),
    "bma180": ("8000", "ff03"),
    "l3g4200d": ("8f00", "ffd3"),
    "mpu6500_acc": ("f500", "ff70"),
    "mpu9250_gyro": ("f500", "ff71"),
    "icm42688_acc": ("f500", "ff47"),
    "lsm6dso_gyro": ("8f00", "ff6c"),
}
TRIADS = {  # the first byte of a read of the triad, X first: bit 7 reads, bit 6 counts on where a chip needs it
    "adxl345": 0x80 | 0x40 | 0x32,
    "bma180": 0x80 | 0x02,
    "l3g4200d": 0x80 | 0x40 | 0x28,
    "mpu6500_acc": 0x80 | 0x3B,
    "mpu9250_gyro": 0x80 | 0x43,
    "icm42688_acc": 0x80 | 0x1F,
    "lsm6dso_gyro": 0x80 | 0x22,
}
RANGES = {"adxl345": 16, "bma180": 4, "l3g4200d": 500}


def text(chip: str, keys: str = "") -> str:
    full_scale = RANGES.get(chip, 4 if chip.endswith("_acc") else 500)
    return (
        f'[array]\nname = "a"\nbus = "spi:"\n[[sensor]]\nname = "A"\nchip = "{chip}"\nbus = "/dev/spidev0.0"\n'
        f"range = {full_scale}\n{keys}"
    )


class Scripted:
    """A chip select that records the bytes sent."""

    def __init__(self, answer: str) -> None:
        self.sent: list[str] = []
        self._answer = bytes.fromhex(answer)

    def exchange(self, sent: bytes) -> bytes:
        self.sent.append(sent.hex())
        return (self._answer + bytes(len(sent)))[: len(sent)]


@pytest.mark.parametrize("chip", IDENTITIES)
def test_the_first_byte_is_that_of_the_data_sheet(chip: str) -> None:
    sent, answer = IDENTITIES[chip]
    port = Scripted(answer)
    spec = CHIPS[chip]
    assert spec.spi is not None
    bus = SpiChip(port, spec.spi)
    assert bus.transfer(0, bytes([spec.identity.address]), 1) == bytes.fromhex(answer)[1:]
    assert port.sent == [sent]
    bits = 0x3F if chip in ("adxl345", "l3g4200d") else 0x7F
    first = {"l3g4200d": 0x80}.get(chip, 0) | TRIADS[chip] & bits  # on I2C bit 7 counts on: L3G-03
    bus.transfer(0, bytes([first]), 6)
    assert int(port.sent[-1][:2], 16) == TRIADS[chip]
    bus.transfer(0, bytes([first, 0x12]))
    assert port.sent[-1] == f"{first & bits:02x}12"


@pytest.mark.parametrize("chip", IDENTITIES)
def test_an_emulated_chip_answers_the_bytes_of_the_data_sheet(chip: str) -> None:
    sent, answer = IDENTITIES[chip]
    with open_array(parse_array(text(chip))) as bus:
        port = bus.spi_port("/dev/spidev0.0", 3, 1_000_000)
        assert port.exchange(bytes.fromhex(sent)).hex() == answer


@pytest.mark.parametrize("chip", IDENTITIES)
def test_the_same_driver_reads_the_same_over_both(chip: str) -> None:
    over_spi = parse_array(text(chip))
    address = CHIPS[chip].addresses[0]
    over_i2c = parse_array(text(chip).replace('bus = "/dev/spidev0.0"', f"address = {address:#x}"))
    means = []
    for array in (over_spi, over_i2c):
        with open_array(array, seed=3) as bus:
            (route,) = connect(array, bus)
            counts = []
            for _ in range(50):
                bus.clock.sleep_until(bus.clock.now_ns() + 20_000_000)
                burst = np.frombuffer(route.driver.fetch(), np.uint8).reshape(1, -1)
                counts.append(route.driver.decode(burst).counts[0])
            means.append(np.mean(counts, axis=0) / array.sensors[0].sensitivity)
    tolerance = 0.02 if "g" in CHIPS[chip].unit and CHIPS[chip].unit == "g" else 0.5
    assert means[0] == pytest.approx(means[1], abs=tolerance)


def test_without_the_multiple_byte_bit_a_chip_repeats_one_register() -> None:
    """ADX-80: MB. DATA_FORMAT is 0x31; the triad follows it."""
    with open_array(parse_array(text("adxl345"))) as bus:
        port = bus.spi_port("/dev/spidev0.0", 3, 5_000_000)
        assert port.exchange(b"\x80\x00\x00\x00") == b"\xff\xe5\xe5\xe5"
        assert port.exchange(b"\xc0\x00\x00\x00")[1:] == b"\xe5\x00\x00"


def test_a_transfer_takes_the_clocks_of_its_bytes() -> None:
    """A byte is eight clocks: at 24 MHz 17 of them last 5.667 us, and 0.2 us are around them."""
    with open_array(parse_array(text("icm42688_acc"))) as bus:
        port = bus.spi_port("/dev/spidev0.0", 0, 24_000_000)
        begun_ns = bus.clock.now_ns()
        port.exchange(bytes([0x80 | 0x1D]) + bytes(16))
        select = bus.selects["/dev/spidev0.0"]
        assert (select.clocks, select.transfers) == (136, 1)
        assert bus.clock.now_ns() - begun_ns == 5667 + 200


@pytest.mark.parametrize(("mode", "clock_hz"), [(3, 6_000_000), (0, 1_000_000)])
def test_too_fast_a_clock_or_another_mode_gives_another_identity(mode: int, clock_hz: int) -> None:
    with open_array(parse_array(text("adxl345"))) as bus:
        assert bus.spi_port("/dev/spidev0.0", mode, clock_hz).exchange(b"\x80\x00") != b"\xff\xe5"


@pytest.mark.parametrize(
    ("chip", "register", "bits", "value"),
    [("icm42688_acc", 0x4C, 0x03, 0x03), ("lsm6dso_acc", 0x13, 0x04, 0x04), ("mpu6500_acc", 0x6A, 0x10, 0x10)],
)
def test_i2c_is_disabled_only_on_spi(chip: str, register: int, bits: int, value: int) -> None:
    """TDK-71, LSM-71, INV-96."""
    address = CHIPS[chip].addresses[0]
    on_i2c = text(chip).replace('bus = "/dev/spidev0.0"', f"address = {address:#x}")
    for words, expected in ((text(chip), value), (on_i2c, 0)):
        array = parse_array(words)
        with open_array(array) as bus:
            connect(array, bus)
            assert bus.chips["A"].page[register] & bits == expected


@pytest.mark.parametrize(
    ("chip", "keys", "message"),
    [
        ("adxl345", "address = 0x53\n", "a chip on SPI has none, leave it out"),
        ("adxl345", "spi_clock_hz = 6000000\n", "spi_clock_hz 6000000: the adxl345 supports up to 5000000"),
        ("mpu6050_acc", "", "the mpu6050_acc has no SPI that is supported; allowed for adxl345"),
        ("icm42688_acc", "spi_clock_hz = 0\n", "allowed is 1 or more"),
    ],
)
def test_invalid_configurations_are_refused(chip: str, keys: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_array(text(chip, keys))


def test_a_clock_is_only_for_spi_and_an_address_only_for_i2c() -> None:
    words = text("adxl345", "spi_clock_hz = 1000000\n").replace('bus = "/dev/spidev0.0"', "address = 0x53")
    with pytest.raises(ConfigError, match="spi_clock_hz: only for a sensor on SPI"):
        parse_array(words)
    with pytest.raises(ConfigError, match="address is missing"):
        parse_array(text("adxl345").replace('bus = "/dev/spidev0.0"', ""))


def test_two_chips_on_one_chip_select_are_refused() -> None:
    second = text("lsm6dso_acc").partition("[[sensor]]")[2].replace('"A"', '"B"')
    with pytest.raises(ConfigError, match=r"'A' and 'B' are both at /dev/spidev0.0"):
        parse_array(text("icm42688_acc") + "[[sensor]]" + second)


def test_a_missing_chip_is_reported() -> None:
    array = parse_array(text("icm42688_acc"))
    with open_array(array) as bus:
        bus.selects["/dev/spidev0.0"].device = _SilentChip()
        with pytest.raises(SensorError, match=r"at /dev/spidev0.0: identity ff, .*no chip drives.*, expected 47"):
            connect(array, bus)
        (line,) = detect(array, bus)
        assert not line.ok
        assert line.place == "/dev/spidev0.0"


class _SilentChip:
    address = 0

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        return 0

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        return b""

    def stop(self, at_ns: int) -> None:
        pass


@pytest.mark.slow
def test_eight_chips_are_recorded_and_replayed(tmp_path: Path) -> None:
    config, transcript = str(CONFIGS / "icm42688x8.toml"), tmp_path / "t.jsonl"
    first, second = tmp_path / "a.h5", tmp_path / "b.h5"
    words = ["log", config, "--seconds", "0.2", "--rate-hz", "100"]
    assert main([*words, "--bus", "emulated:", "-o", str(first), "--transcript", str(transcript)]) == 0
    assert main([*words, "--bus", f"replay:{transcript}", "-o", str(second)]) == 0
    with open_log(first) as log, open_log(second) as again:
        assert len(log.sensors) == 16
        for name, sensor in log.sensors.items():
            assert np.array_equal(sensor.counts[:], again[name].counts[:])
            assert not np.asarray(sensor.status[:]).any()


# spidev ---------------------------------------------------------------------------------------------------------------


class Spidev:
    """The system calls of one chip select, on a real file; `calls` contains the settings."""

    def __init__(self, port: Any) -> None:
        self.port = port
        self.calls: list[tuple[int, int]] = []
        self.refused = 0
        self.error = 0

    def ioctl(self, request: int, at: int) -> int:
        if request == self.refused:
            raise OSError(self.error, os.strerror(self.error))
        if request == 0x40206B00:  # SPI_IOC_MESSAGE(1)
            message = SpiTransfer.from_address(at)
            sent = ctypes.string_at(message.tx_buf, message.len)
            ctypes.memmove(message.rx_buf, self.port.exchange(sent), message.len)
            return int(message.len)
        size = request >> 16 & 0x3FFF
        self.calls.append((request, int.from_bytes(ctypes.string_at(at, size), "little")))
        return 0


@pytest.fixture
def spidev(tmp_path: Path) -> Iterator[tuple[str, Spidev]]:
    """The path of a chip select with an emulated ICM-42688-P, and its device."""
    path = tmp_path / "spidev0.0"
    path.touch()
    with open_array(parse_array(text("icm42688_acc"))) as bus:
        device = Spidev(bus.spi_port("/dev/spidev0.0", 3, 24_000_000))
        real = fcntl.ioctl

        def ioctl(fd: int, request: int, argument: Any = 0, mutate: bool = True, /) -> Any:
            if os.fstat(fd).st_ino != path.stat().st_ino:
                return real(fd, request, argument, mutate)
            return with_address(argument, lambda at: device.ioctl(request, at))

        replace_everywhere("ioctl", real, ioctl)
        try:
            yield str(path), device
        finally:
            replace_everywhere("ioctl", ioctl, real)


def test_the_structure_has_the_size_of_the_kernels() -> None:
    """LNX-51: 32 bytes, the size encoded in the number of the call."""
    assert ctypes.sizeof(SpiTransfer) == 32 == 0x40206B00 >> 16 & 0x3FFF


def test_spidev_is_set_up_and_exchanges_bytes(spidev: tuple[str, Spidev]) -> None:
    path, device = spidev
    port = LinuxSpiPort(path, 3, 8_000_000)
    assert device.calls == [(0x40016B01, 3), (0x40016B03, 8), (0x40046B04, 8_000_000)]
    assert port.exchange(b"\xf5\x00") == b"\xff\x47"
    assert port.exchange(b"\xf5\x00\x00") == b"\xff\x47\x00"
    with pytest.raises(BusUrlError, match="another program has locked this chip select"):
        LinuxSpiPort(path, 3, 8_000_000)
    with pytest.raises(ValueError, match="at most 4096"):
        port.exchange(bytes(5000))
    device.refused, device.error = 0x40206B00, errno.EIO
    with pytest.raises(OSError, match="Input/output") as failed:
        port.exchange(b"\xf5\x00")
    assert failed.value.errno == errno.EIO
    port.close()


def test_a_clock_that_the_controller_refuses_is_an_error_of_one_line(spidev: tuple[str, Spidev]) -> None:
    path, device = spidev
    device.refused, device.error = 0x40046B04, errno.EINVAL
    with pytest.raises(BusUrlError, match="refuses mode 3 or a clock of 99 Hz: Invalid argument"):
        LinuxSpiPort(path, 3, 99)


def test_a_missing_device_is_an_error_of_one_line() -> None:
    with pytest.raises(BusUrlError, match=r"No such file.*enable SPI, join group spi"):
        LinuxSpiPort("/dev/spidev99.9", 3, 1_000_000)
    array = load_array(CONFIGS / "icm42688x8.toml")
    with pytest.raises(BusUrlError, match='use "spi:" alone'):
        open_bus("spi:/dev/spidev0.0", array)
    with open_bus("spi:", array) as bus:
        assert bus.source == "spi"
        with pytest.raises(OSError, match="no I2C bus"):
            bus.transfer(0x68)


def test_the_doctor_checks_chip_selects(tmp_path: Path) -> None:
    array = load_array(CONFIGS / "icm42688x8.toml")
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev" / "spidev0.0").touch()
    checks = examine(array, "spi:", tmp_path, 100.0, machine=Machine(root=tmp_path))
    selects = [check for check in checks if check.name == "chip select"]
    assert [check.ok for check in selects] == [True] + [False] * 7
    assert "/dev/spidev0.1; there are /dev/spidev0.0" in selects[1].found
    assert "dtparam=spi=on" in selects[1].advice

"""The bus of Linux against an emulated adapter: messages that are sent, locks, refusals, and whole logs."""

from __future__ import annotations

import errno
import gc
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.device_file import Adapter, Message, device_files
from imuarray.acquire.bus_segment import connect
from imuarray.acquire.recorder import record
from imuarray.array import ArrayConfig, parse_array
from imuarray.bus import open_bus
from imuarray.bus.linux import LinuxBus
from imuarray.bus.transcript import RecordingBus
from imuarray.errors import BusUrlError, SensorError
from imuarray.log import open_log
from tests.selection import some

ROOT, LEFT, RIGHT = "/dev/i2c-1", "/dev/i2c-11", "/dev/i2c-12"
ADXL = 'chip="adxl345"\nrange=2\nrate_hz=100\n'
BMA = 'chip="bma180"\nrange=2\nbandwidth_hz=40\n'
ON_TRUNK = f'[array]\nname="a"\n[[sensor]]\nname="A"\naddress=0x53\n{ADXL}'
BEHIND_KERNEL_MUX = f"""[array]
name = "a"
[[sensor]]
name = "A"
address = 0x53
bus = "{LEFT}"
{ADXL}
[[sensor]]
name = "B"
address = 0x53
bus = "{RIGHT}"
axes = "-X-Y+Z"
{ADXL}
[[sensor]]
name = "C"
address = 0x40
bus = "{RIGHT}"
{BMA}
"""
BEHIND_OUR_MUX = (
    BEHIND_KERNEL_MUX.replace('name = "a"', 'name = "a"\nmux = { chip = "pca9544a", address = 0x70 }')
    .replace(f'bus = "{LEFT}"', "channel = 0")
    .replace(f'bus = "{RIGHT}"', "channel = 3")
)


@pytest.fixture
def served() -> Iterator[Any]:
    """A function that serves the wires of an emulated array as this machine's adapters until the test ends."""
    with ExitStack() as stack:

        def serve(board: EmulatedBus, kind: str = "bcm2835", **settings: Any) -> dict[str, Adapter]:
            adapters = {path or ROOT: Adapter(wire, kind, **settings) for path, wire in board.wires.items()}
            stack.enter_context(device_files(adapters))
            return adapters

        yield serve


def board_of(text: str, **settings: Any) -> tuple[EmulatedBus, ArrayConfig]:
    array = parse_array(text)
    return open_array(array, **settings), array


class Counting(Adapter):
    """An adapter that remembers how many messages each transfer had."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.asked: list[int] = []

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        self.asked.append(len(messages))
        return super().transfer(messages)


def refused(path: str = ROOT) -> str:
    with pytest.raises(BusUrlError) as error:
        LinuxBus(path)
    assert "\n" not in str(error.value)
    return str(error.value)


class TestOpening:
    def test_a_hung_bus_costs_30_ms_a_transaction(self, served: Any) -> None:
        board, _ = board_of(BEHIND_KERNEL_MUX)
        adapters = served(board)
        with LinuxBus(ROOT) as bus:
            channel = bus.channel_bus(LEFT)
            for path, talk in ((ROOT, bus), (LEFT, channel)):
                adapters[path].stuck = True
                before_ns = board.clock.now_ns()
                with pytest.raises(TimeoutError) as error:
                    talk.transfer(0x53, b"\x00", 1)
                assert error.value.errno == errno.ETIMEDOUT
                assert board.clock.now_ns() - before_ns == 30_000_000
            adapters[LEFT].stuck = False
            assert channel.transfer(0x53, b"\x00", 1) == b"\xe5"

    def test_the_timeout_is_a_parameter(self, served: Any) -> None:
        adapters = served(board_of(ON_TRUNK)[0])
        for timeout_s, expected_ns in ((0.2, 200_000_000), (0.001, 10_000_000)):  # never 0
            with LinuxBus(ROOT, timeout_s=timeout_s):
                assert adapters[ROOT].timeout_ns == expected_ns

    def test_a_second_program_is_refused(self, served: Any) -> None:
        served(board_of(ON_TRUNK)[0])
        with LinuxBus(ROOT):
            assert refused().startswith("i2c:/dev/i2c-1: another program has locked this bus")
            assert "another program" in refused()  # and asking did not break the lock
        with LinuxBus(ROOT) as bus:
            assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"

    def test_a_channel_that_another_program_has_locked_is_refused(self, served: Any) -> None:
        served(board_of(BEHIND_KERNEL_MUX)[0])
        with LinuxBus(LEFT), LinuxBus(ROOT) as bus, pytest.raises(BusUrlError, match=r"^i2c:/dev/i2c-11: another"):
            bus.channel_bus(LEFT)

    def test_an_adapter_of_smbus_alone_is_refused(self, served: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        served(board_of(ON_TRUNK)[0])
        monkeypatch.setattr(Adapter, "functionality", 0x0EFF0000)  # as i2c-stub: LNX-18
        assert refused() == "i2c:/dev/i2c-1: this adapter speaks SMBus only, plain I2C messages are needed"

    def test_a_refusal_closes_the_device(self) -> None:
        before = len(list(Path("/proc/self/fd").iterdir()))
        assert refused("/dev/null").startswith("i2c:/dev/null: Inappropriate ioctl for device")
        assert len(list(Path("/proc/self/fd").iterdir())) == before


class TestTransfer:
    def test_a_transfer_has_at_most_one_read_message_at_its_end(self, served: Any) -> None:
        board, _ = board_of(ON_TRUNK)
        served(board, "bcm2835")  # refuses everything else: LNX-10
        with LinuxBus(ROOT) as bus:
            assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"
            assert bus.transfer(0x53, b"\x1e\x11\x22\x33") == b""
            assert bus.transfer(0x53, b"\x1e", 3) == b"\x11\x22\x33"
            assert bus.transfer(0x53) == b""
        assert board.wire.transactions == 4

    @given(
        st.lists(st.tuples(st.sampled_from([0x53, 0x1D, 0x40]), st.binary(max_size=3), st.integers(0, 40)), max_size=30)
    )
    def test_reused_structures_give_the_same_results(self, requests: list[tuple[int, bytes, int]]) -> None:
        # The same traffic on two equal boards, one of them reached through structures, each transaction twice.
        (direct, _), (behind, _) = board_of(ON_TRUNK), board_of(ON_TRUNK)
        with device_files({ROOT: Adapter(behind.wire)}), LinuxBus(ROOT) as bus:
            for request in requests * 2:
                assert outcome(bus, request) == outcome(direct, request)

    @pytest.mark.slow
    def test_more_transactions_than_the_cache_holds_are_correct(self, served: Any) -> None:
        board, _ = board_of(ON_TRUNK)
        served(board)
        with LinuxBus(ROOT) as bus:
            before = structures()
            for value in range(2000):
                low, high = value & 0xFF, value >> 8
                bus.transfer(0x53, bytes([0x1E, low, high]))
                assert bus.transfer(0x53, b"\x1e", 2) == bytes([low, high])
            assert 100 < structures() - before <= 256

    def test_messages_that_no_adapter_can_send_are_refused(self, served: Any) -> None:
        served(board_of(ON_TRUNK)[0])
        with LinuxBus(ROOT) as bus:
            with pytest.raises(ValueError, match=r"0x53: 8193 bytes, a message carries at most 8192"):
                bus.transfer(0x53, b"\x00", 8193)
            with pytest.raises(ValueError, match=r"0x80: addresses have seven bits"):
                bus.transfer(0x80)


def outcome(bus: Any, request: tuple[int, bytes, int]) -> bytes | int | None:
    try:
        answer: bytes = bus.transfer(*request)
        return answer
    except OSError as error:
        return error.errno


def structures() -> int:
    """The number of cached transactions."""
    gc.collect()
    return sum(type(thing).__name__ == "i2c_rdwr_ioctl_data" for thing in gc.get_objects())


class TestClaim:
    def devices(self, folder: Path, *owned: tuple[str, str]) -> Path:
        """A folder like /sys/bus/i2c/devices."""
        for place, driver in owned:
            (folder / "drivers" / driver).mkdir(parents=True, exist_ok=True)
            (folder / place).mkdir()
            (folder / place / "driver").symlink_to(folder / "drivers" / driver)
        return folder

    def test_a_claim_names_the_driver_that_owns_the_address(self, served: Any, tmp_path: Path) -> None:
        board, _ = board_of(ON_TRUNK)
        served(board, owned={0x53: "adxl345_i2c", 0x70: "pca954x"})
        devices = self.devices(tmp_path, ("1-0053", "adxl345_i2c"))
        with LinuxBus(ROOT, devices=devices) as bus:
            with pytest.raises(SensorError, match=r"^/dev/i2c-1: address 0x53 belongs to the kernel's driver 'adxl345"):
                bus.claim(0x53)
            with pytest.raises(SensorError, match="address 0x70 belongs to a driver of the kernel"):
                bus.claim(0x70)
            bus.claim(0x1D)
        assert board.wire.transactions == 0

    def test_a_claim_on_a_channel_checks_that_channel(self, served: Any, tmp_path: Path) -> None:
        board, _ = board_of(BEHIND_KERNEL_MUX)
        adapters = served(board)
        adapters[RIGHT].owned[0x40] = "bma180"
        with LinuxBus(ROOT, devices=self.devices(tmp_path, ("12-0040", "bma180"))) as bus:
            bus.claim(0x40)
            bus.claim(0x40, LEFT)
            with pytest.raises(
                SensorError, match=r"^/dev/i2c-12: address 0x40 belongs to the kernel's driver 'bma180'"
            ):
                bus.claim(0x40, RIGHT)

    @pytest.mark.parametrize(
        ("text", "path", "address", "message"),
        [
            (ON_TRUNK, ROOT, 0x53, r"^A \(adxl345\): /dev/i2c-1: address 0x53 belongs to"),
            (BEHIND_OUR_MUX, ROOT, 0x70, r"^/dev/i2c-1: address 0x70 belongs to .* leave out mux"),
            (BEHIND_OUR_MUX, ROOT, 0x40, r"^C \(bma180\): /dev/i2c-1: address 0x40"),
            (BEHIND_KERNEL_MUX, RIGHT, 0x53, r"^B \(adxl345\): /dev/i2c-12: address 0x53"),
        ],
    )
    @pytest.mark.parametrize("recorded", [False, True])
    def test_acquisition_refuses_before_it_sends_anything(
        self, served: Any, tmp_path: Path, text: str, path: str, address: int, message: str, recorded: bool
    ) -> None:
        board, array = board_of(text)
        served(board)[path].owned[address] = "somebody"
        bus: Any = LinuxBus(ROOT)
        if recorded:
            bus = RecordingBus(bus, tmp_path / "t.jsonl")
        with bus, pytest.raises(SensorError, match=message):
            connect(array, bus)
        assert [wire.transactions for wire in board.wires.values()] == [0] * len(board.wires)


@pytest.mark.parametrize("number", [6, 121])
def test_both_errnos_of_a_missing_acknowledgement_are_a_missing_chip(served: Any, number: int) -> None:
    board, _ = board_of(ON_TRUNK, nack_errno=number)
    served(board)
    other = parse_array(ON_TRUNK.replace("0x53", "0x1D"))
    with LinuxBus(ROOT) as bus, pytest.raises(SensorError, match="no chip acknowledges this address"):
        connect(other, bus)


@contextmanager
def opened(text: str, url: str, served: Any) -> Iterator[tuple[Any, ArrayConfig, dict[str, Adapter]]]:
    board, array = board_of(text, clock="real")
    adapters = served(board)
    with open_bus(url, array) as bus:
        yield bus, array, adapters


@pytest.mark.parametrize(
    ("text", "url"),
    some(
        [
            (BEHIND_KERNEL_MUX, "i2c:"),
            (BEHIND_KERNEL_MUX, f"i2c:{ROOT}"),
            (BEHIND_OUR_MUX, f"i2c:{ROOT}"),
        ],
        1,
    ),
)
def test_a_log_is_recorded_through_the_linux_bus(served: Any, tmp_path: Path, text: str, url: str) -> None:
    # Two accelerometers of one address on two channels, one of them turned: the box stands upright, +Z up, at 1 g.
    with opened(text, url, served) as (bus, array, _):
        summary = record(array, bus, tmp_path / "log.h5", rate_hz=100, seconds=0.3)
    assert summary.lost == {"A": 0, "B": 0, "C": 0}
    with open_log(tmp_path / "log.h5") as log:
        assert log.source == "i2c"
        for name, per_g, bias_g in (("A", 256, 0.25), ("B", 256, 0.25), ("C", 4096, 0.1)):  # ADX-62, BMA-110
            counts = np.asarray(log[name].counts, float)
            assert 1 <= len(counts) == summary.frames <= 31  # a busy machine misses some
            assert summary.frames + summary.missed >= 29
            mean_g = counts.mean(axis=0) / per_g
            assert np.abs(mean_g - [0.0, 0.0, 1.0]).max() < bias_g + 0.1
        assert not np.array_equal(np.asarray(log["A"].counts), np.asarray(log["B"].counts))

"""Queues that are drained by and through the firmware's core, in the place of the emulated firmware."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acquire.test_serial_queue import test_every_sample_passes_the_link
from tests.acquire.test_stream_counted_queue import (
    test_a_bad_line_makes_no_samples,
    test_a_microcontroller_that_is_late,
    test_every_sample_arrives_at_its_time,
    test_transactions_that_fail,
)
from tests.acquire.test_stream_queue import (
    test_a_bad_line_costs_packets_and_never_makes_any,
    test_a_microcontroller_that_is_late_finds_the_samples_in_the_queue,
    test_a_microcontroller_that_is_reset,
    test_each_row_is_a_packet_at_the_time_of_its_stamp,
    test_packets_that_arrive_during_the_burst_are_taken,
)
from tests.bus import serial_bench
from tests.firmware.build import CoreFirmware

__all__ = [
    "test_a_bad_line_costs_packets_and_never_makes_any",
    "test_a_bad_line_makes_no_samples",
    "test_a_microcontroller_that_is_late",
    "test_a_microcontroller_that_is_late_finds_the_samples_in_the_queue",
    "test_a_microcontroller_that_is_reset",
    "test_each_row_is_a_packet_at_the_time_of_its_stamp",
    "test_every_sample_arrives_at_its_time",
    "test_every_sample_passes_the_link",
    "test_packets_that_arrive_during_the_burst_are_taken",
    "test_transactions_that_fail",
]


@pytest.fixture(autouse=True)
def _the_core(core_firmware: type[CoreFirmware], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(serial_bench, "Firmware", core_firmware)
    yield

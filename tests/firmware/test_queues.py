"""Queues that are drained by and through the firmware's core, in the place of the emulated firmware."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acquire.test_serial_queue import test_every_sample_of_a_queue_is_transferred_by_the_link
from tests.acquire.test_stream_counted_queue import (
    test_a_bad_line_invents_no_samples,
    test_a_counted_queue_bridges_a_short_pause_of_the_microcontroller,
    test_every_sample_is_logged_at_its_time,
    test_failed_transactions_give_no_wrong_rows,
)
from tests.acquire.test_stream_queue import (
    test_a_bad_line_loses_packets_and_never_invents_any,
    test_each_row_is_a_packet_at_the_time_of_its_stamp,
    test_packets_that_arrive_during_the_burst_are_kept,
    test_the_queue_bridges_a_short_pause_of_the_microcontroller,
    test_the_stream_restarts_after_a_reset_of_the_microcontroller,
)
from tests.bus import serial_bench
from tests.firmware.build import CoreFirmware

__all__ = [
    "test_a_bad_line_invents_no_samples",
    "test_a_bad_line_loses_packets_and_never_invents_any",
    "test_a_counted_queue_bridges_a_short_pause_of_the_microcontroller",
    "test_each_row_is_a_packet_at_the_time_of_its_stamp",
    "test_every_sample_is_logged_at_its_time",
    "test_every_sample_of_a_queue_is_transferred_by_the_link",
    "test_failed_transactions_give_no_wrong_rows",
    "test_packets_that_arrive_during_the_burst_are_kept",
    "test_the_queue_bridges_a_short_pause_of_the_microcontroller",
    "test_the_stream_restarts_after_a_reset_of_the_microcontroller",
]


@pytest.fixture(autouse=True)
def _the_core(core_firmware: type[CoreFirmware], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(serial_bench, "Firmware", core_firmware)
    yield

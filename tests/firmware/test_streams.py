"""An array that the firmware's core streams: the logger's tests of resets and unplugged ports, with the core
in the place of the emulated firmware. Its clock is the emulator's, so that every run is the same.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acquire.conftest import an_array
from tests.acquire.test_stream import (
    test_a_recording_ends_also_when_the_port_stays_unplugged,
    test_a_sensor_that_is_unplugged_for_a_while_is_logged_again,
    test_readings_missed_until_a_stop_while_unplugged_are_counted,
    test_the_log_of_the_papers_array_equals_the_bytes_on_the_wire,
    test_the_stream_restarts_after_a_reset_of_the_microcontroller,
    test_the_stream_restarts_after_the_port_is_unplugged_and_plugged_in,
)
from tests.acquire.test_stream_replays import test_a_replayed_frame_is_refused_and_loses_no_other
from tests.acquire.test_stream_spi import (
    test_after_a_reset_the_chip_selects_are_set_again,
    test_eight_chips_at_1_khz_are_streamed,
    test_the_log_of_two_chips_equals_the_bytes_on_the_wires,
)
from tests.bus import serial_bench
from tests.firmware.build import CoreFirmware

__all__ = [
    "an_array",
    "test_a_recording_ends_also_when_the_port_stays_unplugged",
    "test_a_replayed_frame_is_refused_and_loses_no_other",
    "test_a_sensor_that_is_unplugged_for_a_while_is_logged_again",
    "test_after_a_reset_the_chip_selects_are_set_again",
    "test_eight_chips_at_1_khz_are_streamed",
    "test_readings_missed_until_a_stop_while_unplugged_are_counted",
    "test_the_log_of_the_papers_array_equals_the_bytes_on_the_wire",
    "test_the_log_of_two_chips_equals_the_bytes_on_the_wires",
    "test_the_stream_restarts_after_a_reset_of_the_microcontroller",
    "test_the_stream_restarts_after_the_port_is_unplugged_and_plugged_in",
]


pytestmark = pytest.mark.slow  # test_resend.py and test_queues.py have streams of the core in the quick half


@pytest.fixture(autouse=True)
def _the_core(core_firmware: type[CoreFirmware], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(serial_bench, "Firmware", core_firmware)
    yield

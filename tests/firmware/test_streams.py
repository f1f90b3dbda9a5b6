"""An array that the firmware's core streams: the logger's tests of resets and unplugged ports, with the core
in the place of the emulated firmware. Its clock is the emulator's, so that every run is the same.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acquire.conftest import an_array
from tests.acquire.test_stream import (
    test_a_sensor_that_is_unplugged_for_a_while,
    test_pulled_out_for_good_it_still_ends,
    test_stopped_while_it_is_pulled_out_what_it_missed_is_counted,
    test_the_microcontroller_is_reset,
    test_the_papers_array_is_logged_as_it_went_over_the_wire,
    test_the_port_is_pulled_out_and_put_back,
)
from tests.acquire.test_stream_replays import test_a_replayed_frame_costs_itself_alone
from tests.acquire.test_stream_spi import (
    test_after_a_reset_the_chip_selects_are_set_again,
    test_eight_chips_at_1_khz,
    test_two_chips_are_logged_as_they_went_over_the_wires,
)
from tests.bus import serial_bench
from tests.firmware.build import CoreFirmware

__all__ = [
    "an_array",
    "test_a_replayed_frame_costs_itself_alone",
    "test_a_sensor_that_is_unplugged_for_a_while",
    "test_after_a_reset_the_chip_selects_are_set_again",
    "test_eight_chips_at_1_khz",
    "test_pulled_out_for_good_it_still_ends",
    "test_stopped_while_it_is_pulled_out_what_it_missed_is_counted",
    "test_the_microcontroller_is_reset",
    "test_the_papers_array_is_logged_as_it_went_over_the_wire",
    "test_the_port_is_pulled_out_and_put_back",
    "test_two_chips_are_logged_as_they_went_over_the_wires",
]


@pytest.fixture(autouse=True)
def _the_core(core_firmware: type[CoreFirmware], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(serial_bench, "Firmware", core_firmware)
    yield

"""Queues that are drained through the firmware's core, in the place of the emulated firmware."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acquire.test_serial_queue import test_every_sample_passes_the_link
from tests.bus import serial_bench
from tests.firmware.build import CoreFirmware

__all__ = ["test_every_sample_passes_the_link"]


@pytest.fixture(autouse=True)
def _the_core(core_firmware: type[CoreFirmware], monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(serial_bench, "Firmware", core_firmware)
    yield

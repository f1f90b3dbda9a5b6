"""A chip that a configuration may name has its line in every registry; a missing one is named, not a traceback."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from firmware_emulator import chips as emulated
from firmware_emulator.element import SENSED
from firmware_emulator.faulty_parts import LAYOUTS
from firmware_emulator.units import TOLERANCES
from imuarray.chips import CHIPS
from imuarray.drivers import DRIVERS

TRIADS = {chip for chip, spec in CHIPS.items() if spec.quantity != "pressure"}


@pytest.mark.parametrize(
    ("registry", "lines", "needed"),
    [
        ("imuarray/drivers/__init__.py: DRIVERS", DRIVERS, set(CHIPS)),
        ("firmware_emulator/chips/__init__.py: CHIPS", emulated.CHIPS, set(CHIPS)),
        ("firmware_emulator/element.py: SENSED", SENSED, set(CHIPS)),
        ("firmware_emulator/units.py: TOLERANCES", TOLERANCES, set(CHIPS)),
        ("firmware_emulator/faulty_parts.py: LAYOUTS", LAYOUTS, TRIADS),
    ],
)
def test_every_chip_has_an_entry_in_each_registry(registry: str, lines: Collection[str], needed: set[str]) -> None:
    assert needed - set(lines) == set(), f"no line in {registry}"

"""The L3G4200D between its element and its output registers: scale, filters, self-test (facts L3G-30 ... L3G-45).

28571 codes are the full scale of every range (250 dps at 8.75 mdps, L3G-40 ... L3G-43). Choices: in high-pass mode 01
the output is what exceeds REFERENCE, read as the high byte of a code; mode 11 acts as mode 00, because the interrupt is
not modelled.
"""

from __future__ import annotations

from typing import NamedTuple

from firmware_emulator.chip import Element
from firmware_emulator.chips.high_pass import HighPass
from imuarray.facts import l3g4200d as facts

RATES_HZ = (100, 200, 400, 800)
LPF1_HZ = (32.0, 54.0, 78.0, 93.0)  # by DR: L3G-38, DEC-22
LPF2_HZ = (  # by DR, then BW: L3G-30 ... L3G-33
    (12.5, 25.0, 25.0, 25.0),
    (12.5, 25.0, 50.0, 70.0),
    (20.0, 25.0, 50.0, 110.0),
    (30.0, 35.0, 50.0, 110.0),
)
HIGH_PASS_HZ = (56.0, 30.0, 15.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)  # slower by DR and HPCF: L3G-35
RANGES_DPS = (250.0, 500.0, 2000.0, 2000.0)  # L3G-40 ... L3G-42
SELF_TESTS_DPS = (130.0, 200.0, 530.0, 530.0)  # L3G-62
SELF_TEST_SIGNS = (0.0, 1.0, 0.0, -1.0)  # by ST: L3G-14
RANGE_CODES = 250 / 0.00875
REFERENCE_MODE = 0b01

Codes = tuple[int, int, int]


class Path(NamedTuple):
    """The signal path that CTRL_REG1 ... CTRL_REG5 select."""

    range_dps: float
    bandwidth_hz: float
    self_test_dps: float
    high_pass_hz: float  # 0: none
    reference: bool


def path_of(page: bytes | bytearray) -> Path:
    """Return the path that a register page selects (L3G-36, L3G-37)."""
    ctrl1, ctrl2, ctrl4, ctrl5 = page[0x20], page[0x21], page[0x23], page[0x24]
    rate, scale, select = facts.DATA_RATE.of(ctrl1), facts.FULL_SCALE.of(ctrl4), facts.OUT_SELECT.of(ctrl5)
    filtered = select == 0b01 or (select >= 0b10 and bool(facts.HIGH_PASS_EN.of(ctrl5)))
    slowness = 3 - rate + min(9, facts.HIGH_PASS_CUTOFF.of(ctrl2))
    return Path(
        range_dps=RANGES_DPS[scale],
        bandwidth_hz=LPF2_HZ[rate][facts.BANDWIDTH.of(ctrl1)] if select >= 0b10 else LPF1_HZ[rate],
        self_test_dps=SELF_TESTS_DPS[scale] * SELF_TEST_SIGNS[facts.SELF_TEST.of(ctrl4)],
        high_pass_hz=HIGH_PASS_HZ[slowness] if filtered else 0.0,
        reference=filtered and facts.HIGH_PASS_MODE.of(ctrl2) == REFERENCE_MODE,
    )


class Signal:
    """Codes of the element's rate at any instant, along the path that is selected."""

    def __init__(self, element: Element, page: bytearray) -> None:
        self._element = element
        self._page = page
        self._high_pass: HighPass | None = None
        self._path = path_of(page)

    def configure(self, at_ns: int) -> None:
        """Take the path from the registers as they are at `at_ns`."""
        path = path_of(self._page)
        if path.high_pass_hz != self._path.high_pass_hz or path.reference != self._path.reference:
            filtered = path.high_pass_hz and not path.reference
            self._high_pass = HighPass(path.high_pass_hz, at_ns) if filtered else None
        self._path = path
        self._codes_per_dps = RANGE_CODES / path.range_dps
        self._offset = 0.0
        if self._high_pass is None:
            self._offset += path.self_test_dps * self._codes_per_dps
        if path.reference:
            reference = self._page[facts.REFERENCE.address]
            self._offset -= (reference - 256 if reference > 127 else reference) * 256

    def zero(self, at_ns: int) -> None:
        """Make the present rate the high-pass filter's zero, as reading REFERENCE does (L3G-12)."""
        if self._high_pass is not None:
            path = self._path
            x, y, z = self._element.sample(at_ns, path.range_dps, path.bandwidth_hz)
            push = path.self_test_dps
            self._high_pass.zero((x + push, y + push, z + push), at_ns)

    def codes(self, at_ns: int) -> Codes:
        """Return the conversion of `at_ns`, saturated (DEC-21)."""
        path = self._path
        dps = self._element.sample(at_ns, path.range_dps, path.bandwidth_hz)
        if self._high_pass is not None:
            push = path.self_test_dps
            dps = self._high_pass((dps[0] + push, dps[1] + push, dps[2] + push), at_ns)
        scale, offset = self._codes_per_dps, self._offset
        x, y, z = round(dps[0] * scale + offset), round(dps[1] * scale + offset), round(dps[2] * scale + offset)
        if -32768 <= x <= 32767 and -32768 <= y <= 32767 and -32768 <= z <= 32767:
            return x, y, z
        return _saturated(x), _saturated(y), _saturated(z)


def _saturated(code: int) -> int:
    return max(-32768, min(32767, code))

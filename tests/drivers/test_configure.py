"""Setting chips up: from any state that an earlier program left, and verified by reading back.

The expected register values are written out from the data sheets' register tables, not taken from the drivers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_emulator.chips.adxl345 import Adxl345Chip
from firmware_emulator.chips.bma180 import Bma180Chip
from firmware_emulator.chips.hmc5883 import Hmc5883Chip, Hmc5883lChip
from firmware_emulator.chips.l3g4200d import L3g4200dChip
from imuarray.array import SensorConfig
from imuarray.errors import SensorError
from imuarray.log.format import OVERRUN

Build = Callable[..., Any]


def sensor(chip: str, address: int, range_: float, **more: Any) -> SensorConfig:
    return SensorConfig(name="S", chip=chip, address=address, range=float(range_), **more)


class TestAdxl345:
    DIRTY = (
        (0x1E, 0x7F), (0x1F, 0x81), (0x20, 0x11),  # offsets of +2 g, -2 g, 0.27 g (ADX-12)
        (0x2C, 0x1F),  # low power, 3200 Hz
        (0x31, 0x84),  # self-test, left-justified, 10 bits, 2 g
        (0x2E, 0xFF), (0x38, 0x9F),  # interrupts, stream
        (0x2D, 0x3F),  # linked, auto-sleep, measuring, asleep
    )  # fmt: skip

    @pytest.mark.parametrize(("range_", "code"), [(2, 0), (4, 1), (8, 2), (16, 3)])
    @pytest.mark.parametrize("dirty", [(), DIRTY])
    def test_a_chip_is_configured_from_any_state(self, bench: Build, range_: int, code: int, dirty: Any) -> None:
        made = bench(Adxl345Chip, sensor("adxl345", 0x53, range_, rate_hz=400.0), (1.0, -0.5, 0.25))
        made.write(*dirty)
        made.wait(0.1)
        made.driver.identify()
        made.driver.configure()
        assert made.register(0x31) == 0x08 | code  # full resolution, right-justified
        assert made.register(0x2C) == 0x0C  # 400 Hz, normal power
        assert made.register(0x2D) == 0x08
        assert [made.register(address) for address in (0x1E, 0x1F, 0x20, 0x38, 0x2E)] == [0] * 5
        for _ in range(3):
            reading = made.read()
            np.testing.assert_array_equal(reading.counts, [[256, -128, 64]])  # 256 per g in every range: ADX-40
            assert reading.status[0] in (0, OVERRUN)  # samples passed unread while it was configured
            made.wait(0.01)

    @pytest.mark.parametrize(
        ("rate_hz", "code"),
        [(0.09765625, 0), (12.5, 7), (25.0, 8), (100.0, 10), (800.0, 13), (1600.0, 14), (3200.0, 15)],
    )
    def test_rate_codes(self, bench: Build, rate_hz: float, code: int) -> None:
        made = bench(Adxl345Chip, sensor("adxl345", 0x1D, 2, rate_hz=rate_hz))
        made.driver.configure()
        assert made.register(0x2C) == code  # ADX-32 ... ADX-35

    def test_settings_are_made_in_standby(self, bench: Build) -> None:
        made = bench(Adxl345Chip, sensor("adxl345", 0x53, 16))
        made.driver.configure()
        writes = made.tap.writes
        assert writes[0] == b"\x2d\x00"  # ADX-38
        assert writes[-1] == b"\x2d\x08"

    def test_a_second_read_within_a_period_is_stale(self, bench: Build) -> None:
        made = bench(Adxl345Chip, sensor("adxl345", 0x53, 16, rate_hz=100.0))
        made.driver.configure()
        first, second = made.read(), made.read()
        made.wait(0.010)
        third = made.read()
        assert [reading.status[0] for reading in (first, second, third)] == [0, 1, 0]

    @pytest.mark.parametrize("register", [0x2D, 0x2C, 0x31, 0x38, 0x2E, 0x1E, 0x1F, 0x20])
    def test_a_register_that_drops_a_write_is_reported(self, bench: Build, register: int) -> None:
        made = bench(Adxl345Chip, sensor("adxl345", 0x53, 16, rate_hz=400.0))
        made.write(*self.DIRTY)
        made.tap.drops = register.__eq__
        with pytest.raises(
            SensorError, match=rf"S \(adxl345\) at trunk address 0x53: register {register:#04x} reads .* refuses"
        ):
            made.driver.configure()

    def test_never_touches_reserved_registers(self, bench: Build) -> None:
        made = bench(Adxl345Chip, sensor("adxl345", 0x53, 16))
        made.driver.identify()
        made.driver.configure()
        made.driver.fetch()
        assert not {write[0] for _, write, _ in made.tap.seen} & set(range(0x01, 0x1D))  # section 3.2


# A part with trims of its own in every byte that settings share (BMA-26, BMA-36 ... BMA-46), re-programmed by an
# earlier owner: 8 g, 20 Hz, low power, shadow off (BMA-59).
OWN_TRIMS = {
    0x20: 0x1B, 0x2E: 0x95, 0x2F: 0x6E, 0x30: 0xA7, 0x31: 0x94, 0x32: 0x76, 0x33: 0x9B, 0x34: 0x88,
    0x35: 0x7B, 0x36: 0x3C, 0x37: 0xAA, 0x38: 0x81, 0x39: 0x7E, 0x3A: 0x83, 0x3B: 0x5A,
}  # fmt: skip
# Which bits of a register are settings that the driver may change; the others are trims.
SETTING_BITS = {0x20: 0xF0, 0x30: 0x03, 0x33: 0x01, 0x35: 0x0F, 0x37: 0x01}


class TestBma180:
    @pytest.mark.parametrize(
        ("range_", "code", "lsb_per_g"),
        [
            (1, 0, 8192),
            (1.5, 1, 5460),
            (2, 2, 4096),
            (3, 3, 2730),
            (4, 4, 2048),
            (8, 5, 1024),
            (16, 6, 512),
        ],  # BMA-70 ...
    )
    @pytest.mark.parametrize("dirty", [False, True])
    def test_a_chip_is_configured_from_any_state(
        self, bench: Build, range_: float, code: int, lsb_per_g: int, dirty: bool
    ) -> None:
        made = bench(Bma180Chip, sensor("bma180", 0x40, range_, bandwidth_hz=40.0), (0.5, -0.25, 0.75))
        if dirty:  # unlocked, 3 g, 1200 Hz, low power, shadow off, asleep
            made.write((0x0D, 0x10), (0x35, 0x06), (0x20, 0x78), (0x30, 0x83), (0x33, 0x81), (0x0D, 0x12))
        made.driver.identify()
        made.driver.configure()
        assert made.register(0x35) & 0x0F == code << 1
        assert made.register(0x20) >> 4 == 2  # 40 Hz: BMA-83
        assert made.register(0x30) & 0x03 == 0
        assert made.register(0x33) & 0x01 == 0
        assert made.register(0x0D) & 0x12 == 0  # locked, awake
        reading = made.read()
        np.testing.assert_allclose(reading.counts, [[lsb_per_g * 0.5, -lsb_per_g * 0.25, lsb_per_g * 0.75]], atol=1)
        assert reading.temperature_counts[0] == 2  # 25 degC: BMA-63

    @pytest.mark.parametrize(
        ("bandwidth_hz", "code"),  # BMA-81 ... BMA-88
        [(10, 0), (20, 1), (40, 2), (75, 3), (150, 4), (300, 5), (600, 6), (1200, 7)],
    )
    def test_bandwidth_codes(self, bench: Build, bandwidth_hz: float, code: int) -> None:
        made = bench(Bma180Chip, sensor("bma180", 0x41, 2, bandwidth_hz=float(bandwidth_hz)))
        made.driver.configure()
        assert made.register(0x20) >> 4 == code

    def test_trim_bits_are_kept(self, bench: Build) -> None:
        made = bench(Bma180Chip, sensor("bma180", 0x40, 16, bandwidth_hz=150.0), eeprom=OWN_TRIMS)
        before = {register: made.register(register) for register in range(0x20, 0x3C)}
        assert {register: before[register] for register in OWN_TRIMS} == OWN_TRIMS
        made.driver.configure()
        for register in range(0x20, 0x3C):
            trims = ~SETTING_BITS.get(register, 0)
            assert made.register(register) & trims == before[register] & trims, hex(register)
        assert made.register(0x35) & 0x0E == 6 << 1
        assert made.register(0x20) >> 4 == 4

    def test_a_12_bit_read_out_is_switched_off(self, bench: Build) -> None:
        made = bench(
            Bma180Chip, sensor("bma180", 0x40, 2), (1 / 4096, 2 / 4096, 3 / 4096), eeprom={0x37: 0xB1}
        )  # BMA-61
        made.driver.configure()
        np.testing.assert_array_equal(made.read().counts, [[1, 2, 3]])

    def test_never_writes_to_the_eeprom(self, bench: Build) -> None:
        made = bench(Bma180Chip, sensor("bma180", 0x40, 16))
        for _ in range(3):
            made.driver.identify()
            made.driver.configure()
            for _ in range(20):
                made.driver.fetch()
        assert made.chip.eeprom_writes == 0  # BMA-55
        assert max(write[0] for _, write, _ in made.tap.seen if write) < 0x40
        assert {len(write) for write in made.tap.writes} == {2}  # pairs: BMA-05

    def test_nothing_is_sent_during_the_download(self, bench: Build) -> None:
        """Writes are undone if they come within 10 ms of the reset (BMA-53): 20 ms of silence."""
        made = bench(Bma180Chip, sensor("bma180", 0x40, 16))
        times: list[tuple[int, bytes]] = []
        inner = made.tap.bus.transfer
        made.tap.bus.transfer = lambda address, write=b"", read=0: (
            times.append((made.clock.now_ns(), write)) or inner(address, write, read)
        )
        made.driver.configure()
        (reset_ns,) = [at_ns for at_ns, write in times if write == b"\x10\xb6"]
        after = [at_ns for at_ns, _ in times if at_ns > reset_ns]
        assert min(after) - reset_ns >= 20_000_000

    @pytest.mark.parametrize("vanish", [False, True])
    def test_a_slow_download_is_reported(self, bench: Build, vanish: bool) -> None:
        made = bench(Bma180Chip, sensor("bma180", 0x40, 16), download_ns=60_000_000, early_writes_vanish=vanish)
        made.clock.sleep_until(2_000_000_000)
        if vanish:
            with pytest.raises(SensorError, match=r"S \(bma180\) at trunk address 0x40: register 0x35 reads"):
                made.driver.configure()
        else:
            made.driver.configure()  # undone later; not visible yet

    @pytest.mark.parametrize("register", [0x0D, 0x20, 0x30, 0x33, 0x35])
    def test_a_register_that_drops_a_write_is_reported(self, bench: Build, register: int) -> None:
        made = bench(Bma180Chip, sensor("bma180", 0x40, 16, bandwidth_hz=150.0), eeprom=OWN_TRIMS)
        made.tap.drops = register.__eq__
        with pytest.raises(
            SensorError, match=r"S \(bma180\) at trunk address 0x40: register 0x.. reads .* refuses its configuration"
        ):
            made.driver.configure()

    def test_two_reads_within_an_update_give_a_stale_reading(self, bench: Build) -> None:
        made = bench(Bma180Chip, sensor("bma180", 0x40, 2, bandwidth_hz=1200.0))
        made.driver.configure()
        assert made.read().status[0] == 0
        states = [made.read().status[0] for _ in range(20)]  # a burst takes 229 us, an update 417 us: BUS-07, BMA-93
        assert 0 in states
        assert set(states) <= {0, 1}


class TestL3g4200d:
    DIRTY = (
        (0x20, 0x0F),  # awake, 100 Hz
        (0x21, 0x19),  # high-pass
        (0x22, 0xFF),
        (0x23, 0x66),  # BLE, 2000 dps, self-test
        (0x24, 0x5F),  # FIFO, high-pass, LPF2
        (0x2E, 0x5F),  # stream
    )

    @pytest.mark.parametrize(
        ("range_", "bits", "dps_per_digit"), [(250, 0x00, 0.00875), (500, 0x10, 0.0175), (2000, 0x20, 0.07)]
    )
    @pytest.mark.parametrize("dirty", [(), DIRTY])
    def test_a_chip_is_configured_from_any_state(
        self, bench: Build, range_: int, bits: int, dps_per_digit: float, dirty: Any
    ) -> None:
        made = bench(
            L3g4200dChip, sensor("l3g4200d", 0x69, range_, rate_hz=400.0, bandwidth_hz=50.0), (70.0, -35.0, 14.0)
        )
        made.write(*dirty)
        made.wait(0.5)
        made.driver.identify()
        made.driver.configure()
        assert made.register(0x20) == 0xAF  # 400 Hz, third bandwidth, awake, three axes: L3G-32, L3G-34
        assert made.register(0x23) == 0x80 | bits  # BDU: L3G-50
        assert [made.register(register) for register in (0x21, 0x22, 0x2E)] == [0, 0, 0]
        assert made.register(0x24) in (0x02, 0x03)  # through the second low-pass: L3G-37
        made.wait(1.0)
        for _ in range(3):
            reading = made.read()
            np.testing.assert_allclose(reading.counts, np.array([[70, -35, 14]]) / dps_per_digit, atol=1)
            assert reading.status[0] in (0, OVERRUN)  # samples passed unread while it was configured
            made.wait(0.01)
        assert reading.temperature_counts[0] == 22  # 47 at 0 degC in this part, one less a degree: L3G-60

    @pytest.mark.parametrize(
        ("rate_hz", "bandwidth_hz", "top"),
        [
            (100, 12.5, 0x00),
            (200, 70, 0x70),
            (400, 20, 0x80),
            (800, 30, 0xC0),
            (800, 110, 0xF0),
            (200, 25, 0x50),
        ],  # L3G-30 ...
    )
    def test_rate_and_bandwidth_codes(self, bench: Build, rate_hz: float, bandwidth_hz: float, top: int) -> None:
        made = bench(
            L3g4200dChip, sensor("l3g4200d", 0x68, 250, rate_hz=float(rate_hz), bandwidth_hz=float(bandwidth_hz))
        )
        made.driver.configure()
        assert made.register(0x20) == top | 0x0F

    @pytest.mark.parametrize("rate_hz", [100, 200, 400, 800])
    def test_without_a_bandwidth_the_chip_gets_the_bandwidth_that_the_log_states(
        self, bench: Build, rate_hz: int
    ) -> None:
        table = {100: (12.5, 25, 25, 25), 200: (12.5, 25, 50, 70), 400: (20, 25, 50, 110), 800: (30, 35, 50, 110)}
        config = sensor("l3g4200d", 0x68, 250, rate_hz=float(rate_hz))
        made = bench(L3g4200dChip, config)
        made.driver.configure()
        assert table[rate_hz][made.register(0x20) >> 4 & 0b11] == config.chip_bandwidth_hz

    @pytest.mark.parametrize("register", [0x20, 0x21, 0x22, 0x23, 0x24, 0x2E])
    def test_a_register_that_drops_a_write_is_reported(self, bench: Build, register: int) -> None:
        made = bench(L3g4200dChip, sensor("l3g4200d", 0x68, 250, rate_hz=400.0))
        made.write(*self.DIRTY)
        made.tap.drops = register.__eq__
        with pytest.raises(SensorError, match=rf"S \(l3g4200d\) at trunk address 0x68: register {register:#04x} reads"):
            made.driver.configure()

    def test_never_touches_reserved_registers(self, bench: Build) -> None:
        made = bench(L3g4200dChip, sensor("l3g4200d", 0x68, 250))
        made.driver.identify()
        made.driver.configure()
        made.driver.fetch()
        assert made.chip.forbidden_writes == 0  # L3G-07
        assert made.tap.seen[-1] == (0x68, b"\xa6", 8)  # with the bit that counts on: L3G-03

    def test_a_second_read_within_a_period_is_stale(self, bench: Build) -> None:
        made = bench(L3g4200dChip, sensor("l3g4200d", 0x68, 250, rate_hz=100.0))
        made.driver.configure()
        made.wait(0.5)
        assert [made.read().status[0] for _ in range(2)] == [OVERRUN, 1]  # half a second of samples passed unread


@pytest.mark.parametrize(
    ("chip", "emulated", "range_", "gain", "lsb_per_gauss"),
    [
        ("hmc5883l", Hmc5883lChip, 0.88, 0x00, 1370),  # HMC-20 ... HMC-27
        ("hmc5883l", Hmc5883lChip, 1.3, 0x20, 1090),
        ("hmc5883l", Hmc5883lChip, 8.1, 0xE0, 230),
        ("hmc5883", Hmc5883Chip, 0.9, 0x00, 1280),
        ("hmc5883", Hmc5883Chip, 1.2, 0x20, 1024),
        ("hmc5883", Hmc5883Chip, 4.6, 0xA0, 361),
    ],
)
class TestHmc5883:
    DIRTY = ((0x00, 0x71), (0x01, 0xE0), (0x02, 0x03))  # eight averages, 30 Hz, biased; coarsest gain; idle

    @pytest.mark.parametrize("dirty", [(), DIRTY])
    def test_a_chip_is_configured_from_any_state(
        self, bench: Build, chip: str, emulated: Any, range_: float, gain: int, lsb_per_gauss: int, dirty: Any
    ) -> None:
        made = bench(emulated, sensor(chip, 0x1E, range_, rate_hz=75.0), (0.2, -0.1, 0.4))
        made.write(*dirty)
        made.driver.identify()
        made.driver.configure()
        assert made.register(0x00) == 0x18  # one sample, 75 Hz, unbiased: HMC-10, HMC-28
        assert made.register(0x01) == gain
        for _ in range(3):
            reading = made.read()
            np.testing.assert_allclose(
                reading.counts, [[0.2 * lsb_per_gauss, -0.1 * lsb_per_gauss, 0.4 * lsb_per_gauss]], atol=1
            )
            assert reading.status[0] in (0, OVERRUN)  # samples passed unread while it was configured
            made.chip.element.vector = (0.2, -0.1, 0.4)
            made.wait(1 / 75)
        made.chip.element.vector = (-0.2, 0.1, 0.0)
        made.wait(2 / 75)
        np.testing.assert_allclose(made.read().counts, [[-0.2 * lsb_per_gauss, 0.1 * lsb_per_gauss, 0]], atol=1)

    def test_a_chip_with_locked_data_is_configured(
        self, bench: Build, chip: str, emulated: Any, range_: float, gain: int, lsb_per_gauss: int
    ) -> None:
        made = bench(emulated, sensor(chip, 0x1E, range_, rate_hz=75.0), (0.2, -0.1, 0.4))
        made.wire.transfer(0x1E, b"\x03", 2)  # an earlier program read x and died: HMC-33
        made.driver.configure()
        np.testing.assert_allclose(
            made.read().counts, [[0.2 * lsb_per_gauss, -0.1 * lsb_per_gauss, 0.4 * lsb_per_gauss]], atol=1
        )

    @pytest.mark.parametrize("register", [0x00, 0x01])
    def test_a_register_that_drops_a_write_is_reported(
        self, bench: Build, chip: str, emulated: Any, range_: float, gain: int, lsb_per_gauss: int, register: int
    ) -> None:
        made = bench(emulated, sensor(chip, 0x1E, range_, rate_hz=75.0))
        made.write((0x00, 0x71), (0x01, 0x40), (0x02, 0x03))
        made.tap.drops = register.__eq__
        with pytest.raises(SensorError, match=rf"S \({chip}\) at trunk address 0x1e: register {register:#04x} reads"):
            made.driver.configure()


@pytest.mark.parametrize(("chip", "emulated"), [("hmc5883", Hmc5883Chip), ("hmc5883l", Hmc5883lChip)])
def test_an_hmc5883_that_stays_idle_is_reported(bench: Build, chip: str, emulated: Any) -> None:
    made = bench(emulated, sensor(chip, 0x1E, 1.9, rate_hz=75.0))
    made.write((0x02, 0x03))
    made.tap.drops = (0x02).__eq__
    with pytest.raises(SensorError):
        made.driver.configure()


@pytest.mark.parametrize(
    ("chip", "emulated", "range_", "address"),
    [
        ("adxl345", Adxl345Chip, 2, 0x53),
        ("bma180", Bma180Chip, 2, 0x40),
        ("l3g4200d", L3g4200dChip, 250, 0x68),
        ("hmc5883", Hmc5883Chip, 1.2, 0x1E),
    ],
)
class TestIdentity:
    def test_a_missing_acknowledgement_is_reported(
        self, bench: Build, chip: str, emulated: Any, range_: float, address: int
    ) -> None:
        for number in (6, 121):
            made = bench(emulated, sensor(chip, address, range_))
            made.chip.address = 0x10
            made.wire.reroute()
            made.wire.nack_errno = number
            with pytest.raises(
                SensorError, match=rf"^S \({chip}\) at trunk address {address:#04x}: no chip acknowledges this address$"
            ):
                made.driver.identify()

    def test_a_failing_bus_is_reported(
        self, bench: Build, chip: str, emulated: Any, range_: float, address: int
    ) -> None:
        made = bench(emulated, sensor(chip, address, range_))

        class Stuck:
            def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
                raise TimeoutError(110, "Connection timed out")

        made.tap.bus = Stuck()
        with pytest.raises(SensorError, match=r": the bus fails: Connection timed out$"):
            made.driver.identify()

    def test_another_chip_is_refused(self, bench: Build, chip: str, emulated: Any, range_: float, address: int) -> None:
        made = bench(emulated, sensor(chip, address, range_))
        made.chip.page[:] = bytes(256)
        with pytest.raises(SensorError, match=r"identity 00( 00 00)?, expected (e5|03|d3|48 34 33)$"):
            made.driver.identify()

    def test_identification_changes_nothing(
        self, bench: Build, chip: str, emulated: Any, range_: float, address: int
    ) -> None:
        made = bench(emulated, sensor(chip, address, range_))
        made.driver.identify()
        assert made.tap.writes == []

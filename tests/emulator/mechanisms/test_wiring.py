"""Faults of converters, wiring, multiplexer and host, seen through the wires of the whole emulated array."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from firmware_emulator.clock import VirtualClock
from firmware_emulator.mechanisms.converter import (
    ConverterHold,
    MissingCodes,
    RateDivider,
    SlowOscillator,
    StuckBit,
    TornReads,
    without_bit,
)
from firmware_emulator.mechanisms.host import HostClock
from firmware_emulator.mechanisms.host_time import CoarseTimestamps, HostResonator, SchedulerLatency
from firmware_emulator.mechanisms.mechanism import Fitting
from firmware_emulator.mechanisms.power import BrownOut
from firmware_emulator.mechanisms.wiring import CableBitErrors, LooseContact, MuxCrosstalk, MuxHang
from firmware_emulator.world import StillWorld, WorldStimulus
from tests.emulator.mechanisms.mechanism_bench import ARRAY, MS, IdealBoard, S, board, bus_with, of, words

ADXL, BMA, GYRO, MUX = 0x53, 0x40, 0x68, 0x70


def awake(bus):
    """Chips measure: ADXL345 at 800 Hz in full resolution, L3G4200D at 800 Hz through its second filter."""
    bus.transfer(ADXL, b"\x2c\x0d")
    bus.transfer(ADXL, b"\x31\x0b")
    bus.transfer(ADXL, b"\x2d\x08")
    bus.transfer(GYRO, b"\x24\x02")
    bus.transfer(GYRO, b"\x20\xcf")
    bus.clock.sleep_until(S)


def test_a_stuck_bit_is_never_set():
    with bus_with(StuckBit(2), "BMA") as bus:
        awake(bus)
        x, y, z = (word >> 2 for word in words(bus.transfer(BMA, b"\x02", 6)))
        assert (x, y, z) == (0, 0, 4096)
    latch = board(StuckBit(2), "BMA")._sites["BMA"].links.latches[0]
    assert latch(0, (7, -1, 4)) == (3, -5, 0)


def test_missing_codes_become_the_next_code_above():
    latch = board(MissingCodes(4), "BMA")._sites["BMA"].links.latches[0]
    assert latch(0, (11, 12, 15)) == (11, 16, 16)
    assert latch(0, (-1, -4, -5)) == (0, 0, -5)


def test_latched_codes_keep_the_chips_width_and_its_ready_bit():
    def readings(name: str) -> list[int]:
        with bus_with(MissingCodes(14), name) as bus:
            awake(bus)
            return [word for _ in range(20) for word in words(bus.transfer(BMA, b"\x02", 6))]

    latched, untouched = readings("BMA"), readings("BMA twin")
    assert [word & 3 for word in latched] == [word & 3 for word in untouched]
    assert {word & 3 for word in latched} == {0, 1}
    assert latched[2] >> 2 == 4096
    assert board(MissingCodes(14), "BMA")._sites["BMA"].links.latches[0](0, (8191, 0, 0))[0] == 8192
    with bus_with(MissingCodes(14), "BMA", world=lambda at_ns: WorldStimulus((0.0, 0.0, 99.0))) as bus:
        awake(bus)
        assert words(bus.transfer(BMA, b"\x02", 6))[2] >> 2 == 8191


@pytest.mark.parametrize(
    ("name", "address", "first", "ready"), [("ADXL", ADXL, 0x30, 0x80), ("Gyro", GYRO, 0xA7, 0x08)]
)
def test_a_slow_oscillator_gives_new_samples_at_its_own_rate(name, address, first, ready):
    with bus_with(SlowOscillator(40.0), name) as bus:
        awake(bus)
        fresh = 0
        for index in range(500):
            bus.clock.sleep_until(2 * S + index * 10 * MS)
            fresh += bool(bus.transfer(address, bytes([first]), 8)[0] & ready)
        assert fresh == pytest.approx(200, abs=2)  # 40 a second for 5 s, asked a hundred times a second


def test_a_slow_bma180_gives_new_samples_at_its_own_rate():
    with bus_with(SlowOscillator(40.0), "BMA") as bus:
        fresh = 0
        for index in range(500):
            bus.clock.sleep_until(2 * S + index * 10 * MS)
            fresh += words(bus.transfer(BMA, b"\x02", 6))[0] & 1
        assert fresh == pytest.approx(200, abs=2)


def test_a_divider_that_loses_a_bit_acts_on_another_value_than_it_reads_back():
    assert [without_bit(0b1110, which) for which in range(4)] == [0b1100, 0b1010, 0b0110, 0b0110]
    assert without_bit(0, 1) == 0
    with bus_with(RateDivider(0), "ADXL", "Gyro", "BMA") as bus:
        awake(bus)
        assert bus.transfer(ADXL, b"\x2c", 1) == b"\x0d"
        assert bus.transfer(GYRO, b"\x20", 1) == b"\xcf"
        bus.transfer(ADXL, b"\x30", 8)
        fresh = 0
        for index in range(400):  # 0b1101 without its lowest bit is 400 Hz
            bus.clock.sleep_until(2 * S + index * 1_300_000)
            fresh += bus.transfer(ADXL, b"\x30", 8)[0] >> 7
        assert fresh == pytest.approx(400 * 400 * 1.3e-3, abs=20)  # some fall between the flag and the data
        assert bus.chips["Gyro"]._signal._path.bandwidth_hz == 20.0  # DR = 10, BW = 00 (L3G-32)
        bus.transfer(BMA, b"\x0d\x10")
        bus.transfer(BMA, b"\x20\x48")
        assert bus.transfer(BMA, b"\x20", 1)[0] >> 4 == 4
        assert bus.chips["BMA"]._converter._bandwidth_hz == 10.0


def test_bit_errors_have_their_rate():
    with bus_with(CableBitErrors(1e-3), "ADXL") as bus:
        awake(bus)
        assert all(bus.transfer(ADXL, b"\x00", 1) == b"\xe5" for _ in range(300))  # while it is set up
        bus.clock.sleep_until(6 * S)
        flipped = sum((0xE5 ^ bus.transfer(ADXL, b"\x00", 1)[0]).bit_count() for _ in range(5000))
        assert flipped == pytest.approx(40, abs=4 * math.sqrt(40))


def test_a_torn_reading_has_bytes_of_two_samples():
    latch = board(TornReads(1.0), "Gyro")._sites["Gyro"].links.latches[0]
    assert latch(0, (-1, 255, 256)) == (-1, 255, 256)
    assert latch(1, (0, 256, 255)) == (-256, 0, 511)
    assert latch(2, (0, 256, 255)) == (0, 256, 255)
    latch = board(TornReads(1.0), "BMA")._sites["BMA"].links.latches[0]
    latch(0, (-1, 63, 64))
    assert latch(1, (0, 64, 63)) == (-64, 0, 127)


def test_a_converter_repeats_its_value_for_the_hold_time():
    latch = board(ConverterHold(held_s=1.0, free_s=3.0), "Gyro")._sites["Gyro"].links.latches[0]
    got = [latch(index * 10 * MS, (index, 0, 0))[0] for index in range(60000)]
    held = np.array([code != index for index, code in enumerate(got)])
    edges = np.flatnonzero(np.diff(held.astype(int)))
    lengths = {last - first for first, last in pairwise(edges) if held[first + 1]}
    assert lengths == {99}
    assert held.mean() == pytest.approx(0.25, abs=0.06)


def test_a_brown_out_restores_the_range_of_the_eeprom():
    with bus_with(BrownOut(mean_s=5.0), "BMA") as bus:
        bus.transfer(BMA, b"\x0d\x10")
        bus.clock.sleep_until(100 * MS)
        bus.transfer(BMA, b"\x35\x0c")  # 16 g
        bus.clock.sleep_until(S)
        assert words(bus.transfer(BMA, b"\x02", 6))[2] >> 2 == 512
        bus.clock.sleep_until(200 * S)
        bus.transfer(BMA, b"\x00", 1)
        bus.clock.sleep_until(201 * S)
        assert bus.transfer(BMA, b"\x35", 1) == b"\x04"  # 2 g: BMA-58
        assert words(bus.transfer(BMA, b"\x02", 6))[2] >> 2 == 4096


@pytest.mark.parametrize(("until_s", "touched"), [(1, set()), (200, {"BMA"})])
def test_the_truth_states_whether_a_brown_out_happened(until_s, touched):
    """It happens 5 s after power-on at the earliest, and within 200 s but for one case in 10^17."""
    fitted = board(BrownOut(mean_s=5.0), "BMA")
    fitted._sites["BMA"].links.resets[0](until_s * S)
    assert fitted.touched == {BrownOut(mean_s=5.0): touched}


def test_a_loose_contact_does_not_acknowledge_for_its_share_of_the_time():
    with bus_with(LooseContact(open_s=0.3, closed_s=0.7), "ADXL") as bus:
        lost = 0
        for index in range(10000):
            bus.clock.sleep_until(6 * S + index * 100 * MS)
            try:
                assert bus.transfer(ADXL, b"\x00", 1) == b"\xe5"
            except OSError as error:
                assert error.errno == 121
                lost += 1
            bus.transfer(BMA, b"\x00", 1)
        assert lost == pytest.approx(3000, abs=400)


def test_the_twin_answers_while_the_multiplexer_hangs():
    with bus_with(MuxHang(0.5)) as bus:
        awake(bus)
        bus.clock.sleep_until(6 * S)
        hung = 0
        for index in range(400):
            bus.transfer(MUX, b"\x04" if index % 2 else b"\x05")
            assert bus.transfer(MUX, read=1)[0] & 7 == (4 if index % 2 else 5)
            try:
                bus.transfer(ADXL, b"\x00", 1)
                hung += index % 2 == 0  # no chip on channel 1 has that address
            except OSError:
                hung += index % 2
        assert hung == pytest.approx(80, abs=32)  # two STOPs an order: h = (1 - h) / 4, of 400


def test_the_truth_states_for_which_sensor_a_twin_answered():
    fitted = board(MuxHang(0.5), "BMA", "BMA twin")
    mux, passes = fitted.router("pca9544a", MUX, {}, 0), fitted._sites["BMA"].links.latches[0]
    fitted.host.obeys[:] = [lambda at_ns: True]
    mux.write(b"\x04", 0, 1)
    mux.stop(0)
    assert passes(0, (1, 2, 3)) == (1, 2, 3)
    assert fitted.touched == {MuxHang(0.5): set()}
    fitted.host.obeys[:] = [lambda at_ns: False]
    mux.write(b"\x05", 0, 1)
    mux.stop(0)
    assert passes(0, (1, 2, 3)) == (1, 2, 3)
    assert fitted.touched == {MuxHang(0.5): {"BMA twin"}}


def test_a_switch_of_the_multiplexer_adds_a_decaying_kick():
    fitted = board(MuxCrosstalk(kick_dps=0.6, decay_ms=2.0), "Gyro")
    element = fitted.element(of("Gyro"))
    assert element.sample(MS, 250.0, 1.0) == (0.0, 0.0, 0.0)
    fitted.host.switched[0](2 * MS)
    first, later = (np.array(element.sample(at, 250.0, 1.0)) for at in (2 * MS, 4 * MS))
    assert np.sqrt(np.mean(first**2)) == pytest.approx(0.6)
    assert later == pytest.approx(first / math.e)


def test_the_host_waits_before_transactions():
    with bus_with(SchedulerLatency(share=0.5, mean_ms=4.0)) as bus:
        begun = bus.clock.now_ns()
        for _ in range(2000):
            bus.transfer(BMA, b"\x00", 1)
        waited_ms = (bus.clock.now_ns() - begun) / 2000 / MS - 0.0937  # BUS-07
        assert waited_ms == pytest.approx(0.5 * 4.0, rel=0.15)


def test_a_warm_resonator_is_fast_by_its_error():
    resonator = HostResonator(error=5e-3, warm_up_s=30.0)
    gained = [resonator.shown(at * S) - at * S for at in (1000, 1001)]
    assert gained[1] - gained[0] == pytest.approx(5e-3 * S, rel=1e-6)
    assert gained[0] == pytest.approx(5e-3 * (1000 - 30) * S, rel=1e-6)
    assert resonator.shown(10 * MS) - 10 * MS < 100
    for shown_ns in (1, S, 12_345_678_901, 500 * S):
        at_ns = resonator.when(shown_ns)
        assert resonator.shown(at_ns) >= shown_ns > resonator.shown(at_ns - 1)


def test_a_ticking_kernel_shows_and_wakes_on_ticks():
    with bus_with(CoarseTimestamps(10.0)) as bus:
        assert isinstance(bus.clock, HostClock)
        bus.clock.sleep_until(15_600_000)
        assert bus.clock.now_ns() == 20 * MS
        bus.transfer(BMA, b"\x00", 1)
        assert bus.clock.now_ns() == 20 * MS
        bus.clock.advance(10 * MS)
        assert bus.clock.now_ns() == 30 * MS


def test_errors_of_two_clocks_add_up():
    fittings = [Fitting(clock, ("BMA",)) for clock in (HostResonator(0.1, 1.0), CoarseTimestamps(10.0))]
    host = IdealBoard(ARRAY, StillWorld(), 1, fittings)
    clock = host.host_clock(VirtualClock())
    assert isinstance(clock, HostClock)
    clock.sleep_until(10 * S + 1)
    assert clock.now_ns() == 10 * S + 10 * MS
    assert clock.shown(10 * S) == pytest.approx(10.9 * S, abs=10 * MS)


def test_the_hosts_clock_counts_from_power_on():
    world_clock = VirtualClock(100 * S)
    with bus_with(HostResonator(error=0.1, warm_up_s=1.0), clock=world_clock) as bus:
        begun = bus.clock.now_ns()
        assert begun == pytest.approx(100 * S, abs=MS)
        bus.clock.sleep_until(200 * S)
        assert world_clock.now_ns() == pytest.approx(100 * S + 100 * S / 1.1, rel=1e-2)
        assert bus.clock.now_ns() >= 200 * S

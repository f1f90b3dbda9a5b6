"""Twins on two channels are distinguished, marked where they are configured alike, and never confused."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.acquire import connect, record
from imuarray.acquire.bus_segment import alternating_orders, channel_of, routes_of
from imuarray.array import parse_array
from imuarray.bus import open_bus
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE


@pytest.fixture
def connected(an_array: Callable[..., Any], tapped: Callable[..., Any]) -> Callable[..., Any]:
    """``connected(A=0, B=1)``: the bus, and the `Channel` of each segment."""

    def make(**channels: int | None) -> tuple[Any, list[Any]]:
        array = an_array(**channels)
        bus = tapped(array)
        routes = connect(array, bus)
        return bus, [channel_of(part, routes, 40) for part in alternating_orders(routes)[0]]

    return make


def test_channels_without_twins_need_no_check(connected: Callable[..., Any]) -> None:
    _, channels = connected(A=0, B=1, G=None)
    assert channels == [None, None, None]


@pytest.mark.parametrize(
    ("kind", "address", "register", "marks"),
    [("A", 0x53, 0x1D, (1, 2)), ("B", 0x40, 0x2C, (1, 2)), ("G", 0x68, 0x2E, (1, 2))],
)
def test_twins_that_are_configured_alike_are_marked(
    connected: Callable[..., Any], kind: str, address: int, register: int, marks: tuple[int, int]
) -> None:
    """Threshold of taps (ADX-11), customer byte (BMA-35), watermark of the queue (L3G-20): none acts on readings."""
    bus, channels = connected(**{f"{kind}1": 0, f"{kind}2": 1})
    for order, channel, mark in ((b"\x04", channels[0], marks[0]), (b"\x05", channels[1], marks[1])):
        bus.transfer(0x70, order)
        assert bus.transfer(address, bytes([register]), 1) == bytes([mark])
        assert channel.is_connected()
        assert not channels[2 - mark].is_connected()  # the other one


def test_a_sensor_without_a_twin_is_not_marked(connected: Callable[..., Any]) -> None:
    bus, _ = connected(A=0, B=1)
    bus.transfer(0x70, b"\x04")
    assert bus.transfer(0x53, b"\x1d", 1) == b"\x00"


def test_twins_without_a_mark_register_are_identified_by_another_chip_on_the_channel(
    connected: Callable[..., Any],
) -> None:
    """Two magnetometers look alike; only the first has an accelerometer on its channel."""
    bus, (first, second) = connected(M1=0, A=0, M2=1)
    bus.transfer(0x70, b"\x04")
    assert first.is_connected()
    assert not second.is_connected()  # its own witness is the multiplexer's control byte
    bus.transfer(0x70, b"\x05")
    assert second.is_connected()
    assert not first.is_connected()


def test_a_chip_that_was_reset_or_is_gone_does_not_make_its_channel_wrong(connected: Callable[..., Any]) -> None:
    bus, (first, _) = connected(B1=0, G1=0, B2=1, G2=1)
    bus.transfer(0x70, b"\x04")
    for name in ("B1", "G1"):
        bus.chips[name].power_on(bus.clock.now_ns())
        bus.clock.sleep_until(bus.clock.now_ns() + 50_000_000)
        assert all(first.is_connected() for _ in range(4))
    bus.fails = lambda call: call.address in (0x40, 0x68)
    assert all(first.is_connected() for _ in range(4))


def test_a_check_does_not_switch_the_multiplexer(connected: Callable[..., Any]) -> None:
    bus, (first, _) = connected(A1=0, A2=1)
    bus.transfer(0x70, b"\x05")
    before = len(bus.calls)
    assert not first.is_connected()
    assert [call for call in bus.calls[before:] if call.address == 0x70 and call.write] == []


def test_witnesses_take_turns_and_the_matching_witness_is_stated(connected: Callable[..., Any]) -> None:
    bus, (first, _) = connected(B1=0, A=0, B2=1)
    bus.transfer(0x70, b"\x04")
    number = len(first.witnesses)
    turns = [(first.is_connected(), first.witnesses.index(first.right_witness))[1] for _ in range(2 * number)]
    assert {witness.route.sensor.name for witness in first.witnesses} == {"A", "B1"}
    assert [(after - before) % number for before, after in pairwise(turns)] == [1] * (2 * number - 1)


@pytest.mark.slow
def test_checking_channels_loses_no_reading(board: Callable[..., Any]) -> None:
    done = board(A1=0, B1=0, G1=0, A2=1, B2=1, G2=1).record(seconds=3)
    assert sum(done.lost.values()) == done.late == done.missed == 0


def test_making_routes_sends_nothing(an_array: Callable[..., Any], tapped: Callable[..., Any]) -> None:
    array = an_array(A1=0, A2=1)
    bus = tapped(array)
    routes_of(array, bus)
    assert bus.calls == []


@pytest.mark.slow
def test_only_queues_drained_on_the_wrong_channel_are_lost(tmp_path: Path) -> None:
    """For 0.2 s the other channel is connected: the samples in the queues of both gyroscopes at 0x68 are lost
    or of the other. The queue of the accelerometer on the trunk was read normally.
    """
    gyroscope = 'chip="l3g4200d"\naddress=0x68\nrange=250\nrate_hz=100\nbandwidth_hz=12.5\nfifo=true\n'
    array = parse_array(
        '[array]\nname="a"\nmux={chip="pca9544a",address=0x70}\n'
        f'[[sensor]]\nname="G"\nchannel=0\n{gyroscope}[[sensor]]\nname="H"\nchannel=1\n{gyroscope}'
        '[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=4\nrate_hz=100\nfifo=true\n'
    )
    (tmp_path / "f.toml").write_text('[[fault]]\nkind="wrong_channel"\nat_s=3.0\nfor_s=0.2\n')
    with open_bus(f"emulated:?faults={tmp_path / 'f.toml'}", array) as bus:
        record(array, bus, tmp_path / "r.h5", rate_hz=20, seconds=6)
    with open_log(tmp_path / "r.h5") as log:
        begun_s = min(event.time_ns for event in log.events if event.kind == "channel") * 1e-9
        lost = {name: log[name].time[:][(np.asarray(log[name].status) & LOST_BEFORE) != 0] * 1e-9 for name in "GHA"}
    assert not len(lost["A"])
    for name in "GH":
        assert len(lost[name]) and ((lost[name] > begun_s - 0.1) & (lost[name] < begun_s + 0.4)).all()

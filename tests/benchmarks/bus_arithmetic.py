"""How much bus one frame of the paper's array takes, counted on the emulated wire, beside naive byte-wise reads.

The peer is the usual way: every data register of every chip by a transaction of its own (36 clocks, BUS-07), the
multiplexer written before each chip (18 clocks), one write to start a conversion of the barometer. Counted by the same
wire.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compare import Row, row

from imuarray.acquire.bus_segment import connect
from imuarray.acquire.recorder import Poll
from imuarray.acquire.recording import RecordingOptions
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.log.writer import LogWriter

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"

DATA_REGISTERS = {
    "adxl345": range(0x32, 0x38),
    "bma180": range(0x02, 0x09),
    "l3g4200d": range(0x26, 0x2E),
    "bmp180": range(0xF6, 0xF9),
    "hmc5883": range(0x03, 0x09),
}
PAPER_FRAMES_PER_S = 48.0
"""(std/sem)^2 / 900 s of the paper's Table 10."""


def naive_frame(array: Any, bus: Any) -> None:
    """One reading of every sensor, byte by byte."""
    for sensor in array.sensors:
        bus.transfer(array.mux.address, bytes([0x04 | sensor.channel]))
        if sensor.chip == "bmp180":
            bus.transfer(sensor.address, b"\xf4\x34")
        for register in DATA_REGISTERS[sensor.chip]:
            bus.transfer(sensor.address, bytes([register]), 1)


def naive() -> tuple[float, float, float]:
    """SCL clocks, transactions and bus time (s) of a naive frame."""
    array = load_array(CONFIG)
    with open_bus("emulated:", array) as bus:
        connect(array, bus)
        wire: Any = bus.wire  # type: ignore[attr-defined]
        clocks, transactions, start_ns = wire.scl_clocks, wire.transactions, bus.clock.now_ns()
        for _ in range(100):
            naive_frame(array, bus)
        seconds = (bus.clock.now_ns() - start_ns) * 1e-9
        return (wire.scl_clocks - clocks) / 100, (wire.transactions - transactions) / 100, seconds / 100


def ours(folder: Path, rate_hz: float) -> tuple[float, float, float, float]:
    """Mean and largest SCL clocks, transactions and bus time (s) of a frame at `rate_hz`, self-check included."""
    array = load_array(CONFIG)
    with open_bus("emulated:", array) as bus:
        stations = connect(array, bus)
        wire: Any = bus.wire  # type: ignore[attr-defined]
        headers: list[Any] = []
        with LogWriter(
            folder / "frame.h5", headers, source="emulated", epoch="1970-01-01T00:00:00Z", force=True
        ) as log:
            poll = Poll(stations, bus, log, RecordingOptions(rate_hz), 0)
            poll.write = lambda: None  # type: ignore[method-assign]  # the wire is measured, not the file
            clocks, times, transactions = [], [], wire.transactions
            due_ns = bus.clock.now_ns()
            for _ in range(1000):
                before, start_ns = wire.scl_clocks, bus.clock.now_ns()
                poll.frame()
                clocks.append(wire.scl_clocks - before)
                times.append(bus.clock.now_ns() - start_ns)
                due_ns += round(1e9 / rate_hz)
                bus.clock.sleep_until(due_ns)
            return sum(clocks) / 1000, max(clocks), (wire.transactions - transactions) / 1000, sum(times) * 1e-12


def rows() -> list[Row]:
    """SCL clocks, transactions and frames per second of bus time."""
    import tempfile

    naive_clocks, naive_transactions, _ = naive()
    with tempfile.TemporaryDirectory() as folder:
        clocks, _, transactions, frame_s = ours(Path(folder), PAPER_FRAMES_PER_S)
    return [
        row(
            "SCL clocks a frame of martin2013, one self-check read included",
            clocks,
            naive_clocks,
            "clocks",
            1080 / 3087,
            "lower",
        ),
        row("transactions a frame of martin2013", transactions, naive_transactions, "transactions", 15 / 92, "lower"),
        row(
            "frames per second of bus time at 400 kHz", 1 / frame_s, PAPER_FRAMES_PER_S, "frames/s", 360 / 48, "higher"
        ),
    ]

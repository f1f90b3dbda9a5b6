"""A whole array on the emulated bus, opened by arguments and by the parameters of a URL."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

import firmware_emulator
from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.clock import VirtualClock
from firmware_emulator.world import TumbleWorld, WorldStimulus

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
S = 10**9


def sensor(
    name: str, chip: str, address: int, channel: int | None = None, bus: str | None = None, range_: float | None = 16
) -> SimpleNamespace:
    return SimpleNamespace(
        name=name,
        chip=chip,
        channel=channel,
        bus=bus,
        address=address,
        range=range_,
        orientation=IDENTITY,
        position_mm=(0.0, 0.0, 0.0),
    )


def array(*sensors: SimpleNamespace, mux: bool = True) -> SimpleNamespace:
    config = SimpleNamespace(chip="pca9544a", address=0x70) if mux else None
    return SimpleNamespace(name="mine", mux=config, sensors=sensors)


TWELVE = array(
    sensor("ADXL1", "adxl345", 0x53, 0),
    sensor("ADXL2", "adxl345", 0x1D, 0),
    sensor("BMA1", "bma180", 0x40, 0),
    sensor("BMA2", "bma180", 0x41, 0),
    sensor("BMA3", "bma180", 0x40, 1, range_=1.5),
    sensor("BMA4", "bma180", 0x41, 1, range_=1.5),
    sensor("Gyro1", "l3g4200d", 0x68, 0, range_=2000),
    sensor("Gyro2", "l3g4200d", 0x69, 0, range_=2000),
    sensor("Gyro3", "l3g4200d", 0x68, 1, range_=250),
    sensor("BMP180", "bmp180", 0x77, 0, range_=None),
    sensor("HMC1", "hmc5883l", 0x1E, 0, range_=1.3),
    sensor("HMC2", "hmc5883", 0x1E, 1, range_=1.2),
)
IDENTITIES = {
    "adxl345": (0x00, b"\xe5"),
    "bma180": (0x00, b"\x03"),
    "l3g4200d": (0x0F, b"\xd3"),
    "bmp180": (0xD0, b"\x55"),
    "hmc5883": (0x0A, b"H"),
    "hmc5883l": (0x0A, b"H"),
}


def adxl_readings(bus: EmulatedBus, count: int = 5) -> bytes:
    bus.transfer(0x70, b"\x04")
    bus.transfer(0x53, b"\x31\x0b")
    bus.transfer(0x53, b"\x2d\x08")
    read = b""
    for _ in range(count):
        bus.clock.sleep_until(bus.clock.now_ns() + 20_000_000)
        read += bus.transfer(0x53, b"\x32", 6)
    return read


def test_every_chip_answers_at_its_address_and_channel() -> None:
    with open_array(TWELVE) as bus:
        assert set(bus.chips) == {soldered.name for soldered in TWELVE.sensors}
        for soldered in TWELVE.sensors:
            bus.transfer(0x70, bytes([4 + soldered.channel]))
            register, identity = IDENTITIES[soldered.chip]
            assert bus.transfer(soldered.address, bytes([register]), 1) == identity, soldered.name
        bus.transfer(0x70, b"\x05")
        with pytest.raises(OSError) as caught:
            bus.transfer(0x53, b"\x00", 1)
        assert caught.value.errno == 121
        assert bus.source == "emulated"


def test_bytes_of_a_chip_depend_on_the_seed_and_not_on_other_chips() -> None:
    whole = adxl_readings(open_array(TWELVE, seed=3))
    assert adxl_readings(open_array(TWELVE, seed=3)) == whole
    assert adxl_readings(open_array(TWELVE, seed=4)) != whole
    assert adxl_readings(open_array(array(*TWELVE.sensors[:1]), seed=3)) == whole


def test_channels_of_the_kernel_are_separate_buses() -> None:
    board = array(
        sensor("A", "adxl345", 0x53, bus="/dev/i2c-11"),
        sensor("B", "bma180", 0x40, bus="/dev/i2c-12"),
        sensor("C", "l3g4200d", 0x68),
        mux=False,
    )
    with open_array(board) as bus:
        assert bus.channel_bus("/dev/i2c-11").transfer(0x53, b"\x00", 1) == b"\xe5"
        assert bus.channel_bus("/dev/i2c-12").transfer(0x40, b"\x00", 1) == b"\x03"
        assert bus.transfer(0x68, b"\x0f", 1) == b"\xd3"
        with pytest.raises(OSError):
            bus.transfer(0x53, b"\x00", 1)
        with pytest.raises(FileNotFoundError):
            bus.channel_bus("/dev/i2c-13")
        assert bus.clock.now_ns() == 3 * 93_700 + 25_000  # one clock for all


def test_the_time_of_a_scan_matches_the_bus_arithmetic() -> None:
    """BUS-08: four BMA180 with temperature, two ADXL345, three L3G4200D, two HMC5883L and four selects take 2548 us."""
    with open_array(TWELVE) as bus:
        begun_ns = bus.clock.now_ns()
        for channel, reads in ((0, ((0x40, 7), (0x41, 7))), (1, ((0x40, 7), (0x41, 7))), (0, ((0x53, 6), (0x1D, 6)))):
            bus.transfer(0x70, bytes([4 + channel]))
            for address, count in reads:
                bus.transfer(address, b"\x02", count)
        for address in (0x68, 0x69, 0x1E):
            bus.transfer(address, b"\xa8", 6)
        bus.transfer(0x70, b"\x05")
        for address in (0x68, 0x1E):
            bus.transfer(address, b"\xa8", 6)
        assert round((bus.clock.now_ns() - begun_ns) / 1000) == 2548


def test_a_tumbling_board_measures_gravity_and_has_phases() -> None:
    with open_array(array(*TWELVE.sensors[:1]), world=TumbleWorld(face_s=1.0, turn_s=0.5)) as bus:
        adxl_readings(bus, 1)
        assert [phase.name for phase in bus.phases][:2] == ["z_up", "x_up"]
        codes = {}
        for start_ns, _, name, _ in bus.phases:
            bus.clock.sleep_until(start_ns + S // 2)
            data = bus.transfer(0x53, b"\x32", 6)
            codes[name] = [int.from_bytes(data[i : i + 2], "little", signed=True) for i in (0, 2, 4)]
            assert max(bus.truth(bus.clock.now_ns()).force_box, key=abs) == pytest.approx(
                9.80665 if "up" in name else -9.80665
            )
        # 10 % of scale and 250 mg of bias are all that the data sheet allows (ADX-40, ADX-61)
        for name, axis, sign in (("z_up", 2, 1), ("x_up", 0, 1), ("y_up", 1, 1), ("x_down", 0, -1), ("z_down", 2, -1)):
            assert 256 * 0.65 < sign * codes[name][axis] < 256 * 1.35


def test_a_world_begins_when_the_array_is_opened() -> None:
    asked: list[int] = []

    def world(at_ns: int) -> WorldStimulus:
        asked.append(at_ns)
        return WorldStimulus()

    with open_array(array(*TWELVE.sensors[:1]), clock=VirtualClock(start_ns=50 * S), world=world) as bus:
        bus.truth(51 * S)
        assert asked == [S]
        assert bus.phases == ()


def test_the_real_clock_is_used_on_request() -> None:
    with firmware_emulator.open_bus({"clock": "real", "world": "tumble", "face_s": "7"}, TWELVE) as bus:
        before = time.monotonic_ns()
        assert 0 <= before - bus.phases[0].start_ns < S
        assert bus.phases[0].end_ns - bus.phases[0].start_ns == 7 * S
        bus.transfer(0x70, b"\x04")
        bus.transfer(0x53, b"\x2d\x08")
        for _ in range(20):
            bus.transfer(0x53, b"\x32", 6)
        assert before <= bus.clock.now_ns() <= time.monotonic_ns()
        bus.clock.sleep_until(bus.clock.now_ns() + 15_000_000)
        assert bus.transfer(0x53, b"\x30", 1)[0] & 0x80
        assert bus.transfer(0x53, b"\x32", 6) != bytes(6)


def test_parameters_of_a_url_apply() -> None:
    query = {"world": "still", "up": " X", "temperature_degc": "30", "seed": "9", "bit_rate": "100000", "errno": "6"}
    with firmware_emulator.open_bus(query, TWELVE) as bus:
        assert bus.truth(0).force_box == (9.80665, 0.0, 0.0)  # the + of up=+X arrives as a space
        assert bus.truth(0).temperature_degc == 30.0
        assert bus.phases[0].up == "+X"
        bus.transfer(0x70, b"\x04")
        assert bus.clock.now_ns() == 192_700
        with pytest.raises(OSError) as caught:
            bus.transfer(0x31)
        assert caught.value.errno == 6
        assert adxl_readings(bus) == adxl_readings(firmware_emulator.open_bus(query, TWELVE))
    assert firmware_emulator.open_bus({"up": "-Y"}, TWELVE).phases[0].up == "-Y"
    assert firmware_emulator.open_bus({"world": "heating", "scale": "0.1"}, TWELVE).phases[0].end_ns == 30 * S


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"wurld": "still"}, "allowed are clock, world, seed, bit_rate, errno, oscillators, pulse_hz, up"),
        ({"wrld": "still"}, r"did you mean world\?"),
        ({"world": "stil"}, r"did you mean still\?"),
        ({"mechanism": "mains_riple", "sensor": "Gyro2"}, r"did you mean mains_ripple\?"),
        ({"mechanism": "mains_ripple", "sensor": "gyro2"}, r"did you mean Gyro2\?"),
        ({"face_s": "3"}, "face_s: no such parameter"),
        ({"world": "moon"}, "allowed are still, tumble, heating, shaking"),
        ({"clock": "sundial"}, "allowed are virtual, real"),
        ({"errno": "5"}, "allowed are 6, 121"),
        ({"seed": "-1"}, "seed=-1; allowed is a whole number"),
        ({"bit_rate": "0"}, "bit_rate_hz"),
        ({"up": "up"}, r"allowed are \+X, -X"),
        ({"world": "tumble", "face_s": "long"}, "face_s=long; allowed is a number"),
        ({"world": "tumble", "face_s": "nan"}, "face_s=nan"),
        ({"world": "tumble", "face_s": "0"}, "face_s: 0.0; allowed is anything above 0"),
    ],
)
def test_invalid_parameters_are_refused(query: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        firmware_emulator.open_bus(query, TWELVE)
    assert "\n" not in str(caught.value)


def test_invalid_boards_are_refused() -> None:
    with pytest.raises(ValueError, match="no mux"):
        open_array(array(*TWELVE.sensors, mux=False))
    with pytest.raises(ValueError, match="sensor A: chip 'mpu6050'; allowed are adxl345"):
        open_array(array(sensor("A", "mpu6050", 0x68)))


def test_switches_apply_to_their_chips() -> None:
    """DEC-20: a burst past 0x2D goes on to 0x2E or wraps; a dirty start; by chip, and by sensor, which prevails."""
    switches = {"l3g4200d": {"wrap_always": True}, "Gyro2": {"wrap_always": False}, "ADXL1": {}}
    bus = open_array(TWELVE, switches=switches)
    bus.transfer(0x70, b"\x04")
    for address in (0x68, 0x69):
        bus.transfer(address, b"\xae\x07")  # watermark 7 in FIFO_CTRL, 0x2E
    wrapped, straight = (bus.transfer(address, b"\xad", 2) for address in (0x68, 0x69))
    assert wrapped[1] == 0
    assert straight[1] == 0x07
    with pytest.raises(ValueError, match=r"switches for Nobody: allowed are sensors of the array and chips"):
        open_array(TWELVE, switches={"Nobody": {}})
    with pytest.raises(ValueError, match=r"sensor BMA1: .*'nonsense'"):
        open_array(TWELVE, switches={"BMA1": {"nonsense": 1}})

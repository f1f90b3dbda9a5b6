"""One simulated sensor: the same rows for any request, codes and flags as the chip and the logger give them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.array import parse_array
from imuarray.log.format import LOST_BEFORE, SATURATED, STALE
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.response import SizeEffect
from imuarray.simulate.effects.timing import OwnClock
from imuarray.simulate.model import parse_model
from imuarray.simulate.sensor import SimulatedBarometer, SimulatedSensor
from imuarray.simulate.signal import Instants, Place
from imuarray.simulate.simulation import Simulation, effects_of, plan_of
from imuarray.simulate.streams import CHUNK, DrawMemory
from tests.selection import examples

CHIPS = {
    "adxl345": "address = 0x53\nrange = 16\nrate_hz = 400",
    "bma180": "address = 0x40\nrange = 2",
    "l3g4200d": "address = 0x68\nrange = 250\nrate_hz = 400",
    "hmc5883l": "address = 0x1e\nrange = 1.3\nrate_hz = 75",
}


def simulation(
    motion: Any, chip: str = "bma180", effects: tuple[Effect, ...] = (), *, rate_hz: float = 50.0, seconds: float = 1.0,
    settings_of_chip: str | None = None, **options: Any,
) -> Simulation:  # fmt: skip
    text = f'[array]\nname = "a"\n[[sensor]]\nname = "S"\nchip = "{chip}"\n{settings_of_chip or CHIPS[chip]}'
    return Simulation(plan_of(parse_array(text), rate_hz, seconds), motion, {"S": effects}, **options)


def sensor(*arguments: Any, **options: Any) -> SimulatedSensor:
    simulated = simulation(*arguments, **options).sensors["S"]
    assert isinstance(simulated, SimulatedSensor)
    return simulated


def test_an_ideal_sensor_reads_the_data_sheets_test_vector(constant: Any) -> None:
    # one g upwards: 256 counts per g (ADX-40), 4096 (BMA-73); a field of (0.2, 0, -0.4) gauss at 1090 (HMC-21)
    assert sensor(constant(), "adxl345").block(0, 3).counts.tolist() == [[0, 0, 256]] * 3
    assert sensor(constant(), "bma180").block(0, 1).counts.tolist() == [[0, 0, 4096]]
    assert sensor(constant(), "hmc5883l").block(0, 1).counts.tolist() == [[218, 0, -436]]
    spun = constant(rate_box=(0.0, np.radians(8.75), 0.0))
    assert sensor(spun, "l3g4200d").block(0, 1).counts.tolist() == [[0, 1000, 0]]  # 8.75 mdps a count: L3G-40


def test_axes_rotate_the_box_into_the_sensor(constant: Any) -> None:
    turned = sensor(constant(force_box=(1 * 9.80665, 2 * 9.80665, 3 * 9.80665)), "adxl345",
                    settings_of_chip='address = 0x53\nrange = 16\naxes = "-Y+X+Z"')  # fmt: skip
    # x points along -Y, y along +X
    assert turned.block(0, 1).counts.tolist() == [[-512, 256, 768]]


@pytest.mark.parametrize(
    ("chip", "force", "expected"),
    [
        ("adxl345", 20.0, 4095),  # 13 bits in the 16 g range: ADX-46
        ("adxl345", -20.0, -4096),
        ("bma180", 3.0, 8191),  # 14 bits: BMA-60
        ("bma180", -3.0, -8192),
    ],
)
def test_codes_end_at_the_span_and_are_flagged(constant: Any, chip: str, force: float, expected: int) -> None:
    block = sensor(constant(force_box=(0.0, force * 9.80665, 0.0)), chip).block(0, 2)
    assert block.counts[:, 1].tolist() == [expected] * 2
    assert (block.status & SATURATED).all()


@pytest.mark.parametrize(
    ("chip", "address", "lowest", "degc", "temperature"),
    [
        ("icm42688", 0x68, -32767, 35.0, 1325),  # -32768 is no reading: TDK-13; 132.48 a degC above 25: TDK-32
        ("lsm6dso", 0x6A, -32768, 35.0, 2560),  # LSM-32
        ("mpu9250", 0x68, -32768, 31.0, 3339),  # 333.87 a degC above 21: INV-76
        ("mpu6050", 0x68, -32768, 36.0, -181),  # -521 at 35 degC and 340 a degC: INV-42
    ],
)
def test_six_axis_chips_saturate_and_measure_their_temperature(
    constant: Any, chip: str, address: int, lowest: int, degc: float, temperature: int
) -> None:
    motion = constant(force_box=(-99.0, 99.0, 0.0), temperature_degc=degc)
    block = sensor(motion, f"{chip}_acc", settings_of_chip=f"address = {address}\nrange = 4").block(0, 1)
    assert block.counts.tolist() == [[lowest, 32767, 0]]
    assert block.status[0] & SATURATED
    assert block.temperature_counts is not None
    assert block.temperature_counts.tolist() == [temperature]


def test_a_magnetometer_beyond_its_span_is_flagged(constant: Any) -> None:
    block = sensor(constant(field_box=(2.0, 0.0, 0.0)), "hmc5883l").block(0, 1)
    assert block.counts[0, 0] == -4096  # HMC-32
    assert block.status[0] & SATURATED


def test_a_fast_adxl345_has_only_even_codes(constant: Any) -> None:
    def ramp(seconds: Any) -> Any:
        return np.outer(seconds, [9.80665, 0.0, 0.0])

    fast = sensor(constant(force_box=ramp), "adxl345", rate_hz=400.0, seconds=2.0,
                  settings_of_chip="address = 0x53\nrange = 16\nrate_hz = 1600")  # fmt: skip
    codes = fast.block(0, 800).counts[:, 0]
    assert (codes % 2 == 0).all()  # ADX-47
    assert set(np.diff(np.unique(codes)).tolist()) == {2}


def test_a_slow_chip_repeats_readings_flagged_stale(constant: Any) -> None:
    def ramp(seconds: Any) -> Any:
        return np.outer(np.asarray(seconds), [9.80665, 0.0, 0.0])

    # 50 readings a second, asked 100 times: each reading twice, the second time stale
    slow = sensor(constant(force_box=ramp), "adxl345", rate_hz=100.0, seconds=2.0,
                  settings_of_chip="address = 0x53\nrange = 16\nrate_hz = 50")  # fmt: skip
    block = slow.block(8, 48)
    runs = block.counts[:, 0].reshape(20, 2)
    assert (runs == runs[:, :1]).all()
    assert (np.diff(runs[:, 0]) > 0).all()
    assert ((block.status & STALE) != 0).reshape(20, 2).tolist() == [[False, True]] * 20


def test_thermometers_have_the_scales_of_the_data_sheets(constant: Any) -> None:
    bma = sensor(constant(temperature_degc=25.0)).block(0, 1)
    assert bma.temperature_counts is not None
    assert bma.temperature_counts.tolist() == [2]  # 0 at 24 degC, half a degree a count: BMA-63
    warmer, cooler = (
        sensor(constant(temperature_degc=degc), "l3g4200d").block(0, 1).temperature_counts for degc in (30.0, 20.0)
    )
    assert warmer is not None
    assert cooler is not None
    assert int(warmer[0]) - int(cooler[0]) == -10  # falls by one a degree: L3G-60
    assert sensor(constant(), "adxl345").block(0, 1).temperature_counts is None


def noisy() -> tuple[Effect, ...]:
    """One effect of each kind with memory or random draws."""
    return (
        EFFECTS["white_noise"](rms=0.01),  # type: ignore[call-arg]
        EFFECTS["bias_instability"](rms=0.01, time_constant_s=3.0),  # type: ignore[call-arg]
        EFFECTS["bandwidth"](cutoff_hz=5.0),  # type: ignore[call-arg]
        EFFECTS["popcorn_noise"](amplitude=0.02, switches_per_s=0.5),  # type: ignore[call-arg]
        EFFECTS["stale_samples"](probability=0.05),  # type: ignore[call-arg]
        EFFECTS["dropped_samples"](probability=0.02, burst_rows=3.0),  # type: ignore[call-arg]
        EFFECTS["jitter"](rms_s=1e-4),  # type: ignore[call-arg]
    )


SECONDS = (2 * CHUNK + 1000) / 400.0


def noisy_sensor(motion: Any, dtype: Any = np.float64, seed: int = 5) -> SimulatedSensor:
    return sensor(motion, "l3g4200d", noisy(), rate_hz=400.0, seconds=SECONDS, seed=seed, dtype=dtype)


@settings(max_examples=examples(15), deadline=None)
@given(start=st.integers(0, 2 * CHUNK), length=st.integers(1, CHUNK), single=st.booleans())
def test_any_block_alone_equals_that_of_the_whole(start: int, length: int, single: bool) -> None:
    motion = _Rest()
    dtype = np.float32 if single else np.float64
    whole = noisy_sensor(motion, dtype)
    everything = whole.block(0, whole.rows)
    stop = min(start + length, whole.rows)
    alone = noisy_sensor(motion, dtype).block(start, stop)
    stamps = whole.timeline.stamps(start, stop)
    rows = (everything.time >= stamps[0]) & (everything.time <= stamps[-1])
    for ours, theirs in zip(alone[:4], everything[:4], strict=True):
        np.testing.assert_array_equal(ours, np.asarray(theirs)[rows])


LATER = (
    (EFFECTS["white_noise"](rms=0.5),),  # type: ignore[call-arg]
    (EFFECTS["bandwidth"](cutoff_hz=20.0, share=1.0), EFFECTS["glitches"](probability=0.01)),  # type: ignore[call-arg]
    (EFFECTS["odr_error"](rate_hz=390.0),),  # type: ignore[call-arg]
    (EFFECTS["tone"](amplitude=2.0, frequency_hz=30.0, spans=(0.0, 20.0, 40.0)),),  # type: ignore[call-arg]
)


def test_sensors_share_the_signal_after_the_effects_they_begin_with() -> None:
    """Bit for bit, with different effects after the first two. The last sensor takes the signal of the first; an effect
    that changes the times of the readings, as in the third, has no signal in common.
    """
    memory, begin = DrawMemory(1 << 26), (noisy()[1], noisy()[3])
    for later in LATER:
        alone, sharing = (
            sensor(_Rest(), "l3g4200d", (*begin, *later), rate_hz=400.0, seconds=SECONDS, seed=5) for _ in range(2)
        )
        sharing.share(memory, "a log", 2)
        for ours, theirs in zip(sharing.block(3000, 20_000), alone.block(3000, 20_000), strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_a_dropped_row_is_missing_and_the_next_row_is_flagged(constant: Any) -> None:
    simulated = noisy_sensor(constant())
    block, lost = simulated.block(0, simulated.rows), simulated.lost_rows(0, simulated.rows)
    assert 0 < len(lost) < 0.05 * simulated.rows
    assert len(block.time) + len(lost) == simulated.rows
    stamps = simulated.timeline.stamps(0, simulated.rows)
    assert not np.isin(stamps[lost], block.time).any()
    after = np.setdiff1d(lost + 1, lost)
    flagged = block.time[(block.status & LOST_BEFORE) != 0]
    np.testing.assert_array_equal(flagged, stamps[after[after < simulated.rows]])


@dataclass(frozen=True)
class _LossEffect(Effect):
    """A row in five never arrives."""

    name: ClassVar[str] = "dropped_samples"

    def sampled(self, instants: Instants, at: Place) -> Instants:
        rows = instants.first + np.arange(len(instants.kept))
        return replace(instants, kept=rows % 5 != 0)


def test_a_loss_at_the_edge_of_a_chunk_is_flagged(constant: Any) -> None:
    simulated = sensor(constant(), "l3g4200d", (_LossEffect(),), rate_hz=400.0, seconds=(CHUNK + 100) / 400.0)
    block = simulated.block(CHUNK - 10, CHUNK + 10)
    stamps = simulated.timeline.stamps(0, simulated.rows)
    rows = np.searchsorted(stamps, block.time)
    np.testing.assert_array_equal((block.status & LOST_BEFORE) != 0, rows % 5 == 1)


@pytest.mark.parametrize(  # BMP-44 and steps of 1 Pa; BMP-125, BMP-223
    ("chip", "rms_pa", "step_pa", "step_degc"),
    [("bmp180", 3.0, 1.0, 0.1), ("bmp280", 1.3, 0.0, 0.01), ("bmp388", 1.3, 0.0, 0.01)],
)
def test_a_barometer_measures_temperature_and_pressure(
    constant: Any, chip: str, rms_pa: float, step_pa: float, step_degc: float
) -> None:
    text = f'[array]\nname = "a"\n[[sensor]]\nname = "P"\nchip = "{chip}"\naddress = 0x77'
    plan = plan_of(parse_array(text), 50.0, 100.0)
    result = Simulation(plan, constant(temperature_degc=31.4, pressure_pa=98_000.0), {}).sensors["P"]
    assert isinstance(result, SimulatedBarometer)
    block = result.block(0, result.rows)
    assert block.counts.dtype == np.int32
    np.testing.assert_allclose(block.compensated["temperature"], 31.4, atol=1.1 * step_degc)
    pressure = block.compensated["pressure"]
    # 400 rows: mean within 5 standard errors (steps included, of which the first that reaches a value is taken), spread
    # within 5 of its own
    assert abs(pressure.mean() - 98_000.0) < 5 * (rms_pa + 0.1) / 20 + 0.5 * step_pa + 0.1
    assert abs(pressure.std() - rms_pa) < 5 * rms_pa / np.sqrt(800)


class _Rest:
    """At rest, for tests that hypothesis calls many times."""

    phases: ClassVar[tuple[Any, ...]] = ()
    seconds: ClassVar[float] = 1e6

    def stimulus(self, time_ns: Any) -> Any:
        from imuarray.simulate.motion.stimulus import BoxStimulus

        n = len(time_ns)
        rest = np.broadcast_to(np.array([0.0, 0.0, 9.80665]), (n, 3))
        zero = np.broadcast_to(np.zeros(3), (n, 3))
        return BoxStimulus(time_ns, rest, zero, zero, zero, np.full(n, 25.0), np.full(n, 101325.0))


CROSSED = """
[array]
name = "a"
[[sensor]]
name = "A"
chip = "adxl345"
address = 0x53
range = 16
axes = "+X+Y+Z"
position_mm = [10.0, 0.0, 0.0]
[[sensor]]
name = "B"
chip = "adxl345"
address = 0x1d
range = 16
axes = "-Y+X+Z"
position_mm = [0.0, -30.0, 0.0]
"""


def test_a_sensor_can_be_read_in_the_place_of_another(constant: Any) -> None:
    """The sensor read as A is at the position of B: x along -Y, and 30 mm from the origin. Its header stays as the
    configuration has it, and the other one where it was.
    """
    plan = plan_of(parse_array(CROSSED), 50.0, 1.0)
    motion = constant(force_box=(1 * 9.80665, 2 * 9.80665, 3 * 9.80665))
    result = Simulation(plan, motion, {"A": (ChannelSwap("B", "place"),)})
    assert result.sensors["A"].block(0, 1).counts.tolist() == [[-512, 256, 768]]
    assert result.sensors["A"].header.axes == "+X+Y+Z"
    assert result.sensors["B"].block(0, 1).counts.tolist() == [[-512, 256, 768]]
    model = parse_model(
        '[model]\nname = "m"\n[[sensor]]\nname = "A"\nchip = "adxl345"\n'
        'channel_swap = { sensor = "B", kind = "place" }',
        "m",
    )
    effects = effects_of(plan, model, 0)
    places = {
        name: entry.position_mm for name, own in effects.items() for entry in own if isinstance(entry, SizeEffect)
    }
    assert places == {"A": (0.0, -30.0, 0.0), "B": (0.0, -30.0, 0.0)}
    with pytest.raises(ValueError, match=r"^channel_swap of A: C: not in this array; it has A, B$"):
        Simulation(plan, motion, {"A": (ChannelSwap("C", "place"),)})


def test_rows_slightly_above_the_nominal_rate_are_readings_unless_polled(
    constant: Any,
) -> None:
    """401 rows a second for 20 s: whose clock made them is not known, but for a host's. That host asks a chip of
    400 Hz 8020 times for 8000 readings.
    """
    asked = {"rate_hz": 401.0, "seconds": 20.0}
    own, polled = (
        sensor(constant(), "adxl345", (OwnClock(phase_deg=90.0, polled=polled),), **asked).block(0, 8020).status
        for polled in (0.0, 1.0)
    )
    assert not (own & STALE).any()
    assert np.count_nonzero(polled & STALE) == pytest.approx(20, abs=1)

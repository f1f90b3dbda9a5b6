"""A reading is reported as stale only when the chip must have had a newer one, however irregular the frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.acquire.sample_buffer import SampleBuffer
from imuarray.acquire.sensor_health import Freshness
from imuarray.array import ArrayConfig, SensorConfig, parse_array
from imuarray.log.format import LOST_BEFORE, STALE
from tests.reliability.night import array_of, night
from tests.selection import some

MS, SECOND = 1_000_000, 1_000_000_000
TOLERANCE = 0.15
"""A BMA180 may be 10 % slow (BMA-107); the others' data sheets don't say."""


def gyroscope(rate_hz: int) -> SensorConfig:
    return parse_array(
        f'[array]\nname="a"\n[[sensor]]\nname="G"\nchip="l3g4200d"\naddress=0x68\nrange=250\nrate_hz={rate_hz}\n'
    ).sensors[0]


def polled(
    rate_hz: float, reads_ns: npt.NDArray[np.int64], phase: float, frozen_ns: int = 1 << 62
) -> npt.NDArray[np.uint16]:
    """Status of reads of a chip that samples at `rate_hz` until `frozen_ns`: stale if nothing is new since the last."""
    samples = np.floor(np.minimum(reads_ns, frozen_ns) * 1e-9 * rate_hz + phase)
    return np.where(np.diff(samples, prepend=samples[0] - 1) == 0, STALE, 0).astype(np.uint16)


@st.composite
def irregular_reads(draw: st.DrawFn) -> npt.NDArray[np.int64]:
    """Frames with jitter, stalls and bursts: gaps of 0.3 ms to a second."""
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    frame_ms = draw(st.sampled_from([1.0, 2.5, 5.0, 10.0, 20.0, 100.0]))
    gaps = frame_ms * (1 + draw(st.floats(0, 0.9)) * rng.uniform(-1, 1, 600))
    gaps[rng.random(600) < draw(st.floats(0, 0.2))] = 0.3  # a burst
    gaps[rng.random(600) < draw(st.floats(0, 0.1))] *= 20  # a stall
    return np.cumsum(np.maximum(gaps, 0.3) * MS).astype(np.int64)


@given(
    irregular_reads(),
    st.sampled_from([100, 200, 400, 800]),
    st.floats(-TOLERANCE, TOLERANCE),
    st.floats(0, 1),
    st.integers(0, 1 << 32),
)
def test_a_working_chip_is_never_reported_as_stale(
    reads_ns: npt.NDArray[np.int64], rate_hz: int, error: float, phase: float, seed: int
) -> None:
    """The time of a read is known to a millisecond; blocks are cut anywhere."""
    rng = np.random.default_rng(seed)
    status = polled(rate_hz * (1 + error), reads_ns, phase)
    known_ns = reads_ns - rng.integers(0, MS, len(reads_ns))
    judge = Freshness(gyroscope(rate_hz))
    cuts = np.sort(rng.integers(0, len(reads_ns), 5))
    for times, flags in zip(np.split(known_ns, cuts), np.split(status, cuts), strict=True):
        assert not judge.overdue(times, flags, np.zeros(len(times), bool)).any()


@given(irregular_reads(), st.sampled_from([100, 200, 400, 800]), st.floats(-TOLERANCE, TOLERANCE), st.floats(0, 1))
def test_a_chip_without_new_readings_is_overdue_at_the_first_possible_read(
    reads_ns: npt.NDArray[np.int64], rate_hz: int, error: float, phase: float
) -> None:
    """At the first read that follows the last new reading by 1 / 0.85 periods and twice the millisecond."""
    frozen_ns = int(reads_ns[300])
    status = polled(rate_hz * (1 + error), reads_ns, phase, frozen_ns)
    late = Freshness(gyroscope(rate_hz)).overdue(reads_ns, status, np.zeros(len(reads_ns), bool))
    fetched_ns = reads_ns[np.flatnonzero(status == 0)[-1]]
    must_ns = fetched_ns + SECOND / rate_hz / 0.85 + 2 * MS
    np.testing.assert_array_equal(late, reads_ns > must_ns + 1)


@pytest.mark.parametrize("doubt", ["uncertain", "lost"])
def test_an_uncertain_or_lost_read_restarts_the_count(doubt: str) -> None:
    times = np.arange(0, 200, 20, dtype=np.int64) * MS
    status = np.full(10, STALE, np.uint16)
    status[0] = 0
    doubtful = np.zeros(10, bool)
    if doubt == "uncertain":
        doubtful[1:8] = True
    else:
        status[1:8] |= LOST_BEFORE
    late = Freshness(gyroscope(100)).overdue(times, status, doubtful)
    assert np.flatnonzero(late).tolist() == [9]  # since the read at 160 ms


def irregular_array() -> ArrayConfig:
    array = array_of(B=0, G=0, M=1)
    return parse_array(array.text.replace("rate_hz=75", "rate_hz=15"))


@pytest.mark.slow
@pytest.mark.parametrize("error", some([-0.1, 0.0, 0.1], 2, 0))
@pytest.mark.parametrize("rate_hz", some([10.0, 14.0, 90.0], 2, 0))
def test_stalls_and_slow_clocks_are_not_reported_as_stale(rate_hz: float, error: float) -> None:
    """A magnetometer of 15 Hz, asked at 10 and 14 Hz and as often as it measures; the program is held up at random."""
    rng = np.random.default_rng(3)
    stalls = [
        {"kind": "stall", "at_s": float(at_s), "for_s": float(rng.choice([0.01, 0.03, 0.07, 0.3]))}
        for at_s in np.sort(rng.uniform(1, 120, 150))
    ]
    switches = {"bma180": {"rate_error": error}, "l3g4200d": {"rate_error": error}}
    log = night(irregular_array(), stalls, 120, rate_hz=rate_hz, switches=switches).log
    assert {event.kind for event in log.events} <= {"late"}


@pytest.mark.parametrize(("kind", "event_kind"), some([("stale", "stale"), ("frozen", "frozen")], 3))
@pytest.mark.parametrize(("sensor", "within_s"), some([("B", 1.5), ("G", 1.5), ("M", 4.0)], 1))
def test_a_frozen_chip_is_reported_also_in_irregular_frames(
    kind: str, event_kind: str, sensor: str, within_s: float
) -> None:
    """Within a sweep and a second, or as long as 24 readings take (30 of 0.1 s, which wait for each other)."""
    table = {"kind": kind, "sensor": sensor, "at_s": 10.0, "for_s": 30.0}
    log = night(irregular_array(), [table], 30, rate_hz=50.0 if sensor != "M" else 10.0).log
    events = [event for event in log.events if event.sensor == sensor and event.kind in ("frozen", "stale")]
    assert events
    assert 9.0 * SECOND < events[0].time_ns < (10.0 + within_s) * SECOND


def reading_since(buffer: SampleBuffer, gaps_ms: list[float]) -> int | None:
    at_ns = 0
    for gap_ms in gaps_ms:
        at_ns += round(gap_ms * MS)
        buffer.add(bytes(buffer.driver.burst), at_ns)
    return buffer.frozen_since()


@pytest.mark.parametrize(("gap_ms", "frozen"), [(20.0, True), (0.5, False), (15.0, False), (18.4, True)])
def test_readings_that_repeat_faster_than_the_chip_measures_are_not_frozen(
    gap_ms: float, frozen: bool, an_array: Callable[..., Any], tapped: Callable[..., Any]
) -> None:
    """50 readings take a second at 50 Hz; in a burst of frames they take less, and then 50 equal ones mean nothing."""
    from imuarray.acquire.bus_segment import routes_of

    array = an_array(B=0)
    (route,) = routes_of(array, tapped(array))
    assert (reading_since(SampleBuffer(route, 50.0), [gap_ms] * 50) is not None) == frozen

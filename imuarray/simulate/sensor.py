"""One simulated sensor: any stretch of its rows, independent of the order and extent of requests.

Rows are computed in chunks of `CHUNK`, each together with the earlier rows that its effects need (`Effect.lookback`).
Blocks are cut from chunks, so their length does not change a result.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Integers, Reals
from imuarray.axes import Matrix
from imuarray.barometer import BAROMETERS
from imuarray.log.format import LOST_BEFORE, SATURATED, STALE, SensorHeader
from imuarray.log.writer import Block
from imuarray.simulate.active_spans import acting
from imuarray.simulate.converters import (
    code_span,
    convert,
    hold_readings,
    latest_reading,
    thermometer_counts,
    thermometer_of,
)
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.timing import AT_ITS_RATE, OwnClock
from imuarray.simulate.host_latency import DelayedTimes
from imuarray.simulate.signal import Analog, BoxStimulus, Codes, Instants, Motion, Place, per_row
from imuarray.simulate.streams import CHUNK, DrawMemory, Streams
from imuarray.simulate.timeline import Timeline
from imuarray.units import SI_PER_UNIT, STANDARD_GRAVITY

_WORTH_IT = 1024
"""Number of rows below which a request computes its whole chunk, because more of it will likely be requested."""

NO_READY_BIT = ("hmc5883", "hmc5883l", "mmc5983")
"""Chips whose ready bit no driver reads: only repeated triads show that a reading is stale."""

_COLUMN = {"specific_force": "force_box", "angular_rate": "rate_box", "magnetic_field": "field_box"}


Counts = npt.NDArray[np.int16] | npt.NDArray[np.int32]
"""Values in the form in which a log stores them."""


class Demand(Enum):
    """The rows that are required: any, so that whole chunks are computed; stretches `APART`, whose chunks are computed
    only if several are short; or `FEW` of each chunk, so that just these are computed.
    """

    ANY = auto()
    APART = auto()
    FEW = auto()


class Chunk(NamedTuple):
    """Computed rows: stamps, whether they arrive, codes, counts in the form of a log, flags."""

    stamp_ns: Integers
    kept: Booleans
    codes: Codes
    counts: Counts
    status: npt.NDArray[np.uint16]

    @property
    def nbytes(self) -> int:
        """The memory of all columns."""
        codes = (self.codes.instant_ns, self.codes.counts, self.codes.temperature_counts, self.codes.fresh)
        columns = (self.stamp_ns, self.kept, self.counts, self.status, *codes)
        return sum(column.nbytes for column in columns if column is not None)


@dataclass(frozen=True)
class Surroundings:
    """The data that all triads of a simulation share: the motion, the random streams, the function that returns a
    neighbour's codes by name and rows, and the type of the numbers.
    """

    motion: Motion
    streams: Streams
    neighbour: Callable[[str, int, int], Codes]
    dtype: npt.DTypeLike


class _SharedSignal(NamedTuple):
    """The memory that stores signals after the first `effects` acting effects, and the `owner` of these in it."""

    memory: DrawMemory
    owner: Hashable
    effects: int


class SimulatedSensor:
    """A triad; `block(start, stop)` returns rows in the form of a log."""

    def __init__(
        self,
        header: SensorHeader,
        timeline: Timeline,
        effects: Sequence[Effect],
        surroundings: Surroundings,
        lies: Matrix | None = None,
    ) -> None:
        """Create the triad. `lies` is the true orientation, if it differs from that of the header."""
        self.header = header
        self.timeline = timeline
        self.effects = tuple(effects)
        self.rows = timeline.rows
        motion, streams = surroundings.motion, surroundings.streams
        self._motion = motion
        waits = timeline.waits if isinstance(timeline, DelayedTimes) else None
        self._place = Place(
            header,
            timeline.rows_per_s,
            motion,
            streams,
            surroundings.neighbour,
            self._reaching,
            timeline.stamps,
            surroundings.dtype,
            waits,
        )
        self._span = code_span(header)
        self._orientation = np.array(lies or header.orientation)
        places = zip(self.effects, self._places(), strict=True)
        acting_effects = [(acting(effect, streams.boot), at) for effect, at in places]
        self._acting = tuple((effect, at) for effect, at in acting_effects if effect is not None)
        self._is_late = any(effect.name == "jitter" for effect in self.effects)
        self._is_polled = any(isinstance(effect, OwnClock) and effect.polled for effect in self.effects)
        self._lookback = (
            1 + 2 * self._is_polled + self._held_rows() + sum(effect.lookback(at) for effect, at in self._acting)
        )
        self._chunk: Callable[[int, bool], Chunk] = lru_cache(maxsize=4)(self._evaluate_chunk)
        self._alone: Callable[[int, int], Block] = self._rows_alone
        self._shared: _SharedSignal | None = None

    def remember(self, memory: DrawMemory, owner: Hashable) -> None:
        """Keep computed rows in a memory, as those of `owner`, instead of keeping only the latest in this sensor."""

        def chunk(number: int, swapped: bool) -> Chunk:
            key = (owner, number, swapped)
            return memory.recall(key, lambda: self._evaluate_chunk(number, swapped), lambda rows: rows.nbytes)

        def alone(begin: int, end: int) -> Block:
            return memory.recall((owner, "alone", begin, end), lambda: self._rows_alone(begin, end), _bytes_of_rows)

        self._chunk, self._alone = chunk, alone

    def share(self, memory: DrawMemory, owner: Hashable, count: int) -> None:
        """Keep the signal after the first `count` effects in a memory, in which it belongs to `owner`: simulations that
        differ only in later effects share it, unless one of these changes the read times or the stimulus.
        """
        chosen, later = self.effects[:count], self.effects[count:]
        if not any(_changes_input_signal(effect) for effect in later):
            boot = self._place.streams.boot
            acting_count = sum(acting(effect, boot) is not None for effect in chosen)
            self._shared = _SharedSignal(memory, (owner, chosen), acting_count)

    def block(self, start: int, stop: int, demand: Demand = Demand.ANY) -> Block:
        """Return those of the rows start ... stop - 1 that arrive (fewer than stop - start if readings are dropped).
        Depending on the `demand`, only these rows are computed if that costs less than their chunks; the result is the
        same, but for rounding if effects need earlier rows.
        """
        parts = [self._arriving(chunk, start, stop, demand) for chunk in range(start // CHUNK, -(-stop // CHUNK))]
        if len(parts) == 1:
            return parts[0]
        time, counts, status, temperature, _ = zip(*parts, strict=True)
        has_temperature = self.header.has_temperature
        return Block(
            np.concatenate(time),
            np.concatenate(counts),
            np.concatenate(status),
            np.concatenate(temperature) if has_temperature else None,
        )

    def codes(self, first: int, stop: int) -> Codes:
        """Return the codes of rows first ... stop - 1, including dropped ones, without a channel swap; ValueError
        beyond the last row.
        """
        if stop > self.rows:
            raise ValueError(f"{self.header.name}: row {stop - 1} of {self.rows}")
        parts = [
            self._chunk(chunk, False).codes.rows(first, stop) for chunk in range(first // CHUNK, -(-stop // CHUNK))
        ]
        return parts[0] if len(parts) == 1 else _join(parts)

    def lost_rows(self, start: int, stop: int) -> Integers:
        """Return the numbers of the rows in start ... stop - 1 that do not arrive."""
        lost = [
            chunk * CHUNK + np.flatnonzero(~self._chunk(chunk, True).kept)
            for chunk in range(start // CHUNK, -(-stop // CHUNK))
        ]
        rows = np.concatenate(lost)
        return np.asarray(rows[(rows >= start) & (rows < stop)])

    def _arriving(self, number: int, start: int, stop: int, demand: Demand) -> Block:
        begin, end = max(start, number * CHUNK), min(stop, (number + 1) * CHUNK, self.rows)
        is_few = demand is Demand.FEW and end - begin + self._lookback < CHUNK // 2
        if is_few or (demand is not Demand.ANY and _WORTH_IT <= end - begin < CHUNK - self._lookback):
            return self._alone(begin, end)
        chunk, begin = self._chunk(number, True), number * CHUNK
        return _arriving_of(chunk, max(start - begin, 0), min(stop - begin, len(chunk.kept)))

    def _places(self) -> Iterator[Place]:
        """Yield a place for each effect; several effects of one kind have different random streams."""
        counts: Counter[str] = Counter()
        for effect in self.effects:
            counts[effect.name] += 1
            yield self._place if counts[effect.name] == 1 else replace(self._place, copy=counts[effect.name])

    def _held_rows(self) -> int:
        rate_hz = self.header.rate_hz
        return math.ceil(self.timeline.rows_per_s / rate_hz) + 1 if 0 < rate_hz < self.timeline.rows_per_s else 0

    def _evaluate_chunk(self, number: int, swapped: bool) -> Chunk:
        return self._evaluate(number * CHUNK, min((number + 1) * CHUNK, self.rows), swapped)

    def _rows_alone(self, begin: int, end: int) -> Block:
        """Return those rows of a part of a chunk that arrive."""
        return _arriving_of(self._evaluate(begin, end), 0, end - begin)

    def _evaluate(self, begin: int, end: int, swapped: bool = True) -> Chunk:
        """Compute rows begin ... end - 1 with the sensor's own channel swap, or without it if a neighbour asks."""
        first = max(0, begin - self._lookback)
        acting = [(effect, at) for effect, at in self._acting if swapped or effect.name != "channel_swap"]
        instants, codes = self._chain(first, end, acting)
        cut = slice(begin - first, None)
        narrow = self.header.count_bits <= 16
        counts: Counts = codes.counts.astype(np.int16) if narrow else codes.counts.astype(np.int32)
        status = self._status(counts, codes.fresh)
        for effect, at in acting:
            status = effect.flagged(status, instants, at)
        if not instants.kept.all():
            status[1:][~instants.kept[:-1]] |= LOST_BEFORE
        return Chunk(instants.stamp_ns[cut], instants.kept[cut], codes.rows(begin, end), counts[cut], status[cut])

    def _reaching(self, effect_name: str, row: int) -> Codes:
        """Return the codes of one row at the input of an effect of this sensor."""
        names = [effect.name for effect, _ in self._acting]
        first = max(0, row - self._lookback)
        _, codes = self._chain(first, row + 1, self._acting, until=names.index(effect_name))
        return codes.rows(row, row + 1)

    def _chain(
        self, first: int, stop: int, acting: Sequence[tuple[Effect, Place]], until: int | None = None
    ) -> tuple[Instants, Codes]:
        """Compute rows first ... stop - 1 through all stages; in the last stage, only up to effect number `until`."""
        shared = self._shared
        if shared is None:
            instants, analog = self._input_signal(first, stop, acting)
        else:
            instants, analog = shared.memory.recall(
                (shared.owner, first, stop),
                lambda: self._apply_analog(*self._input_signal(first, stop, acting), acting[: shared.effects]),
                lambda signal: _bytes_of(*signal),
            )
        _, analog = self._apply_analog(instants, analog, acting[0 if shared is None else shared.effects :])
        codes = self._convert(analog, instants.phase)
        for effect, at in acting[:until]:
            codes = effect.codes(codes, at)
        return instants, codes

    def _input_signal(self, first: int, stop: int, acting: Sequence[tuple[Effect, Place]]) -> tuple[Instants, Analog]:
        """Return the instants at which rows first ... stop - 1 are read, and the signal of the true quantity."""
        stamps = self.timeline.stamps(first, stop)
        instants = Instants(first, stamps, stamps, np.ones(len(stamps), bool), self.header.rate_hz)
        for effect, at in acting:
            instants = effect.sampled(instants, at)
        instants = replace(instants, instant_ns=latest_reading(instants.instant_ns, instants.rate_hz, instants.phase))
        stimulus = self._motion.stimulus(instants.instant_ns)
        for effect, at in acting:
            stimulus = effect.stimulus(stimulus, at)
        return instants, self._sense(first, instants, stimulus)

    @staticmethod
    def _apply_analog(
        instants: Instants, analog: Analog, acting: Sequence[tuple[Effect, Place]]
    ) -> tuple[Instants, Analog]:
        """Return the instants and the signal after these effects."""
        for effect, at in acting:
            analog = effect.analog(analog, at)
        return instants, analog

    def _sense(self, first: int, instants: Instants, stimulus: BoxStimulus) -> Analog:
        """Return the true quantity along the sensor's axes, before any effect."""
        header, dtype = self.header, self._place.dtype
        vector_box: Reals = getattr(stimulus, _COLUMN[header.quantity])
        unit = 1.0 if header.quantity == "magnetic_field" else 1 / SI_PER_UNIT[header.unit]  # a field is in gauss
        value = _turn_to_sensor(vector_box, self._orientation * unit * header.adjustment, dtype)
        return Analog(
            first,
            instants.instant_ns,
            value,
            np.broadcast_to(np.zeros((), dtype), value.shape),
            _turn_to_sensor(stimulus.force_box, self._orientation / STANDARD_GRAVITY, dtype),
            stimulus.temperature_degc,
            header.sensitivity,
            self._span.lowest,
            self._span.highest,
            self._span.step,
            stimulus.temperature_degc,
            instants.rate_hz,
        )

    def _convert(self, analog: Analog, phase: float) -> Codes:
        thermometer = thermometer_of(self.header)
        temperature = None if thermometer is None else thermometer_counts(thermometer, analog.thermometer_degc)
        counts = convert(analog, self._span)
        codes = Codes(analog.first, analog.instant_ns, counts, temperature, np.ones(len(counts), bool))
        if self._is_polled:
            return hold_readings(codes, analog.rate_hz, phase) if analog.rate_hz > 0 else codes
        rows_per_s = self.timeline.rows_per_s
        is_asked_twice = self._is_late and analog.rate_hz > (1 + AT_ITS_RATE) * rows_per_s
        is_slow = 0 < (1 + AT_ITS_RATE) * analog.rate_hz < rows_per_s
        return hold_readings(codes, analog.rate_hz, phase) if is_asked_twice or is_slow else codes

    def _status(self, counts: Counts, fresh: Booleans) -> npt.NDArray[np.uint16]:
        """Return the flags that the logger would set: stale, saturated."""
        span = self._span
        if self.header.chip in NO_READY_BIT:
            fresh = np.concatenate([[True], (counts[1:] != counts[:-1]).any(axis=1)])
        status = np.zeros(len(counts), np.uint16)
        if not fresh.all():
            status[~fresh] |= STALE
        if counts.min() <= span.lowest or counts.max() >= span.highest:  # per row only if necessary
            status[((counts <= span.lowest) | (counts >= span.highest)).any(axis=1)] |= SATURATED
        return status


class SimulatedBarometer:
    """A barometer without effects: the data sheet's example part with the data sheet's noise. A chip that
    `imuarray.barometer` does not have is simulated as a BMP180.
    """

    def __init__(self, header: SensorHeader, timeline: Timeline, motion: Motion, streams: Streams) -> None:
        self._barometer = BAROMETERS.get(header.chip, BAROMETERS["bmp180"])
        self.header = replace(header, extra={**self._barometer.words, **self._barometer.settings})
        self.timeline = timeline
        self.effects: tuple[Effect, ...] = ()
        self.rows = timeline.rows
        self._motion = motion
        self._noise = streams.of_boot(header.name, "pressure noise", width=1)

    def block(self, start: int, stop: int) -> Block:
        """Return rows start ... stop - 1."""
        stamps = self.timeline.stamps(start, stop)
        stimulus = self._motion.stimulus(stamps)
        chip = self._barometer
        noise = self._noise.normal(start, stop)[:, 0] * chip.noise_pa
        degc, pa = np.asarray(stimulus.temperature_degc, float), np.asarray(stimulus.pressure_pa + noise, float)
        ut, up = chip.uncompensated(degc, pa, chip.words)
        temperature, pressure = chip.compensate(ut, up, chip.words)
        counts = np.stack([ut, up], axis=1).astype(np.int32)
        status = np.zeros(len(stamps), np.uint16)
        return Block(stamps, counts, status, None, {"temperature": temperature, "pressure": pressure})

    def lost_rows(self, start: int, stop: int) -> Integers:
        """Return no rows: a barometer loses none."""
        return np.zeros(0, np.int64)


def _arriving_of(chunk: Chunk, start: int, stop: int) -> Block:
    """Return those of the rows start ... stop - 1 of a chunk that arrive."""
    rows: Any = slice(start, stop)
    if not chunk.kept[rows].all():
        rows = start + np.flatnonzero(chunk.kept[rows])
    temperature = chunk.codes.temperature_counts
    return Block(
        chunk.stamp_ns[rows],
        chunk.counts[rows],
        chunk.status[rows],
        None if temperature is None else temperature[rows].astype(np.int16),
    )


def _bytes_of_rows(block: Block) -> int:
    columns = (block.time, block.counts, block.status, block.temperature_counts)
    return sum(column.nbytes for column in columns if column is not None)


def _changes_input_signal(effect: Effect) -> bool:
    """Return whether an effect changes the instants at which rows are read, or the stimulus at these instants."""
    kind = type(effect)
    return kind.sampled is not Effect.sampled or kind.stimulus is not Effect.stimulus


def _bytes_of(instants: Instants, analog: Analog) -> int:
    """Return the size in bytes of the arrays of a signal, each counted once; arrays that repeat one row count as 0."""
    arrays = {id(item): item for stage in (instants, analog) for item in vars(stage).values()}.values()
    return sum(item.nbytes for item in arrays if isinstance(item, np.ndarray) and item.strides[0])


def _turn_to_sensor(vector_box: Reals, orientation: Reals, dtype: npt.DTypeLike) -> Reals:
    """Return `vector_box` (n, 3) along the sensor's axes; a constant vector may be one row."""
    if vector_box.strides[0] == 0:
        x, y, z = (vector_box[0] @ orientation).tolist()
        return per_row((x, y, z), np.broadcast_to(np.zeros((), dtype), vector_box.shape))
    return np.asarray(vector_box @ orientation, dtype)


def _join(parts: Sequence[Codes]) -> Codes:
    temperatures = [part.temperature_counts for part in parts if part.temperature_counts is not None]
    return Codes(
        parts[0].first,
        np.concatenate([part.instant_ns for part in parts]),
        np.concatenate([part.counts for part in parts]),
        np.concatenate(temperatures) if temperatures else None,
        np.concatenate([part.fresh for part in parts]),
    )


__all__ = ["Demand", "SimulatedBarometer", "SimulatedSensor"]

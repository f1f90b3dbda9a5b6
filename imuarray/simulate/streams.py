"""Random numbers, of which any stretch of rows can be generated alone, independent of earlier requests.

Every stream is named (seed, boot, sensor, effect, purpose): omitting one effect changes no draw of any other, and a run
is another `boot` of the same units. A stream is cut into chunks of `CHUNK` rows, each with its own generator (SFC64,
seeded by hashing its name and number), so row 10**9 costs no more than row 0.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property, lru_cache
from threading import Lock
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Reals

CHUNK = 1 << 14
"""Rows per chunk: two float64 triads of this length fit into a second-level cache."""

_KEPT = 3
_LEAST = 128

Value = TypeVar("Value")


class DrawMemory:
    """A cache of the latest results of draws, limited in bytes, for many simulations of the same units: models that are
    compared with the same random numbers do not draw them again.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._values: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def recall(self, key: Hashable, make: Callable[[], Value], size: Callable[[Value], int]) -> Value:
        """Return the result of `make`, or the cached one for this key, which contains everything that the result
        depends on. `size` returns the number of bytes of a result. Results must not be modified.
        """
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                value: Value = self._values[key][0]
                return value
        value = make()
        with self._lock:
            if key not in self._values:
                self._values[key] = value, size(value)
                self._bytes += self._values[key][1]
            while self._bytes > self._most_bytes:
                self._bytes -= self._values.popitem(last=False)[1][1]
        return value


class Stream:
    """One named stream of random rows; `normal` numbers have the standard deviations `scale` (width,), or 1."""

    def __init__(
        self,
        entropy: tuple[int, ...],
        width: int,
        dtype: npt.DTypeLike,
        chunk_rows: int = CHUNK,
        scale: Sequence[float] | None = None,
    ) -> None:
        self.memory: DrawMemory | None = None
        self._entropy = entropy
        self._chunk_rows = chunk_rows
        self._scale = scale
        self._width = width
        self._dtype: Any = np.dtype(dtype).type

    def normal(self, start: int, stop: int) -> Reals:
        """Return (stop - start, width) independent normal numbers; read-only."""
        return self._rows(self._normal_chunk, start, stop)

    def uniform(self, start: int, stop: int) -> Reals:
        """Return (stop - start, width) independent numbers in [0, 1); read-only. Use either `normal` or `uniform` of
        one stream, not both.
        """
        return self._rows(self._uniform_chunk, start, stop)

    def generator(self, chunk: int = 0) -> np.random.Generator:
        """Return an independent generator for each `chunk`, for an unknown number of draws."""
        words = np.concatenate([self._entropy_words, _words_of(chunk)])
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence(words)))

    @cached_property
    def _entropy_words(self) -> npt.NDArray[np.uint32]:
        return np.concatenate([_words_of(number) for number in self._entropy])

    @cached_property
    def _normal_chunk(self) -> Callable[[int, int], Reals]:
        if self.memory is not None:  # which keeps what is used again: thousands of streams would keep too much
            return self._draw_normal
        return lru_cache(maxsize=_KEPT)(self._draw_normal)

    @cached_property
    def _uniform_chunk(self) -> Callable[[int, int], Reals]:
        return lru_cache(maxsize=_KEPT)(self._draw_uniform)

    def without_memory(self) -> Stream:
        """Return the same stream, whose draws are not remembered."""
        return Stream(self._entropy, self._width, self._dtype, self._chunk_rows, self._scale)

    def recall(self, key: Hashable, make: Callable[[], Reals]) -> Reals:
        """Return the result of `make`, which depends on this stream and on `key`, or a remembered one; read-only."""
        if self.memory is None:
            return make()
        whole_key = (self._entropy, self._width, self._dtype, self._chunk_rows, key)
        return self.memory.recall(whole_key, make, lambda rows: int(rows.nbytes))

    def _draw_normal(self, chunk: int, count: int) -> Reals:
        def draw() -> Reals:
            drawn: Reals = self.generator(chunk).standard_normal((count, self._width), dtype=self._dtype)
            drawn.flags.writeable = self.memory is None
            return drawn

        rows = self.recall(("normal", chunk, count), draw)
        if self._scale is not None:
            wide = math.gcd(count, 128)  # few long rows: four times faster than many rows of three
            longer = rows.reshape(-1, wide * self._width)
            row_scale = np.tile(np.asarray(self._scale, self._dtype), wide)
            rows = np.multiply(longer, row_scale, out=longer if self.memory is None else None).reshape(rows.shape)
        rows.flags.writeable = False
        return rows

    def _draw_uniform(self, chunk: int, count: int) -> Reals:
        rows: Reals = self.generator(chunk).random((count, self._width), dtype=self._dtype)
        rows.flags.writeable = False
        return rows

    def _rows(self, chunk_of: Callable[[int, int], Reals], start: int, stop: int) -> Reals:
        size = self._chunk_rows
        first, last = start // size, max(stop - 1, start) // size
        reached = max(stop - last * size, _LEAST)
        count = min(size, 1 << (reached - 1).bit_length())  # further numbers are drawn only on request
        if first == last:
            rows: Reals = chunk_of(first, count)[start - first * size : stop - first * size]
            return rows
        parts = [*(chunk_of(chunk, size) for chunk in range(first, last)), chunk_of(last, count)]
        parts[0], parts[-1] = parts[0][start - first * size :], parts[-1][: stop - last * size]
        return np.concatenate(parts)


class Streams:
    """All streams of one simulation: the draws of the units depend on `seed`, those that differ from run to run on
    `seed` and `boot`.
    """

    def __init__(self, seed: int, boot: int = 0, memory: DrawMemory | None = None) -> None:
        if seed < 0 or boot < 0:
            raise ValueError(f"seed {seed}, boot {boot}: allowed are 0, 1, 2, ...")
        self.seed = seed
        self.boot = boot
        self.memory = memory

    def of_boot(
        self,
        *name: str,
        width: int = 3,
        dtype: npt.DTypeLike = np.float64,
        chunk_rows: int = CHUNK,
        scale: Sequence[float] | None = None,
    ) -> Stream:
        """Return a stream that differs from run to run; `chunk_rows` are drawn at a time and belong to its identity."""
        stream = Stream((self.seed, 1 + self.boot, *_words(name)), width, dtype, chunk_rows, scale)
        stream.memory = self.memory
        return stream

    def of_unit(self, *name: str) -> np.random.Generator:
        """Return a generator for properties of a unit that are the same in all runs."""
        return Stream((self.seed, 0, *_words(name)), 1, np.float64).generator()


def _words(name: tuple[str, ...]) -> tuple[int, ...]:
    """Return 128 bits as four words, unique to this name."""
    digest = hashlib.blake2b("\0".join(name).encode(), digest_size=16).digest()
    return tuple(int.from_bytes(digest[at : at + 4], "little") for at in range(0, 16, 4))


def _words_of(number: int) -> npt.NDArray[np.uint32]:
    """Return the words of a number, the lowest first: what SeedSequence makes of it, which takes longer."""
    count = max(1, -(-number.bit_length() // 32))
    return np.frombuffer(number.to_bytes(4 * count, "little"), "<u4").astype(np.uint32, copy=False)

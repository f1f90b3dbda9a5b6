"""Random numbers that can be generated for any stretch of rows alone, independent of earlier requests.

Every stream is named (seed, boot, sensor, effect, purpose): leaving one effect out changes no draw of any other, and a
run is another `boot` of the same units. A stream is cut into chunks of `CHUNK` rows, each with its own generator
(SFC64, seeded by hashing its name and number), so row 10**9 costs no more than row 0.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Reals

CHUNK = 1 << 14
"""Rows per chunk: two float64 triads of this length fit into a second-level cache."""

_KEPT = 3
_LEAST = 128


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
        self._entropy = entropy
        self._chunk_rows = chunk_rows
        self._scale = scale
        self._width = width
        self._dtype: Any = np.dtype(dtype).type

    def normal(self, start: int, stop: int) -> Reals:
        """Return (stop - start, width) independent normal numbers; read-only."""
        return self._rows(self._normal_chunk, start, stop)

    def uniform(self, start: int, stop: int) -> Reals:
        """Return (stop - start, width) independent numbers in [0, 1); read-only. Take `normal` or `uniform` of one
        stream, not both.
        """
        return self._rows(self._uniform_chunk, start, stop)

    def generator(self, chunk: int = 0) -> np.random.Generator:
        """Return an independent generator for each `chunk`, for an unknown number of draws."""
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence((*self._entropy, chunk))))

    @cached_property
    def _normal_chunk(self) -> Callable[[int, int], Reals]:
        return lru_cache(maxsize=_KEPT)(self._draw_normal)

    @cached_property
    def _uniform_chunk(self) -> Callable[[int, int], Reals]:
        return lru_cache(maxsize=_KEPT)(self._draw_uniform)

    def _draw_normal(self, chunk: int, count: int) -> Reals:
        rows: Reals = self.generator(chunk).standard_normal((count, self._width), dtype=self._dtype)
        if self._scale is not None:
            wide = math.gcd(count, 128)  # few long rows: four times faster than many rows of three
            longer = rows.reshape(-1, wide * self._width)
            longer *= np.tile(np.asarray(self._scale, self._dtype), wide)
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
    """All streams of one simulation: `seed` is the key of the units and of everything else, `boot` that of everything
    that differs from run to run.
    """

    def __init__(self, seed: int, boot: int = 0) -> None:
        if seed < 0 or boot < 0:
            raise ValueError(f"seed {seed}, boot {boot}: allowed are 0, 1, 2, ...")
        self.seed = seed
        self.boot = boot

    def of_boot(
        self,
        *name: str,
        width: int = 3,
        dtype: npt.DTypeLike = np.float64,
        chunk_rows: int = CHUNK,
        scale: Sequence[float] | None = None,
    ) -> Stream:
        """Return a stream that differs from run to run; `chunk_rows` are drawn at a time and are part of its
        identity.
        """
        return Stream((self.seed, 1 + self.boot, *_words(name)), width, dtype, chunk_rows, scale)

    def of_unit(self, *name: str) -> np.random.Generator:
        """Return a generator for properties of a unit that are the same in all runs."""
        return Stream((self.seed, 0, *_words(name)), 1, np.float64).generator()


def _words(name: tuple[str, ...]) -> tuple[int, ...]:
    """Return 128 bits as four words, unique to this name."""
    digest = hashlib.blake2b("\0".join(name).encode(), digest_size=16).digest()
    return tuple(int.from_bytes(digest[at : at + 4], "little") for at in range(0, 16, 4))

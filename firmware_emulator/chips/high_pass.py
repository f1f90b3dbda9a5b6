"""A first-order high-pass that is evaluated at irregular times, whenever the emulated filter is read.

The input is assumed to be constant between two calls, at its value in the earlier call. Any unit; times in integer
nanoseconds.
"""

from __future__ import annotations

import math

from firmware_emulator.chip import Triple


class HighPass:
    """A high-pass filter with the cut-off `cutoff_hz`, switched on at `since_ns` with an empty state."""

    def __init__(self, cutoff_hz: float, since_ns: int) -> None:
        self._per_ns = -2e-9 * math.pi * cutoff_hz
        self._at_ns = since_ns
        self._input: Triple | None = None
        self._removed: Triple = (0.0, 0.0, 0.0)

    def __call__(self, value: Triple, at_ns: int) -> Triple:
        """Filter `value`, the input at `at_ns`; `at_ns` never decreases from call to call."""
        earlier = value if self._input is None else self._input
        share = math.exp(self._per_ns * max(0, at_ns - self._at_ns))
        x, y, z = (old + (new - old) * share for new, old in zip(self._removed, earlier, strict=True))
        self._at_ns, self._input, self._removed = at_ns, value, (x, y, z)
        return value[0] - x, value[1] - y, value[2] - z

    def zero(self, value: Triple, at_ns: int) -> None:
        """Set the state so that an input of `value` gives 0 from `at_ns` on."""
        self._at_ns, self._input, self._removed = at_ns, value, value

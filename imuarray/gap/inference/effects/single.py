"""Events so few that each of them is told by itself: when it came is taken from the recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

from imuarray.gap.inference.evidence import Span

NUMBERS = 1.0
"""Nats that one event costs of a gain. Its two numbers, its moment and how long or how large it is, cost a nat each;
what is told by both parts gains the mean of them, and an event lies in one.
"""

SINGLE = 64
"""More events than this are not told one by one."""


class Stretches(TypedDict):
    """Parameters of an effect whose single stretches are known."""

    runs: tuple[float, ...]
    moments_s: tuple[float, ...]
    lengths_s: tuple[float, ...]


def stretches(spans: Sequence[Span]) -> Stretches:
    """In which log, when, and for how long."""
    return {
        "runs": tuple(float(span.log) for span in spans),
        "moments_s": tuple(span.moment_s for span in spans),
        "lengths_s": tuple(span.length_s for span in spans),
    }

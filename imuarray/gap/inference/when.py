"""Times at which a hypothesis holds: always, from a moment on, in some logs, or during stretches of logs."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypedDict

from imuarray.gap.statistics.split import Split


class Span(NamedTuple):
    """In log number `log` from `moment_s`, in seconds since its epoch, for `length_s`."""

    log: int
    moment_s: float
    length_s: float

    @property
    def is_whole(self) -> bool:
        """True if it is all of the log."""
        return self.moment_s <= 0 and math.isinf(self.length_s)


@dataclass(frozen=True)
class When:
    """`spans` of logs; always, without any. `chosen`: how many numbers say which they are (None: a log for each, and
    the moments at which it begins and ends).
    """

    spans: tuple[Span, ...] = ()
    chosen: int | None = None

    @property
    def triples(self) -> list[tuple[int, float, float]]:
        """(log, from, until), as the simulation has them."""
        return [(span.log, span.moment_s, span.moment_s + span.length_s) for span in self.spans]

    @property
    def numbers(self) -> int:
        """The number of fitted or chosen numbers that determine the time."""
        if self.chosen is not None:
            return self.chosen
        return sum(1 + (span.moment_s > 0) + math.isfinite(span.length_s) for span in self.spans)

    def is_in_both(self, split: Split) -> bool:
        """Return whether both parts of a campaign have a good share of it."""
        if not self.spans:
            return True
        train_s, held_out_s = (self._seconds(split, held_out) for held_out in (False, True))
        return min(train_s, held_out_s) >= _SHARE * (train_s + held_out_s) > 0

    def _seconds(self, split: Split, held_out: bool) -> float:
        phases = split.phases(held_out)
        return sum(
            max(0.0, min(phase.end_ns * 1e-9, end_s) - max(phase.start_ns * 1e-9, begin_s))
            for log, begin_s, end_s in self.triples
            for phase in phases[log]
        )


ALWAYS = When()

SINGLE = 64
"""More events than this are not listed one by one."""

NUMBERS = 1.0
"""Nats that a number costs which was chosen to say when: the moment of an event, or how long it is. What is told by
both parts gains the mean of them, and an event lies in one.
"""

_SHARE = 0.2
"""A part of the campaign that has less of the time says too little of what holds only then."""


def in_logs(logs: Collection[int]) -> When:
    """Return the whole of these logs."""
    return When(tuple(Span(log, 0.0, math.inf) for log in sorted(logs)))


def since(first: Span, logs: Collection[int]) -> When:
    """Return the time from the beginning of a span on, in its log and in the later `logs`."""
    return When((first, *in_logs([log for log in logs if log > first.log]).spans), 2)


def join_spans(whens: Iterable[When]) -> When:
    """Return the spans of all."""
    return When(tuple(sorted(span for when in whens for span in when.spans)))


class Stretches(TypedDict):
    """Parameters of an effect whose single stretches are known."""

    runs: tuple[float, ...]
    moments_s: tuple[float, ...]
    lengths_s: tuple[float, ...]


def stretches(spans: Sequence[Span]) -> Stretches:
    """Return the stretches of the spans: log, begin and length."""
    return {
        "runs": tuple(float(span.log) for span in spans),
        "moments_s": tuple(span.moment_s for span in spans),
        "lengths_s": tuple(span.length_s for span in spans),
    }

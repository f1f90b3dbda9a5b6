"""Effects that act for part of the time: in some runs, from an instant on, or during some stretches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from imuarray.arrays import Booleans, Integers
from imuarray.simulate.effect import FOREVER_S, Effect
from imuarray.simulate.signal import Analog, BoxStimulus, Codes, Flags, Instants, Place

Stage = TypeVar("Stage", Instants, BoxStimulus, Analog, Codes)


def acting(effect: Effect, run: int) -> Effect | None:
    """Return the effect as it acts in run number `run`: unchanged, limited to its spans, or None if it does not act."""
    if not effect.spans:
        return effect
    own = [(begin_s, end_s) for number, begin_s, end_s in effect.each_span() if number == run]
    if any(begin_s <= 0 and end_s >= FOREVER_S for begin_s, end_s in own):
        return effect
    return _Within(effect, tuple((begin_s * 1e9, end_s * 1e9) for begin_s, end_s in own)) if own else None


_MATTERING = frozenset({"own_clock", "jitter", "channel_swap"})
"""Kinds of effect that change how rows are read in all runs of a sensor that has one."""


def effects_in(run: int, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the effects, in order, without those that can be omitted in the run with that number. An effect can be
    omitted if neither it nor a later effect of its kind acts in this run. An earlier effect of the same kind stays,
    because the random draws of the later one depend on its index.
    """
    chosen: list[Effect] = []
    for effect in reversed(effects):
        if effect.name in _MATTERING or any(effect.name == later.name for later in chosen) or acting(effect, run):
            chosen.append(effect)
    return tuple(reversed(chosen))


@dataclass(frozen=True)
class _Within(Effect):
    """An `effect` that acts only on rows whose stamps lie within `stretches_ns`, each (from, until). Its random draws
    are the same as those of an effect that always acts.
    """

    effect: Effect = Effect()  # noqa: RUF009  # frozen
    stretches_ns: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.effect.name)

    def lookback(self, at: Place) -> int:
        return self.effect.lookback(at)

    def sampled(self, instants: Instants, at: Place) -> Instants:
        """Raise ValueError for an effect that changes the times of readings, which cannot be limited to single rows."""
        return _mix(instants, self.effect.sampled(instants, at), self._inside(instants.stamp_ns))

    def flagged(self, status: Flags, instants: Instants, at: Place) -> Flags:
        inside = self._inside(instants.stamp_ns)
        return np.where(inside, self.effect.flagged(status, instants, at), status)

    def stimulus(self, stimulus: BoxStimulus, at: Place) -> BoxStimulus:
        """Return the stimulus unchanged; ValueError if the effect changes it, because the stamps of rows are unknown at
        this stage.
        """
        changed = self.effect.stimulus(stimulus, at)
        if changed is not stimulus:
            raise ValueError(f"spans: {self.effect.name} can't act for a part of a run")
        return stimulus

    def analog(self, analog: Analog, at: Place) -> Analog:
        inside = self._inside(at.stamps(analog.first, analog.first + len(analog.instant_ns)))
        return _mix(analog, self.effect.analog(analog, at), inside) if inside.any() else analog

    def codes(self, codes: Codes, at: Place) -> Codes:
        inside = self._inside(at.stamps(codes.first, codes.first + len(codes.counts)))
        return _mix(codes, self.effect.codes(codes, at), inside) if inside.any() else codes

    def _inside(self, stamp_ns: Integers) -> Booleans:
        """Return (n,) whether rows with these stamps, ascending, lie within the stretches."""
        inside = np.zeros(len(stamp_ns), bool)
        for begin_ns, end_ns in self.stretches_ns:
            due, over = np.searchsorted(stamp_ns, (begin_ns, end_ns))
            inside[due:over] = True
        return inside


def _mix(before: Stage, after: Stage, inside: Booleans) -> Stage:
    """Return the rows of `after` that are `inside`, and those of `before` otherwise."""
    changes: dict[str, Any] = {}
    for item in fields(before):
        old, new = getattr(before, item.name), getattr(after, item.name)
        if new is old or (not isinstance(old, np.ndarray) and not isinstance(new, np.ndarray) and new == old):
            continue
        if item.name in ("rate_hz", "phase"):
            raise ValueError(f"spans: {item.name} can't change for a part of a run")
        is_by_axis = isinstance(old, tuple) or np.ndim(old) in (0, 2) or np.ndim(new) == 2
        wide = inside[:, None] if is_by_axis else inside
        mixed = np.where(wide, new, old)
        changes[item.name] = mixed.astype(old.dtype) if isinstance(old, np.ndarray) else mixed
    return replace(before, **changes)


def spans_of(stretches: Sequence[tuple[int, float, float]]) -> tuple[float, ...]:
    """Return stretches (run, from, until) as the spans of an effect; infinity means without end."""
    return tuple(value for run, begin_s, end_s in stretches for value in (float(run), begin_s, min(end_s, FOREVER_S)))

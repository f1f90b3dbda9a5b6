"""`bias_instability`: Allan deviations that leave the slope of -1/2, and come back to it or not."""

from __future__ import annotations

from collections.abc import Iterator

from imuarray.gap.candidates.candidate import Candidate, Trial
from imuarray.gap.candidates.levels import levels, log_levels
from imuarray.gap.candidates.removal import with_removal
from imuarray.gap.candidates.slow import BEYOND, TRACES, longest_s, rms_at, sized, slower, wander_of
from imuarray.gap.evidence import Evidence
from imuarray.simulate.effects.bias_instability import BiasInstability

_FREE = ("rms", "time_constant_s")
_SLOWEST = 5.0
"""A process that is slower than so many phases is another bias in each boot; within one phase it is a random walk if it
is slower than that."""


def guesses(evidence: Evidence) -> Iterator[Trial]:
    """The Gauss-Markov process that fits the Allan variances best; a slower one (a faster
    one, if it is slower than phases are long); and one as large as the logs' levels
    are apart, if these wander.
    """
    yield from with_removal(evidence, BiasInstability.name, _found(evidence), several=True)


def _found(evidence: Evidence) -> Iterator[Trial]:
    if not evidence.is_odd(*TRACES, beyond=BEYOND) or (found := wander_of(evidence)) is None:
        return
    score = evidence.score(*TRACES)
    for one in (found, slower(evidence, found)):
        if one.rms.any():
            yield Trial(
                (BiasInstability(sized(one.rms, score), one.time_constant_s),),
                _FREE,
                limits={"time_constant_s": (0.0, longest_s(evidence))},
            )
    yield from _over_logs(evidence)


def _over_logs(evidence: Evidence) -> Iterator[Trial]:
    """Logs' levels say how large it is, what goes on within them 2 rms^2 / time constant, how fast."""
    _, means, errors = log_levels(levels(evidence))
    if len(means) < 3 or not evidence.is_odd("run_scatter", "run_spread", "mean", beyond=BEYOND):
        return
    square = (means.var(axis=0, ddof=1) - errors.mean(axis=0)).clip(0.0)
    long_s = 10 * longest_s(evidence)
    pace = rms_at(evidence, long_s) ** 2 / long_s
    if square.any() and pace.any():
        time_constant_s = min(max(square.mean() / pace.mean(), longest_s(evidence) / 3), _SLOWEST * longest_s(evidence))
        effect = BiasInstability(sized(square**0.5, evidence.score(*TRACES)), time_constant_s)
        limits = {"time_constant_s": (0.0, _SLOWEST * longest_s(evidence))}
        yield Trial((effect,), _FREE, limits=limits)


BIAS_INSTABILITY = Candidate(
    BiasInstability.name,
    guesses,
    {"static": "still for 10 of its time constants, an hour at least", "turn-on": "a dozen boots of some minutes"},
)

"""`bias_instability`: Allan deviations that leave the slope of -1/2, and come back to it or not."""

from __future__ import annotations

from collections.abc import Iterator

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.slow import BEYOND, SLOWEST, TRACES, longest_s, over_logs, sized, slower, wander_of
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias_instability import BiasInstability

_FREE = ("rms", "time_constant_s")


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """The Gauss-Markov process that fits the Allan variances best; a slower one (a faster
    one, if it is slower than phases are long); and one as large as the logs' levels
    are apart, if these wander.
    """
    yield from with_removal(evidence, BiasInstability.name, _hypotheses(evidence), several=True)


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*TRACES, beyond=BEYOND) or (wander := wander_of(evidence)) is None:
        return
    score = evidence.score(*TRACES)
    for process in (wander, slower(evidence, wander)):
        if process.rms.any():
            yield Hypothesis(
                (BiasInstability(sized(process.rms, score), process.time_constant_s),),
                _FREE,
                limits={"time_constant_s": (0.0, longest_s(evidence))},
            )
    yield from _over_logs(evidence)


def _over_logs(evidence: Evidence) -> Iterator[Hypothesis]:
    """A bias that wanders as much as the logs' levels differ."""
    if (wander := over_logs(evidence)) is not None:
        effect = BiasInstability(sized(wander.rms, evidence.score(*TRACES)), wander.time_constant_s)
        limits = {"time_constant_s": (0.0, SLOWEST * longest_s(evidence))}
        yield Hypothesis((effect,), _FREE, limits=limits)


BIAS_INSTABILITY = Candidate(
    BiasInstability.name,
    guesses,
    {"static": "still for 10 of its time constants, an hour at least", "turn-on": "a dozen boots of some minutes"},
)

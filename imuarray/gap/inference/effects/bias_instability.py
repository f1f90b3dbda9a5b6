"""`bias_instability`: Allan deviations that leave the slope of -1/2, and come back to it or not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.effects.slow import (
    BEYOND,
    SLOWEST,
    TRACES,
    flicker_of,
    longest_s,
    over_logs,
    sized,
    slower,
    wander_of,
)
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.bias import BiasInstability
from imuarray.simulate.signal import Triple


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the Gauss-Markov process that fits the Allan variances best; a slower one (a faster one, if it is slower
    than phases are long); flicker noise; and a process as large as the logs' levels are apart, if these wander.
    """
    yield from with_removal(evidence, BiasInstability.name, _hypotheses(evidence), several=True)


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if not evidence.is_odd(*TRACES, beyond=BEYOND) or (wander := wander_of(evidence)) is None:
        return
    score, longest = evidence.score(*TRACES), longest_s(evidence)
    for process in (wander, slower(evidence, wander)):
        for rms in sized(process.rms, score):
            yield _process(rms, process.time_constant_s, longest)
    if (flicker := flicker_of(evidence)) is not None:
        for rms in sized(np.array(flicker.rms), score):
            yield Hypothesis((replace(flicker, rms=rms),), ("rms",))
    if (of_logs := over_logs(evidence)) is not None:  # as large as the logs' levels are apart
        for rms in sized(of_logs.rms, score):
            yield _process(rms, of_logs.time_constant_s, SLOWEST * longest)


def _process(rms: Triple, time_constant_s: float, slowest_s: float) -> Hypothesis:
    effect = BiasInstability(rms, time_constant_s)
    return Hypothesis((effect,), ("rms", "time_constant_s"), limits={"time_constant_s": (0.0, slowest_s)})


BIAS_INSTABILITY = Candidate(
    BiasInstability.name,
    guesses,
    {"static": "still for 10 of its time constants, an hour at least", "turn-on": "a dozen boots of some minutes"},
)

"""The whole diagnosis: discrepancy by discrepancy, what explains it, and how far the tables come closer.

Each discrepancy is judged on the array that already has what was chosen for those before it, so that scatter and
level are counted once. Nothing random but the resampling of channels for the intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType

from imuarray.paper.gap.acting import Effects, with_effects
from imuarray.paper.gap.boot_fault import boot_fault
from imuarray.paper.gap.candidate import Discrepancy, statistics
from imuarray.paper.gap.even_codes import even_codes
from imuarray.paper.gap.high_rate import correlation, line
from imuarray.paper.gap.mounting import g_sensitivity, mounting, noise
from imuarray.paper.gap.result import Cause, PaperGap
from imuarray.paper.gap.sensor import Array, data_sheet_array
from imuarray.paper.gap.slopes import slopes
from imuarray.paper.gap.two_states import two_states
from imuarray.paper.gap.wander import in_run, turn_on

STEPS: Mapping[str, Callable[[Array], Discrepancy]] = MappingProxyType(
    {
        "even codes": even_codes,
        "noise of bma180": partial(noise, chip="bma180"),
        "noise of l3g4200d": partial(noise, chip="l3g4200d"),
        "in-run": in_run,
        "slopes": slopes,
        "mounting": mounting,
        "force on gyroscopes": g_sensitivity,
        "boot fault": boot_fault,
        "two states": two_states,
        "turn-on": turn_on,
        "correlation": correlation,
        "line": line,
    }
)
"""In this order: noise decides how far means scatter, and levels need directions before boots can be judged."""

FITTED = frozenset({"white_noise", "thermal_bias"})
"""What `imuarray.gap` fits beside the bias before anything is blamed."""


def diagnose(seed: int = 1) -> PaperGap:
    """The gap between the data sheets' array and the paper's tables; `seed` is that of the resampling."""
    array = base = data_sheet_array()
    found: list[Discrepancy] = []
    for step in STEPS.values():
        found.append(step(array))
        array = with_effects(array, found[-1].best.adds)
    chosen = [one.best.adds for one in found]
    without = [statistics(with_effects(base, merged(chosen[:i] + chosen[i + 1 :]))) for i in range(len(chosen))]
    causes = tuple(Cause(one, rows) for one, rows in zip(found, without, strict=True))
    fitted = statistics(with_effects(base, only(merged(chosen), FITTED)))
    return PaperGap(seed, statistics(base), fitted, statistics(with_effects(base, merged(chosen))), causes)


def only(effects: Effects, names: frozenset[str]) -> Effects:
    """The effects of these names."""
    return {name: tuple(effect for effect in some if effect.name in names) for name, some in effects.items()}


def merged(effects: Sequence[Effects]) -> Effects:
    """By sensor, one after the other."""
    names = dict.fromkeys(name for one in effects for name in one)
    return {name: tuple(effect for one in effects for effect in one.get(name, ())) for name in names}

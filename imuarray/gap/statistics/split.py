"""The split of a campaign into a training part, to which parameters are fitted, and a held-out part.

If there are several logs of one kind, every second one is held out. If a log is the only one of its kind, the second
half of each of its phases is held out. Phases are halved too in a series of boots that is too short for two parts, and
in a few motions or heatings, each of which may have another axis or face, so that both parts contain all of them. Both
parts thus have the same faces and phases, and the fit uses only one of them. Logs with and without a phase at rest
count as two kinds, since only the former determine noise and bias.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.statistics.campaign import Campaign, LogSummary
from imuarray.log.format import Phase

FEWEST_RUNS = 4
"""Least number of runs of a turn-on series from which the variation from run to run is estimated."""


_HALVED = {"turn-on": range(FEWEST_RUNS, 3 * FEWEST_RUNS), "motion": range(2, 4), "heating": range(2, 4)}
"""Numbers of logs of a kind at which phases are halved, since there are too few logs to hold out every second one."""


@dataclass(frozen=True)
class Share:
    """The part of one log that is used: `phases`, their `numbers` in the log, and whether each is held out; `half` is
    true if the phases are halves of those of the log.
    """

    phases: tuple[Phase, ...]
    numbers: tuple[int, ...]
    held_out: tuple[bool, ...]
    half: bool


@dataclass(frozen=True)
class Side:
    """One part of a campaign: its logs that have phases in this part, and their numbers in the whole campaign."""

    campaign: Campaign
    logs: tuple[int, ...]


@dataclass(frozen=True)
class Split:
    """The shares of every log of a campaign, in order."""

    shares: tuple[Share, ...]

    def train(self, campaign: Campaign) -> Side:
        """Return the part that the model is fitted to."""
        return self._side(campaign, False)

    def held_out(self, campaign: Campaign) -> Side:
        """Return the part that the fitted model is tested on."""
        return self._side(campaign, True)

    def both(self, campaign: Campaign) -> Side:
        """Return the whole campaign as one part."""
        return Side(campaign, tuple(range(len(campaign.logs))))

    def phases(self, held_out: bool | None = None) -> tuple[tuple[Phase, ...], ...]:
        """Return the phases of each log that are used: those of both parts (None), or of one part."""
        return tuple(tuple(share.phases[at] for at in _places(share, held_out)) for share in self.shares)

    @property
    def words(self) -> str:
        """Describe the split in one sentence."""
        halved = sum(share.half for share in self.shares)
        whole = sum(all(share.held_out) for share in self.shares if share.phases and not share.half)
        parts = [f"{whole} of {len(self.shares)} logs (every second of a kind)"] if whole else []
        parts += [f"the second half of every phase of {halved} {'log' if halved == 1 else 'logs'}"] if halved else []
        return f"held out: {' and '.join(parts) or 'nothing'}"

    def _side(self, campaign: Campaign, held_out: bool) -> Side:
        parts = [_part(log, share, held_out) for log, share in zip(campaign.logs, self.shares, strict=True)]
        logs = tuple(number for number, part in enumerate(parts) if part.phases)
        return Side(Campaign(tuple(parts[number] for number in logs)), logs)


def split_of(kinds: Sequence[str], phases: Sequence[Sequence[Phase]]) -> Split:
    """Return the split of a campaign whose logs are of these kinds and have these phases."""
    several = [(kind, any(map(is_at_rest, log_phases))) for kind, log_phases in zip(kinds, phases, strict=True)]
    many = {kind for kind, count in Counter(several).items() if count > 1 and count not in _HALVED.get(kind[0], ())}
    shares = []
    for number, (kind, log_phases) in enumerate(zip(several, phases, strict=True)):
        if kind in many:
            out = several[:number].count(kind) % 2 == 1
            shares.append(Share(tuple(log_phases), tuple(range(len(log_phases))), (out,) * len(log_phases), False))
        else:
            shares.append(_halve(log_phases))
    return Split(tuple(shares))


def _halve(phases: Sequence[Phase]) -> Share:
    halves: list[Phase] = []
    for phase in phases:
        middle = (phase.start_ns + phase.end_ns) // 2
        halves += [phase._replace(end_ns=middle), phase._replace(start_ns=middle)]
    numbers = tuple(number // 2 for number in range(len(halves)))
    return Share(tuple(halves), numbers, (False, True) * len(phases), True)


def _places(share: Share, held_out: bool | None) -> list[int]:
    return [at for at, out in enumerate(share.held_out) if held_out is None or out == held_out]


def _part(log: LogSummary, share: Share, held_out: bool) -> LogSummary:
    """Return the summary of a log with only the phases of one part. The log was summarised in all phases of its share,
    or only in those of this part.
    """
    places = _places(share, held_out)
    chosen = places if len(log.phases) == len(share.phases) else range(len(log.phases))
    parts = [replace(log.phases[at], number=share.numbers[place]) for at, place in zip(chosen, places, strict=False)]
    return replace(log, phases=tuple(parts))

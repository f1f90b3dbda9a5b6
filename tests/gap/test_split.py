"""Both parts of every campaign together are the campaign, without overlap."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, Layout, LogSummary, PhaseSummary
from imuarray.gap.statistics.split import Side, Split, split_of
from imuarray.log.format import Phase
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.small_campaign import phases_of, simulation

KINDS = ("static", "tumble", "heating", "turn-on", "motion")

LOGS = st.lists(
    st.tuples(st.sampled_from(KINDS), st.lists(st.integers(0, 10**10), min_size=2, max_size=6, unique=True)),
    min_size=1,
    max_size=8,
)
"""Kinds, and the edges of phases that follow each other."""


def phases_between(edges_ns: list[int]) -> list[Phase]:
    return [Phase(*both, f"phase {at}", "+Z") for at, both in enumerate(pairwise(sorted(edges_ns)))]


def summarised(kind: str, phases: tuple[Phase, ...]) -> LogSummary:
    """A log without sensors."""
    return LogSummary(kind, tuple(PhaseSummary(one, at, Layout({}, 1), {}, None) for at, one in enumerate(phases)))


def whole(split: Split, kinds: list[str]) -> Campaign:
    return Campaign(tuple(map(summarised, kinds, split.phases())))


def stretches(side: Side) -> set[tuple[int, Phase]]:
    return {(at, one.phase) for at, log in zip(side.logs, side.campaign.logs, strict=True) for one in log.phases}


@given(LOGS)
def test_the_parts_cover_the_whole_without_overlap(logs: list[tuple[str, list[int]]]) -> None:
    """Every nanosecond of every phase is in one part, and in one only."""
    kinds, phases = [kind for kind, _ in logs], [phases_between(edges) for _, edges in logs]
    split = split_of(kinds, phases)
    campaign = whole(split, kinds)
    train, held_out = split.train(campaign), split.held_out(campaign)
    assert not stretches(train) & stretches(held_out)
    everything = sorted((at, one.start_ns, one.end_ns) for side in (train, held_out) for at, one in stretches(side))
    for number, own in enumerate(phases):
        mine = [(start, end) for at, start, end in everything if at == number]
        assert mine[0][0] == own[0].start_ns
        assert mine[-1][1] == own[-1].end_ns
        assert all(end == start for (_, end), (start, _) in pairwise(mine))


@given(LOGS)
def test_every_second_log_of_a_kind_or_halves_are_held_out(logs: list[tuple[str, list[int]]]) -> None:
    """Halves of a single log of its kind, of four to eleven boots, and of two or three motions or heatings."""
    kinds, phases = [kind for kind, _ in logs], [phases_between(edges) for _, edges in logs]
    split = split_of(kinds, phases)
    campaign = whole(split, kinds)
    for kind in set(kinds):
        mine = [number for number, one in enumerate(kinds) if one == kind]
        trained = [number for number in split.train(campaign).logs if kinds[number] == kind]
        judged = [number for number in split.held_out(campaign).logs if kinds[number] == kind]
        is_short = (kind == "turn-on" and 4 <= len(mine) < 12) or (kind in ("motion", "heating") and len(mine) < 4)
        if len(mine) == 1 or is_short:
            assert trained == judged == mine
        else:
            assert trained == mine[::2]
            assert judged == mine[1::2]


def test_a_half_keeps_name_face_and_number_of_its_phase() -> None:
    """9 ns: 4 in one half, 5 in the other."""
    split = split_of(["static"], [[Phase(0, 9, "z_up", "+Z"), Phase(20, 40, "z_down", "-Z")]])
    campaign = whole(split, ["static"])
    for side, expected in (
        (split.train(campaign), [Phase(0, 4, "z_up", "+Z"), Phase(20, 30, "z_down", "-Z")]),
        (split.held_out(campaign), [Phase(4, 9, "z_up", "+Z"), Phase(30, 40, "z_down", "-Z")]),
    ):
        assert [one.phase for one in side.campaign.logs[0].phases] == expected
        assert [one.number for one in side.campaign.logs[0].phases] == [0, 1]
    both = split.both(campaign)
    assert (both.campaign, both.logs) == (campaign, (0,))


def test_both_parts_have_a_rest_if_any_log_has() -> None:
    """A ride without a stop and a box that is turned by hand are both motions; the noise of both parts is that of the
    rests of the second. With three more logs that have rests, two of these are held out.
    """
    ride = [Phase(0, 100, "motion", "")]
    turned = [Phase(0, 40, "pose 1", ""), Phase(40, 50, "motion", ""), Phase(50, 100, "pose 2", "")]
    split = split_of(["motion"] * 2, [ride, turned])
    for held_out in (False, True):
        names = [phase.name for phase in split.phases(held_out)[1]]
        assert names == ["pose 1", "motion", "pose 2"]
    split = split_of(["motion"] * 5, [ride, turned, turned, turned, turned])
    assert [len(phases) for phases in split.phases(True)] == [1, 0, 3, 0, 3]
    assert [len(phases) for phases in split.phases(False)] == [1, 3, 0, 3, 0]


def test_a_summary_of_one_part_alone_is_that_part() -> None:
    """As in simulations that need the training part only."""
    phases = [Phase(0, 10, "run 1", "+Z"), Phase(20, 30, "run 2", "+Z")]
    kinds = ["static", "turn-on", "turn-on"]
    split = split_of(kinds, [phases] * 3)
    short = Campaign(tuple(map(summarised, kinds, split.phases(held_out=False))))
    every = split.train(whole(split, kinds))
    one = split.train(short)
    assert (one.logs, stretches(one)) == (every.logs, stretches(every)) == ((0, 1), stretches(every))
    assert [part.number for part in one.campaign.logs[0].phases] == [0, 1]


def test_every_row_is_in_exactly_one_part() -> None:
    """Also rows at the middle of a phase: halves include the row at their begin."""
    motion = Tumble(2.0, 0.5)
    phases = phases_of(motion)
    shared = split_of(["tumble"], [phases]).phases()[0]
    for source in simulated_sources(simulation(motion, {}, 1)).values():
        for number, phase in enumerate(phases):
            parts = [
                {int(time) for block in source.blocks(half.start_ns, half.end_ns) for time in block.time}
                for half in shared[2 * number : 2 * number + 2]
            ]
            assert not parts[0] & parts[1]
            every = {int(time) for block in source.blocks(phase.start_ns, phase.end_ns) for time in block.time}
            assert parts[0] | parts[1] == every
            assert abs(len(parts[0]) - len(parts[1])) <= 1


@pytest.mark.parametrize(
    ("kinds", "words"),
    [
        (["static"], "held out: the second half of every phase of 1 log"),
        (["static", "tumble"], "held out: the second half of every phase of 2 logs"),
        (["turn-on"] * 3, "held out: 1 of 3 logs (every second of a kind)"),
        (["turn-on"] * 5, "held out: the second half of every phase of 5 logs"),
        (["turn-on"] * 13, "held out: 6 of 13 logs (every second of a kind)"),
        (["motion"] * 3, "held out: the second half of every phase of 3 logs"),
        (
            ["static", "tumble", "static"],
            "held out: 1 of 3 logs (every second of a kind) and the second half of every phase of 1 log",
        ),
        ([], "held out: nothing"),
    ],
)
def test_text_of_the_split(kinds: list[str], words: str) -> None:
    assert split_of(kinds, [[Phase(0, 10, "static", "+Z")]] * len(kinds)).words == words

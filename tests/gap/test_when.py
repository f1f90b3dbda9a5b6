"""The times of a hypothesis, from the course of a log and from the gains of single logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.evidence import ALWAYS, NATS_PER_NUMBER, Span, When, in_logs, join_spans, since
from imuarray.gap.recording.course import stretches_of
from imuarray.gap.recording.recordings import sources_of
from imuarray.gap.statistics.split import split_of
from imuarray.log.format import Phase
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.effects.noise import Tone
from tests.gap import multirate_logs
from tests.selection import some

LINE = Hypothesis((Tone((0.0, 0.04, 0.0), 17.0),), ("amplitude",))


def still(seconds: Sequence[float]) -> list[list[Phase]]:
    """One log of one phase for each."""
    return [[Phase(0, round(one * 1e9), "static", "+Z")] for one in seconds]


def test_the_choice_of_logs_and_moments_has_a_cost() -> None:
    """Each log, and each moment that is neither its beginning nor its end."""
    assert ALWAYS.numbers == 0
    assert in_logs([0, 3]).numbers == 2
    assert When((Span(0, 4.0, math.inf),)).numbers == 2
    assert When((Span(0, 4.0, 2.0), Span(0, 9.0, 2.0))).numbers == 6
    assert since(Span(1, 4.0, math.inf), [0, 1, 2, 3]).numbers == 2


def test_effects_of_a_timed_hypothesis_act_at_that_time() -> None:
    """Its effects act then; the choice is added to its rarity once."""
    when = join_spans([in_logs([2]), When((Span(0, 4.0, 3.0),))])
    trial = LINE.at(when)
    assert trial.when == when
    assert trial.effects[0].spans == (0.0, 4.0, 7.0, 2.0, 0.0, 1e9)
    assert trial.rarity == NATS_PER_NUMBER * 4
    assert trial.form == LINE.form
    assert trial.at(in_logs([1])).rarity == NATS_PER_NUMBER
    assert LINE.at(ALWAYS) is LINE


def test_a_beginning_that_is_narrowed_down() -> None:
    """To the moments next to the present beginning; the first and last moments are their own neighbours. The cost of
    the choice stays.
    """
    trial = replace(LINE.at(join_spans([in_logs([0]), When((Span(2, 30.0, math.inf),))])), begin_bounds_s=(10.0, 50.0))
    narrowed = trial.narrowed((10.0, 20.0, 30.0, 50.0), 1)
    assert narrowed.when.triples == [(0, 0.0, math.inf), (2, 20.0, math.inf)]
    assert narrowed.effects[0].spans == (0.0, 0.0, 1e9, 2.0, 20.0, 1e9)
    assert narrowed.begin_bounds_s == (10.0, 30.0)
    assert narrowed.rarity == trial.rarity
    assert trial.narrowed((10.0, 50.0), 1).begin_bounds_s == (10.0, 50.0)


def test_an_onset_that_is_narrowed_down() -> None:
    """An effect with an onset of its own has no spans."""
    trial = Hypothesis(
        (RangeReset(2.0, onset_s=30.0, run=0.0), RangeReset(2.0, runs=(1.0,))), begin_bounds_s=(10.0, 50.0)
    )
    narrowed = trial.narrowed((10.0, 20.0, 30.0, 50.0), 1)
    assert narrowed.effects == (RangeReset(2.0, onset_s=20.0, run=0.0), RangeReset(2.0, runs=(1.0,)))
    assert narrowed.begin_bounds_s == (10.0, 30.0)


def test_a_beginning_followed_by_whole_logs() -> None:
    """From some moment of log 2 on, and in the logs after it."""
    since_2 = since(Span(2, 30.0, math.inf), [3, 4])
    trial = replace(LINE.at(since_2), begin_bounds_s=(10.0, 50.0))
    narrowed = trial.narrowed((10.0, 20.0, 30.0, 50.0), 1)
    assert narrowed.when.triples == [(2, 20.0, math.inf), (3, 0.0, math.inf), (4, 0.0, math.inf)]


@pytest.mark.parametrize(
    ("when", "both"),
    [
        (ALWAYS, True),
        (When((Span(0, 33.0, math.inf),)), False),  # the second half of the only log of its kind is held out
        (When((Span(0, 20.0, 21.0),)), True),
        (When((Span(0, 28.0, 32.0),)), False),
        (in_logs([1]), False),  # one of two of a kind is held out
        (in_logs([1, 2]), True),
    ],
)
def test_timed_hypotheses_observable_in_both_parts(when: When, both: bool) -> None:
    split = split_of(["static", "turn-on", "turn-on"], still([60.0, 20.0, 20.0]))
    assert when.is_in_both(split) is both


@pytest.mark.parametrize(
    ("sensor", "change", "begin_s", "end_s", "within_s"),
    some(
        [
            ("G3", multirate_logs.even_codes(20.0, 41.0), 20.0, 41.0, 0.1),
            ("G2", multirate_logs.line(31.0, 0.04, since_s=33.0), 33.0, math.inf, 1.0),
            ("G1", multirate_logs.more_noise(1.3, (0,), 15.0, 40.0), 15.0, 40.0, 1.0),
            ("G1", multirate_logs.held(160.0, 12.0, 30.0), 12.0, 30.0, 0.1),
        ],
        1,
    ),
)
def test_intervals_are_suggested_by_the_course_of_a_log(
    tmp_path_factory: pytest.TempPathFactory,
    sensor: str,
    change: multirate_logs.Change,
    begin_s: float,
    end_s: float,
    within_s: float,
) -> None:
    """These, and the rest of the time; none for the other sensors."""
    folder = tmp_path_factory.mktemp("course")
    (log,) = multirate_logs.recorded(folder, {sensor: change}, (multirate_logs.FAST,))
    found = {name: stretches_of(source, log.phases) for name, source in sources_of(log).items()}
    assert {name for name, own in found.items() if own} == {sensor}
    sides = [own for own in found[sensor] if len(own) == 1 and own[0][0] > 0]
    assert sides
    np.testing.assert_allclose(sides[0][0], (begin_s, end_s), atol=within_s)


@pytest.mark.slow
def test_a_uniform_log_has_no_intervals(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Neither has a log with a permanent effect."""
    folder = tmp_path_factory.mktemp("same")
    changes = {
        "G1": multirate_logs.low_pass(40.0),
        "G2": multirate_logs.line(31.0, 0.05),
        "G3": multirate_logs.held(160.0),
    }
    (log,) = multirate_logs.recorded(folder, changes, (multirate_logs.FAST,), seed=3)
    assert not any(stretches_of(source, log.phases) for source in sources_of(log).values())

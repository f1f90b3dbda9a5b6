"""Lines in simulated logs at known frequencies, and the sentences that report them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from imuarray.gap.findings.deviations import line_hz, lines_shown, shared_changes, unexplained_lines
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.lines import unaliased_hz
from imuarray.simulate.effects.noise import Tone
from tests.gap.small_campaign import campaign_of, header, where

LINE = Tone((0.0, 0.05, 0.0), 20.0)


@pytest.fixture(scope="module")
def campaign():  # type: ignore[no-untyped-def]
    return campaign_of("static", {"G1": (LINE,)}, seed=3)


def test_a_line_is_detected_at_its_frequency(campaign) -> None:  # type: ignore[no-untyped-def]
    (phase,) = campaign.logs[0].still("G1")
    assert line_hz(phase, 1) == pytest.approx(20.0, abs=phase.spectrum.resolution_hz / phase.intervals.mean_s)
    assert line_hz(phase, 0) is None


def test_a_line_is_reported_once(campaign) -> None:  # type: ignore[no-untyped-def]
    told = unexplained_lines(campaign, [where("G1", "y"), where("G1", "y"), where("G1", "y", "lag_1")], ["a.h5"])
    assert len(told) == 1
    found = re.fullmatch(
        r"G1 y: a line that the causes do not fully explain: (.*) Hz in 1 of 1 stretches at rest of a.h5\.", told[0]
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(20.0, abs=0.2)


def test_no_line_is_reported_without_one(campaign) -> None:  # type: ignore[no-untyped-def]
    assert unexplained_lines(campaign, [where("G2", "x")], ["a.h5"]) == ()
    assert unexplained_lines(campaign, [], ["a.h5"]) == ()


@pytest.mark.parametrize(("changes", "told"), [((0.008, 0.0085, 0.0082), True), ((0.008, -0.008, 0.0082), False)])
def test_a_common_change_of_units_is_reported(changes: tuple[float, ...], told: bool) -> None:
    """Three units 8 mg higher in the held-out log, along their own axes; the training part is ignored."""
    headers = {name: header(name) for name in ("A1", "A2", "A3")}
    keys = [Key(0, name, "z", "", -1, "level", "level") for name in headers]
    both = np.array([*(1.0, 1.0, 1.0), *changes])
    found = shared_changes([*keys, *keys], both, [False] * 3 + [True] * 3, headers)
    assert bool(found) == told
    if told:
        assert "All 3 bma180, z: held-out log 1 lies +8.23 mg" in found[0]


def test_lines_are_reported_with_their_frequencies() -> None:
    """A line at 20 Hz on one axis, and the mains, whose 40 Hz and 60 Hz are equal at 100 rows per second: 60 is beyond
    half.
    """
    mains = Tone((0.05, 0.0, 0.0), 60.0)
    campaign = campaign_of("static", {"G1": (LINE, mains)}, seed=3)
    rate_hz = 1 / campaign.logs[0].still("G1")[0].intervals.mean_s
    (told,) = lines_shown(campaign, [where("G1", "y")], ())
    assert told.startswith("G1, lines at rest: ")
    lines = dict(re.findall(r"([xyz]+) ([\d.]+) Hz", told))
    assert float(lines["y"]) == pytest.approx(20.0, abs=0.2)
    assert float(lines["x"]) == pytest.approx(rate_hz - 60, abs=0.2)
    assert f"Hz, an alias of 60 Hz, the mains ({rate_hz:.3g} rows a second)" in told
    assert lines_shown(campaign, [where("G2", "y"), where("G1", "y", "lag_1")], ()) == ()


@pytest.mark.parametrize(
    ("seen_hz", "rows_per_s", "true_hz"),
    [
        (26.93, 76.93, 50.0),
        (3.86, 76.93, 150.0),  # the third harmonic, 150 - 2 * 76.93
        (30.79, 76.93, 30.79),  # the fourth, 3 * 76.93 - 200, is not searched
        (50.0, 200.0, 50.0),
        (24.4, 76.93, 24.4),
    ],
)
def test_which_lines_are_aliases_of_the_mains(seen_hz: float, rows_per_s: float, true_hz: float) -> None:
    assert unaliased_hz(seen_hz, 0.05, rows_per_s) == true_hz


@pytest.mark.parametrize(
    ("seen_hz", "bin_hz", "true_hz"),
    [
        (7.4, 0.24, 7.4),  # 180 - 3 * 62.5 is -7.5; four bins of 0.24 Hz in 31.25 Hz are 3 % for each multiple
        (7.45, 0.06, 180.0),
        (24.9, 0.15, 100.0),  # 100 - 2 * 62.5 is -25; four bins are 2 %
        (12.4, 0.24, 50.0),  # the mains frequency itself is always searched
    ],
)
def test_multiples_of_the_mains_need_narrow_bins(seen_hz: float, bin_hz: float, true_hz: float) -> None:
    assert unaliased_hz(seen_hz, bin_hz, 62.5) == true_hz

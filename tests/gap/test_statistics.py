"""Keys of statistics: their set, order and JSON."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import ALL_LOGS, WHOLE_LOG, Key, statistics
from imuarray.gap.statistics.probes import PROBES
from tests.gap.small_campaign import campaign_of


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return Campaign((*campaign_of("static").logs, *campaign_of("motion").logs, *campaign_of("turn-on").logs))


@pytest.mark.slow
def test_every_probe_has_a_value_somewhere(campaign: Campaign) -> None:
    found = statistics(campaign)
    assert {key.probe for key in found.keys} == set(PROBES) - {"turn_factor"}  # turns between rests: test_turns.py
    assert len(set(found.keys)) == len(found.keys) == len(found.values) == len(found.resolutions)
    assert not np.isinf(found.values).any()
    assert all(key.domain == PROBES[key.probe].domain for key in found.keys)


def test_keys_have_their_phase_axis_and_log(campaign: Campaign) -> None:
    found = statistics(campaign)
    assert {key.phase for key in found.keys if key.domain == "motion"} == {"motion", ""}
    assert {key.probe for key in found.keys if key.domain == "motion" and not key.phase} == {"motion_delay_rate"}
    assert {key.axis for key in found.keys if key.domain in ("timing", "status")} == {""}
    assert {key.probe for key in found.keys if key.phase == "motion" and key.probe == "mean"} == set()
    runs = [key for key in found.keys if key.log == ALL_LOGS]
    assert {(key.domain, key.phase, key.phase_number) for key in runs} == {
        ("run_to_run", "turn-on", WHOLE_LOG),
        ("timing", "", WHOLE_LOG),
    }
    assert found[Key(0, "A1", "z", "static", 0, "level", "mean")] == pytest.approx(1.02, abs=0.001)  # 1 g, bias 0.02
    with pytest.raises(KeyError):
        found[Key(0, "A1", "z", "static", 0, "level", "noise")]


@pytest.mark.slow
def test_the_order_is_always_the_same(campaign: Campaign) -> None:
    again = Campaign((*campaign_of("static").logs, *campaign_of("motion", seed=9).logs, *campaign.logs[2:]))
    assert statistics(campaign).keys == statistics(again).keys


def test_an_empty_campaign_has_no_statistics() -> None:
    found = statistics(Campaign(()))
    assert found.keys == ()
    assert len(found.values) == len(found.resolutions) == 0

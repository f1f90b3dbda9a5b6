"""Knocks of a box at rest are reported and do not split the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate.motion import LISTED, Knock, find_knocks, knock_sentence, longest_rest
from imuarray.calibrate.pose_readings import rest_windows
from imuarray.characterise import characterise_log
from imuarray.importers.plausibility import report_of
from imuarray.log import Log, open_log
from tests.calibrate.motion_logs import RATE_HZ, Felt, Floats, record, resting

KNOCKS_S = (20.25, 41.3, 77.8)


def knocked(*at_s: float, g: float = 0.4) -> Felt:
    """A rest with decaying oscillations of a third of a second."""

    def felt(seconds: Floats) -> Floats:
        since = seconds[:, None] - np.array(at_s)
        ringing = np.where(since >= 0, np.exp(-np.maximum(since, 0) / 0.1) * np.sin(40 * since), 0).sum(axis=1)
        return resting(seconds) + g * np.outer(ringing, [0.4, 0.2, 1.0])

    return felt


def tilted(at_s: float, g: float) -> Felt:
    """Knocked, and pushed into another attitude."""
    return lambda seconds: knocked(at_s)(seconds) + g * np.outer(seconds > at_s, [1.0, 0, 0])


def knocks_of(log: Log) -> str:
    """The sentence on the knocks that the accelerometers show, in mg."""
    return knock_sentence(find_knocks(rest_windows(log)), "mg", 1e3)


@pytest.mark.slow
def test_knocks_do_not_split_a_rest_and_are_excluded(tmp_path: Path) -> None:
    with open_log(record(tmp_path / "run.h5", knocked(*KNOCKS_S), 1, seconds=100.0, noise_g=0.002)) as log:
        rest = longest_rest(log)
        assert rest is not None
        assert (rest.end_ns - rest.start_ns) * 1e-9 > 97
        assert len(rest.left_out) == len(KNOCKS_S)
        for (start_ns, end_ns), at_s in zip(rest.left_out, KNOCKS_S, strict=True):
            assert start_ns * 1e-9 < at_s < at_s + 0.3 < end_ns * 1e-9
        assert sum(end_ns - start_ns for start_ns, end_ns in rest.left_out) * 1e-9 < 8
        result = characterise_log(log, rest)
        noise_g = result["sensors"][0]["axes"][2]["unit"]["std"]
        assert noise_g == pytest.approx(0.002, rel=0.04), "the knocks are not in the noise"
        # 0.002 / sqrt(2 * 4300 rows) is 1.1 %
        assert result["stretch"]["remark"].startswith("the box was knocked 3 times at rest, at 20.")
        assert any("the box was knocked 3 times" in text for text in report_of(log).quirks)


def test_a_change_of_attitude_ends_a_rest(tmp_path: Path) -> None:
    with open_log(record(tmp_path / "run.h5", tilted(60.0, 0.006), 2, seconds=100.0, noise_g=0.002)) as log:
        rest = longest_rest(log)
        assert rest is not None
        assert 57 < (rest.end_ns - rest.start_ns) * 1e-9 < 60
        (knock,) = find_knocks(rest_windows(log))
        assert knock.shift == pytest.approx(0.006, abs=0.0006)
        assert "readings at rest changed by up to 6" in knocks_of(log) or "5." in knocks_of(log)


@pytest.mark.parametrize("rate_noise_g", [0.0005, 0.02])
def test_an_undisturbed_rest_has_no_knock(tmp_path: Path, rate_noise_g: float) -> None:
    with open_log(record(tmp_path / "run.h5", resting, 3, seconds=200.0, noise_g=rate_noise_g)) as log:
        assert knocks_of(log) == ""


def test_a_new_pose_is_not_a_knock(tmp_path: Path) -> None:
    """A box that is laid on another side within two seconds was not knocked."""

    def turned(seconds: Floats) -> Floats:
        angle = np.pi / 2 * np.clip((seconds - 30) / 2, 0, 1)
        return np.stack([np.sin(angle), np.zeros(len(seconds)), np.cos(angle)], axis=1)

    with open_log(record(tmp_path / "run.h5", turned, 4, seconds=60.0, noise_g=0.002)) as log:
        assert knocks_of(log) == ""
        rest = longest_rest(log)
        assert rest is not None and not rest.left_out and RATE_HZ > 0


def test_the_first_five_knocks_are_listed() -> None:
    """The times are the middles of the knocks; a sixth knock is counted and not listed."""
    knocks = [Knock(round(second * 1e9), round((second + 0.2) * 1e9), True, 0.0) for second in range(1, 7)]
    assert LISTED == 5
    five = "the box was knocked 5 times at rest, at 1.1, 2.1, 3.1, 4.1, 5.1 s"
    assert knock_sentence(knocks[:5], "mg", 1e3) == five
    assert knock_sentence(knocks, "mg", 1e3) == five.replace("5 times", "6 times").replace(" s", ", ... s")

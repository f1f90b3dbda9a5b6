"""Intervals with changed settings of a chip: the time of the change, and the readings before it."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.recording.resets import MOST, resets_in
from imuarray.log import Block, Log, LogWriter, open_log
from imuarray.log.format import RECONFIGURED, STALE, SUSPECT, SensorHeader

ROW_NS = 10_000_000
USUAL, OTHER = np.array([40.0, -30.0, 520.0]), np.array([20.0, 90.0, 4160.0])


def readings(rows: int, changed: Collection[int] = (), noise: float = 2.0) -> npt.NDArray[np.float64]:
    """(rows, 3) with noise, those `changed` at another level with four times the noise."""
    drawn = np.random.default_rng(3).normal(0.0, noise, (rows, 3))
    other = np.isin(np.arange(rows), list(changed))[:, None]
    return np.where(other, OTHER + 4 * drawn, USUAL + drawn)


def recorded(
    path: Path,
    counts: npt.NDArray[np.float64],
    doubted: Collection[int],
    lost: Collection[int] = (),
    blank: Collection[int] = (),
    configured: Collection[int] = (),
) -> Log:
    """Rows every 10 ms, some of them flagged; those that are `lost` are missing, those `blank` are zeros, not fresh,
    and at those `configured` the chip was set up again.
    """
    rows = np.array([row for row in range(len(counts)) if row not in lost])
    status = np.where(np.isin(rows, list(doubted)), SUSPECT, 0).astype(np.uint16)
    status[np.isin(rows, list(blank))] |= STALE
    status[np.isin(rows, list(configured))] |= RECONFIGURED
    counts = np.where(np.isin(np.arange(len(counts)), list(blank))[:, None], 0, counts)
    header = SensorHeader("A", "bma180", "specific_force", "g", 16.0, 512.0, rate_hz=2400.0)
    with LogWriter(path, [header], source="imported", epoch="2024-01-01T00:00:00Z", force=True) as log:
        log.append("A", Block(rows * ROW_NS, np.rint(counts[rows]).astype(np.int16), status))
    return open_log(path)


def test_a_temporary_reset_is_detected(tmp_path: Path) -> None:
    """Suspect since row 300, other readings from 306 to 311, then configured again with a loss of ten rows."""
    with recorded(tmp_path / "log.h5", readings(500, range(306, 312)), range(300, 312), range(312, 322)) as log:
        (found,) = resets_in(log["A"])
    assert (found.doubt_s, found.moment_s, found.end_s) == pytest.approx((2.995, 3.055, 3.115))
    np.testing.assert_allclose(found.before, USUAL, atol=2)  # medians of 16 and of 6 rows: 3 standard errors and more
    np.testing.assert_allclose(found.within, OTHER, atol=16)


def test_zeros_after_a_reset_are_ignored(tmp_path: Path) -> None:
    """Zeros in row 306, one reading in 307, and then it is configured again: one reading does not
    determine the noise.
    """
    with recorded(tmp_path / "log.h5", readings(500, [306, 307]), range(300, 308), range(308, 330), [306]) as log:
        (found,) = resets_in(log["A"])
    assert (found.doubt_s, found.moment_s, found.end_s) == pytest.approx((2.995, 3.055, 3.075))
    assert found.blank_s == pytest.approx(0.01)
    np.testing.assert_allclose(found.within, OTHER, atol=4 * 4 * 2)
    assert np.isnan(found.noise_within).all()


def test_zeros_alone_give_no_reset(tmp_path: Path) -> None:
    with recorded(tmp_path / "log.h5", readings(500), range(300, 308), range(308, 330), [306, 307]) as log:
        assert resets_in(log["A"]) == ()


def test_a_reset_until_the_end_of_the_log_is_detected(tmp_path: Path) -> None:
    with recorded(tmp_path / "log.h5", readings(400, range(300, 400)), range(295, 400)) as log:
        (found,) = resets_in(log["A"])
    assert (found.doubt_s, found.moment_s, found.end_s) == pytest.approx((2.945, 2.995, 3.995))
    assert 4 < found.noise_within.mean() < 12
    assert 1 < found.noise_before.mean() < 3


def test_a_reset_across_blocks_is_detected(tmp_path: Path) -> None:
    """Flags are read 65536 rows at a time."""
    with recorded(tmp_path / "log.h5", readings(65_700, range(65_530, 65_560)), range(65_520, 65_560)) as log:
        (found,) = resets_in(log["A"])
    assert found.moment_s == pytest.approx(655.295)
    assert found.end_s == pytest.approx(655.595)


def test_flags_alone_are_not_a_reset(tmp_path: Path) -> None:
    """Neither are flags from the first row on; rows without a flag are not examined."""
    with recorded(tmp_path / "same.h5", readings(200), range(100, 120)) as log:
        assert resets_in(log["A"]) == ()
    with recorded(tmp_path / "first.h5", readings(200, range(20)), range(20)) as log:
        assert resets_in(log["A"]) == ()
    with recorded(tmp_path / "none.h5", readings(200, range(100, 120)), ()) as log:
        assert resets_in(log["A"]) == ()


def test_a_lost_setting_other_than_the_range_is_detected(tmp_path: Path) -> None:
    """Suspect from row 300 on with the same readings, and configured again at row 330, after 18 lost rows."""
    doubted, lost = range(300, 312), range(312, 330)
    with recorded(tmp_path / "log.h5", readings(500), doubted, lost, configured=[330]) as log:
        (reset,) = resets_in(log["A"])
    assert (reset.doubt_s, reset.moment_s, reset.end_s) == pytest.approx((2.995, 2.995, 3.115))
    np.testing.assert_allclose(reset.within, USUAL, atol=3)


def test_the_number_of_resets_is_limited(tmp_path: Path) -> None:
    changed = [row for row in range(100, 4000) if row % 40 < 5]
    with recorded(tmp_path / "log.h5", readings(4000, changed), changed) as log:
        assert len(resets_in(log["A"])) == MOST

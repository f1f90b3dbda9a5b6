"""`range_reset`: other counts per unit, another offset, the same truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from imuarray.log.format import RECONFIGURED, SUSPECT
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.signal import Analog, Codes, Instants
from tests.simulate.conftest import MakePlace, header

MakeAnalog = Callable[..., Analog]


def test_bma1_in_run_10_has_the_counts_of_table_6(place: MakePlace, analog: MakeAnalog) -> None:
    """Table 6: z 536.4 LSB at 16 g (512 LSB/g: BMA-76), 4308.7 at 2 g (4096 LSB/g: BMA-72); the offset, 4.3 mg here,
    is that range's own (BMA-79).
    """
    z, offset = 536.4 / 512, 4308.7 / 4096 - 536.4 / 512
    rows = RangeReset(2.0, (0.0, 0.0, offset)).analog(analog(0, 5, value=(0.0, 0.0, z), noise=0.01), place())
    assert rows.sensitivity == 4096
    np.testing.assert_allclose(rows.value[:, 2] * rows.sensitivity, 4308.7)
    assert (rows.noise == 0.01).all()
    assert (rows.lowest, rows.highest) == (-8192, 8191)


def test_the_range_changes_from_one_row_to_the_next(place: MakePlace, analog: MakeAnalog) -> None:
    """Onset at 0.05 s: row 5 of 100 a second."""
    for dtype in (np.float32, np.float64):
        rows = RangeReset(2.0, 0.25, onset_s=0.05).analog(analog(0, 10, value=1.0, dtype=dtype), place(dtype=dtype))  # type: ignore[arg-type]
        assert np.shape(rows.sensitivity) == (10, 1)
        counts = rows.value * rows.sensitivity
        assert counts.dtype == dtype
        np.testing.assert_array_equal(counts, np.repeat([[512.0] * 3, [1.25 * 4096] * 3], 5, axis=0))


def test_a_reading_older_than_its_log_is_in_the_other_range(place: MakePlace, analog: MakeAnalog) -> None:
    """The chip measured the first row before the log's clock began: it is in the other range too."""
    rows = analog(0, 5, value=1.0)
    early = replace(rows, instant_ns=rows.instant_ns - 5_000_000)
    assert RangeReset(2.0).analog(early, place()).sensitivity == 4096


def test_a_reset_acts_in_its_run_only(place: MakePlace, analog: MakeAnalog) -> None:
    effect, before = RangeReset(2.0, run=3.0), analog(0, 5)
    assert effect.analog(before, place(boot=2)) is before
    assert effect.analog(before, place(boot=3)).sensitivity == 4096


def test_a_reset_can_act_in_several_runs(place: MakePlace, analog: MakeAnalog) -> None:
    effect, before = RangeReset(2.0, runs=(3, 5)), analog(0, 5)
    reset = [effect.analog(before, place(boot=boot)).sensitivity == 4096 for boot in range(7)]
    assert np.flatnonzero(reset).tolist() == [3, 5]


def test_blocks_before_within_and_after_the_onset_agree(place: MakePlace, analog: MakeAnalog) -> None:
    effect = RangeReset(2.0, (0.1, 0.2, 0.3), onset_s=0.05)
    whole = effect.analog(analog(0, 20, value=1.0), place())
    for first, stop in ((0, 5), (5, 20), (3, 7)):
        part = effect.analog(analog(first, stop, value=1.0), place())
        np.testing.assert_array_equal(part.value * part.sensitivity, (whole.value * whole.sensitivity)[first:stop])
    before = analog(0, 5)
    assert effect.analog(before, place()) is before


def test_a_gyroscope_changes_its_scale_and_keeps_its_codes(place: MakePlace, analog: MakeAnalog) -> None:
    """70 mdps a digit at 2000 dps, 8.75 at 250 (L3G-40, L3G-42): eight times as many counts, in 16 bits still."""
    rows = analog(0, 2, sensitivity=1 / 0.07, lowest=-32768, highest=32767)
    after = RangeReset(250.0).analog(rows, place(header("l3g4200d")))
    assert after.sensitivity == pytest.approx(8 / 0.07)
    assert (after.lowest, after.highest) == (-32768, 32767)


@pytest.mark.parametrize(("rate_hz", "highest"), [(400.0, 511), (1600.0, 510)])
def test_adxl345_keeps_its_scale_and_clips_sooner(
    place: MakePlace, analog: MakeAnalog, rate_hz: float, highest: int
) -> None:
    """256 LSB/g at any range (ADX-40), ten bits at 2 g (ADX-46), even codes at 1600 Hz (ADX-47)."""
    rows = analog(0, 10, sensitivity=256.0, lowest=-4096, highest=4095, rate_hz=rate_hz)
    after = RangeReset(2.0, onset_s=0.05).analog(rows, place(header("adxl345", rate_hz=400.0)))
    np.testing.assert_array_equal(np.ravel(after.sensitivity), [256.0] * 10)
    np.testing.assert_array_equal(np.ravel(after.lowest), [-4096] * 5 + [-512] * 5)
    np.testing.assert_array_equal(np.ravel(after.highest), [4095] * 5 + [highest] * 5)


def test_resets_have_their_probability(place: MakePlace, analog: MakeAnalog) -> None:
    """One boot of fifteen, as in Table 6; 5 standard errors of 1000 boots: 6e-7."""
    effect, rows = RangeReset(2.0, probability=1 / 15), analog(0, 1)
    reset = [effect.analog(rows, place(boot=boot)).sensitivity == 4096 for boot in range(1000)]
    assert np.mean(reset) == pytest.approx(1 / 15, abs=5 * np.sqrt(14 / 15**2 / 1000))


def test_defaults_do_nothing_and_invalid_parameters_are_refused(place: MakePlace, analog: MakeAnalog) -> None:
    rows = analog(0, 10)
    assert RangeReset().analog(rows, place()) is rows
    with pytest.raises(ValueError, match=r"range: 7; allowed for S1 \(bma180\) are 1, 1\.5, 2, 3, 4, 8, 16$"):
        RangeReset(7.0, probability=0.0).analog(rows, place())
    with pytest.raises(ValueError, match=r"probability: 2(\.0)?; allowed is 0 to 1"):
        RangeReset(2.0, probability=2.0)
    with pytest.raises(ValueError, match="onset_s: inf"):
        RangeReset(2.0, onset_s=np.inf)


def test_known_stretches_are_flagged_and_in_the_other_range(
    place: MakePlace, analog: MakeAnalog, instants: Callable[..., Instants]
) -> None:
    """Rows 7 and 8 of 100 a second in run 2, doubted since row 5; rows 9 and 10 are lost while it is set up again."""
    effect = RangeReset(2.0, 0.25, runs=(2, 3), moments_s=(0.065, 0.2), lengths_s=(0.02, 0.1), doubts_s=(0.02, 0.0))  # type: ignore[arg-type]
    for first in (0, 8, 12):
        rows = effect.analog(analog(first, 20, value=1.0), place(boot=2))
        counts = np.broadcast_to(rows.value * rows.sensitivity, (20 - first, 3))[:, 0]
        wanted = np.where(np.isin(np.arange(first, 20), [7, 8]), 1.25 * 4096, 512.0)
        np.testing.assert_array_equal(counts, wanted)
    here = instants(0, 20)
    kept = replace(here, kept=~np.isin(np.arange(20), [9, 10]))
    status = np.zeros(20, np.uint16)
    flagged = effect.flagged(status, kept, place(boot=2))
    assert {int(row): int(flagged[row]) for row in np.flatnonzero(flagged)} == {
        5: SUSPECT,
        6: SUSPECT,
        7: SUSPECT,
        8: SUSPECT,
        11: RECONFIGURED,
    }
    assert not status.any()
    assert not effect.flagged(status, here, place(boot=1)).any()
    assert effect.analog(analog(0, 20), place(boot=1)).sensitivity == 512


def test_readings_before_the_first_measurement_are_blank(place: MakePlace, codes: Callable[..., Codes]) -> None:
    """Rows 7 to 9 of 100 a second in run 2, 7 before the chip has measured anything; none without that parameter."""
    effect = RangeReset(2.0, runs=(2,), moments_s=(0.065,), lengths_s=(0.03,), doubts_s=(0.0,), blanks_s=(0.01,))
    before = codes(0, 20, np.full((20, 1), 300))
    for first in (0, 7, 8):
        after = effect.codes(
            replace(before, first=first, counts=before.counts[first:], fresh=before.fresh[first:]), place(boot=2)
        )
        assert np.flatnonzero(~after.counts.any(axis=1)).tolist() == [7 - first] * (first < 8)
        assert np.flatnonzero(~after.fresh).tolist() == [7 - first] * (first < 8)
    assert effect.codes(before, place(boot=1)) is before
    silent = replace(effect, blanks_s=())
    assert silent.blanks_s == (0.0,)
    assert silent.codes(before, place(boot=2)) is before

"""Slips and conclusions: their verdicts, and the numbers in their evidence."""

from __future__ import annotations

import pytest
from scipy import stats

from imuarray.studies.paper.conclusions import SLIPS, conclusions, range_ratio, sign_test, slips

# Table or section of each slip, with words that its evidence must name.
SLIP_EVIDENCE = {
    "sign of the scale factors": ("Table 3", "box X on 18 of 18", "main axis on 9"),
    "azimuth formula": ("Appendix B", "88.8 deg", "-178.8 deg", "0 of 18", "18 of 18"),
    "six-term sum": ("Appendix B", "4 of 18", "18 of 18"),
    "orientation table": ("Table 1", "BMA2 printed +Y-X-Z has determinant -1", "+Y+X-Z with +1", "-Y-X-Z with +1"),
    "logging rate": ("Section 4", "47.90 to 47.97 Hz", "27 inertial channels", "a factor of 7.3"),
    "temperature slopes": ("Section 5.2.5", "0.187 to 0.265", "a factor of 10.0"),
    "combined slope": ("Section 5.2.5", "0.265 - 0.261 = 0.004", "0.002 LSB/degC"),
    "gyroscope bias": ("Section 5.2.2", "six readings gives 0 of 9", "9 of 9"),
    "ADXL345 ratios": ("Section 5.2.4", "1.20 to 1.95"),
    "thermometers": ("Table 11", "4 standard deviations", "0 are inertial"),
}


@pytest.mark.parametrize("name", SLIPS)
def test_slips_do_not_hold_and_their_evidence_has_the_numbers(name: str) -> None:
    place, *words = SLIP_EVIDENCE[name]
    statement = SLIPS[name]()
    assert statement.holds is False
    assert statement.claim.startswith(place)
    assert [word for word in words if word not in statement.evidence] == []


def test_every_slip_is_listed() -> None:
    assert len(slips()) == len(SLIPS) == len(SLIP_EVIDENCE)


VERDICTS = [
    ("5.2.4: run 10 of BMA1", True, "8.03 times"),
    ("5.2.4: Gyro3", True, "(-0.1, 70.0, 2.2) and (-12.6, 75.2, 0.7)"),
    ("6.1: the gyroscopes' temperature drift", True, "8 of 9 slopes are positive, sign test p = 0.039"),
    ("6.1, 7: opposed L3G4200D", True, "0.002 LSB/degC"),
    ("5.2.5, 6.1: how well a pair cancels", True, "12 times less"),
    ("6.1: both ADXL345 z axes", True, "-0.352, -0.194"),
    ("6.1: the BMA180's temperature drift", True, "5 of 12"),
    ("6.2: the ADXL345's z axis", True, "noise 1.99 and 2.02"),
    ("6.2: each BMA180's turn-on bias", False, "BMA2 1.86, BMA3 4.69, BMA4 2.74"),
    ("6.2: the gyroscopes' z axis", True, "1.06, 1.23, 0.98"),
    ("6.3: at +-1.5 g the BMA180 has half the noise", True, "9.53 against 17.05 mg"),
    ("6.3: the BMA180's fixed bias", True, "0.081 times"),
    ("6.3: the BMA180's temperature drift", True, "0.68 times"),
    ("6.3: the BMA180's biases are slightly more stable", False, "in-run 1.02, run-to-run 0.93"),
    ("6.3: the L3G4200D's noise", True, "0.99, 0.98, 0.94"),
    ("6.3: of the L3G4200D's systematic errors", False, "bias 0.41, in-run 0.55"),
    ("6.3, 7: weighting", True, "8.32 mg, 15 % below the plain average (9.77), 13 % below"),
    ("7: for each of the three techniques", True, "opposed axes yes, planes yes, ranges yes"),
]


def test_conclusions_have_their_verdicts_and_evidence() -> None:
    result = conclusions()
    assert len(result) == len(VERDICTS)
    for statement, (claim, holds, evidence) in zip(result, VERDICTS, strict=True):
        assert statement.claim.startswith(claim)
        assert (claim, statement.holds) == (claim, holds)
        assert evidence in statement.evidence
        assert "criterion" in statement.evidence


@pytest.mark.parametrize(("positive", "total"), [(8, 9), (1, 9), (5, 12), (6, 12), (0, 5), (1, 1)])
def test_the_sign_test_equals_scipy(positive: int, total: int) -> None:
    assert sign_test(positive, total) == pytest.approx(float(stats.binomtest(positive, total).pvalue))


def test_the_ratio_of_biases_of_two_ranges_by_hand() -> None:
    """Table 3's biases, mg as printed: six at 1.5 g, six at 16 g."""
    low = (10.1 + 2.1 + 9.7 + 9.9 + 7.7 + 27.2) / 6
    high = (180.6 + 249.5 + 22.5 + 53.8 + 184.8 + 132.9) / 6
    assert float(range_ratio("BMA", 3, ["bias_lsb"])) == pytest.approx(low / high, rel=2e-3)
    without = float(range_ratio("BMA", 11, ["runs_std_of_means"], leave_out="BMA1"))
    by_hand = (1.058 + 0.650 + 4.008 + 1.111 + 1.573 + 3.678) / 6 / 5460 / ((0.148 + 0.167 + 0.293) / 3 / 512)
    assert without == pytest.approx(by_hand)

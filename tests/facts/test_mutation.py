"""Every fact has a witness: the mutation run, and tests of the run itself."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("mutation.py")


@pytest.mark.campaign
def test_every_fact_has_a_witness():
    run = subprocess.run([sys.executable, str(SCRIPT), "--json"], capture_output=True, text=True, timeout=600)
    report = json.loads(run.stdout)
    assert report["without_witness"] == []
    assert report["inert_no_more"] == []
    assert report["all"]["wrong_facts"] > 3000
    assert report["all"]["noticed"] > 0.9
    assert report["stated"]["by_golden"] > 0.5  # the conversations alone, without the table check
    assert all(entry["reason"] for entry in report["inert"])


@pytest.mark.slow
def test_facts_of_one_chip_have_witnesses(mutation):
    """Every eighth mutant of a small table; campaigns try all of every table."""
    tried = list(mutation.mutants("bmp180"))[::8]
    escaped = {mutant[:3] for mutant in tried if not mutation.judge(mutant).noticed}
    assert escaped <= mutation.INERT.keys()
    assert len(escaped) < 0.2 * len(tried)


def test_mutants_cover_values_access_and_addresses(mutation):
    wrong = {(mutant.fact, mutant.change): mutant for mutant in mutation.mutants("bmp180")}
    assert wrong["CHIP_ID reset", "0x55 -> 0x54"].stated
    assert not wrong["CTRL_MEAS reset", "0x00 -> 0x01"].stated
    assert wrong["OVERSAMPLING low", "[7:6] -> [7:7]"].stated
    assert wrong["ADDRESSES number", "0x77 -> 0x76"].stated
    assert {change for fact, change in wrong if fact == "OUT_MSB access"} == {"r -> w", "r -> rw"}
    right = (mutation.ROOT / "imuarray" / "facts" / "bmp180.py").read_text()
    assert len({mutant.source for mutant in wrong.values()} | {ast.unparse(ast.parse(right))}) == len(wrong) + 1


@pytest.mark.parametrize(
    ("chip", "fact", "change", "tables", "golden"),
    [
        ("bmp180", "CHIP_ID reset", "0x55 -> 0x54", False, True),
        ("bmp180", "MEASUREMENT high", "[4:0] -> [5:0]", True, True),
        ("bmp180", "ADDRESSES number", "0x77 -> 0x76", True, True),
        ("bma180", "CTRL_REG0 reset", "0x00 -> 0x20", False, False),
    ],
)
def test_a_mutant_is_detected_by_the_expected_check(mutation, chip, fact, change, tables, golden):
    (mutant,) = [mutant for mutant in mutation.mutants(chip) if (mutant.fact, mutant.change) == (fact, change)]
    assert mutation.judge(mutant)[1:] == (tables, golden)


def test_judging_restores_the_packages(mutation):
    """The import of the mutated table sets attributes of the packages; these are restored."""
    import imuarray.acquire
    import imuarray.facts

    before = dict(vars(imuarray.acquire)), dict(vars(imuarray.facts))
    (mutant, *_) = mutation.mutants("bmp180")
    mutation.judge(mutant)
    assert (vars(imuarray.acquire), vars(imuarray.facts)) == before

"""The tables of `imuarray.facts` check themselves; and the check detects each kind of mistake."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from imuarray import facts
from imuarray.facts.registers import Register
from tests.facts.tables import CHIPS


def table(**contents: object) -> ModuleType:
    module = ModuleType("pca9544a")
    vars(module).update(ADDRESSES=tuple(range(0x70, 0x78)), **contents)
    return module


def test_every_table_is_checked(tables):
    modules = {path.stem for path in Path(facts.__file__).parent.glob("*.py")}
    assert modules - {"__init__", "registers", *CHIPS} == set(), "no line in tests/facts/tables.py: CHIPS"
    assert modules - {"__init__", "registers"} == set(CHIPS) == set(tables.CHIPS)


@pytest.mark.parametrize("chip", CHIPS)
def test_tables_have_no_complaints(tables, chip):
    assert tables.complaints(chip, import_module(f"imuarray.facts.{chip}")) == []


GOOD = Register(0x00, reserved=0x08)


@pytest.mark.parametrize(
    ("contents", "complaint"),
    [
        ({"A": GOOD, "HIGH": GOOD[7:4], "LOW": GOOD[2:0]}, None),
        ({"A": GOOD, "HIGH": GOOD[7:4], "LOW": GOOD[1:0]}, "A: bits 0x04 belong to no field"),
        ({"A": GOOD, "HIGH": GOOD[7:3], "LOW": GOOD[2:0]}, "HIGH overlaps"),
        ({"A": GOOD, "HIGH": GOOD[7:4], "LOW": GOOD[2:0], "ONE": GOOD[0]}, "ONE overlaps"),
        ({"A": GOOD, "B": Register(0x00)}, "B is at 0x00, where A is"),
        ({"A": Register(0x01)}, "access rw: registers ['0x0', '0x1'] disagree"),
        ({"A": Register(0x00, "r")}, "access r: registers ['0x0'] disagree"),
        ({"A": Register(0x00, reset=0x0C, reserved=0x08)}, "A: reset 0xc, reserved 0x8"),
        ({"A": Register(0x00, reset=0x100)}, "A: reset 0x100"),
        ({"A": GOOD}, "A: reserved 0x08, which no field bounds"),
        ({"A": GOOD, "HIGH": GOOD[7:4], "LOW": GOOD[2:0], "LOST": Register(0x05)[0]}, "LOST: its register has no name"),
    ],
)
def test_each_kind_of_mistake_is_detected(tables, contents, complaint):
    problems = tables.complaints("pca9544a", table(**contents))
    assert (problems == []) if complaint is None else any(line.startswith(complaint) for line in problems)


def test_an_invented_reset_value_is_detected(tables):
    sensor = ModuleType("bmp180")
    vars(sensor).update(vars(import_module("imuarray.facts.bmp180")) | {"CALIBRATION": Register(0xAA, "r", reset=0x01)})
    assert tables.complaints("bmp180", sensor) == ["CALIBRATION: no reset value is printed, 0x01 is said"]


def test_a_wrong_bus_address_is_detected(tables):
    module = table(A=GOOD, HIGH=GOOD[7:4], LOW=GOOD[2:0])
    module.ADDRESSES = (0x70, 0x71)
    assert tables.complaints("pca9544a", module) == ["bus addresses (112, 113)"]

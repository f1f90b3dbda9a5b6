"""Which wrong facts are detected? Every fact in `imuarray.facts` is made wrong, one bit at a time.

    python tests/facts/mutation.py [--json]

Of each register the address, access, reset value and reserved bits (also where the table leaves them at their default),
of each field both bounds, of each chip its bus addresses. A wrong fact is noticed if the table check (tables.py)
complains or a golden conversation (tests/golden) differs, with driver or chip. A fact that neither detects has to be in
`INERT`, with the reason.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, NamedTuple, NoReturn

ROOT = Path(__file__).parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))

CHIPS = sorted(
    path.stem for path in (ROOT / "imuarray" / "facts").glob("*.py") if path.stem not in ("__init__", "registers")
)
"""Every chip of which there are facts, as test_tables.py checks."""
ACCESSES = ("r", "w", "rw")
HANGS_S = 10
CONTROL_EVERY = 25
READERS = ("imuarray.drivers", "firmware_emulator.chips", "imuarray.acquire.bus_segment", "firmware_emulator.board")
FAMILIES = ("imuarray.drivers.", "firmware_emulator.chips.")
"""Packages with modules of several chips, which are named after none of them."""
INERT: dict[tuple[str, str, str], str] = {
    ("bma180", "CTRL_REG0 reset", "0x00 -> 0x20"): "update_image clears itself when the download of power-on ends",
    ("icm42688", "DEVICE_CONFIG reset", "0x00 -> 0x01"): "SOFT_RESET clears itself when the reset of power-on ends",
    ("lsm6dso", "CTRL3_C reset", "0x04 -> 0x05"): "SW_RESET clears itself when the reset of power-on ends",
    ("mpu6050", "PWR_MGMT_1 reset", "0x40 -> 0xc0"): "DEVICE_RESET clears itself when the reset of power-on ends",
    ("mpu6500", "PWR_MGMT_1 reset", "0x01 -> 0x81"): "DEVICE_RESET clears itself when the reset of power-on ends",
}
"""By chip, fact and change: why no conversation can notice it."""


class Mutant(NamedTuple):
    """A table with one wrong fact."""

    chip: str
    fact: str
    change: str
    stated: bool
    """Whether the table prints this fact; otherwise it is the default of `Register`."""
    source: str


class Verdict(NamedTuple):
    """The checks that detected it."""

    mutant: Mutant
    tables: bool
    golden: bool

    @property
    def noticed(self) -> bool:
        return self.tables or self.golden


# Wrong facts ----------------------------------------------------------------------------------------------------------


def mutants(chip: str) -> Iterator[Mutant]:
    """Every table of `chip` with one bit wrong."""
    statements = ast.parse((ROOT / "imuarray" / "facts" / f"{chip}.py").read_text()).body
    texts = [ast.unparse(statement) for statement in statements]
    for index, statement in enumerate(statements):
        if not (isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name)):
            continue
        name, left_out = statement.targets[0].id, _left_out(statement.value)
        for fact, change, value in _wrong(statement.value):
            source = "\n".join([*texts[:index], f"{name} = {ast.unparse(value)}", *texts[index + 1 :]])
            yield Mutant(chip, f"{name} {fact}", change, fact not in left_out, source)


def _left_out(value: ast.expr) -> set[str]:
    """The attributes that a ``Register(...)`` leaves at their defaults."""
    if not isinstance(value, ast.Call):
        return set()
    names = {*("address", "access")[: len(value.args)], *(keyword.arg for keyword in value.keywords)}
    return {"access", "reset", "reserved"} - names


def _wrong(value: ast.expr) -> Iterator[tuple[str, str, ast.expr]]:
    """Fact, change and wrong expression, for each way in which one assignment can be wrong."""
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "Register":
        yield from _wrong_registers(value)
    elif isinstance(value, ast.Subscript):
        yield from _wrong_fields(value)
    else:
        yield from _wrong_numbers(value)


def _wrong_registers(call: ast.Call) -> Iterator[tuple[str, str, ast.expr]]:
    arguments: dict[str, Any] = {"access": "rw", "reset": 0, "reserved": 0}
    arguments |= dict(zip(("address", *arguments), map(ast.literal_eval, call.args), strict=False))
    arguments |= {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in call.keywords}
    for fact in ("address", "reset", "reserved"):
        for bit in range(8):
            yield (
                fact,
                f"{arguments[fact]:#04x} -> {arguments[fact] ^ 1 << bit:#04x}",
                _register({**arguments, fact: arguments[fact] ^ 1 << bit}),
            )
    for bit in range(3 if "bank" in arguments else 0):
        wrong = arguments["bank"] ^ 1 << bit
        yield "bank", f"{arguments['bank']} -> {wrong}", _register({**arguments, "bank": wrong})
    for access in ACCESSES:
        if access != arguments["access"]:
            yield "access", f"{arguments['access']} -> {access}", _register({**arguments, "access": access})


def _register(arguments: dict[str, Any]) -> ast.expr:
    text = ", ".join(f"{key}={value!r}" for key, value in arguments.items())
    return ast.parse(f"Register({text})", mode="eval").body


def _wrong_fields(field: ast.Subscript) -> Iterator[tuple[str, str, ast.expr]]:
    """Other bounds that a byte can have."""
    bounds = field.slice
    pair = (bounds.lower, bounds.upper) if isinstance(bounds, ast.Slice) else (bounds, bounds)
    high, low = (ast.literal_eval(bound) for bound in pair if bound is not None)
    register = ast.unparse(field.value)
    wrong = [("high", high ^ 1 << bit, low) for bit in range(3)] + [("low", high, low ^ 1 << bit) for bit in range(3)]
    if high == low:
        wrong += [("bit", high ^ 1 << bit, high ^ 1 << bit) for bit in range(3)]
    for fact, upper, lower in wrong:
        if 7 >= upper >= lower >= 0:
            text = f"{register}[{upper}:{lower}]"
            yield fact, f"[{high}:{low}] -> [{upper}:{lower}]", ast.parse(text, mode="eval").body


def _wrong_numbers(value: ast.expr) -> Iterator[tuple[str, str, ast.expr]]:
    """Every number in a tuple or a range, a bit at a time."""
    for place, node in enumerate(ast.walk(value)):
        if isinstance(node, ast.Constant) and isinstance(node.value, int):
            for bit in range(7):
                wrong = copy.deepcopy(value)
                twin = list(ast.walk(wrong))[place]
                if isinstance(twin, ast.Constant):
                    twin.value = node.value ^ 1 << bit
                yield "number", f"{node.value:#04x} -> {node.value ^ 1 << bit:#04x}", wrong


# Detection ------------------------------------------------------------------------------------------------------------


def judge(mutant: Mutant) -> Verdict:
    """Replace the table, and everything that has read it, and run the checks."""
    for name in READERS:
        import_module(name)
    package, before = import_module("imuarray.facts"), _ours()
    attributes = {name: dict(vars(module)) for name, module in before.items() if hasattr(module, "__path__")}
    previous = signal.signal(signal.SIGALRM, _hangs)
    signal.alarm(HANGS_S)
    try:
        facts = _install(mutant, package)
        tables = _loaded("facts_tables", ROOT / "tests" / "facts" / "tables.py")
        return Verdict(mutant, bool(tables.complaints(mutant.chip, facts)), _golden_notices(mutant.chip))
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)
        for name in _ours():
            del sys.modules[name]
        sys.modules.update(before)
        for name, names in attributes.items():  # an import replaces them
            vars(before[name]).update(names)


def _ours() -> dict[str, ModuleType]:
    """The loaded modules of the project and its tests."""
    ours = ("imuarray", "firmware_emulator", "golden_replay", "facts_tables")
    return {name: module for name, module in sys.modules.items() if name.startswith(ours)}


def _hangs(number: int, frame: FrameType | None) -> NoReturn:
    raise TimeoutError(f"{HANGS_S} s")


def _install(mutant: Mutant, package: ModuleType) -> ModuleType:
    """The wrong table in place of the right one; modules that have read that are unloaded."""
    name = f"imuarray.facts.{mutant.chip}"
    facts = ModuleType(name)
    exec(compile(mutant.source, name, "exec"), vars(facts))  # noqa: S102 - our own table, mutated
    right = sys.modules.get(name)
    stale = (f"imuarray.drivers.{mutant.chip}", f"firmware_emulator.chips.{mutant.chip}")
    whole = {*READERS}
    if mutant.fact.startswith("ADDRESSES"):
        whole |= {"imuarray.chips", "imuarray.array"}
    for loaded, module in list(sys.modules.items()):
        reads = loaded.startswith(FAMILIES) and any(value is right for value in vars(module).values())
        if reads or loaded in whole or loaded.startswith(stale):
            del sys.modules[loaded]
    sys.modules[name] = facts
    setattr(package, mutant.chip, facts)
    return facts


def _golden_notices(chip: str) -> bool:
    """Whether any conversation of `chip` differs, or can't even be held."""
    try:
        replay = _loaded("golden_replay", ROOT / "tests" / "golden" / "replay.py")
        for path in replay.PATHS:
            if not path.stem.startswith(chip):
                continue
            conversation = replay.load(path)
            if conversation.is_for("driver"):
                replay.play_to_driver(conversation)
            if conversation.is_for("chip"):
                replay.play_to_chip(conversation)
    except Exception:  # any error from a wrong fact counts as detected
        return True
    return False


def _loaded(name: str, path: Path) -> ModuleType:
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(path)
    module = module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


# The run --------------------------------------------------------------------------------------------------------------


def run() -> dict[str, Any]:
    """All verdicts, summed up: shares detected, and facts that escaped."""
    for chip in CHIPS:
        if judge(_right(chip)).noticed:
            raise RuntimeError(f"{chip}: complaints as it stands; run tests/facts and tests/golden first")
    every = [mutant for chip in CHIPS for mutant in mutants(chip)]
    controls = [_right(every[index].chip) for index in range(0, len(every), CONTROL_EVERY)]
    mixed = [part for index in range(len(controls)) for part in (*_slice(every, index), controls[index])]
    with multiprocessing.get_context("fork").Pool(min(2, os.cpu_count() or 1)) as pool:
        judged = pool.map(judge, mixed, chunksize=4 * (CONTROL_EVERY + 1))
    verdicts = [verdict for verdict in judged if verdict.mutant.fact]
    if any(verdict.noticed for verdict in judged if not verdict.mutant.fact):
        raise RuntimeError("a right table was complained of: one wrong fact has outlived its trial")
    escaped = [verdict.mutant for verdict in verdicts if not verdict.noticed]
    listed = [{"chip": mutant.chip, "fact": mutant.fact, "change": mutant.change} for mutant in escaped]
    reasons = [INERT.get((mutant.chip, mutant.fact, mutant.change)) for mutant in escaped]
    return {
        "all": _shares(verdicts),
        "stated": _shares([verdict for verdict in verdicts if verdict.mutant.stated]),
        "inert": [{**entry, "reason": reason} for entry, reason in zip(listed, reasons, strict=True) if reason],
        "without_witness": [entry for entry, reason in zip(listed, reasons, strict=True) if not reason],
        "inert_no_more": [" ".join(key) for key in INERT if key not in {mutant[:3] for mutant in escaped}],
    }


def _right(chip: str) -> Mutant:
    """The unchanged table, which must have no complaint."""
    return Mutant(chip, "", "", True, (ROOT / "imuarray" / "facts" / f"{chip}.py").read_text())


def _slice(every: list[Mutant], index: int) -> list[Mutant]:
    return every[index * CONTROL_EVERY : (index + 1) * CONTROL_EVERY]


def _shares(verdicts: list[Verdict]) -> dict[str, float]:
    """How many wrong facts there were, and the shares noticed: by either, by each alone."""
    count = len(verdicts)
    return {
        "wrong_facts": count,
        "noticed": sum(verdict.noticed for verdict in verdicts) / count,
        "by_tables": sum(verdict.tables for verdict in verdicts) / count,
        "by_golden": sum(verdict.golden for verdict in verdicts) / count,
    }


def main() -> int:
    """Print the result of the run; 1 if a fact has no witness."""
    parser = argparse.ArgumentParser(description="Make register facts wrong one by one; count those noticed (minutes).")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    arguments = parser.parse_args()
    result = run()
    if arguments.json:
        print(json.dumps(result, indent=1))
        return int(bool(result["without_witness"]))
    for kind, text in (("all", "defaults included"), ("stated", "printed in the tables")):
        share = result[kind]
        print(f"{share['wrong_facts']} wrong facts ({text}): {share['noticed']:.2%} noticed,", end=" ")
        print(f"by the table check {share['by_tables']:.1%}, by golden conversations {share['by_golden']:.1%}")
    for entry in result["inert"]:
        print(f"inert: {entry['chip']} {entry['fact']} {entry['change']}: {entry['reason']}")
    for entry in result["without_witness"]:
        print(f"without witness: {entry['chip']} {entry['fact']} {entry['change']}")
    for key in result["inert_no_more"]:
        print(f"inert no more: {key}")
    return int(bool(result["without_witness"]))


if __name__ == "__main__":
    sys.exit(main())

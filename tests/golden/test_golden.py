"""Every golden conversation, both ways; and the player itself detects differences."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from imuarray.chips import CHIPS

PATHS = sorted(Path(__file__).parent.glob("*.jsonl"))
Lines = list[dict[str, Any]]


def played_by(side: str) -> list[Any]:
    """The files for one side."""
    heads = {path: json.loads(path.read_text().splitlines()[0]) for path in PATHS}
    sides = {
        path: head.get("played", ["chip"] if head["part"] == "chip only" else ["driver", "chip"])
        for path, head in heads.items()
    }
    return [pytest.param(path, id=path.stem) for path in PATHS if side in sides[path]]


@pytest.mark.parametrize("path", played_by("driver"))
def test_the_driver_makes_these_transactions(replay, path):
    conversation = replay.load(path)
    assert conversation.is_for("driver")
    replay.play_to_driver(conversation)


@pytest.mark.parametrize("path", played_by("chip"))
def test_the_chip_gives_these_answers(replay, path):
    conversation = replay.load(path)
    assert conversation.is_for("chip")
    replay.play_to_chip(conversation)


def test_every_chip_is_identified_configured_and_read(replay):
    held = {(conversation.chip, conversation.part) for conversation in map(replay.load, PATHS)}
    assert {*CHIPS} - {chip for chip, _ in held} == set(), "no conversation in tests/golden"
    assert {chip for chip, _ in held} == {*CHIPS, "pca9544a"}
    assert held >= {(chip, part) for chip in CHIPS for part in ("identify", "configure", "fetch")}
    assert held >= {(chip, "drain") for chip in ("adxl345", "l3g4200d")}


@pytest.fixture
def changed(replay, tmp_path) -> Callable[[str, Callable[[Lines], None]], Any]:
    """A conversation from a file that was spoilt."""

    def change(name: str, spoil: Callable[[Lines], None]) -> Any:
        lines = [json.loads(text) for text in (replay.HERE / f"{name}.jsonl").read_text().splitlines()]
        spoil(lines)
        path = tmp_path / f"{name}.jsonl"
        path.write_text("\n".join(map(json.dumps, lines)))
        return replay.load(path)

    return change


def set_(line: int, **values: Any) -> Callable[[Lines], None]:
    return lambda lines: lines[line].update(values)


@pytest.mark.parametrize(
    ("name", "spoil", "complaint"),
    [
        ("adxl345_configure_16g_400hz", set_(1, write="2d08"), r"hz.jsonl, line 2: to 53: write \[2d 08\] read 0 exp"),
        ("adxl345_configure_16g_400hz", set_(1, to="1d"), r"line 2: to 1d: .* to 53: write \[2d 00\] read 0 came"),
        ("adxl345_configure_16g_400hz", set_(-1, wait_ms=3.7), "line 20: 0.1 ms too early"),
        ("bma180_configure_16g_150hz", set_(2, wait_ms=20.1), "line 3: 0.1 ms too early"),
        ("adxl345_configure_16g_400hz", lambda lines: lines.append(lines[1]), r"line 21: not said: to 53: write \[2d"),
        (
            "adxl345_configure_16g_400hz",
            lambda lines: lines.__delitem__(slice(-3, None)),
            r"\[2d 08\] .* after the last",
        ),
        ("bma180_fetch_stale", set_(-1, counts=[[512, 0, -511]]), "line 3: counts .*-512.*, expected .*-511"),
        ("bma180_fetch_stale", set_(-1, stale=[False]), "line 3: stale"),
        ("bma180_fetch_stale", set_(-1, temperature_counts=[2]), "line 3: temperature_counts"),
        ("pca9544a_select", set_(-1, write="06"), "line 5: to 70"),
    ],
)
def test_a_driver_that_differs_is_detected(replay, changed, name, spoil, complaint):
    with pytest.raises(replay.DifferenceError, match=complaint):
        replay.play_to_driver(changed(name, spoil))


@pytest.mark.parametrize(
    ("name", "spoil", "complaint"),
    [
        ("adxl345_identify", set_(1, read="e4"), r"line 2: to 53: write \[00\] read 1: e5, expected e4"),
        ("adxl345_identify", set_(1, to="54"), r"line 2: to 54: .* nobody acknowledges"),
        ("adxl345_identify", set_(1, nack=True), r"line 2: .* acknowledged, and should not be"),
        ("adxl345_fetch_16g", set_(2, read="830b0001000001ff"), "line 3: .*: 83 0b 00 01 00 00 00 ff, expected"),
    ],
)
def test_a_chip_that_differs_is_detected(replay, changed, name, spoil, complaint):
    with pytest.raises(replay.DifferenceError, match=complaint):
        replay.play_to_chip(changed(name, spoil))


def test_only_masked_bits_are_compared(replay, changed):
    replay.play_to_chip(changed("adxl345_identify", set_(1, read="ef", mask="f0")))
    with pytest.raises(replay.DifferenceError, match="line 2"):
        replay.play_to_chip(changed("adxl345_identify", set_(1, read="ef", mask="02")))


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"source": "somebody said so"}, "line 2: the source has no id of a fact"),
        ({"mask": "ffff"}, "line 2: neither .* or a mask of another length"),
        ({"wait_ms": 1}, "line 2: neither transaction nor wait"),
    ],
)
def test_an_invalid_line_is_refused(replay, changed, values, complaint):
    with pytest.raises(replay.DifferenceError, match=complaint):
        changed("adxl345_identify", set_(1, **values))


def test_a_part_that_does_not_exist_is_refused(replay, changed):
    with pytest.raises(replay.DifferenceError, match="part 'reset'"):
        changed("adxl345_identify", set_(0, part="reset"))

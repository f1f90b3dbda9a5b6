"""Processor time to refuse a hostile log, against 50 ms, and to read a journal with 64 MB of anything behind it,
against a second.

Each kind of `tests/log/hostile_files.py` damages a log of the paper's array. The figure is the longest time of all
kinds; that of a kind is the shortest of several attempts, which excludes other work of the machine.
"""

from __future__ import annotations

import random
import shutil
import struct
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from compare import Row, row

from imuarray.acquire.recorder import record
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.errors import LogError
from imuarray.log import Block, Log, LogWriter, open_log
from imuarray.log.format import SensorHeader
from imuarray.log.journal import JournalReader, journal_of, tag_of

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.log.hostile_files import KINDS, damage_log

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
TRIES = 7
WANTED_MS = 50.0
WANTED_TAIL_S = 1.0
TAIL_BYTES = 64 << 20


def refused_ms(path: Path, said: str) -> float:
    """Milliseconds to a refusal that says so; RuntimeError for any other outcome."""
    begun_s = time.process_time()
    try:
        open_log(path).close()
    except LogError as error:
        spent_s = time.process_time() - begun_s
        if said not in str(error):
            raise RuntimeError(f"{path}: {error}") from error
        return 1e3 * spent_s
    raise RuntimeError(f"{path}: is let in")


def tails(tag: int) -> dict[str, bytes]:
    """Bytes that may stand behind a journal whose blocks bear this tag: what a disk leaves, and what costs most."""
    head = struct.pack("<HHII", 0, tag, 100, 5)
    return {
        "zeros": bytes(TAIL_BYTES),
        "random bytes": random.Random(1).randbytes(TAIL_BYTES),
        "tags": tag.to_bytes(2, "little") * (TAIL_BYTES // 2),
        "heads of blocks": head * (TAIL_BYTES // len(head)),
    }


def tail_row(folder: Path) -> Row:
    """The slowest journal with something behind it."""
    path, header = folder / "tail.h5", SensorHeader("A", "bma180", "specific_force", "g", 16.0, 512.0)
    with LogWriter(path, [header], source="simulated", epoch="2026-01-01T00:00:00Z", watermark=0) as log:
        log.keep()
        log.append("A", Block(np.arange(100), np.zeros((100, 3), np.int16), np.zeros(100, np.uint16)))
        log.flush()
        content = journal_of(path).read_bytes()
        shutil.copy(path, folder / "cut.h5")
    with_tail, spent = journal_of(folder / "cut.h5"), {}
    with_tail.write_bytes(content)
    with JournalReader(folder / "cut.h5") as journal:
        kinds = tails(tag_of(journal.preamble.identity))
    for kind, tail in kinds.items():
        with_tail.write_bytes(content + tail)
        begun_s = time.process_time()
        Log(folder / "cut.h5", thorough=True).close()
        spent[kind] = time.process_time() - begun_s
    kind = max(spent, key=lambda kind: spent[kind])
    return row(f"journal with 64 MB behind it, read ({kind})", spent[kind], WANTED_TAIL_S, "s", 1, "lower")


def rows() -> list[Row]:
    """The slowest kind of hostile log, and the slowest journal."""
    spent: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        good = Path(name) / "good.h5"
        array = load_array(CONFIG)
        renamed = {sensor.name: sensor.name for sensor in array.sensors}
        renamed[array.sensors[0].name] = "Acc"
        sensors = tuple(sensor.model_copy(update={"name": renamed[sensor.name]}) for sensor in array.sensors)
        array = array.model_copy(update={"sensors": sensors})
        with open_bus("emulated:", array) as bus:
            record(array, bus, good, rate_hz=50, seconds=20)
        for kind in KINDS:
            path = Path(name) / "spoilt.h5"
            shutil.copy(good, path)
            said = damage_log(path, kind)
            spent[kind] = min(refused_ms(path, said) for _ in range(TRIES))
        journals = tail_row(Path(name))
    worst = max((ms, kind) for kind, ms in spent.items())
    return [
        row(
            f"hostile logs, {len(spent)} kinds, the slowest refusal ({worst[1]})", worst[0], WANTED_MS, "ms", 1, "lower"
        ),
        journals,
    ]


if __name__ == "__main__":
    for found in rows():
        print(found)

"""Damage a log in COUNT ways and read all of each: `python fuzz.py LOG SEED COUNT [fixed]`.

Ends with 0 if every one was read or refused by a LogError, in time and in little memory; names any other. A crash of
the interpreter is detected by the caller. `fixed`: the check sums of object headers are made right again, so that HDF5
accepts them.
"""

from __future__ import annotations

import resource
import signal
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from imuarray.errors import LogError
from imuarray.log import open_log
from imuarray.log.inspection import _checksum
from imuarray.log.journal import journal_of

MEMORY = 2 << 30
LONGEST_S = 20
WORDS = (b"\0" * 8, b"\xff" * 8, b"\x7f" + b"\xff" * 7, b"\0" * 7 + b"\x80", b"\1" + b"\0" * 7, b"\0\0\0\1\0\0\0\0")


def spoilt(data: bytes, draw: np.random.Generator, marks: list[int]) -> bytearray:
    """A few changes, most of them where headers begin."""
    changed = bytearray(data)
    for _ in range(draw.integers(1, 4)):
        near = marks and draw.random() < 0.7
        at = int(marks[draw.integers(len(marks))] + draw.integers(0, 64)) if near else int(draw.integers(len(data)))
        way = draw.integers(6)
        if way == 0 and at < len(changed):
            changed[at] ^= 1 << int(draw.integers(8))
        elif way == 1 and at < len(changed):
            changed[at] = int(draw.integers(256))
        elif way == 2:
            word = WORDS[draw.integers(len(WORDS))][: int(draw.integers(1, 9))]
            changed[at : at + len(word)] = word
        elif way == 3:
            start, length = int(draw.integers(len(data))), int(draw.integers(1, 200))
            changed[at : at + length] = data[start : start + length]
        elif way == 4 and draw.random() < 0.3:
            del changed[at:]
        elif way == 5 and draw.random() < 0.3:
            changed[at:at] = bytes(int(draw.integers(1, 16)))
    return changed


def marks_of(data: bytes) -> list[int]:
    """Where structures begin that HDF5 identifies by a signature."""
    signs = (b"OHDR", b"OCHK", b"FRHP", b"FHDB", b"FHIB", b"BTHD", b"BTLF", b"BTIN", b"GCOL", b"EAHD", b"EAIB", b"FADB")
    signs += (b"TREE", b"SNOD", b"HEAP", b"\x89HDF", b"imuarray", b"deflate")
    return sorted(at for sign in signs for at in range(len(data)) if data.startswith(sign, at))


def fix(data: bytearray) -> None:
    """Check sums of object headers (HDF5 file format, IV.A.1.b: version 2)."""
    at = data.find(b"OHDR")
    while at >= 0:
        flags = data[at + 5] if at + 5 < len(data) else 0
        start = at + 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
        width = 1 << (flags & 3)
        end = start + width + int.from_bytes(data[start : start + width], "little")
        if end + 4 <= len(data) and end - at < 1 << 16:
            data[end : end + 4] = _checksum(bytes(data[at:end]))
        at = data.find(b"OHDR", at + 4)


def read(path: Path) -> bool:
    """Read everything; return whether it was accepted."""
    try:
        with open_log(path) as log:
            _ = (log.phases, log.events, log.epoch, log.config, log.software, log.state)
            for track in (log.truth, log.reference):
                if track is not None:
                    for column in track:
                        _ = None if column is None else column[:4096]
            for sensor in log.sensors.values():
                for block in sensor.blocks():
                    _ = sensor.time[block], sensor.counts[block], sensor.status[block]
                dict(sensor.attributes)
                break
        return True
    except LogError as error:
        if not str(error).isprintable():
            raise
        return False
    except OSError:  # a wrong check sum of a chunk is reported when the chunk is read
        return True


def main() -> int:
    """Everything; exit code."""
    original, seed, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    fixed = "fixed" in sys.argv
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    beside = journal_of(original).read_bytes() if journal_of(original).exists() else b""
    data = original.read_bytes()
    path = original.with_name("spoilt.h5")
    draw = np.random.default_rng(seed)
    marks, marks_beside = marks_of(data), marks_of(beside)
    let_in, slowest = 0, 0.0
    for number in range(count):
        changed = spoilt(data, draw, marks)
        if fixed:
            fix(changed)
        path.write_bytes(changed)
        if beside:
            journal_of(path).write_bytes(spoilt(beside, draw, marks_beside) if draw.random() < 0.5 else beside)
        Path(sys.argv[1]).with_name("number").write_text(str(number))
        signal.alarm(LONGEST_S)
        begun_s = time.monotonic()
        let_in += read(path)
        slowest = max(slowest, time.monotonic() - begun_s)
    status = Path("/proc/self/status").read_text(encoding="ascii")  # ru_maxrss is at least that of the parent process
    peak = int(status.split("VmHWM:")[1].split()[0]) >> 10
    print(f"{count} logs: {let_in} let in, slowest {slowest:.3f} s, {peak} MiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Good logs damaged at random in another process: each is read or refused; none crashes or hangs it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Event, Phase, SensorHeader
from imuarray.log.journal import journal_of
from tests.selection import some

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits memory and time as Unix does")

HERE = Path(__file__).parent
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE.parents[1]), *sys.path])}
ACC = SensorHeader("Acc", "bma180", "specific_force", "g", 16.0, 512.0, 2400.0, 150.0, has_temperature=True)
GYRO = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 1 / 0.00875, 800.0, 35.0)


def finished(small: Path, folder: Path) -> Path:
    """As it is."""
    return Path(shutil.copy(small, folder / "a.h5"))


def old_format(small: Path, folder: Path) -> Path:
    """The same in HDF5's first format, whose headers have no check sums: it accepts more damage."""
    with h5py.File(small) as log, h5py.File(folder / "a.h5", "w", libver="earliest") as copy:
        for name in log:
            log.copy(name, copy, without_attrs=True)  # HDF5 1.14.2 crashes where it copies references to scales
        copy.attrs.update(log.attrs)
        log.visititems(lambda name, item: describe(copy[name], item))
    return folder / "a.h5"


def describe(to: h5py.Group | h5py.Dataset, item: h5py.Group | h5py.Dataset) -> None:
    """Gives `to`, the copy of an object in another file, the object's attributes and scales."""
    for name, value in item.attrs.items():
        if name not in ("DIMENSION_LIST", "REFERENCE_LIST"):
            to.attrs.create(name, value, dtype=item.attrs.get_id(name).dtype)
    if isinstance(item, h5py.Dataset) and not item.is_scale:
        for own, dimension in zip(to.dims, item.dims, strict=True):
            for scale in dimension.values():
                own.attach_scale(to.file[scale.name])


def unfinished(small: Path, folder: Path) -> Path:
    """A log that was cut short, and its journal."""
    path = folder / "run.h5"
    epoch = "2013-09-16T08:30:00.000000Z"
    with LogWriter(path, [ACC, GYRO], source="simulated", epoch=epoch, config="# toml", watermark=0) as log:
        log.keep()
        time = np.arange(5000) * 10_000_000
        status = np.zeros(5000, np.uint16)
        log.append("Acc", Block(time, np.zeros((5000, 3), np.int16), status, np.zeros(5000, np.int16)))
        log.append("Gyro", Block(time[:50], np.ones((50, 3), np.int16), status[:50]))
        log.event(Event(5, "Acc", "lost", "no reading"))
        log.phase(Phase(0, 9, "static"))
        log.flush()
        shutil.copy(path, folder / "a.h5")
        shutil.copy(journal_of(path), journal_of(folder / "a.h5"))
    return folder / "a.h5"


KINDS = {
    "finished": (finished, ()),
    "check sums made right": (finished, ("fixed",)),
    "old format": (old_format, ()),
    "unfinished": (unfinished, ()),
}


@pytest.mark.parametrize(
    "count", [12, pytest.param(60, marks=pytest.mark.slow), pytest.param(800, marks=pytest.mark.campaign)]
)
@pytest.mark.parametrize("kind", some(KINDS, 1))
def test_no_damaged_log_does_harm(small: Path, tmp_path: Path, kind: str, count: int) -> None:
    make, extra = KINDS[kind]
    folder = tmp_path / "fuzz"
    folder.mkdir()
    path = make(small, folder)
    words = [sys.executable, str(HERE / "fuzz.py"), str(path), str(count), str(count), *extra]
    done = subprocess.run(words, capture_output=True, text=True, env=ENVIRONMENT, timeout=600)
    at = (folder / "number").read_text()
    assert done.returncode == 0, f"number {at}: ended with {done.returncode}: {done.stderr[-2000:]}"
    match = re.match(r"\d+ logs: (\d+) let in, slowest ([\d.]+) s, (\d+) MiB", done.stdout)
    assert match
    assert 0 < int(match[1]) < count  # some are harmless, some are not
    # HDF5 allocates the size that the descriptor of a text declares, 32 bits at most, before it reads a shorter text.
    assert int(match[3]) < (400 if count < 50 else 2048)


@pytest.mark.slow
def test_a_heap_that_never_ends_is_refused(small: Path, tmp_path: Path) -> None:
    """HDF5 alone would go round in it for ever: an object of no size, one of nearly 2^64 bytes."""
    data = small.read_bytes()
    at = data.index(b"GCOL")
    paths = []
    for number, size in ((0, 0), (1, (1 << 64) - 16), (1, (1 << 64) - 8), (0, 8), (1, 1 << 40)):
        changed = bytearray(data)
        changed[at + 16 : at + 18] = number.to_bytes(2, "little")
        changed[at + 24 : at + 32] = size.to_bytes(8, "little")
        paths.append(tmp_path / f"spoilt{len(paths)}.h5")
        paths[-1].write_bytes(changed)
    code = "import sys\nfrom imuarray.cli import main\nprint([main(['info', path]) for path in sys.argv[1:]])"
    words = [sys.executable, "-c", code, *map(str, paths)]
    done = subprocess.run(words, capture_output=True, text=True, env=ENVIRONMENT, timeout=30)
    assert done.stdout.strip() == "[2, 2, 2, 2, 2]"
    assert len(done.stderr.splitlines()) == 5


def test_counts_that_look_like_a_heap_are_counts(tmp_path: Path) -> None:
    """A log that is being written, whose numbers are by chance the signature of a heap."""
    path = tmp_path / "run.h5"
    word = np.frombuffer(b"GCOL" * 3, "<i2")
    with LogWriter(path, [GYRO], source="simulated", epoch="2013-09-16T08:30:00Z", watermark=0) as log:
        log.keep()
        counts = np.tile(word, (5000, 1))[:, :3]
        log.append("Gyro", Block(np.arange(5000) * 10_000_000, counts, np.zeros(5000, np.uint16)))
        log.flush()
        with open_log(path) as live:
            assert live.state == "being written"
            np.testing.assert_array_equal(live["Gyro"].counts[:], counts)
    with open_log(path) as finished_log:
        np.testing.assert_array_equal(finished_log["Gyro"].counts[:], counts)

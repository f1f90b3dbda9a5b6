"""States of a log after a crash or a power cut at any call: it always opens, and never contains a wrong value.

A recording runs once with all calls noted that change the disk (`storage_writes.c`); the disk is made again from them.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from imuarray.errors import LogError
from tests.reliability import storage_rows as rows
from tests.reliability.storage_disk import Call, Disk, File, read_calls
from tests.selection import some

ROOT = Path(__file__).parents[2]
COMPILER = shutil.which("cc") or shutil.which("gcc")
FRAMES, BATCH, CHUNK = 1500, 10, 256


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory) -> list[Call]:
    """Every call of a recording of 1500 frames, from its creation to its finished file."""
    if COMPILER is None or not sys.platform.startswith("linux"):
        pytest.skip("the calls are noted by a small C library: needs cc, on Linux")
    folder = tmp_path_factory.mktemp("calls")
    (folder / "disk").mkdir()
    library = folder / "writes.so"
    source = Path(__file__).with_name("storage_writes.c")
    subprocess.run([COMPILER, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl", "-lpthread"], check=True)
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "LD_PRELOAD": str(library),
        "RECORD_WRITES": str(folder / "calls"),
        "RECORD_UNDER": str(folder / "disk"),
    }
    numbers = [str(number) for number in (FRAMES, BATCH, CHUNK)]
    program = [sys.executable, "-m", "tests.reliability.storage_rows", str(folder / "disk"), *numbers]
    subprocess.run(program, check=True, cwd=ROOT, env=environment, timeout=120)
    calls = read_calls(folder / "calls")
    disk = Disk()
    for call in calls:
        disk.apply(call)
    files = {path.name: path.read_bytes() for path in (folder / "disk").iterdir()}
    assert disk.now() == files  # no call was missed
    assert set(files) == {"run.h5", "acknowledged", "synced"}
    return calls


def look(folder: Path, image: dict[str, bytes], before: dict[str, bytes]) -> tuple[int, list[str]] | None:
    """The content of the log in an image; None if there is none. `before` is the earlier content of the folder."""
    for name in before.keys() - image.keys():
        (folder / name).unlink()
    for name, content in image.items():
        if before.get(name) != content:
            (folder / name).write_bytes(content)
    return rows.wrong(folder / "run.h5") if "run.h5" in image else None


def number(image: dict[str, bytes], name: str) -> int:
    content = image.get(name, b"")
    return int.from_bytes(content[-8:], "little")


@pytest.mark.parametrize("every", some([7, 1], 0, 1))
def test_a_log_opens_after_every_prefix_of_the_calls(calls: list[Call], tmp_path: Path, every: int) -> None:
    """A kill between any two calls, or after every seventh."""
    disk, before, looked = Disk(), {}, 0
    writes = sum(call.kind == "w" for call in calls)
    for place, call in enumerate(calls, 1):
        disk.apply(call)
        if place % every and place < len(calls):
            continue
        image = disk.now()
        content = look(tmp_path, image, before)
        before = image
        acknowledged = number(image, "acknowledged")
        if content is None:
            assert acknowledged == 0
            continue
        looked += 1
        assert content[1] == []
        assert content[0] >= acknowledged
    print(f"{len(calls)} calls, {writes} of them writes; {looked} logs after a prefix of them: all open, none wrong")
    assert content == (FRAMES, [])


@pytest.mark.parametrize("count", some([50, 400], 0, 1))
def test_a_log_opens_after_power_cuts(calls: list[Call], tmp_path: Path, count: int) -> None:
    draw = random.Random(8)
    cuts = sorted(draw.randrange(1, len(calls)) for _ in range(count))
    disk, at, before, looked = Disk(), 0, {}, 0
    for cut in cuts:
        for call in calls[at:cut]:
            disk.apply(call)
        at = cut
        synced = number(disk.now(), "synced")
        image = disk.after_power_cut(draw)
        try:
            content = look(tmp_path, image, before)
        except LogError as error:
            pytest.fail(f"after {cut} calls: {error}")
        before = image
        if content is None:
            assert synced == 0
            continue
        looked += 1
        assert content[1] == []
        assert content[0] >= synced, f"after {cut} calls {synced} frames were synced, {content[0]} are left"
    print(f"{count} power cuts, {looked} with a log: all open, no synced frame lost, nothing made up")


def test_the_disk_model_keeps_synced_data() -> None:
    file = File()
    file.write(0, b"a" * 5000)
    file.sync()
    file.write(4096, b"b" * 8000)
    draw = random.Random(1)
    images = [file.after_power_cut(draw) for _ in range(200)]
    assert all(image[:4096] == b"a" * 4096 for image in images)
    assert {len(image) for image in images} == {5000, 12_096}
    assert {image[4096:4097] for image in images} == {b"a", b"b"}
    assert any(image[8192:8193] == b"\0" for image in images)


def test_the_disk_model_keeps_the_first_changes_of_the_folder() -> None:
    disk = Disk()
    for call in (
        Call("c", 1, 0, b"/x/old"),
        Call("s", 9, 0, b""),
        Call("c", 2, 0, b"/x/new"),
        Call("r", 0, 0, b"/x/new\0/x/old"),
        Call("u", 0, 0, b"/x/old\0"),
    ):
        disk.apply(call)
    draw = random.Random(2)
    names = {tuple(sorted(disk.after_power_cut(draw))) for _ in range(100)}
    assert names == {("old",), ("new", "old"), ()}

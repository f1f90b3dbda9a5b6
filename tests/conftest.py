"""Fixtures and settings of all tests."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests run side by side: threads of BLAS would be in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gc
import shutil
import sys
from collections.abc import Generator, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

if sys.dont_write_bytecode:  # as in many containers: every start of the program would compile all its modules
    sys.dont_write_bytecode = False
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest
from hypothesis import settings

# Garbage is collected seldom: the syntax trees of test files and thousands of collected tests, none of which is freed
# before the end, would be examined each time. They are not frozen, since Hypothesis looks for referrers of its random
# numbers, which would hide them.
gc.set_threshold(100_000, 20, 50)

# The time of an example depends on the machine.  The examples are the same every time, so that what passed
# passes again; `pytest --hypothesis-profile explore` draws others.  The quick half draws few, .ci/run all ("full").
settings.register_profile("quick", deadline=None, derandomize=True, max_examples=3)
settings.register_profile("full", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile("quick")


MEMORY = Path("/dev/shm")
LEAST_FREE_BYTES = 4 << 30
"""Free memory disk from which temporary files are kept there; the quick half takes less than a tenth of it."""


def pytest_configure(config: pytest.Config) -> None:
    """Keep the temporary files of the quick half in memory, if TMPDIR and --basetemp name no other place. A log is
    synchronised to the disk several times, and a thousand of them are written: on a disk they take most of the time.
    """
    if "not slow" not in config.option.markexpr or "TMPDIR" in os.environ or not MEMORY.is_dir():
        return
    is_executable = not os.statvfs(MEMORY).f_flag & os.ST_NOEXEC  # tests compile programs and run them
    if is_executable and shutil.disk_usage(MEMORY).free >= LEAST_FREE_BYTES:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))


LONGEST = (
    "tests/system/test_own_python.py",
    "tests/system/test_kernel_usbip.py",
    "tests/studies/fusion_gain/test_must_show.py",
    "tests/system/test_service_unit.py",
    "tests/system/test_kernel_iio.py",
    "tests/studies/test_demo.py",
)
"""Files of half a minute or more, of the slow half or of the campaigns. Two workers begin with one each, so that the
first two guests do not run side by side.
"""


HERE = Path(__file__).parent

SHARED = {
    "tests/gap/effects/": "replicates of the small campaigns",
    "tests/firmware/": "compiled firmware",
    "tests/emulator/test_serial_firmware.py": "compiled firmware",
    "tests/acquire/test_serial_queue.py": "compiled firmware",
    "tests/acquire/test_stream_queue.py": "compiled firmware",
    "tests/report/": "Matplotlib",
    "tests/characterise/test_plots.py": "Matplotlib",
    "tests/characterise/test_scale.py": "Matplotlib",
    "tests/export/": "pandas",
    "tests/test_analysis.py": "pandas",
    "tests/log/test_format.py": "pandas",
    "tests/log/test_time_uncertainty.py": "pandas",
}
"""What files share that takes a second or more to make or to import: a worker gets all files that share it. Other files
are distributed file by file, as all are in the campaigns.
"""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Distribute the quick and the slow half by what is shared, in the place of `--dist loadscope`."""
    from xdist.scheduler import LoadScopeScheduling

    if config.getvalue("dist") != "loadscope" or "not campaign" not in config.option.markexpr:
        return None

    class SharedScheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return next((shared for start, shared in SHARED.items() if nodeid.startswith(start)), nodeid.split("::")[0])

    return SharedScheduling(config, log)


def _begins_at_the_end(config: pytest.Config) -> bool:
    """Return whether this is the second, fourth, ... of several workers; False if more than one place is tested."""
    worker = int(getattr(config, "workerinput", {"workerid": "gw0"})["workerid"][2:])
    return worker % 2 == 1 and len(config.args) == 1


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Let every other worker collect the folders from the last to the first. In a new checkout all files have to be
    compiled with their assertions; each is then compiled by the worker that comes to it first, not by both.
    """
    report = yield
    if collector.path == HERE and _begins_at_the_end(collector.config):
        report.result.reverse()
    return report


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the longest files first: a worker that began one of them last would be waited for by all others. The workers
    keep to this order with `--no-loadscope-reorder`.
    """
    if _begins_at_the_end(config):  # all workers must have the same order
        folders = [list(group) for _, group in groupby(items, lambda item: item.path.relative_to(HERE).parts[0])]
        items[:] = [item for group in reversed(folders) for item in group]
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.nodeid.split("::")[0], len(places)))


@pytest.fixture(scope="session", autouse=True)
def _same_priority() -> Iterator[None]:
    """The page steps back behind the logger, for good: a test that serves it would slow down all tests after it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "nice", lambda increment: 0, raising=False)
        yield


@pytest.fixture(scope="session")
def core_firmware(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The firmware's core in C, compiled once a session, with the interface of the emulated firmware."""
    from tests.firmware import build

    if build.COMPILER is None:
        pytest.skip(build.NO_COMPILER)
    build.CoreFirmware.core = build.library(tmp_path_factory.mktemp("firmware"))
    return build.CoreFirmware


@pytest.fixture
def firmware_kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The firmware of both benches: "emulated", or its "core" (`tests.firmware.kinds`). Its clock is the emulator's, so
    that every run is the same.
    """
    from tests.bus import serial_bench
    from tests.emulator import firmware_bench

    if request.param == "core":
        core = request.getfixturevalue("core_firmware")
        monkeypatch.setattr(serial_bench, "Firmware", core)
        monkeypatch.setattr(firmware_bench, "Firmware", core)

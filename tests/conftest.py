"""Fixtures and settings of all tests."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests run side by side: threads of BLAS would be in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gc
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

if sys.dont_write_bytecode:  # as in many containers: every start of the program would compile all its modules
    sys.dont_write_bytecode = False
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest
from hypothesis import settings

# The time of an example depends on the machine.  The examples are the same every time, so that what passed
# passes again; `pytest --hypothesis-profile explore` draws others.  The quick half draws few, .ci/run all ("full").
settings.register_profile("quick", deadline=None, derandomize=True, max_examples=5)
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
    "tests/studies/fusion_gain/test_must_show.py",
    "tests/system/test_service_unit.py",
    "tests/studies/test_demo.py",
)
"""Files of one or more minutes. Two workers begin with two each, so that the two guests do not run side by side."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first: a worker that began one of them last would be waited for by all others. The workers
    keep to this order with `--no-loadscope-reorder`.
    """
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.nodeid.split("::")[0], len(places)))


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Collect garbage seldom: thousands of collected tests, none of which is freed before the end, are examined each
    time. They are not frozen, since Hypothesis looks for referrers of its random numbers, which would hide them.
    """
    gc.set_threshold(100_000, 20, 50)


@pytest.fixture(scope="session", autouse=True)
def _same_priority() -> Iterator[None]:
    """The page steps back behind the logger, for good: a test that serves it would slow down all tests after it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "nice", lambda increment: 0, raising=False)
        yield

"""Reuse of memory for later arrays."""

import subprocess
import sys
from platform import libc_ver

import pytest

FAULTS_OF_ARRAYS = """
import resource, sys
import numpy as np
from imuarray.heap import keep_freed_memory

if "keep" in sys.argv:
    assert keep_freed_memory()
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
np.ones(1 << 17)
before = faults()
for _ in range(50):
    np.ones(1 << 17)  # a megabyte: 256 pages, unless they are huge
print(faults() - before)
"""


def faults(*arguments: str) -> int:
    """Page faults of fifty arrays of a megabyte, one after the other."""
    command = [sys.executable, "-c", FAULTS_OF_ARRAYS, *arguments]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.slow
@pytest.mark.skipif(libc_ver()[0] != "glibc", reason="a setting of glibc")
def test_later_arrays_reuse_the_pages_of_earlier_ones() -> None:
    assert faults("keep") < 600  # those of about two arrays

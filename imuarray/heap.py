"""Settings of the C library's heap for programs that create many large arrays in sequence.

By default glibc maps memory of the kernel for each array of more than 128 KB and returns it when the array is freed
(`mallopt`, M_MMAP_THRESHOLD and M_TRIM_THRESHOLD in the Linux manual pages). The kernel clears every page again for the
next array, which takes a tenth of the processor time of a report.
"""

from __future__ import annotations

import ctypes

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""Numbers of the two parameters in glibc's malloc.h."""

MAPPED_BYTES = 1 << 25
"""Size in bytes from which on arrays are mapped individually: the largest value that glibc accepts."""

TRIMMED_BYTES = 1 << 28
"""Number of freed bytes at the end of the heap from which on they are returned to the kernel."""


def keep_freed_memory() -> bool:
    """Keep freed memory of this process for its next arrays; return whether the C library supports this (glibc
    does).
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library, or Windows
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, MAPPED_BYTES) and mallopt(_M_TRIM_THRESHOLD, TRIMMED_BYTES))

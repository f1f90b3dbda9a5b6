"""A monitor steps back: what is recorded comes first."""

from __future__ import annotations

import contextlib
import os

NICENESS = 10
"""What is added to this process's: at equal demand the logger gets ten times as much of a processor."""


def step_back() -> None:
    """Lower the priority of this process."""
    if hasattr(os, "nice"):  # Windows has none
        with contextlib.suppress(OSError):
            os.nice(NICENESS)

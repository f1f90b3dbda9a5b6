"""A monitor process for a test."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]


@contextmanager
def serve_page(path: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The address of a page of the log at `path`, from a separate process."""
    program = [sys.executable, "-m", "imuarray", "monitor", str(path), "--port", "0", "--every", "0.2", *options]
    process = subprocess.Popen(program, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), process
    finally:
        process.kill()
        process.communicate()

"""The page of a log that this process writes: a process of its own, at low priority, which ends when this one does."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

from imuarray.errors import MissingExtraError
from imuarray.monitor.server import LINGER_S, PORT

_PATIENCE_S = LINGER_S + 5.0


@contextmanager
def page_beside(
    run: Path, *, host: str = "127.0.0.1", port: int = PORT, calibration: Path | None = None
) -> Iterator[None]:
    """Serve the page of the log at `run`, which need not be there yet; its address is told on standard error. A page
    that is looked at is served on for `LINGER_S` behind the end, so that it learns how the log ended. Whatever becomes
    of the page, the log goes on. MissingExtraError without Bokeh.
    """
    if find_spec("bokeh") is None:
        raise MissingExtraError("bokeh", "monitor")
    program = [sys.executable, "-m", "imuarray", "monitor", str(run), "--host", host, "--port", str(port)]
    program += ["--parent", str(os.getpid())]
    if calibration is not None:
        program += ["--calibration", str(calibration)]
    process = subprocess.Popen(program, stdin=subprocess.DEVNULL, stdout=sys.stderr.fileno(), start_new_session=True)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            with suppress(subprocess.TimeoutExpired):
                process.wait(1.0)

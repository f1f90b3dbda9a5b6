"""Serves the page of a log that this process writes, in a process of its own at low priority, which ends with this one.

Nothing of it is loaded here: what a page needs would take a logger longer to load than everything else.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

from imuarray.errors import MissingExtraError

_PATIENCE_S = 8.0
"""An open page is served for three more seconds after the end."""
_NICENESS = 10


def _print(text: str) -> None:
    with suppress(OSError, ValueError):
        print(f"imuarray: {text}", file=sys.stderr, flush=True)


@contextmanager
def serve_page(run: Path, arguments: Mapping[str, object], tell: Callable[[str], None] = _print) -> Iterator[None]:
    """Serve the page of the log at `run`, which need not exist yet, in a process of its own.

    `arguments` are options of `imuarray monitor` by name; None values are left out. `tell` receives the page's address
    and what goes wrong, from another thread. A page that is being viewed is served for a moment after the end, so that
    it shows how the log ended. Whatever happens to the page, the log goes on. MissingExtraError without Bokeh.
    """
    if find_spec("bokeh") is None:
        raise MissingExtraError("bokeh", "monitor")
    program = [sys.executable, "-m", "imuarray", "monitor", str(run), "--parent", str(os.getpid())]
    for option, value in arguments.items():
        program += [option, str(value)] if value is not None else []
    process = subprocess.Popen(
        program,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,  # Ctrl-C is the logger's
    )
    _lower_priority(process.pid)
    reporting = threading.Thread(target=_report_lines, args=(process.stdout, tell), name="page", daemon=True)
    reporting.start()
    try:
        yield
    finally:
        _end(process)
        reporting.join(1.0)
        if process.stdout is not None and not reporting.is_alive():
            process.stdout.close()


def _lower_priority(process: int) -> None:
    """Lower the priority at once: to load what a page needs is work too."""
    if hasattr(os, "setpriority"):  # Windows has none
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, process, os.getpriority(os.PRIO_PROCESS, 0) + _NICENESS)


def _report_lines(lines: Iterable[str] | None, tell: Callable[[str], None]) -> None:
    """Report what the page's process prints: the page's address, or why there is none."""
    for line in lines or ():
        text = line.strip()
        tell(f"watch it at {text}" if text.startswith("http://") else f"no page: {text.removeprefix('imuarray: ')}")


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        with suppress(subprocess.TimeoutExpired):
            process.wait(1.0)

"""Many cases over an executor: resumable, and a worker that dies costs its case alone.

A case goes out as itself and a folder's path, and comes back as one word. Its files are written by who works on it,
whole or not at all; nothing in them tells who that was, how many there were, or in which order.

A worker dies of its case (memory, a crash of compiled code) or for no fault of it. That a case begins is marked in the
folder before anything is done, and so no case begins a third time, whoever sends it: this process or a cluster's
scheduler.
"""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from imuarray.errors import ImuArrayError
from imuarray.validation.case import Case, Outcome, write_json
from imuarray.validation.executors import Here, Workers, executor_of

__all__ = ["LOST", "Job", "Ran", "State", "executor_of", "run_cases"]

Job = Callable[[Case, Path], None]
"""A module's function that works on a case and writes sealed/NAME.json and, last, outcomes/NAME.json into the folder.
What it writes depends on nothing but the case.
"""
State = Literal["done", "failed", "lost"]

LOST = "its worker died twice"
"""The `error` of the outcome of a case that is lost."""

_BEGINNINGS = 2
_LOOK_S = 5.0
"""So often a cluster is asked how large it is while nothing finishes."""


@dataclass(frozen=True)
class Ran:
    """How it went: of how many of the `cases` the outcome was there `before`; the names of those that now `failed` with
    an error, and of those that are `lost` with their workers.
    """

    cases: int
    before: int
    failed: tuple[str, ...]
    lost: tuple[str, ...]


def run_cases(
    cases: Sequence[Case],
    folder: Path,
    job: Job,
    executor: Workers | None = None,
    *,
    again: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> Ran:
    """Every case of which `folder` has no outcome (`again`: or an error), by `executor` (None: in this process, with as
    many BLAS threads as it has). `progress` is told how many of all are done.

    What goes wrong with a case is the `error` of its outcome (its `seconds` are 0), and stops no other. A case whose
    worker died is tried once more; by processes when all others are done, alone. If that one dies too, it is lost.
    ImuArrayError if workers can't begin or are taken away, ValueError for two cases of one name. What is done stays,
    then and at a KeyboardInterrupt, whose text says how to go on.
    """
    folder = folder.resolve()
    if len({case.name for case in cases}) < len(cases):
        raise ValueError("two cases have one name")
    _make(folder)
    todo = _undone(cases, folder, again)
    before = len(cases) - len(todo)
    states: dict[str, State] = {}
    try:
        with closing(_worked(todo, executor or Here(), job, folder)) as worked:
            progress(before)
            for case, state in worked:
                states[case.name] = state
                progress(before + len(states))
    except KeyboardInterrupt:
        done = f"{before + len(states)} of {len(cases)} cases are done"
        raise KeyboardInterrupt(f"{done}; the same again goes on with the rest") from None
    with suppress(OSError):
        _mark(folder).rmdir()
    failed, lost = (tuple(sorted(name for name in states if states[name] == state)) for state in ("failed", "lost"))
    return Ran(len(cases), before, failed, lost)


def _make(folder: Path) -> None:
    """The folders, without the marks of a run before."""
    for part in (folder / "outcomes", folder / "sealed", _mark(folder)):
        part.mkdir(parents=True, exist_ok=True)
    for mark in _mark(folder).iterdir():
        mark.unlink()


def _undone(cases: Sequence[Case], folder: Path, again: bool) -> list[Case]:
    """The cases without an outcome; an error is none, and taken away, if they are to be tried `again`."""
    todo = []
    for case in cases:
        state = _state(case, folder)
        if state is not None and state != "done" and again:
            _outcome(case, folder).unlink()
            state = None
        if state is None:
            todo.append(case)
    return todo


def _worked(
    cases: Sequence[Case], workers: Workers, job: Job, folder: Path
) -> Generator[tuple[Case, State], None, None]:
    """Each case when it is finished. No more are out than there are places for: few are lost when this process ends."""
    waiting, again, deaths = deque(cases), deque[Case](), Counter[str]()
    out: dict[Future[State], Case] = {}
    try:
        while waiting or again or out:
            if not waiting and not out:
                waiting.append(again.popleft())
            for _ in range(min(len(waiting), max(workers.places, 1) - len(out))):
                case = waiting.popleft()
                out[workers.submit(_attempt, job, case, folder)] = case
            for future in wait(out, _LOOK_S, FIRST_COMPLETED).done:
                case = out.pop(future)
                state = _answer(future, case, folder, workers, deaths)
                if state is None:
                    again.append(case)
                else:
                    yield case, state
    finally:
        for future in out:
            future.cancel()


def _answer(future: Future[State], case: Case, folder: Path, workers: Workers, deaths: Counter[str]) -> State | None:
    """What came of a case that was sent; None if it shall be sent again. `deaths` so far, by case."""
    try:
        return future.result()
    except CancelledError:
        raise ImuArrayError(f"{case.name}: taken away: is the scheduler gone? The same again goes on") from None
    except workers.deaths as error:
        deaths[case.name] += 1
        begun = _begun(case, folder)
        if begun >= _BEGINNINGS:
            return _finish(case, folder, LOST)
        if deaths[case.name] - begun >= _BEGINNINGS:
            raise ImuArrayError(f"{case.name}: workers die before they begin: {_line(error)}") from error
        return None
    except Exception as error:
        raise ImuArrayError(f"{case.name}: a worker can't begin: {_line(error)}") from error


def _attempt(job: Job, case: Case, folder: Path) -> State:
    """Where the work is done. A case may come that is done: its worker died before it said so."""
    state = _state(case, folder)
    if state is not None:
        return state
    if _begun(case, folder) >= _BEGINNINGS:
        return _finish(case, folder, LOST)
    with _mark(folder, case).open("ab") as beginnings:
        beginnings.write(b".")
    try:
        job(case, folder)
    except (Exception, SystemExit) as error:
        return _finish(case, folder, _line(error))
    return _finish(case, folder, "" if _outcome(case, folder).exists() else "it wrote no outcome")


def _finish(case: Case, folder: Path, error: str) -> State:
    """Writes an error down, and takes the mark away."""
    if error:
        write_json(_outcome(case, folder), asdict(Outcome(case.name, {}, {}, 0.0, error)))
    _mark(folder, case).unlink(missing_ok=True)
    return _of_error(error)


def _state(case: Case, folder: Path) -> State | None:
    """What the outcome says; None if there is none that can be read."""
    try:
        return _of_error(json.loads(_outcome(case, folder).read_text())["error"])
    except (FileNotFoundError, ValueError):
        return None


def _of_error(error: str) -> State:
    return "lost" if error == LOST else "failed" if error else "done"


def _outcome(case: Case, folder: Path) -> Path:
    return folder / "outcomes" / f"{case.name}.json"


def _mark(folder: Path, case: Case | None = None) -> Path:
    """The file that has a byte for each time the case began, or the folder of all of them."""
    return folder / "begun" / (case.name if case else "")


def _begun(case: Case, folder: Path) -> int:
    """How often a case that isn't finished began."""
    try:
        return _mark(folder, case).stat().st_size
    except FileNotFoundError:
        return 0


def _line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())

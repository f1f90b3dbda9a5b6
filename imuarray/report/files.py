"""One page from any mix of files: each kind is recognised by its content and contributes its own sections.

To add a kind: a function that recognises it, one that describes it, and a line in `KINDS`.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

from imuarray.calibrate import Calibration, load_calibration
from imuarray.errors import LogError
from imuarray.fuse import read_fused_head
from imuarray.fuse.fused_file import is_fused
from imuarray.log import Log, open_log
from imuarray.report.calibration_sheet import calibration_sections, calibration_summary, residual_section
from imuarray.report.fused_sheet import fused_sections, fused_summary, techniques_section
from imuarray.report.log_sheet import log_sections, log_summary
from imuarray.report.page import Section, Verdict, write_page
from imuarray.report.verdicts import calibration_verdict, joined, recording_verdict
from imuarray.spelling import guess_file

_MOST_BYTES = 1 << 26
"""Maximum size of a text file."""

_LONG_ROWS = 50_000
"""Rows of a sensor from which on another process is worth its start, of about a second."""

_NOISE = 0.2
"""Share of the time that the noise of a log takes beside the techniques."""

NO_FIGURES = "No figures on this page: they need matplotlib (pip install 'imuarray[report]')."


@dataclass(frozen=True)
class PageContext:
    """The links between the files of a page: the calibrations, merged in their order, and whether to draw."""

    calibration: Calibration
    drawn: bool
    progress: Callable[[float], None] = lambda share: None
    """Told what share of a file is done."""
    workers: int = 1
    """Number of processes that may work on a file; the page does not depend on it."""


Sayings = tuple[list[Verdict], list[str], list[Section]]
"""Verdicts, lines of the summary, and sections."""


def _log(path: Path, together: PageContext) -> Sayings:
    with ExitStack() as stack:
        log: Log = stack.enter_context(open_log(path))
        log.keep_rows()
        known = together.calibration
        fitting = [sensor for sensor in log.sensors.values() if sensor.name in known.sensors and sensor.is_triad]
        scales = {sensor.name: known.of(sensor).scale_lsb_per_unit.tolist() for sensor in fitting}
        noise, techniques = (
            (lambda share: together.progress(_NOISE * share)),
            (lambda share: together.progress(_NOISE + (1 - _NOISE) * share)),
        )
        sections = list(log_sections(log, scales, drawn=together.drawn, progress=noise, calibration=known))
        if fitting and (residuals := residual_section(log, known, drawn=together.drawn)):
            sections.append(residuals)
        verdicts = [recording_verdict(log)]
        with _beside(log, together.workers) as executor:
            gained = techniques_section(log, known, drawn=together.drawn, progress=techniques, executor=executor)
        if gained:
            sections.append(gained.section)
            verdicts += [gained.verdict] if gained.verdict else []
        return verdicts, list(log_summary(log)), sections


def _beside(log: Log, workers: int) -> AbstractContextManager[Executor | None]:
    """Return a process to work beside this one on a long log; None where it takes longer to start than it saves."""
    if workers == 1 or max((len(sensor) for sensor in log.sensors.values()), default=0) < _LONG_ROWS:
        return nullcontext()
    from imuarray.gap.model.workers import processes

    return processes(1)


def _calibration(path: Path, together: PageContext) -> Sayings:
    calibration = load_calibration(path)
    verdict = calibration_verdict(path, calibration)
    return [verdict], list(calibration_summary(path, calibration)), list(calibration_sections(path, calibration))


def _fused(path: Path, together: PageContext) -> Sayings:
    head = read_fused_head(path)
    verdict, section = fused_sections(path, head, drawn=together.drawn)
    return [verdict], list(fused_summary(path, head)), [section]


def _gap(path: Path, together: PageContext) -> Sayings:
    from imuarray.gap.findings.files import diagnosis_of
    from imuarray.report.gap_page import gap_sections, gap_summary, gap_verdict

    diagnosis = diagnosis_of(_json(path), str(path))
    return [gap_verdict(diagnosis)], list(gap_summary(diagnosis)), list(gap_sections(diagnosis, drawn=together.drawn))


def _validation(path: Path, together: PageContext) -> Sayings:
    from imuarray.report.validation_figures import plots_of
    from imuarray.report.validation_page import validation_sections, validation_verdict
    from imuarray.report.validation_words import summary_lines
    from imuarray.validation.bench import CHIPS, HIDDEN
    from imuarray.validation.scoring import score_folder

    figures = score_folder(path, hidden=HIDDEN, sensors=CHIPS)
    plots = plots_of(figures) if together.drawn else {}
    return [validation_verdict(figures)], list(summary_lines(figures)), list(validation_sections(figures, plots))


KINDS: Mapping[str, Callable[[Path, PageContext], Sayings]] = MappingProxyType(
    {
        "log": _log,
        "calibration": _calibration,
        "fused result": _fused,
        "gap diagnosis": _gap,
        "validation run": _validation,
    }
)
"""The kinds of files that a page can show, in the order in which they are recognised."""

_ALLOWED = (
    "allowed are logs and fused results (.h5), calibrations (.toml), gap.json or the folder of `gap diagnose -o`, and"
    " the folder of a validation run"
)


def write_report(
    paths: Sequence[Path],
    output: str | PathLike[str],
    *,
    title: str = "",
    force: bool = False,
    progress: Callable[[float], None] = lambda share: None,
    workers: int = 1,
) -> dict[str, str]:
    """Write the page of these files; the kind of each. `progress` is told what share is done; with more than one of
    `workers` a second process does a part of what a long log needs, which changes nothing on the page. LogError for a
    file of no kind, OutputExistsError.
    """
    kinds = {path: file_kind(path) for path in dict.fromkeys(member for path in paths for member in members(path))}
    known = Calibration()
    for path, kind in kinds.items():
        if kind == "calibration":
            known = known.merged(load_calibration(path))
    drawn = find_spec("matplotlib") is not None
    verdicts: list[Verdict] = []
    summary: list[str] = []
    sections: list[Section] = []
    for done, path in enumerate(sorted(kinds, key=lambda path: list(KINDS).index(kinds[path]))):
        own_progress = partial(_moved, progress, done, len(kinds))
        judged, lines, own = KINDS[kinds[path]](_file_of(path), PageContext(known, drawn, own_progress, workers))
        verdicts += judged
        summary += lines
        sections += own
        own_progress(1.0)
    if len(verdicts) > 1:
        summary[:0] = [f"{verdict.sign} {verdict.sentence}" for verdict in verdicts]
    if not drawn:
        summary.append(NO_FIGURES)
    heading = title or ", ".join(path.name for path in kinds)
    write_page(output, heading, summary, sections, verdict=joined(verdicts), force=force)
    return {str(path): kind for path, kind in kinds.items()}


def _moved(progress: Callable[[float], None], files: int, of: int, share: float) -> None:
    """Report progress: `files` of `of` are done, and a `share` of the next."""
    progress((files + share) / of)


def members(path: Path) -> list[Path]:
    """Return what a folder holds that a page can tell of: everything of one of `KINDS` in it; any other path itself.
    LogError for a folder that holds nothing of that.
    """
    if not path.is_dir() or any(recognised(path) for _, recognised in _RECOGNISED):
        return [path]
    contents = [member for member in sorted(path.iterdir()) if any(recognised(member) for _, recognised in _RECOGNISED)]
    if not contents:
        raise LogError(f"{path}: contains no file that a report can show; {_ALLOWED}")
    return contents


def file_kind(path: Path) -> str:
    """Return which of `KINDS` a file or folder is; LogError if it is none."""
    for kind, recognised in _RECOGNISED:
        if recognised(path):
            return kind
    missing = f"no such file or folder{guess_file(path)}" if not path.exists() else "not a file that a report can show"
    raise LogError(f"{path}: {missing}; {_ALLOWED}")


def _recognise() -> Iterator[tuple[str, Callable[[Path], bool]]]:
    yield "validation run", lambda path: (path / "plan.json").is_file()
    yield (
        "gap diagnosis",
        lambda path: isinstance(table := _json(path), Mapping) and {"verdict", "causes"} <= set(table),
    )
    yield "calibration", lambda path: path.suffix == ".toml" and "calibration" in _toml(path)
    yield "fused result", lambda path: path.is_file() and is_fused(path)
    yield "log", lambda path: path.is_file() and path.suffix in (".h5", ".hdf5")


_RECOGNISED = tuple(_recognise())


def _file_of(path: Path) -> Path:
    return path / "gap.json" if (path / "gap.json").is_file() else path


def _json(path: Path) -> Any:
    """Return the content of a JSON file; None if it is none. A folder stands for the `gap.json` in it."""
    place = _file_of(path)
    if place.suffix != ".json" or not place.is_file() or place.stat().st_size > _MOST_BYTES:
        return None
    try:
        return json.loads(place.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError):
        return None


def _toml(path: Path) -> Mapping[str, Any]:
    if not path.is_file() or path.stat().st_size > _MOST_BYTES:
        return {}
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError):
        return {}

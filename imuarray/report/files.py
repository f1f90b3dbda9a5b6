"""One page from any mix of files: the kind of each is recognised by its content and has sections of its own.

To add a kind, write a function that recognises it and one that returns its sections, and add a line to `KINDS`.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from imuarray.calibrate import Calibration, load_calibration
from imuarray.errors import LogError
from imuarray.figures import can_draw
from imuarray.fuse import read_fused_head
from imuarray.fuse.fused_file import is_fused
from imuarray.importers.plausibility import report_of
from imuarray.log import Log, open_log
from imuarray.report.calibration_page import calibration_sections, calibration_summary, residual_section
from imuarray.report.fused_page import fused_sections, fused_summary, techniques_section
from imuarray.report.log_page import doubt_sections, log_sections, log_summary
from imuarray.report.page import NO_FIGURES, Section, Verdict, write_page
from imuarray.report.verdicts import calibration_verdict, joined, recording_verdict
from imuarray.spelling import guess_file

_MOST_BYTES = 1 << 26
"""Largest size of a text file, in bytes."""

_LONG_ROWS = 120_000
"""Least number of rows of a sensor for which a second process saves more than the second that its start takes."""

_NOISE = 0.2
"""Share of the time for a log's sections that the noise takes; the techniques take the rest."""


@dataclass(frozen=True)
class PageContext:
    """The data that the sections of all files share: the calibrations, merged in their order, whether there are
    figures, the callback for the share of the file that is done, and the number of processes, on which the result
    does not depend.
    """

    calibration: Calibration
    with_figures: bool
    progress: Callable[[float], None] = lambda share: None
    workers: int = 1


class PagePart(NamedTuple):
    """The contribution of one file to a page: verdicts, lines of the summary, and sections."""

    verdicts: Sequence[Verdict]
    summary: Sequence[str]
    sections: Sequence[Section]


def _log(path: Path, context: PageContext) -> PagePart:
    with ExitStack() as stack:
        log: Log = stack.enter_context(open_log(path))
        log.keep_rows()
        calibration = context.calibration
        calibrated = [
            sensor for sensor in log.sensors.values() if sensor.name in calibration.sensors and sensor.is_triad
        ]
        scales = calibration.scales(calibrated)
        with_figures = context.with_figures
        noise, techniques = (
            (lambda share: context.progress(_NOISE * share)),
            (lambda share: context.progress(_NOISE + (1 - _NOISE) * share)),
        )
        sections = list(log_sections(log, scales, with_figures=with_figures, progress=noise, calibration=calibration))
        if calibrated and (residuals := residual_section(log, calibration, with_figures=with_figures)):
            sections.append(residuals)
        doubts = report_of(log).doubts if log.source == "imported" else ()
        sections[:0] = doubt_sections(log, doubts)
        verdicts = [recording_verdict(log, doubts)]
        with _second_process(log, context.workers) as executor:
            gains = techniques_section(
                log, calibration, with_figures=with_figures, progress=techniques, executor=executor
            )
        if gains:
            section, verdict = gains
            sections.append(section)
            verdicts += [verdict] if verdict else []
        return PagePart(verdicts, list(log_summary(log)), sections)


def _second_process(log: Log, workers: int) -> AbstractContextManager[Executor | None]:
    """Return an executor with one process for a long log; None where its start takes longer than it saves."""
    if workers == 1 or max((len(sensor) for sensor in log.sensors.values()), default=0) < _LONG_ROWS:
        return nullcontext()
    from imuarray.gap.model.workers import processes

    return processes(1)


def _calibration(path: Path, context: PageContext) -> PagePart:
    calibration = load_calibration(path)
    verdict = calibration_verdict(path, calibration)
    return PagePart([verdict], list(calibration_summary(path, calibration)), [*calibration_sections(path, calibration)])


def _fused(path: Path, context: PageContext) -> PagePart:
    head = read_fused_head(path)
    verdict, section = fused_sections(path, head, with_figures=context.with_figures)
    return PagePart([verdict], list(fused_summary(path, head)), [section])


def _gap(path: Path, context: PageContext) -> PagePart:
    from imuarray.gap.findings.diagnosis import diagnosis_of
    from imuarray.report.gap_page import gap_sections, gap_summary, gap_verdict

    diagnosis = diagnosis_of(_content(path), str(path))
    sections = gap_sections(diagnosis, with_figures=context.with_figures)
    return PagePart([gap_verdict(diagnosis)], list(gap_summary(diagnosis)), sections)


def _validation(path: Path, context: PageContext) -> PagePart:
    from imuarray.report.validation_figures import plots_of
    from imuarray.report.validation_page import summary_lines, validation_sections, validation_verdict
    from imuarray.validation.bench import CHIPS, HIDDEN
    from imuarray.validation.scoring import score_folder

    figures = score_folder(path, hidden=HIDDEN, sensors=CHIPS)
    plots = plots_of(figures) if context.with_figures else {}
    return PagePart([validation_verdict(figures)], list(summary_lines(figures)), validation_sections(figures, plots))


class FileKind(NamedTuple):
    """A kind of file: how it is recognised, and what it contributes to a page."""

    recognises: Callable[[Path], bool]
    part: Callable[[Path, PageContext], PagePart]


KINDS: Mapping[str, FileKind] = {
    "log": FileKind(lambda path: path.is_file() and path.suffix in (".h5", ".hdf5"), _log),
    "calibration": FileKind(lambda path: path.suffix == ".toml" and "calibration" in _content(path), _calibration),
    "fused result": FileKind(lambda path: path.is_file() and is_fused(path), _fused),
    "gap diagnosis": FileKind(lambda path: {"verdict", "causes"} <= {*_content(_file_of(path))}, _gap),
    "validation run": FileKind(lambda path: (path / "plan.json").is_file(), _validation),
}
"""The kinds of files that a page can show, in the order of a page. The last ones are tried first, because a fused
result has the suffix of a log.
"""

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
    """Write the page of these files, and return the kind of each. `progress` is called with the share that is done.
    With more than one of `workers`, a second process does a part of the work on a long log; the page is the same.
    LogError for a file of no kind, OutputExistsError.
    """
    kinds = {path: file_kind(path) for path in dict.fromkeys(file for path in paths for file in reportable_files(path))}
    calibration = Calibration()
    for path, kind in kinds.items():
        if kind == "calibration":
            calibration = calibration.merged(load_calibration(path))
    with_figures = can_draw()
    verdicts: list[Verdict] = []
    summary: list[str] = []
    sections: list[Section] = []
    for number, path in enumerate(sorted(kinds, key=lambda path: list(KINDS).index(kinds[path]))):
        context = PageContext(calibration, with_figures, partial(_report, progress, number, len(kinds)), workers)
        part = KINDS[kinds[path]].part(_file_of(path), context)
        verdicts += part.verdicts if len(kinds) == 1 else [verdict.of_file(path.name) for verdict in part.verdicts]
        summary += part.summary
        sections += part.sections
        context.progress(1.0)
    if len(verdicts) > 1:
        summary[:0] = [f"{verdict.sign} {verdict.sentence}" for verdict in verdicts]
    if not with_figures:
        summary.append(NO_FIGURES)
    heading = title or ", ".join(path.name for path in kinds)
    write_page(output, heading, summary, sections, verdict=joined(verdicts), force=force)
    return {str(path): kind for path, kind in kinds.items()}


def _report(progress: Callable[[float], None], files: int, of: int, share: float) -> None:
    """Report progress: `files` of `of` are done, and a `share` of the next."""
    progress((files + share) / of)


def reportable_files(path: Path) -> list[Path]:
    """Return the files of a folder that a page can show; any other path itself. LogError for a folder without any."""
    if not path.is_dir() or _kind_of(path):
        return [path]
    files = [member for member in sorted(path.iterdir()) if _kind_of(member)]
    if not files:
        raise LogError(f"{path}: contains no file that a report can show; {_ALLOWED}")
    return files


def file_kind(path: Path) -> str:
    """Return which of `KINDS` a file or folder is; LogError for any other."""
    if kind := _kind_of(path):
        return kind
    missing = f"no such file or folder{guess_file(path)}" if not path.exists() else "not a file that a report can show"
    raise LogError(f"{path}: {missing}; {_ALLOWED}")


def _kind_of(path: Path) -> str:
    return next((kind for kind, (recognises, _) in reversed(list(KINDS.items())) if recognises(path)), "")


def _file_of(path: Path) -> Path:
    """Return `gap.json` for the folder of a diagnosis, any other path itself."""
    return path / "gap.json" if (path / "gap.json").is_file() else path


def _content(path: Path) -> Mapping[str, Any]:
    """Return the table in a JSON or TOML file; {} if there is none."""
    parse = {".json": json.loads, ".toml": tomllib.loads}.get(path.suffix)
    if parse is None or not path.is_file() or path.stat().st_size > _MOST_BYTES:
        return {}
    try:
        table = parse(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError):
        return {}
    return table if isinstance(table, Mapping) else {}

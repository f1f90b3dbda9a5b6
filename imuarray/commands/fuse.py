"""`imuarray fuse`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import click
import numpy as np

from imuarray.commands.fuse_report import evaluate_techniques, notes_sentences, pair_lines, pairs_of, print_evaluation
from imuarray.commands.options import (
    bars,
    force_option,
    json_option,
    log_argument,
    only_option,
    option,
    output_option,
    parameter,
    print_json,
    refuse_existing,
    refuse_other_suffix,
    share_progress,
    takes,
)
from imuarray.fuse.technique_descriptions import NAME_WIDTH, TECHNIQUE_DESCRIPTIONS, TECHNIQUE_NAMES
from imuarray.printable import encodable, listed
from imuarray.units import INERTIAL, READABLE_SI

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.fuse import FaultEvent, FusedBlock, FusionNotes, PipelineFactory, QuietNoise
    from imuarray.log import Log

_MEAN = "mean"

Fuse = Callable[..., "Iterator[FusedBlock]"]
"""Function `imuarray.fuse.fuse` with some arguments set."""

_AVERAGE = 0.1
"""Share of the time that the average takes if it is computed before an estimator of the whole array."""

_WORDS = {
    "rms": "rms error against the truth",
    "noise": "scatter from frame to frame",
    "drift": "drift (max - min of sixteen means)",
}


_LIST = "\n".join(f"{name:{NAME_WIDTH}} {technique.about}" for name, technique in TECHNIQUE_DESCRIPTIONS.items())

_HELP = f"""Fuse all sensors of RUN.h5 into one specific force and one angular rate in the box frame.

\b
{_LIST}

--evaluate compares all techniques on a log that contains the truth: errors, ratios to the mean with their 95 %
intervals, consistency of the covariances, and errors of heading and velocity after coasting.

\b
imuarray fuse run.h5 --calibration cal.toml --technique optimal -o fused.h5
"""


@dataclass(frozen=True)
class FuseOptions:
    """The options of `imuarray fuse`."""

    run: Path = parameter(log_argument)
    calibration_file: Path | None = option(
        "--calibration", metavar="CAL.toml", help="the calibration to apply (default: data-sheet values)"
    )
    technique: str = option(default="mean", show_default=True, metavar="NAME", help=TECHNIQUE_NAMES)
    output: Path | None = output_option(metavar="FUSED.h5", help="the result to write (optional with --evaluate)")
    only: tuple[str, ...] = parameter(only_option("fuse only these sensors"))
    causal: bool = option(help="use only readings up to each frame, as `log --fuse` does")
    watch: bool | None = option(
        "--watch/--no-watch",
        default=None,
        help="detect, report and exclude failing sensors (default: only with optimal)",
    )
    evaluate: bool = option(help="compare every technique with the truth in the log, and with the mean")
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)


@click.command("fuse", help=_HELP)
@takes(FuseOptions)
def command(options: FuseOptions) -> None:
    """Fuse the sensors of a log."""
    from imuarray.calibrate import Calibration, load_calibration
    from imuarray.chips import SENSITIVITIES
    from imuarray.fuse.fusion import complete_responses, prepare_inputs, require_known_sensors, require_technique
    from imuarray.log import open_log

    if options.output is not None:
        refuse_other_suffix(options.output, "a fused result")
        refuse_existing(options.output, options.force, source=options.run)
    elif not options.evaluate:
        raise click.UsageError("Missing option '-o' / '--output'.")
    require_technique(options.technique)
    calibration = load_calibration(options.calibration_file) if options.calibration_file else Calibration()
    with open_log(options.run) as log:
        selected = [log[name].name for name in options.only]
        if options.calibration_file:
            require_known_sensors(log, calibration, selected, str(options.calibration_file))
        with bars() as advance:
            inputs = prepare_inputs(
                log,
                calibration,
                technique=None if options.evaluate else options.technique,
                only=selected,
                ranges=SENSITIVITIES,
                progress=advance,
            )
        if not options.causal:
            inputs = complete_responses(log, inputs)
        for remark in inputs.remarks:
            click.echo(f"imuarray: {remark}", err=True)
        calibration, names = inputs.calibration, list(inputs.only)
        report: dict[str, Any] = {
            "technique": options.technique,
            "remarks": list(inputs.remarks),
            "uncalibrated": list(inputs.uncalibrated),
            "start_up": list(inputs.start_up),
            "thermal": list(inputs.thermal),
            "temperature": list(inputs.temperature),
            "changes": _changes(log, calibration, options.technique, names),
            "pairs": pairs_of(log, calibration, names) if options.technique == "opposed" else [],
        }
        notes = None
        if options.output is not None:
            evaluation, notes = _write_fused(log, calibration, names, options, options.output)
            report |= evaluation
        if options.evaluate:
            report["evaluation"] = evaluate_techniques(log, calibration, names)
    if options.as_json:
        print_json(report)
    else:
        _print(report, notes)


def _write_fused(
    log: Log, calibration: Calibration, names: Sequence[str], options: FuseOptions, output: Path
) -> tuple[dict[str, Any], FusionNotes]:
    """Write the fused file; return its path, its figures and those of the average, and the notes of the technique."""
    from imuarray.chips import SENSITIVITIES
    from imuarray.fuse import Watch, fuse, write_fused

    technique = options.technique
    events: list[FaultEvent] = []
    notes: list[FusionNotes] = []
    sensors: dict[str, list[str]] = {
        quantity: [sensor.name for sensor in log.of(quantity, names)] for quantity in INERTIAL
    }
    average = partial(fuse, log, calibration, only=names, causal=options.causal)
    watch = Watch(options.watch, SENSITIVITIES, events.append)
    with share_progress(technique) as progress, _Quality(log) as quality:
        frames = write_fused(
            output,
            _measure(average, partial(average, watch=watch, notes=notes.append), options, quality, progress),
            epoch=log.epoch,
            technique=technique,
            log=encodable(str(log.path)),
            calibration=encodable(str(options.calibration_file or "")),
            sensors=sensors,
            events=events,
            force=options.force,
        )
        results = quality.results()
    report = {
        "fused": str(output),
        "frames": frames,
        "empty": [
            f"{quantity}: no frame has a value, because {listed(names)} had no valid reading near the time of a frame"
            for quantity, names in sensors.items()
            if names and quantity not in quality.valued.get(technique, ())
        ],
        "faults": [event.as_json() for event in sorted(events, key=lambda event: event.time_ns)],
        "learned": notes[0].as_json(),
        "error": results[technique] if log.motion_track else {},
        "results": results,
    }
    return report, notes[0]


def _measure(
    average: Fuse, fused: Fuse, options: FuseOptions, quality: _Quality, progress: Callable[[float], None]
) -> Iterator[FusedBlock]:
    """Yield the blocks of `fused`; `quality` gets each of them, and the blocks of the `average` before them. If the
    technique excludes no readings, both are computed from the same aligned frames.
    """
    from imuarray.chips import SENSITIVITIES
    from imuarray.fuse import TECHNIQUES, ComparisonPipeline, Watch

    technique = options.technique
    if technique not in TECHNIQUES and not options.causal and not options.watch:  # it smooths
        add: Callable[[FusedBlock], None] = lambda block: quality.add({_MEAN: block})  # noqa: E731
        for block in fused(technique, average=add, progress=progress):
            quality.add({technique: block})
            yield block
        return
    if technique == _MEAN or technique not in TECHNIQUES or options.watch:
        start = 0.0 if technique == _MEAN else _AVERAGE
        if technique != _MEAN:
            watch = Watch(options.watch, SENSITIVITIES)
            for block in average(_MEAN, watch=watch, progress=lambda share: progress(start * share)):
                quality.add({_MEAN: block})
        for block in fused(technique, progress=lambda share: progress(start + (1 - start) * share)):
            quality.add({technique: block})
            yield block
        return
    averages: list[FusedBlock] = []
    comparison: PipelineFactory = lambda axes, period_s: ComparisonPipeline(axes, technique, _MEAN, averages.append)  # noqa: E731
    for block in fused(comparison, progress=progress):
        quality.add({_MEAN: averages.pop(), technique: block})
        yield block


def _changes(log: Log, calibration: Calibration, technique: str, names: Sequence[str]) -> list[str]:
    """Return in what the technique differs from the average, for both quantities."""
    from imuarray.fuse import axes_of, changes

    sentences = []
    for quantity in INERTIAL:
        sensors = log.of(quantity, names)
        sentences += changes(technique, axes_of(sensors, calibration)) if sensors else []
    return sentences


class _Quality:
    """The errors of results with respect to the truth in the log, in SI; their noise at rest if it has none. A context
    manager.
    """

    def __init__(self, log: Log) -> None:
        from imuarray.fuse import ErrorEvaluation

        self._errors = ErrorEvaluation(log) if log.motion_track else None
        self._noise: dict[str, QuietNoise] = {}
        self.valued: dict[str, set[str]] = {}
        """The quantities of which a frame has a value, by technique."""

    def add(self, together: Mapping[str, FusedBlock]) -> None:
        from imuarray.fuse import QuietNoise

        for technique, block in together.items():
            valued = self.valued.setdefault(technique, set())
            valued.update(quantity for quantity, triads in block.triads.items() if np.isfinite(triads).any())
            if self._errors is None:
                self._noise.setdefault(technique, QuietNoise()).add(block)
        if self._errors is not None:
            self._errors.add(together)

    def results(self) -> dict[str, dict[str, Any]]:
        if self._errors is not None:
            errors = self._errors.errors()
            return {technique: {name: vars(error) for name, error in of.items()} for technique, of in errors.items()}
        return {
            technique: {quantity: {"noise": scatter} for quantity, scatter in noise.scatter().items()}
            for technique, noise in self._noise.items()
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._errors is not None:
            self._errors.__exit__(*error)


def _print(report: dict[str, Any], notes: FusionNotes | None) -> None:
    technique = report["technique"]
    if "fused" in report:
        click.echo(f"{report['fused']}: {report['frames']} frames by {technique}")
    if report["uncalibrated"]:
        click.echo(f"  not calibrated, nominal values used: {listed(report['uncalibrated'])}")
    for sentence in report["start_up"]:
        click.echo(f"  {sentence}")
    if report["thermal"]:
        click.echo(f"  bias follows the log's temperature: {listed(report['thermal'])}")
    for sentence in report["temperature"]:
        click.echo(f"  {sentence}")
    if "fused" in report:
        _print_results(report)
    for sentence in notes_sentences(notes) if notes else ():
        click.echo(f"  {sentence}")
    if "evaluation" in report:
        print_evaluation(report["evaluation"])


def _print_results(report: dict[str, Any]) -> None:
    """Print what the technique changed, and its errors next to those of the average."""
    technique = report["technique"]
    for sentence in report["empty"]:
        click.echo(f"  {sentence}")
    for fault in report["faults"]:
        click.echo(f"  {fault['sentence']}")
    description = TECHNIQUE_DESCRIPTIONS[technique]
    if description.effect:
        changes = ", ".join(report["changes"])
        click.echo(f"  {technique} {f'{description.effect} {changes}' if changes else description.no_effect}")
    for line in pair_lines(report["pairs"], follows_temperature=bool(report["thermal"])):
        click.echo(f"  {line}")
    for quantity in report["results"].get(_MEAN, ()):
        factor, unit = READABLE_SI[quantity]
        rows = {result: _error_rows(errors.get(quantity, {}), factor) for result, errors in report["results"].items()}
        if len(rows) > 1 and len(set(map(str, rows.values()))) == 1:
            rows = {"both": rows["mean"]}  # the technique gives the average, to every printed digit
        for name, words in _WORDS.items():
            for result, cells in rows.items():
                if name in cells:
                    click.echo(f"  {quantity:15} {words:38} {result:{NAME_WIDTH}} {cells[name]} {unit}")


def _error_rows(errors: dict[str, Any], factor: float) -> dict[str, str]:
    """Return the printed errors of one quantity along x, y, z by the name of the error."""
    return {
        name: "  ".join(f"{axis} {factor * value:8.3f}" for axis, value in zip("xyz", errors[name], strict=True))
        for name in _WORDS
        if name in errors
    }

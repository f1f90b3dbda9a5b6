"""`imuarray calibrate`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.commands.options import (
    PathName,
    bars,
    force_option,
    json_option,
    names_option,
    print_json,
    refuse_existing,
    report_doubts,
)
from imuarray.json_values import json_value
from imuarray.printable import printable

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration
    from imuarray.calibrate.pointing import Pointing
    from imuarray.log import Log

Report = dict[str, Any]

_output = click.option(
    "-o",
    "--output",
    required=True,
    type=PathName(),
    metavar="CAL.toml",
    help="the calibration file to write",
)
_update = click.option("--update", is_flag=True, help="keep the contents of CAL.toml and add to them")
_logs = click.argument("runs", metavar="RUN.h5...", nargs=-1, required=True, type=PathName())


def _add_log_arguments(function: Callable[..., None]) -> Callable[..., None]:
    """Add the arguments of a command that calibrates by logs: these, and those of `CalibrationOutput`."""
    for parameter in (json_option, force_option, _update, _output, _logs):
        function = parameter(function)
    return function


@click.group("calibrate", invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Determine sensor parameters from logs and write them to a TOML file.

    Begin with tumble; the others add to its file with --update.

    \b
    imuarray calibrate tumble poses.h5 -o cal.toml
    imuarray calibrate noise rest.h5 -o cal.toml --update
    """
    if context.invoked_subcommand is None:
        raise click.UsageError(f"choose what to calibrate: {', '.join(command.commands)}")


@command.command("tumble", short_help="bias and response, from six faces or from poses")
@_add_log_arguments
def tumble(runs: tuple[Path, ...], **options: Any) -> None:
    """Determine bias and response of accelerometers, and bias, g-sensitivity and response of gyroscopes.

    If phases name the six faces (z_up, x_down, ...) or the axis that was up (`imuarray log --up`), in one log or in one
    log per face, they are evaluated as in Appendix B of the paper. Otherwise at least nine static poses are detected in
    the logs. If the box was turned slowly to all sides without resting, accelerometers are calibrated by the magnitude
    of gravity along the path. The scale factors and axes of gyroscopes need at least six turns between poses of one
    log. Faces and poses that were disturbed are excluded and listed.

    \b
    imuarray calibrate tumble z_up.h5 x_up.h5 y_up.h5 z_down.h5 x_down.h5 y_down.h5 -o cal.toml
    """
    from imuarray.calibrate import calibrate_tumble
    from imuarray.commands.calibrate_tumble import print_report, report_of

    target = CalibrationOutput(**options)
    with target.opened(runs) as logs, bars() as advance:
        result = calibrate_tumble(*logs, progress=advance)
        report = report_of(logs[0], result)
    target.write(result.calibration, report, print_report)


@command.command("noise", short_help="noise, its spectrum and drift, from rest")
@_add_log_arguments
def noise(runs: tuple[Path, ...], **options: Any) -> None:
    """Determine noise, its spectrum and drift of every sensor axis from stretches in which the box was at rest.

    The spectrum is described by the correlation of neighbouring readings and by lines. Drift needs stretches of some
    minutes; with --update, the part that follows temperature by the slopes in CAL.toml is removed.

    \b
    imuarray calibrate noise rest.h5 -o cal.toml --update
    """
    from imuarray.calibrate import calibrate_noise
    from imuarray.commands.calibrate_noise import print_report, report_of

    target = CalibrationOutput(**options)
    with target.opened(runs) as logs, bars() as advance:
        calibration = calibrate_noise(*logs, known=target.existing(), progress=advance).stamped(logs)
    target.write(calibration, report_of(calibration), print_report)


@command.command("thermal", short_help="how biases change with temperature")
@_add_log_arguments
def thermal(runs: tuple[Path, ...], **options: Any) -> None:
    """Determine how biases change with temperature, from logs in which the box was at rest while heated or cooled.

    On the axis that carries gravity, one orientation cannot separate bias from scale factor; logs of opposite faces
    can. For opposing axes of one design, it prints how much less their mean drifts than each axis.

    \b
    imuarray calibrate thermal heat_up.h5 heat_down.h5 -o cal.toml --update
    """
    from imuarray.calibrate import calibrate_thermal
    from imuarray.commands.calibrate_thermal import print_report, report_of

    target = CalibrationOutput(**options)
    with target.opened(runs) as logs:
        result = calibrate_thermal(*logs)
    target.write(result.calibration, report_of(result), print_report)


@command.command("turn-on", short_help="how biases change from one switch-on to the next")
@_add_log_arguments
@click.option(
    "--seed", default=1, show_default=True, help="seed of the test that decides whether two states are due to chance"
)
def turn_on(runs: tuple[Path, ...], seed: int, **options: Any) -> None:
    """Determine how much biases change from one switch-on to the next.

    Give one log per run, all in one pose, or one log whose phases `run 1`, `run 2`, ... are the runs; at least three.

    \b
    imuarray calibrate turn-on boot_*.h5 -o cal.toml --update
    """
    from imuarray.calibrate import calibrate_turn_on
    from imuarray.chips import SENSITIVITIES
    from imuarray.commands.calibrate_turn_on import print_report, report_of

    target = CalibrationOutput(**options)
    with target.opened(runs) as logs:
        calibration, results = calibrate_turn_on(logs, SENSITIVITIES, seed)
        report = report_of(results)
    target.write(calibration, report, print_report, with_verdict=False)


@command.command("axes", short_help="axes of every sensor, from a few poses held by hand")
@click.argument("run", metavar="RUN.h5", type=PathName())
@click.option(
    "-o",
    "--output",
    required=True,
    type=PathName(),
    metavar="ARRAY.toml",
    help="the log's configuration, completed with the axes",
)
@names_option(
    "--poses",
    metavar="+Z,+X,+Y",
    help="the box axis that was up in each pose, in the order of the poses (default: as the log's phases say,"
    " else +Z,+X,+Y)",
)
@force_option
@json_option
def axes(run: Path, output: Path, poses: tuple[str, ...], force: bool, as_json: bool) -> None:
    """Determine the axes of every sensor from a few poses held by hand.

    Record one log while you hold the box still for three seconds with its Z axis up, then X, then Y. Accelerometers are
    oriented by gravity, gyroscopes by the turns from pose to pose, magnetometers by the field.

    \b
    imuarray log array.toml --seconds 30 -o poses.h5
    imuarray calibrate axes poses.h5 -o array.toml --force
    """
    from imuarray.atomic import write_text
    from imuarray.calibrate.pointing import find_pointing, upright_poses, with_axes
    from imuarray.log import open_log

    refuse_existing(output, force, source=run)
    with open_log(run) as log:
        if not log.config:
            raise click.UsageError(f"{run}: this log has no configuration to write the axes into")
        pointings = find_pointing(log, upright_poses(log, poses))
        text = with_axes(log.config, pointings, str(run))
        report = _axes_report(pointings, {name: sensor.axes for name, sensor in log.sensors.items()})
    write_text(output, text, force=force)
    _print_result({**report, "configuration": str(output)}, _print_axes, output, as_json)


@command.command("compare", short_help="what changed between calibrations of one array")
@click.argument("files", metavar="A.toml B.toml...", nargs=-1, required=True, type=PathName())
@json_option
def compare(files: tuple[Path, ...], as_json: bool) -> None:
    """Compare calibrations of one array: print what changed, and by how many standard errors.

    Also shows which part of the changes of biases is common to the units of a design, and how much of it opposing axes
    cancel. Biases are compared at one temperature if the calibrations state temperatures and slopes.

    \b
    imuarray calibrate compare march.toml june.toml
    """
    from imuarray.calibrate import load_calibration
    from imuarray.calibrate.comparison import compare_calibrations
    from imuarray.commands.calibrate_compare import print_report, report_of

    if len(set(files)) < len(files):
        raise click.UsageError("a calibration is given more than once")
    report = json_value(report_of(compare_calibrations({str(file): load_calibration(file) for file in files})))
    if as_json:
        print_json(report)
    else:
        print_report(report)


@dataclass(frozen=True)
class CalibrationOutput:
    """The calibration file to write: `update` adds to it, `force` overwrites it; `as_json` prints JSON."""

    output: Path
    update: bool
    force: bool
    as_json: bool

    @contextmanager
    def opened(self, runs: Sequence[Path]) -> Iterator[list[Log]]:
        """Open the logs, after a check that the file can be written."""
        from imuarray.log import open_log, require_distinct

        for run in runs:
            refuse_existing(self.output, self.force or self.update, source=run)
        if self.output.suffix != ".toml":
            raise click.UsageError(
                f"{self.output}: a calibration is a TOML file; name it {self.output.with_suffix('.toml').name}"
            )
        with ExitStack() as stack:
            logs = [stack.enter_context(open_log(run)) for run in runs]
            for log in logs:
                report_doubts(log)
            require_distinct(logs)
            yield logs

    def existing(self) -> Calibration | None:
        """Return the calibration that is added to; None if there is none."""
        from imuarray.calibrate import load_calibration

        return load_calibration(self.output) if self.update and self.output.exists() else None

    def write(
        self, calibration: Calibration, report: Report, show: Callable[[Report], None], *, with_verdict: bool = True
    ) -> None:
        """Write the file and print the report, and the verdict on the whole file."""
        older = self.existing()
        if older is None:
            calibration.save(self.output, force=self.force)
        else:
            older.merged(calibration).save(self.output, force=True)
        _print_result({**report, "calibration": str(self.output)}, show, self.output, self.as_json)
        if with_verdict and not self.as_json:
            from imuarray.calibrate import load_calibration
            from imuarray.report.verdicts import calibration_verdict

            click.echo(printable(calibration_verdict(self.output, load_calibration(self.output)).sentence))


def _print_result(report: Report, show: Callable[[Report], None], output: Path, as_json: bool) -> None:

    known = json_value(report)
    if as_json:
        print_json(known)
    else:
        show(known)
        click.echo(f"wrote {output}")


def _axes_report(pointings: Sequence[Pointing], before: dict[str, str]) -> dict[str, Any]:
    """Return every sensor's axes before and now, JSON-ready; an empty text where they could not be determined.

    `left` is the former name of `residual`, for programs that read it.
    """
    return {
        "sensors": [
            {**asdict(pointing), "left": pointing.residual, "before": before[pointing.sensor]} for pointing in pointings
        ]
    }


def _print_axes(report: dict[str, Any]) -> None:
    click.echo(f"{'sensor':12} {'axes':8} {'residual':>8} {'next best':>9}")
    for row in report["sensors"]:
        note = row["reason"] and f"  not determined: {row['reason']}; {row['before']} kept"
        fit = f"{row['residual'] or 0:8.2f} {row['next_best'] or 0:9.2f}" if row["axes"] else ""
        click.echo(f"{row['sensor']:12} {row['axes'] or '?':8} {fit}{note}".rstrip())

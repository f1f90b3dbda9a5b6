"""`imuarray log`, the signals that end a recording cleanly, and its summary."""

from __future__ import annotations

import re
import signal
from collections.abc import Sequence
from contextlib import ExitStack, closing, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.axes import UP_AXES, face_up
from imuarray.commands.options import (
    Duration,
    bus_option,
    config_argument,
    force_option,
    json_option,
    only_option,
    option,
    output_option,
    parameter,
    print_json,
    rate_option,
    refuse_existing,
    refuse_other_suffix,
    takes,
)
from imuarray.errors import ConfigError
from imuarray.fuse.technique_descriptions import TECHNIQUE_NAMES
from imuarray.printable import counted
from imuarray.shipped import find_config
from imuarray.spelling import guess

if TYPE_CHECKING:
    from imuarray.acquire import RecordingCounts
    from imuarray.array import ArrayConfig
    from imuarray.bus.protocol import OpenBus
    from imuarray.bus.transcript import RecordingBus
    from imuarray.calibrate.start_up import StartStateDetector
    from imuarray.fuse.live_fusion import LiveFusion

_HANG_UP: int | None = getattr(signal, "SIGHUP", None)  # Windows has none


class Interruptible:
    """Context manager in which SIGINT, SIGTERM and SIGHUP (the terminal is closed) request the end of a log instead of
    ending the program. `asked`: a signal was received; `hung_up`: it was SIGHUP. A SIGHUP that is ignored (nohup) stays
    ignored.
    """

    def __init__(self) -> None:
        self.asked = self.hung_up = False
        self._handlers: dict[int, Any] = {}

    def _ask(self, number: int, frame: Any) -> None:
        self.asked = True
        self.hung_up |= number == _HANG_UP

    def __enter__(self) -> Interruptible:
        for number in (signal.SIGINT, signal.SIGTERM, _HANG_UP):
            if number is None or (number == _HANG_UP and signal.getsignal(number) == signal.SIG_IGN):
                continue
            self._handlers[number] = signal.signal(number, self._ask)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)


_CARRIES = ("bus", "channel", "link", "adapter", "refused")
"""Kinds of events that belong to no sensor and can lose readings."""
_NAMED = 3


def print_summary(
    summary: RecordingCounts, output: Path, start_up: list[str], fusion: LiveFusion | None, as_json: bool
) -> None:
    """Print what was recorded, as text or JSON; `start_up` holds the sentences on how sensors started."""
    lost_readings = {name: count for name, count in summary.lost.items() if count}
    if as_json:
        logs = [str(path) for path in summary.logs]
        report = {"log": str(output), **vars(summary), "logs": logs, "lost": lost_readings, "start_up": start_up}
        print_json({**report, "fusion": fusion.report()} if fusion else report)
        return
    rate = summary.frames / summary.seconds if summary.seconds else 0.0
    files_text = output if len(summary.logs) == 1 else f"{summary.logs[0]} ... {summary.logs[-1].name}"
    is_cut = bool(summary.silent) and set(summary.silent) >= set(summary.lost)
    incomplete = ", incomplete: no sensor answered at its end" if is_cut else ""
    frames_text = f"{summary.frames} frames in {summary.seconds:.1f} s ({rate:.1f} Hz)"
    click.echo(f"{files_text}: {frames_text}, {summary.late} late{incomplete}")
    if fusion:
        files = fusion.paths or [fusion.path]
        named = files[0] if len(files) == 1 else f"{files[0]} ... {files[-1].name}"
        click.echo(f"  {named}: {counted(fusion.frames, 'frame')} fused while recording")
    if summary.missed:
        click.echo(f"  {counted(summary.missed, 'frame')} missed: {_why_missed(summary)}")
    if summary.uncertain:
        click.echo(f"  {counted(summary.uncertain, 'reading')} with a time that is uncertain by a millisecond or more")
    if summary.refused:
        click.echo(
            f"  {counted(summary.refused, 'frame')} of the link rejected: old, repeated, out of order or unsolicited"
        )
    for name, count in lost_readings.items():
        first, *further = _logs_with_events(summary.logs, name)
        others_text = f", {', '.join(path.name for path in further[:_NAMED])}" if further else ""
        others_text += f" and {len(further) - _NAMED} more" if len(further) > _NAMED else ""
        click.echo(f"  {name}: {counted(count, 'reading')} lost (see events: imuarray info {first}{others_text})")


def _why_missed(summary: RecordingCounts) -> str:
    """Return the cause of the missed frames: the bus, this machine, or both."""
    from imuarray.log.missed_frames import BUS_WAS_LATE

    busy = "the array can't be read this fast, or this machine was busy"
    if not summary.missed_by_bus:
        return busy
    if summary.missed_by_bus == summary.missed:
        return f"{BUS_WAS_LATE}; check its wires and pull-up resistors"
    return f"{summary.missed_by_bus} because {BUS_WAS_LATE}, {summary.missed - summary.missed_by_bus} because {busy}"


def _logs_with_events(logs: Sequence[Path], sensor: str) -> list[Path]:
    """Return the logs with events of a sensor or of its bus or link; all logs if there are none."""
    from imuarray.log import open_log

    if len(logs) == 1:
        return list(logs)
    matching = []
    for path in logs:
        with open_log(path) as log:
            if any(event.sensor == sensor or (not event.sensor and event.kind in _CARRIES) for event in log.events):
                matching.append(path)
    return matching or list(logs)


@dataclass(frozen=True)
class LogOptions:
    """The options of `imuarray log`."""

    config: Path = parameter(config_argument)
    bus_url: str | None = parameter(bus_option)
    output: Path = output_option(required=True, metavar="RUN.h5", help="the log to write")
    seconds: float | None = option(
        type=Duration(), metavar="60s", help="duration: 90, 90s, 10min, 8h (default: until interrupted)"
    )
    rate_hz: float = parameter(rate_option)
    phase: str = option(
        default="",
        metavar="NAME",
        help="name of the phase that is recorded: static, z_up, room, heat, motion, run 3, ...",
    )
    up: str | None = option(
        type=click.Choice(UP_AXES),
        default=None,
        help="the box axis that points up (default: from the name of the phase, such as z_up)",
    )
    transcript: Path | None = option(metavar="T.jsonl", help="also write a transcript of every transaction")
    only: tuple[str, ...] = parameter(only_option("read only these sensors"))
    calibration: Path | None = option(
        metavar="CAL.toml",
        help=(
            "from `calibrate turn-on`: detect from the first seconds at rest which sensor started in a wrong state,"
            " flag its readings and configure it again; with --fuse: the calibration for the fusion"
        ),
    )
    fuse: bool = option(help="also fuse the readings while recording, with a delay of one or two seconds")
    technique: str | None = option(metavar="NAME", help=f"for --fuse: {TECHNIQUE_NAMES}  [default: mean]")
    fused_file: Path | None = option(
        "--fused",
        metavar="FUSED.h5",
        help="output of --fuse  [default: RUN_fused.h5]; with --rotate one file for each part: RUN_001_fused.h5, ...",
    )
    watch: bool | None = option(
        "--watch/--no-watch",
        default=None,
        help="for --fuse: detect, report and exclude failing sensors (default: only with optimal)",
    )
    rotate_s: float | None = option(
        "--rotate",
        type=Duration(),
        metavar="1h",
        help="split the log into parts of this length: RUN_001.h5, RUN_002.h5, ... (30s, 10min, 1h, 1d)",
    )
    monitor: bool = option(help="also serve a live page of the recording, as `imuarray monitor` does")
    monitor_port: int | None = option(
        type=click.IntRange(0, 65535), help="for --monitor: the port, 0 for any free one  [default: 8765]"
    )
    monitor_host: str | None = option(
        metavar="ADDRESS",
        help=(
            "for --monitor: the address to serve on; if other machines can reach it, the page requires the printed"
            " token  [default: 127.0.0.1]"
        ),
    )
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)

    @property
    def first(self) -> Path:
        """The first log that is written."""
        from imuarray.log.rotate import part_of

        return self.output if self.rotate_s is None else part_of(self.output, 1)

    def check(self) -> None:
        """Raise click.UsageError for options that contradict each other and for an output that cannot be written."""
        _check_phase(self.phase)
        if self.up and not self.phase:
            raise click.UsageError("--up needs --phase: it is the direction of the box in that phase")
        if self.up and face_up(self.phase) not in ("", self.up):
            raise click.UsageError(f"--up {self.up}: the phase {self.phase} has {face_up(self.phase)} up")
        refuse_existing(self.first, self.force)
        refuse_other_suffix(self.output, "a log")
        if self.transcript is not None and self.transcript.absolute() == self.first.absolute():
            raise click.UsageError(f"--transcript {self.transcript}: is the name of the log; choose another")
        fusion = {"--technique": self.technique, "--fused": self.fused_file, "--watch": self.watch}
        _refuse_without("--fuse", self.fuse, fusion)
        page = {"--monitor-host": self.monitor_host, "--monitor-port": self.monitor_port}
        _refuse_without("--monitor", self.monitor, page)


@click.command("log")
@takes(LogOptions)
def command(options: LogOptions) -> int:
    """Record the array of CONFIG into a log of raw counts. Interrupt (Ctrl-C) to end it cleanly.

    Events are printed on standard error. Over ssh, start it as a service, in tmux or with nohup: closing the terminal
    ends the log.

    The bus is --bus or that of the configuration; without either, nothing is recorded. If the adapter is unplugged,
    recording goes on when it is back. Exits 1 if no sensor answered when the recording ended.

    \b
    imuarray log array.toml -o run.h5 --phase z_up --seconds 60
    imuarray log array.toml -o night.h5 --rotate 1h --fuse --calibration cal.toml
    """
    from imuarray.acquire import RecordingOptions, record
    from imuarray.commands.log_display import LogScreen, serve_page

    options.check()
    array, url = _array_and_bus(options)
    judge = _judge(options, array)
    fusion = _fusion(options, judge) if options.fuse else None
    listeners: dict[str, Any] = {}
    with ExitStack() as stack:
        bus, recorder = _connect(stack, options, url, array)
        stop = stack.enter_context(Interruptible())
        status = fusion.status if fusion else str
        screen = stack.enter_context(closing(LogScreen(str(options.output), options.rate_hz, options.seconds, status)))
        if options.monitor:  # the page follows parts from the first one on
            stack.enter_context(serve_page(options.first, _page_arguments(options), screen.remark))
        if fusion:
            fusion.on_remark = screen.remark
            stack.enter_context(closing(fusion))
            listeners = {"on_headers": fusion.begin, "on_first_frame": fusion.set_start, "on_block": fusion.observe}
        recording = RecordingOptions(
            rate_hz=options.rate_hz,
            seconds=options.seconds,
            phases=() if options.phase else getattr(bus, "phases", ()),
            phase=options.phase,
            up=options.up or face_up(options.phase),
            rotate_s=options.rotate_s,
            stopped=lambda: stop.asked,
            on_event=screen.event,
            on_counts=screen.counted,
            judge=judge,
            force=options.force,
            **listeners,
        )
        summary = record(array, bus, options.output, recording)
    with suppress(OSError) if stop.hung_up else nullcontext():  # the terminal is gone
        if bus.source == "replay" and getattr(bus, "stopped", False):
            click.echo("imuarray: the transcript ends here because the recorded program was stopped", err=True)
        if recorder is not None and recorder.failed:
            click.echo(f"imuarray: {recorder.failed}", err=True)
        print_summary(summary, options.output, judge.sentences if judge else [], fusion, options.as_json)
        if len(summary.silent) == len(array.sensors):
            doctor = f"imuarray detect {options.config} --doctor"
            click.echo(f"imuarray: no sensor answered when the recording ended; try `{doctor}`", err=True)
    return 1 if len(summary.silent) == len(array.sensors) else 0


_FACES = tuple(f"{axis}_{way}" for axis in "xyz" for way in ("up", "down"))
_PHASES = ("static", "room", "heat", "cool", "motion", "run 1", *_FACES, *(f"{face}_check" for face in _FACES))
"""Names of phases that other commands recognise; any other name is allowed."""


def _check_phase(phase: str) -> None:
    """Raise click.UsageError if the name of a phase differs from one that other commands recognise in letter case and
    punctuation only; print a remark if it differs slightly.
    """
    if not phase or phase in _PHASES or re.fullmatch(r"run \d+", phase):
        return
    plain = {re.sub(r"[\W_]", "", name): name for name in _PHASES}
    if recognised := plain.get(re.sub(r"[\W_]", "", phase.casefold())):
        raise click.UsageError(
            f"phase {phase!r}: other commands recognise {recognised!r} only; write --phase {recognised}"
        )
    if near := guess(phase, _PHASES):
        click.echo(f"imuarray: phase {phase!r} is not a name that other commands recognise{near}", err=True)


def _refuse_without(option: str, is_given: bool, dependent: dict[str, Any]) -> None:
    """Raise click.UsageError if one of the `dependent` options is given without `option`."""
    for name, value in dependent.items():
        if value is not None and not is_given:
            raise click.UsageError(f"{name} needs {option}")


def _array_and_bus(options: LogOptions) -> tuple[ArrayConfig, str]:
    """Return the sensors to read and the URL of their bus; ConfigError if there is none."""
    from imuarray.array import load_array

    array = load_array(find_config(options.config))
    url = options.bus_url or array.bus
    if url is None:
        raise ConfigError(
            f"{options.config}: no bus: give --bus i2c:/dev/i2c-1 (or --bus emulated: to rehearse),"
            " or give [array] a bus"
        )
    return array.only(options.only) if options.only else array, url


def _judge(options: LogOptions, array: ArrayConfig) -> StartStateDetector | None:
    """Return the detector of wrong start-up states; None without a calibration, or if --calibration is for --fuse and
    its file states none.
    """
    if options.calibration is None:
        return None
    from imuarray.calibrate import load_calibration
    from imuarray.calibrate.start_up import StartStateDetector

    judge = StartStateDetector(load_calibration(options.calibration), array.sensitivities, _remark)
    return judge if judge.knows_states or not options.fuse else None


def _remark(text: str) -> None:
    click.echo(f"imuarray: {text}", err=True)


def _fusion(options: LogOptions, judge: StartStateDetector | None) -> LiveFusion:
    from imuarray.calibrate import Calibration, load_calibration
    from imuarray.chips import SENSITIVITIES
    from imuarray.fuse.live_fusion import FusionOutput, LiveFusion, LiveFusionOptions, default_path

    calibration = load_calibration(options.calibration) if options.calibration else Calibration()
    output = FusionOutput(
        options.fused_file or default_path(options.output),
        options.output,
        technique=options.technique or "mean",
        calibration_file=str(options.calibration or ""),
        rotate_s=options.rotate_s,
        force=options.force,
    )
    fusion_options = LiveFusionOptions(
        options.rate_hz,
        watch=options.watch,
        ranges=SENSITIVITIES,
        start_calibration=judge.in_states if judge else None,
    )
    fusion = LiveFusion(output, calibration, fusion_options, _remark)
    refuse_existing(fusion.first_path, options.force, source=options.output)
    return fusion


def _page_arguments(options: LogOptions) -> dict[str, Any]:
    """Return the options of `imuarray monitor` for the page of this log."""
    return {
        "--host": options.monitor_host,
        "--port": options.monitor_port,
        "--calibration": options.calibration,
        "--fused": options.fused_file,
    }


def _connect(
    stack: ExitStack, options: LogOptions, url: str, array: ArrayConfig
) -> tuple[OpenBus, RecordingBus | None]:
    """Return the bus, which is open as long as `stack`, and the recorder of its transcript, if there is one."""
    from imuarray.bus import open_bus
    from imuarray.bus.transcript import RecordingBus

    bus: OpenBus = stack.enter_context(open_bus(url, array))
    recorder = None
    if options.transcript:
        bus = recorder = stack.enter_context(RecordingBus(bus, options.transcript, force=options.force))
        if recorder.remark:
            click.echo(f"imuarray: {recorder.remark}", err=True)
    if bus.source == "emulated":
        click.echo("imuarray: recording the emulated array, no hardware", err=True)
    return bus, recorder

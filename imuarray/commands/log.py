"""`imuarray log`."""

from __future__ import annotations

from contextlib import ExitStack, closing, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.axes import UP_AXES, face_up
from imuarray.commands.options import (
    Duration,
    bus_option,
    config_argument,
    find_config,
    force_option,
    json_option,
    refuse_existing,
)
from imuarray.errors import ConfigError

if TYPE_CHECKING:
    from imuarray.array import ArrayConfig
    from imuarray.bus.protocol import OpenBus
    from imuarray.bus.transcript import RecordingBus
    from imuarray.commands.log_fusion import LiveFusion
    from imuarray.commands.start_up import StartUpJudge


@click.command("log")
@config_argument
@bus_option
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), metavar="RUN.h5", help="the log to write"
)
@click.option("--seconds", type=click.FloatRange(min=0, min_open=True), help="how long (default: until interrupted)")
@click.option(
    "--rate-hz",
    type=click.FloatRange(0.01, 3200),
    default=50.0,
    show_default=True,
    help="frames per second; a frame reads every sensor once",
)
@click.option(
    "--phase", default="", metavar="NAME", help="what this log is: static, z_up, room, heat, motion, run 3, ..."
)
@click.option(
    "--up", type=click.Choice(UP_AXES), default=None, help="the box axis that points up (told by z_up and the like)"
)
@click.option(
    "--transcript", type=click.Path(path_type=Path), metavar="T.jsonl", help="also write every transaction here"
)
@click.option("--only", metavar="SENSOR,...", help="read only these sensors")
@click.option(
    "--calibration",
    type=click.Path(path_type=Path),
    metavar="CAL.toml",
    help="of `calibrate turn-on`: tell from the first seconds at rest which sensor came up wrong, flag its readings and"
    " set it up again; with --fuse: what the fusion knows of the sensors",
)
@click.option("--fuse", is_flag=True, help="also fuse the readings as they come (a second or two behind)")
@click.option(
    "--technique", metavar="NAME", help="of --fuse: mean, opposed, planes, ranges or optimal  [default: mean]"
)
@click.option(
    "--fused",
    "fused_file",
    type=click.Path(path_type=Path),
    metavar="FUSED.h5",
    help="where --fuse writes  [default: RUN_fused.h5]; with --rotate a file for each part: RUN_001_fused.h5, ...",
)
@click.option(
    "--watch/--no-watch",
    default=None,
    help="of --fuse: find sensors that fail, say so and go on without them (default: with optimal)",
)
@click.option(
    "--rotate",
    "rotate_s",
    type=Duration(),
    metavar="1h",
    help="begin a new log every so often: RUN_001.h5, RUN_002.h5, ... (30s, 10min, 1h, 1d)",
)
@click.option("--monitor", is_flag=True, help="also serve a page that shows it all, as `imuarray monitor` does")
@click.option("--monitor-port", type=click.IntRange(0, 65535), help="of --monitor: 0 is any free one  [default: 8765]")
@click.option(
    "--monitor-host",
    metavar="ADDRESS",
    help="of --monitor: where to serve; on another than this machine's own the page wants the token that is printed"
    "  [default: 127.0.0.1]",
)
@force_option
@json_option
def command(
    config: Path,
    bus_url: str | None,
    output: Path,
    seconds: float | None,
    rate_hz: float,
    phase: str,
    up: str | None,
    transcript: Path | None,
    only: str | None,
    calibration: Path | None,
    fuse: bool,
    technique: str | None,
    fused_file: Path | None,
    watch: bool | None,
    rotate_s: float | None,
    monitor: bool,
    monitor_port: int | None,
    monitor_host: str | None,
    force: bool,
    as_json: bool,
) -> int:
    """Record the array of CONFIG into a log of raw counts. Interrupt (Ctrl-C) to end it cleanly.

    What happens to a sensor meanwhile is told on standard error. Over ssh start it by the service, tmux or nohup: a
    terminal that goes away ends the log.

    The bus is --bus or the configuration's; with neither, nothing is recorded. An adapter that is unplugged is waited
    for. Exits 1 if no sensor answered any more when the recording ended.

    \b
    imuarray log array.toml -o run.h5 --phase z_up --seconds 60
    imuarray log array.toml -o night.h5 --rotate 1h --fuse --calibration cal.toml
    """
    from imuarray.acquire import record
    from imuarray.commands.interruptible import Interruptible
    from imuarray.commands.log_page import page_beside
    from imuarray.commands.log_screen import Screen
    from imuarray.commands.log_summary import tell
    from imuarray.log.rotate import part_of

    if up and not phase:
        raise click.UsageError("--up says which way the box stood in a phase: name it with --phase")
    array, url = _array_and_bus(config, bus_url, only)
    first = output if rotate_s is None else part_of(output, 1)
    refuse_existing(first, force)
    if output.suffix not in (".h5", ".hdf5"):
        raise click.UsageError(f"{output}: a log is an HDF5 file; name it {output.name}.h5")
    _refuse_without("--fuse", fuse, {"--technique": technique, "--fused": fused_file, "--watch": watch})
    _refuse_without("--monitor", monitor, {"--monitor-host": monitor_host, "--monitor-port": monitor_port})
    judge = _judge(array, calibration, only_if_it_can=fuse) if calibration else None
    options = {"rate_hz": rate_hz, "watch": watch, "rotate_s": rotate_s, "force": force}
    fusion = _fusion(output, fused_file, calibration, technique or "mean", judge, options) if fuse else None
    heard: dict[str, Any] = {}
    with ExitStack() as stack:
        bus, recorder = _connected(stack, url, array, transcript, force)
        stop = stack.enter_context(Interruptible())
        more = fusion.status if fusion else str
        screen = stack.enter_context(closing(Screen(str(output), rate_hz, seconds, more)))
        if monitor:  # the page follows parts from the first one on
            beside = {"calibration": calibration, "result": fused_file}
            page = page_beside(first, host=monitor_host, port=monitor_port, tell=screen.remark, **beside)
            stack.enter_context(page)
        if fusion:
            fusion.tell = screen.remark
            stack.enter_context(closing(fusion))
            heard = {"begun": fusion.begun, "started": fusion.started, "observe": fusion.observe}
        summary = record(
            array,
            bus,
            output,
            rate_hz=rate_hz,
            seconds=seconds,
            phases=() if phase else getattr(bus, "phases", ()),
            phase=phase,
            up=up or face_up(phase),
            rotate_s=rotate_s,
            stopped=lambda: stop.asked,
            tell=screen.event,
            counted=screen.counted,
            judge=judge,
            force=force,
            **heard,
        )
    with suppress(OSError) if stop.hung_up else nullcontext():  # nobody is there to be told
        if bus.source == "replay" and getattr(bus, "stopped", False):
            click.echo("imuarray: the transcript ends here: the recorded program was stopped", err=True)
        if recorder is not None and recorder.failed:
            click.echo(f"imuarray: {recorder.failed}", err=True)
        tell(summary, output, judge.said if judge else [], fusion, as_json)
        if len(summary.silent) == len(array.sensors):
            doctor = f"imuarray detect {config} --doctor"
            click.echo(f"imuarray: no sensor answered any more when the recording ended; try `{doctor}`", err=True)
    return 1 if len(summary.silent) == len(array.sensors) else 0


def _refuse_without(option: str, said: bool, beside: dict[str, Any]) -> None:
    """UsageError if one of the options that belong to another is given, and that one isn't."""
    for name, value in beside.items():
        if value is not None and not said:
            raise click.UsageError(f"{name} is of {option}: say that too")


def _array_and_bus(config: Path, bus_url: str | None, only: str | None) -> tuple[ArrayConfig, str]:
    """The sensors that are to be read, and the URL of their bus; ConfigError if there is none."""
    from imuarray.array import load_array

    array = load_array(find_config(config))
    url = bus_url or array.bus
    if url is None:
        raise ConfigError(
            f"{config}: no bus: say --bus i2c:/dev/i2c-1 (or --bus emulated: to rehearse), or give [array] a bus"
        )
    return array.only(tuple(only.split(","))) if only else array, url


def _judge(array: ArrayConfig, calibration: Path, only_if_it_can: bool) -> StartUpJudge | None:
    """What says how sensors came up; None if it is wanted `only_if_it_can` and the calibration does not say it."""
    from imuarray.commands.start_up import StartUpJudge

    judge = StartUpJudge(array, calibration)
    return judge if judge.knows_states or not only_if_it_can else None


def _fusion(
    output: Path,
    fused_file: Path | None,
    calibration: Path | None,
    technique: str,
    judge: StartUpJudge | None,
    options: dict[str, Any],
) -> LiveFusion:
    """What fuses beside the log."""
    from imuarray.calibrate import Calibration, load_calibration
    from imuarray.commands.log_fused_files import beside
    from imuarray.commands.log_fusion import LiveFusion

    known = load_calibration(calibration) if calibration else Calibration()
    fusion = LiveFusion(
        fused_file or beside(output),
        output,
        known,
        technique,
        calibration_file=str(calibration or ""),
        came_up=judge.in_states if judge else None,
        **options,
    )
    refuse_existing(fusion.first_path, options["force"], source=output)
    return fusion


def _connected(
    stack: ExitStack, url: str, array: ArrayConfig, transcript: Path | None, force: bool
) -> tuple[OpenBus, RecordingBus | None]:
    """The bus, open as long as `stack` is, and what writes its transcript, if one is wanted."""
    from imuarray.bus import open_bus
    from imuarray.bus.transcript import RecordingBus

    bus: OpenBus = stack.enter_context(open_bus(url, array))
    recorder = None
    if transcript:
        bus = recorder = stack.enter_context(RecordingBus(bus, transcript, force=force))
        if recorder.remark:
            click.echo(f"imuarray: {recorder.remark}", err=True)
    if bus.source == "emulated":
        click.echo("imuarray: recording the emulated array, no hardware", err=True)
    return bus, recorder

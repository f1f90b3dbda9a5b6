"""`imuarray log`."""

from __future__ import annotations

import signal
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.axes import UP_AXES, face_up
from imuarray.commands.options import (
    bus_option,
    config_argument,
    find_config,
    force_option,
    json_option,
    print_json,
    progress,
    refuse_existing,
)
from imuarray.errors import ConfigError

if TYPE_CHECKING:
    from imuarray.acquire import Summary
    from imuarray.array import ArrayConfig
    from imuarray.log.writer import Block


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
    help="of `calibrate turn-on`: say after the first seconds at rest which sensor came up wrong",
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
    force: bool,
    as_json: bool,
) -> None:
    """Record the array of CONFIG into a log of raw counts. Interrupt (Ctrl-C) to end it cleanly.

    The bus is --bus or the configuration's; with neither, nothing is recorded.
    """
    from imuarray.acquire import record
    from imuarray.array import load_array
    from imuarray.bus import open_bus
    from imuarray.bus.transcript import RecordingBus

    if up and not phase:
        raise click.UsageError("--up says which way the box stood in a phase: name it with --phase")
    array = load_array(find_config(config))
    url = bus_url or array.bus
    if url is None:
        raise ConfigError(
            f"{config}: no bus: say --bus i2c:/dev/i2c-1 (or --bus emulated: to rehearse), or give [array] a bus"
        )
    if only:
        array = array.only(tuple(only.split(",")))
    refuse_existing(output, force)
    first = _FirstSeconds(array, calibration) if calibration else None
    with ExitStack() as stack:
        bus = stack.enter_context(open_bus(url, array))
        if transcript:
            bus = stack.enter_context(RecordingBus(bus, transcript, force=force))
        if bus.source == "emulated":
            click.echo("imuarray: recording the emulated array, no hardware", err=True)
        stop = stack.enter_context(_Interruptible())
        done = stack.enter_context(progress(int((seconds or 0) * rate_hz), str(output)))
        summary = record(
            array,
            bus,
            output,
            rate_hz=rate_hz,
            seconds=seconds,
            phases=() if phase else getattr(bus, "phases", ()),
            phase=phase,
            up=up or face_up(phase),
            stopped=lambda: stop.asked,
            progress=done,
            observe=first.observe if first else lambda sensor, block: None,
            force=force,
        )
    said = first.say() if first else []
    _tell(summary, output, said, as_json)


def _tell(summary: Summary, output: Path, start_up: list[str], as_json: bool) -> None:
    """What was recorded, for a person or a program."""
    lost = {name: count for name, count in summary.lost.items() if count}
    if as_json:
        print_json(
            {
                "log": str(output),
                "frames": summary.frames,
                "late": summary.late,
                "lost": lost,
                "seconds": summary.seconds,
                "start_up": start_up,
            }
        )
        return
    rate = summary.frames / summary.seconds if summary.seconds else 0.0
    click.echo(f"{output}: {summary.frames} frames in {summary.seconds:.1f} s ({rate:.1f} Hz), {summary.late} late")
    for name, count in lost.items():
        click.echo(f"  {name}: {count} readings lost (see events: imuarray info {output})")


class _FirstSeconds:
    """Collects the first seconds of every sensor and says how they came up, once, while the log goes on."""

    SECONDS = 10.0

    def __init__(self, array: ArrayConfig, calibration: Path) -> None:
        from imuarray.calibrate import load_calibration

        self._array = array
        self._calibration = load_calibration(calibration)
        self._blocks: dict[str, list[Block]] = {sensor.name: [] for sensor in array.sensors if sensor.spec.sensitivity}
        self._said: list[str] | None = None

    def observe(self, sensor: str, block: Block) -> None:
        """Rows that were written."""
        if self._said is None and sensor in self._blocks:
            self._blocks[sensor].append(block)
            if all(parts and parts[-1].time[-1] >= self.SECONDS * 1e9 for parts in self._blocks.values()):
                self.say()

    def say(self) -> list[str]:
        """What there is to say, on standard error the first time."""
        from imuarray.calibrate.start_up import state_of

        if self._said is None:
            means = {name: _mean(parts, self.SECONDS) for name, parts in self._blocks.items() if parts}
            ranges = {sensor.name: sensor.spec.sensitivity for sensor in self._array.sensors}
            found = state_of(means, self._calibration, ranges=ranges)
            texts = [start.sentence(name, self._calibration) for name, start in found.items()]
            self._said = [text for text in texts if text]
            usual = (
                f"{len(found)} sensors came up as ever" if found else "the calibration does not say how sensors come up"
            )
            for text in self._said or [usual]:
                click.echo(f"imuarray: {text}", err=True)
        return self._said


def _mean(parts: list[Block], seconds: float) -> Any:
    """Mean counts (3,) of the first seconds."""
    import numpy as np

    time = np.concatenate([part.time for part in parts])
    counts = np.concatenate([part.counts for part in parts])
    return counts[time <= time[0] + seconds * 1e9].mean(axis=0)


class _Interruptible:
    """SIGINT and SIGTERM end a log cleanly instead of breaking it off."""

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[int, Any] = {}

    def _ask(self, number: int, frame: Any) -> None:
        self.asked = True

    def __enter__(self) -> _Interruptible:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._ask)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

"""`imuarray detect`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imuarray.commands.options import bus_option, find_config, force_option, json_option, print_json, refuse_existing
from imuarray.printable import printable

if TYPE_CHECKING:
    from imuarray.acquire import Found
    from imuarray.acquire.doctor import Check
    from imuarray.array import ArrayConfig

_USUAL_RATE_HZ = 50.0
"""Frames a second of `imuarray log`, if nothing else is said."""
_SENSOR_ADVICE = "look at its supply, its wires and its address pin, and whether CONFIG has the right channel"


@click.command("detect")
@click.argument("config", required=False, type=click.Path(path_type=Path))
@bus_option
@click.option("--self-test", is_flag=True, help="let each chip test itself; its settings are lost")
@click.option("--doctor", is_flag=True, help="say why the bus does not work, and what to do: permission, drivers, room")
@click.option(
    "--logs",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="where logs will go, for --doctor (default: here)",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="NEW.toml",
    help="without CONFIG: write a configuration of what answers, ready to log with; chips that identify themselves"
    " alike (HMC5883, HMC5883L) are told apart by their self-test",
)
@force_option
@json_option
def command(
    config: Path | None,
    bus_url: str | None,
    self_test: bool,
    doctor: bool,
    logs: Path | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """What answers on the bus, and is it what CONFIG says; without CONFIG, what answers on --bus.

    \b
    imuarray detect --bus i2c:/dev/i2c-1 -o array.toml

    Exits 2 if a sensor is missing, another chip sits in its place, a driver of the kernel has its address, or it fails
    its self-test; 1 if a self-test could not be determined; with --doctor 1 if anything is not well (it needs no
    CONFIG; with one it looks at each sensor, too).
    """
    from imuarray.acquire import detect, explore
    from imuarray.acquire.propose import tell_apart
    from imuarray.array import load_array
    from imuarray.bus import open_bus

    if config is None and (self_test or (bus_url is None and not doctor)):
        raise click.UsageError(
            "say what to look for (CONFIG), or where to look (--bus URL); --self-test wants a CONFIG"
        )
    if logs is not None and not doctor:
        raise click.UsageError("--logs is a place for --doctor to look at: say --doctor too")
    if output is not None:
        if doctor:
            raise click.UsageError("--doctor writes nothing: leave -o out")
        if config is not None:
            raise click.UsageError("-o writes what answers on --bus, whatever a CONFIG says: leave CONFIG out")
        refuse_existing(output, force)
    array = load_array(find_config(config or Path("martin2013")))
    url = bus_url or array.bus
    if doctor:
        return _doctor(array, config is not None, bus_url or (array.bus if config else None) or "", logs, as_json)
    if url is None:
        url = "emulated:"
        click.echo(f"imuarray: {config}: no bus is named: asking the emulated array, no hardware", err=True)
    with open_bus(url, array) as bus:
        found = explore(bus) if config is None else detect(array, bus, self_test=self_test)
        if output is not None:
            found = tell_apart(found, bus)
        source = bus.source
    if output is not None:
        _write(found, url, output, force)
    name = array.name if config else None
    wrong = [line for line in found if not line.ok]
    unknown = [line for line in found if line.undetermined]
    exit_code = 2 if wrong else 1 if unknown else 0
    if as_json:
        lines = [asdict(line) for line in found]
        print_json({"array": name, "source": source, "found": lines, "ok": not wrong and not unknown})
        return exit_code
    note = " (emulated, no hardware)" if source == "emulated" else ""
    click.echo(f"{name or 'chips'} on {url}{note}")
    for line in found:
        mark = "ok " if line.ok and line.expected and not line.undetermined else "?  " if line.ok else "NO "
        mark = mark if name else "   "
        wanted = f"{line.sensor} ({line.expected})" if line.expected else "not in the configuration" if name else ""
        told = [text for text in (line.found, line.self_test) if text not in ("", line.expected)]
        click.echo(f"  {mark} {line.place:24} {wanted:28} {'; '.join(told)}".rstrip())
    if output is not None:
        click.echo(
            f"wrote {output}; next: hold the box with Z, X and Y up while `imuarray log {output} -o poses.h5` runs,"
        )
        click.echo(f"then `imuarray calibrate axes poses.h5 -o {output} --force`")
    if name:
        expected = sum(bool(line.expected) for line in found)
        more = f", {len(unknown)} undetermined" if unknown else ""
        click.echo(f"{expected - len(wrong) - len(unknown)} as configured, {len(wrong)} not{more}")
    return exit_code


def _write(found: Sequence[Found], url: str, output: Path, force: bool) -> None:
    """A configuration of what was found."""
    from imuarray.acquire.propose import propose
    from imuarray.array import parse_array
    from imuarray.atomic import write_text

    text = propose(found, url, output.stem)
    parse_array(text, str(output))
    write_text(output, text, force=force)


def _doctor(array: ArrayConfig, is_meant: bool, url: str, logs: Path | None, as_json: bool) -> int:
    """Every check, without a CONFIG (`array` is not meant) those that need none; 0 if all is well, 1 otherwise."""
    from imuarray.acquire import detect, explore
    from imuarray.acquire.doctor import examine
    from imuarray.bus import open_bus

    def talk() -> list[Check]:
        with open_bus(url, array) as bus:
            found = [line for line in detect(array, bus) if line.expected] if is_meant else explore(bus)
        return _answers(found) if is_meant else [_chips(found)]

    checks = examine(array if is_meant else None, url, logs or Path(), _USUAL_RATE_HZ, talk=talk)
    well = all(check.ok for check in checks)
    if as_json:
        print_json(
            {
                "array": array.name if is_meant else None,
                "bus": url,
                "ok": well,
                "checks": [check._asdict() for check in checks],
            }
        )
        return 0 if well else 1
    for check in checks:
        advice = f" -> {check.advice}" if check.advice else ""
        click.echo(printable(f"  {'ok ' if check.ok else 'NO '} {check.name:14} {check.found}{advice}"))
    return 0 if well else 1


def _answers(found: Sequence[Found]) -> list[Check]:
    """Sensors of a CONFIG that are not what answers, or one line for all."""
    from imuarray.acquire.doctor import Check

    silent = [
        Check("sensor", False, f"{line.sensor} ({line.expected}) at {line.place}: {line.found}", _SENSOR_ADVICE)
        for line in found
        if not line.ok
    ]
    return silent or [Check("sensors", True, f"all {len(found)} answer")]


def _chips(found: Sequence[Found]) -> Check:
    """Whatever answers, without a CONFIG."""
    from imuarray.acquire.doctor import Check

    if not found:
        return Check("chips", False, "no chip that we know answers", "look at supply, wires and address pins")
    counts = Counter(line.found for line in found)
    return Check("chips", True, f"{len(found)} answer: " + ", ".join(f"{n} {chip}" for chip, n in counts.items()))

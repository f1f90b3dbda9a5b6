"""`imuarray detect`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imuarray.commands.options import (
    argument,
    bus_option,
    force_option,
    json_option,
    option,
    output_option,
    parameter,
    print_json,
    refuse_existing,
    takes,
)
from imuarray.printable import printable
from imuarray.shipped import find_config

if TYPE_CHECKING:
    from imuarray.acquire import Detection
    from imuarray.acquire.doctor import Check
    from imuarray.bus.protocol import OpenBus

_USUAL_RATE_HZ = 50.0
"""Default frame rate of `imuarray log`."""
_SENSOR_ADVICE = "check its supply, its wiring and its address pin, and the channel in CONFIG"


@dataclass(frozen=True)
class DetectOptions:
    """The options of `imuarray detect`."""

    config: Path | None = argument(required=False)
    bus_url: str | None = parameter(bus_option)
    self_test: bool = option(help="run the self-test of each chip, which resets its settings")
    doctor: bool = option(help="diagnose a bus that does not work, with advice: permissions, drivers, disk")
    logs: Path | None = option(
        metavar="FOLDER", help="folder for the logs, which --doctor checks (default: the current folder)"
    )
    output: Path | None = output_option(
        metavar="NEW.toml",
        help=(
            "without CONFIG: write a configuration of the chips that answer, ready to log with; chips that identify"
            " themselves alike (HMC5883, HMC5883L) are distinguished by their self-test"
        ),
    )
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)


@click.command("detect")
@takes(DetectOptions)
def command(options: DetectOptions) -> int:
    """Report which sensors answer and whether they match CONFIG; without CONFIG, which chips answer on --bus.

    \b
    imuarray detect --bus i2c:/dev/i2c-1 -o array.toml

    Exits 2 if a sensor is missing, a different chip answers in its place, a kernel driver owns its address, or it
    fails its self-test; 1 if the result of a self-test is undetermined. --doctor needs no CONFIG, and also checks each
    sensor if there is one; it exits 1 if any check fails.
    """
    if options.config is None and (options.self_test or (options.bus_url is None and not options.doctor)):
        raise click.UsageError("CONFIG or --bus URL is required; --self-test requires CONFIG")
    if options.logs is not None and not options.doctor:
        raise click.UsageError("--logs needs --doctor")
    if options.output is not None:
        if options.doctor:
            raise click.UsageError("-o can't be combined with --doctor, which writes nothing")
        if options.config is not None:
            raise click.UsageError("-o can't be combined with CONFIG: it writes a configuration of the chips on --bus")
        refuse_existing(options.output, options.force)
    if options.doctor:
        return _doctor(options.config, options.bus_url, options.logs or Path(), options.as_json)
    if options.config is None:
        return _explore(options.bus_url or "", options.output, options.force, options.as_json)
    return _verify(options.config, options.bus_url, options.self_test, options.as_json)


_NOTHING_ON_BUS = "no chip answers; imuarray detect --doctor --bus {url} looks for the cause"
_NOTHING_ON_IIO = "the kernel serves no device; load the module of the sensor's driver, and bind it"


def _verify(config: Path, bus_url: str | None, self_test: bool, as_json: bool) -> int:
    """Report whether the sensors of CONFIG answer, and which other chips do; return the exit code."""
    from imuarray.acquire import detect
    from imuarray.array import load_array
    from imuarray.bus import open_bus

    array = load_array(find_config(config))
    url = bus_url or array.bus
    if url is None:
        url = "emulated:"
        click.echo(f"imuarray: {config}: no bus is configured: using the emulated array, no hardware", err=True)
    with open_bus(url, array) as bus:
        detections, source = detect(array, bus, self_test=self_test), bus.source
        firmware = _firmware(bus)
    wrong = sum(not detection.ok for detection in detections)
    unknown = sum(detection.undetermined for detection in detections)
    exit_code = 2 if wrong else 1 if unknown else 0
    if as_json:
        _print_json(array.name, source, detections, firmware)
        return exit_code
    _print_head(array.name, url, source)
    for detection in detections:
        certain = detection.ok and detection.expected and not detection.undetermined
        mark = "ok " if certain else "?  " if detection.ok else "NO "
        configured = f"{detection.sensor} ({detection.expected})" if detection.expected else "not in the configuration"
        _print_row(mark, configured, detection)
    _print_firmware(firmware)
    expected = sum(bool(detection.expected) for detection in detections)
    undetermined = f", {unknown} undetermined" if unknown else ""
    click.echo(f"{expected - wrong - unknown} of {expected} as configured, {wrong} not{undetermined}")
    return exit_code


def _explore(url: str, output: Path | None, force: bool, as_json: bool) -> int:
    """Report which chips answer on a bus without a configuration, and write a configuration of them to `output`."""
    from imuarray.acquire import explore
    from imuarray.acquire.detection import distinguish_alike
    from imuarray.array import load_array
    from imuarray.bus import open_bus

    array = load_array(find_config(Path("martin2013")))  # needed only by an emulated bus
    with open_bus(url, array) as bus:
        detections = explore(bus)
        if output is not None:
            detections = distinguish_alike(detections, bus)
        source, firmware = bus.source, _firmware(bus)
    if output is not None:
        _write(detections, url, output, force)
    if as_json:
        _print_json(None, source, detections, firmware)
        return 0
    _print_head("chips", url, source)
    for detection in detections:
        _print_row("   ", "", detection)
    if not detections:
        click.echo(f"  {_NOTHING_ON_IIO if source == 'iio' else _NOTHING_ON_BUS.format(url=url)}")
    _print_firmware(firmware)
    if output is not None:
        click.echo(
            f"wrote {output}; next: hold the box with Z, X and Y up while `imuarray log {output} -o poses.h5` runs,"
        )
        click.echo(f"then `imuarray calibrate axes poses.h5 -o {output} --force`")
    return 0


def _firmware(bus: OpenBus) -> dict[str, Any] | None:
    """Return the capacity and counters of a microcontroller's firmware; None on other buses."""
    from imuarray.bus.serial_bus import SerialBus

    if not isinstance(bus, SerialBus):
        return None
    counts = bus.firmware_counts()
    return {**bus.capacity._asdict(), "counts": None if counts is None else counts._asdict()}


def _print_firmware(firmware: dict[str, Any] | None) -> None:
    """Print the capacity of the microcontroller and its counters since it booted."""
    if firmware is None:
        return
    room = (
        f"{firmware['lists']} lists, {firmware['request_bytes']} bytes of requests, {firmware['selects']} chip selects"
    )
    click.echo(f"microcontroller: room for {room}; {firmware['kept_bytes']} bytes of unacknowledged frames")
    counts = firmware["counts"]
    if counts is None:
        click.echo("  its firmware keeps no counts")
        return
    boot = ", reset by its watchdog" if counts["watchdog_reset"] else ""
    click.echo(
        f"  up for {counts['up_us'] / 1e6:.0f} s{boot}: {counts['sent']} frames sent, {counts['late']} skipped for"
        f" lack of time, {counts['dropped']} dropped because the line was full, {counts['overwritten']} lost"
        f" unacknowledged; {counts['failures']} requests failed, {counts['skipped']} bytes not understood"
    )


def _print_json(
    name: str | None, source: str, detections: Sequence[Detection], firmware: dict[str, Any] | None
) -> None:
    ok = all(detection.ok and not detection.undetermined for detection in detections)
    print_json({"array": name, "source": source, "found": list(detections), "firmware": firmware, "ok": ok})


def _print_head(name: str, url: str, source: str) -> None:
    click.echo(f"{name} on {url}{' (emulated, no hardware)' if source == 'emulated' else ''}")


def _print_row(mark: str, configured: str, detection: Detection) -> None:
    texts = (detection.found, detection.self_test, detection.remark)
    about = "; ".join(text for text in texts if text not in ("", detection.expected))
    click.echo(f"  {mark} {detection.place:24} {configured:28} {about}".rstrip())


def _write(detections: Sequence[Detection], url: str, output: Path, force: bool) -> None:
    from imuarray.acquire.detection import propose
    from imuarray.array import parse_array
    from imuarray.atomic import write_text

    text = propose(detections, url, output.stem)
    parse_array(text, str(output))
    write_text(output, text, force=force)


def _doctor(config: Path | None, bus_url: str | None, logs: Path, as_json: bool) -> int:
    """Report every check that is possible with or without a CONFIG; return 0 if all pass, else 1."""
    from imuarray.acquire import detect, explore
    from imuarray.acquire.doctor import examine
    from imuarray.array import load_array
    from imuarray.bus import open_bus

    is_meant = config is not None
    array = load_array(find_config(config or Path("martin2013")))
    url = bus_url or (array.bus if is_meant else None) or ""

    def talk() -> list[Check]:
        with open_bus(url, array) as bus:
            if is_meant:
                return _sensor_checks([line for line in detect(array, bus) if line.expected])
            return [_chip_check(explore(bus))]

    checks = examine(array if is_meant else None, url, logs, _USUAL_RATE_HZ, talk=talk)
    well = all(check.ok for check in checks)
    if as_json:
        name = array.name if is_meant else None
        print_json({"array": name, "bus": url, "ok": well, "checks": [check._asdict() for check in checks]})
        return 0 if well else 1
    for check in checks:
        advice = f" -> {check.advice}" if check.advice else ""
        click.echo(printable(f"  {'ok ' if check.ok else 'NO '} {check.name:14} {check.found}{advice}"))
    return 0 if well else 1


def _sensor_checks(detections: Sequence[Detection]) -> list[Check]:
    """Return a failed check for each sensor of CONFIG that does not answer as configured, or one passed check."""
    from imuarray.acquire.doctor import Check

    silent = [
        Check("sensor", False, f"{line.sensor} ({line.expected}) at {line.place}: {line.found}", _SENSOR_ADVICE)
        for line in detections
        if not line.ok
    ]
    return silent or [Check("sensors", True, f"all {len(detections)} answer")]


def _chip_check(detections: Sequence[Detection]) -> Check:
    """Return the check that any chip answers, for a bus without a CONFIG."""
    from imuarray.acquire.doctor import Check

    if not detections:
        return Check("chips", False, "no known chip answers", "check supply, wiring and address pins")
    counts = Counter(line.found for line in detections)
    return Check("chips", True, f"{len(detections)} answer: " + ", ".join(f"{n} {chip}" for chip, n in counts.items()))

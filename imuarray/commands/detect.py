"""`imuarray detect`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from imuarray.commands.options import bus_option, find_config, json_option, print_json


@click.command("detect")
@click.argument("config", required=False, type=click.Path(path_type=Path))
@bus_option
@click.option("--self-test", is_flag=True, help="let each chip test itself; its settings are lost")
@json_option
def command(config: Path | None, bus_url: str | None, self_test: bool, as_json: bool) -> int:
    """What answers on the bus, and is it what CONFIG says; without CONFIG, what answers on --bus.

    Exits 2 if a sensor is missing, another chip sits in its place, or it fails its self-test.
    """
    from imuarray.acquire import detect, explore
    from imuarray.array import load_array
    from imuarray.bus import open_bus

    if config is None and (bus_url is None or self_test):
        raise click.UsageError(
            "say what to look for (CONFIG), or where to look (--bus URL); --self-test wants a CONFIG"
        )
    array = load_array(find_config(config or Path("martin2013")))
    url = bus_url or array.bus or "emulated:"
    with open_bus(url, array) as bus:
        found = explore(bus) if config is None else detect(array, bus, self_test=self_test)
        source = bus.source
    name = array.name if config else None
    wrong = [line for line in found if not line.ok]
    if as_json:
        print_json({"array": name, "source": source, "found": [asdict(line) for line in found], "ok": not wrong})
        return 2 if wrong else 0
    note = " (emulated, no hardware)" if source == "emulated" else ""
    click.echo(f"{name or 'chips'} on {url}{note}")
    for line in found:
        mark = "   " if not name else "ok " if line.ok and line.expected else ("?  " if line.ok else "NO ")
        wanted = f"{line.sensor} ({line.expected})" if line.expected else "not in the configuration" if name else ""
        told = [text for text in (line.found, line.self_test) if text not in ("", line.expected)]
        click.echo(f"  {mark} {line.place:24} {wanted:28} {'; '.join(told)}".rstrip())
    if name:
        click.echo(f"{sum(bool(line.expected) for line in found) - len(wrong)} as configured, {len(wrong)} not")
    return 2 if wrong else 0

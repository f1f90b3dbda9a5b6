"""`python -m firmware_emulator CONFIG --usbip`: the emulated array as an I2C adapter of this or another Linux machine;
`--serial`: on an emulated microcontroller behind a pseudo-terminal.

This is the only file of the emulator that reads a configuration. Exit codes are those of `imuarray`: 2 for invalid
input, with one line that names the place and what is allowed; 130 after an interrupt.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import parse_qsl

import click

from firmware_emulator.array import EmulatedBus, open_bus
from firmware_emulator.microcontroller_bus import SELECTS, MicrocontrollerBus
from firmware_emulator.serial_firmware import Firmware
from firmware_emulator.serial_port import SerialPort
from firmware_emulator.serve import DEFAULT_HOST, DEFAULT_PORT, UsbipServer
from imuarray.array import ArrayConfig, load_array
from imuarray.commands.program import run
from imuarray.shipped import find_config

PROGRAM = "firmware_emulator"


@click.command(PROGRAM, context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--usbip", is_flag=True, help="serve a USB/IP device that Linux's module i2c-tiny-usb drives")
@click.option("--serial", is_flag=True, help="serve a microcontroller that reads the array, on a serial port")
@click.option("--host", default=DEFAULT_HOST, show_default=True, help="for --usbip: the address, without a password")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=DEFAULT_PORT,
    show_default=True,
    help="for --usbip; 0: any free port",
)
@click.option(
    "--query",
    default="",
    metavar="TEXT",
    help="parameters of the emulated array, as after emulated:? in a bus URL: world=tumble&face_s=10",
)
def program(config: Path, usbip: bool, serial: bool, host: str, port: int, query: str) -> None:
    """Serve the emulated array of CONFIG to other programs, in real time, with --usbip or --serial.

    To use it after --usbip, run as root: modprobe -a vhci-hcd i2c-tiny-usb i2c-dev; usbip attach -r 127.0.0.1 -b 1-1.
    To use it after --serial, run imuarray log CONFIG --bus serial:PORT -o RUN.h5 with the port that is printed.

    \b
    python -m firmware_emulator configs/martin2013.toml --serial
    """
    if usbip == serial:
        raise click.UsageError("give either --usbip or --serial")
    array = load_array(find_config(config))
    bus = real_time_bus(query, array)
    if serial:
        serve_serial(array, bus)
    else:
        serve_usbip(array, bus, host, port)


def real_time_bus(query: str, array: ArrayConfig) -> EmulatedBus:
    """Return the emulated bus with these parameters of a URL, on the real clock, because kernels and external drivers
    sleep in real time.
    """
    parameters = {"clock": "real", **dict(parse_qsl(query, keep_blank_values=True))}
    try:
        if parameters["clock"] != "real":
            raise ValueError(f"clock={parameters['clock']}; allowed is real")
        return open_bus(parameters, array)
    except ValueError as error:
        raise click.UsageError(f"--query {query!r}: {error}") from None


def serve_serial(array: ArrayConfig, bus: EmulatedBus) -> None:
    """Print the address, and serve until interrupted."""
    with SerialPort(Firmware(MicrocontrollerBus(bus), bus.clock, selects=SELECTS)) as port:
        click.echo(f"{array.name}: serial:{port.path}")
        port.serve_forever()


def serve_usbip(array: ArrayConfig, bus: EmulatedBus, host: str, port: int) -> None:
    """Print the port, and serve until interrupted."""
    try:
        server = UsbipServer(bus.wires, array.name, host, port, log=lambda line: click.echo(line, err=True))
    except OSError as error:
        raise click.UsageError(f"{host} port {port}: {error.strerror or error}") from error
    with server:
        host, port = server.address
        for busid, title in server.titles.items():
            click.echo(f"{title}: usbip --tcp-port {port} attach -r {host} -b {busid}")
        server.serve_forever()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    return run(program, PROGRAM, arguments)


if __name__ == "__main__":
    sys.exit(main())

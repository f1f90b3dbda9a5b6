"""The command line: each command is a module of `imuarray.commands`, which is imported only when the command is
called.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from types import MappingProxyType

import click

from imuarray import __version__
from imuarray.commands.program import EXIT_CODES, run
from imuarray.heap import keep_freed_memory
from imuarray.spelling import guess

COMMANDS: Mapping[str, str] = MappingProxyType(
    {
        "demo": "record the emulated array, calibrate, fuse, diagnose, write report.html",
        "detect": "check that the configured sensors answer, or write a configuration of the chips that answer",
        "log": "record an array into a log",
        "monitor": "show a log live while it is being written, as a page or as text",
        "info": "show the contents of a log",
        "verify": "check every block of a log",
        "recover": "finish an interrupted log",
        "import": "convert a recording made by other software into a log",
        "export": "write a log or a fused result as CSV, NumPy, MCAP, MATLAB or Kalibr file",
        "simulate": "simulate an array, and write a log as the array would record it",
        "characterise": "determine Allan deviation, spectrum, codes and noise of a log at rest",
        "calibrate": "determine sensor parameters from logs: axes, tumble, noise, thermal, turn-on",
        "fuse": "fuse all sensors into one specific force and one angular rate",
        "study": "compare fusion techniques with the simple average and with the lower bound, on simulated experiments",
        "gap": "find where recordings and simulations differ, why, and how much of the difference a repair removes",
        "report": "write one HTML page about any logs, calibrations, fused results and diagnoses",
        "paper": "recompute the paper's tables and conclusions from its published data",
        "completion": "print a script that lets a shell complete commands, options and file names",
    }
)
"""Every command and its line in `--help`; the command is `command` in the module `imuarray.commands.<name>`."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables that set the number of threads of linear algebra libraries.

`main` sets them to 1 unless the user has set them. One thread is faster for matrices of at most a hundred rows, and
gives the same bits on every machine. The libraries read the variables when NumPy is imported.
"""

_MODULES = {"import": "imuarray.commands.import_"}


class _Commands(click.Group):
    """The commands above, imported when one of them is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = import_module(_MODULES.get(name, f"imuarray.commands.{name}")).command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in COMMANDS and not name.startswith("-") and not ctx.resilient_parsing:
            ctx.fail(f"No such command {name!r}{guess(name, COMMANDS)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


_PACKAGES = ("numpy", "scipy", "h5py", "smbus2", "pyserial", "matplotlib")
"""The packages on which results can depend."""


def _versions(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    """Print the versions on which results may depend, and end."""
    if not wanted or context.resilient_parsing:
        return
    import platform
    from importlib.metadata import PackageNotFoundError, version

    import h5py

    system = f"{platform.python_version()} on {platform.system()} {platform.release()} {platform.machine()}"
    numbers = {"python": system, "HDF5": h5py.version.hdf5_version}
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            numbers[name] = version(name)
    click.echo(f"imuarray {__version__}")
    for name, number in numbers.items():
        click.echo(f"  {name:12} {number}")
    context.exit()


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=f"Exit codes: {EXIT_CODES}.",
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_versions,
    help="show the versions of imuarray and of the libraries that affect results",
)
@click.pass_context
def program(context: click.Context) -> None:
    """Drive, log, calibrate and fuse an array of low-cost MEMS inertial sensors."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


_COLLECTED = 20_000
"""New objects after which Python looks for unused cycles of objects, instead of 700.

Imports create a hundred thousand permanent objects; the search through them takes up to 7 % of the time of a short
command.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    gc.set_threshold(_COLLECTED)
    atexit.register(gc.freeze)  # no search for cycles at the end of the process, which frees all objects anyway
    keep_freed_memory()
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    return run(program, "imuarray", arguments)


if __name__ == "__main__":
    sys.exit(main())

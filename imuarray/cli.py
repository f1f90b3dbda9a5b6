"""The command line: one small file a command in `imuarray.commands`, loaded only when it is called."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from types import MappingProxyType

import click

from imuarray import __version__
from imuarray.commands.program import EXIT_CODES, run
from imuarray.spelling import guess

COMMANDS: Mapping[str, str] = MappingProxyType(
    {
        "demo": "record the emulated array, calibrate, fuse, diagnose, write report.html",
        "detect": "check that the configured sensors answer; write a configuration of those that do",
        "log": "record an array into a log",
        "monitor": "watch a log while it is written: a page, or text",
        "info": "show the contents of a log",
        "verify": "check every block of a log",
        "recover": "finish an interrupted log",
        "import": "turn a foreign recording into a log",
        "export": "write a log or fused result as CSV, npz, MCAP, MATLAB or Kalibr file",
        "simulate": "write a log as an array would record it, from a model of its sensors",
        "characterise": "Allan deviation, spectrum, codes and noise table of a log at rest",
        "calibrate": "determine sensor parameters from logs: axes, tumble, noise, thermal, turn-on",
        "fuse": "fuse all sensors into one specific force and one angular rate",
        "study": "compare techniques on simulated experiments, with the average and with the lower bound",
        "gap": "find where recordings and simulations differ, why, and how much a repair closes: diagnose",
        "report": "write one HTML page from any mix of logs, calibrations, fused results and diagnoses",
        "paper": "recompute the paper's tables and conclusions from its published data",
        "completion": "print a script that lets a shell complete commands, options and file names",
    }
)
"""Every command and the line that `--help` shows; the module `imuarray.commands.<name>` holds it as `command`."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""How many threads the usual libraries of linear algebra start: one is faster for the matrices here, which have a
hundred rows and fewer (several wait for each other longer than they work), and the same bits come out on every machine.
They read it when numpy is imported; whoever has set it knows better.
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


def _versions(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    """Print the versions on which results may depend, and end."""
    if wanted and not context.resilient_parsing:
        from imuarray.commands.versions import versions

        click.echo(f"imuarray {__version__}")
        for name, version in versions().items():
            click.echo(f"  {name:12} {version}")
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
    help="versions of what results depend on",
)
@click.pass_context
def program(context: click.Context) -> None:
    """Drive, log, calibrate and fuse an array of low-cost MEMS inertial sensors."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; what it returns is the exit code."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    return run(program, "imuarray", arguments)


if __name__ == "__main__":
    sys.exit(main())

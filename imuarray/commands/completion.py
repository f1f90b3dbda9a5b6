"""`imuarray completion`."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_SHELLS = ("bash", "zsh", "fish")


@click.command("completion")
@click.argument("shell", type=click.Choice(_SHELLS))
def command(shell: str) -> None:
    """Print a script for SHELL that completes commands, options and file names.

    \b
    imuarray completion bash > ~/.local/share/bash-completion/completions/imuarray
    imuarray completion zsh > ~/.zfunc/_imuarray
    imuarray completion fish > ~/.config/fish/completions/imuarray.fish
    """
    from imuarray.cli import program

    complete = get_completion_class(shell)
    if complete is None:
        raise click.UsageError(f"{shell}: allowed are {', '.join(_SHELLS)}")
    click.echo(complete(program, {}, "imuarray", "_IMUARRAY_COMPLETE").source())

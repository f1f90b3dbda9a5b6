"""Every command's --help ends its description with an example that the command accepts."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator

import click
import pytest

from imuarray.cli import program


def leaves(group: click.Group, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """The commands that do something, each with the words that call it."""
    for name in group.list_commands(click.Context(group)):
        result = group.get_command(click.Context(group), name)
        if isinstance(result, click.Group):
            yield from leaves(result, (*words, name))
        elif result is not None:
            yield (*words, name), result


FOUND = list(leaves(program, ("imuarray",)))


@pytest.mark.parametrize(("words", "command"), FOUND, ids=["-".join(words[1:]) for words, _ in FOUND])
def test_every_command_has_an_example_with_valid_options(words: tuple[str, ...], command: click.Command) -> None:
    context = click.Context(command, info_name=" ".join(words))
    story = command.get_help(context).split("\nOptions:")[0]
    examples = re.findall(rf"^  {' '.join(words)} (.+)$", story, flags=re.MULTILINE)
    assert examples
    for example in examples:
        arguments = shlex.split(example.split(" > ")[0], comments=True)
        command.make_parser(context).parse_args(arguments)  # click.NoSuchOption for one that it has not


@pytest.mark.parametrize("group", ["", "calibrate", "gap"])
def test_lists_of_commands_have_whole_sentences(group: str) -> None:
    """Click cuts a first sentence that is longer than 45 characters, and ends it with three dots."""
    result = program.get_command(click.Context(program), group) if group else program
    assert result is not None
    assert "..." not in result.get_help(click.Context(result)).split("Commands:")[1]

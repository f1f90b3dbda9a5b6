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
        found = group.get_command(click.Context(group), name)
        if isinstance(found, click.Group):
            yield from leaves(found, (*words, name))
        elif found is not None:
            yield (*words, name), found


FOUND = list(leaves(program, ("imuarray",)))


@pytest.mark.parametrize(("words", "command"), FOUND, ids=["-".join(words[1:]) for words, _ in FOUND])
def test_every_command_has_an_example_with_valid_options(words: tuple[str, ...], command: click.Command) -> None:
    context = click.Context(command, info_name=" ".join(words))
    story = command.get_help(context).split("\nOptions:")[0]
    examples = re.findall(rf"^  {' '.join(words)} (.+)$", story, flags=re.MULTILINE)
    assert examples
    for example in examples:
        said = shlex.split(example.split(" > ")[0], comments=True)
        command.make_parser(context).parse_args(said)  # click.NoSuchOption for one that it has not


@pytest.mark.parametrize("group", ["", "calibrate", "gap"])
def test_lists_of_commands_have_whole_sentences(group: str) -> None:
    """Click cuts a first sentence that is longer than 45 characters, and ends it with three dots."""
    found = program.get_command(click.Context(program), group) if group else program
    assert found is not None
    assert "..." not in found.get_help(click.Context(found)).split("Commands:")[1]

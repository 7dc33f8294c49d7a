"""The commands that README, documentation and examples show are commands, with their options and values."""

import re
import shlex

import click
import command_line
import places
import pytest

from dehyst.cli import main

PAGES = [places.ROOT / "README.md", *sorted(places.DOCS.rglob("*.md")), *sorted(places.EXAMPLES.rglob("*.md"))]

PARAMETERS = [each for _, command in command_line.commands() for each in command.params]
OPTIONS = {"--help", *(name for each in PARAMETERS for name in (*each.opts, *each.secondary_opts))}


def commands(page):
    """Return the commands of indented and fenced blocks."""
    text = page.read_text().replace("\\\n", " ")
    blocks = "\n".join(re.findall(r"^```\w*\n(.*?)^```", text, re.DOTALL | re.MULTILINE))
    return [
        *re.findall(r"^ {4,}(?:\$ )?(dehyst [a-z].*)$", text, re.MULTILINE),
        *re.findall(r"^(?:\$ )?(dehyst [a-z].*)$", blocks, re.MULTILINE),
    ]


def parsed(words):
    """Let the command line read words, and run nothing."""
    command, context = main, click.Context(main, info_name="dehyst")
    while isinstance(command, click.Group):
        _, command, words = command.resolve_command(context, words)
        context = click.Context(command, parent=context, info_name=command.name)
    return command.make_context(command.name, list(words), parent=context).params


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(places.ROOT)))
def test_the_commands_on_a_page_are_understood(page):
    for line in commands(page):
        # Placeholders that a user replaces: the number of a data sheet, a file that another command writes.
        complete = line.replace("GAIN", "1").replace("@scope.txt", "rate=1")
        words = shlex.split(complete, comments=True)[1:]
        # The page on the command line shows how a name that does not exist is refused.
        if words[0] == "identfy":
            continue
        end = next((k for k, word in enumerate(words) if word in (">", "|", "&", "&&")), len(words))
        try:
            assert parsed(words[:end])
        except click.ClickException as error:
            pytest.fail(f"{line}: {error.format_message()}")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(places.ROOT)))
def test_the_options_in_the_sentences_of_a_page_exist(page):
    if "decisions" not in page.parts:
        code = " ".join(re.findall(r"`([^`\n]+)`", page.read_text()))
        assert {*re.findall(r"(?<![\w-])--[a-z][\w-]*", code)} <= OPTIONS


def test_pages_have_commands():
    assert sum(len(commands(page)) for page in PAGES) > 60

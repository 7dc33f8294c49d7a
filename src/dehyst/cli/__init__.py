"""The command line: the operations as commands."""

from dehyst.cli.commands import main

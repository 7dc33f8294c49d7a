"""The command line: commands parse, call and print."""

from dehyst.cli.commands import main

__all__ = ["main"]

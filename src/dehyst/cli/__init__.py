"""The command line: the operations as commands."""

from dehyst.cli.entry import main

__all__ = ["main"]

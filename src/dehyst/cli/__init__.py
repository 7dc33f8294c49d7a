"""The command line: commands parse, call and print."""

from dehyst.cli.registry import main

__all__ = ["main"]

"""The command line: the operations as commands."""

import sys

try:
    from dehyst.cli.commands import main
except KeyboardInterrupt:
    # While the library is imported no command can answer it yet.
    sys.stderr.write("dehyst: stopped by Ctrl-C\n")
    sys.exit(130)

__all__ = ["main"]

"""The command line: the operations as commands."""

import os
import sys

try:
    from dehyst.cli.commands import main
except KeyboardInterrupt:
    os.write(2, b"dehyst: stopped by Ctrl-C\n")
    sys.exit(130)

__all__ = ["main"]

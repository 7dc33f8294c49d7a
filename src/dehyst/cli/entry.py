"""The commands, imported so that Ctrl-C during the import of the library ends without a traceback."""

import sys

try:
    from dehyst.cli.commands import main  # noqa: F401
except KeyboardInterrupt:
    sys.stderr.write("dehyst: stopped by Ctrl-C\n")
    sys.exit(130)

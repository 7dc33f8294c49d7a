"""The command line, as ``dehyst`` and ``python -m dehyst``: Ctrl-C while the library loads ends without a traceback."""

import sys

try:
    from dehyst.cli import main
except KeyboardInterrupt:
    sys.stderr.write("dehyst: stopped by Ctrl-C\n")
    sys.exit(130)

if __name__ == "__main__":
    sys.exit(main())

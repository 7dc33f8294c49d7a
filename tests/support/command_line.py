"""The command line as a process of its own."""

import subprocess
import sys

DEHYST = [sys.executable, "-c", "from dehyst.cli import main; main()"]


def run(*arguments, cwd=None):
    """Return exit status, standard output and standard error of a dehyst command."""
    command = [*DEHYST, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=600, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, done.stdout, done.stderr

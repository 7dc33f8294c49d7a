"""One command for another program, which reads its output: it ends when standard input does."""

from __future__ import annotations

import os
import signal
import threading

_NICE = 5


def _end_with_input() -> None:
    """Wait for the end of standard input, then end as on SIGTERM: the program that started the command is gone."""
    # Not through `sys.stdin`, whose lock the interpreter needs at its own end.
    while os.read(0, 1024):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    # A process that drives an instrument comes first. Windows has no such number.
    if hasattr(os, "nice"):
        os.nice(_NICE)
    threading.Thread(target=_end_with_input, daemon=True).start()
    from dehyst.cli import main

    main()

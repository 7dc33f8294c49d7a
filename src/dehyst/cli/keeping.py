"""The best model so far on the disk: a first one at once, the best one on Ctrl-C."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst.cli.common import refuse_replacing

if TYPE_CHECKING:
    from dehyst.identification import Deadline
    from dehyst.model import Actuator

_WORDS = "dehyst: Ctrl-C: completing the best model so far; press it again to stop at once\n"


class BestSoFar:
    """The best model so far of one identification.

    Parameters
    ----------
    deadline : Deadline
        Of the identification; the first Ctrl-C after the first model ends it.
    output : Path, optional
        Where the model will be written. A finished model that is there already stays until the new one is finished.
    """

    def __init__(self, deadline: Deadline, output: Path | None) -> None:
        self._deadline = deadline
        self._output = output
        self._usable = self._written = False

    def keep(self, actuator: Actuator) -> None:
        """Write the first model."""
        output = self._output
        if output is not None and (not os.path.lexists(output) or _is_provisional(output)):
            refuse_replacing(output)
            actuator.save(output)
            self._written = True
        self._usable = True

    def remove(self) -> None:
        """Remove the first model, because there will be no final one."""
        if self._written and self._output is not None:
            self._output.unlink(missing_ok=True)

    @contextmanager
    def ended_by_interrupt(self) -> Iterator[None]:
        """Let the first Ctrl-C end the search once there is a model; if an error does, remove the model."""
        before = signal.getsignal(signal.SIGINT)
        # A program in the background ignores Ctrl-C.
        handles = threading.current_thread() is threading.main_thread() and before is signal.default_int_handler
        if handles:
            signal.signal(signal.SIGINT, self._end)
        try:
            yield
        except Exception:
            self.remove()
            raise
        finally:
            if handles:
                signal.signal(signal.SIGINT, before)

    def _end(self, *_: Any) -> None:
        if not self._usable:
            raise KeyboardInterrupt
        signal.signal(signal.SIGINT, signal.default_int_handler)
        # Not through the stream, which may be in the middle of a line.
        with suppress(OSError):
            os.write(2, ("\r\033[K" if sys.stderr.isatty() else "").encode() + _WORDS.encode())
        self._deadline.end("Ctrl-C", leave_step=True)


def _is_provisional(path: Path) -> bool:
    """Whether a file is the first model of an identification that did not end."""
    from dehyst._errors import DehystError
    from dehyst.model import Actuator

    with suppress(DehystError):
        return Actuator.load(path).provenance.get("provisional") is True
    return False

"""The emulated controller with faults: commands that it lacks, and answers that a test sets."""

from emulator import Controller
from emulator.gcs_controller import COMMANDS, GcsError
from hand_clock import Hand

from dehyst.virtual import PlayActuator, VirtualBench

WAVES = ["WAV", "WAV?", "WSL", "WGC", "WTR", "WGO", "WGO?", "DRC", "DRL?", "DRR?", "RTR", "DRT", "SPA?", "TNR?", "HDR?"]


class FakeController(Controller):
    """Answers lines of one axis `1`; `told` replaces its answer to the first word of a query, None by silence."""

    def __init__(self, *, limits=(-20.0, 120.0), clock=None, without=(), told=None, **options):
        self.clock = clock or Hand()
        options = {"record_points": 8192, "wave_points": 4096} | options
        self.bench = VirtualBench(PlayActuator(), limits=limits, clock=self.clock, **options)
        super().__init__(self.bench)
        self.known = [word for word in COMMANDS if word not in without]
        self.told, self.lines = dict(told or {}), []

    def answer(self, line):
        """Return the text of an answer, or None."""
        self.lines.append(line)
        word, *arguments = line.split() or [""]
        if word in self.told:
            found = self.told[word]
            return text_of(found(arguments) if callable(found) else found)
        if word == "HLP?":
            return text_of([*(f"{known} does something" for known in self.known), "end of help"])
        if word and word not in self.known:
            self.error = GcsError.UNKNOWN_COMMAND
            return None
        return super().answer(line)


def text_of(lines):
    """Return an answer as it goes over the wire."""
    return None if lines is None else " \n".join(lines) + "\n"

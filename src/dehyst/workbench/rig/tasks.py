"""What moves a rig: operations and waves, and the live data that they send, thinned to ten messages a second."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import RigError
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.instruments import AbstractRig, Reading, Samples
from dehyst.operations.registry import find
from dehyst.operations.run import Run, perform
from dehyst.workbench.rig.messages import Request, path

if TYPE_CHECKING:
    from dehyst.calibration.plan import WantedVoltage

# Seconds between two messages, and between two changes of the state.
_PERIOD, _STATE_PERIOD = 0.1, 1.0
# Most samples of one message.
MOST = 200
# Digits of a number: a microvolt and less than a picometre.
_DIGITS = 6


class LiveFeed:
    """A listener of waves and calibrations, which sends live data and progress and stops them if necessary.

    Parameters
    ----------
    live : callable
        Takes a message of live data.
    state : callable
        Takes changed fields of the state, as keywords.
    check : callable
        Called after each batch of samples is on disk; it raises an error to stop the wave.

    Attributes
    ----------
    status : str
        Sent with each message.
    last : Reading or None
        The last sample.
    seen_at : float
        Time of the last sample [s of time.monotonic].
    count : int
        Samples of the present step.
    """

    def __init__(
        self, live: Callable[[dict[str, Any]], None], state: Callable[..., None], check: Callable[[], None]
    ) -> None:
        self._live, self._state, self._check = live, state, check
        self.status, self.seen_at, self.count = "none", 0.0, 0
        self.last: Reading | None = None
        self._step: str | None = None
        self._first: float | None = None
        self._share: float | None = None
        self._seconds = 0.0
        self._batches: list[tuple[Array, Array, Array, Array]] = []
        self._sent_at = self._state_at = -np.inf

    def step(self, name: str, seconds: float = 0.0) -> None:
        """Begin the step `name`, which plays for `seconds` [s]; 0 for one that computes."""
        self.flush()
        self._check()
        self._step, self._seconds, self._first, self.count = name, seconds, None, 0
        self._share = 0.0 if seconds else None
        self._state(step=name, progress=self._share, words=[])

    def message(self, text: str) -> None:
        """Send a `text` on the present activity of the step."""
        self._check()
        self._state(words=[text])

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Send `samples` that are on disk; `expected` (n,) [m] is their wanted displacement."""
        if samples.time.size:
            wanted = np.full(samples.time.size, np.nan) if expected is None else np.asarray(expected, dtype=np.float64)
            self._batches.append((*samples[:3], wanted))
            self.last = last = Reading(*(float(column[-1]) for column in samples[:3]))
            self.seen_at = time.monotonic()
            self.count += samples.time.size
            self._first = float(samples.time[0]) if self._first is None else self._first
            if self._seconds:
                self._share = min(1.0, (last.time - self._first) / self._seconds)
            if self.seen_at - self._sent_at >= _PERIOD:
                self.flush()
        self._check()

    def reading(self, reading: Reading) -> None:
        """Send one `reading` of a rig at rest."""
        time, voltage, displacement = (np.array([value]) for value in reading)
        self.samples(Samples(time, voltage, displacement))

    def end(self) -> None:
        """End the last step."""
        self.flush()
        self._step, self._share, self._seconds = None, None, 0.0
        self._state(step=None, progress=None, **self._present())

    def flush(self) -> None:
        """Send the samples since the last message."""
        if not self._batches:
            return
        time_, voltage, displacement, wanted = (np.concatenate(column) for column in zip(*self._batches, strict=True))
        self._batches, self._sent_at = [], time.monotonic()
        rows = thinned(voltage)
        self._live(
            {
                "kind": "live",
                "t": _numbers(time_[rows]),
                "v": _numbers(voltage[rows]),
                "y": _numbers(1e6 * displacement[rows]),
                "expected": _numbers(1e6 * wanted[rows]),
                "step": self._step,
                "share": self._share,
                "status": self.status,
            }
        )
        if self._sent_at - self._state_at >= _STATE_PERIOD:
            self._state_at = self._sent_at
            self._state(progress=self._share, **self._present())

    def _present(self) -> dict[str, Any]:
        if self.last is None:
            return {}
        return {"voltage": self.last.voltage, "displacement_um": 1e6 * self.last.displacement}


def thinned(voltage: Array) -> NDArray[np.intp]:
    """Return the rows of at most 200 of voltages (n,) [V]: the last, and the two extremes of each equal stretch."""
    if voltage.size <= MOST:
        return np.arange(voltage.size, dtype=np.intp)
    stretches = np.array_split(np.arange(voltage.size - 1, dtype=np.intp), MOST // 2 - 1)
    extremes = [stretch[[function(voltage[stretch])]] for stretch in stretches for function in (np.argmin, np.argmax)]
    return np.unique(np.concatenate([*extremes, [voltage.size - 1]]))


def _numbers(values: Array) -> list[float | None]:
    return [round(value, _DIGITS) if np.isfinite(value) else None for value in values.tolist()]


class RigRun(Run):
    """The run of an operation on the rig that this process holds.

    Until it begins to send voltages it only checks: `working` is entered then, and yields the receiver of samples.
    `show` takes changed fields of the state.
    """

    def __init__(self, rig: AbstractRig, working: AbstractContextManager[LiveFeed], show: Callable[..., None]) -> None:
        self._working, self._show = working, show
        self.notes: list[str] = []
        super().__init__()
        self.held = nullcontext(rig)

    @property
    def known(self) -> dict[str, Any]:
        """What is known already; the page shows it while the operation runs."""
        return self._known

    @known.setter
    def known(self, values: dict[str, Any]) -> None:
        self._known = values
        self._show(known=values)

    def note(self, sentence: object) -> None:
        """Keep a warning for the result."""
        self.notes.append(str(sentence))

    def watch(self, steps: Sequence[str]) -> AbstractContextManager[LiveFeed]:
        """Return the context in which voltages are sent."""
        return self._working


def performed(run: RigRun, request: Request, **more: Any) -> dict[str, Any]:
    """Perform the operation of a request, and return its result for the state; `more` parameters have priority."""
    operation = find(request["do"])
    given = request.get("given")
    if not isinstance(given, dict):
        raise RigError(f"{request['do']}: got {str(given)[:60]}, need the parameters of dehyst {operation.name}")
    result = perform(operation, operation.of_json({**given, **more}), run)
    # A fit is long, and in a file; repetitions are known already.
    fields = {name: value for name, value in result.fields.items() if name not in ("fit", "cycles")}
    outcome = {"good": result.good, "warnings": [*run.notes, *result.warnings], "command": run.command}
    return {"kind": operation.name, **fields, **outcome}


def playing(rig: AbstractRig, request: Request, feed: LiveFeed, *, first: bool) -> Callable[[], dict[str, Any]]:
    """Return a function that plays the file of a `request` on `rig` and writes its record.

    If it is the `first` one since the connection, the voltage is brought to the safe value before, because the wave of
    a killed process may still be playing. Every sample is on disk before `feed` receives it; the record of a stopped
    wave is marked incomplete. Raise `RecordError` or `FileFormatError` if the file cannot be played; nothing was sent.
    """
    from dehyst.calibration.plan import read_voltage
    from dehyst.records.recording import demand_disk_space

    voltage, target = read_voltage(path(request, "file")), path(request, "record")
    rig.check(voltage.excitation)
    demand_disk_space(target.parent, len(voltage.excitation))

    def task() -> dict[str, Any]:
        with rig.safely():
            if first:
                rig.retreat()
            return _played(rig, voltage, target, feed)

    return task


def _played(rig: AbstractRig, voltage: WantedVoltage, target: Path, feed: LiveFeed) -> dict[str, Any]:
    from dehyst.records import Recording

    excitation, wanted = voltage
    rows = rig.rows(len(excitation))
    meta = {"identity": rig.identity, "axis": rig.axis, "excitation": excitation.name, "program": __version__}
    recording = Recording(target, meta=meta, others=rig.others)
    try:
        with recording:

            def listen(samples: Samples) -> None:
                part = rows[recording.samples : recording.samples + samples.time.size]
                recording.add(samples)
                feed.samples(samples, None if wanted is None else wanted[part])

            feed.step(excitation.name, excitation.duration)
            recording.finish(rig.play(excitation, listen))
    except BaseException:
        if not recording.samples:
            target.unlink(missing_ok=True)
        raise
    return {"kind": "record", "file": str(target), "samples": recording.samples}

"""Search for a delay or a first-order lag between voltage and displacement, beside creep.

Behind a turn of the voltage a delay, a low-pass and a relaxation of half a cycle look alike. So every candidate is
fitted beside branches of slow creep, whose starts are free and follow a drift too, and is judged against no lag at all
by simulating time that was not trained on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dehyst.identification.held_out import block_error
from dehyst.identification.regression.fold_sums import training_errors
from dehyst.identification.regression.nuisances import searched_delay
from dehyst.identification.regression.regression import Regression
from dehyst.identification.rules import RULES
from dehyst.identification.structure import Structure
from dehyst.identification.training_data import Lagging, TrainingData

_ROWS = 1500
# Elements that bend to any loop, and branches that are slower than this part of a cycle: what relaxes faster is lag.
_STRUCTURE = Structure(elements=20, grades=3, transformer=10, smooth=True, creep=3)
_SLOWER = 0.2
# Where ranges grow, free constants nearly hide a lag from the residual: parts of the longest that are simulated too.
_SIMULATED = (0.05, 0.1, 0.2, 0.35, 0.6)
# Delays, evenly up to the longest, that are tried before the best is refined; then parts of it that are of first order.
_POINTS, _SHARES = 7, (0.0, 0.5, 1.0)


def find_lag(frame: TrainingData, longest: float, cycle: float) -> Lagging:
    """Return delay and lag of the records; both 0 unless they predict time that was not trained on.

    `frame`: without delay and lag. `longest`: largest delay looked for [s]; a displacement that leads has another
    cause. `cycle`: least duration of a cycle [s].
    """
    search, step, grows = _LagSearch(frame, cycle), frame.times[0], frame.grows()
    total = search.delay(longest)
    # Where ranges grow the residual does not show a lag. Held-out errors scatter from delay to delay: all that were
    # compared must be better than none.
    errors = (search.held_out,) if grows else (search.residual, search.held_out)

    def helps(place: float) -> bool:
        return all(error(place) < RULES.delay_gain * error(0.0) for error in errors)

    if not (grows or helps(total)):
        return Lagging()
    if not frame.creepless:
        # Slow creep can leave a delay open: of those that are alike beside it, the one that explains most without it.
        other = _LagSearch(replace(frame, creepless=True), cycle).delay(longest)
        if search.residual(other) < RULES.delay_alike * search.residual(total) and search.held_out(
            other
        ) < RULES.delay_as_good * search.held_out(total):
            total = other
    if grows:
        least = RULES.hopeless_delay * search.residual(total)
        simulated = [share * longest for share in _SIMULATED if search.residual(share * longest) < least]
        places = sorted({0.0, total, *simulated})
        total = _vertex(places, [search.held_out(place) for place in places])
    if total < RULES.shortest_lag * step or not helps(total):
        return Lagging()
    share = _vertex(_SHARES, [search.residual(total, share) for share in _SHARES])
    lags = all(error(total, share) < RULES.lag_gain * error(total) for error in errors)
    return _split(total, share if lags else 0.0)


def _split(total: float, share: float) -> Lagging:
    """Return a lag [s] of which a share is of first order, and the rest a delay."""
    return Lagging((1 - share) * total, share * total)


class _LagSearch:
    """Errors of the records with a lag [s] of which a share is of first order."""

    def __init__(self, frame: TrainingData, cycle: float) -> None:
        self._frame = frame
        structure = replace(_STRUCTURE, creep=0) if frame.creepless else _STRUCTURE
        self._grid = structure.grid(frame.span, frame.voltages, (_SLOWER * cycle / 3, frame.times[1]))
        self._training_error = training_errors()
        self._known: dict[tuple[str, float, float], float] = {}

    def delay(self, longest: float) -> float:
        """Return the delay [s] with the least residual; 0 unless it is significant."""
        frame = self._frame
        voltage = self._regression(frame).rows.voltage
        return searched_delay(self.residual, longest, frame.times[0], voltage, frame.stroke, _POINTS)

    def residual(self, total: float, share: float = 0.0) -> float:
        """Return the RMS residual of a fit [m]."""
        key = "residual", total, share
        if key not in self._known:
            late = replace(self._frame, lagging=_split(total, share))
            self._known[key] = self._training_error(self._regression(late))
        return self._known[key]

    def held_out(self, total: float, share: float = 0.0) -> float:
        """Return the error [m] of simulated time that was not trained on."""
        key = "held out", total, share
        if key not in self._known:
            late = replace(self._frame, lagging=_split(total, share))
            self._known[key] = block_error(late, self._regression(late))
        return self._known[key]

    def _regression(self, frame: TrainingData) -> Regression:
        made = frame.on_grid(self._grid, _ROWS, smoothing=_STRUCTURE.smoothing, drifts=False)
        return made if frame.creepless else replace(made, strained=tuple(range(len(frame.training))))


def _vertex(places: Sequence[float], errors: Sequence[float]) -> float:
    """Return where the parabola through the squares of the least error and its neighbours is least."""
    k = int(np.argmin(errors))
    if not 0 < k < len(places) - 1:
        return places[k]
    near, squares = np.array(places[k - 1 : k + 2]), np.square(errors[k - 1 : k + 2])
    bend, slope, _ = np.polyfit(near - near[1], squares / squares[1], 2)
    return float(np.clip(near[1] - 0.5 * slope / bend, near[0], near[2])) if bend > 0 else places[k]

"""The shortest homing: the voltage of least travel that leads from any state at rest to a known one, certified.

Where the order of voltages tells the state it follows in closed form. Where time has a say, or smooth elements have, a
swing through all of the limits is played in time, see `dehyst.control.homing_in_time`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array, Mask
from dehyst._validation import interval, number
from dehyst.control.homing_in_time import Swing
from dehyst.control.major_loop import MajorLoop
from dehyst.control.state_bounds import StateBounds, first_move_error, least_width, moves_on
from dehyst.model import Actuator, GradedSlip, State
from dehyst.waveforms import Excitation, Sampling


@dataclass(frozen=True, eq=False)
class Homing:
    """A voltage that leads from any state to a known one.

    Attributes
    ----------
    turns : tuple of float
        Voltages [V] to visit in this order, the present one first; in between the voltage is monotone. The present one
        alone if the state is known already.
    bracket : StateBounds
        Of the state at the end, by two simulations.
    unknown : tuple of int
        Elements whose carts it leaves unknown, counted from 0.
    certified : bool
        Whether the displacement and every element with stiffness are known at the end, hence all later motion too.
    remarks : tuple of str
        What else the user should know, in sentences.
    played : Excitation or None
        The voltage in time, holds among it, where time has a say: it is certified at this pace only.
    left : float or None
        With `played`: how far apart the displacement may be [m] at the end and along a further cycle through the
        limits, whatever was before. It is this that `certified` speaks of.
    """

    turns: tuple[float, ...]
    bracket: StateBounds
    unknown: tuple[int, ...]
    certified: bool
    remarks: tuple[str, ...] = ()
    played: Excitation | None = None
    left: float | None = None

    @property
    def state(self) -> State:
        """The state at the end, certified or only the middle of the bracket; unknown carts are put halfway."""
        return self.bracket.middle

    @property
    def width(self) -> float:
        """The widest bracket [m] at the end, elements without stiffness among them."""
        return self.bracket.width

    @property
    def error(self) -> float:
        """Error bar [m] of a displacement after it: `left`, or the width of the bracket."""
        return self.width if self.left is None else self.left

    @property
    def travel(self) -> float:
        """Length of the path [V]."""
        return _travel(self.turns)


def shortest_homing(
    actuator: Actuator,
    *,
    limits: Sequence[float] | None = None,
    present: float = 0.0,
    end: float | None = None,
    tolerance: float | None = None,
    stiff_only: bool = False,
    drive: Sampling | None = None,
    hold: float | None = None,
) -> Homing:
    """Find the voltage of least travel that leads from any state at rest to a known one.

    Whether a state is known depends on the extremes of the voltage alone (`least_range`), so no waveform of any shape
    is shorter than the best of: up, down, up and down, down and up, each then to the end. The extremes follow in
    closed form; the certificate is two simulations.

    It is just long enough for the model. A real actuator deserves some percent more; going farther never unhomes.

    Parameters
    ----------
    actuator : Actuator
    limits : (float, float), optional
        Lowest and highest voltage [V]; default the actuator's.
    present, end : float, optional
        Where the voltage is and where it shall end [V]; default 0 and back to the present one.
    tolerance : float, optional
        Width [m] to which the state shall be known; default 1e-12 of the range of the spring's knots. Where time has a
        say, that to which the displacement shall be known; default 1e-3 of that range.
    stiff_only : bool, optional
        Leave out elements without stiffness from the start. They never move the actuator; by default they are homed
        too where the limits allow it, so that the state is known whole.
    drive : Sampling, optional
        Pace and shape of the legs, where time has a say; default: legs of a twentieth of the longest creep time
        constant, and no shorter than fifty periods of a resonance.
    hold : float, optional
        Seconds to wait at either end of the limits at the last visit, where time has a say; default: what the tolerance
        needs, or if no hold does, the longest time constant of creep.

    Returns
    -------
    Homing
        If the limits are too narrow, the best within them, not certified, with a remark on what would do. What creep
        leaves is told as an error bar, and how long a hold would do.

    Raises
    ------
    ModelError
        If there are no limits, present or end lie outside them, or a number is impossible.
    """
    if not isinstance(actuator, Actuator):
        raise ModelError(f"actuator: got {type(actuator).__name__}, need an Actuator")
    bounds = _limits(actuator, limits)
    start = _inside(present, "present", bounds)
    stop = start if end is None else _inside(end, "end", bounds)
    if moves_on(actuator):
        return _in_time(Swing.of(actuator, bounds, (start, stop), drive=drive, hold=hold, tolerance=tolerance))
    task = _HomingTask(actuator, bounds, start, stop, least_width(actuator, tolerance))
    turns = task.turns(task.stiff if stiff_only or not task.can(task.whole) else task.whole)
    bracket = StateBounds.at_rest(actuator, start).drive(actuator, turns).bracket
    unknown = bracket.widths > task.tolerance
    loose = unknown & _stiff(actuator)
    certified = not loose.any() and first_move_error(bracket) <= task.tolerance
    remark = task.remark(turns, bracket, unknown, loose, certified)
    return Homing(turns, bracket, tuple(map(int, np.flatnonzero(unknown))), certified, (remark,) if remark else ())


def _in_time(swing: Swing) -> Homing:
    """What a swing played in time is worth."""
    unknown = swing.bracket.widths > swing.tolerance
    certified = swing.left <= swing.tolerance
    return Homing(
        swing.turns,
        swing.bracket,
        tuple(map(int, np.flatnonzero(unknown))),
        certified,
        swing.remarks(),
        swing.excitation,
        swing.left,
    )


def _stiff(actuator: Actuator) -> Mask:
    """Elements with stiffness anywhere (N,)."""
    kappa = actuator.slip.stiffness
    return np.asarray((kappa > 0).any(axis=1) if isinstance(actuator.slip, GradedSlip) else kappa > 0)


@dataclass(frozen=True, eq=False)
class _HomingTask:
    """A homing asked for. A reach [m] is the least range that makes known what shall be: see `least_range`."""

    actuator: Actuator
    limits: tuple[float, float]
    start: float
    stop: float
    tolerance: float

    @property
    def whole(self) -> float:
        return self._reach(self.actuator.slip.breakaway)

    @property
    def stiff(self) -> float:
        return self._reach(self.actuator.slip.breakaway[_stiff(self.actuator)])

    @property
    def slack(self) -> float:
        """The part of the tolerance [m] that is left to rounding."""
        return min(self.tolerance, least_width(self.actuator, None))

    def _reach(self, breakaway: Array) -> float:
        return 2 * float(breakaway.max()) - (self.tolerance - self.slack) if breakaway.size else -np.inf

    def can(self, reach: float) -> bool:
        return self._enough(*self.limits, reach)

    def _enough(self, low: float, high: float, reach: float) -> bool:
        # An identified model's largest element breaks away over the full excursion exactly: rounding must not decide.
        return self.branch.displacement(high, 1) - self.branch.displacement(low, -1) >= reach - 0.5 * self.slack

    def top(self, bottom: float, reach: float) -> float:
        """Highest voltage [V] that, with `bottom` the lowest, makes the least range `reach`."""
        branch = self.branch
        return branch.voltage(branch.displacement(bottom, -1) + reach, 1)

    def bottom(self, top: float, reach: float) -> float:
        branch = self.branch
        return branch.voltage(branch.displacement(top, 1) - reach, -1)

    @cached_property
    def branch(self) -> MajorLoop:
        return MajorLoop(self.actuator)

    def extremes(self, reach: float) -> tuple[float, float]:
        """Lowest and highest voltage [V], as close together as `reach` allows; the limits if they do not allow it."""
        low, high = self.limits
        near, far = min(self.start, self.stop), max(self.start, self.stop)
        if self._enough(near, far, reach):
            return near, far
        if not self.can(reach):
            return low, high
        latest = near if self._enough(near, high, reach) else max(low, self.bottom(high, reach))
        # The top is piecewise linear in the bottom: the least difference lies where the slope of either changes.
        places = np.concatenate([self.branch.bends(-1), self.branch.bends(1) - reach])
        corners = [self.branch.voltage(float(place), -1) for place in places]
        bottoms = np.clip([latest, low, self.bottom(far, reach), *corners], low, latest)
        tops = np.array([far if self._enough(b, far, reach) else min(high, self.top(b, reach)) for b in bottoms])
        # Of equals the one that goes down least: a piezo stack is better pushed than pulled.
        short = tops - bottoms <= (1 + 1e-12) * (tops - bottoms).min()
        best = int(np.argmax(np.where(short, bottoms, -np.inf)))
        return float(bottoms[best]), float(tops[best])

    def turns(self, reach: float) -> tuple[float, ...]:
        """The shorter order of the two extremes; up first if both are as long."""
        low, high = self.extremes(reach)
        middle = (low, high) if self.stop > self.start else (high, low)
        visited = (self.start, *(turn for turn in middle if turn not in (self.start, self.stop)), self.stop)
        return visited[:1] if visited == (self.start, self.start) else visited

    def remark(
        self, turns: tuple[float, ...], bracket: StateBounds, unknown: Mask, loose: Mask, certified: bool
    ) -> str | None:
        if not certified and self.can(self.stiff):
            return f"not certified: rounding leaves a width of {bracket.width:.3g} m; give a tolerance above that"
        if not certified:
            return f"not certified: {_left(bracket, loose)}; {self._beyond(self.stiff)}"
        if unknown.any():
            said = f"{_left(bracket, unknown)}, without stiffness, which no motion depends on"
            return said if self.can(self.whole) else f"{said}; {self._beyond(self.whole)}"
        travel, shorter = _travel(turns), _travel(self.turns(self.stiff))
        if shorter >= travel * (1 - 1e-9):
            return None
        return f"{travel - shorter:.4g} V of the {travel:.6g} V only home elements without stiffness (stiff_only=True)"

    def _beyond(self, reach: float) -> str:
        low, high = self.limits
        above, below = self.top(low, reach) - high, low - self.bottom(high, reach)
        return f"{above:.4g} V above {high:.6g} V, or {below:.4g} V below {low:.6g} V, would do"


def _limits(actuator: Actuator, limits: Sequence[float] | None) -> tuple[float, float]:
    chosen = actuator.limits if limits is None else limits
    if chosen is None:
        raise ModelError("no voltage limits: the actuator has none and none were given; give limits=(low, high)")
    return interval(chosen)


def _inside(voltage: float, what: str, limits: tuple[float, float]) -> float:
    v = number(voltage, what)
    if not limits[0] <= v <= limits[1]:
        raise ModelError(
            f"{what}: got {v:.6g} V, need a voltage within the limits {limits[0]:.6g} to {limits[1]:.6g} V"
        )
    return v


def _travel(turns: Sequence[float]) -> float:
    return float(sum(abs(b - a) for a, b in pairwise(turns)))


def _named(elements: Mask) -> str:
    """Elements in words, counted from 1 as in the paper."""
    numbers = [int(i) + 1 for i in np.flatnonzero(elements)]
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"elements {numbers[0]} to {numbers[-1]}"
    return f"element{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _left(bracket: StateBounds, unknown: Mask) -> str:
    widest = bracket.widths[unknown].max(initial=0.0) * 1e6
    return f"leaves {_named(unknown)} of {unknown.size} unknown, by up to {widest:.4g} um"

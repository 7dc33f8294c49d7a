"""Blocks for python-control: an actuator and a compensator whose whole memory is the block's state."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from dehyst._errors import MissingExtraError, ModelError
from dehyst._native import CoreError, Loop
from dehyst._types import Array
from dehyst._validation import number
from dehyst.model.base import State
from dehyst.model.evaluator import Evaluator
from dehyst.model.plausibility import Range, voltage_words

if TYPE_CHECKING:
    from control import NonlinearIOSystem

_LINEAR = (
    "linearising, and looking for an operating point (control.linearize, control.find_operating_point), are not "
    "possible, for they change one number of the memory alone, which friction would not hold, and the slope on the "
    "way up is not that on the way down"
)
_LARGEST = float(np.finfo(np.float64).max)


def actuator_block(
    model: Evaluator, start: State, period: float | None, name: str, allowed: Range | None
) -> NonlinearIOSystem:
    """See `dehyst.Actuator.to_control`; `start` is complete, and voltages that stray from `allowed` are refused."""
    period = None if period is None else number(period, "period")
    if period is not None and period <= 0:
        raise ModelError(f"period: got {period}, need a positive number of seconds")
    if period is None and model.needs_time:
        raise ModelError("creep, inertia or a lag need the time between samples; give period= [s]")
    seconds = 0.0 if period is None else period
    pace = model.pace(np.array([0, 1]), np.array([seconds]))
    numbers = np.array([-_LARGEST, _LARGEST, _LARGEST, *model.amplifier(seconds)])
    loop = model.core.loop(pace, np.ones(1), numbers, _ignore_clamps, model.held(start))
    return _block(loop, loop.moved, loop.reached, ("voltage", "displacement"), labels(model, 1), period, name, allowed)


def compensator_block(loop: Loop, states: list[str], period: float | None, name: str) -> NonlinearIOSystem:
    """See `dehyst.Compensator.to_control`; the loop is the block's own and stands where it shall start."""
    return _block(loop, loop.stepped, loop.offered, ("wanted", "voltage"), states, period, name)


def labels(model: Evaluator, taps: int) -> list[str]:
    """Names of a loop's states, in the order of `row` in `src/loop.cpp`.

    w and carts, creep's strains, smooth elements' elongations [m]; with dynamics y, y'/omega and the mass's push [m];
    the voltage last sent; with a lag what acts and the two that were to act before [V]; with preview what was fed [m].
    """
    branches, elements = len(model.creep or ()), len(model.smooth or ())
    found = ["w", *_numbered("cart", len(model.slip)), *_numbered("creep", branches), *_numbered("smooth", elements)]
    found += ["y", "y_rate", "push"] if model.dynamics is not None else []
    found += ["sent", *(["acting", *_numbered("wished", 2)] if model.lag else [])]
    return [*found, *_numbered("fed", taps - 1)]


def _block(
    loop: Loop,
    moved: Callable[[Array, float], Array],
    seen: Callable[[Array, float], float],
    signals: tuple[str, str],
    states: list[str],
    period: float | None,
    name: str,
    allowed: Range | None = None,
) -> NonlinearIOSystem:
    """A block of one input and one output; both functions depend on the state and input that they are given alone."""
    try:
        import control
    except ImportError as error:
        raise MissingExtraError.of("python-control", "control", "A block for python-control") from error

    if not isinstance(name, str) or not name:
        raise ModelError(f"name: got {name!r}, need a word, such as 'stage'")

    def update(_t: float, x: Any, u: Any, _params: Any) -> Array:
        return np.asarray(_of(moved, x, u, signals[0], allowed))

    def output(_t: float, x: Any, u: Any, _params: Any) -> Array:
        return np.array([_of(seen, x, u, signals[0], allowed)])

    block = control.NonlinearIOSystem(
        update,
        output,
        inputs=[signals[0]],
        outputs=[signals[1]],
        states=states,
        dt=True if period is None else float(period),
        name=name,
    )
    block.start = loop.row()
    block.start.flags.writeable = False
    block.linearize = _not_linear
    return block


def _of(function: Callable[[Array, float], Any], x: Any, u: Any, what: str, allowed: Range | None) -> Any:
    state, given = _row(x, "the state"), _row(u, what)
    if given.size != 1 or not np.isfinite(given[0]):
        raise ModelError(f"block: got {what} = {np.ravel(u).tolist()}, need one finite number")
    if allowed is not None and (got := allowed.astray(given)) is not None:
        raise ModelError(f"block: {voltage_words(got, allowed)}; or make the block with extrapolate=True")
    try:
        return function(state, float(given[0]))
    except CoreError as error:
        raise ModelError(
            f"block: got {what} = {float(given[0])!r} and a state that no history leaves behind: {error}. Give `start` "
            f"of the block, or a state that it came to, as the initial state. If it was given: {_LINEAR}"
        ) from error


def _row(values: Any, what: str) -> Array:
    try:
        return np.array(values, dtype=np.float64, ndmin=1).ravel()
    except (TypeError, ValueError) as error:
        raise ModelError(f"block: got {np.ravel(values).tolist()} for {what}, need finite numbers") from error


def _not_linear(*_given: Any, **_options: Any) -> NoReturn:
    raise ModelError(f"linearize: {_LINEAR}; measure the slope by playing a small cycle, and a large one")


def _numbered(name: str, count: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(count)]


def _ignore_clamps(_slewed: bool, _displacement: float, _voltage: float) -> None:
    """Ignore clamps: an actuator has no limits."""

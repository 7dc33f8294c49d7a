"""Blocks for python-control: an actuator and a compensator; the block's state holds all their memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from dehyst._errors import MissingExtraError, ModelError
from dehyst._native import CoreError, Loop
from dehyst._types import Array
from dehyst._validation import number
from dehyst.model.base import State
from dehyst.model.checks import Range, voltage_error
from dehyst.model.evaluator import Evaluator

if TYPE_CHECKING:
    from control import NonlinearIOSystem

_LINEAR = (
    "linearising and searching for an operating point (control.linearize, control.find_operating_point) are not "
    "possible: they change a single number of the memory, which gives a state that friction does not allow; and the "
    "slopes of a rise and of a fall differ"
)
_LARGEST = float(np.finfo(np.float64).max)


def actuator_block(
    model: Evaluator, start: State, period: float | None, name: str, allowed: Range | None
) -> NonlinearIOSystem:
    """Return the block of `dehyst.Actuator.to_control`; `start` is complete; voltages far out of `allowed` raise."""
    seconds = 0.0 if period is None else number(period, "period")
    if period is not None and seconds <= 0:
        raise ModelError(argument="period", got=period, need="a positive number of seconds")
    if period is None and model.needs_time:
        raise ModelError(
            "creep, inertia or a lag need the time between samples", hint="give the period [s]", change=("period",)
        )
    steps = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
    numbers = np.array([-_LARGEST, _LARGEST, _LARGEST, *model.amplifier(seconds)])
    loop = model.core.loop(steps, np.ones(1), numbers, lambda *_: None, model.core_state(start))
    functions, signals = (loop.moved, loop.reached), ("voltage", "displacement")
    return _block(loop, functions, signals, labels(model, 1), period and seconds, name, allowed)


def compensator_block(loop: Loop, states: list[str], period: float | None, name: str) -> NonlinearIOSystem:
    """Return the block of `dehyst.Compensator.to_control`; the loop belongs to the block and is in its start state."""
    return _block(loop, (loop.stepped, loop.offered), ("wanted", "voltage"), states, period, name)


def labels(model: Evaluator, taps: int) -> list[str]:
    """Return the names of a loop's states, in the order of `row` in `bindings/loop.cpp`.

    w and carts, creep strains, smooth elongations [m]; with displacement creep its strains, and the displacement that
    drives it [m]; with dynamics y, y'/omega and the push on the mass [m]; the
    voltage last sent; with a lag the acting voltage and the last two wanted ones [V]; with preview the inputs [m].
    """
    counts = {"cart": len(model.slip), "creep": len(model.creep or ()), "smooth": len(model.smooth or ())}
    names = ["w", *(f"{name}[{i}]" for name, count in counts.items() for i in range(count))]
    if behind := len(model.displacement_creep or ()):
        names += [*(f"displacement_creep[{i}]" for i in range(behind)), "driven"]
    if model.dynamics is not None:
        names += ["y", "y_rate", "push"]
    names += ["sent", "acting", "wished[0]", "wished[1]"] if model.lag else ["sent"]
    return [*names, *(f"fed[{i}]" for i in range(taps - 1))]


def _block(
    loop: Loop,
    functions: tuple[Callable[[Array, float], Array], Callable[[Array, float], float]],
    signals: tuple[str, str],
    states: list[str],
    period: float | None,
    name: str,
    allowed: Range | None = None,
) -> NonlinearIOSystem:
    """Return a block from functions of state and input: one gives the next state, one the output."""
    try:
        import control
    except ImportError as error:
        raise MissingExtraError(
            "A block needs python-control, which is not installed. Try: pip install control"
        ) from error

    if not isinstance(name, str) or not name:
        raise ModelError(argument="name", got=repr(name), need="a word, such as 'stage'")

    def evaluated(function: Callable[[Array, float], Any]) -> Callable[..., Array]:
        return lambda _t, x, u, _params: np.atleast_1d(_evaluate(function, x, u, signals[0], allowed))

    block = control.NonlinearIOSystem(
        *map(evaluated, functions),
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


def _evaluate(function: Callable[[Array, float], Any], x: Any, u: Any, signal: str, allowed: Range | None) -> Any:
    given = []
    for values, what in ((x, "the state"), (u, signal)):
        try:
            given.append(np.array(values, dtype=np.float64, ndmin=1).ravel())
        except (TypeError, ValueError) as error:
            raise ModelError(f"block: got {np.ravel(values).tolist()} for {what}, need finite numbers") from error
    state, signals = given
    if signals.size != 1 or not np.isfinite(signals[0]):
        raise ModelError(f"block: got {signal} = {np.ravel(u).tolist()}, need one finite number")
    if allowed is not None and (got := allowed.far_ends(signals)) is not None:
        raise ModelError(f"block: {voltage_error(got, allowed)}; or let the block extrapolate")
    try:
        return function(state, float(signals[0]))
    except CoreError as error:
        raise ModelError(
            f"block: got {signal} = {float(signals[0])!r} and a state that no history leads to: {error}. Give "
            f"`start` of the block, or a state that it reached, as the initial state. If you did: {_LINEAR}"
        ) from error


def _not_linear(*_given: Any, **_options: Any) -> NoReturn:
    raise ModelError(f"linearize: {_LINEAR}; measure the slope: play a small cycle and a large one")

"""The most operations on numbers that a step of the loop takes, from the sizes of its parts."""

from __future__ import annotations

from dataclasses import dataclass

from dehyst.control import Compensator
from dehyst.exports.model_header import Sizes, demand_compensator

# Steps of `dehyst_smooth_solve` beside those that pass events.
_TRIES = 200


@dataclass(frozen=True)
class Operations:
    """Counts of operations on real numbers; operations on integers and moves are not counted.

    `arithmetic`: additions, subtractions, multiplications and changes of sign.
    """

    arithmetic: int = 0
    divisions: int = 0
    comparisons: int = 0

    def __add__(self, other: Operations) -> Operations:
        return Operations(
            self.arithmetic + other.arithmetic, self.divisions + other.divisions, self.comparisons + other.comparisons
        )

    def __rmul__(self, times: int) -> Operations:
        return Operations(times * self.arithmetic, times * self.divisions, times * self.comparisons)


def worst_case(compensator: Compensator) -> Operations:
    """Bound the operations of `dehyst_loop_step`, `piezo_step` and `piezo_simulate`, whatever came before.

    The count follows the functions of `core/` on their most expensive branches: an offer, then a simulation of the
    actuator with another voltage than the candidate's, past every breakaway and every knot on the way. `compensator` is
    the one that is exported. Raise `ModelError` if it is no Compensator.
    """
    demand_compensator(compensator)
    tables = compensator.tables()
    sizes, inertia = Sizes.of(tables), tables["inertia"].size > 0
    known = _known(sizes, inertia)
    # The wanted displacement and its voltage are tested, limited, and tested again.
    offer = Operations(2 * sizes.taps - 1 + 6 + 2 + 3, 1, 9)
    commit = Operations(2 + 5, 0, 10)
    return offer + _evaluate(sizes, known) + commit + known + _simulate(sizes, inertia)


def _search(n: int) -> int:
    """Count the comparisons of `count_below`: two for each of three tries, then bisection."""
    return 6 + max(n, 0).bit_length()


def _curve(knots: int) -> Operations:
    return Operations(3, 0, _search(knots - 2)) if knots else Operations()


def _evaluate(s: Sizes, known: Operations) -> Operations:
    """Count those of `dehyst_evaluate`."""
    held = _look_ahead(s) if s.grades else Operations(7 + 5 * s.elements, 0, _search(s.knots - 2) + 2 * s.elements)
    smooth = Operations(1, 0, 1) + s.smooth * (Operations(5) + _MOVED) if s.smooth else Operations()
    return held + known + smooth + _curve(s.bends) + Operations(4, 0, 1)


def _known(s: Sizes, inertia: bool) -> Operations:
    """Count those of `known_voltage`: creep, and with inertia gain and offset."""
    return Operations(3 * s.branches + 3) + (Operations(2 + 9 + 5, 2) if inertia else Operations())


def _simulate(s: Sizes, inertia: bool) -> Operations:
    """Count those of `dehyst_simulate_step` without `known_voltage`."""
    advance = Operations(1 + 3 * s.branches) + (Operations(2 + 9 + 2 + 3 + 7, 2) if inertia else Operations())
    moved = Operations(2 * s.elements, 0, 2 * s.elements)
    within_reach = Operations(2, 0, 4)
    solve = _smooth_solve(s) if s.smooth else _solve(s)
    return _curve(s.bends) + Operations(1) + solve + within_reach + moved + advance


def _events(s: Sizes) -> int:
    """Count the changes of slope that a step can pass."""
    return (s.elements + 1) * max(s.grades, 1) + s.knots


def _solve(s: Sizes) -> Operations:
    """Count those of `dehyst_solve`: both directions are tried, then there is a look ahead for each event."""
    events = _events(s)
    return Operations(4, 0, 2) + events * Operations(8, 1, 1) + (events + 2) * _look_ahead(s)


def _smooth_solve(s: Sizes) -> Operations:
    """Count those of `dehyst_smooth_solve`: at most two looks ahead for each step."""
    meet = _look_ahead(s) + Operations(4) + s.smooth * (_MOVED + Operations(9, 1, 1))
    tries = _TRIES + _events(s)
    last = Operations(1, 0, 2) + s.smooth * (Operations(3) + _MOVED)
    return Operations(4, 0, 2 + s.smooth) + tries * Operations(15, 3, 5) + 2 * (tries + 1) * meet + last


def _look_ahead(s: Sizes) -> Operations:
    """Count those of `dehyst_plain_look_ahead` or, with graded elements, `dehyst_grades_look_ahead`."""
    spring = _search(s.knots - 2) + 4
    if not s.grades:
        return Operations(6 + 10 * s.elements, 0, spring + 2 * s.elements)
    grade = Operations(2 + s.grades + 1, 0, 1 + _search(s.grades - 1) + s.grades + 1)
    return Operations(11, 0, spring + 1) + grade + s.elements * (Operations(12, 0, 2) + grade)


# `dehyst_decay`, `dehyst_log1p`, and `moved` for an element that returns, is at rest, and goes on.
_DECAY = Operations(31, 1, 2)
_LOG = Operations(28, 2, 1)
_MOVED = _DECAY + _LOG + _DECAY + Operations(11, 3, 6)

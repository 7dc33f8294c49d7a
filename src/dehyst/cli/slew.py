"""The slew rate of a path: as given, or by default the speed of the model's records; and what a path needs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import click

if TYPE_CHECKING:
    from dehyst.model import Actuator

_NONE = "none"
# What is said of a bound, by where it comes from.
_WORDS = {
    "option": "at most {bound:.4g} V/s",
    "records": "at most {bound:.4g} V/s, the speed of the model's records and a margin of 5 % (--slew changes it)",
    "none": "not limited",
    "unknown": "not limited: this model does not know the speed of its records; give --slew",
    "no time": "not limited: the path has no time",
}


class _SlewType(click.ParamType):  # type: ignore[type-arg]
    """A slew rate, or the word none."""

    name = "slew"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        if value == _NONE:
            return _NONE
        try:
            return float(value)
        except ValueError:
            self.fail(f"got {value!r}, need a number of V/s, or none", param, ctx)


path_slew_option = click.option(
    "--slew",
    type=_SlewType(),
    metavar="V/S|none",
    help="Largest slew rate; none: not limited.  [default: that of the model's records]",
)


class Slew(NamedTuple):
    """The largest slew rate [V/s] of a path, None if not limited, and where it comes from: a key of `_WORDS`."""

    bound: float | None
    origin: str

    @classmethod
    def chosen(cls, actuator: Actuator, given: float | str | None, *, timed: bool = True) -> Slew:
        """Return the slew rate that was `given` [V/s], or the default of a path; `timed`: whether it has a time."""
        if given is not None:
            return cls(None, "none") if isinstance(given, str) else cls(given, "option")
        if actuator.recorded_slew_rate is None:
            return cls(None, "unknown")
        return cls(actuator.recorded_slew_rate, "records") if timed else cls(None, "no time")

    @property
    def words(self) -> str:
        """The bound and its origin."""
        return f"slew rate: {_WORDS[self.origin].format(bound=self.bound)}"

    def missed_words(self, limits: tuple[float, float], voltage: Any, missed: float) -> str:
        """Return for a summary why and by how much [m] a path is missed by its clamped voltages (n,) [V]."""
        at_limit = voltage.min() <= limits[0] or voltage.max() >= limits[1]
        reasons = (at_limit and "cut at the limits", self.bound is not None and "held back by the slew rate")
        return f", {' or '.join(one for one in reasons if one)}: missed by up to {missed * 1e6:.4g} um"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {"slew_V_per_s": self.bound, "slew_from": self.origin}

    def remarks(
        self, actuator: Actuator, limits: tuple[float, float], wanted: Any, time: Any, **rates: Any
    ) -> tuple[str, ...]:
        """Remark a path (n,) [m] that needs more than the speed of the records and its margin.

        `time` (n,) [s] or None; `rates`: the velocity and acceleration of the path, if they are known.
        """
        recorded = actuator.recorded_slew_rate
        if recorded is None or time is None or len(wanted) < 2:
            return ()
        needed = _needed(actuator, limits, wanted, time, rates)
        if needed <= recorded:
            return ()
        held = self.bound is not None and needed > self.bound
        words = f"{needed:.4g} V/s, {needed / recorded:.3g} times the speed of the model's records with a margin of 5 %"
        ways = ": held back; --slew V/S sets another bound, --slew none removes it" if held else ""
        return (f"the path needs up to {words} ({recorded:.4g} V/s){ways}",)


def _needed(actuator: Actuator, limits: tuple[float, float], wanted: Any, time: Any, rates: dict[str, Any]) -> float:
    """Return the largest abs(dv/dt) [V/s] of a path without a slew rate."""
    import numpy as np

    from dehyst.model.states import state_at

    state = state_at(actuator, actuator.state, float(wanted[0]))
    motion = actuator.compensate(wanted, time=time, **rates, state=state, extrapolate=True)
    return float(np.abs(np.diff(np.clip(motion.voltage, *limits)) / np.diff(time)).max())

"""The parts of an actuator in numbers and sentences: one line, and the summary."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from dehyst._text import counted, digits, escaped
from dehyst._types import Array
from dehyst._views.lines import ends, length
from dehyst.model.actuator import Actuator
from dehyst.model.dynamics import DisplacementCreep, Dynamics, Thermal
from dehyst.model.elements import GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer, segment_of
from dehyst.model.states import creep_times, quasistatic, turned, voltages_of

# Duration of a step response in longest time constants, and its number of samples.
_DURATION, _TIMES = 3.0, 160
_PLACES = 400
# Effect of a lag on a planned path, by the source of the lag.
_LATE = {
    "actuator": "a voltage planned with times leads its path by this lag",
    "sensor": "the sensor lags, not the path",
    "": "if the actuator lags, a path is late by this lag",
}


class Part(NamedTuple):
    """One part of an actuator; `sentence`: its effect in this actuator."""

    name: str
    sentence: str


def parts_of(actuator: Actuator) -> tuple[Part, ...]:
    """Return every part of an actuator, in the order of its equation."""
    slopes = actuator.spring.slopes * 1e-6
    knots = f"{actuator.spring.voltage.size} knots, slopes from {slopes.min():.3g} to {slopes.max():.3g} V/um."
    parts = [_slip(actuator.slip, actuator.spring)]
    parts.append(Part("Parallel spring", knots))
    for name, (_, describe) in _FURTHER.items():
        if (part := getattr(actuator, name)) is not None:
            parts.append(describe(part, actuator))
    if actuator.delay:
        late = f"The measured displacement lags the voltage by {_seconds(actuator.delay)}"
        parts.append(Part("Delay", f"{late}; {_LATE[actuator.identification.lag_of]}."))
    if actuator.lag:
        late = f"The acting voltage lags the command by {_seconds(actuator.lag)}"
        parts.append(Part("Amplifier", f"{late}; it is compensated."))
    if actuator.load_stiffness is not None:
        parts.append(Part("Load", f"A force of 1 N moves the actuator by {1e6 / actuator.load_stiffness:.3g} um."))
    return tuple(parts)


def bend(transformer: Transformer) -> Array:
    """Return tau minus the straight line between its ends, at its knots (K,) [V]."""
    v, tau = transformer.voltage, transformer.drive
    return np.asarray(tau - tau[0] - (v - v[0]) * np.ptp(tau) / np.ptp(v))


def step_response(actuator: Actuator) -> tuple[Array, Array]:
    """Compute creep after the fastest rise through the limits, without inertia and lag.

    The rise begins at rest at the lower limit, after a long motion downward.

    Returns
    -------
    time, displacement : (n,) array
        Time since the end of the rise [s], and creep as a part of the displacement of the rise.
    """
    times = creep_times(actuator)
    if not times.size:
        return np.zeros(1), np.zeros(1)
    low, high = voltages_of(actuator)
    begin = turned(actuator, float(actuator.spring.displacement[0]), rising=False)
    slow = quasistatic(actuator)
    shortest, longest = float(times.min()), float(times.max())
    since = np.geomspace(0.1 * shortest, _DURATION * longest, _TIMES)
    # The actuator waits at the lower limit until creep is at rest.
    rest = np.array([0.0, 20 * longest])
    time = np.concatenate([rest, rest[-1] + 0.1 * shortest + np.concatenate([[0.0], since])])
    voltage = np.concatenate([[low, low], np.full(_TIMES + 1, high)])
    y = slow.simulate(voltage, time=time, state=begin, extrapolate=True).displacement
    return since, (y[3:] - y[2]) / (y[2] - y[1])


def resonance(dynamics: Dynamics, spring: Spring) -> tuple[float, float]:
    """Return the resonances [Hz] at constant charge, and at constant voltage with the mean slope of the spring."""
    free = dynamics.frequency
    return free, free * float(np.sqrt(1 - dynamics.share(spring)))


def _slip(slip: GradedSlip | MaxwellSlip, spring: Spring) -> Part:
    sentence = f"{len(slip)} elements, {int(np.count_nonzero(slip.friction > 0))} of them with stiffness"
    if isinstance(slip, GradedSlip):
        y = np.linspace(spring.displacement[0], spring.displacement[-1], _PLACES)
        slopes = spring.slopes[segment_of(spring.displacement, y)] + slip.slopes_at(y[:, None]).sum(axis=1)
        y, k, least, most = 1e6 * y, 1e-6 * slopes, int(np.argmin(slopes)), int(np.argmax(slopes))
        sentence += (
            f", graded in {slip.knots.size - 1} segments: just after a turn the slope is {k[least]:.3g} V/um at "
            f"{y[least]:.3g} um and {k[most]:.3g} V/um at {y[most]:.3g} um"
        )
    return Part("Slip elements", f"{sentence}.")


def _transformer(transformer: Transformer, _: Actuator) -> Part:
    deviation = bend(transformer)
    most, v = int(np.argmax(np.abs(deviation))), transformer.voltage
    sentence = (
        f"tau(v) lies up to {abs(deviation[most]):.3g} V ({digits(100 * abs(deviation[most]) / np.ptp(v))} % of the "
        f"voltages) {'above' if deviation[most] > 0 else 'below'} a straight line, most at {v[most]:.4g} V."
    )
    return Part("Transformer", sentence)


def _creep(creep: DisplacementCreep, _: Actuator) -> Part:
    times = creep.time_constants
    branches = "one branch" if len(creep) == 1 else f"{len(creep)} branches"
    spread = f", {_seconds(times.min())} to {_seconds(times.max())}" if len(creep) else ""
    grows = f"a displacement that is held grows by {digits(100 * (creep.at_rest - 1))} %"
    return Part("Creep", f"{branches} behind the elements{spread}: {grows}.")


def _thermal(thermal: Thermal, actuator: Actuator) -> Part:
    # Rounded, as it may be 0.
    at_lowest = round(thermal.offset + thermal.gain * actuator.reach[0], 15)
    shift = f", and the displacement at the lowest voltage by {1e9 * at_lowest:+.3g} nm/K" if at_lowest else ""
    sentence = f"from {thermal.reference:.4g} degC on, the stroke changes by {100 * thermal.gain:+.3g} %/K{shift}."
    return Part("Temperature", sentence)


def _smooth(smooth: SmoothSlip, _: Actuator) -> Part:
    lengths = np.unique(smooth.length) * 1e6
    elements = f"One element that yields gradually over {lengths[0]:.3g} um"
    if len(smooth) > 1:
        elements = f"{len(smooth)} elements that yield gradually over {lengths[0]:.3g} to {lengths[-1]:.3g} um"
    return Part("Smooth elements", f"{elements}: inner loops do not quite close.")


def _dynamics(dynamics: Dynamics, actuator: Actuator) -> Part:
    free, driven = resonance(dynamics, actuator.spring)
    sentence = f"Resonance at {free:.4g} Hz with a damping of {dynamics.damping:.3g}"
    if dynamics.series:
        sentence += f", under a voltage at {driven:.4g} Hz about the mean slope"
    return Part("Inertia", f"{sentence}.")


# Name and sentence of each part that an actuator may have.
_FURTHER: dict[str, tuple[str, Any]] = {
    "transformer": ("transformer", _transformer),
    "displacement_creep": ("creep", _creep),
    "thermal": ("", _thermal),
    "smooth": ("smooth elements", _smooth),
    "dynamics": ("inertia", _dynamics),
}


def _seconds(time: float) -> str:
    if time < 0.1:
        return f"{1e3 * time:.3g} ms"
    return f"{time:.3g} s" if time < 1000 else f"{time:.0f} s"


def _ranges(actuator: Actuator) -> tuple[str, str]:
    """Return the limits and the stroke in words; without records the stroke is the range of the spring's knots."""
    limits, tested = actuator.limits, actuator.identification.validity
    within = np.ptp(actuator.spring.displacement) if tested is None else tested.stroke
    return "no voltage limits" if limits is None else ends(*limits, "V"), f"stroke {length(float(within))}"


def one_line(actuator: Actuator) -> str:
    """Return name, parts, voltages and stroke in one line, without computations that could fail."""
    graded = "graded " if isinstance(actuator.slip, GradedSlip) else ""
    further = [words for name, (words, _) in _FURTHER.items() if words and getattr(actuator, name) is not None]
    parts = ", ".join([f"{graded}{counted(len(actuator.slip), 'slip element')}", *further])
    return "<Actuator '{}': {}, {}, {}>".format(escaped(actuator.name), parts, *_ranges(actuator))


def lines(actuator: Actuator) -> Iterator[str]:
    """Yield the lines of a summary: voltages, stroke and reach, then each part with its sentence."""
    low, high = actuator.reach
    yield "{}: {}, {}, reach {}".format(escaped(actuator.name), *_ranges(actuator), ends(1e6 * low, 1e6 * high, "um"))
    for part in parts_of(actuator):
        yield f"  {part.name + ':':<17} {part.sentence}"

"""What goes wrong in a record: of the sensor, of the surroundings, of the recorder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray
# White noise of every sensor, as a part of the stroke.
QUIET = 2e-4


@dataclass(frozen=True)
class Raw:
    """A record before it is one: times [s], voltages [V] and displacements [m] (n,), and a name."""

    time: Array
    voltage: Array
    displacement: Array
    name: str

    def rows(self, kept: Array) -> Raw:
        """Return some of its samples."""
        return Raw(self.time[kept], self.voltage[kept], self.displacement[kept], self.name)


@dataclass(frozen=True)
class Scale:
    """What disturbances are measured by: stroke [m], range [V] and slow period [s].

    `unit` is a two hundredth of the fastest period [s].
    """

    stroke: float
    volts: float
    period: float
    unit: float


Change = Callable[[list[Raw], Scale, np.random.Generator], list[Raw]]


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of records; `named` is a pattern of the words by which a warning names it.

    `delay` is one of the drive, in units of `Scale`; `parts` are those by which a model may rightly follow it.
    """

    name: str
    change: Change
    named: str
    delay: float = 0.0
    parts: frozenset[str] = frozenset()


def _each(change: Callable[[Raw, Scale, np.random.Generator], Array]) -> Change:
    """Return a change of the displacements of each record."""
    return lambda raws, scale, rng: [replace(raw, displacement=change(raw, scale, rng)) for raw in raws]


def _clean(raws: list[Raw], scale: Scale, rng: np.random.Generator) -> list[Raw]:
    return raws


def _white(level: float) -> Change:
    return _each(lambda raw, scale, rng: raw.displacement + rng.normal(0, level * scale.stroke, raw.time.size))


def _vibrating(raw: Raw, scale: Scale, rng: np.random.Generator) -> Array:
    """Of 1 %, sixty times in a slow period: 3 Hz beside loops of 20 s."""
    return raw.displacement + 0.01 * scale.stroke * np.sin(2 * np.pi * 60.3 / scale.period * raw.time + 1.0)


def _drifting(raw: Raw, scale: Scale, rng: np.random.Generator) -> Array:
    """By 3 % over the record."""
    return raw.displacement + 0.03 * scale.stroke * (raw.time - raw.time[0]) / np.ptp(raw.time)


def _walking(raw: Raw, scale: Scale, rng: np.random.Generator) -> Array:
    """By about 1.5 % at its end."""
    steps = rng.normal(0, 1, raw.time.size)
    return raw.displacement + 0.015 * scale.stroke * np.cumsum(steps) / np.sqrt(raw.time.size)


def _spiking(raw: Raw, scale: Scale, rng: np.random.Generator) -> Array:
    y = raw.displacement.copy()
    at = rng.choice(np.arange(20, y.size - 20), 8, replace=False)
    y[at] += scale.stroke * rng.uniform(0.05, 0.3, 8) * rng.choice([-1, 1], 8)
    return y


def _coarse(raw: Raw, scale: Scale, rng: np.random.Generator) -> Array:
    step = 0.003 * scale.stroke
    return step * np.round(raw.displacement / step)


def _coarse_voltage(raws: list[Raw], scale: Scale, rng: np.random.Generator) -> list[Raw]:
    step = scale.volts / 255
    return [replace(raw, voltage=step * np.round(raw.voltage / step)) for raw in raws]


def filtered(raw: Raw, scale: Scale, rng: np.random.Generator) -> Array:
    """By a first-order low-pass of the sensor of an eightieth of the fastest period: 0.25 s beside loops of 20 s."""
    y, keep = raw.displacement, float(np.exp(-np.median(np.diff(raw.time)) / (2.5 * scale.unit)))
    late, filtered = float(y[0]), []
    for now in y.tolist():
        late = keep * late + (1 - keep) * now
        filtered.append(late)
    return np.array(filtered)


def _missing(raws: list[Raw], scale: Scale, rng: np.random.Generator) -> list[Raw]:
    """Leave out a tenth of the samples, one by one, and about an eighth of a period in one piece."""
    gapped = []
    for raw in raws:
        kept = rng.random(raw.time.size) > 0.1
        begin, length = raw.time.size * 2 // 3, raw.time.size // 90
        kept[begin : begin + length] = False
        gapped.append(raw.rows(kept))
    return gapped


def _rezeroed(raws: list[Raw], scale: Scale, rng: np.random.Generator) -> list[Raw]:
    """Split each record in two parts; each begins with 0."""
    parts = []
    for raw in raws:
        half = raw.time.size * 55 // 100
        for letter, span in (("a", slice(0, half)), ("b", slice(half, None))):
            part = raw.rows(np.arange(raw.time.size)[span])
            parts.append(replace(part, displacement=part.displacement - part.displacement[0], name=raw.name + letter))
    return parts


def _glitched(raws: list[Raw], scale: Scale, rng: np.random.Generator) -> list[Raw]:
    """Record six voltages as 0 or half as large again; the actuator does not get them."""
    glitched = []
    for raw in raws:
        voltage = raw.voltage.copy()
        at = rng.choice(np.arange(20, voltage.size - 20), 6, replace=False)
        voltage[at] *= rng.choice([0.0, 1.5], 6)
        glitched.append(replace(raw, voltage=voltage))
    return glitched


_NOISE = r"nois"
DISTURBANCES = {
    disturbance.name: disturbance
    for disturbance in (
        Disturbance("none", _clean, r"(?!)"),
        Disturbance("white-0.1", _white(0.001), _NOISE),
        Disturbance("white-0.3", _white(0.003), _NOISE),
        Disturbance("white-1", _white(0.01), _NOISE),
        Disturbance("vibration", _each(_vibrating), r"vibrat|periodic|\bHz\b"),
        Disturbance("drift", _each(_drifting), r"drift|creeps"),
        Disturbance("walk", _each(_walking), r"drift|creeps|slow"),
        Disturbance("spikes", _each(_spiking), r"spike|outlier|stray|jump"),
        Disturbance("coarse", _each(_coarse), r"quanti|resol|coarse|nois|steps of"),
        Disturbance("coarse-voltage", _coarse_voltage, r"quanti|resol|coarse|steps of"),
        Disturbance("filter", _each(filtered), r"filter|lag", parts=frozenset({"delay"})),
        Disturbance("delay", _clean, r"delay|lag", delay=2.5, parts=frozenset({"delay"})),
        Disturbance("missing", _missing, r"missing|gap"),
        Disturbance("rezeroed", _rezeroed, r"zero|datum"),
        Disturbance("glitches", _glitched, r"glitch|spike|voltages? "),
    )
}

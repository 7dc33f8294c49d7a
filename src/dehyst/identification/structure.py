"""The structure of a model: which parts an actuator has, and the grids on which they lie."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._types import Array, Mask
from dehyst.model import Actuator, GradedSlip, segment_of

# Lengths of smooth elements as parts of the stroke, each with both closings. An element forgets its start over a few
# lengths: longer elements would still depend on the start of a record.
_LENGTHS = np.array([0.02, 0.05, 0.1, 0.2, 0.5])
_CLOSINGS = np.array([0.5, 1.0])
# Least and largest numbers.
_COUNTS = {"elements": (1, 500), "grades": (1, 50), "knots": (2, 500), "transformer": (0, 200)}


@dataclass(frozen=True)
class Structure:
    """The parts of an actuator and their numbers.

    Parameters
    ----------
    elements : int
        Number N of thresholds, rho_i = stroke / 2 (i / N)^spacing. The last element slides only over the whole stroke
        and acts as part of the spring.
    spacing : float
        1: uniform grid, as in the paper; 2: denser for small loops.
    grades : int
        Number of segments of the stroke, each with other stiffnesses of the elements; 1: Maxwell-slip elements.
    knots : int
        Number of knots of the spring.
    transformer : int
        Number of segments of tau(v); 0: no transformer.
    smooth : bool
        Whether there are elements that yield gradually, of five lengths.
    smoothing : float
        Weight of the differences of neighbouring stiffnesses and slopes; 0: none. See `regularization`.

    Raises
    ------
    IdentifyError
        If a number is impossible.
    """

    elements: int = 20
    spacing: float = 1.0
    grades: int = 1
    knots: int = 21
    transformer: int = 0
    smooth: bool = False
    smoothing: float = 3e-3

    def __post_init__(self) -> None:
        for name, (least, most) in _COUNTS.items():
            _validation.count(getattr(self, name), name, least, most)
        _validation.Numbers(least=0.5, most=4.0, error=IdentifyError)(self.spacing, "spacing")
        if not isinstance(self.smooth, bool):
            raise IdentifyError(argument="smooth", got=repr(self.smooth), need="True or False")
        _validation.Numbers(least=0.0, most=1.0, error=IdentifyError)(self.smoothing, "smoothing")
        if self.transformer == 1:
            raise IdentifyError("transformer: got 1, need 0 or at least two segments: one segment is a straight line")

    @property
    def words(self) -> str:
        """Description in words."""
        parts = [f"{self.elements} elements" + ("" if self.spacing == 1 else ", dense where loops are small")]
        if self.grades > 1:
            parts.append(f"graded in {self.grades} segments")
        if self.transformer:
            parts.append(f"a transformer of {self.transformer} segments")
        if self.smooth:
            parts.append("smooth elements")
        return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return asdict(self)

    def grid(self, span: tuple[float, float], voltages: tuple[float, float]) -> Grid:
        """Return thresholds and knots for loops over displacements `span` [m] and `voltages` [V], (low, high)."""
        low, high = span
        stroke = high - low
        breakaway = 0.5 * stroke * (np.arange(1, self.elements + 1) / self.elements) ** self.spacing
        lengths = np.repeat(_LENGTHS * stroke, _CLOSINGS.size) if self.smooth else np.zeros(0)
        return Grid(
            breakaway,
            np.linspace(low, high, self.grades + 1),
            np.linspace(low, high, self.knots),
            np.linspace(*voltages, self.transformer + 1) if self.transformer else np.zeros(0),
            lengths=lengths,
            closings=np.tile(_CLOSINGS, lengths.size // _CLOSINGS.size),
            graded=self.grades > 1,
        )


def _nothing() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Grid:
    """Thresholds and knots of the parts of an actuator.

    Attributes
    ----------
    breakaway : (N,) array
        rho [m].
    grades : (M + 1,) array
        Knots [m] of the elements' stiffnesses; M = 1: Maxwell-slip elements.
    knots : (K,) array
        Knots of the spring [m].
    drive : (T + 1,) or (0,) array
        Knots of tau [V].
    lengths, closings : (L,) array
        Lengths of smooth elements [m], and their closings.
    graded : bool
        Whether the elements are graded; with M = 1 both are possible.
    sliding : (N,) bool array, optional
        Elements that get a stiffness; default: elements that can slide both ways within the knots of the spring.
    """

    breakaway: Array
    grades: Array
    knots: Array
    drive: Array = field(default_factory=_nothing)
    lengths: Array = field(default_factory=_nothing)
    closings: Array = field(default_factory=_nothing)
    graded: bool = False
    sliding: Mask | None = None

    @classmethod
    def of_actuator(cls, actuator: Actuator, sliding: Mask | None = None) -> Grid:
        """Return the grid of the parts of an actuator."""
        slip, knots = actuator.slip, actuator.spring.displacement
        tau, smooth = actuator.transformer, actuator.smooth
        graded = isinstance(slip, GradedSlip)
        return cls(
            slip.breakaway,
            slip.knots if isinstance(slip, GradedSlip) else knots[[0, -1]],
            knots,
            _nothing() if tau is None else tau.voltage,
            _nothing() if smooth is None else smooth.length,
            _nothing() if smooth is None else smooth.closing,
            graded,
            sliding,
        )

    @cached_property
    def movable(self) -> Mask:
        """(N,) whether elements get a stiffness: `sliding`, or whether they can slide both ways within the knots."""
        if self.sliding is not None:
            return self.sliding
        return np.asarray(2 * self.breakaway < np.ptp(self.knots) * (1 - 1e-9))

    @cached_property
    def outermost(self) -> Array:
        """Coefficients (p, q) of stiffnesses and spring slopes in the slope of each piece of the outer branches."""
        rho = self.breakaway[self.movable]
        parts = []
        for sign in (1.0, -1.0):
            bends = np.unique(np.concatenate([self.knots, self.grades, (self.grades[:, None] + sign * rho).ravel()]))
            y = np.concatenate([[bends[0] - 1e-9], 0.5 * (bends[1:] + bends[:-1]), [bends[-1] + 1e-9]])
            ahead = segment_of(self.grades, y)[:, None, None] == np.arange(self.segments)
            held = segment_of(self.grades, y[:, None] - sign * rho)[:, :, None] == np.arange(self.segments)
            spring = segment_of(self.knots, y)[:, None] == np.arange(self.knots.size - 1)
            elements = (ahead.astype(np.int8) - held.astype(np.int8)).reshape(y.size, -1)
            parts.append(np.hstack([elements, spring.astype(np.int8)]))
        rows = np.vstack(parts)
        # Each row becomes one string of bytes: comparing these is faster than sorting by columns.
        _, first = np.unique(rows.view(np.dtype((np.void, rows.shape[1]))).ravel(), return_index=True)
        return np.asarray(rows[np.sort(first)], dtype=np.float64)

    @property
    def segments(self) -> int:
        """Number M of segments."""
        return self.grades.size - 1

    @cached_property
    def places(self) -> dict[str, slice]:
        """Slices of each kind of non-negative unknown, in the order of the program."""
        sizes = {
            "elements": int(np.count_nonzero(self.movable)) * self.segments,
            "spring": self.knots.size - 1,
            "smooth": self.lengths.size,
            "transformer": max(self.drive.size - 2, 0),
        }
        ends = np.cumsum(list(sizes.values())).tolist()
        return {kind: slice(end - size, end) for (kind, size), end in zip(sizes.items(), ends, strict=True)}

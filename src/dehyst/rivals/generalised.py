"""The generalised Prandtl-Ishlinskii model: plays of the voltage, each seen through a curve of its own, and low-passes.

M. Al Janaideh, S. Rakheja, C.-Y. Su, "An analytical generalized Prandtl-Ishlinskii model inversion for hysteresis
compensation in micropositioning control", IEEE/ASME Trans. Mechatronics 16(4), 2011, 734-744 (envelope functions); here
each play has an envelope, piecewise linear and fitted, and first-order low-passes stand for creep as in H. Jung,
D.-G. Gweon, "Creep characteristics of piezoelectric actuators", Rev. Sci. Instrum. 71(4), 2000, 1896-1900.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._native import Array, vector
from dehyst.model import AbstractModel, Motion
from dehyst.program import one_thread
from dehyst.record import Record
from dehyst.rivals.least_squares import Rows, differences, left_out, nonnegative
from dehyst.rivals.plays import PlayBank, PlayState
from dehyst.rivals.training import Training, count, share

# Low-passes fitted to what is no creep do harm elsewhere: they have to predict what was left out this much better.
_WORTH = 0.8


@dataclass(frozen=True, eq=False)
class Generalised(AbstractModel):
    """``y = offset + sum_i phi_i(play_i[v]) + sum_k c_k lowpass_k[v]``, phi_i increasing and piecewise linear.

    Its inverse is walked exactly from one place where a slope changes to the next.

    Attributes
    ----------
    bank : PlayBank
        Its operators.
    state : PlayState
        Where it starts: by default after a long descent to the lowest voltage of its records.
    delay : float
        Seconds by which the displacement lags the voltage; `simulate` and `compensate` leave it to the caller.
    remarks : tuple of str
        Sentences: what was repaired in the records.
    """

    bank: PlayBank
    state: PlayState
    delay: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def parameters(self) -> int:
        """Numbers that the fit chose."""
        return self.bank.parameters

    def simulate(self, voltage: ArrayLike, *, state: PlayState | None = None, time: ArrayLike | None = None) -> Motion:
        """Displacement (n,) [m] that a voltage (n,) [V] causes.

        Parameters
        ----------
        voltage : (n,) array_like
            [V].
        state : PlayState, optional
            Before the first sample; by default the model's own.
        time : (n,) array_like, optional
            [s], increasing; needed with low-passes. A time that begins after the state's goes on from there; another
            follows it by its own first interval, and a state without time at once.

        Raises
        ------
        ModelError
            If a value is not finite, the time is missing or does not increase, or the state is not this model's.
        """
        v = vector(voltage, "voltage")
        y, after = self.bank.simulate(v, self.state if state is None else state, time)
        return Motion(v, y, after)

    def compensate(
        self, displacement: ArrayLike, *, state: PlayState | None = None, time: ArrayLike | None = None
    ) -> Motion:
        """Voltage (n,) [V] for a displacement (n,) [m]; arguments and errors as `simulate`.

        Raises
        ------
        ModelError
            Also if no voltage reaches a displacement.
        """
        y = vector(displacement, "displacement")
        v, after = self.bank.compensate(y, self.state if state is None else state, time)
        return Motion(v, y, after)

    @classmethod
    @one_thread()
    def fit(
        cls, records: Record | Sequence[Record], *, plays: int = 20, segments: int = 10,
        lowpasses: ArrayLike | None = None, slope_floor: float = 0.05, smoothing: float = 1e-6,
        delay: float | None = None, drift: bool = True,
    ) -> Generalised:  # fmt: skip
        """Fit the slopes of all curves and the low-passes' shares by nonnegative least squares.

        Parameters
        ----------
        records : Record or sequence of Record
            Loops; none needs to start relaxed. Each has an offset of its own.
        plays : int, optional
            Their thresholds cut half of the voltage's range in equal parts, from 0.
        segments : int, optional
            Of each curve, over what its play can reach.
        lowpasses : (K,) array_like, optional
            Time constants [s]; an empty one leaves creep out. By default two a decade from two samples to the length of
            the longest record, or none unless quarters of the records left out of the fit are predicted much better so.
        slope_floor : float, optional
            Least slope just after a reversal, as a fraction of the mean one, without which there is no inverse.
        smoothing : float, optional
            Weight of the squared differences of neighbouring slopes, for those of which the records say nothing.
        delay : float, optional
            Seconds by which the displacement lags the voltage; by default looked for.
        drift : bool, optional
            Whether a record may creep by a logarithm of the time since its start, which is then set aside.

        Raises
        ------
        RecordError, IdentifyError
            If a record cannot be used, or an option is impossible.
        """
        count(plays, "plays")
        count(segments, "segments")
        share(slope_floor, "slope_floor")
        training = Training.of(records)
        lag = training.lag(delay)
        choices = [_times(training), np.zeros(0)] if lowpasses is None else [_given(lowpasses)]
        designs = [_Design.of(training, plays, segments, times, lag, drift, slope_floor) for times in choices]
        if len(designs) > 1 and designs[0].missed(smoothing) > _WORTH * designs[1].missed(smoothing):
            del designs[0]
        bank, state = training.placed(designs[0].fitted(smoothing))
        return cls(bank, state, lag, training.sentences)


@dataclass(frozen=True, eq=False)
class _Design:
    """Columns of slopes and low-passes, floors below them, and how they hang together."""

    thresholds: Array
    knots: list[Array]
    times: Array
    rows: Rows
    columns: Array
    floors: Array
    rough: Array

    @classmethod
    def of(
        cls, training: Training, plays: int, segments: int, times: Array, delay: float, drift: bool, floor: float
    ) -> _Design:
        thresholds = training.thresholds(plays)
        knots = [np.linspace(training.low + r, training.high - r, segments + 1)[1:-1] for r in thresholds]
        rows = training.rows(thresholds, times, delay, drift)
        floors = np.zeros(plays * segments + times.size)
        floors[:segments] = floor * training.slope
        rough = np.pad(differences([segments] * plays), ((0, 0), (0, times.size)))
        return cls(thresholds, knots, times, rows, rows.ramps(knots), floors, rough)

    def missed(self, smoothing: float) -> float:
        return left_out(self.rows, self.columns, self.floors, self.rough, smoothing)

    def fitted(self, smoothing: float) -> PlayBank:
        rows = self.rows
        weights, _ = nonnegative(self.columns, rows.nuisance, rows.displacement, self.floors, self.rough, smoothing)
        count = self.thresholds.size * (self.knots[0].size + 1)
        slopes = weights[:count].reshape(self.thresholds.size, -1)
        return PlayBank(self.thresholds, self.knots, list(slopes), 0.0, self.times, weights[count:])


def _times(training: Training) -> Array:
    sample, longest = training.seconds
    decades = np.log10(max(longest / (2 * sample), 1.0))
    return np.geomspace(2 * sample, max(longest, 2 * sample), max(2, round(2 * decades) + 1))


def _given(lowpasses: ArrayLike) -> Array:
    try:
        times = vector(lowpasses, "lowpasses")
    except ModelError as error:
        raise IdentifyError(str(error)) from error
    if np.any(times <= 0):
        raise IdentifyError(f"lowpasses: got {times}, need time constants above 0, in seconds")
    return times

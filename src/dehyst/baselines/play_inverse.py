"""The closed-form inverse of a Prandtl-Ishlinskii operator: another one, with weights that are not all positive.

P. Krejci, K. Kuhnen, "Inverse control of systems with hysteresis and creep", IEE Proc. Control Theory Appl. 148(3),
2001, 185-192.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.baselines._native_plays import PlayCore
from dehyst.baselines.play_bank import PlayBank, PlayState


@dataclass(frozen=True, eq=False)
class PlayInverse:
    """Of ``y = offset + sum_i w_i play_i[v]``, r_0 = 0 < r_1 < ..., w_0 > 0, the others 0 or more.

    ``v = sum_i w'_i play_{r'_i}[y - offset]`` with
    ``r'_i = sum_{j<=i} w_j (r_i - r_j)``, ``w'_0 = 1 / w_0`` and ``w'_i = 1 / W_i - 1 / W_{i-1}``, W_i the sum of
    w_0 ... w_i.

    Raises
    ------
    ModelError
        If the bank has no such inverse.
    """

    bank: PlayBank
    weights: Array = field(init=False)
    _back: Array = field(init=False, repr=False)
    _core: PlayCore = field(init=False, repr=False)

    def __post_init__(self) -> None:
        r = self.bank.thresholds
        if not r.size or r[0] != 0 or np.any(np.diff(r) <= 0) or any(k.size for k in self.bank.knots):
            raise ModelError("no closed-form inverse: need plays of increasing thresholds from 0, on straight lines")
        if self.bank.times.size or self.bank.slopes[0][0] <= 0:
            raise ModelError("no closed-form inverse: need a positive weight at threshold 0 and no low-passes")
        w = np.concatenate(self.bank.slopes)
        summed = np.cumsum(w)
        thresholds = np.concatenate([[0.0], np.cumsum(summed[:-1] * np.diff(r))])
        back = np.diff(1 / summed, prepend=0.0)
        zeros, none = np.zeros(r.size), np.zeros(0)
        core = PlayCore(
            thresholds, np.arange(r.size + 1, dtype=np.intc), zeros, zeros, np.repeat(back, 2), none, none, 0.0
        )
        object.__setattr__(self, "weights", w)
        object.__setattr__(self, "_back", back)
        object.__setattr__(self, "_core", core)

    def compensate(self, y: Array, state: PlayState) -> tuple[Array, PlayState]:
        """Voltage (n,) [V] for a displacement (n,) [m], explicitly; `bank.compensate` says the same.

        From a state that no history leads to, neighbours farther apart than their thresholds, the closed form does not
        hold, and the bank walks instead.
        """
        self.bank.check(state)
        steps = np.diff(self.bank.thresholds)
        if not y.size or np.any(np.abs(np.diff(state.plays)) > steps + 1e-9 * self.bank.thresholds.max()):
            return self.bank.compensate(y, state, None)
        start = _through(self.weights, np.concatenate([[state.voltage], state.plays[1:]]))
        none = np.zeros(0)
        v, z, _ = self._core.simulate(y - self.bank.offset, none, float(start[0]), start, none)
        return v, PlayState(float(v[-1]), _through(self._back, z), none, state.time)


def _through(weights: Array, z: Array) -> Array:
    """Outputs of the other operator's plays: sum_{j<=i} w_j z_i + sum_{j>i} w_j z_j."""
    product = weights * z
    return np.asarray(np.cumsum(weights) * z + product.sum() - np.cumsum(product))

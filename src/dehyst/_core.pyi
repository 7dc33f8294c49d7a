from numpy import float64, int64
from numpy.typing import NDArray

Array = NDArray[float64]
Bounds = NDArray[int64]

class CoreError(ValueError): ...

class Core:
    def __init__(self, rho: Array, kappa: Array, knot: Array, value: Array) -> None: ...
    def compensate(self, y: Array, start: float, cart: Array, stack: bool) -> tuple[Array, float, Array]: ...
    def simulate(self, v: Array, start: float, cart: Array, stack: bool) -> tuple[Array, float, Array]: ...
    def depth(self, y: Array, start: float, cart: Array) -> int: ...
    def voltage(self, y: float, cart: Array) -> float: ...
    def spring_at(self, y: float) -> float: ...
    def spring_inverse(self, v: float) -> float: ...

class Wide:
    def __init__(
        self,
        rho: Array,
        kappa: Array,
        knot: Array,
        value: Array,
        grade_knot: Array,
        grades: Array,
        tau_voltage: Array,
        tau_drive: Array,
        stiffness: Array,
        inertia: Array,
        length: Array,
        closing: Array,
        smooth: Array,
    ) -> None: ...
    def compensate(
        self, w: Array, more: Array, bounds: Bounds, decay: Array, gain: Array, transition: Array,
        start: float, cart: Array, strain: Array, motion: Array, stack: bool,
    ) -> tuple[Array, float, Array, Array, Array]: ...  # fmt: skip
    def simulate(
        self, v: Array, load: Array, bounds: Bounds, decay: Array, gain: Array, transition: Array,
        start: float, cart: Array, strain: Array, motion: Array, stack: bool,
    ) -> tuple[Array, float, Array, Array, Array]: ...  # fmt: skip
    def voltage(self, w: float, cart: Array, strain: Array, motion: Array) -> float: ...

def stops(rho: Array, cart: Array, y: Array) -> tuple[Array, Array]: ...
def smooth_elongations(length: Array, closing: Array, y: Array) -> Array: ...
def steps(time: Array) -> tuple[Bounds, Array]: ...
def strains(
    path: Array, bounds: Bounds, decay: Array, gain: Array, before: float, strain: Array
) -> tuple[Array, Array]: ...

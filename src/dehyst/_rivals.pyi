from numpy import float64, intc
from numpy.typing import NDArray

Array = NDArray[float64]

class Plays:
    def __init__(
        self,
        r: Array,
        first: NDArray[intc],
        knot: Array,
        value: Array,
        slope: Array,
        tau: Array,
        share: Array,
        offset: float,
    ) -> None: ...
    def simulate(
        self, v: Array, dt: Array, start: float, z: Array, q: Array
    ) -> tuple[Array, int, float, Array, Array]: ...
    def compensate(
        self, y: Array, dt: Array, start: float, z: Array, q: Array
    ) -> tuple[Array, int, float, Array, Array]: ...

def play_outputs(r: Array, z: Array, v: Array) -> Array: ...

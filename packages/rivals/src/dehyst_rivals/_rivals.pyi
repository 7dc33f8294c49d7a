from numpy import float64, intc, intp
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
def preisach(
    numbers: Array, everett: Array, cells: int, turns: Array, v: float, y: float, drive: Array, inverse: bool
) -> tuple[Array, Array, float, float]: ...
def preisach_weights(low: float, step: float, cells: int, voltage: Array, samples: NDArray[intp]) -> Array: ...
def bouc_wen(numbers: Array, v: float, h: float, drive: Array, what: int) -> tuple[Array, float, float]: ...
def coleman_hodgdon(
    numbers: Array, rise: Array, fall: Array, v: float, y: float, drive: Array, inverse: bool
) -> tuple[Array, float, float]: ...
def cubic(numbers: Array, x: float, inverse: bool) -> float: ...

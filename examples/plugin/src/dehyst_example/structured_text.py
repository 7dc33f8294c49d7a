"""A target of exports: a function block in Structured Text (IEC 61131-3) for a PLC, of elements and a spring."""

from importlib.resources import files

import numpy as np

from dehyst import MaxwellSlip, ModelError
from dehyst.exports import Target, Written

BEYOND = ("transformer", "creep", "displacement_creep", "thermal", "smooth", "dynamics", "load_stiffness", "lag")


def write(compensator, path, options):
    """Write the block, which begins in the state of the compensator."""
    actuator, state, (low, high) = compensator.actuator, compensator.state, compensator.limits
    beyond = [name for name in BEYOND if getattr(actuator, name)]
    if beyond or not isinstance(actuator.slip, MaxwellSlip) or not len(actuator.slip):
        raise ModelError(f"{path}: need slip elements and a spring only; the model has {beyond or 'other elements'}")
    y, v = actuator.spring.displacement, actuator.spring.voltage
    change = 1e30 if compensator.slew_rate is None else compensator.slew_rate * compensator.period
    numbers = {"elements": len(actuator.slip), "cart": state.carts, "present": state.displacement}
    numbers |= {"stiffness": actuator.slip.stiffness, "breakaway": actuator.slip.breakaway}
    numbers |= {"knots": y.size - 1, "knot": y[:-1], "held": v[:-1], "slope": np.diff(v) / np.diff(y)}
    numbers |= {"voltage": compensator.voltage, "low": low, "high": high, "change": change}
    text = files("dehyst_example").joinpath("compensator.st.in").read_text(encoding="ascii")
    for name, value in numbers.items():
        text = text.replace(f"@{name}@", ", ".join(map(repr, np.atleast_1d(value).tolist())))
    path.write_text(text, encoding="ascii")
    return Written({"file": str(path)}, f"{path}: a function block of {len(actuator.slip)} elements")


TARGET = Target("Structured Text", write, about="A function block for a PLC (IEC 61131-3).")

"""What a true memory is worth: a path beyond the limits, the error after its voltage has left them again.

A virtual actuator, identified from the demo's record of it, is to follow a path whose top needs 130 V; 0 to 100 V are
allowed. The compensator's memory follows the voltage that is sent; for comparison the wanted voltage is only
clipped, and the memory continues as if it had been sent. Writes `saturation.json`.
"""

import json
import warnings
from pathlib import Path

import numpy as np

import dehyst
from dehyst.operations.demo import record_loops
from dehyst.virtual import PlayActuator
from dehyst.waveforms.standard import wanted_path

OUTPUT = Path(__file__).parent / "saturation.json"
LIMITS, SLEW_RATE, PERIOD = (0.0, 100.0), 2e3, 1e-3
TRUE, CLIPPED = "memory follows what is sent", "clipped only"
TURNS = (0.05, 1.0, 0.2, 0.6, 0.1, 0.5)
LEG = 500


def measure() -> dict:
    """Errors, voltages outside the limits, and the largest step of a voltage."""
    truth = PlayActuator(highest=1.3 * LIMITS[1])
    actuator = dehyst.identify(record_loops(truth)[0]).actuator
    wanted = wanted_path(truth.stroke, TURNS)
    homing = np.concatenate([np.linspace(0, truth.highest, LEG), np.linspace(truth.highest, 0, LEG)])
    homed = actuator.simulate(homing).state
    free = actuator.compensate(wanted, state=homed).voltage
    compensator = dehyst.Compensator(actuator, LIMITS, SLEW_RATE, period=PERIOD, state=homed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dehyst.ClampWarning)
        sent = {TRUE: compensator.run(wanted), CLIPPED: np.clip(free, *LIMITS)}
    left = 1 + max(int(np.flatnonzero((v <= LIMITS[0]) | (v >= LIMITS[1]))[-1]) for v in sent.values())
    result = {"allowed_V": LIMITS, "needed_V": float(free.max()), "outside": 0, "after_saturation_percent": {}}
    for name, voltage in sent.items():
        truth.play(homing)
        error = truth.play(voltage, measured=False) - wanted
        result["outside"] += int(np.count_nonzero((voltage < LIMITS[0]) | (voltage > LIMITS[1])))
        result["after_saturation_percent"][name] = float(100 * np.abs(error[left:]).max() / truth.stroke)
    steps = np.diff(np.append(dehyst.Compensator(actuator, LIMITS, state=homed).voltage, sent[TRUE]))
    return {**result, "largest_slew_rate_V_per_s": float(np.abs(steps).max() / PERIOD)}


def main() -> None:
    result = measure()
    OUTPUT.write_text(json.dumps(result, indent=1) + "\n")
    print(f"{LIMITS[1]:.1f} V allowed, {result['needed_V']:.1f} V needed; largest error after saturation:")
    for name, percent in result["after_saturation_percent"].items():
        print(f"  {name:<30}{percent:8.3f} % of the stroke")


if __name__ == "__main__":
    main()

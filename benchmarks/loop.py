"""A compensator in a loop: integral feedback, feedforward and both on a stage that creeps and resonates.

Writes `loop.json`, and `loop.svg` and the table of `docs/how_to/control.md` (by `control_page.py`). The stage is
`stage.Stage`, no instance of the model, which is identified from its records. All three use the same model and the
sample before, and keep the same margin:

feedback     v = nominal ratio times the integral of the error
feedforward  v = compensator (with preview) of the wanted displacement
both         v = compensator of the wanted displacement and the integral of the error

The integral's gain is the largest with which the loop, computed with the identified resonance and delay and the
steepest branch of the identified loop, keeps a gain margin of 6 dB, also if the resonance lies 5 % lower or higher.

    python benchmarks/loop.py [--model FILE]

With --model the identified model is read from FILE if it is there, else written to it.
"""

from __future__ import annotations

import argparse
import copy
import json
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import figures
import numpy as np
import stage
from stage import HIGHEST, PERIOD, Stage

import dehyst
from dehyst.control.loop import preview_filter
from dehyst.model import simulated

OUTPUT = Path(__file__).with_suffix(".json")
KINDS = ("feedback", "feedforward", "both")
MARGIN, ASTRAY = 2.0, 0.05
LEAD_IN, SECONDS = 0.6, 4.0
LINES, ROUNDED = 5.0, 6e-3
TONES = ((0.7, 0.20), (2.3, 0.11), (7.1, 0.07), (17.0, 0.04))
AMPLITUDES = {"small": 0.005, "large": 0.2}
FREQUENCIES = np.unique(np.round(np.concatenate([np.geomspace(1, 1000, 28), [285, 292, 300, 308, 315]]), 2))
LIMITS = (-20.0, 220.0)
TIMES, SWINGING, PUSHED = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15), 10.0, 1.8


@dataclass(frozen=True)
class Bench:
    """The stage after homing, the model, its displacement by the model, and the gains."""

    stage: Stage
    model: dehyst.Actuator
    state: dehyst.State
    taps: np.ndarray
    ahead: int
    gains: dict[str, float]

    @classmethod
    def of(cls, model: dehyst.Actuator) -> Bench:
        """Home the stage, and the model with it."""
        one, voltage = Stage(seed=1), stage.homing()
        one.play(voltage)
        state = simulated(model, voltage, PERIOD * np.arange(voltage.size)).state
        taps, ahead = preview_filter(model, PERIOD)
        return cls(one, model, state, taps, ahead, gains(model, taps))

    @property
    def start(self) -> float:
        """Displacement of the stage by the model [m]."""
        return self.model.displacement(self.state)

    def reached(self, kind: str, wanted: np.ndarray, disturbance: np.ndarray | None = None) -> np.ndarray:
        """Return the true displacement (n,) [m], with a disturbance (n,) [m] added to it."""
        shaken = np.zeros(wanted.size) if disturbance is None else disturbance
        own, ahead = copy.deepcopy(self.stage), self.ahead
        fed = np.concatenate([wanted, np.full(ahead, wanted[-1])])[ahead:]
        compensator = dehyst.Compensator(self.model, LIMITS, period=PERIOD, state=self.state, preview=True)
        if kind == "feedforward":
            return own.play(compensator.run(fed)) + shaken
        ratio, gain = HIGHEST / own.stroke, self.gains[kind]
        integral = 0.0 if kind == "both" else compensator.voltage / ratio
        y = np.empty(wanted.size)
        for k in range(wanted.size):
            v = compensator.step(fed[k] + integral) if kind == "both" else float(np.clip(ratio * integral, *LIMITS))
            y[k] = own.play(np.array([v]))[0] + shaken[k]
            integral += gain * (wanted[k] - own.measured(y[k]))
        return y


def gains(model: dehyst.Actuator, taps: np.ndarray) -> dict[str, float]:
    """Of the integral, for each sample."""
    w = 2 * np.pi * np.geomspace(0.5, 0.5 / PERIOD, 40_000)
    late = np.exp(-1j * np.outer(w * PERIOD, np.arange(taps.size)))
    ahead = late @ taps
    found = {}
    for kind, before in (("feedback", np.full(w.size, steepest(model), complex)), ("both", ahead)):
        worst = 0.0
        for shift in (1 - ASTRAY, 1.0, 1 + ASTRAY):
            loop = before * mechanics(model, w, shift) / np.expm1(1j * w * PERIOD)
            crossing = np.flatnonzero((loop.imag[1:] * loop.imag[:-1] < 0) & (loop.real[1:] < 0))
            worst = max(worst, float(np.abs(loop.real[crossing]).max()))
        found[kind] = 1 / (MARGIN * worst)
    return found


def mechanics(model: dehyst.Actuator, w: np.ndarray, shift: float) -> np.ndarray:
    """Frequency response of the identified resonance and delay, the resonance shifted."""
    own = model.dynamics.frequency * shift
    return np.exp(-1j * w * model.delay) / (1 - (w / own) ** 2 + 2j * model.dynamics.damping * w / own)


def steepest(model: dehyst.Actuator) -> float:
    """Largest slope of displacement over voltage on the identified major loop, over the nominal ratio."""
    v = HIGHEST * (0.5 - 0.5 * np.cos(np.pi * np.arange(8000) / 2000))
    y = simulated(model, v, 1e-3 * np.arange(v.size)).displacement
    rise = np.diff(v)
    # Near the turns both steps are small, and their ratio is all rounding and creep.
    moving = np.abs(rise) > 0.3 * np.abs(rise).max()
    return float((np.diff(y)[moving] / rise[moving]).max() * HIGHEST / Stage().stroke)


def smooth(u: np.ndarray) -> np.ndarray:
    u = np.clip(u, 0, 1)
    return u**3 * (10 - 15 * u + 6 * u**2)


def led_in(start: float, path: np.ndarray) -> np.ndarray:
    """From rest at `start` onto the path [m], whose lead-in is bent."""
    at = smooth(PERIOD * np.arange(path.size) / LEAD_IN)
    return start + at * (path - start)


def triangle(time: np.ndarray, stroke: float) -> np.ndarray:
    """Lines of a raster between 10 and 90 % of the stroke, turns rounded."""
    lines = np.abs(2 * ((LINES * time + 0.25) % 1) - 1) * 2 - 1
    window = np.hanning(round(ROUNDED / PERIOD) + 2)
    # Twice, so that the acceleration has no jumps either.
    for _ in range(2):
        padded = np.pad(lines, window.size // 2, mode="edge")
        lines = np.convolve(padded, window / window.sum(), mode="same")[window.size // 2 :][: time.size]
    return stroke * (0.5 + 0.4 * lines)


def tones(time: np.ndarray, stroke: float) -> np.ndarray:
    return stroke * (0.5 + sum(a * np.sin(2 * np.pi * f * time + k) for k, (f, a) in enumerate(TONES)))


def tracked(bench: Bench, path: np.ndarray) -> tuple[dict, dict]:
    """Errors of each kind in % of the stroke after the lead-in, and what the figure shows."""
    stroke, first = bench.stage.stroke, round(LEAD_IN / PERIOD)
    wanted, found, shown = led_in(bench.start, path), {}, {"wanted": path[first:] / stroke}
    for kind in KINDS:
        y = bench.reached(kind, wanted)
        error = 100 * (wanted - y)[first:] / stroke
        found[kind] = {"largest_percent": float(np.abs(error).max()), "rms_percent": float(np.sqrt(np.mean(error**2)))}
        shown[kind] = error
    return found, shown


def pushed(bench: Bench, path: np.ndarray) -> dict[str, list[dict]]:
    """Larger gains on a path, until the stage swings: its acceleration is then many times what the path asks for."""
    stroke, first, found = bench.stage.stroke, round(LEAD_IN / PERIOD), {}
    asked = float(np.std(np.diff(path[first:], 2)))
    for kind in bench.gains:
        rows = found.setdefault(kind, [])
        for times in TIMES:
            harder = replace(bench, gains={kind: times * bench.gains[kind]})
            y = harder.reached(kind, led_in(bench.start, path))[first:]
            largest = float(np.abs(path[first:] - y).max())
            swings = bool(np.std(np.diff(y, 2)) > SWINGING * asked)
            rows.append({"times": times, "largest_percent": 100 * largest / stroke, "swings": swings})
            if swings:
                break
    return found


def response(bench: Bench, kind: str, amplitude: float) -> list[tuple[float, float]]:
    """Frequency [Hz] and reached over wanted [dB] at the middle of the stroke, until it is down by 15 dB."""
    found = []
    for frequency in FREQUENCIES:
        found.append((float(frequency), gain(bench, kind, frequency, amplitude, asked=True)))
        if found[-1][1] < -15:
            break
    return found


def rejection(bench: Bench, kind: str) -> list[tuple[float, float]]:
    """Frequency [Hz] and what is left of a disturbance [dB], until nothing is taken away any more."""
    found = []
    for frequency in FREQUENCIES:
        found.append((float(frequency), gain(bench, kind, frequency, AMPLITUDES["small"], asked=False)))
        if found[-1][1] > 0 or (len(found) > 3 and kind == "feedforward"):
            break
    return found


def gain(bench: Bench, kind: str, frequency: float, amplitude: float, *, asked: bool) -> float:
    """Of a sine around half the stroke [dB], asked for or a disturbance."""
    stroke = bench.stage.stroke
    kept, settled = round(max(4 / frequency, 0.06) / PERIOD), round((LEAD_IN + 0.15) / PERIOD)
    time = PERIOD * np.arange(settled + kept)
    sine = smooth((time - LEAD_IN) / 0.05) * amplitude * stroke * np.sin(2 * np.pi * frequency * time)
    rest = led_in(bench.start, np.full(time.size, 0.5 * stroke))
    y = bench.reached(kind, rest + sine) if asked else bench.reached(kind, rest, sine)
    return float(20 * np.log10(fundamental(time[settled:], y[settled:], frequency) / (amplitude * stroke)))


def fundamental(time: np.ndarray, y: np.ndarray, frequency: float) -> float:
    """Amplitude of a sine in a displacement that also creeps [m]."""
    phase = 2 * np.pi * frequency * time
    columns = np.column_stack([np.sin(phase), np.cos(phase), np.ones(time.size), time - time.mean()])
    a, b = np.linalg.lstsq(columns, y, rcond=None)[0][:2]
    return float(np.hypot(a, b))


def bandwidth(found: list[tuple[float, float]], edge: float, *, rising: bool = False) -> float | None:
    """First frequency [Hz] at which the gain falls below, or rises above, `edge` dB; None: nowhere, 0.0: everywhere."""
    f, g = np.log(np.array(found)[:, 0]), np.array(found)[:, 1]
    beyond = np.flatnonzero(g > edge if rising else g < edge)
    if not beyond.size:
        return None
    k = int(beyond[0])
    if k == 0:
        return 0.0
    return float(np.exp(f[k - 1] + (f[k] - f[k - 1]) * (edge - g[k - 1]) / (g[k] - g[k - 1])))


def identified(path: Path | None) -> tuple[dehyst.Actuator, list[dict]]:
    if path is not None and path.exists():
        model = dehyst.Actuator.load(path)
        return model, json.loads(path.with_suffix(".errors.json").read_text())
    fit = dehyst.identify(stage.records())
    errors = [error.as_dict() for error in fit.errors]
    if path is not None:
        fit.actuator.save(path)
        path.with_suffix(".errors.json").write_text(json.dumps(errors))
    return fit.actuator, errors


def measure(model: dehyst.Actuator, errors: list[dict]) -> tuple[dict, dict]:
    """Return the figures, and the data of the drawing."""
    bench = Bench.of(model)
    time = PERIOD * np.arange(round((LEAD_IN + SECONDS) / PERIOD))
    paths = {"triangle": triangle(time, bench.stage.stroke), "tones": tones(time, bench.stage.stroke)}
    tracking, shown, responses, bands = {}, {}, {}, {}
    for name, path in paths.items():
        tracking[name], shown[name] = tracked(bench, path)
        print(name, json.dumps(tracking[name]), flush=True)
    harder = pushed(bench, paths["triangle"][: round(PUSHED / PERIOD)])
    print("larger gains", json.dumps(harder), flush=True)
    for size, amplitude in AMPLITUDES.items():
        responses[size] = {kind: response(bench, kind, amplitude) for kind in KINDS}
        bands[size] = {
            kind: {
                "down_3_dB_Hz": bandwidth(found, -3.0),
                "up_3_dB_Hz": bandwidth(found, 3.0, rising=True),
                "swept_to_Hz": found[-1][0],
            }
            for kind, found in responses[size].items()
        }
        print(size, json.dumps(bands[size]), flush=True)
    rejections = {kind: rejection(bench, kind) for kind in KINDS}
    rejecting = {kind: bandwidth(found, -3.0, rising=True) for kind, found in rejections.items()}
    print("disturbances", json.dumps(rejecting), flush=True)
    dynamics = model.dynamics
    about = {
        "resonance_Hz": dynamics.frequency / (2 * np.pi),
        "damping": dynamics.damping,
        "delay_s": model.delay,
        "steepest": steepest(model),
        "period_s": PERIOD,
        "samples_ahead": bench.ahead,
        "errors": errors,
    }
    true = {"resonance_Hz": Stage.resonance, "damping": Stage.damping, "delay_s": Stage.late * PERIOD}
    integral = {kind: {"gain_per_sample": gain, "gain_per_s": gain / PERIOD} for kind, gain in bench.gains.items()}
    found = {
        "stage": true,
        "identified": about,
        "integral": integral,
        "margin_dB": 20 * np.log10(MARGIN),
        "tracking": tracking,
        "larger_gains": harder,
        "bandwidth": bands,
        "rejecting_to_Hz": rejecting,
        "response": responses,
        "rejection": rejections,
    }
    return found, shown


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure a loop; see the top of this file.")
    parser.add_argument("--model", type=Path, help="file of the identified model")
    warnings.simplefilter("ignore", dehyst.ClampWarning)  # fast large sines ask for more than the limits
    found, shown = measure(*identified(parser.parse_args().model))
    OUTPUT.write_text(json.dumps(found, indent=1) + "\n")
    figures.draw_loop(found, shown, PERIOD)


if __name__ == "__main__":
    main()

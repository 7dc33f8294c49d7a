"""Captions of the paper's figures for a virtual actuator: what to look at, and what differs from the paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dehyst.studies.paper.error_floors import chord_error, symmetric_width_floor
from dehyst.studies.paper.experiment import (
    CYCLES,
    DRIVE,
    ELEMENTS,
    PEAKS,
    PRE_ENERGISED,
    RELAXED,
    Experiment,
    midpoints,
    true_errors,
)
from dehyst.studies.paper.tables import PAPER, physical

_SCHEMATIC = (
    "The voltage v acts as a force F = T v on a massless bar at x. Three kinds of springs hold the bar: km and ke in "
    "series, together keq = ke km/(ke + km), which meet at the displacement y; the nonlinear spring g; and N slip "
    "elements, each a spring kᵢ on a massless cart at xbᵢ, which Coulomb friction holds until the force is fᵢ. km is "
    "the mechanical stiffness, ke = T²/C that of the capacitance C. x, y and the forces count to the right. Drawn anew "
    "after the paper's text and equations."
)
_BLOCKS = (
    "(a) The physical model, Eqs. 1 and 2: the displacement x drives the slip elements, and their forces FHᵢ return "
    "to the force balance. (b) The Preisach model, its double integral as a sum: the voltage drives M relays with the "
    "switching values αᵢ, βᵢ, and their weighted sum is the displacement. The summation is a balance of forces in (a), "
    "a mathematical one in (b)."
)


def captions(found: Experiment, symmetric: Experiment) -> dict[int, str]:
    """Return one caption for each figure, by the paper's number.

    `found`, `symmetric`: with the virtual E-280.10, and with the same without its asymmetric map.
    """
    single: dict[int, Callable[[Experiment], str]] = {
        3: _typical_loop,
        5: _break_points,
        6: _initial_states,
        7: _loops,
        8: _parallel_spring,
        9: _right_extreme,
        10: _control_voltages,
        11: _trajectories,
    }
    words = {1: _SCHEMATIC, 2: _BLOCKS}
    both = {4: _antisymmetry(found, symmetric), 12: _tracking_errors(found, symmetric)}
    return words | {number: caption(found) for number, caption in single.items()} | both


def _typical_loop(found: Experiment) -> str:
    loop = found.loops[0]
    return (
        f"Voltage up to {PEAKS['major']:g} V at {DRIVE.frequency:g} Hz, from the relaxed state. Look at the residual "
        f"displacement of {1e6 * loop.bottom:.2f} µm to which 0 V leads back, and at the range of "
        f"{1e6 * loop.range:.3f} µm from there to the peak. The paper's loop is not anti-symmetric either; the "
        "readable text does not describe how it bends."
    )


def _antisymmetry(found: Experiment, symmetric: Experiment) -> str:
    off, without = (np.abs(midpoints(experiment)).max() for experiment in (found, symmetric))
    return (
        "(a) The loop and its image under a half-turn about its centre, with the break points of the descending (full) "
        "and the ascending branch (hollow). Lemma 2: without the nonlinear spring the two coincide, and the midpoint "
        f"of each pair of break points is the centre. (b) How far the midpoints are off: up to {off:.1f} V here, "
        f"{without:.2f} V without the asymmetric map, which is what noise leaves. The paper's Fig. 4 illustrates the "
        "lemma; here it is measured."
    )


def _break_points(found: Experiment) -> str:
    return (
        f"The range from y(T₀) to y(T₀/2) is divided into N = {ELEMENTS} equal parts; where a branch crosses Yᵢ its "
        "voltage is a break voltage: v↓ᵢ at Yᵢ on the descending branch, v↑ᵢ at Y₁₀₋ᵢ on the ascending one. The "
        "paper's method uses only these points of the loop. Look at the first segment after each turning point: "
        f"straight in the model, bent in the loop by up to {chord_error(found.exact, ELEMENTS):.2f} % of the range."
    )


def _initial_states(found: Experiment) -> str:
    moved = found.shift
    by_paper, by_record = (1e6 * found.trials[key].shift for key in ("breakpoints", "record_tops"))
    return (
        f"(a) The same voltage from the relaxed state, and after {PRE_ENERGISED:g} V were applied and removed; in "
        "both the sensor reads zero at t = 0. (b) The difference: from the first peak on it is the same everywhere, "
        f"{1e6 * moved.loop:.3f} µm with a standard deviation of {1e9 * moved.deviation:.1f} nm, the noise of two "
        "records. By Eq. 10 it is minus the reading at t = 0 of a sensor that is not zeroed again: "
        f"{1e6 * moved.rest:.3f} µm. From the earlier voltage alone the models predict {by_paper:.2f} µm (paper's "
        f"method) and {by_record:.2f} µm (whole record, tops added); for that they need the spring below the "
        "identified range, where it is extrapolated. The paper discharges quickly; this actuator is rate-independent, "
        "so the speed does not matter. The readable text gives no number for the paper's shift."
    )


def _loops(found: Experiment) -> str:
    paper, record, tops = (true_errors(found.trials[key]) for key in ("breakpoints", "record", "record_tops"))
    peaks = ", ".join(f"{peak:g}" for peak in PEAKS.values())
    return (
        f"Raised cosines of {peaks} V, {CYCLES} cycles each in one run; the major and the small loop were fitted, the "
        "medium one only simulated. The readable text does not give the peaks of the paper's minor loops. Below, "
        "measured minus simulated in the last cycle. Largest errors against the truth (major, medium, small): "
        f"{paper} % by the paper's method, which reports {PAPER['major']:g}, {PAPER['medium']:g} and "
        f"{PAPER['small']:g} %; {record} % by the whole record; {tops} % with descending tops in the training. In (b) "
        "the medium loop is wrong because two loops leave directions of the stiffnesses open. In (c) none is open; no "
        f"model of the class avoids {symmetric_width_floor(found.exact):.2f} % of the remaining error."
    )


def _parallel_spring(found: Experiment) -> str:
    p = physical(found, "breakpoints")
    slopes = np.diff(p.parallel) / np.diff(p.deformation)
    ratio = p.equivalent_stiffness / p.mechanical_stiffness
    needed = p.mechanical_stiffness * found.loops[0].range
    return (
        f"h rises everywhere, by {1e-3 * slopes.min():.3g} kN/m at least: Assumption I holds. With the paper's "
        f"constants g comes out strongly negative, {p.nonlinear[-1]:.1f} N at the peak: keq x = km y, over the range "
        f"alone {needed:.1f} N, but T v₀ is {p.transformer_ratio * PEAKS['major']:.1f} N (T/km = "
        f"{1e9 * p.transformer_ratio / p.mechanical_stiffness:.0f} nm/V would make 6 µm of 200 V, not 16). Only h "
        "matters. x is counted from the place where h has no force, by extrapolation, and is much larger than the "
        f"displacement: y = {ratio:.4f} x."
    )


def _right_extreme(found: Experiment) -> str:
    step = 1e6 * found.loops[0].range / ELEMENTS
    return (
        "The medium minor loop, held out, where it turns. The model's branch is straight until the first element "
        f"slips, 2δ keq/km = {step:.3f} µm below the peak, while the measured one bends at once; on the major loop the "
        f"chord is wrong by {chord_error(found.exact, 10):.2f} % of the range with 10 elements, by "
        f"{chord_error(found.exact, 40):.2f} % with 40. The paper finds the largest errors of its minor loops at this "
        "place and suspects inertia; here there is none, and at 0.01 Hz it would be 1e-10 of the force."
    )


def _control_voltages(found: Experiment) -> str:
    added = np.abs(found.trials["breakpoints"].tracking.voltage - found.nominal.voltage).max()
    return (
        "(a) Voltages sent for the same path, a raised cosine over the full range: in proportion to it, and by inverse "
        f"control. (b) What inverse control adds, up to {added:.0f} V: more voltage on the way up, less on the way "
        "down. Voltages are cut at 0 and 200 V, which happens to Goldfarb and Celanovic's."
    )


def _trajectories(found: Experiment) -> str:
    bottom = 1e6 * found.runs[RELAXED.name].true[int(DRIVE.rate / DRIVE.frequency)]
    return (
        "The path wanted, and what the actuator does with the voltages of Fig. 10: its true displacement on the "
        f"sensor's axis. With the nominal ratio it lags behind both ways. The path starts at {bottom:.2f} µm, where "
        "the major loop ends, after one cycle that makes the state known; the paper does not describe its start."
    )


def _tracking_errors(found: Experiment, symmetric: Experiment) -> str:
    of, without = (
        {key: trial.tracking.largest for key, trial in experiment.trials.items()} for experiment in (found, symmetric)
    )
    return (
        f"Reached minus wanted. (a) Nominal ratio {found.nominal.largest:.2f} % (paper {PAPER['nominal']:g} %), "
        f"Goldfarb and Celanovic {of['goldfarb']:.2f} %. (b) The paper's method {of['breakpoints']:.2f} % (paper "
        f"{PAPER['tracking']:g} %), whole record with descending tops {of['record_tops']:.2f} %. (c) The same on an "
        f"actuator that differs only in having no asymmetric map: {without['breakpoints']:.2f} and "
        f"{without['record_tops']:.2f} %. The difference between (c) and (b) is due to the model class."
    )

"""Every class in C: compiled apart it gives the same bits, stays within its arrays, and NaN moves nothing."""

import subprocess
from dataclasses import replace

import numpy as np
import plain_records
import pytest
import strategies as our

from dehyst import Dynamics
from dehyst._native import StepCoefficients
from dehyst.model import SmoothSlip, evaluator_of
from examples import at_night

SOURCES = plain_records.CORE_SOURCES

# Reads an actuator, one pace, a state and a path; prints, a line a sample, the voltages and what they lead back to: on
# the stack, then on the carts.
HARNESS = r"""
#include <stdio.h>
#include "dehyst_records.h"
#define MOST 1100
static dehyst_real rho[MOST], kappa[MOST], knot[MOST], value[MOST], slope[MOST], edge[MOST], intercept[MOST];
static dehyst_real stiffness[MOST], grade_knot[MOST], grade_value[MOST], grade_slope[MOST], volt[MOST], drive[MOST];
static dehyst_real tau_slope[MOST], tau_inverse[MOST], to[8], mass[2], motion[2];
static dehyst_real start[MOST], cart[MOST], path[MOST], out[4][MOST];
static dehyst_real length[MOST], closing[MOST], back[MOST], smooth[MOST], before[MOST], elongation[MOST];
static dehyst_real room_value[MOST], room_slope[MOST], held[MOST];
static dehyst_real smooth_work[2 * MOST + 1];
static int segment[MOST];
static dehyst_reversal reversal[DEHYST_STACK_CAPACITY(MOST)];

static int read(dehyst_real *a, int n)
{
    double number;
    int i;
    for (i = 0; i < n; i++) {
        if (scanf("%la", &number) != 1) return 0;
        a[i] = (dehyst_real)number;
    }
    return 1;
}

int main(void)
{
    dehyst_actuator a = {0};
    dehyst_transition pace;
    dehyst_state state;
    int n, m, k, l, q, inertia, samples, i, t, column;
    if (scanf("%d %d %d %d %d %d %d", &n, &m, &k, &l, &q, &inertia, &samples) != 7) return 1;
    if (!read(rho, n) || !read(kappa, n) || !read(knot, k) || !read(value, k)) return 2;
    if (m > 0 && (!read(grade_knot, m + 1) || !read(grade_slope, n * m))) return 2;
    if (!read(volt, l) || !read(drive, l)) return 2;
    if (!read(length, q) || !read(closing, q) || !read(smooth, q)) return 2;
    if (inertia && (!read(mass, 2) || !read(to, 8) || !read(motion, 2))) return 2;
    if (!read(&state.memory.y, 1) || !read(start, n) || !read(before, q)) return 2;
    if (!read(path, samples)) return 2;
    a.plain.slip.size = n, a.plain.slip.rho = rho, a.plain.slip.kappa = kappa, a.plain.slip.edge = edge;
    a.plain.slip.intercept = intercept, a.plain.slip.stiffness = stiffness;
    a.plain.spring.size = k, a.plain.spring.knot = knot, a.plain.spring.value = value, a.plain.spring.slope = slope;
    if (dehyst_curve_tabulate(k, knot, value, slope) != DEHYST_OK) return 3;
    if (dehyst_slip_tabulate(n, rho, kappa, edge, intercept, stiffness, &a.plain.slip.inverse_step) != DEHYST_OK)
        return 4;
    if (m > 0) {
        if (dehyst_grades_tabulate(n, m, grade_knot, grade_slope, grade_value) != DEHYST_OK) return 5;
        a.grades.size = m, a.grades.knot = grade_knot, a.grades.value = grade_value, a.grades.slope = grade_slope;
    }
    if (l > 0) {
        if (dehyst_curve_tabulate(l, volt, drive, tau_slope) != DEHYST_OK) return 6;
        if (dehyst_curve_tabulate(l, drive, volt, tau_inverse) != DEHYST_OK) return 6;
        a.transformer.size = l, a.transformer.knot = volt;
        a.transformer.value = drive, a.transformer.slope = tau_slope;
        a.inverse_transformer.size = l, a.inverse_transformer.knot = drive;
        a.inverse_transformer.value = volt, a.inverse_transformer.slope = tau_inverse;
    }
    if (dehyst_smooth_tabulate(q, length, closing, back) != DEHYST_OK) return 8;
    a.smooth.size = q, a.smooth.length = length, a.smooth.back = back, a.smooth.stiffness = smooth;
    a.inertia = inertia, a.series = mass[0], a.share = mass[1];
    for (i = 0; i < 4; i++) pace.phi[i] = to[i];
    for (i = 0; i < 2; i++) pace.before[i] = to[4 + i], pace.after[i] = to[6 + i];
    {
        const dehyst_real y = state.memory.y;
        for (column = 0; column < 4; column++) {
            dehyst_stack stack = {DEHYST_STACK_CAPACITY(MOST), 0, 1, 0, 0, 0};
            dehyst_workspace room = {stack, room_value, room_slope, held, segment, smooth_work};
            if (column < 2) room.stack.reversal = reversal;
            state.memory.y = y, state.memory.cart = cart, state.elongation = elongation;
            state.y = motion[0], state.rate = motion[1], state.input = 0;
            for (i = 0; i < n; i++) cart[i] = start[i];
            for (i = 0; i < q; i++) elongation[i] = before[i];
            if (dehyst_check(&a, &state) != DEHYST_OK) return 7;
            if (column % 2 == 0)
                dehyst_compensate_run(&a, &state, &room, path, NULL, out[column], samples);
            else
                dehyst_simulate_run(&a, &pace, &state, &room, out[column - 1], NULL, out[column], samples);
        }
    }
    for (t = 0; t < samples; t++)
        printf("%a %a %a %a\n", (double)out[0][t], (double)out[1][t], (double)out[2][t], (double)out[3][t]);
    return 0;
}
"""


def bench(kind, seed):
    """An actuator with the parts that the kind names, its state and pace, and a path long enough to reach the stack."""
    plain = our.make_actuator(seed, 9, 9, uniform=seed % 2 == 0)
    parts = {part: part in kind for part in ("graded", "transformer")}
    actuator = our.make_wider(plain, seed, **parts, creep=False)
    slope, stroke = actuator.spring.slopes.min(), np.ptp(actuator.spring.displacement)
    if "smooth" in kind:
        # Both closings, lengths in proportion to the stroke.
        smooth = SmoothSlip(stroke * np.array([0.03, 0.1, 0.4]), [1.0, 0.5, 0.8], slope * np.array([0.5, 0.3, 0.2]))
        actuator = replace(actuator, smooth=smooth)
    if "mass" in kind:
        actuator = replace(actuator, dynamics=Dynamics(4.8, 0.3, slope))
    model = evaluator_of(actuator)
    state = model.complete_state(our.make_state(plain, seed, "arbitrary"))
    kinds = ("break points", "decay", "jumps", "noisy ramp", "walk")
    path = np.concatenate([our.make_path(plain, state.deformation, seed, k, 200) for k in kinds])
    time = np.arange(path.size) * 0.01
    pace = model._steps(time, path.size)
    # One pace for all, as a harness has it.
    steps = StepCoefficients(np.array([0, path.size]), *(table[-1:] for table in pace[1:]))
    return model, model.core_state(state), steps, path


def numbers(model, held, pace, path):
    slip, tau, smooth, mass = model.slip, model.transformer, model.smooth, model.dynamics
    graded = hasattr(slip, "knots")
    arrays = [
        slip.breakaway,
        np.zeros(len(slip)) if graded else slip.stiffness,
        model.spring.displacement,
        model.spring.voltage,
    ]
    arrays += [slip.knots, slip.stiffness.ravel()] if graded else []
    arrays += [tau.voltage, tau.drive] if tau else []
    arrays += [smooth.length, smooth.closing, smooth.stiffness] if smooth else []
    arrays += [[mass.series, mass.share(model.spring)], pace.transition[0], held.motion] if mass else []
    arrays += [[held.w], held.carts, held.strains, path]
    sizes = [
        len(slip),
        slip.knots.size - 1 if graded else 0,
        model.spring.voltage.size,
        tau.voltage.size if tau else 0,
        len(smooth) if smooth else 0,
        int(mass is not None),
        len(path),
    ]
    return " ".join(map(str, sizes)) + "\n" + "\n".join(float(x).hex() for x in np.concatenate(arrays))


def run_apart(compiled, *bench):
    command = [str(compiled.folder / "wide")]
    done = subprocess.run(command, input=numbers(*bench), capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, f"status {done.returncode}: {done.stderr}"
    return np.array([[float.fromhex(x) for x in line.split()] for line in done.stdout.splitlines()])


def compile_apart(compiled, *options):
    (compiled.folder / "wide.c").write_text("#include <stddef.h>\n" + HARNESS)
    compiled.compile(*options, "wide.c", *SOURCES, "-o", "wide")


KINDS = [
    "plain",
    "transformer",
    "graded",
    "graded transformer",
    "smooth",
    "smooth graded transformer",
    "mass",
    "transformer mass",
    "graded mass",
    "smooth graded transformer mass",
]


@pytest.mark.parametrize(
    "options", [at_night(["-O2"]), at_night(["-O3", "-flto"]), ["-O1", "-fsanitize=address,undefined"]]
)
def test_c_compiled_apart_gives_the_same_bits(compiled, options):
    compile_apart(compiled, *options, "-fno-sanitize-recover")
    for seed, kind in enumerate(KINDS):
        model, held, pace, path = bench(kind, seed)
        got = run_apart(compiled, model, held, pace, path)
        for column, stack in ((0, True), (2, False)):
            voltage, _ = model.core.compensate(path, pace, held, stack=stack)
            back, _ = model.core.simulate(voltage, pace, held, stack=stack)
            assert np.array_equal(got[:, column], voltage), kind
            assert np.array_equal(got[:, column + 1], back), kind


@pytest.mark.parametrize("options", [["-O2", "-flto"], at_night(["-O1", "-fsanitize=address,undefined"])])
def test_the_core_works_in_single_precision(compiled, options):
    compiled.use_float()
    compile_apart(compiled, *options, "-fno-sanitize-recover", "-Wdouble-promotion")
    for seed, kind in enumerate(KINDS):
        model, held, pace, path = bench(kind, seed)
        got = run_apart(compiled, model, held, pace, path)
        sent, _ = model.core.compensate(path, pace, held)
        for column in (0, 2):
            assert np.abs(got[:, column] - sent).max() <= 1e-4 * np.ptp(sent), kind
            # With a mass the voltage of a path that jumps is not the one that makes it: the model is asked again.
            back, _ = model.core.simulate(got[:, column], pace, held)
            assert np.abs(got[:, column + 1] - back).max() <= 2e-4 * np.ptp(path), kind
            if "mass" not in kind:
                assert np.abs(got[:, column + 1] - path).max() <= 2e-4 * np.ptp(path), kind


def test_the_plain_core_stays_within_its_arrays(compiled):
    """With the first seed, pruning once left a branch that began beyond the present place, and read before a table."""
    compile_apart(compiled, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover")
    for seed, n, kind in [(624, 1, "walk"), *((s, s % 4, our.PATH_KINDS[s % 7]) for s in range(40))]:
        plain = our.make_actuator(seed, n, 2 + seed % 2, uniform=True)
        state = our.make_state(plain, seed, "reached")
        path = our.make_path(plain, state.deformation, seed, kind, 800)
        model = evaluator_of(plain)
        pace = model.step_coefficients(np.array([0, path.size]), np.zeros(1))
        assert np.isfinite(run_apart(compiled, model, model.core_state(state), pace, path)).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stack", [True, False])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_sample_that_is_not_a_number_moves_nothing(kind, stack, bad):
    model, held, pace, path = bench(kind, 3)
    voltage, _ = model.core.compensate(path[:300], pace._replace(bounds=np.array([0, 300])), held, stack=stack)
    hole = voltage.copy()
    hole[[0, 70, 71, 200]] = bad
    path = path[:300].copy()
    path[[0, 70, 71, 200]] = bad
    pace = pace._replace(bounds=np.array([0, 300]))
    sent, reached = model.core.compensate(path, pace, held, stack=stack)
    came, moved = model.core.simulate(hole, pace, held, stack=stack)
    assert np.isfinite(sent).all()
    assert np.isfinite(came).all()
    for state in (reached, moved):
        assert all(np.isfinite(part).all() for part in state)
    if "mass" not in kind:
        assert came[0] == held.w
        assert came[71] == came[70] == came[69]
        there = np.isfinite(path)
        shorter = pace._replace(bounds=np.array([0, np.count_nonzero(there)]))
        good, end = model.core.compensate(path[there], shorter, held, stack=stack)
        plain_records.assert_close(sent[there], good, 1e-12 * np.ptp(good))
        for first, second in zip(reached, end, strict=True):
            plain_records.assert_close(first, second, 1e-12 * np.ptp(path[there]))

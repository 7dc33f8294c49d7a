"""Exported folders compiled for this computer, and for an emulated Cortex-M4, whose instructions are counted."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records

from dehyst import Compensator, DisplacementCreep, Dynamics, Stage, Thermal
from dehyst.exports.firmware import code
from dehyst.exports.naming import shipped
from dehyst.model import turned

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off")
CORTEX_M4 = ("-O2", "-mcpu=cortex-m4", "-mthumb")
CORTEX_M4F = (*CORTEX_M4, "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
LIMITS = (10.0, 150.0)

# Reads what is wanted of each axis and its temperature; writes voltages, displacements, clamped samples, and on the
# emulated board the counts of its timer, which counts at 25 MHz: an instruction takes 2**6 ns of QEMU's clock.
PROGRAM = r"""
#include <stdint.h>
#include <stdio.h>
#include "played.h"
#ifdef __arm__
#define CONTROL (*(volatile uint32_t *)0xE000E010u)
#define RELOAD (*(volatile uint32_t *)0xE000E014u)
#define COUNT (*(volatile uint32_t *)0xE000E018u)
#else
static volatile uint32_t CONTROL, RELOAD, COUNT;
#endif

int main(void)
{
    static BODY body;
    FILE *given = fopen("given", "rb"), *answers = fopen("answers", "wb");
    double row[2 * AXES], answer[4 * AXES + 1];
    dehyst_real wanted[AXES], degrees[AXES], volts[AXES], moved[AXES];
    int j;
    (void)degrees;
    CONTROL = 0, RELOAD = 0xFFFFFFu, COUNT = 0, CONTROL = 5;
    if (BEGIN(&body) != DEHYST_OK) return 1;
    while (fread(row, sizeof row, 1, given) == 1) {
        uint32_t begin, end;
        for (j = 0; j < AXES; j++) wanted[j] = (dehyst_real)row[j], degrees[j] = (dehyst_real)row[AXES + j];
#ifdef TEMPERATURE
        if (TEMPERATURE(&body, degrees) != DEHYST_OK) return 2;
#endif
        COUNT = 0;
        begin = COUNT;
        STEP(&body, wanted, volts);
        end = COUNT;
        DISPLACEMENT(&body, moved);
        for (j = 0; j < AXES; j++) {
            answer[j] = volts[j], answer[AXES + j] = moved[j];
            answer[2 * AXES + 2 * j] = LOOP(&body, j).limited, answer[2 * AXES + 2 * j + 1] = LOOP(&body, j).slewed;
        }
        answer[4 * AXES] = (double)((begin - end) & 0xFFFFFFu);
        fwrite(answer, sizeof answer, 1, answers);
    }
#ifdef TEMPERATURE
    {
        const dehyst_real gain = LOOP(&body, 0).gain;
        degrees[0] += 10, degrees[AXES - 1] = 1000;
        if (TEMPERATURE(&body, degrees) != DEHYST_ERR_SIGN || LOOP(&body, 0).gain != gain) return 3;
    }
#endif
    return fclose(answers);
}
"""
# The calls of PROGRAM, of one axis and of a stage.
ONE = """
#include "piezo.h"
#define AXES 1
#define BODY piezo
#define BEGIN piezo_begin
#define LOOP(p, j) ((void)(j), (p)->loop)
#define STEP(p, wanted, volts) *(volts) = piezo_step(p, *(wanted))
#define DISPLACEMENT(p, moved) *(moved) = piezo_displacement(p)
"""
STAGE = """
#include "stage.h"
#define AXES STAGE_AXES
#define BODY stage
#define BEGIN stage_begin
#define LOOP(p, j) ((p)->loop[j])
#define STEP stage_step
#define DISPLACEMENT stage_displacement
"""
TEMPERATURES = {"piezo": "(p, degrees) piezo_temperature(p, *(degrees))", "stage": " stage_temperature"}

BOARD = {name: shipped(name) for name in ("start.S", "board.ld")}
QEMU = ["qemu-system-arm", "-M", "mps2-an386", "-nographic", "-semihosting", "-icount", "shift=6", "-kernel"]
COUNTS_AN_INSTRUCTION = 1.6


def plain(elements=10, *, slew=None, period=None):
    """A compensator of an actuator of the plain class."""
    actuator = plain_records.plant(elements, seed=4)
    return Compensator(actuator, LIMITS, slew, period=period, state=turned(actuator, 0.3 * plain_records.STROKE))


def wider(kind, *, moving=False, creeping=False):
    """A compensator of a wider actuator; `moving`: with a mass, a delay and a lag; creep begins strained."""
    made = structured_records.plant(structured_records.STRUCTURES[kind])
    period, actuator, state = 1 / structured_records.RATE, made.actuator, made.state
    if creeping:
        creep = DisplacementCreep([0.01, 0.2, 3.0], [0.01, 0.02, 0.03])
        actuator = replace(actuator, displacement_creep=creep)
        state = replace(state, displacement_creep=[1e-7, -2e-7, 3e-7])
    if moving:
        actuator = replace(actuator, dynamics=Dynamics(5, 0.1, 2e6), lag=0.01, delay=0.012)
    return Compensator(actuator, LIMITS, 5e3, period=period, state=None if moving else state, preview=moving)


def wishes(compensator, samples):
    """Displacements that jump beyond the whole reach, then less and less far, and again; of a stage (n, axes)."""
    reach = np.array(compensator.reach)
    middle, half = reach.mean(axis=-1), 0.6 * np.ptp(reach, axis=-1)
    if reach.ndim == 2:
        middle, half = compensator.stage.coupling @ middle, 2 * half
    shares = 1.0 / 2.0 ** (np.arange(samples) // 512 % 6)
    jumps = np.random.default_rng(5).uniform(-1, 1, (samples, *half.shape))
    return middle + half * (shares * jumps.T).T


def answers(compensator, wanted, degrees=None):
    """Voltage, displacement and the counts of clamped samples of each axis after each sample, by Python."""
    loop, rows = compensator._clone(), []
    for k, path in enumerate(wanted.tolist()):
        volts = loop.step(path) if degrees is None else loop.step(path, degrees[k].tolist())
        rows.append(np.hstack([volts, loop.displacement, np.ravel(loop.clamps)]))
    return np.array(rows)


def must_run(command, folder, **options):
    """The output of a command that must succeed."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=900, **options)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    return done.stdout


def _played(folder, wanted, degrees, compiler, link, run):
    """Compile PROGRAM with an export, and apart from it the core, whose objects compilers remember; run it."""
    name = "stage" if (folder / "stage.h").exists() else "piezo"
    warm = f"{name}_temperature" in (folder / f"{name}.h").read_text()
    assert warm == (degrees is not None)
    calls = (STAGE if name == "stage" else ONE) + f"#define TEMPERATURE{TEMPERATURES[name]}\n" * warm
    (folder / "played.h").write_text(calls)
    (folder / "played.c").write_text(PROGRAM)
    must_run([*compiler, "-c", "dehyst.c"], folder)
    must_run([*compiler, "played.c", f"{name}.c", "dehyst.o", *link, "-o", "played"], folder)
    wanted = np.asarray(wanted, dtype=float).reshape(len(wanted), -1)
    np.hstack([wanted, np.zeros_like(wanted) if degrees is None else degrees]).tofile(folder / "given")
    must_run(run, folder)
    return np.fromfile(folder / "answers").reshape(len(wanted), -1)


def played(folder, wanted, degrees=None, *, compiler="gcc", options=("-O2",)):
    """What `answers` returns, by C on this computer."""
    return _played(folder, wanted, degrees, [compiler, *STRICT, *options], [], ["./played"])[:, :-1]


def emulated(folder, wanted):
    """The same on an emulated Cortex-M4, doubles by software and floats by its unit; and instructions of each step."""
    for file, content in BOARD.items():
        (folder / file).write_text(content)
    link = ["start.S", "--specs=rdimon.specs", "-T", "board.ld"]
    found = _played(folder, wanted, None, ["arm-none-eabi-gcc", *STRICT, *CORTEX_M4F], link, [*QEMU, "played"])
    return found[:, :-1], found[:, -1] / COUNTS_AN_INSTRUCTION


KINDS = {
    "plain": plain,
    "slewing": lambda: plain(slew=2e4, period=1e-3),
    "graded": lambda: wider("graded, transformer"),
    "creep": lambda: wider("graded, transformer", creeping=True),
    "all": lambda: wider("all", creeping=True),
    "moving": lambda: wider("all", moving=True),
}
COUPLING = np.array([[1.0, 0.05, -0.03], [-0.06, 1.0, 0.04], [0.02, -0.045, 1.0]])


def plain_stage(**options):
    actuators = tuple(plain_records.plant(count, seed=count) for count in (6, 10, 3))
    limits = [(20.0, 180.0), (0.0, 150.0), (40.0, 200.0)]
    return Compensator(Stage(actuators, COUPLING), limits=limits, **options)


def wide_stage():
    """Smooth elements, graded elements and a transformer, and all parts together."""
    axes = [wider(kind) for kind in ("smooth", "graded, transformer", "all")]
    stage, states = Stage([axis.actuator for axis in axes], COUPLING), [axis.state for axis in axes]
    slews, period = [None, 5e3, 8e3], axes[0].period
    return Compensator(stage, limits=[LIMITS] * 3, period=period, slew_rate=slews, state=states)


def warm_stage():
    """Of each axis another effect of the temperature."""
    thermals = Thermal(-0.004, 3.3e-9, 24.7), Thermal(-0.002, 0.0, 21.0)
    plants = [plain_records.plant(count, seed=count) for count in (6, 10)]
    actuators = tuple(replace(plant, thermal=part) for plant, part in zip(plants, thermals, strict=True))
    return Compensator(Stage(actuators, COUPLING[:2, :2]), limits=[(20.0, 180.0), (0.0, 150.0)])


STAGES = {
    "plain stage": plain_stage,
    "slewing stage": lambda: plain_stage(period=1e-3, slew_rate=[2e4, None, 4e4]),
    "wide stage": wide_stage,
    "stage of one axis": lambda: Compensator(Stage((plain_records.plant(5),)), limits=[(0.0, 190.0)]),
    "warm stage": warm_stage,
}
TOOLS = {
    "gcc": "the exported C cannot be compiled",
    "make": "the exported Makefile cannot be run",
    "arm-none-eabi-gcc": "nothing can be compiled for ARM (Debian: gcc-arm-none-eabi libnewlib-arm-none-eabi)",
    "qemu-system-arm": "no Cortex-M4 can be emulated (Debian: qemu-system-arm)",
}


def need(*tools):
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed: {TOOLS[tool]}")


def written(folder, compensator, number="double", **options):
    """The C files alone."""
    folder.mkdir(exist_ok=True)
    for name, text in code(compensator, number, **options).items():
        (folder / name).write_text(text)
    return folder

"""Exported folders compiled for this computer, and for an emulated Cortex-M4, whose instructions are counted."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records

from dehyst import Compensator, DisplacementCreep, Dynamics
from dehyst.exports.firmware import code
from dehyst.exports.naming import shipped
from dehyst.model import turned

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off")
CORTEX_M4 = ("-O2", "-mcpu=cortex-m4", "-mthumb")
CORTEX_M4F = (*CORTEX_M4, "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
LIMITS = (10.0, 150.0)
SEED, MULTIPLIER, INCREMENT = 88172645463325252, 6364136223846793005, 1442695040888963407
OFFSET, PRIME, WORD = 14695981039346656037, 1099511628211, 2**64 - 1

# Both sides request the same displacements: jumps beyond the whole reach, then smaller and smaller ones, and again. A
# running digest of the answers is compared, and some answers one by one.
DRIVER = r"""
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include "piezo.h"

static void put(uint64_t bits)
{
    printf("%08lx%08lx\n", (unsigned long)(bits >> 32), (unsigned long)(bits & 0xffffffffu));
}

int main(void)
{
    static piezo p;
    uint64_t x = 88172645463325252u, digest = 14695981039346656037u;
    long t;
    if (piezo_begin(&p) != DEHYST_OK) return 1;
    for (t = 0; t < SAMPLES; t++) {
        double share, wide = 1.0 / (double)(1 << (t / 512 % 6));
        uint64_t bits = 0;
        dehyst_real v;
        x = x * 6364136223846793005u + 1442695040888963407u;
        share = (double)(x >> 11) * 0x1p-53;
        v = piezo_step(&p, (dehyst_real)(MIDDLE + HALF * (2 * share - 1) * wide));
        memcpy(&bits, &v, sizeof v);
        digest = (digest ^ bits) * 1099511628211u;
        if (t % EVERY == 0) put(bits);
    }
    put(digest);
    printf("%lu %lu\n", p.loop.limited, p.loop.slewed);
    return 0;
}
"""

BOARD = {name: shipped(name) for name in ("start.S", "board.ld")}
QEMU = ["qemu-system-arm", "-M", "mps2-an386", "-nographic", "-semihosting", "-kernel"]

# Prints the instructions of each step and its voltage [uV]. The board's timer counts at 25 MHz,
# and an instruction takes 2**6 ns of QEMU's clock: 1.6 counts.
STOPWATCH = r"""
#include <stdio.h>
#include <stdint.h>
#include <string.h>
#include "piezo.h"
#define CONTROL (*(volatile uint32_t *)0xE000E010u)
#define RELOAD (*(volatile uint32_t *)0xE000E014u)
#define COUNT (*(volatile uint32_t *)0xE000E018u)

int main(void)
{
    static piezo p;
    volatile dehyst_real sent;
    long t;
    CONTROL = 0, RELOAD = 0xFFFFFFu, COUNT = 0, CONTROL = 5;
    if (piezo_begin(&p) != DEHYST_OK) return 1;
    for (t = 0; t < (long)(sizeof WISHES / sizeof *WISHES); t++) {
        uint32_t begin, end;
        dehyst_real wish = (dehyst_real)WISHES[t];
        COUNT = 0;
        begin = COUNT;
        sent = piezo_step(&p, wish);
        end = COUNT;
        printf("%lu %ld\n", (unsigned long)((begin - end) & 0xFFFFFFu), (long)(1e6 * (double)sent));
    }
    return 0;
}
"""
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


def spread(compensator):
    """Middle and half width of the requested displacements: a tenth beyond the reach."""
    low, high = compensator.reach
    return 0.5 * (low + high), 0.55 * (high - low)


def wishes(compensator, samples):
    """The displacements that DRIVER requests."""
    shares, x = np.empty(samples), SEED
    for t in range(samples):
        x = (x * MULTIPLIER + INCREMENT) & WORD
        shares[t] = (x >> 11) * 2.0**-53
    middle, half = spread(compensator)
    return middle + half * (2 * shares - 1) * (1.0 / 2.0 ** (np.arange(samples) // 512 % 6))


def told(voltages, clamps, *, every):
    """The lines that DRIVER prints of these answers."""
    words, value = voltages.view(np.uint64), OFFSET
    for bits in words.tolist():
        value = ((value ^ bits) * PRIME) & WORD
    return [*(f"{bits:016x}" for bits in (*words[::every].tolist(), value)), f"{clamps.limited} {clamps.slewed}"]


def must_run(command, folder, **options):
    """The output of a command that must succeed."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=900, **options)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    return done.stdout


def _built(folder, name, text, *command, link=()):
    """Compile a program of an export, and apart from it the core, whose objects compilers remember."""
    (folder / f"{name}.c").write_text(text)
    must_run([*command, "-c", "dehyst.c"], folder)
    must_run([*command, f"{name}.c", "piezo.c", "dehyst.o", *link, "-o", name], folder)
    return name


def _built_for_board(folder, name, text):
    """Compile it for the emulated Cortex-M4 with its floating-point unit."""
    for file, content in BOARD.items():
        (folder / file).write_text(content)
    link = ["start.S", "--specs=rdimon.specs", "-T", "board.ld"]
    return _built(folder, name, text, "arm-none-eabi-gcc", *STRICT, *CORTEX_M4F, link=link)


def _driver(compensator, samples, every):
    middle, half = spread(compensator)
    given = {"SAMPLES": f"{samples}L", "EVERY": f"{every}L", "MIDDLE": middle.hex(), "HALF": half.hex()}
    return "".join(f"#define {name} {value}\n" for name, value in given.items()) + DRIVER


def driven(folder, compensator, samples, *, every, compiler="gcc", options=("-O2",)):
    """Lines that DRIVER prints, compiled for this computer."""
    name = _built(folder, "driver", _driver(compensator, samples, every), compiler, *STRICT, *options)
    return must_run([f"./{name}"], folder).splitlines()


def emulated(folder, compensator, samples, *, every):
    """The same on an emulated Cortex-M4: doubles by software, floats by its floating-point unit."""
    name = _built_for_board(folder, "driver", _driver(compensator, samples, every))
    return must_run([*QEMU, name], folder).splitlines()


def instructions(folder, given):
    """Instructions of each step on an emulated Cortex-M4 with its floating-point unit, and the voltages."""
    values = ",".join(float(x).hex() for x in given)
    text = STOPWATCH.replace("int main", f"static const double WISHES[] = {{{values}}};\n\nint main", 1)
    program = _built_for_board(folder, "stopwatch", text)
    rows = must_run([*QEMU[:-1], "-icount", "shift=6", "-kernel", program], folder).splitlines()
    counts, volts = zip(*(row.split() for row in rows), strict=True)
    return np.array(counts, dtype=float) / COUNTS_AN_INSTRUCTION, 1e-6 * np.array(volts, dtype=float)


KINDS = {
    "plain": plain,
    "slewing": lambda: plain(slew=2e4, period=1e-3),
    "graded": lambda: wider("graded, transformer"),
    "creep": lambda: wider("graded, transformer", creeping=True),
    "all": lambda: wider("all", creeping=True),
    "moving": lambda: wider("all", moving=True),
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


def written(folder, compensator, number="double"):
    """The C files alone."""
    folder.mkdir()
    for name, text in code(compensator, number).items():
        (folder / name).write_text(text)
    return folder


def plain_code(name):
    """The C files of a plain compensator."""
    return code(plain(), name=name)

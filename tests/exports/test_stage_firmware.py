"""The compensator of a stage as C: the bits of Python, whichever axes are clamped."""

import subprocess
from dataclasses import replace

import compiled_exports
import numpy as np
import plain_records
import pytest
import structured_records
from compiled_exports import STRICT, need

from dehyst import DisplacementCreep, ModelError, Stage, StageCompensator, Thermal, export
from dehyst.exports.firmware import code
from dehyst.exports.golden_trace import Call, golden_trace

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")

PERIOD = 1 / structured_records.RATE
COUPLING = np.array([[1.0, 0.05, -0.03], [-0.06, 1.0, 0.04], [0.02, -0.045, 1.0]])
# Steps of a program of its own, of random displacements; what it prints are the bits of its voltages.
STEPS = 20_000
DRIVER = """#include "stage.h"
#include <stdio.h>
#include <stdint.h>
#include <string.h>

int main(void)
{
    static stage body;
    uint64_t x = 18, told = 14695981039346656037u, bits;
    long t;
    int j;
    if (stage_begin(&body) != DEHYST_OK) return 1;
    for (t = 0; t < STEPS; t++) {
        dehyst_real wanted[STAGE_AXES], volts[STAGE_AXES];
        for (j = 0; j < STAGE_AXES; j++) {
            x = x * 6364136223846793005u + 1442695040888963407u;
            wanted[j] = middle[j] + half[j] * (2 * ((double)(x >> 11) * 0x1p-53) - 1);
        }
        stage_step(&body, wanted, volts);
        for (j = 0; j < STAGE_AXES; j++) {
            memcpy(&bits, &volts[j], sizeof bits);
            told = (told ^ bits) * 1099511628211u;
            told = (told ^ (uint64_t)body.clamped[j]) * 1099511628211u;
        }
    }
    printf("%016llx\\n", (unsigned long long)told);
    return 0;
}
"""
WORD = 2**64 - 1


def plain_stage(**options):
    actuators = tuple(plain_records.plant(count, seed=count) for count in (6, 10, 3))
    limits = options.pop("limits", [(20.0, 180.0), (0.0, 150.0), (40.0, 200.0)])
    return StageCompensator(Stage(actuators, COUPLING), limits=limits, **options)


def wide_stage():
    """Smooth elements, graded elements and a transformer, and all parts together."""
    kinds = ("smooth", "graded, transformer", "all")
    plants = [structured_records.plant(structured_records.STRUCTURES[kind]) for kind in kinds]
    states = [plant.state for plant in plants]
    stage = Stage(tuple(plant.actuator for plant in plants), COUPLING)
    limits = [compiled_exports.LIMITS] * 3
    return StageCompensator(stage, limits=limits, period=PERIOD, slew_rate=[None, 5e3, 8e3], states=states)


def single_axis():
    return StageCompensator(Stage((plain_records.plant(5),)), limits=[(0.0, 190.0)])


STAGES = {
    "plain": plain_stage,
    "slewing": lambda: plain_stage(period=1e-3, slew_rate=[2e4, None, 4e4]),
    "wide": wide_stage,
    "one axis": single_axis,
}


@pytest.fixture(params=STAGES)
def compensator(request):
    return STAGES[request.param]()


def make(folder, *targets):
    done = subprocess.run(["make", "-s", *targets], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_the_golden_trace_is_replayed_bit_for_bit(compensator, tmp_path):
    need("gcc", "make", "arm-none-eabi-gcc", "qemu-system-arm")
    export(compensator, tmp_path / "c")
    status, words = make(tmp_path / "c", "check", "symbols", "worst")
    assert status == 0, words
    assert " instructions\n" in words
    assert "double: 0 of" in words
    assert "no symbol is needed from outside" in words


def test_the_golden_trace_clamps_no_axis_some_and_all(compensator):
    rows = [row for row in golden_trace(compensator).rows if row.what is Call.STEP]
    loop, patterns = compensator._clone(), set()
    for row in rows:
        loop.step(row.given)
        patterns.add(loop.clamped)
    assert len(patterns) >= 2 ** len(loop.clamped)
    assert set(Call) == {row.what for row in golden_trace(compensator).rows}


def told_by_python(compensator, middle, half):
    """What DRIVER prints."""
    loop, x, told = compensator._clone(), 18, 14695981039346656037
    for _ in range(STEPS):
        wanted = []
        for m, h in zip(middle, half, strict=True):
            x = (x * 6364136223846793005 + 1442695040888963407) & WORD
            wanted.append(m + h * (2 * ((x >> 11) * 2.0**-53) - 1))
        volts = np.array(loop.step(wanted)).view(np.uint64).tolist()
        for bits, clamped in zip(volts, loop.clamped, strict=True):
            told = ((told ^ bits) * 1099511628211) & WORD
            told = ((told ^ int(clamped)) * 1099511628211) & WORD
    return f"{told:016x}"


def test_random_steps_have_the_same_bits(compensator, tmp_path):
    need("gcc")
    reach = np.array([axis.reach for axis in compensator.compensators])
    middle = (compensator.stage.coupling @ reach.mean(axis=1)).tolist()
    half = np.ptp(reach, axis=1).tolist()
    constants = "".join(
        f"static const double {name}[] = {{{', '.join(value.hex() for value in values)}}};\n"
        for name, values in (("middle", middle), ("half", half))
    )
    for name, text in code(compensator).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "driver.c").write_text(DRIVER.replace("int main", f"{constants}\nint main"))
    command = ["gcc", *STRICT, "-O2", f"-DSTEPS={STEPS}L", "driver.c", "stage.c", "dehyst.c", "-o", "driver"]
    compiled_exports.must_run(command, tmp_path)
    assert compiled_exports.must_run(["./driver"], tmp_path).strip() == told_by_python(compensator, middle, half)


def test_a_stage_and_an_actuator_fit_into_one_firmware(tmp_path):
    need("gcc")
    files = code(plain_stage(), name="scanner") | compiled_exports.plain_code("focus")
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "both.c").write_text(
        '#include "scanner.h"\n#include "focus.h"\nint main(void)\n{\n'
        "    static scanner s;\n    static focus f;\n    return scanner_begin(&s) || focus_begin(&f);\n}\n"
    )
    sources = sorted(name for name in (*files, "both.c") if name.endswith(".c"))
    compiled_exports.must_run(["gcc", *STRICT, *sources, "-o", "both"], tmp_path)
    compiled_exports.must_run(["./both"], tmp_path)


@pytest.mark.parametrize("axes", ["1 2 3", "do int x.y", "x X z", "int step loop", "x x_step z"])
def test_axes_of_any_names_compile(axes, tmp_path):
    need("gcc", "make")
    stage = Stage(plain_stage().stage.actuators, COUPLING, tuple(axes.split()))
    export(StageCompensator(stage, limits=[(0.0, 200.0)] * 3), tmp_path / "c", name="table")
    assert make(tmp_path / "c", "check")[0] == 0


def test_creep_in_displacement_is_refused():
    creep = DisplacementCreep([1.0], [0.05])
    actuators = [replace(actuator, displacement_creep=creep) for actuator in plain_stage().stage.actuators]
    stage = Stage(actuators, COUPLING)
    with pytest.raises(ModelError, match="creep in displacement"):
        code(StageCompensator(stage, limits=[(10.0, 150.0)] * 3, period=PERIOD))


WARMING = r"""#include "stage.h"
#include <stdio.h>

int main(void)
{
    static stage body;
    double wanted[2], degrees[2], volts[2], moved[2], hot[2] = {30.0, 1000.0};
    if (stage_begin(&body) != DEHYST_OK) return 1;
    while (scanf("%lf %lf %lf %lf", wanted, wanted + 1, degrees, degrees + 1) == 4) {
        if (stage_temperature(&body, degrees) != DEHYST_OK) return 2;
        stage_step(&body, wanted, volts);
        stage_displacement(&body, moved);
        printf("%a %a %a %a\n", volts[0], volts[1], moved[0], moved[1]);
    }
    if (stage_temperature(&body, hot) != DEHYST_ERR_SIGN) return 3;
    return body.loop[0].gain == 1 - 0.004 * (degrees[0] - 24.7) ? 0 : 4;
}
"""


def test_temperatures_give_the_bits_of_python(tmp_path):
    need("gcc")
    plants = [plain_records.plant(count, seed=count) for count in (6, 10)]
    thermals = Thermal(-0.004, 3.3e-9, 24.7), Thermal(-0.002, 0.0, 21.0)
    stage = Stage(tuple(plants), COUPLING[:2, :2])
    warm = tuple(replace(plant, thermal=part) for plant, part in zip(plants, thermals, strict=True))
    loop = StageCompensator(replace(stage, actuators=warm), limits=[(20.0, 180.0), (0.0, 150.0)])
    cold = export(StageCompensator(stage, limits=loop.limits), tmp_path / "cold")
    assert "stage_temperature" not in (cold / "stage.h").read_text()
    folder = export(loop, tmp_path / "c")
    (folder / "warming.c").write_text(WARMING)
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Werror", "-pedantic"]
    subprocess.run(["gcc", *flags, "warming.c", "stage.c", "dehyst.c", "-o", "warming"], cwd=folder, check=True)
    rng, reach = np.random.default_rng(5), np.array([compensator.reach for compensator in loop.compensators])
    # Wide enough that each axis and both are clamped.
    rows = np.column_stack([rng.uniform(*(reach.T * 1.1), (2000, 2)), rng.uniform(10, 60, (2000, 2))]).tolist()
    given = "".join(f"{' '.join(map(repr, row))}\n" for row in rows)
    done = subprocess.run([folder / "warming"], input=given, capture_output=True, text=True, check=True)
    clamped = set()
    for line, row in zip(done.stdout.splitlines(), rows, strict=True):
        expected = [*loop.step(row[:2], row[2:]).tolist(), *loop.displacement.tolist()]
        assert [float.fromhex(word) for word in line.split()] == expected
        clamped.add(loop.clamped)
    assert len(clamped) == 4

"""The compensator of a stage as C: the bits of Python, whichever axes are clamped."""

import subprocess
from dataclasses import replace

import compiled_exports
import numpy as np
import plain_records
import pytest
import structured_records
from compiled_exports import STRICT, need

from dehyst import Compensator, DisplacementCreep, ModelError, Stage, Thermal, export
from dehyst.exports.firmware import code
from dehyst.exports.golden_trace import Call, golden_trace
from examples import NIGHTLY, at_night

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")

PERIOD = 1 / structured_records.RATE
COUPLING = np.array([[1.0, 0.05, -0.03], [-0.06, 1.0, 0.04], [0.02, -0.045, 1.0]])
STEPS = 4000
# Reads what is wanted of each axis, and with WARM its temperature; prints voltage, displacement and clamped samples.
PROGRAM = r"""#include "stage.h"
#include <stdio.h>

static int read(double *numbers)
{
    int j;
    for (j = 0; j < STAGE_AXES; j++)
        if (scanf("%lf", numbers + j) != 1) return 0;
    return 1;
}

int main(void)
{
    static stage body;
    double wanted[STAGE_AXES], degrees[STAGE_AXES], volts[STAGE_AXES], moved[STAGE_AXES];
    int j;
    if (stage_begin(&body) != DEHYST_OK) return 1;
    while (read(wanted) && read(degrees)) {
#ifdef WARM
        if (stage_temperature(&body, degrees) != DEHYST_OK) return 2;
#endif
        stage_step(&body, wanted, volts);
        stage_displacement(&body, moved);
        for (j = 0; j < STAGE_AXES; j++) {
            printf("%a %a %lu ", volts[j], moved[j], body.loop[j].limited + body.loop[j].slewed);
        }
    }
#ifdef WARM
    {
        const double gain = body.loop[0].gain;
        degrees[STAGE_AXES - 1] = 1000;
        if (stage_temperature(&body, degrees) != DEHYST_ERR_SIGN || body.loop[0].gain != gain) return 3;
    }
#endif
    return 0;
}
"""


def plain_stage(**options):
    actuators = tuple(plain_records.plant(count, seed=count) for count in (6, 10, 3))
    limits = options.pop("limits", [(20.0, 180.0), (0.0, 150.0), (40.0, 200.0)])
    return Compensator(Stage(actuators, COUPLING), limits=limits, **options)


def wide_stage():
    """Smooth elements, graded elements and a transformer, and all parts together."""
    kinds = ("smooth", "graded, transformer", "all")
    plants = [structured_records.plant(structured_records.STRUCTURES[kind]) for kind in kinds]
    states = [plant.state for plant in plants]
    stage = Stage(tuple(plant.actuator for plant in plants), COUPLING)
    limits = [compiled_exports.LIMITS] * 3
    return Compensator(stage, limits=limits, period=PERIOD, slew_rate=[None, 5e3, 8e3], state=states)


def warm_stage():
    """Of each axis another effect of the temperature."""
    thermals = Thermal(-0.004, 3.3e-9, 24.7), Thermal(-0.002, 0.0, 21.0)
    plants = [plain_records.plant(count, seed=count) for count in (6, 10)]
    actuators = tuple(replace(plant, thermal=part) for plant, part in zip(plants, thermals, strict=True))
    return Compensator(Stage(actuators, COUPLING[:2, :2]), limits=[(20.0, 180.0), (0.0, 150.0)])


def single_axis():
    return Compensator(Stage((plain_records.plant(5),)), limits=[(0.0, 190.0)])


STAGES = {
    "plain": plain_stage,
    "slewing": lambda: plain_stage(period=1e-3, slew_rate=[2e4, None, 4e4]),
    "wide": wide_stage,
    "one axis": single_axis,
    "warm": warm_stage,
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
    # At night the steps of the largest model are counted on an emulated processor, too.
    counted = ["worst"] * (NIGHTLY and compensator.period == PERIOD)
    status, words = make(tmp_path / "c", "check", "symbols", *counted)
    assert status == 0, words
    assert (" instructions\n" in words) == bool(counted)
    assert "double: 0 of" in words
    assert "no symbol is needed from outside" in words


def test_the_golden_trace_clamps_none_some_and_all_of_the_axes(compensator):
    rows = [row for row in golden_trace(compensator).rows if row.what is Call.STEP]
    loop, patterns = compensator._clone(), set()
    for row in rows:
        before = np.sum(np.atleast_2d(loop.clamps), axis=1)
        loop.step(row.given)
        patterns.add(tuple(np.sum(np.atleast_2d(loop.clamps), axis=1) > before))
    assert len(patterns) >= 2 ** len(loop.stage.axes)
    assert set(Call) == {row.what for row in golden_trace(compensator).rows}


def test_random_steps_have_the_same_bits(compensator, tmp_path):
    need("gcc")
    warm = any(actuator.thermal for actuator in compensator.stage.actuators)
    for name, text in code(compensator).items():
        (tmp_path / name).write_text(text)
    assert ("stage_temperature" in (tmp_path / "stage.h").read_text()) == warm
    (tmp_path / "run.c").write_text(PROGRAM)
    command = ["gcc", *STRICT, "-O2", *["-DWARM"] * warm, "run.c", "stage.c", "dehyst.c", "-o", "run"]
    compiled_exports.must_run(command, tmp_path)
    # Wide enough that each axis and all are clamped.
    reach, rng = np.array(compensator.reach), np.random.default_rng(5)
    middle, half = compensator.stage.coupling @ reach.mean(axis=1), np.ptp(reach, axis=1)
    wanted = (middle + half * rng.uniform(-1, 1, (STEPS, half.size))).tolist()
    degrees = rng.uniform(10, 60, (STEPS, half.size)).tolist()
    given = "\n".join(" ".join(map(repr, [*path, *celsius])) for path, celsius in zip(wanted, degrees, strict=True))
    words = compiled_exports.must_run(["./run"], tmp_path, input=given).split()
    loop, expected = compensator._clone(), []
    for path, celsius in zip(wanted, degrees, strict=True):
        volts = loop.step(path, celsius) if warm else loop.step(path)
        counts = [sum(each) for each in np.atleast_2d(loop.clamps).tolist()]
        expected += [number for row in zip(volts, loop.displacement, counts, strict=True) for number in row]
    got = [float(word) if k % 3 == 2 else float.fromhex(word) for k, word in enumerate(words)]
    assert got == expected
    assert all(sum(each) for each in np.atleast_2d(loop.clamps).tolist())


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


@pytest.mark.parametrize("axes", ["do 2 x.y", "x X x_step", *map(at_night, ["int step loop", "1 2 3"])])
def test_axes_of_any_names_compile(axes, tmp_path):
    need("gcc", "make")
    stage = Stage(plain_stage().stage.actuators, COUPLING, tuple(axes.split()))
    export(Compensator(stage, limits=[(0.0, 200.0)] * 3), tmp_path / "c", name="table")
    assert make(tmp_path / "c", "check")[0] == 0


def test_creep_in_displacement_is_refused():
    creep = DisplacementCreep([1.0], [0.05])
    actuators = [replace(actuator, displacement_creep=creep) for actuator in plain_stage().stage.actuators]
    stage = Stage(actuators, COUPLING)
    with pytest.raises(ModelError, match="creep in displacement"):
        code(Compensator(stage, limits=[(10.0, 150.0)] * 3, period=PERIOD))

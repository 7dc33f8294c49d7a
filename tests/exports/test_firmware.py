"""A compensator of an actuator or a stage as C: the bits of Python here and on a Cortex-M4, within stated bytes."""

import errno
import os
import re
import shlex
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from itertools import product, starmap

import compiled_exports
import numpy as np
import places
import plain_records
import pytest
from compiled_exports import CORTEX_M4, CORTEX_M4F, COUPLING, KINDS, STAGES, STRICT, need, written

import dehyst
from dehyst import Actuator, Compensator, FileFormatError, MaxwellSlip, ModelError, Spring, Stage
from dehyst.exports import export
from dehyst.exports.firmware import CONFIG, CORE, SOURCES, code
from dehyst.exports.golden_trace import Call, golden_trace
from dehyst.exports.model_header import ExportedStart
from dehyst.model import turned
from examples import NIGHTLY, at_night, spanning

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")

LOW, HIGH = compiled_exports.LIMITS


def make(folder, *arguments):
    done = subprocess.run(["make", "-s", *arguments], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@cache
def pythons(kind, samples):
    """Wishes, temperatures, and the answers of Python."""
    loop = BOTH[kind]()
    wanted, degrees = compiled_exports.wishes(loop, samples), None
    if kind == "warm stage":
        degrees = np.random.default_rng(6).uniform(10, 60, wanted.shape)
    return wanted, degrees, compiled_exports.answers(loop, wanted, degrees)


BOTH = KINDS | STAGES
OPTIMISED = ["-O0"], ["-O2"], ["-O3"], ["-Os", "-flto"]
# Wishes grow narrower over 3072 samples, and begin again.
ON_THE_BOARD = [*product(("plain", "all", "moving"), [4000]), *starmap(at_night, [("plain", 10**6), ("all", 10_000)])]


@pytest.mark.parametrize(
    ("kind", "compiler"),
    [*spanning(("plain", "slewing", "all", "moving"), ("gcc", "clang")), *((kind, "gcc") for kind in STAGES)],
)
@pytest.mark.parametrize("samples", [4000, at_night(10**5)])
def test_random_samples_have_the_bits_of_python(tmp_path, kind, samples, compiler):
    if compiler == "clang" and shutil.which("clang") is None:
        pytest.skip("clang is not installed")
    need("gcc")
    wanted, degrees, expected = pythons(kind, samples)
    clamped = expected[-1, expected.shape[1] // 2 :].reshape(-1, 2).sum(axis=1)
    assert np.all((0.005 * samples < clamped) & (clamped < 0.999 * samples))
    folder = written(tmp_path / "c", BOTH[kind]())
    for options in OPTIMISED if NIGHTLY else OPTIMISED[:3:2] if kind == "plain" else OPTIMISED[2:3]:
        got = compiled_exports.played(folder, wanted, degrees, compiler=compiler, options=options)
        assert got.tobytes() == expected.tobytes(), options


@pytest.mark.parametrize(("kind", "samples"), ON_THE_BOARD)
def test_an_emulated_cortex_m4_has_the_bits_of_python(tmp_path, kind, samples):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    wanted, _, expected = pythons(kind, samples)
    got, _ = compiled_exports.emulated(written(tmp_path / "c", KINDS[kind]()), wanted)
    assert got.tobytes() == expected.tobytes()


@pytest.mark.parametrize(("kind", "samples"), ON_THE_BOARD)
def test_floats_on_a_cortex_m4_are_those_of_this_computer(tmp_path, kind, samples):
    need("gcc", "arm-none-eabi-gcc", "qemu-system-arm")
    wanted, _, expected = pythons(kind, samples)
    folder = written(tmp_path / "c", KINDS[kind](), "float")
    here = compiled_exports.played(folder, wanted)
    assert compiled_exports.emulated(folder, wanted)[0].tobytes() == here.tobytes()
    assert np.any(here != expected)


# At night the steps of the largest model are counted on an emulated processor, too.
REPLAYED = [*spanning([*KINDS], ["double", "float"]), *((kind, "double") for kind in STAGES)]


@pytest.mark.parametrize(("kind", "number"), REPLAYED)
def test_an_export_replays_the_trace_of_python(tmp_path, kind, number):
    need("gcc", "make")
    counted = ["worst"] * (NIGHTLY and kind == "wide stage")
    status, printed = make(export(BOTH[kind](), tmp_path / "c", number), "check", "symbols", *counted)
    assert status == 0, printed
    assert (" instructions\n" in printed) == bool(counted)
    assert "no symbol is needed from outside" in printed
    assert ("double: 0 of" if number == "double" else "float: largest error") in printed


def test_the_check_finds_a_wrong_number_and_a_wrong_number_type(tmp_path):
    need("gcc", "make")
    compensator = compiled_exports.plain()
    double = export(compensator, tmp_path / "double")
    numbers = double / "piezo.c"
    text = numbers.read_text()
    first = re.search(r"piezo_kappa\[10\] = \{\n    (0x[^,]+),", text)
    numbers.write_text(text.replace(first[1], (float.fromhex(first[1]) * (1 + 2**-52)).hex()))
    status, said = make(double, "check")
    assert status != 0
    assert re.search(r"double: \d\d+ of", said)
    # A number type that was not rewritten: the numbers are floats', the arithmetic double's; a float's error is missed.
    single = export(compensator, tmp_path / "float", "float")
    (single / CONFIG).write_text(code(compensator)[CONFIG])
    assert make(single, "check")[0] != 0
    text = (single / "trace.h").read_text()
    (single / CONFIG).write_text(code(compensator, "float")[CONFIG])
    for bound, worse in (("MOST", "1e-9"), ("LEAST", "1e-3")):
        (single / "trace.h").write_text(re.sub(rf"TRACE_{bound} \S+", f"TRACE_{bound} {worse}", text))
        assert make(single, "check")[0] != 0, bound


def test_the_trace_has_every_kind_of_call():
    trace = golden_trace(compiled_exports.plain(slew=2e4, period=1e-3))
    assert {row.what for row in trace.rows} == set(Call)
    assert trace.clamps[0].limited > 5
    assert trace.clamps[0].slewed > 5
    assert trace.refused > 3
    offers = [i for i, row in enumerate(trace.rows) if row.what is Call.OFFER]
    assert any(trace.rows[i + 1].what in (Call.STEP, Call.OFFER) for i in offers), "an offer that was not taken"
    steps = [row for row in trace.rows if row.what is Call.STEP]
    assert any(LOW < row.answer[0] < HIGH for row in steps)
    assert any(row.answer[0] in (LOW, HIGH) for row in steps)


@pytest.mark.parametrize("kind", STAGES)
def test_the_trace_clamps_none_some_and_all_of_the_axes(kind):
    loop, patterns = STAGES[kind](), set()
    rows = golden_trace(loop).rows
    assert set(Call) == {row.what for row in rows}
    for row in rows:
        if row.what is Call.STEP:
            before = np.sum(np.atleast_2d(loop.clamps), axis=1)
            loop.step(row.given)
            patterns.add(tuple(np.sum(np.atleast_2d(loop.clamps), axis=1) > before))
    assert len(patterns) >= 2 ** len(loop.stage.axes)


@pytest.mark.parametrize("kind", KINDS)
def test_the_trace_simulates_the_actuator(kind):
    compensator = KINDS[kind]()
    rows = [row for row in golden_trace(compensator).rows if row.what is Call.SIMULATE]
    actuator, state = compensator.actuator, compensator.state
    voltages = np.array([actuator.voltage(state), *(row.given[0] for row in rows)])
    time = np.arange(voltages.size) * (compensator.period or 1.0)
    motion = actuator.simulate(voltages, time=time, state=state)
    got = np.array([row.answer[0] for row in rows])
    np.testing.assert_allclose(got, motion.displacement[1:], rtol=0, atol=1e-12 * plain_records.STROKE)


def test_an_export_has_the_text_of_the_core_and_one_line_for_the_number_type():
    compensator = compiled_exports.plain()
    double, single = code(compensator), code(compensator, "float")
    assert set(double) == set(single) == {"piezo.c", "piezo.h", *CORE, CONFIG}
    core = {path.name: path.read_text() for path in places.CORE_FILES}
    assert all(double[name] == core[name] for name in ("dehyst.h", "dehyst_model.h", CONFIG))
    rest = double["dehyst.c"]
    for name in ("internal.h", "slip.c", "graded.c", "smooth.c", "step.c", "compensator.c", "block.c"):
        text = core[name].replace('#include "internal.h"\n\n', "")
        assert rest.count(text) == 1, name
        rest = rest.replace(text, "")
    assert re.sub(r"/\*.*?\*/|\s", "", rest) == ""
    assert all(single[name] == double[name] for name in CORE)
    assert single[CONFIG] == double[CONFIG].replace("REAL double", "REAL float") != double[CONFIG]
    # Only piezo.c has the numbers.
    assert [name for name, text in double.items() if "piezo_rho" in text] == ["piezo.c"]
    for unused in ("piezo_edge", "piezo_intercept"):
        assert unused not in double["piezo.c"]


def test_floats_on_a_microcontroller_need_no_double_and_no_library(tmp_path):
    need("arm-none-eabi-gcc")
    folder = written(tmp_path / "c", KINDS["moving"](), "float")
    strict = [*STRICT, "-ffreestanding", "-Wdouble-promotion", "-Wfloat-conversion", "-Wshadow", "-Wvla"]
    for flags in (CORTEX_M4, CORTEX_M4F):
        compiled_exports.must_run(["arm-none-eabi-gcc", *strict, *flags, "-c", *SOURCES], folder)
        objects = [f"{source[:-2]}.o" for source in SOURCES]
        compiled_exports.must_run(["arm-none-eabi-gcc", "-nostdlib", "-r", *objects, "-o", "all.o"], folder)
        needed = set(re.findall(r"U (\S+)", compiled_exports.must_run(["arm-none-eabi-nm", "-u", "all.o"], folder)))
        assert all(name.startswith("__aeabi_") and not name.startswith("__aeabi_d") for name in needed), needed
        assert flags is CORTEX_M4 or not needed


@pytest.mark.parametrize("flag", ["-Ofast", "-ffast-math", "-ffinite-math-only"])
def test_compiler_flags_that_break_the_check_for_nan_are_refused(tmp_path, flag):
    need("gcc")
    folder = written(tmp_path / "c", compiled_exports.plain())
    command = ["gcc", *STRICT, "-O2", "-c", "dehyst.c"]
    compiled_exports.must_run(command, folder)
    done = subprocess.run([*command, flag], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "a NaN is not refused" in done.stderr


def test_a_failed_export_leaves_no_file(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("dehyst.exports.firmware._readme", fail)
    with pytest.raises(FileFormatError):
        export(compiled_exports.plain(), tmp_path / "c")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("given", [None, 3, "model.json"])
def test_other_objects_than_a_compensator_and_a_path_are_refused(tmp_path, given):
    for write in (export, lambda number, _: code(number)):
        with pytest.raises(ModelError, match="Compensator"):
            write(given, tmp_path / "c")
    for path in (None, 3, b"c", "a\0b"):
        with pytest.raises(FileFormatError, match="name of a file"):
            export(compiled_exports.plain(), path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name",
    [
        "",
        "a" * 41,
        3,
        *["7x", "a-b", "ü", "_x", "dehyst_x", "Dehyst", "double", "class", "loop", "trace", "stdio", "Check", "main"],
    ],
)
def test_names_with_a_meaning_in_c_are_refused(tmp_path, name):
    with pytest.raises(ModelError, match=r"^name: got "):
        export(compiled_exports.plain(), tmp_path / "c", name=name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["x", "Stage_2" + "a" * 33])
def test_an_export_with_another_name_compiles(tmp_path, name):
    need("gcc")
    folder = export(compiled_exports.plain(), tmp_path / "c", name=name)
    sources = [name + ".c" if source == "piezo.c" else source for source in SOURCES]
    example = re.search(r"^    (#include.*?^)    }\n\n", (folder / "README.md").read_text(), re.MULTILINE | re.DOTALL)[
        1
    ]
    bench_words = (
        "void start_timer(void), dac_write(double);\ndouble next_displacement(void);\nvoid timer_interrupt(void);\n"
    )
    (folder / "example.c").write_text(f"{bench_words}{example}}}\n")
    compiled_exports.must_run(["gcc", *STRICT, "-c", "example.c", "check.c", *sources], folder)
    assert (folder / f"{name}.o").exists()
    compiled_exports.must_run(["g++", "-Wall", "-Werror", "-fsyntax-only", "-x", "c++", f"{name}.h"], folder)


def test_a_stage_and_an_actuator_fit_into_one_firmware(tmp_path):
    need("gcc")
    compiled_exports.written(tmp_path, compiled_exports.plain_stage(), name="scanner")
    compiled_exports.written(tmp_path, compiled_exports.plain(), name="focus")
    (tmp_path / "both.c").write_text(
        '#include "scanner.h"\n#include "focus.h"\nint main(void)\n{\n'
        "    static scanner s;\n    static focus f;\n    return scanner_begin(&s) || focus_begin(&f);\n}\n"
    )
    compiled_exports.must_run(
        ["gcc", *STRICT, *sorted(path.name for path in tmp_path.glob("*.c")), "-o", "both"], tmp_path
    )
    compiled_exports.must_run(["./both"], tmp_path)


@pytest.mark.parametrize("axes", ["do 2 x.y", "x X x_step", *map(at_night, ["int step loop", "1 2 3"])])
def test_axes_of_any_names_compile(axes, tmp_path):
    need("gcc", "make")
    stage = Stage(compiled_exports.plain_stage().stage.actuators, compiled_exports.COUPLING, tuple(axes.split()))
    export(Compensator(stage, limits=[(0.0, 200.0)] * 3), tmp_path / "c", name="table")
    assert make(tmp_path / "c", "check")[0] == 0


def narrow(rho, knots):
    """A plain actuator whose numbers are nearly alike."""
    rho, knots = np.asarray(rho), np.asarray(knots)
    return Compensator(Actuator(MaxwellSlip(rho, np.full(rho.size, 1e6)), Spring(knots, 1e7 * knots)), (0, 100))


def creeping(**options):
    slow = dehyst.DisplacementCreep([1e-2, 1e6], [0.01, 0.01])
    return Compensator(replace(plain_records.plant(3), displacement_creep=slow), (0, 100), **options)


@pytest.mark.parametrize(
    "compensator",
    [
        narrow([1e-6, 1e-6 * (1 + 1e-9)], [0, 1e-5]),
        narrow([1e-6], [0, 1e-5, 1e-5 * (1 + 1e-9)]),
        narrow([1e-50, 1e-6], [0, 1e-5]),
        Compensator(Actuator(MaxwellSlip([1e-6], [1e6]), Spring([0, 1e-20], [0, 1e25])), (0, 1)),
        creeping(period=1e-3),
        Compensator(plain_records.plant(3), (100, 100 + 1e-9)),
    ],
)
def test_models_that_cannot_be_rounded_to_floats_are_refused(compensator):
    assert "piezo_rho" in code(compensator)["piezo.c"]
    with pytest.raises(ModelError):
        code(compensator, "float")


@pytest.mark.parametrize(
    ("given", "number"),
    [
        (creeping(), "double"),
        (creeping(period=1e-3), "half"),
        (Compensator(Stage([creeping().actuator] * 2, COUPLING[:2, :2]), limits=[(0, 100)] * 2, period=1.0), "double"),
    ],
)
def test_creep_without_a_period_or_in_a_stage_and_unknown_number_types_are_refused(given, number):
    with pytest.raises(ModelError):
        code(given, number)


@pytest.mark.parametrize("limits", [(0.1, 100.1), (-0.1, 150.3), (-20.7, 99.9)])
def test_floats_stay_within_the_limits(limits):
    compensator = Compensator(plain_records.plant(3), limits, 1234.567, period=1e-3)
    files = code(compensator, "float")
    found = [float(np.float32(number)) for number in re.findall(r"(?:LOW|HIGH) (\S+)f", files["piezo.h"])]
    steps = [float(abs(np.spacing(np.float32(limit)))) for limit in limits]
    assert limits[0] <= found[0] < limits[0] + steps[0]
    assert limits[1] - steps[1] < found[1] <= limits[1]
    low, high, change = re.findall(r"^ (\S+)f, (\S+)f, (\S+)f,$", files["piezo.c"], re.MULTILINE)[0]
    assert [float.fromhex(low), float.fromhex(high)] == found
    assert 1.234567 - 1e-6 < float.fromhex(change) <= 1234.567 * 1e-3


@pytest.mark.parametrize(("kind", "number"), [("moving", "float"), at_night("slewing", "double")])
def test_sanitizers_find_no_fault(tmp_path, kind, number):
    need("gcc")
    folder = export(KINDS[kind](), tmp_path / "c", number)
    watched = ["-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    compiled_exports.must_run(["gcc", *STRICT, *watched, "check.c", *SOURCES, "-o", "check"], folder)
    said = compiled_exports.must_run(["./check"], folder)
    assert re.match(r"double: 0 of \d+ answers differ" if number == "double" else r"float: ", said), said


@pytest.mark.parametrize(("standard", "number"), spanning(["c++98", "c++11", "c++17"], ["double", "float"]))
def test_cpp_compiles_the_headers_and_reads_the_same_numbers(tmp_path, standard, number):
    need("g++")
    compensator = Compensator(plain_records.plant(3), (-20.7, 1e3 / 3), 1234.567, period=1e-4 / 3)
    folder = written(tmp_path / "c", compensator, number)
    (folder / "told.cc").write_text(
        '#include <cstdio>\n#include "piezo.h"\nint main() '
        '{ std::printf("%.17g %.17g %.17g", (double)PIEZO_LOW, (double)PIEZO_HIGH, (double)PIEZO_PERIOD); }\n'
    )
    compiled_exports.must_run(
        ["g++", f"-std={standard}", "-Wall", "-Wextra", "-Werror", "-pedantic", "told.cc", "-o", "t"], folder
    )
    told = [float(word) for word in compiled_exports.must_run(["./t"], folder).split()]
    expected = [*compensator.limits, compensator.period]
    if number == "double":
        assert told == expected
    else:
        assert told[2] == float(np.float32(expected[2]))
        np.testing.assert_allclose(told, expected, rtol=2**-23)


def test_the_example_for_another_processor_in_the_makefile_works(tmp_path):
    need("make", "arm-none-eabi-gcc")
    folder = export(compiled_exports.plain(), tmp_path / "c")
    example = re.search(r"^#   make (clean all symbols .*)$", (folder / "Makefile").read_text(), re.MULTILINE)[1]
    status, said = make(folder, *shlex.split(example))
    assert status == 0, said
    assert "no symbol is needed from outside" in said


@pytest.mark.parametrize("rising", [True, False])
def test_the_described_way_to_the_start_reaches_the_exported_state(rising):
    """Two ways: the words followed on the virtual actuator, and the state that was exported."""
    actuator = plain_records.plant(10, seed=4)
    low, high = (
        actuator.voltage(turned(actuator, 0, rising=False)),
        actuator.voltage(turned(actuator, plain_records.STROKE)),
    )
    state = turned(actuator, plain_records.STROKE if rising else 0, rising=rising)
    outset = ExportedStart.of(Compensator(actuator, (low, high), state=state)._axes[0])
    first, words = (low, "raise the voltage slowly from its lowest") if rising else (high, "lower the voltage slowly")
    assert outset.way.startswith(words)
    elsewhere = actuator.relaxed(0.5 * (low + high))
    path = [actuator.voltage(elsewhere), *np.linspace(first, outset.voltage, 50)]
    reached = actuator.simulate(path, state=elsewhere).displacement[-1]
    assert reached == pytest.approx(outset.displacement, abs=1e-9 * plain_records.STROKE)


def adversary(compensator, steps=200):
    """Every step reverses and asks for more than there is: all elements break away, all knots are passed."""
    low, high = compensator.reach
    far = 10 * (high - low)
    return np.where(np.arange(steps) % 2, low - far, high + far)


@pytest.mark.parametrize("kind", ["plain", at_night("graded"), at_night("creep")])
def test_the_instructions_of_a_step_are_bounded(tmp_path, kind):
    """No step gets longer by those before it, and clamped steps over the whole range are among the longest."""
    need("arm-none-eabi-gcc", "qemu-system-arm")
    compensator = KINDS[kind]()
    folder = export(compensator, tmp_path / "c", "float")
    longest = int(re.search(r"(\d+) instructions", compiled_exports.must_run(["make", "-s", "worst"], folder))[1])
    answers, clamped = compiled_exports.emulated(folder, adversary(compensator))
    sent, usual = answers[:, 0], compiled_exports.emulated(folder, compiled_exports.wishes(compensator, 2000))[1]
    assert np.all((sent >= compensator.limits[0]) & (sent <= compensator.limits[1]))
    for side in (0, 1):
        assert np.ptp(clamped[100 + side :: 2]) <= 0.1 * clamped.max()
    assert 100 < np.median(usual) < usual.max() <= 1.01 * longest < 20_000
    assert clamped.max() <= 1.01 * longest

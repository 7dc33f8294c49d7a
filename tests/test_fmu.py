"""FMUs of both versions: what Python does, to the last bit, through the functions of the standard alone."""

import json
import os
import re
import shutil
import subprocess
import sys
import warnings
import zipfile
from itertools import pairwise
from pathlib import Path

import bench
import numpy as np
import pytest
from fmu_rig import INPUT, KINDS, LIMITED, OUTPUT, PERIOD, VERSIONS, Slave, compensators, voltages, wanted

from dehyst import Compensator, FileFormatError, ModelError
from dehyst.console import start_state
from dehyst.fmu import SourceOnlyWarning, export_fmu

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed")
if not sys.platform.startswith("linux") or os.uname().machine != "x86_64" or shutil.which("cc") is None:
    pytest.skip("binaries are built by a C compiler on Linux x86-64", allow_module_level=True)

from fmpy.build import build_platform_binary  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402

ALL = compensators()
MODELS = tuple(ALL)
PATH = wanted()


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """(model, version, kind) to the FMU and the folder that it was unpacked to, made once."""
    folder, known = tmp_path_factory.mktemp("fmu"), {}

    def get(model, version, kind):
        key = model, version, kind
        if key not in known:
            path = folder / f"{model}-{kind}-{version[0]}.fmu"
            export_fmu(ALL[model], path, version, kind)
            known[key] = path, Path(fmpy.extract(path, folder / path.stem))
        return known[key]

    return get


def actuator_voltages(model):
    """Any but too fast: a random path, and beyond the limits."""
    return np.clip(PATH / bench.STROKE, -0.2, 1.2) * 150 + 10


def displacements(model, volts, start=None):
    """Of `Actuator.simulate`, from the start state on."""
    compensator = ALL[model]
    actuator, start = compensator.actuator, compensator.afresh().state if start is None else start
    given = np.append(actuator.voltage(start), volts)
    time = np.arange(given.size) * PERIOD if compensator.period else None
    return actuator.simulate(given, time=time, state=start).displacement[1:]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", MODELS)
def test_validation_finds_nothing(made, model, version, kind):
    path, _ = made(model, version, kind)
    assert validate_fmu(str(path)) == []


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", MODELS)
def test_the_compensator_is_pythons_bit_for_bit(made, model, version):
    v, clamps = voltages(ALL[model], PATH)
    assert clamps.limited > 5
    with Slave(made(model, version, "compensator")[1]) as slave:
        np.testing.assert_array_equal(slave.run(PATH), v)
        assert slave.counts() == tuple(clamps)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", MODELS)
def test_the_actuator_is_pythons(made, model, version):
    volts = actuator_voltages(model)
    with Slave(made(model, version, "actuator")[1]) as slave:
        y = slave.run(volts)
    np.testing.assert_allclose(y, displacements(model, volts), rtol=0, atol=1e-12 * bench.STROKE)
    assert np.ptp(y) > 0.5 * bench.STROKE


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", ["plain", "mass"])
def test_simulate_fmu_gives_the_same(made, model, version):
    """The importer's own loop: inputs from a table, outputs a step later."""
    count = 200
    time = np.arange(count) * PERIOD
    for kind, given, expected in (
        ("compensator", PATH[:count], voltages(ALL[model], PATH[:count])[0]),
        ("actuator", actuator_voltages(model)[:count], displacements(model, actuator_voltages(model)[:count])),
    ):
        source, sink = ("displacement", "voltage")[:: 1 if kind == "compensator" else -1]
        table = np.array(list(zip(time, given, strict=True)), dtype=[("time", "f8"), (source, "f8")])
        result = fmpy.simulate_fmu(
            str(made(model, version, kind)[0]),
            stop_time=time[-1],
            step_size=PERIOD,
            output_interval=PERIOD,
            input=table,
        )
        assert result["time"].size == count
        span = float(np.ptp(expected))
        np.testing.assert_allclose(result[sink][1:], expected[:-1], rtol=0, atol=1e-12 * span)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", VERSIONS)
def test_before_the_first_step_it_rests_in_the_start_state(made, version, kind):
    fresh = ALL["mass"].afresh()
    start = fresh.state.motion[0], fresh.voltage
    with Slave(made("mass", version, kind)[1]) as slave:
        assert tuple(slave.read([INPUT, OUTPUT])) == (start if kind == "compensator" else start[::-1])
        if kind == "actuator":  # held there, it stays
            assert slave.step() == pytest.approx(start[0], rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_of_many_periods_is_as_many_steps(made, version, kind):
    _, folder = made("creep", version, kind)
    given = PATH[:40] if kind == "compensator" else actuator_voltages("creep")[:40]
    with Slave(folder) as one, Slave(folder) as other:
        expected = one.run(np.repeat(given, 3))[2::3]
        np.testing.assert_array_equal([other.step(value, 3 * PERIOD) for value in given], expected)


@pytest.mark.parametrize("version", VERSIONS)
def test_any_step_is_one_sample_without_time(made, version):
    v, _ = voltages(ALL["timeless"], PATH[:50])
    steps = np.random.default_rng(3).uniform(1e-6, 10, 50)
    with Slave(made("timeless", version, "compensator")[1]) as slave:
        np.testing.assert_array_equal([slave.step(y, by) for y, by in zip(PATH, steps, strict=False)], v)


@pytest.mark.parametrize("by", [0.5 * PERIOD, 1.5 * PERIOD, PERIOD * (1 + 1e-7), 0.0, -PERIOD, np.nan, np.inf])
@pytest.mark.parametrize("version", VERSIONS)
def test_another_step_is_refused_and_moves_nothing(made, version, by):
    with Slave(made("creep", version, "compensator")[1]) as slave:
        slave.run(PATH[:20])
        before = slave.state()
        with pytest.raises(FMICallException, match="error"):
            slave.step(by=by)
        assert slave.state() == before
        category, message = slave.said[-1]
        assert category == "logStatusError" and f"need a whole multiple of {PERIOD:.17g} s" in message


@pytest.mark.parametrize("version", VERSIONS)
def test_steps_between_rounded_times_are_steps(made, version):
    """As an importer takes them: differences of times far from zero."""
    with Slave(made("creep", version, "compensator")[1], begin=False) as slave:
        slave.begin(1e5)
        times = 1e5 + np.arange(300) * PERIOD
        for at, to in pairwise(times):
            slave.fmu.doStep(currentCommunicationPoint=at, communicationStepSize=to - at)
        assert slave.read([0]) == [pytest.approx(times[-1], abs=1e-9)]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", VERSIONS)
def test_what_is_no_number_is_refused_and_moves_nothing(made, version, kind, value):
    given = PATH[:30] if kind == "compensator" else actuator_voltages("mass")[:30]
    with Slave(made("mass", version, kind)[1]) as one, Slave(made("mass", version, kind)[1]) as other:
        first = one.run(given)
        other.run(given[:10])
        before = other.state()
        with pytest.raises(FMICallException):
            other.write([INPUT], [value])
        assert other.state() == before
        assert "need a finite number of" in other.said[-1][1]
        np.testing.assert_array_equal(other.run(given[10:]), first[10:])


@pytest.mark.parametrize("version", VERSIONS)
def test_numbers_beyond_all_measure_are_refused(made, version):
    """Finite ones of which no finite voltage or displacement comes."""
    for kind in KINDS:
        with Slave(made("mass", version, kind)[1]) as slave:
            slave.run(PATH[:5] if kind == "compensator" else actuator_voltages("mass")[:5])
            slave.write([INPUT], [1.7e308])
            before = slave.state()
            try:
                slave.step(by=4 * PERIOD)
            except FMICallException:
                assert slave.state() == before
                assert "more than the model can follow" in slave.said[-1][1]
            assert np.isfinite(slave.read([OUTPUT])[0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("model", MODELS)
def test_a_state_is_gone_back_to_bit_for_bit(made, model, version, kind):
    _, folder = made(model, version, kind)
    given = PATH if kind == "compensator" else actuator_voltages(model)
    with Slave(folder) as one, Slave(folder) as other:
        one.run(given[:101])
        time = one.time
        kept, data = one.fmu.getFMUState(), one.state()
        expected = one.run(given[101:])
        after = one.state()
        one.fmu.setFMUState(kept)
        one.time = time
        assert one.state() == data
        np.testing.assert_array_equal(one.run(given[101:]), expected)
        one.fmu.freeFMUState(kept)
        # In another instance that has been elsewhere.
        other.run(given[200:250])
        other.restore(data)
        other.time = time
        np.testing.assert_array_equal(other.run(given[101:]), expected)
        assert other.state() == after
        # From the beginning.
        other.fmu.reset()
        other.begin()
        other.run(given[:101])
        assert other.state() == data


@pytest.mark.parametrize("version", VERSIONS)
def test_the_state_of_another_model_is_refused(made, version):
    with (
        Slave(made("plain", version, "compensator")[1]) as one,
        Slave(made("creep", version, "compensator")[1]) as other,
    ):
        for data in (one.state(), other.state()[:-1], b""):
            with pytest.raises(FMICallException):
                other.restore(data)
            assert other.said[-1][1] == "state: it is of another model"


@pytest.mark.parametrize("version", VERSIONS)
def test_instances_do_not_meddle(made, version):
    """Several of one library and of others, step by step in turn."""
    models = ("plain", "creep", "creep", "mass")
    paths = [wanted(seed, 120) for seed in range(4)]
    slaves = [Slave(made(model, version, "compensator")[1]) for model in models]
    found = np.array([[one.step(y) for one, y in zip(slaves, row, strict=True)] for row in zip(*paths, strict=True)])
    for one, model, path, column in zip(slaves, models, paths, found.T, strict=True):
        np.testing.assert_array_equal(column, voltages(ALL[model], path)[0])
        one.fmu.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_clamping_is_said_once_of_each(made, version):
    for logging in (True, False):
        with Slave(made("plain", version, "compensator")[1], logging=logging) as slave:
            slave.run(PATH)
            assert min(slave.counts()) > 2
            words = [message for category, message in slave.said if category == "logStatusWarning"]
            assert len(words) == (2 if logging else 0)
            assert all(word.startswith("CLAMPED: ") for word in words)


@pytest.mark.parametrize("version", VERSIONS)
def test_what_is_not_allowed_is_refused(made, version):
    _, folder = made("plain", version, "compensator")
    with pytest.raises(Exception, match="instantiate"):
        Slave(folder, token="{another}")
    with Slave(folder, begin=False) as slave:
        with pytest.raises(FMICallException):
            slave.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=PERIOD)
        assert slave.said[-1][1] == "DoStep: not allowed now; end the initialization first"
        slave.begin()
        for write, reference, words in ((slave.write, OUTPUT, "no input"), (slave.read, LIMITED, "no real number")):
            with pytest.raises(FMICallException):
                write([reference], *([[1.0]] if write == slave.write else []))
            assert words in slave.said[-1][1]
        slave.fmu.terminate()


@pytest.mark.parametrize("version", VERSIONS)
def test_built_from_its_own_sources_it_is_the_same(made, version, tmp_path, monkeypatch):
    """As an importer builds it: the files, language and definitions of its own description, no flags of ours."""
    cmake = shutil.which("cmake") or shutil.which("cmake", path=str(Path(sys.executable).parent))
    if cmake is None:
        pytest.skip("cmake is not installed")
    monkeypatch.setenv("PATH", f"{Path(cmake).parent}{os.pathsep}{os.environ['PATH']}")
    for kind in KINDS:
        folder = Path(fmpy.extract(made("mass", version, kind)[0], tmp_path / kind))
        shutil.rmtree(folder / "binaries")
        build_platform_binary(folder)
        given = PATH if kind == "compensator" else actuator_voltages("mass")
        with Slave(folder) as built, Slave(made("mass", version, kind)[1]) as shipped:
            np.testing.assert_array_equal(built.run(given), shipped.run(given))


@pytest.mark.parametrize("version", VERSIONS)
def test_the_declarations_are_those_of_the_standard(made, version, tmp_path):
    """Its own headers say no other thing than the official ones, nothing is missing, and nothing else is seen."""
    _, folder = made("creep", version, "compensator")
    official = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-strict-prototypes"]
    for options in ([], ["-DFMU_STANDARD_HEADERS", f"-I{official}"]):
        command = ["cc", *flags, *options, "-fPIC", "-shared", "all.c", "-o", str(tmp_path / "x.so")]
        subprocess.run(command, cwd=folder / "sources", check=True)
    listed = subprocess.run(["nm", "-D", "--defined-only", str(tmp_path / "x.so")], capture_output=True, check=True)
    seen = {line.split()[-1] for line in listed.stdout.decode().splitlines()}
    assert all(name.startswith(f"fmi{version[0]}") for name in seen)
    if version == "3.0":
        text = (official / "fmi3Functions.h").read_text()
        assert seen == {line.split()[-1].rstrip(";") for line in text.splitlines() if line.startswith("FMI3_Export")}


@pytest.mark.parametrize("version", VERSIONS)
def test_no_memory_is_lost_or_overrun(made, version, tmp_path):
    """A life from instantiation to the end, under the sanitizers of the compiler."""
    _, folder = made("preview", version, "compensator")
    life = Path(__file__).with_name(f"fmu_life{version[0]}.c")
    command = ["cc", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{folder / 'sources'}"]
    built = subprocess.run(
        [*command, str(life), "-o", str(tmp_path / "life")], capture_output=True, text=True, check=False
    )
    if "cannot find" in built.stderr:
        pytest.skip("the sanitizers' libraries are not installed")
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(tmp_path / "life")], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout == "alike\n"


@pytest.mark.parametrize("version", VERSIONS)
def test_the_same_model_makes_the_same_file(made, version, tmp_path):
    path, _ = made("creep", version, "compensator")
    again = compensators()["creep"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        again.run(PATH)  # where it is now does not matter, where it was made does
    export_fmu(again, tmp_path / "again.fmu", version)
    assert (tmp_path / "again.fmu").read_bytes() == path.read_bytes()
    tokens = {fmpy.read_model_description(made(model, version, kind)[0]).guid for model in MODELS for kind in KINDS}
    assert len(tokens) == len(MODELS) * len(KINDS)


def test_without_a_compiler_it_holds_sources(tmp_path, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.warns(SourceOnlyWarning, match="no C compiler is installed"):
        export_fmu(ALL["plain"], tmp_path / "a.fmu")
    monkeypatch.setenv("CC", "/nowhere/cc")
    with pytest.warns(SourceOnlyWarning, match="No such file"):
        export_fmu(ALL["plain"], tmp_path / "b.fmu")
    names = zipfile.ZipFile(tmp_path / "a.fmu").namelist()
    assert "sources/all.c" in names and not [name for name in names if name.startswith("binaries")]
    assert validate_fmu(str(tmp_path / "a.fmu")) == []


def test_the_licence_goes_with_it(made):
    _, folder = made("plain", "3.0", "actuator")
    assert "MIT License" in (folder / "documentation" / "licenses" / "license.txt").read_text()


def test_any_name_makes_an_fmu(tmp_path):
    from dataclasses import replace

    odd = replace(bench.plant(3), name='Möbius "<&> 100 %\n\x00 7')
    export_fmu(Compensator(odd, (0, 100)), tmp_path / "x.fmu")
    assert validate_fmu(str(tmp_path / "x.fmu")) == []
    with Slave(fmpy.extract(tmp_path / "x.fmu", tmp_path / "x")) as slave:
        assert slave.step(5e-6) == voltages(Compensator(odd, (0, 100)), [5e-6])[0][0]


def test_refusals(tmp_path):
    with pytest.raises(ModelError, match=r"version: got '1\.0', need '2\.0' or '3\.0'"):
        export_fmu(ALL["plain"], tmp_path / "x.fmu", "1.0")
    with pytest.raises(ModelError, match="kind: got 'plant', need 'compensator' or 'actuator'"):
        export_fmu(ALL["plain"], tmp_path / "x.fmu", kind="plant")
    with pytest.raises(FileFormatError, match=r"ends in \.fmu"):
        export_fmu(ALL["plain"], tmp_path / "x.zip")
    with pytest.raises(ModelError, match="give period="):
        export_fmu(Compensator(ALL["creep"].actuator, (0, 1)), tmp_path / "x.fmu")


def cli(*arguments, cwd):
    command = [sys.executable, "-c", "from dehyst.cli import main; main()", "export", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=120, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    return done


def test_the_command_line_writes_both_kinds(tmp_path):
    compensator = ALL["creep"]
    compensator.actuator.save(tmp_path / "model.json")
    low, high = compensator.limits
    options = "--limits", low, high, "--slew", compensator.slew_rate, "--period", PERIOD
    done = cli("model.json", "c.fmu", *options, "--fmu", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith("c.fmu: an FMU 3.0 of the compensator, sources and a binary for Linux x86-64")
    assert "outside the limits" in done.stderr
    done = cli("model.json", "a.fmu", "--period", PERIOD, "--fmu", "2.0", "--kind", "actuator", "--json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == {
        "fmu": "a.fmu", "version": "2.0", "kind": "actuator", "binary": True, "warnings": []
    }  # fmt: skip
    for name in ("c", "a"):
        assert validate_fmu(str(tmp_path / f"{name}.fmu")) == []
    with Slave(fmpy.extract(tmp_path / "a.fmu", tmp_path / "a")) as slave:
        volts = actuator_voltages("creep")
        y = slave.run(volts)
    expected = displacements("creep", volts, start_state(compensator.actuator, "top"))
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12 * bench.STROKE)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--kind", "actuator"], "give --fmu too"),
        (["--fmu", "2.0", "--number", "float"], "an FMU has doubles"),
        (["--fmu", "2.0", "--kind", "actuator", "--preview"], "leave out --limits, --slew, --preview"),
        (["--fmu", "2.0", "--limits", "0", "100"], "is there already; replace it with --force"),
    ],
)
def test_the_command_line_refuses(tmp_path, options, words):
    ALL["plain"].actuator.save(tmp_path / "model.json")
    (tmp_path / "x.fmu").write_text("")
    done = cli("model.json", "x.fmu", *options, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert (tmp_path / "x.fmu").read_text() == ""


def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch):
    """And what it shows: the actuator follows two steps late."""
    page = (Path(__file__).parents[1] / "docs" / "fmu.md").read_text()
    names = {}
    ALL["creep"].actuator.save(tmp_path / "model.json")
    monkeypatch.chdir(tmp_path)
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)
    missed = np.abs(names["moved"]["displacement"][2:] - names["wanted"].displacement[:-2])
    assert names["sent"]["limited"][-1] == 0
    assert missed.max() < 1e-12 * bench.STROKE

"""FMUs: what Python does, to the last bit, through the standard's functions; files that are valid and whole."""

import itertools
import os
import re
import shutil
import subprocess
import sys
import warnings
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import places
import plain_records
import pytest
from fmu_runner import (
    ALL,
    GAIN,
    INPUT,
    LIMITED,
    MODELS,
    OFFSET,
    OUTPUT,
    PATH,
    PERIOD,
    TARGETS,
    VOLTAGES,
    Slave,
    displacements,
    fmpy,
    validate_fmu,
    voltages,
)

import dehyst
from dehyst import Compensator, FileFormatError, ModelError, Thermal
from dehyst.exports import SourceOnlyWarning, export
from dehyst.model import evaluator_of
from examples import at_night, spanning

FMICallException = fmpy.fmi1.FMICallException


@pytest.mark.parametrize("model", MODELS)
def test_the_compensator_has_the_bits_of_python(fmus, model):
    v, clamps = voltages(ALL[model], PATH)
    assert clamps.limited > 5
    with Slave(fmus(model, "compensator")[1]) as slave:
        np.testing.assert_array_equal(slave.run(PATH), v)
        assert slave.counts() == tuple(clamps)


@pytest.mark.parametrize("model", ["timeless", "creep", "mass", *map(at_night, ["plain", "preview"])])
def test_the_actuator_moves_as_in_python(fmus, model):
    with Slave(fmus(model, "actuator")[1]) as slave:
        y = slave.run(VOLTAGES)
    np.testing.assert_allclose(y, displacements(model, VOLTAGES), rtol=0, atol=1e-12 * plain_records.STROKE)
    assert np.ptp(y) > 0.5 * plain_records.STROKE


def test_gain_and_offset_are_those_of_python(fmus):
    loop, (before, after) = ALL["plain"]._clone(), np.split(PATH[:400], 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dehyst.ClampWarning)
        expected = [loop.run(before)]
        loop.scale(1.07, 3e-7)
        expected.append(loop.run(after))
    with Slave(fmus("plain", "compensator")[1]) as slave:
        found = [slave.run(before)]
        slave.write([GAIN, OFFSET], [1.07, 3e-7])
        kept = slave.fmu.getFMUState()
        for _ in range(2):
            np.testing.assert_array_equal(np.concatenate([*found, slave.run(after)]), np.concatenate(expected))
            with pytest.raises(FMICallException):
                slave.write([GAIN], [-1.0])
            assert slave.read([GAIN, OFFSET]) == [1.07, 3e-7]
            slave.fmu.setFMUState(kept)
            slave.time -= PERIOD * after.size
        slave.fmu.freeFMUState(kept)
    with Slave(fmus("timeless", "actuator")[1]) as slave:
        (y,) = slave.run([60.0])
        slave.write([GAIN, OFFSET], [2.0, 1e-6])
        assert slave.run([60.0]) == [pytest.approx(1e-6 + 2 * y, rel=1e-14)]


@pytest.mark.parametrize("kind", TARGETS)
def test_before_the_first_step_it_is_in_the_start_state(fmus, kind):
    fresh = ALL["mass"]._clone()
    start = fresh.displacement, fresh.voltage
    assert fresh.limits[0] <= start[1] <= fresh.limits[1]
    if kind == "actuator":  # it has no limits to be brought within
        asked = evaluator_of(fresh.actuator).complete_state(fresh._axes[0].given)
        start = fresh.actuator.displacement(asked), fresh.actuator.voltage(asked)
    with Slave(fmus("mass", kind)[1]) as slave:
        assert tuple(slave.read([INPUT, OUTPUT])) == (start if kind == "compensator" else start[::-1])
        if kind == "actuator":  # held there, it stays
            assert slave.step() == pytest.approx(start[0], rel=1e-9)


@pytest.mark.parametrize("kind", TARGETS)
def test_a_step_of_many_periods_equals_many_steps(fmus, kind):
    _, folder = fmus("creep", kind)
    given = PATH[:40] if kind == "compensator" else VOLTAGES[:40]
    with Slave(folder) as first, Slave(folder) as other:
        expected = first.run(np.repeat(given, 3))[2::3]
        np.testing.assert_array_equal([other.step(value, 3 * PERIOD) for value in given], expected)


def test_without_a_period_any_step_is_one_sample(fmus):
    v, _ = voltages(ALL["timeless"], PATH[:50])
    steps = np.random.default_rng(3).uniform(1e-6, 10, 50)
    with Slave(fmus("timeless", "compensator")[1]) as slave:
        np.testing.assert_array_equal([slave.step(y, by) for y, by in zip(PATH, steps, strict=False)], v)


STEPS = (0.5 * PERIOD, 1.5 * PERIOD, PERIOD * (1 + 1e-7), 0.0, -PERIOD, np.nan, np.inf)
PLACES = (PERIOD, -PERIOD, 1e-7 * PERIOD, 1e3, np.nan, np.inf)


@pytest.mark.parametrize(
    ("model", "off", "by"),
    [
        *(("creep", 0.0, by) for by in STEPS),
        *((model, off, PERIOD) for model in ("creep", "timeless") for off in PLACES),
    ],
)
def test_a_step_of_another_length_or_from_another_time_is_refused_and_changes_nothing(fmus, model, off, by):
    with Slave(fmus(model, "compensator")[1]) as slave:
        slave.run(PATH[:20])
        before = slave.state()
        with pytest.raises(FMICallException, match="error"):
            slave.fmu.doStep(currentCommunicationPoint=slave.time + off, communicationStepSize=by)
        assert slave.state() == before
        assert slave.said[-1][0] == "logStatusError"
        slave.time *= 1 + 1e-16
        slave.step()


def test_steps_between_rounded_times_are_accepted(fmus):
    """As an importer takes them: differences of times far from zero."""
    with Slave(fmus("creep", "compensator")[1], begin=False) as slave:
        slave.begin(1e5)
        times = 1e5 + np.arange(300) * PERIOD
        for at, to in itertools.pairwise(times):
            slave.fmu.doStep(currentCommunicationPoint=at, communicationStepSize=to - at)
        assert slave.read([0]) == [pytest.approx(times[-1], abs=1e-9)]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", TARGETS)
def test_an_input_that_is_no_number_is_refused_and_changes_nothing(fmus, kind, value):
    given = PATH[:30] if kind == "compensator" else VOLTAGES[:30]
    with Slave(fmus("mass", kind)[1]) as initial, Slave(fmus("mass", kind)[1]) as other:
        first = initial.run(given)
        other.run(given[:10])
        before = other.state()
        with pytest.raises(FMICallException):
            other.write([INPUT], [value])
        assert other.state() == before
        assert "finite number" in other.said[-1][1]
        np.testing.assert_array_equal(other.run(given[10:]), first[10:])


@pytest.mark.parametrize(("model", "kind"), spanning(MODELS, TARGETS))
def test_a_state_is_restored_bit_for_bit(fmus, model, kind):
    _, folder = fmus(model, kind)
    given = PATH if kind == "compensator" else VOLTAGES
    with Slave(folder) as first, Slave(folder) as other:
        first.run(given[:101])
        time = first.time
        kept, data = first.fmu.getFMUState(), first.state()
        expected = first.run(given[101:])
        after = first.state()
        first.fmu.setFMUState(kept)
        first.time = time
        assert first.state() == data
        np.testing.assert_array_equal(first.run(given[101:]), expected)
        first.fmu.freeFMUState(kept)
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


def test_the_state_of_another_model_is_refused(fmus):
    with Slave(fmus("plain", "compensator")[1]) as first, Slave(fmus("creep", "compensator")[1]) as other:
        for data in (first.state(), other.state()[:-1], b""):
            with pytest.raises(FMICallException):
                other.restore(data)
            assert other.said[-1][1].startswith("state: ")


def checksum(data):
    """FNV-1a of 64 bits, of what lies behind it."""
    value = 14695981039346656037
    for byte in data[48:]:
        value = ((value ^ byte) * 1099511628211) % 2**64
    return value.to_bytes(8, "little")


@pytest.mark.parametrize("kind", TARGETS)
def test_a_damaged_state_is_refused(fmus, kind):
    """Any bit of it turned, and numbers that no FMU writes, though their checksum fits."""
    with Slave(fmus("creep", kind)[1]) as slave:
        given = PATH[:20] if kind == "compensator" else VOLTAGES[:20]
        slave.run(given)
        data = slave.state()
        assert data[40:48] == checksum(data)
        for bit in range(40 * 8, len(data) * 8, 31):
            broken = bytearray(data)
            broken[bit // 8] ^= 1 << bit % 8
            with pytest.raises(FMICallException):
                slave.restore(bytes(broken))
            assert "checksum" in slave.said[-1][1]
        low, high = ALL["creep"].limits
        # The output, and of the snapshot, whose header has 40 bytes: the deflection, the voltage and the last number.
        shown, snapshot = 56 + 8, 80
        deflection, sent = snapshot + 40, snapshot + 40 + 8 * 4
        for at, value, words in (
            (shown, np.nan, "not finite"),
            (shown, np.nextafter(high, np.inf), "limits"),
            (deflection, np.nan, "actuator"),
            (len(data) - 8, np.inf, "actuator"),
            (sent, np.nextafter(high, np.inf), "limits"),
            (sent, -1e6, "actuator"),
        ):
            broken = bytearray(data)
            broken[at : at + 8] = np.float64(value).tobytes()
            broken[snapshot + 12 : snapshot + 16] = zlib.crc32(broken[snapshot + 16 :]).to_bytes(4, "little")
            broken[40:48] = checksum(broken)
            if kind == "actuator" and (at == sent or words == "limits"):
                slave.restore(bytes(broken))
                continue
            with pytest.raises(FMICallException):
                slave.restore(bytes(broken))
            assert words in slave.said[-1][1]
        if kind == "compensator":
            assert low <= slave.read([OUTPUT])[0] <= high
        slave.restore(data)
        assert slave.state() == data


def test_the_voltage_declares_and_keeps_its_limits(fmus, tmp_path):
    """Also before the first step, and where a state is held by a voltage outside them."""
    folder = fmus("creep", "compensator")[1]
    voltage = next(v for v in fmpy.read_model_description(folder).modelVariables if v.name == "voltage")
    assert (float(voltage.min), float(voltage.max)) == ALL["creep"].limits
    actuator = ALL["plain"].actuator
    low, high = narrow = 60.0, 61.0
    export(Compensator(actuator, narrow, state=actuator.relaxed()), tmp_path / "x.fmu")
    with Slave(fmpy.extract(tmp_path / "x.fmu", tmp_path / "x"), begin=False) as slave:
        assert slave.read([OUTPUT]) == [low]
        slave.begin()
        assert slave.read([OUTPUT]) == [low]
        sent = slave.run(PATH)
        assert low <= sent.min() and sent.max() <= high
    free = fmpy.read_model_description(fmus("creep", "actuator")[1]).modelVariables
    assert all(variable.min is None and variable.max is None for variable in free)


def test_the_actuator_has_no_limits(tmp_path):
    actuator = ALL["plain"].actuator
    state = actuator.relaxed()
    export(replace(actuator, limits=(60, 61), state=state), tmp_path / "x.fmu")
    volts = np.array([0.0, 160.0, 20.0, 90.0])
    expected = actuator.simulate(np.append(actuator.voltage(state), volts), state=state).displacement[1:]
    with Slave(fmpy.extract(tmp_path / "x.fmu", tmp_path / "x")) as slave:
        np.testing.assert_allclose(slave.run(volts), expected, rtol=0, atol=1e-12 * plain_records.STROKE)


def test_calls_that_the_standard_forbids_are_refused(fmus):
    _, folder = fmus("plain", "compensator")
    with pytest.raises(Exception, match="instantiate"):
        Slave(folder, token="{another}")
    with Slave(folder, begin=False) as slave:
        with pytest.raises(FMICallException):
            slave.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=PERIOD)
        assert slave.said[-1][1].startswith("DoStep: ")
        slave.begin()
        for write, reference, words in ((slave.write, OUTPUT, "no input"), (slave.read, LIMITED, "no real number")):
            with pytest.raises(FMICallException):
                write([reference], *([[1.0]] if write == slave.write else []))
            assert words in slave.said[-1][1]
        slave.fmu.terminate()


@pytest.mark.parametrize(("model", "kind"), spanning(MODELS, TARGETS))
def test_the_validator_finds_no_fault(fmus, model, kind):
    path, _ = fmus(model, kind)
    assert validate_fmu(str(path)) == []


@pytest.mark.nightly
def test_a_binary_built_from_the_sources_is_the_same(fmus, tmp_path, monkeypatch):
    """As an importer builds it: the files, language and definitions of its own description, no flags of ours."""
    from fmpy.build import build_platform_binary

    cmake = shutil.which("cmake") or shutil.which("cmake", path=str(Path(sys.executable).parent))
    if cmake is None:
        pytest.skip("cmake is not installed")
    monkeypatch.setenv("PATH", f"{Path(cmake).parent}{os.pathsep}{os.environ['PATH']}")
    for kind in TARGETS:
        folder = Path(fmpy.extract(fmus("mass", kind)[0], tmp_path / kind))
        shutil.rmtree(folder / "binaries")
        build_platform_binary(folder)
        given = PATH if kind == "compensator" else VOLTAGES
        with Slave(folder) as built, Slave(fmus("mass", kind)[1]) as shipped:
            np.testing.assert_array_equal(built.run(given), shipped.run(given))


def test_the_declarations_are_those_of_the_standard(fmus, tmp_path):
    """Its own headers say no other thing than the official ones, nothing is missing, and nothing else is seen."""
    _, folder = fmus("creep", "compensator")
    official = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-strict-prototypes"]
    for options in ([], ["-DFMU_STANDARD_HEADERS", f"-I{official}"]):
        command = ["cc", *flags, *options, "-fPIC", "-shared", "all.c", "-o", str(tmp_path / "x.so")]
        subprocess.run(command, cwd=folder / "sources", check=True)
    listed = subprocess.run(["nm", "-D", "--defined-only", str(tmp_path / "x.so")], capture_output=True, check=True)
    seen = {line.split()[-1] for line in listed.stdout.decode().splitlines()}
    assert all(name.startswith("fmi2") for name in seen)


def test_no_memory_is_leaked_or_overrun(fmus, tmp_path):
    """A life from instantiation to the end, under the sanitizers of the compiler."""
    _, folder = fmus("preview", "compensator")
    life = places.SUPPORT / "fmu_life.c"
    command = ["cc", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{folder / 'sources'}"]
    command += [f"-DMODEL_PERIOD={PERIOD!r}"]
    built = subprocess.run(
        [*command, str(life), "-o", str(tmp_path / "life")], capture_output=True, text=True, check=False
    )
    if "cannot find" in built.stderr:
        pytest.skip("the sanitizers' libraries are not installed")
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(tmp_path / "life")], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout == "alike\n"


def test_without_a_compiler_it_contains_sources(tmp_path, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "absent"))
    with pytest.warns(SourceOnlyWarning, match="compiler"):
        export(ALL["plain"], tmp_path / "a.fmu")
    monkeypatch.setenv("CC", str(tmp_path / "absent" / "cc"))
    with pytest.warns(SourceOnlyWarning, match="such file"):
        export(ALL["plain"], tmp_path / "b.fmu")
    names = zipfile.ZipFile(tmp_path / "a.fmu").namelist()
    assert "sources/all.c" in names and not [name for name in names if name.startswith("binaries")]
    assert validate_fmu(str(tmp_path / "a.fmu")) == []


TIMED = ALL["creep"].actuator


@pytest.mark.parametrize(
    ("given", "name", "options", "error"),
    [
        *(
            (ALL["plain"], "x.fmu", options, ModelError)
            for options in ({"name": "axis"}, {"number": "float"}, {"period": 1.0})
        ),
        (ALL["plain"], "x.zip", {}, FileFormatError),
        (Compensator(TIMED, (0, 1)), "x.fmu", {}, ModelError),
        (TIMED, "x.fmu", {}, ModelError),
        (Compensator(replace(ALL["plain"].actuator, thermal=Thermal(0.004)), (0, 100)), "x.fmu", {}, ModelError),
    ],
)
def test_impossible_arguments_are_refused(tmp_path, given, name, options, error):
    with pytest.raises(error):
        export(given, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch):
    """And what it shows: the actuator follows two steps late."""
    page = (places.DOCS / "how_to" / "simulink.md").read_text()
    names = {}
    ALL["creep"].actuator.save(tmp_path / "model.json")
    monkeypatch.chdir(tmp_path)
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)
    missed = np.abs(names["moved"]["displacement"][2:] - names["wanted"].displacement[:-2])
    assert names["sent"]["limited"][-1] == 0
    assert missed.max() < 1e-12 * plain_records.STROKE

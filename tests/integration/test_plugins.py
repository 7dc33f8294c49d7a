"""Plug-ins: what they add, what they may not replace, and that a broken one takes nothing else down."""

import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import time
import zlib

import numpy as np
import places
import pytest
from command_line import DEHYST, run
from fake_rig import FakeRig
from plugged_in import describe, plugged_in, write_distribution

import dehyst
from dehyst._errors import FileFormatError, MissingExtraError, ModelError, PluginError, RecordError, RigError
from dehyst._plugins import PluginWarning, Registry
from dehyst.baselines import BASELINES
from dehyst.baselines.comparison import OURS, contenders
from dehyst.exports import TARGETS
from dehyst.instruments import SCHEMES, AbstractRig, open_rig
from dehyst.records import LOADERS
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops
from dehyst.workbench.forms import connect_form, exports, rig_address

REGISTRIES = {"readers": LOADERS, "rigs": SCHEMES, "baselines": BASELINES, "targets": TARGETS}
READER = """
import fcntl, os, signal, sys, time
import numpy as np
from dehyst.records import Column
from dehyst.records.formats import reader_process

if sys.argv[0] == "-c":  # in the reader's process
    reader_process._SECONDS, reader_process._BUSY = 1, 4

def read(data, allowance):
    if data == b"sleep":
        time.sleep(1e6)
    if data == b"deaf":
        signal.signal(signal.SIGXCPU, signal.SIG_IGN)
        while True:
            pass
    if data == b"leave":
        os._exit(0)
    if data.startswith(b"lock "):
        locked = open(data[5:], "w")
        fcntl.flock(locked, fcntl.LOCK_EX)
        print("locked", file=locked, flush=True)
        time.sleep(1e6)
    if data == b"name":
        return [Column(5, np.zeros(3))]
    if data == b"crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if data == b"memory":
        np.ones(400_000_000)
    if data == b"complex":
        return [Column(n, np.arange(3) + 1j) for n in ("time_s", "voltage_V", "displacement_um")]
    if data == b"empty":
        return [Column(n, np.zeros(0)) for n in ("a", "b", "c")]
    if data == b"masked":
        return [Column(n, np.ma.masked_all(3)) for n in ("time_s", "voltage_V", "displacement_um")]
    if data == b"bare":
        return [np.zeros(3)]
    if data == b"allowance":
        allowance.take(10**9, "the header")
    rows = np.array([line.split(b";") for line in data.split()], dtype=float)
    return [Column(n, c) for n, c in zip(("time_s", "voltage_V", "displacement_um"), rows.T)]
"""
RIG = """
from dehyst.instruments import Scheme
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator

def opened(rest, options):
    if rest == "careless":
        options["limits"] = None
    if rest == "none":
        return None
    if rest == "broken":
        raise KeyError("port")
    return SimulatedRig(PlayActuator(highest=100), **options)

RIG = Scheme("bench://NAME", opened)
"""
TARGET = """
from dehyst.exports import Target, Written

def write(compensator, path, options):
    path.write_text(f"{compensator.limits[1]} {compensator.preview} {options['force']}")
    return Written({"file": str(path)}, f"{path}: a line")

TARGET = Target("a line", write, ("preview",), about="Nothing but a line.")
"""


def until(condition, seconds):
    """Wait for a condition; return whether it holds."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


def loops(top=100.0):
    excitation = descending_tops(top, steps=4, drive=Sampling(sample_rate=50.0))
    time = np.arange(len(excitation.voltage)) / 50.0
    return dehyst.Record(time, excitation.voltage, PlayActuator(highest=top).play(excitation.voltage))


def test_without_plug_ins_a_registry_has_its_own_rows():
    for registry in REGISTRIES.values():
        assert list(registry) == list(registry.own)
        assert len(registry) == len(registry.own) > 2
        assert registry.plugins == ()
        assert "none of these" not in registry


def test_a_library_that_is_imported_looks_for_no_plug_in():
    code = "import sys, dehyst; assert 'importlib.metadata' not in sys.modules and 'dehyst._plugins' not in sys.modules"
    done = subprocess.run([sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}; {code}"], check=False)
    assert done.returncode == 0


def test_rows_of_this_package_are_found_without_a_search(monkeypatch):
    monkeypatch.setattr(Registry, "plugins", property(lambda _: pytest.fail("searched")))
    for registry in REGISTRIES.values():
        for name in registry.own:
            assert registry[name] is registry.own[name]


def test_a_plug_in_may_not_replace_a_row_of_this_package(tmp_path):
    write_distribution(
        tmp_path,
        "greedy",
        {"readers": ".csv = greedy:read", "baselines": "dehyst = greedy:read\nPREISACH = greedy:read"},
        READER,
    )
    with plugged_in(tmp_path):
        with pytest.warns(PluginWarning, match=r"'\.csv' \(readers\) of greedy 1\.0 .* belongs to dehyst \d"):
            assert list(LOADERS) == list(LOADERS.own)
        assert LOADERS[".csv"] is LOADERS.own[".csv"]
        with pytest.warns(PluginWarning, match="'(dehyst|PREISACH)' .* of greedy 1.0 .* a model of dehyst"):
            assert list(contenders()) == [OURS, f"{OURS}, paper's", *BASELINES.own]


def test_two_plug_ins_of_one_name_are_both_refused(tmp_path):
    for name in ("one", "other"):
        write_distribution(tmp_path / name, name, {"readers": ".daq = one:read"}, READER)
    refused = pytest.raises(PluginError, match=r"one 1\.0 .*other 1\.0")
    with plugged_in(tmp_path / "one", tmp_path / "other"), pytest.warns(PluginWarning), refused:
        dehyst.read(tmp_path / "a.daq")


def test_a_plug_in_that_fails_is_named_and_the_others_work(tmp_path):
    groups = {"readers": ".bad = fails:read", "rigs": "bad = fails:rig", "targets": ".bad = fails:target"}
    write_distribution(tmp_path, "fails", groups, "raise SystemExit('no licence')")
    write_distribution(tmp_path, "works", {"readers": ".daq = works:read\n.gone = works:gone"}, READER)
    (tmp_path / "a.daq").write_text("0;0;0\n1;2;3\n2;1;2")
    with plugged_in(tmp_path):
        with pytest.warns(PluginWarning, match=r"fails 1\.0 .*SystemExit") as caught:
            assert dehyst.read(tmp_path / "a.daq").voltage.tolist() == [0, 2, 1]
        assert sum("works 1.0" in str(one.message) for one in caught) == 1
        with pytest.raises(PluginError, match=r"'\.bad' \(readers\) of fails 1\.0"):
            dehyst.read(tmp_path / "a.bad")
        with pytest.warns(PluginWarning), pytest.raises(PluginError, match=r"'bad' \(rigs\) of fails 1\.0"):
            open_rig("bad://x")
        status, out, _ = run("--version")
    assert status == 0
    assert "reader of .daq of works 1.0" in out.splitlines()
    assert sum("of fails 1.0 cannot be used: SystemExit: no licence" in line for line in out.splitlines()) == 3
    assert run("--version")[1] == f"dehyst, version {dehyst.__version__}\n"


@pytest.mark.parametrize(
    ("group", "entry"),
    [
        ("readers", "daq = wrong:read"),
        ("readers", ".DAQ = wrong:read"),
        ("readers", ".daq = wrong:word"),
        ("rigs", "bench = wrong:word"),
        ("rigs", "My-Bench = wrong:RIG"),
        ("baselines", "flat = wrong:word"),
        ("targets", ".st = wrong:word"),
        ("targets", "st = wrong:TARGET"),
    ],
)
def test_what_is_no_member_is_refused(tmp_path, group, entry):
    write_distribution(tmp_path, "wrong", {group: entry}, f"{RIG}{TARGET}word = 'no'\ndef read(*_): pass")
    with plugged_in(tmp_path), pytest.warns(PluginWarning, match=r"wrong 1\.0"):
        assert list(REGISTRIES[group]) == list(REGISTRIES[group].own)


def test_masked_values_of_a_plug_in_are_no_numbers(tmp_path):
    write_distribution(tmp_path, "reads", {"readers": ".daq = reads:read"}, READER)
    (tmp_path / "a.daq").write_text("masked")
    with plugged_in(tmp_path), pytest.raises(RecordError, match=r"time .* 3 values"):
        dehyst.read(tmp_path / "a.daq")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the limits of the reader's process need fork")
@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("crash", signal.SIGSEGV.name),
        ("memory", "takes more memory"),
        ("bare", "need Columns"),
        ("complex", "column 'time_s': holds complex numbers"),
        ("empty", "column"),
        ("name", "the name 5 .*, need text"),
        ("sleep", "its plug-in did not finish it in .* s in all"),
        ("deaf", "its plug-in did not finish it in .* s of CPU time"),
        ("leave", r"its plug-in ended without an answer \(status 0\).*author"),
        ("allowance", "the header declares 8000 MB"),
        ("no numbers", "not a readable .daq file"),
    ],
)
def test_a_reader_of_a_plug_in_runs_within_the_limits_of_the_readers_process(tmp_path, content, message):
    write_distribution(tmp_path, "reads", {"readers": ".daq = reads:read"}, READER)
    (tmp_path / "a.daq").write_text(content)
    with plugged_in(tmp_path), pytest.raises(FileFormatError, match=f"a.daq: .*{message}|{message}"):
        dehyst.read(tmp_path / "a.daq", max_bytes=1e6)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="only a forked reader can outlive its process")
@pytest.mark.parametrize("end", ["SIGINT", "SIGTERM", "SIGHUP", "SIGKILL"])
def test_no_reader_outlives_the_process_that_asked(tmp_path, end):
    import fcntl

    write_distribution(tmp_path, "reads", {"readers": ".daq = reads:read"}, READER.replace("= 1, 4", "= 1000, 1000"))
    lock, file = tmp_path / "lock", tmp_path / "a.daq"
    file.write_text(f"lock {lock}")
    given = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    code = "import signal, sys, dehyst; signal.signal(2, signal.default_int_handler); dehyst.read(sys.argv[1])"
    asker = subprocess.Popen([sys.executable, "-c", code, file], env=given, stderr=subprocess.DEVNULL)
    assert until(lambda: lock.exists() and lock.read_text() == "locked\n", 60)
    asker.send_signal(signal.Signals[end])
    assert asker.wait(10) != 0

    def is_free():
        with lock.open() as held, contextlib.suppress(BlockingIOError):
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        return False

    assert until(is_free, 10)


def test_a_rig_of_a_plug_in_keeps_what_every_rig_keeps(tmp_path):
    write_distribution(tmp_path, "rigs", {"rigs": "bench = rigs:RIG"}, RIG)
    with plugged_in(tmp_path):
        with open_rig("bench://1", limits=(0, 60), slew_rate=500) as rig:
            assert (rig.limits.low, rig.limits.high, rig.slew_rate) == (0, 60, 500)
        with pytest.raises(RigError, match=r"0 to 100 V.*0 to 60 V"):
            open_rig("bench://careless", limits=(0, 60))
        with pytest.raises(RigError, match="bench://none: returned a NoneType"):
            open_rig("bench://none")
        with pytest.raises(RigError, match="bench://broken: raised KeyError"):
            open_rig("bench://broken")
        with pytest.raises(RigError, match="cannot choose axes"):
            open_rig("bench://1", axes=["1", "2"])
        with pytest.raises(RigError, match="bench://NAME"):
            open_rig("other://1")
        assert rig_address().fullmatch("bench://1")
        assert connect_form()["address"]["hint"].endswith("; bench://NAME")
    assert not rig_address().fullmatch("bench://1")


@pytest.mark.parametrize("name", ["play", "limits", "set_voltage", "_ramp", "_retreated", "retreat"])
def test_no_rig_replaces_what_limits_and_retreat_rely_on(name):
    with pytest.raises(TypeError, match=f"Own: replaces {name} of AbstractRig; a rig writes only nearest_rate, _read"):
        type("Own", (AbstractRig,), {name: None})


@pytest.mark.parametrize("name", ["play", "limits", "read", "close", "__exit__", "__getattribute__", "_ramp"])
def test_no_base_of_a_rig_replaces_what_limits_and_retreat_rely_on(name):
    mixin = type("Mixin", (), {name: None})
    with pytest.raises(TypeError, match=rf"Own: replaces {name} \(in Mixin\) of AbstractRig"):
        type("Own", (mixin, FakeRig), {})


@pytest.mark.parametrize("name", ["play", "_ramp", "_reading"])
def test_no_attribute_of_a_rig_hides_what_limits_and_retreat_rely_on(name):
    class Own(FakeRig):
        def __init__(self):
            setattr(self, name, None)

    with pytest.raises(TypeError, match=f"Own: sets {name}, a method of AbstractRig"):
        Own()


def test_a_rig_whose_bases_hide_the_check_of_its_class_cannot_be_constructed():
    class Silent:
        def __init_subclass__(cls):
            pass

    class Own(Silent, FakeRig):
        def play(self, excitation):
            pass

    with pytest.raises(TypeError, match="Own: replaces play of AbstractRig"):
        Own()


def test_a_base_of_a_rig_may_have_what_a_driver_writes():
    class Mixin:
        def _wait(self, seconds):
            self.instrument.wait(seconds)

        def home(self):
            return self.set_voltage(0.0)

    assert type("Own", (Mixin, FakeRig), {})().home() == 0.0


def test_a_baseline_of_a_plug_in_is_compared(tmp_path):
    code = "from dehyst.baselines import BASELINES\ndef fit(records):\n    return BASELINES['linear ratio'](records)\n"
    code += "def fail(records):\n    raise KeyError('slope')\n"
    write_distribution(tmp_path, "rival", {"baselines": "flat = rival:fit\nbroken = rival:fail"}, code)
    dehyst.write_record(tmp_path / "a.csv", loops())
    chosen = [word for name in ("flat", "linear ratio", "broken") for word in ("--only", name)]
    with plugged_in(tmp_path):
        status, out, _ = run("compare", tmp_path / "a.csv", "--json", *chosen)
        flat, linear, broken = json.loads(out)["models"]
    assert status == 0
    assert (flat["model"], linear["model"]) == ("flat", "linear ratio")
    assert flat["errors"] == linear["errors"]
    assert broken["said"].startswith("broken: a plug-in raised KeyError: 'slope'")


def test_a_target_of_a_plug_in_is_exported_to(tmp_path):
    write_distribution(tmp_path, "writes", {"targets": ".st = writes:TARGET"}, TARGET)
    model = tmp_path / "model.json"
    dehyst.Actuator(dehyst.MaxwellSlip([1e-6], [1e6]), dehyst.Spring([0, 1e-5], [0, 80]), limits=(0, 90)).save(model)
    with plugged_in(tmp_path):
        status, out, _ = run("export", model, tmp_path / "a.st", "--json")
        assert (status, json.loads(out)["file"]) == (0, str(tmp_path / "a.st"))
        assert (tmp_path / "a.st").read_text() == "90.0 False False"
        assert run("export", model, tmp_path / "a.st", "--name", "x")[0] == 2
        assert run("export", model, tmp_path / "a.st")[0] == 2
        (tmp_path / "a.st").write_text("(* dehyst: a line *)")
        assert run("export", model, tmp_path / "a.st")[0] == 0
        (tmp_path / "b.st").write_text("mine")
        assert run("export", model, tmp_path / "b.st")[0] == 2
        assert (tmp_path / "b.st").read_text() == "mine"
        assert exports()[".st"] == ("a line", "Nothing but a line.", ".st")
    assert ".st" not in exports()


@pytest.mark.parametrize(
    ("body", "status", "message"),
    [
        ("raise ModelError(f'{path}: has creep')", 2, "a.st: has creep"),
        ("raise RuntimeError('broken')", 2, "a plug-in raised RuntimeError: broken"),
        ("raise SystemExit(0)", 2, "a plug-in raised SystemExit: 0"),
        ("raise OSError(errno.ENOSPC, 'No space left on device')", 2, "No space left on device); make room"),
        ("path.with_name('no').joinpath('x').write_text('')", 2, "a.st: cannot be written (No such file"),
        ("open('/none/of/mine')", 2, "report it to its author"),
        ("raise KeyboardInterrupt", 130, ""),
        ("signal.raise_signal(signal.SIGTERM)", 143, ""),
        ("path.unlink(); return Written({}, 'done')", 2, "a.st: a plug-in did not write "),
        ("path.with_suffix('.log').write_text(''); return Written({}, 'done')", 2, "wrote a.log too"),
        ("return None", 2, "write returned a NoneType"),
        ("return Written({'a': {1}}, 'done')", 2, "set is not JSON serializable"),
        ("return Written({}, 5)", 2, "need a dictionary, and text"),
    ],
)
def test_a_target_that_fails_leaves_the_files_as_they_were(tmp_path, body, status, message):
    code = "import errno, signal\nfrom dehyst import ModelError\nfrom dehyst.exports import Target, Written\n"
    code += f"def write(loop, path, options):\n    path.write_text('half')\n    {body}\nTARGET = Target('x', write)\n"
    # A module of its own for each body: modules stay imported.
    name = f"fails_{zlib.crc32(body.encode())}"
    write_distribution(tmp_path / "plug", name, {"targets": f".st = {name}:TARGET"}, code)
    model, out = tmp_path / "model.json", tmp_path / "out"
    out.mkdir()
    dehyst.Actuator(dehyst.MaxwellSlip([1e-6], [1e6]), dehyst.Spring([0, 1e-5], [0, 80]), limits=(0, 90)).save(model)
    with plugged_in(tmp_path / "plug"):
        found, shown, _ = run("export", model, out / "a.st", "--json")
        assert found == status
        assert message in (json.loads(shown)["error"]["message"] if message else "")
        assert ".dehyst-" not in shown
        assert list(out.iterdir()) == []
        (out / "a.st").write_text("before")
        assert run("export", model, out / "a.st", "--force")[0] == status
        assert [one.name for one in out.iterdir()] == ["a.st"]
        assert (out / "a.st").read_text() == "before"


def test_a_target_whose_files_fail_and_a_rig_and_a_baseline_that_exit_are_named(tmp_path):
    code = "import dehyst.exports as e, dehyst.instruments as i\ndef leave(*_): raise SystemExit(0)\n"
    code += "TARGET = e.Target('x', leave, (), leave)\nRIG = i.Scheme('bench://NAME', leave)\n"
    groups = {"targets": ".st = leaves:TARGET", "rigs": "bench = leaves:RIG", "baselines": "flat = leaves:leave"}
    write_distribution(tmp_path, "leaves", groups, code)
    model = tmp_path / "model.json"
    dehyst.Actuator(dehyst.MaxwellSlip([1e-6], [1e6]), dehyst.Spring([0, 1e-5], [0, 80]), limits=(0, 90)).save(model)
    with plugged_in(tmp_path):
        status, _, err = run("export", model, tmp_path / "a.st")
        assert (status, "SystemExit: 0" in err) == (2, True)
        with pytest.raises(RigError, match=r"bench://x: .*SystemExit: 0"):
            open_rig("bench://x")
        with pytest.raises(PluginError, match=r"flat: .*SystemExit: 0"):
            BASELINES["flat"]([loops()])


def test_a_suffix_that_nobody_registers_is_no_folder(tmp_path):
    model = tmp_path / "model.json"
    dehyst.Actuator(dehyst.MaxwellSlip([1e-6], [1e6]), dehyst.Spring([0, 1e-5], [0, 80]), limits=(0, 90)).save(model)
    status, _, err = run("export", model, tmp_path / "stage.mm", "--no-measure")
    assert (status, ".wasm or .fmu" in err) == (2, True)
    assert not (tmp_path / "stage.mm").exists()
    (tmp_path / "stage.mm").mkdir()
    for name in ("stage.mm", "piezo-1.5"):
        assert run("export", model, tmp_path / name, "--no-measure")[0] == 0


def test_without_pytest_the_contracts_name_their_extra(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("dehyst.testing")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pytest", None)
    with pytest.raises(MissingExtraError, match=r"dehyst\[testing\]"):
        importlib.import_module("dehyst.testing")


@pytest.mark.slow
def test_the_example_of_a_plug_in_passes_its_tests(tmp_path):
    """Its own tests are the contracts; its lines are few enough to read."""
    project = places.EXAMPLES / "plugin"
    describe(project, tmp_path)
    given = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (tmp_path, project / "src", *sys.path)))}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", str(project)]
    done = subprocess.run(command, cwd=project, env=given, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    listed = subprocess.run([*DEHYST, "--version"], env=given, capture_output=True, text=True, timeout=60, check=True)
    rows = ["reader of .wav", "rig line", "baseline polynomial", "export to .st"]
    assert listed.stdout.splitlines()[1:] == [f"{row} of dehyst-example 0.1.0" for row in rows]
    assert sum(path.read_text().count("\n") for path in (project / "src").rglob("*.py")) < 150


def test_an_error_of_a_plug_ins_own_class_arrives(tmp_path):
    code = "from dehyst import ModelError\nclass Own(ModelError): pass\ndef read(*_): raise Own('of its own')\n"
    write_distribution(tmp_path, "own", {"readers": ".daq = own:read"}, code)
    (tmp_path / "a.daq").write_text("x")
    with plugged_in(tmp_path), pytest.raises(ModelError, match="of its own"):
        dehyst.read(tmp_path / "a.daq")

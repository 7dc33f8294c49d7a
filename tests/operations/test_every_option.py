"""Every option of every command, on every kind of input: it changes what the command does, or is refused by its name.

A walk over all operations. `VALUES` holds what is tried for each option, for each rare one, and for each key of
--columns; `CASES` the invocations to which it is added. An option without an entry fails: what a new option changes
must be shown here.
"""

import contextlib
import json
import re
import shlex
import shutil
from dataclasses import dataclass, field, replace
from importlib import import_module
from itertools import pairwise
from unittest.mock import MagicMock

import click
import coupled_stage
import numpy as np
import pytest
from click.testing import CliRunner

import dehyst
import dehyst.exports
import dehyst.fleet
from dehyst.cli import main
from dehyst.cli.workbench import workbench
from dehyst.control import Compensator
from dehyst.operations.declaration import flag
from dehyst.operations.files import RECORD
from dehyst.operations.registry import ENTRIES, find
from dehyst.records import write_columns
from dehyst.virtual import PlayActuator
from examples import NIGHTLY

AXES = "x=vx_V:x_um, y=vy_V:y_um"
# What is tried, by parameter; of a command alone, by "command parameter". Values are no defaults. Keys of --columns are
# after a colon, rare parameters are JSON.
VALUES = {
    "output": "-o other.csv",
    "report": "--report other.html",
    "json": "--json",
    "force": "--force",
    "all": "--all",
    # How files are read.
    "columns:max_size": "max_size=0.0001",
    "columns:time": "time=clock_s",
    "columns:voltage": "voltage=monitor_V",
    "columns:displacement": "displacement=back_um",
    "columns:voltage_scale": "voltage=voltage_V*1.1",
    "columns:displacement_scale": "displacement=monitor_V*0.08um/V",
    "columns:names": "names=-|-|displacement:um|voltage:V|-|time:s",
    "columns:join": "join=more.csv",
    "columns:rate": "rate=300",
    "columns:decimal": "decimal=comma",
    "columns:wanted": "wanted=other_um",
    "columns:temperature": "temperature=clock_s:C",
    "columns:axes": AXES,
    # Paths.
    "limits": "--limits 5 60",
    "slew_rate": "--slew-rate 7",
    "start": "--start bottom",
    "home": "--no-home",
    "present": "--present 20",
    "zero": "--zero bottom",
    "lag": "--lag",
    "table": "--table cycle.csv",
    "temperature": "--temperature 35",
    "temperatures": [10, 60],
    "cycles": "--cycles 2",
    "approach": 3,
    "start_up": 5,
    "tolerance": 0.5,
    # Scans.
    "low": "--low 2.5",
    "high": "--high 6.5",
    "y_low": "--y-low 2.5",
    "y_high": "--y-high 6.5",
    "frequency": "--frequency 0.7",
    "sample_rate": "--sample-rate 60",
    "turns": "--turns 0.2",
    "speed": "--speed 2.5",
    "acceleration": "--acceleration 15",
    "rising": 0.7,
    "rounding": "cosine",
    "lines": "--lines 6",
    "slow": "ramp",
    "back": 2,
    "revolutions": "--revolutions 3",
    "constant": "angular",
    "ratio": "--ratio 2 3",
    "phase": 20.0,
    "levels": "--levels 2,4,5",
    "dwell": "--dwell 2",
    "edge": 2.0,
    "scan shape": "trapezoid",
    # Models.
    "history": "--history kept",
    "goal": "--goal 50",
    "trajectory": "--trajectory path.csv",
    "seconds": 5,
    "level": 0.5,
    "precision": 0.01,
    "repeats": 20,
    "number": "--number float",
    "period": "--period 0.01",
    "preview": "--preview",
    "name": "--name other",
    "measure": "--no-measure",
    "fmu": "--fmu 2.0",
    "kind": "--kind actuator",
    # Identification.
    "validate": "--validate again.csv",
    "traces": "--traces traces.npz",
    "method": "breakpoints",
    "elements": 3,
    "structure": "--structure auto",
    "norm": "l2",
    "knots": 5,
    "slope_floor": 0.9,
    "branch": "ascending",
    "delay": 0.001,
    "sensor_lag": "--sensor-lag 0",
    "shared_datum": True,
    "time_limit": "--time-limit 1e-6",
    "drift": False,
    # What only some commands have.
    "pace": "rate",
    "base": "--base 3",
    "steps": "--steps 4",
    "majors": "--majors 3",
    "random": "--random 4",
    "lowest": 5.0,
    "count": 4,
    "highest": "--highest 40",
    "hold": "--hold 2",
    "ramp": 0.7,
    "axes": "--axes a,b",
    "seed": 5,
    "model": "--model model.json",
    "lead": "--lead 0.1",
    "truths": "--truths play",
    "only": "--only 'linear ratio'",
    "dry_run": "--dry-run",
    "protocol": "--protocol again.csv",
    "rounds": 5,
    "actuator": "--actuator creep",
    "coupling": "--coupling 7",
    "hysteretic": 2,
    "host": "0.0.0.0",
    "port": "--port 4711",
    "noise": 5,
    "wave_points": 100,
    "fault": "--fault drop",
    "epics": "--epics PIEZO",
    "ageing": "gain=-7,seconds=60",
    "path": "--path way.csv",
    "updated": "--updated updated.json",
    "memory": 3,
    "zero_drifts": False,
    "resume": "--resume",
    "browser": "--no-browser",
    "max_size": "--max-size 3",
    "excite shape": "triangle",
    "excite sample_rate": "--sample-rate 30",
    "excite back": "--back",
    "excite limits": "--limits 0 20",
    "excite slew_rate": "--slew-rate 1",
    "rig slew_rate": "--slew-rate 7",
    "rig seconds": "--seconds 0.1",
    "demo report": "--no-report",
    "calibrate axes": "--axes 1,2",
    "rig axes": "--axes 2",
    "rig fault": "--fault drop",
    "fleet scheduler": "--scheduler tcp://host:8786",
    "fleet output": "-o other.parquet",
}
# What these do is to refuse: more than they allow.
BOUNDS = {"columns:max_size": "max_size", "speed": "speed", "limits": "limits"}
_KEYS = [name for name in VALUES if name.startswith("columns:")]


@dataclass(frozen=True)
class Case:
    """A command with one kind of input.

    `more`: words for both runs, without and with an option. `values`: what is tried instead of `VALUES`. `exempt`:
    options that change nothing that can be seen here, with the reason. `caught`: functions whose calls are printed, and
    which run only if a plus is before their name. `foreign`: an output that --force replaces. `only`: options to try,
    if not all.
    """

    words: str
    more: dict[str, str] = field(default_factory=dict)
    values: dict[str, str] = field(default_factory=dict)
    exempt: dict[str, str] = field(default_factory=dict)
    caught: tuple[str, ...] = ()
    foreign: str = "out.csv"
    only: tuple[str, ...] = ()


_BASE = {
    "columns:join": "--columns displacement=extra_um",
    "columns:rate": "--columns 'voltage=2:V, displacement=3:um'",
}
_UNTIMED = "--columns 'names=-|-|displacement:um|-|-|-'"
_TWO = "v=voltage_V:displacement_um, w=monitor_V:back_um"
_OF_AXES = {
    "columns:axes": "x=vx_V:bx_um, y=vy_V:y_um",
    "columns:names": "names=time:s|vx_V|vy_V|-|y_um|-|-|x_um|-",
    "columns:join": "join=morestage.csv",
    "columns:displacement_scale": "displacement=*0.2um/V",
    "columns:voltage_scale": "voltage=*1.1",
}
_AXES_BASE = {
    "columns:displacement_scale": "--columns 'x=vx_V:sx_V, y=vy_V:sy_V'",
    "columns:voltage_scale": f"--columns '{AXES}'",
    "columns:join": "--columns 'x=vx_V:ex_um, y=vy_V:y_um'",
    "columns:rate": "--columns 'names=-|vx_V|vy_V|x_um|y_um|-|-|-|-'",
}
_SCANS = {
    "triangle": "--low 2 --high 6 --frequency 0.5 --sample-rate 50",
    "raster": "--low 2 --high 6 --frequency 0.5 --lines 4 --sample-rate 50",
    "spiral": "--low 2 --high 6 --frequency 0.5 --revolutions 2 --sample-rate 50",
    "lissajous": "--low 2 --high 6 --frequency 0.5 --sample-rate 50",
    "steps": "--levels 2,4 --dwell 1 --acceleration 20 --sample-rate 50",
}
_PLAN = ("dehyst.operations.bench.Plan",)
_OPEN = ("dehyst.operations.bench.open_rig",)
_LONG = "an experiment on an emulated instrument takes minutes: tests/calibration"
_PRINTED = dict.fromkeys(("json", "dry_run", "output"), f"of what is printed or written; {_LONG}")
_BENCHES = (
    *("+dehyst.operations.bench.VirtualBench", "+dehyst.operations.bench._driven"),
    *("+dehyst.operations.bench.actual_limits", "+dehyst.operations.bench.spread_coupling"),
    *("dehyst.operations.bench.Server", "dehyst.operations.bench.serve_ioc"),
)
_STEP = dict.fromkeys(("slew_rate", "preview"), "--period 0.02")
_OF_C = {"force": "of a folder that is there: see below", "fmu": "beside --no-measure, which an FMU refuses"}
# Functions that end the command.
ENDS = ("open_rig", "serve", "demand_folder")
_STUDY = {"json": "a study takes a minute: tests/studies", "report": "as --json"}
_RIG = dict.fromkeys(("seconds",), "of the clock")
CASES = {
    "show": [
        Case(
            "record.csv",
            _BASE | {"force": "-o out.csv"},
            {"columns:axes": "v=voltage_V:displacement_um, w=monitor_V:back_um"},
        ),
        Case(f"stage.csv --columns '{AXES}'", _AXES_BASE, _OF_AXES, {"columns:axes": "see above"}),
        Case("stage.json"),
        Case("texts/commas.txt", only=("columns:decimal",)),
    ],
    "check": [
        Case("model.json texts/commas.txt", only=("columns:decimal",)),
        Case("model.json record.csv", _BASE),
        Case(
            "model.json record.csv --history kept",
            values={"history": "--history others"},
            exempt={"force": "of a picture in the folder of a history"},
            only=("history", "force", "json", "goal"),
        ),
        Case("stage.json stage.csv", _AXES_BASE, _OF_AXES),
    ],
    "update": [
        Case("model.json texts/commas.txt -o new.json", only=("columns:decimal",)),
        Case("model.json record.csv -o new.json", _BASE, foreign="new.json"),
        Case("stage.json stage.csv -o new.json", _AXES_BASE, _OF_AXES, foreign="new.json"),
    ],
    "simulate": [
        Case("warm.json record.csv -o out.csv", only=("temperature", "columns:temperature")),
        Case("model.json texts/commas.txt -o out.csv", only=("columns:decimal",)),
        Case(
            "model.json record.csv -o out.csv",
            _BASE
            | {"columns:join": "--columns voltage=extra_V", "columns:rate": "--columns 'names=-|voltage:V|-|-|-|-'"},
            {"home": "--home", "columns:names": "names=-|-|-|voltage:V|-|-"},
        ),
        Case(
            "stage.json stage.csv -o out.csv",
            _AXES_BASE | {"columns:join": "--columns 'x=ex_V, y=vy_V'"},
            _OF_AXES
            | {
                "home": "--home",
                "columns:axes": "x=sx_V, y=vy_V",
                "columns:names": "names=time:s|vy_V|vx_V|-|-|-|-|-|-",
            },
        ),
    ],
    "scan": [
        *(Case(f"{kind} {words} -o out.csv", values={"kind": "--kind"}) for kind, words in _SCANS.items()),
    ],
    "compensate": [
        Case("warm.json record.csv -o out.csv", only=("temperature", "columns:temperature")),
        Case("model.json texts/commas.txt -o out.csv", only=("columns:decimal",)),
        Case("model.json record.csv -o out.csv", _BASE | {"present": "--home", "columns:rate": _UNTIMED}),
        Case("model.json scan.csv -o out.csv", {"present": "--home"}, {"columns:displacement": "displacement=y_um"}),
        Case(
            "model.json scan.csv -o out.csv --table cycle.csv",
            values={"table": "--table other.csv", "columns:displacement": "displacement=y_um"},
            exempt={"tolerance": "a model without creep settles in one cycle: tests/control"},
        ),
        Case("stage.json stage.csv -o out.csv", _AXES_BASE, _OF_AXES),
        Case(
            "stage.json scan.csv -o out.csv",
            only=("table", "columns:axes"),
            values={"columns:axes": "x=x_um, y=middle"},
        ),
    ],
    "run": [
        Case("sim://model.json --model model.json --path texts/commas.txt", only=("columns:decimal",)),
        Case(
            "sim://model.json --model model.json --path record.csv",
            _BASE | {"columns:rate": _UNTIMED, "force": "-o out.csv"},
            {"model": "--model other.json", "path": "--path way.csv", "slew_rate": "--slew-rate 700"},
        ),
    ],
    "insight": [
        Case("model.json record.csv --options REPEATS --trajectory texts/commas.txt", only=("columns:decimal",)),
        Case(
            "model.json record.csv --options NONE",
            _BASE | {"limits": "--all"},
            exempt={"trajectory": "needs intervals: see below", "seconds": "of advice, which is not needed: see below"},
        ),
        Case(
            "model.json record.csv --options REPEATS --trajectory path.csv",
            {"force": "-o out.csv"},
            {"repeats": 21, "trajectory": "--trajectory way.csv"},
            only=("trajectory", "columns:wanted", "zero", "start", "output", "force", "level", "precision"),
        ),
        Case("model.json short.csv --options NONE", values={"seconds": 0.02}, only=("seconds",)),
        Case(
            "stage.json stage.csv --options NONE",
            _AXES_BASE,
            _OF_AXES,
            only=("trajectory", "zero", "start", "output", "force", "columns:voltage", "columns:axes"),
        ),
    ],
    "identify": [
        Case("texts/commas.txt --structure maxwell_slip --options FEW", only=("columns:decimal",)),
        Case(
            "record.csv --structure maxwell_slip --options FEW -o out.json",
            _BASE,
            {"columns:axes": _TWO},
            {"columns:axes": "see below", "structure": "see below"},
            foreign="out.json",
        ),
        Case(
            "record.csv --options ANTI",
            only=("branch",),
        ),
        Case("record.csv again.csv --structure maxwell_slip --options FEW -o out.json", only=("shared_datum",)),
        Case(
            "record.csv --time-limit 0.5 --all",
            values={"structure": "--structure maxwell_slip"},
            only=("structure", "time_limit"),
        ),
        Case("record.csv --options FEW", only=("structure",)),
        Case(
            f"stage.csv --columns '{AXES}' --structure maxwell_slip --options FEW -o out.json",
            {"columns:displacement_scale": "", "columns:voltage_scale": ""},
            {"elements": 4, "columns:voltage_scale": "voltage=*1.1"},
            only=("traces", "zero", "columns:voltage", "elements", "columns:voltage_scale"),
        ),
    ],
    "export": [
        Case("model.json out --no-measure", _STEP, {"measure": "--measure"}, _OF_C),
        Case("model.json earlier --no-measure", only=("force",)),
        Case("model.json out.wasm", _STEP, foreign="out.wasm"),
        Case("model.json out.fmu --fmu 3.0", _STEP, caught=("dehyst.exports.targets.export_fmu",), foreign="out.fmu"),
        Case(
            "model.json out.fmu --fmu 3.0 --kind actuator",
            values={"kind": "--kind compensator"},
            caught=("dehyst.exports.targets.export_fmu",),
            foreign="out.fmu",
        ),
        Case("stage.json out --no-measure", _STEP, {"measure": "--measure"}, _OF_C),
    ],
    "calibrate": [
        Case(
            "sim://play -o out",
            {"columns:max_size": "--protocol again.csv"},
            exempt=_PRINTED,
            caught=(*_PLAN, *_OPEN),
            foreign="out/report.html",
        ),
        Case(
            "pi://localhost/1,2 -o out",
            values={"axes": "--axes 2,1", "limits": "--limits 1=5 60", "slew_rate": "--slew-rate 1=7"},
            exempt=_PRINTED,
            caught=(*_PLAN, *_OPEN),
            foreign="out/report.html",
        ),
    ],
    "compare": [
        Case("texts/commas.txt --only 'linear ratio'", only=("columns:decimal",)),
        Case(
            "record.csv --only 'linear ratio'",
            _BASE | {"force": "-o out.csv", "lead": "--validate again.csv"},
            {"only": "--only Duhem"},
            dict.fromkeys(
                (f"columns:{name}" for name in ("names", "voltage", "voltage_scale", "time")),
                "errors in % are alike at any scale of volts and time",
            ),
        ),
        Case("--truths play --only 'linear ratio'", only=("lead", *_KEYS)),
    ],
    "excite": [
        Case("raised-cosine 50 30 -o out.csv"),
        Case("descending-tops 50 -o out.csv"),
        Case("reversal-curves 50 -o out.csv"),
        Case("minor-loop 10 30 --highest 50 -o out.csv"),
        Case("staircase 50 -o out.csv --hold 1"),
        Case("stage 50 40 -o out.csv --steps 3 --cycles 3", values={"cycles": "--cycles 20"}),
        Case("homing 50 -o out.csv", exempt={"model": "instead of a voltage"}),
        Case(
            "homing --model model.json -o out.csv",
            values={"model": "--model other.json"},
            exempt={
                "pace": "of legs of different heights, which this homing has not",
                "hold": "of creep: tests/control",
            },
        ),
    ],
    "fleet": [Case("records -o out.parquet", foreign="out.parquet")],
    "rig serve": [
        Case("--seconds 0", caught=_BENCHES, exempt=_RIG),
        Case("--axes 2", values={"axes": "--axes 3"}, caught=_BENCHES, exempt=_RIG | {"ageing": "within the stage"}),
    ],
    "workbench": [Case("out", caught=("dehyst.cli.workbench.serve",), exempt={"browser": "opens a browser"})],
    "demo": [Case("-o out", caught=("dehyst.studies.demo.demand_folder",), exempt=_STUDY)],
    "paper": [Case("-o out", caught=("dehyst.studies.paper.run.demand_folder",), exempt=_STUDY)],
}
_OPTIONS = {
    "REPEATS": {"repeats": 20},
    "NONE": {"repeats": 0},
    "FEW": {"elements": 5},
    "ANTI": {"method": "antisymmetric"},
}


def words_of(line):
    """Return words, those of --columns and of --options together."""
    words, columns, options, rest = shlex.split(line), [], {}, []
    while words:
        word = words.pop(0)
        if word == "--columns":
            text = words.pop(0)
            # A key that is given again counts alone; `displacement=extra_um` and a scale of it go together.
            columns = [one for one in columns if one.split("=")[0] not in text] + [text]
        elif word == "--options":
            given = words.pop(0)
            options |= _OPTIONS[given] if given in _OPTIONS else json.loads(given)
        else:
            rest.append(word)
    rest += ["--columns", ", ".join(columns)] if columns else []
    return rest + (["--options", json.dumps(options)] if options else [])


def tried(case, name, command, operation):
    """Return the words of the trial of an option, or of a key of --columns."""
    own = VALUES.get(f"{command.split()[0]} {name}")
    value = case.values.get(name, own if own is not None else VALUES.get(name))
    if value is None:
        return None
    if name.startswith("columns:"):
        return f"--columns {shlex.quote(value)}"
    one = operation.parameter(name)
    return f"--options {shlex.quote(json.dumps({name: value}))}" if one is not None and one.rare else value


def names_of(operation):
    """Return the options of an operation, with the keys of --columns."""
    names = [one.name for one in operation.parameters if not one.positional and one.name != "columns"]
    if operation.parameter("columns"):
        names += _KEYS
    names += ["force"] * operation.writes + ["all"] * operation.details + ["json"] * operation.returns
    return names


def of_this_run(command, names):
    """Return the names that are tried: one reader serves all commands, and a push tries its keys at three of them."""
    every = NIGHTLY or command in ("show", "simulate", "compensate")
    return [name for name in names if every or not name.startswith("columns:")]


def operation_of(command):
    return workbench if command == "workbench" else find(command)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with what commands read."""
    folder = tmp_path_factory.mktemp("bench")
    t, v, y = measured(0, drift=0.02)
    y = np.interp(t - 2e-3, t, y)
    columns = {"time_s": t, "voltage_V": v, "displacement_um": y}
    write_columns(folder / "record.csv", columns | {"monitor_V": 1.1 * v + 0.1, "back_um": 1.2 * y, "clock_s": 2 * t})
    _, _, again = measured(1)
    write_columns(folder / "again.csv", {"time_s": t, "voltage_V": v, "displacement_um": again + 0.3})
    write_columns(folder / "more.csv", {"time_s": t, "extra_um": 0.9 * y, "extra_V": 0.9 * v})
    fit = dehyst.identify(dehyst.Record(t, v, 1e-6 * y, "record"), structure="maxwell_slip", elements=6)
    replace(fit.actuator, delay=2e-3).save(folder / "model.json")
    replace(fit.actuator, thermal=dehyst.Thermal(-0.01, 0.0, 20.0)).save(folder / "warm.json")
    record, _ = coupled_stage.excited(steps=4, cycles=4)
    of_axes = {f"v{axis}_V": record.voltage[:, k] for k, axis in enumerate("xy")}
    of_axes |= {f"{axis}_um": 1e6 * record.displacement[:, k] for k, axis in enumerate("xy")}
    more = {"sx_V": 5 * of_axes["x_um"], "sy_V": 5 * of_axes["y_um"], "bx_um": 1.1 * of_axes["x_um"]}
    write_columns(folder / "stage.csv", {"time_s": record.time, **of_axes, **more, "clock_s": 2 * record.time})
    other = {"ex_um": 0.9 * of_axes["x_um"], "ex_V": 0.9 * of_axes["vx_V"]}
    write_columns(folder / "morestage.csv", {"time_s": record.time, **other})
    read = dehyst.records.read(folder / "stage.csv", axes="vx_V:x_um vy_V:y_um")
    found = dehyst.identify_stage(read, structure="maxwell_slip", elements=6)
    replace(found.stage, recorded_columns=("vx_V:x_um", "vy_V:y_um")).save(folder / "stage.json")
    # All numbers have three decimals and a comma, which could group digits as well.
    lines = (f"{a:.3f}\t{b:.3f}\t{c:.3f}\n" for a, b, c in zip(t + 1, v + 1, y - y.min() + 1, strict=True))
    (folder / "texts").mkdir()
    (folder / "texts" / "commas.txt").write_text(
        "time_s\tvoltage_V\tdisplacement_um\n" + "".join(lines).replace(".", ",")
    )
    few = v.size // 3
    write_columns(folder / "short.csv", {"time_s": t[:few], "voltage_V": v[:few], "displacement_um": y[:few]})
    path = np.linspace(2, 6, 60)
    write_columns(folder / "way.csv", {"time_s": np.arange(60) / 50, "displacement_um": 0.9 * path})
    write_columns(folder / "path.csv", {"time_s": np.arange(60) / 50, "displacement_um": path, "other_um": path[::-1]})
    with contextlib.chdir(folder):
        words = shlex.split(f"scan raster {_SCANS['raster']} -o scan.csv")
        assert CliRunner().invoke(main, words).exit_code == 0
    (folder / "records").mkdir()
    shutil.copy(folder / "record.csv", folder / "records")
    dehyst.exports.export(Compensator(fit.actuator), folder / "earlier", measure=False)
    replace(fit.actuator, limits=(5.0, 80.0)).save(folder / "other.json")
    return folder


def measured(seed, drift=0.0, samples=40):
    """Time [s], voltage [V] and displacement [um] of a record."""
    turns = np.array([0, 100, 0, 100, 0, 60, 0, 30, 0, 100, 40, 100, 0])
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples // 2 + 1) / (samples // 2))
    v = np.concatenate([[0.0], *(a + (b - a) * rise for a, b in pairwise(turns))])
    t = np.arange(v.size) / 1000
    y = 1e6 * PlayActuator(stroke=10e-6, highest=100.0, plays=50, noise=2e-9, seed=seed, width=0.5).play(v)
    return t, v, y + drift * np.ptp(y) * t / t[-1]


@contextlib.contextmanager
def connected(scheduler):
    """Stand for the workers of a fleet."""
    click.echo(f"computed by {scheduler}")
    yield None


def in_this_process(_, paths, read):
    """Yield the rows of a fleet."""
    yield from (dehyst.fleet.row_of(read, name, path) for name, path in paths.items())


def described(value):
    """Return what is seen of an argument."""
    if isinstance(value, Compensator):
        return [value.limits, value.slew_rate, value.period, value.preview, value.state.displacement]
    return re.sub(r" at 0x[0-9a-f]+", "", repr(value))


def watched(patch, target):
    """Print each call of a function, and run it only if the name begins with a plus."""
    module, _, name = target.removeprefix("+").rpartition(".")
    original = getattr(import_module(module), name)

    def seen(*arguments, **named):
        shown = [described(one) for one in arguments], {key: described(one) for key, one in named.items()}
        click.echo(f"{name}: {shown}")
        if target.startswith("+"):
            return original(*arguments, **named)
        if name in ENDS:
            raise SystemExit(3)
        return MagicMock(port=1)

    patch.setattr(import_module(module), name, seen)


class Walk:
    """Commands that run in a copy of the bench, each once."""

    def __init__(self, bench, folder, monkeypatch):
        self.bench, self.folder, self.patch, self.known = bench, folder, monkeypatch, {}
        monkeypatch.setattr(dehyst.fleet, "_connected", connected)
        monkeypatch.setattr(dehyst.fleet, "_computed", in_this_process)

    def outcome(self, words, caught=(), foreign=None):
        """Return status, text and files of a command."""
        if (known := self.known.get((*words, foreign))) is not None:
            return known
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(self.bench, self.folder)
        if foreign is not None:
            (self.folder / foreign).parent.mkdir(exist_ok=True)
            (self.folder / foreign).write_text("foreign\n")
        before = {path: path.stat().st_mtime_ns for path in self.folder.rglob("*")}
        with self.patch.context() as patch, contextlib.chdir(self.folder):
            for target in caught:
                watched(patch, target)
            done = CliRunner().invoke(main, words)
        assert done.exception is None or isinstance(done.exception, SystemExit), (words, done.exception)
        files = {
            str(path.relative_to(self.folder)): path.read_bytes()
            for path in self.folder.rglob("*")
            if path.is_file() and before.get(path) != path.stat().st_mtime_ns
        }
        # Seconds of a fit, and nanoseconds of a sample, in the table of dehyst compare.
        text = re.sub(r"\d+\.\d\d +\d+\.\d +(\d+\.\d|-)( +\d+)$", r"\2", done.output, flags=re.MULTILINE)
        self.known[*words, foreign] = done.exit_code, text, files
        return self.known[*words, foreign]

    def effect(self, command, case, name, operation):
        """Return "changed", "refused" by its name, or what else became of an option."""
        base = f"{command} {case.words} {case.more.get(name, '')}"
        trial = tried(case, name, command, operation)
        foreign = case.foreign if name == "force" else None
        before, after = (self.outcome(words_of(line), case.caught, foreign) for line in (base, f"{base} {trial}"))
        if after == before:
            return "no effect"
        if after[0] == 2 and BOUNDS.get(name, "\0") in after[1] and "no effect" not in after[1]:
            return "changed"
        if after[0] == 2:
            return "refused" if refused(name, after[1]) else f"{trial}: {after[1][-300:]}"
        return "changed"


def refused(name, text):
    """Return whether a message names an option or a key of --columns."""
    if name.startswith("columns:"):
        key = name.removeprefix("columns:").removesuffix("_scale")
        return "--columns" in text or re.search(rf"\b({key}|axes|axis)\b", text) is not None
    return any(word in text for word in (flag(name), flag(name, off=True), f"{name} in --options"))


@pytest.mark.parametrize("command", list(CASES))
def test_each_option_changes_something_or_is_refused_by_its_name(bench, tmp_path, monkeypatch, command):
    walk, operation = Walk(bench, tmp_path / "run", monkeypatch), operation_of(command)
    names = names_of(operation)
    assert not [name for name in names if tried(CASES[command][0], name, command, operation) is None]
    wrong, works = [], set()
    for case in CASES[command]:
        for name in of_this_run(command, names):
            if case.only and name not in case.only:
                continue
            what = "changed" if name in case.exempt else walk.effect(command, case, name, operation)
            if what == "changed":
                works.add(name)
            elif what != "refused":
                wrong.append(f"{case.words}: {name}: {what}")
    wrong += [f"{name}: nowhere an effect" for name in sorted({*names} - works) if not name.startswith("columns:")]
    assert not wrong, "\n".join(wrong)


def test_every_key_of_columns_has_an_effect_somewhere():
    """Each is shown by the walk of some command: `show` has all that are of a record."""
    assert {key.removeprefix("columns:") for key in _KEYS} >= {*RECORD, "wanted", "axes"}


def test_all_commands_are_walked():
    assert {*ENTRIES, "workbench"} == {*CASES}


@pytest.mark.nightly
def test_all_commands_are_repeatable(bench, tmp_path, monkeypatch):
    for command, cases in CASES.items():
        words = words_of(f"{command} {cases[0].words}")
        first, second = (Walk(bench, tmp_path / "run", monkeypatch).outcome(words, cases[0].caught) for _ in range(2))
        assert first == second, command

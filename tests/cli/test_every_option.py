"""Every option of every command, on every kind of input: it changes what the command does, or is refused by its name.

A walk over all commands. `VALUES` holds what is tried for each option, `CASES` the invocations to which it is added.
An option without an entry fails: what a new option changes must be shown here.
"""

import contextlib
import re
import shlex
import shutil
from dataclasses import dataclass, field, replace
from importlib import import_module
from unittest.mock import MagicMock

import click
import coupled_stage
import fleet_records
import numpy as np
import pytest
from click.testing import CliRunner

import dehyst
import dehyst.exports
import dehyst.fleet.run
from dehyst.cli import main
from dehyst.control import Compensator
from dehyst.fleet.task import TaskRunner
from dehyst.records import write_columns

AXES = "vx_V:x_um vy_V:y_um"
# What is tried, by the option's parameter; of a command alone, by "command parameter". Values are no defaults.
VALUES = {
    "output": "-o other.csv",
    "report": "--report other.html",
    "as_json": "--json",
    "force": "--force",
    "max_bytes": "--max-size 0.0001",
    # Columns.
    "time": "--time clock_s",
    "voltage": "--voltage monitor_V",
    "displacement": "--displacement back_um",
    "voltage_scale": "--voltage-scale '1.1 V/V'",
    "displacement_scale": "--displacement-scale '0.08 um/V'",
    "columns": "--columns -,-,displacement:um,voltage:V,-,time:s",
    "join": "--join more.csv",
    "sample_rate": "--sample-rate 300",
    "decimal": "--decimal ,",
    # Paths.
    "axes": f"--axes '{AXES}'",
    "limits": "--limits 5 60",
    "slew": "--slew 7",
    "axis_limits": "--axis-limits x 5 60",
    "axis_slew": "--axis-slew x 7",
    "start": "--start bottom",
    "home": "--no-home",
    "present": "--present 20",
    "zero": "--zero bottom",
    "lag": "--lag",
    "scan": "--scan raster",
    "axis": "--axis y",
    "cycle": "--cycle cycle.csv",
    "cycles": "--cycles 2",
    "approach": "--approach 3",
    "start_up": "--start-up 5",
    "tolerance": "--tolerance 0.5",
    # Scans.
    "low": "--low 2.5",
    "high": "--high 6.5",
    "y_low": "--y-low 2.5",
    "y_high": "--y-high 6.5",
    "frequency": "--frequency 0.7",
    "turns": "--turns 0.2",
    "speed": "--speed 2.5",
    "acceleration": "--acceleration 15",
    "rising": "--rising 0.7",
    "rounding": "--rounding cosine",
    "lines": "--lines 6",
    "slow": "--slow ramp",
    "back": "--back 2",
    "revolutions": "--revolutions 3",
    "constant": "--constant angular",
    "ratio": "--ratio 2 3",
    "phase": "--phase 20",
    "levels": "--levels 2,4,5",
    "dwell": "--dwell 2",
    "edge": "--edge 2",
    "shape": "--shape trapezoid",
    # Models.
    "history": "--history kept",
    "goal": "--goal 50",
    "trajectory": "--trajectory path.csv",
    "wanted": "--wanted other_um",
    "seconds": "--seconds 5",
    "level": "--level 0.5",
    "precision": "--precision 0.01",
    "repeats": "--repeats 20",
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
    "method": "--method breakpoints",
    "elements": "--elements 3",
    "structure": "--structure auto",
    "refine": "--refine",
    "norm": "--norm l2",
    "knots": "--knots 5",
    "slope_floor": "--slope-floor 0.9",
    "delay": "--delay 0.001",
    "sensor_lag": "--sensor-lag 0",
    "shared_datum": "--shared-datum",
    "time_limit": "--time-limit 1e-6",
    "no_drift": "--no-drift",
    "verbose": "--all",
    # What only some commands have.
    "pace": "--pace rate",
    "base": "--base 3",
    "steps": "--steps 4",
    "majors": "--majors 3",
    "lowest": "--lowest 5",
    "count": "--count 4",
    "highest": "--highest 40",
    "hold": "--hold 2",
    "ramp": "--ramp 0.7",
    "names": "--names a,b",
    "seed": "--seed 5",
    "model": "--model model.json",
    "lead": "--lead 0.1",
    "truths": "--truth play",
    "only": "--only 'linear ratio'",
    "dry_run": "--dry-run",
    "protocol": "--protocol again.csv",
    "rounds": "--rounds 5",
    "actuator": "--actuator creep",
    "coupling": "--coupling 7",
    "hysteretic": "--hysteretic 2",
    "host": "--host 0.0.0.0",
    "port": "--port 4711",
    "noise": "--noise 5",
    "wave_points": "--wave-points 100",
    "faults": "--fault drop",
    "epics": "--epics PIEZO",
    "by": "--by serial",
    "prior": "--prior table.parquet",
    "jobs": "--jobs 3",
    "dask": "--dask tcp://127.0.0.1:8786",
    "resume": "--resume",
    "threshold": "--threshold 2",
    "over": "--over width50_um",
    "browser": "--no-browser",
    "excite base": "--base 3",
    "excite shape": "--shape triangle",
    "excite present": "--present 20",
    "excite sample_rate": "--sample-rate 30",
    "excite back": "--back",
    "excite limits": "--limits 0 20",
    "excite slew": "--slew 1",
    "export start": "--start bottom",
    "demo report": "--no-report",
    "calibrate axes": "--axes 1,2",
    "rig axes": "--axes 2",
    "fleet sample_rate": "--sample-rate 300",
    "fleet time_limit": "--time-limit 60",
    "fleet voltage": "--voltage monitor_V",
}
# What these do is to refuse: more than they allow.
BOUNDS = {"max_bytes": "--max-size", "speed": "speed", "limits": "limits"}


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


_COLUMNS = {
    "displacement_scale": "--displacement monitor_V",
    "join": "--displacement extra_um",
    "sample_rate": "--columns -,voltage:V,displacement:um,-,-,-",
}
_AXES_COLUMNS = {
    "displacement_scale": "--axes 'x=vx_V:sx_V y=vy_V:sy_V'",
    "join": "--axes 'x=vx_V:ex_um y=vy_V:y_um'",
    "sample_rate": "--columns -,vx_V,vy_V,x_um,y_um,-,-,-,-",
}
_AXES = {
    "axes": "--axes 'x=vx_V:bx_um y=vy_V:y_um'",
    "columns": "--columns time:s,vx_V,vy_V,-,y_um,-,-,x_um,-",
    "join": "--join morestage.csv",
    "displacement_scale": "--displacement-scale '0.2 um/V'",
}
_OTHER_AXIS = dict.fromkeys(("y_low", "y_high", "slow", "phase"), "of the other axis of the same scan")
_Y = dict.fromkeys(_OTHER_AXIS, "--axis y")
_SCANS = {
    "triangle": "--low 2 --high 6 --frequency 0.5 --sample-rate 50",
    "raster": "--low 2 --high 6 --frequency 0.5 --lines 4 --sample-rate 50",
    "spiral": "--low 2 --high 6 --frequency 0.5 --revolutions 2 --sample-rate 50",
    "lissajous": "--low 2 --high 6 --frequency 0.5 --sample-rate 50",
    "steps": "--levels 2,4 --dwell 1 --acceleration 20 --sample-rate 50",
}
_PLAN = ("dehyst.calibration.Plan",)
_OPEN = ("dehyst.instruments.open_rig",)
_LONG = "an experiment on an emulated instrument takes minutes: tests/calibration"
_PRINTED = dict.fromkeys(("as_json", "dry_run", "output"), f"of what is printed or written; {_LONG}")
_BENCHES = (
    *("+dehyst.cli.rig._bench_options", "+dehyst.cli.rig._driven", "+dehyst.virtual.emulator.faults.actual_limits"),
    *("+dehyst.virtual.stage.spread_coupling", "dehyst.virtual.emulator.Server", "dehyst.cli.rig._serve_epics"),
)
_STEP = dict.fromkeys(("slew", "axis_slew", "preview"), "--period 0.02")
_OF_C = {"force": "of a folder that is there: see below", "fmu": "beside --no-measure, which an FMU refuses"}
# Functions that end the command.
ENDS = ("open_rig", "serve", "demand_folder")
_STUDY = {"as_json": "a study takes a minute: tests/studies", "report": "as --json"}
_RIG = dict.fromkeys(("seconds",), "of the clock")
CASES = {
    "show": [
        Case(
            "record.csv",
            _COLUMNS | {"force": "-o out.csv"},
            {"axes": "--axes 'voltage_V:displacement_um monitor_V:back_um'"},
        ),
        Case("stage.csv --axes AXES", _AXES_COLUMNS, _AXES),
        Case("stage.json"),
        Case("texts/commas.txt", only=("decimal",)),
    ],
    "check": [
        Case("model.json texts/commas.txt", only=("decimal",)),
        Case("model.json record.csv", _COLUMNS, exempt={}),
        Case(
            "model.json record.csv --history kept",
            _COLUMNS,
            {"history": "--history others"},
            {"force": "of a picture in the folder of a history"},
            only=("history", "force", "as_json", "goal"),
        ),
        Case("stage.json stage.csv", _AXES_COLUMNS, _AXES),
    ],
    "simulate": [
        Case("model.json texts/commas.txt -o out.csv", only=("decimal",)),
        Case(
            "model.json record.csv -o out.csv",
            _COLUMNS | {"join": "--voltage extra_V"},
            {"home": "--home", "columns": "--columns -,-,-,voltage:V,-,-"},
        ),
        Case(
            "stage.json stage.csv -o out.csv",
            _AXES_COLUMNS | {"join": "--axes 'x=ex_V y=vy_V'"},
            _AXES
            | {"home": "--home", "axes": "--axes 'x=sx_V y=vy_V'", "columns": "--columns time:s,vy_V,vx_V,-,-,-,-,-,-"},
        ),
    ],
    "compensate": [
        Case("model.json texts/commas.txt -o out.csv", only=("decimal",)),
        Case("model.json record.csv -o out.csv", _COLUMNS | {"present": "--home"}),
        *(
            Case(
                f"model.json --scan {kind} {words} -o out.csv",
                {"present": "--home"},
                {"scan": "--scan lissajous"},
                {} if kind in ("triangle", "steps") else _OTHER_AXIS,
            )
            for kind, words in _SCANS.items()
            if kind != "lissajous"
        ),
        Case(f"model.json --scan lissajous {_SCANS['lissajous']} -o out.csv", _Y, {"scan": "--scan triangle"}),
        Case(
            f"model.json --scan raster {_SCANS['raster']} --axis y -o out.csv",
            values={"axis": "--axis x"},
            only=("axis", "y_low", "y_high", "slow", "lines", "back"),
        ),
        Case(
            f"model.json --scan triangle {_SCANS['triangle']} -o out.csv --cycle cycle.csv",
            values={"cycle": "--cycle other.csv"},
            exempt={"tolerance": "a model without creep settles in one cycle: tests/control"},
        ),
        Case("stage.json stage.csv -o out.csv", _AXES_COLUMNS, _AXES),
        Case(f"stage.json --scan raster {_SCANS['raster']} -o out.csv", values={"scan": "--scan lissajous"}),
    ],
    "insight": [
        Case("model.json record.csv --repeats 20 --trajectory texts/commas.txt", only=("decimal",)),
        Case(
            "model.json record.csv --repeats 0",
            _COLUMNS | {"limits": "--all"},
            values={"repeats": "--repeats 20"},
            exempt={"trajectory": "needs intervals: see below", "seconds": "of advice, which is not needed: see below"},
        ),
        Case(
            "model.json record.csv --repeats 20 --trajectory path.csv",
            {"force": "-o out.csv"},
            {"repeats": "--repeats 21", "trajectory": "--trajectory way.csv"},
            only=("trajectory", "wanted", "zero", "start", "output", "force", "level", "precision"),
        ),
        Case("model.json short.csv --repeats 0", values={"seconds": "--seconds 0.02"}, only=("seconds",)),
        Case(
            "stage.json stage.csv --repeats 0",
            _AXES_COLUMNS,
            _AXES,
            only=(
                "trajectory",
                "wanted",
                "zero",
                "start",
                "output",
                "report",
                "force",
                "voltage",
                "displacement",
                "axes",
            ),
        ),
    ],
    "identify": [
        Case("texts/commas.txt --structure maxwell_slip --elements 5", only=("decimal",)),
        Case(
            "record.csv --structure maxwell_slip --elements 5 -o out.json",
            _COLUMNS,
            exempt={"axes": "see below", "refine": "of parts, refused here: a slow step", "structure": "see below"},
            foreign="out.json",
        ),
        Case("record.csv again.csv --structure maxwell_slip --elements 5 -o out.json", only=("shared_datum",)),
        Case(
            "record.csv --time-limit 2",
            values={"structure": "--structure maxwell_slip"},
            only=("structure", "time_limit"),
        ),
        Case("record.csv --elements 5", only=("structure",)),
        Case(
            "stage.csv --axes AXES --structure maxwell_slip --elements 5 -o out.json",
            _AXES_COLUMNS,
            _AXES | {"elements": "--elements 4"},
            only=("axes", "traces", "zero", "voltage", "displacement", "elements", "voltage_scale"),
        ),
    ],
    "export": [
        Case("model.json out --no-measure", _STEP, {"measure": "--measure"}, _OF_C),
        Case("model.json earlier --no-measure", only=("force",)),
        Case("model.json out.wasm", _STEP, foreign="out.wasm"),
        Case("model.json out.fmu --fmu", _STEP, caught=("dehyst.exports.export_fmu",), foreign="out.fmu"),
        Case(
            "model.json out.fmu --fmu --kind actuator",
            values={"kind": "--kind compensator"},
            caught=("dehyst.exports.export_fmu",),
            foreign="out.fmu",
        ),
        Case("stage.json out --no-measure", _STEP, {"measure": "--measure"}, _OF_C),
    ],
    "calibrate": [
        Case(
            "sim://play -o out",
            {"max_bytes": "--protocol again.csv"},
            exempt=_PRINTED,
            caught=(*_PLAN, *_OPEN),
            foreign="out/report.html",
        ),
        Case(
            "pi://localhost/1,2 -o out",
            values={"axes": "--axes 2,1", "axis_limits": "--axis-limits 1 5 60", "axis_slew": "--axis-slew 1 7"},
            exempt=_PRINTED,
            caught=(*_PLAN, *_OPEN),
            foreign="out/report.html",
        ),
    ],
    "compare": [
        Case("texts/commas.txt --only 'linear ratio'", only=("decimal",)),
        Case(
            "record.csv --only 'linear ratio'",
            _COLUMNS | {"force": "-o out.csv", "lead": "--validate again.csv"},
            {"only": "--only Duhem"},
            dict.fromkeys(
                ("columns", "voltage", "voltage_scale", "time"),
                "errors in % are alike at any scale of volts and time",
            ),
        ),
        Case(
            "--truth play --only 'linear ratio'", only=("lead", "decimal", "voltage", "sample_rate", "join", "columns")
        ),
    ],
    "excite raised-cosine": [Case("50 30 -o out.csv")],
    "excite descending-tops": [Case("50 -o out.csv")],
    "excite reversal-curves": [Case("50 -o out.csv")],
    "excite minor-loop": [Case("10 30 --highest 50 -o out.csv")],
    "excite staircase": [Case("50 -o out.csv --hold 1", exempt={"pace": "refused: the steps are equal"})],
    "excite stage": [Case("50 40 -o out.csv --steps 3 --cycles 3", values={"cycles": "--cycles 20"})],
    "excite homing": [
        Case("50 -o out.csv"),
        Case(
            "--model model.json -o out.csv",
            values={"model": "--model other.json"},
            exempt={
                "pace": "of legs of different heights, which this homing has not",
                "hold": "of creep: tests/control",
            },
        ),
    ],
    "fleet identify": [
        Case("texts -o out2.parquet --elements 5", only=("decimal",)),
        Case("fleet.parquet --by serial,session -o out2.parquet --elements 5", only=("decimal",)),
        Case(
            "records -o out.parquet --elements 5",
            {"displacement_scale": "--displacement monitor_V"},
            {"by": "--by serial,session", "output": "-o other.parquet"},
            {"structure": "auto, which is slow, refuses elements"},
            foreign="out.parquet",
        ),
    ],
    "fleet report": [
        Case("table.parquet -o out.html", values={"by": "--by session --over serial"}, foreign="out.html")
    ],
    "fleet drift": [Case("table.parquet", values={"by": "--by session --over serial"})],
    "rig serve": [
        Case("--seconds 0", caught=_BENCHES, exempt=_RIG),
        Case("--axes 2", values={"axes": "--axes 3"}, caught=_BENCHES, exempt=_RIG),
    ],
    "workbench": [Case("out", caught=("dehyst.workbench.serve",), exempt={"browser": "opens a browser"})],
    "demo": [Case("-o out", caught=("dehyst.studies.demo.demand_folder",), exempt=_STUDY)],
    "paper": [Case("-o out", caught=("dehyst.studies.paper.run.demand_folder",), exempt=_STUDY)],
}


def commands(group=main, path=()):
    """Yield each command with its name."""
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with what commands read."""
    folder = tmp_path_factory.mktemp("bench")
    t, v, y = fleet_records.columns(0, drift=0.02, samples=40)
    y = np.interp(t - 2e-3, t, y)
    columns = {"time_s": t, "voltage_V": v, "displacement_um": y}
    write_columns(folder / "record.csv", columns | {"monitor_V": 1.1 * v + 0.1, "back_um": 1.2 * y, "clock_s": 2 * t})
    _, _, again = fleet_records.columns(1, samples=40)
    write_columns(folder / "again.csv", {"time_s": t, "voltage_V": v, "displacement_um": again + 0.3})
    write_columns(folder / "more.csv", {"time_s": t, "extra_um": 0.9 * y, "extra_V": 0.9 * v})
    fit = dehyst.identify(dehyst.Record(t, v, 1e-6 * y, "record"), structure="maxwell_slip", elements=6)
    replace(fit.actuator, delay=2e-3).save(folder / "model.json")
    record, _ = coupled_stage.excited(steps=4, cycles=4)
    of_axes = {f"v{axis}_V": record.voltage[:, k] for k, axis in enumerate("xy")}
    of_axes |= {f"{axis}_um": 1e6 * record.displacement[:, k] for k, axis in enumerate("xy")}
    more = {"sx_V": 5 * of_axes["x_um"], "sy_V": 5 * of_axes["y_um"], "bx_um": 1.1 * of_axes["x_um"]}
    write_columns(folder / "stage.csv", {"time_s": record.time, **of_axes, **more, "clock_s": 2 * record.time})
    other = {"ex_um": 0.9 * of_axes["x_um"], "ex_V": 0.9 * of_axes["vx_V"]}
    write_columns(folder / "morestage.csv", {"time_s": record.time, **other})
    read = dehyst.records.read(folder / "stage.csv", axes=AXES)
    found = dehyst.identify_stage(read, structure="maxwell_slip", elements=6)
    replace(found.stage, recorded_columns=tuple(AXES.split())).save(folder / "stage.json")
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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dehyst.fleet.run, "run_tasks", inline)
        fleet = fleet_records.write_parquet(
            folder / "fleet.parquet", 12, lambda k: {"samples": 20, "gain": 1.3 if k == 7 else 1.0 - 0.02 * (k == 3)}
        )
        dehyst.fleet.identify_fleet(fleet, folder / "table.parquet", by=("serial", "session"))
        (folder / "records").mkdir()
        shutil.copy(folder / "record.csv", folder / "records" / "S7_2.csv")
        options = dehyst.fleet.FleetOptions(elements=5)
        dehyst.fleet.identify_fleet(folder / "records", folder / "out.parquet", options=options)
    dehyst.exports.export(Compensator(fit.actuator), folder / "earlier", measure=False)
    replace(fit.actuator, limits=(5.0, 80.0)).save(folder / "other.json")
    return folder


def inline(head, tasks, *, jobs, scheduler):
    """Run tasks in this process."""
    click.echo(f"computed by {scheduler}, {jobs}, {head['time_limit']}")
    runner = TaskRunner(head)
    yield from map(runner.run, tasks)


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


def content(path):
    """Return what a file holds, without the seconds that something took."""
    if path.suffix != ".parquet" or path.read_bytes() == b"foreign\n":
        return path.read_bytes()
    fleet, measured = dehyst.fleet.load(path), ("cpu_s", "wall_s", "memory_MB")
    return fleet.by, [{name: row[name] for name in row if name not in measured} for row in fleet.rows]


class Walk:
    """Commands that run in a copy of the bench, each once."""

    def __init__(self, bench, folder, monkeypatch):
        self.bench, self.folder, self.patch, self.known = bench, folder, monkeypatch, {}
        monkeypatch.setattr(dehyst.fleet.run, "run_tasks", inline)

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
            str(path.relative_to(self.folder)): content(path)
            for path in self.folder.rglob("*")
            if path.is_file() and before.get(path) != path.stat().st_mtime_ns
        }
        # Seconds of a fit, and nanoseconds of a sample, in the table of dehyst compare.
        text = re.sub(r"\d+\.\d\d +\d+\.\d +(\d+\.\d|-)( +\d+)$", r"\2", done.output, flags=re.MULTILINE)
        self.known[*words, foreign] = done.exit_code, text, files
        return self.known[*words, foreign]

    def effect(self, command, case, option):
        """Return "changed", "refused" by its name, or what else became of an option."""
        more = case.more.get(option.name, "")
        base = shlex.split(f"{command} {case.words} {more}".replace("AXES", f"'{AXES}'"))
        words = shlex.split(tried(case, option.name, command))
        foreign = case.foreign if option.name == "force" else None
        before, after = (self.outcome(each, case.caught, foreign) for each in (base, [*base, *words]))
        if after == before:
            return "no effect"
        if after[0] == 2 and BOUNDS.get(option.name, "\0") in after[1] and "no effect" not in after[1]:
            return "changed"
        if after[0] == 2:
            named = any(flag in after[1] for flag in (*option.opts, *option.secondary_opts))
            return "refused" if named else f"{words}: {after[1]}"
        return "changed"


def tried(case, name, command):
    """Return the words of the trial of an option."""
    own = VALUES.get(f"{command.split()[0]} {name}")
    return case.values.get(name) or own or VALUES.get(name)


@pytest.mark.parametrize("command", list(CASES))
def test_each_option_changes_something_or_is_refused_by_its_name(bench, tmp_path, monkeypatch, command):
    walk = Walk(bench, tmp_path / "run", monkeypatch)
    options = [one for one in dict(commands())[command].params if isinstance(one, click.Option)]
    assert not [one.name for one in options if not all(tried(case, one.name, command) for case in CASES[command])]
    wrong, works = [], set()
    for case in CASES[command]:
        for option in options:
            if case.only and option.name not in case.only:
                continue
            what = "changed" if option.name in case.exempt else walk.effect(command, case, option)
            if what == "changed":
                works.add(option.name)
            elif what != "refused":
                wrong.append(f"{case.words}: {option.name}: {what}")
    wrong += [f"{name}: nowhere an effect" for name in sorted({one.name for one in options} - works)]
    assert not wrong, "\n".join(wrong)


def test_all_commands_are_walked_and_are_repeatable(bench, tmp_path, monkeypatch):
    assert {name for name, _ in commands()} == set(CASES)
    for command, cases in CASES.items():
        words = shlex.split(f"{command} {cases[0].words}")
        first, second = (Walk(bench, tmp_path / "run", monkeypatch).outcome(words, cases[0].caught) for _ in range(2))
        assert first == second, command

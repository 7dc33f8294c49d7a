"""A compensator in WebAssembly: the bits of Python in node, one small module for all models, hostile ones refused."""

import json
import re
import runpy
import shutil
import subprocess

import compiled_exports
import numpy as np
import places
import pytest
from compiled_exports import KINDS
from node_programs import column, exported, node

import dehyst
from dehyst import Compensator
from dehyst.exports import wasm_module
from dehyst.exports.naming import shipped, shipped_bytes
from examples import at_night

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")

BUILDER = places.ROOT / "bindings" / "wasm" / "build.py"
MOST = 26_200


def test_the_wasm_module_was_compiled_from_the_present_sources():
    building = runpy.run_path(str(BUILDER))
    assert building["recorded"](shipped_bytes("core.wasm")) == building["digest"](), "run make wasm, and commit"
    assert building["MODULE"].read_bytes() == shipped_bytes("core.wasm")


def test_the_compiler_of_debian_makes_the_same_bytes(tmp_path):
    if shutil.which("clang") is None or shutil.which("wasm-ld") is None:
        pytest.skip("clang or wasm-ld is not installed: the module cannot be built (Debian: clang lld)")
    version = subprocess.run(["clang", "--version"], capture_output=True, text=True, check=True).stdout
    if not re.search(r"clang version 14\.", version):
        pytest.skip(f"the module is built by clang 14, here is {version.splitlines()[0]}")
    runpy.run_path(str(BUILDER))["build"](tmp_path / "core.wasm")
    assert (tmp_path / "core.wasm").read_bytes() == shipped_bytes("core.wasm")


def test_the_module_is_small():
    assert len(shipped_bytes("core.wasm")) < MOST
    assert all(len(wasm_module(KINDS[kind]())) < MOST for kind in KINDS)


# The bits

STEPS = """
const wanted = read("wanted"), compensator = new Compensator(module), voltage = new Float64Array(wanted.length);
for (let i = 0; i < wanted.length; i++) voltage[i] = compensator.step(wanted[i]);
const { limited, slewed, refused } = compensator.clamps;
write("voltage", voltage);
compensator.reset();
const kept = compensator.trajectory(wanted), ahead = compensator.simulate(kept.voltage);
write("ran", compensator.run(wanted));
compensator.reset();
write("offered", wanted.map((one) => {
    const offered = compensator.offer(one);
    compensator.commit(offered);
    return offered;
}));
compensator.commit(voltage[0]);
compensator.commit();
write("held", [compensator.voltage, compensator.displacement]);
compensator.reset();
write("played", kept.voltage.map((one) => compensator.play(one)));
write("simulated", ahead);
write("path", kept.voltage);
console.log(limited, slewed, refused, kept.clamped.filter((code) => code === 1).length);
"""


@pytest.mark.parametrize(("kind", "samples"), [*((kind, 4000) for kind in KINDS), at_night("plain", 10**6)])
def test_random_steps_have_the_bits_of_python(tmp_path, kind, samples):
    compensator = KINDS[kind]()
    folder = exported(tmp_path / kind, compensator)
    wanted = compiled_exports.wishes(compensator, samples)
    counts = [int(word) for word in node(folder, STEPS, wanted=wanted).split()]
    loop = compensator._clone()
    voltage = np.array([loop.step(each) for each in wanted.tolist()])
    assert np.array_equal(column(folder, "voltage"), voltage.view(np.uint64))
    assert counts[:3] == [*loop.clamps, 0] and counts[0] > 0
    for name in ("ran", "offered", "path"):
        assert np.array_equal(column(folder, name), voltage.view(np.uint64)), name
    loop.commit(float(voltage[0]))
    loop.hold()
    assert np.array_equal(column(folder, "held"), np.array([loop.voltage, loop.displacement]).view(np.uint64))
    assert counts[3] == loop.clamps.limited
    virtual, reached = compensator._clone("m"), []
    for sent in voltage.tolist():
        virtual.commit(sent)
        reached.append(virtual.actuator.displacement(virtual.state))
    for name in ("simulated", "played"):
        assert np.array_equal(column(folder, name), np.array(reached).view(np.uint64)), name


TRACK = """
const wanted = read("wanted"), measured = read("measured"), [gain, bound] = read("numbers");
const compensator = new Compensator(module), other = new Compensator(module);
compensator.feedback(gain, bound);
other.feedback(gain, bound);
write("voltage", [...wanted].map((y, i) => compensator.track(y, measured[i])));
wanted.forEach((y, i) => other.track(y, 1e6 * measured[i]));
console.log(compensator.fault, other.fault);
for (const wrong of [() => compensator.scale(-1), () => compensator.feedback(2, bound), () => other.track(NaN)]) {
    try { wrong(); } catch (error) { console.log(error.name); }
}
"""


@pytest.mark.parametrize("kind", ["slewing", "creep", "moving"])
@pytest.mark.filterwarnings("ignore::dehyst.control.SensorWarning")
def test_feedback_has_the_bits_of_python(tmp_path, kind):
    compensator = KINDS[kind]()
    folder = exported(tmp_path / kind, compensator)
    low, high = compensator.reach
    wanted = low + (high - low) * (0.5 - 0.4 * np.cos(np.arange(4000) / 60))
    measured = low + 0.99 * (np.roll(wanted, 1) - low)
    measured[::5] = np.nan
    loop = compensator._clone("m")
    fed = dehyst.Feedback(loop, bound=0.05 * (high - low))
    said = node(folder, TRACK, wanted=wanted, measured=measured, numbers=np.array([fed.gain, fed.bound]))
    voltage = np.array([fed.step(y, seen) for y, seen in zip(wanted.tolist(), measured.tolist(), strict=True)])
    assert said.split() == [str(int(fed.fault)), "1", "RangeError", "RangeError", "RangeError"]
    assert np.array_equal(column(folder, "voltage"), voltage.view(np.uint64))


LEAD = """
const compensator = new Compensator(module), [target] = read("wanted");
const present = compensator.voltage, steps = compensator.lead(target), before = compensator.voltage;
const { voltage } = compensator.trajectory([target, target]);
console.log(present, steps, before, voltage[0], compensator.voltage);
"""


def test_lead_moves_to_a_path_within_the_slew_rate(tmp_path):
    compensator = Compensator(KINDS["plain"]().actuator, (-10.0, 10.0), 50.0, period=1e-3)
    folder = exported(tmp_path, compensator)
    low, high = compensator.reach
    words = node(folder, LEAD, wanted=np.array([low + 0.3 * (high - low)])).split()
    present, steps, before, first, after = map(float, words)
    assert steps == np.floor(abs(first - present) / 0.05) and steps > 20
    assert abs(first - before) < 0.05 and before == after


def test_options_replace_limits_and_slew_rate(tmp_path):
    compensator = compiled_exports.plain(period=1e-3)
    wanted = compiled_exports.wishes(compensator, 5000)
    options = "{ limits: [30, 90], slewRate: 1e4 }"
    folder = exported(tmp_path / "c", compensator)
    said = node(
        folder,
        f'const c = new Compensator(module, {options}); write("voltage", c.run(read("wanted")));'
        "console.log(JSON.stringify([c.limits, c.slewRate, c.period, c.clamps.limited, c.clamps.slewed]))",
        wanted=wanted,
    )
    loop = Compensator(compensator.actuator, (30, 90), 1e4, period=1e-3, state=compensator._axes[0].given)
    assert np.array_equal(column(folder, "voltage"), loop.run(wanted).view(np.uint64))
    assert json.loads(said) == [[30, 90], 1e4, 1e-3, *loop.clamps]


# Refusals

REFUSED = """
const refused = (what, work) => {
    try { work(); } catch (error) {
        if (error instanceof RangeError || error instanceof TypeError) return;
        throw error;
    }
    throw new Error(`${what}: not refused`);
};
"""


def test_wrong_numbers_and_options_are_refused_and_change_nothing(tmp_path):
    folder = exported(tmp_path / "c", KINDS["creep"]())
    program = (
        REFUSED
        + """
const c = new Compensator(module);
c.step(c.about.start.displacement);
const before = [c.displacement, c.voltage, JSON.stringify(c.clamps)].join();
for (const wrong of [NaN, Infinity, undefined]) {
    refused(`step ${wrong}`, () => c.step(wrong));
    refused(`offer ${wrong}`, () => c.offer(wrong));
    refused(`run ${wrong}`, () => c.run([1e-6, wrong]));
    refused(`trajectory ${wrong}`, () => c.trajectory([1e-6, wrong]));
}
for (const wrong of [NaN, Infinity, 1e6]) refused(`commit ${wrong}`, () => c.commit(wrong));
for (const wrong of [NaN, Infinity, undefined]) {
    refused(`play ${wrong}`, () => c.play(wrong));
    refused(`simulate ${wrong}`, () => c.simulate([1, wrong, 2]));
}
const options = [
    ...[[1, 1], [2, 1], [NaN, 1], [0, Infinity]].map((limits) => ({ limits })),
    ...[0, -1, NaN].map((slewRate) => ({ slewRate })),
    ...[1, null, 0].map((period) => ({ period })),
];
for (const option of options) refused(JSON.stringify(option), () => new Compensator(module, option));
const after = [c.displacement, c.voltage, JSON.stringify(c.clamps)].join();
if (before !== after) throw new Error(`${before} ${after}`);
refused("no model", () => new Compensator(new WebAssembly.Module(new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0]))));
console.log("done");
"""
    )
    assert node(folder, program) == "done"


# A checksum and a length that fit, so that a changed block is not refused for these.
SEAL = """
const seal = (own) => {
    if (own.length < 16) return own;
    let sum = 0xFFFFFFFF;
    for (let at = 16; at < own.length; at++) {
        sum ^= own[at];
        for (let bit = 0; bit < 8; bit++) sum = (sum >>> 1) ^ (sum & 1 ? 0xEDB88320 : 0);
    }
    const view = new DataView(own.buffer);
    view.setUint32(8, own.length, true);
    view.setUint32(12, ~sum >>> 0, true);
    return own;
};
"""


EVERY = """
const numbers = new Uint8Array(WebAssembly.Module.customSections(module, "dehyst.model")[0]);
const opened = (own) => {
    const core = new WebAssembly.Instance(module).exports;
    new Uint8Array(core.memory.buffer, core.reserve(own.length), own.length).set(own);
    return core.open();
};
const changed = (change) => {
    const own = numbers.slice();
    change(new DataView(own.buffer));
    found.add(opened(own));
    return opened(seal(own));
};
const found = new Set();
for (let at = 64; at < numbers.length; at += 8) {
    for (const wrong of [NaN, Infinity]) found.add(changed((view) => view.setFloat64(at, wrong, true)));
}
for (let at = 16; at < 44; at += 4) {
    for (const by of [-1, 1]) found.add(changed((view) => view.setUint32(at, view.getUint32(at, true) + by, true)));
}
for (let size = 0; size < numbers.length; size++) found.add(opened(seal(numbers.slice(0, size))));
found.add(opened(seal(Uint8Array.from([...numbers, ...new Uint8Array(8)]))));
console.log(opened(numbers), [...found].sort().join());
"""


@pytest.mark.parametrize("kind", ["plain", "all", at_night("moving")])
def test_every_wrong_size_and_number_is_refused(tmp_path, kind):
    sound, refused = node(exported(tmp_path / kind, KINDS[kind]()), SEAL + EVERY).split()
    assert sound == "0"
    assert {"-2", "-8", "-11"} <= set(refused.split(",")) <= {"-1", "-2", "-8", "-11"}


def test_the_declared_types_have_every_member():
    script, types = shipped("compensator.js"), shipped("compensator.d.ts")
    members = set(re.findall(r"^  (?:get )?([a-z]\w*)\(.*\) \{$", script, re.MULTILINE)) - {"constructor"}
    assert members >= {"step", "trajectory", "simulate", "clamps"}
    assert all(re.search(rf"^  (readonly )?{name}[(:]", types, re.MULTILINE) for name in members)
    for kind in KINDS:
        text = wasm_module(KINDS[kind]())
        about = json.loads(text[text.index(b'{"format"') : text.index(b"}}") + 2])
        assert all(re.search(rf"^  {name}: ", types, re.MULTILINE) for name in about)
        assert about["needsPeriod"] == (kind in ("creep", "all", "moving"))

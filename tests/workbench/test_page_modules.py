"""Modules that draw and compute, run by node: curves, paths, numbers; and how they become one script."""

import json
import re
import shutil
import subprocess

import node_programs
import numpy as np
import places
import pytest

from dehyst.model.branches import branches_of, paces_of
from dehyst.web import files

FOLDERS = places.SOURCES / "web", places.SOURCES / "workbench" / "page"
HEAD = """
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { before, nearest, pixels, steps } from "./thinning.js";
import { fastestBranch, inserted, moved, removed, sampled } from "./path.js";
globalThis.document = { getElementById: () => null, createElement: () => ({}) };
globalThis.window = { addEventListener() {} };
const { column } = await import("./report.js");
const { judged, TOO_FAST } = await import("./path_figures.js");
import { bytes, duration, extent, length, parsed, percent, plain, range, roundDown, short } from "./numbers.js";
import { limitsFrom, numberFrom, ticks, whole } from "./numbers.js";
const floats = (name) => {
  const bytes = readFileSync(new URL(name, import.meta.url));
  return new Float32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
};
const print = (value) => console.log(JSON.stringify(value));
"""
# Values to pixels: 0 to 100 V and -12 to 12 um on 400 x 300 pixels.
FRAME = "const frame = { x0: 0, kx: 4, y0: 12, ky: -12.5, width: 400, height: 300 };"


@pytest.fixture(scope="module")
def modules(tmp_path_factory):
    node_programs.need_node()
    folder = tmp_path_factory.mktemp("modules")
    for sources in FOLDERS:
        shutil.copytree(sources, folder, dirs_exist_ok=True)
    (folder / "package.json").write_text('{"type": "module"}')
    return folder


@pytest.fixture
def run(modules):
    def node(program, **columns):
        printed = node_programs.node(modules, program, HEAD + FRAME, "<f4", **columns)
        return json.loads(printed) if printed else None

    return node


def loops(samples, noise, cycles=40):
    phase = np.linspace(0, 2 * np.pi * cycles, samples)
    height = 0.3 + 0.7 * np.abs(np.sin(phase / 37))
    random = np.random.default_rng(samples)
    voltage = 50 + 49 * height * np.sin(phase)
    return voltage, 10 * height * np.sin(phase - 0.2) + random.normal(0, 1, samples) * noise


@pytest.mark.parametrize(("samples", "noise"), [(5_000, 0.0), (200_000, 0.05), (20_000, 0.3)])
def test_a_long_path_draws_each_pair_of_pixels_once(run, samples, noise):
    x, y = loops(samples, noise)
    curve = 'const curve = pixels({ x: floats("x"), y: floats("y") }, frame);'
    found = np.array(run(f"{curve} print(steps(curve, frame));", x=x, y=y))
    columns, rows = 4 * x.astype("<f4").astype(float), -12.5 * (y.astype("<f4").astype(float) - 12)
    pixels = np.column_stack([columns, rows]).astype(int)
    drawn = [tuple(sorted(map(tuple, pixels[pair].tolist()))) for pair in found]
    assert len({*drawn}) == len(drawn)
    moved = np.flatnonzero(np.any(np.diff(pixels, axis=0), axis=1))
    assert {*drawn} == {tuple(sorted(map(tuple, pixels[[k, k + 1]].tolist()))) for k in moved}


def test_a_path_is_interrupted_at_missing_values_and_outside_the_view(run):
    run("""
        const pairs = (px, py) => steps({ px, py }, frame);
        assert.deepEqual(pairs([10, 50, NaN, 150, 200], [20, 20, 20, 20, 20]), [[0, 1], [3, 4]]);
        assert.deepEqual(pairs([-1e7, 1e7], [150, 151]), [[0, 1]]);
        assert.deepEqual(pairs([-5, -9, -9, 500], [10, 20, -3, -4]), []);
        assert.equal(pairs([], []).length + pixels({ x: [], y: [], rising: true }, frame).px.length, 0);
    """)


def test_a_curve_over_time_keeps_the_extremes_of_each_column_of_pixels(run):
    time = np.linspace(0, 100, 100_000)
    y = np.random.default_rng(3).normal(0, 2, time.size)
    drawn = run(
        """
        const [x, y] = [floats("x"), floats("y")];
        const { px, py } = pixels({ x, y, rising: true }, frame);
        print({ px: [...px], py: [...py] });
        """,
        x=time,
        y=y,
    )
    px, py = np.array(drawn["px"]), np.array(drawn["py"])
    assert px.size <= 4 * 402
    assert np.all(np.diff(np.floor(px)) >= 0)
    pixels = (y.astype(np.float32).astype(float) - 12) * -12.5
    columns = np.floor(time.astype(np.float32).astype(float) * 4)
    for column in (0, 17, 200, 399):
        mine = py[np.floor(px) == column]
        assert mine.min() == pytest.approx(pixels[columns == column].min(), abs=1e-3)
        assert mine.max() == pytest.approx(pixels[columns == column].max(), abs=1e-3)


def test_only_visible_samples_and_their_neighbours_are_drawn(run):
    run("""
        const x = Float32Array.from({ length: 1000 }, (_, i) => i);
        const near = { ...frame, x0: 500, kx: 40 };
        const { px } = pixels({ x, y: x.map(() => 0), rising: true }, near);
        assert.ok(px.length <= 14 && px[0] < 0 && px.at(-1) >= 400, String(px.length));
        assert.equal(before(x, 10.5), 11);
        assert.equal(before(x, -1), 0);
        assert.equal(before(x, 5000), 1000);
    """)


@pytest.mark.parametrize("rising", [False, True])
def test_the_nearest_sample_is_found(run, rising):
    random = np.random.default_rng(5)
    x = np.sort(random.uniform(0, 100, 4000)) if rising else random.uniform(0, 100, 4000)
    y = random.uniform(-12, 12, 4000)
    at = random.uniform([0, 0], [400, 300], (20, 2))
    found = run(
        f"""
        const [x, y, at] = [floats("x"), floats("y"), floats("at")];
        const places = Array.from({{ length: 20 }}, (_, k) => ({{ x: at[2 * k], y: at[2 * k + 1] }}));
        const rising = {str(rising).lower()};
        assert.equal(nearest({{ x: [1e9], y: [0], rising }}, frame, {{ x: 0, y: 0 }}, 40), null);
        print(places.map((one) => nearest({{ x, y, rising }}, frame, one, 40)?.index ?? -1));
        """,
        x=x,
        y=y,
        at=at,
    )
    pixels = np.column_stack([4 * x, (y - 12) * -12.5])
    for spot, index in zip(at, found, strict=True):
        assert index == np.argmin(np.hypot(*(pixels - spot).T))


def test_page_and_server_sample_points_alike(run):
    points = [[0, 2], [0.2501, 9], [0.25011, 4], [1.0, 3]]
    got = run(f"const {{ time, wanted }} = sampled({points}, 1000); print([[...time], [...wanted]]);")
    time = np.arange(1001) / 1000
    assert got[0] == pytest.approx(time)
    assert got[1] == pytest.approx(np.interp(time, *np.array(points).T), abs=1e-12)


def test_page_and_promise_find_the_same_fastest_branch(run):
    time, random = np.arange(20_000) / 1000, np.random.default_rng(1)
    triangle = 200 * np.abs((2 * time + 0.5) % 1 - 0.5)
    stairs = np.interp(time, np.arange(0, 20, 0.05), np.repeat(random.uniform(0, 100, 200), 2))
    noisy = triangle + random.normal(0, 0.2, time.size)
    for values in (50 - 50 * np.cos(20 * time), noisy, stairs, 90 - 4 * time):
        voltage = values.astype("<f4").astype(float)
        known = paces_of(time, voltage, branches_of(voltage, 100))[:, 0].max()
        assert run('print(1000 * fastestBranch(floats("v"), 2));', v=voltage) == pytest.approx(known, rel=1e-6)


def test_a_path_without_a_promise_has_no_number(run):
    run("""
        const planned = { voltage: [0, 50], steepest: 9, missed: 0, clamps: { limited: 0, slewed: 0 } };
        const known = { largest_percent: 0.56, why: TOO_FAST, speed: "" };
        const said = (band) => JSON.stringify(judged(planned, { ...known, band }));
        assert.match(said(0.1), /within 100 nm \\(0.56 %/);
        assert.doesNotMatch(said(0), /within|%/);
        assert.match(said(0), /no record is as fast as this path/);
        const clamps = { limited: 0, slewed: 7 };
        const cut = (file) => JSON.stringify(judged({ ...planned, clamps }, { ...known, band: 0.1, file }));
        assert.doesNotMatch(cut(), /within|%/);
        assert.match(cut("a.csv"), /7 samples are slewed.*within 100 nm \\(0.56 %.*promise of the file a.csv/);
    """)


def test_points_stay_in_their_order(run):
    run("""
        const points = [[0, 1], [1, 2], [2, 3]];
        assert.deepEqual(moved(points, 1, [5, 7], 0.01)[1], [1.99, 7]);
        assert.deepEqual(moved(points, 0, [5, 7], 0.01)[0], [0, 7]);
        assert.deepEqual(moved(points, 2, [9, 7], 0.01)[2], [9, 7]);
        assert.deepEqual(inserted(points, [1.5, 4], 0.01), [[0, 1], [1, 2], [1.5, 4], [2, 3]]);
        assert.equal(inserted(points, [1.001, 4], 0.01), points);
        assert.equal(inserted(points, [-1, 4], 0.01), points);
        assert.deepEqual(removed(points, 1), [[0, 1], [2, 3]]);
        assert.equal(removed(points, 0), points);
        const two = [[0, 1], [1, 2]];
        assert.equal(removed(two, 1), two);
        assert.throws(() => sampled(points, 0.1), /fewer than two samples/);
        assert.throws(() => sampled(points, 1e9), /at most/);
    """)


def test_modules_become_one_script_with_unique_names(modules):
    script = files.script("report.js")
    assert re.search(r"^(import|export) ", script, re.M) is None
    assert len(re.findall(r"^class Chart ", script, re.M)) == 1
    (modules / "one.mjs").write_text(script)
    done = subprocess.run(["node", "--check", "one.mjs"], cwd=modules, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_numbers_are_written_with_few_digits_and_units(run):
    run("""
        const values = [0, 0.5, 1234.5, -3.25, 1e-9, null];
        const texts = ["0", "0.5", "1235", "\\u22123.25", "1.00e\\u22129", "\\u2013"];
        assert.deepEqual(values.map((one) => short(one)), texts);
        assert.deepEqual([-3.25, 0.5 ** 20, 1 / 3].map((one) => plain(one, 3)), ["-3.25", "9.54e-7", "0.333"]);
        const rounded = [[1, 1], [0.99, 0.5], [20, 20], [0.1999, 0.1], [0.2, 0.2], [7.3e-6, 5e-6]];
        for (const [value, lower] of rounded) assert.ok(Math.abs(roundDown(value) / lower - 1) < 1e-12, String(value));
        assert.equal(percent(0.887), "0.89 %");
        assert.equal(length(0.0085), "8.5 nm");
        assert.equal(length(45.8), "45.8 \\u00b5m");
        assert.equal(whole(1000000), "1\\u202f000\\u202f000");
        assert.deepEqual([12.34, 119.7, 60 * 3].map(duration), ["12.3 s", "2 min 0 s", "3 min 0 s"]);
        assert.equal(bytes(33e6), "33 MB");
        assert.equal(bytes(null), "\u2013");
        assert.equal(range([-123.1, -73.64], "\\u00b5m"), "\\u2212123.1 to \\u221273.64 \\u00b5m");
        assert.equal(range([-1.4e-5, 16.15], "V"), "0 to 16.15 V");
        const typed = ["1,5", "1e3", " \\u22122 ", "", "x", "1,000,000"];
        assert.deepEqual(typed.map(parsed), [1.5, 1000, -2, null, NaN, NaN]);
        assert.deepEqual(extent([[1, 3], [NaN, 2]]), [1, 3]);
        assert.deepEqual(extent([[5, 5]]), [4, 6]);
        assert.deepEqual(ticks([0, 1], 5).map(([, text]) => text), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert.deepEqual(ticks([-3, 1], 4, { log: true }).map(([, text]) => text), ["0.001", "0.01", "0.1", "1", "10"]);
        assert.equal(ticks([0, 1], 5, { log: true }).length, 4);
        assert.equal(numberFrom("", "Goal", { optional: true }), null);
        assert.equal(numberFrom("0", "Rounds", { least: 0 }), 0);
        assert.throws(() => numberFrom("0", "Goal", { above: 0 }), /Goal: got 0, need a number above 0/);
        assert.throws(() => limitsFrom("5", "5"), /not below/);
    """)

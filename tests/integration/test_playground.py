"""The page of the site that runs: its actuator is the virtual one, dehyst follows, a straight scale factor does not."""

import re
import runpy
import shutil

import node_programs
import numpy as np
import places
import pytest
from virtual_loops import record_loops
from workbench_page import CHROMIUM

import dehyst
from dehyst import Compensator
from dehyst.control import PossibleStart
from dehyst.exports import wasm_module
from dehyst.virtual import PlayActuator

EXTENSIONS = places.DOCS / "_extensions"


def test_the_page_has_the_virtual_actuator_of_the_package(tmp_path):
    voltage = np.concatenate([np.linspace(200, 0, 200), np.random.default_rng(0).uniform(0, 200, 2000)])
    truth = PlayActuator()
    truth.play(np.linspace(0, 200, 400))
    expected = truth.play(voltage, measured=False)
    shutil.copy(EXTENSIONS / "play_actuator.js", tmp_path / "play_actuator.mjs")
    program = """
import { PlayActuator } from "./play_actuator.mjs";
import fs from "node:fs";
const bytes = fs.readFileSync("voltage"), actuator = new PlayActuator();
for (let v = 0; v <= 200; v += 0.5) actuator.play(v);
const voltage = new Float64Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
fs.writeFileSync("reached", voltage.map((v) => actuator.play(v)));
"""
    node_programs.node(tmp_path, program, head="", voltage=voltage)
    assert np.allclose(np.fromfile(tmp_path / "reached"), expected, rtol=0, atol=1e-12 * truth.stroke)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """The page's own part, with its script."""
    text = (places.DOCS / "tutorials" / "try_it.md").read_text()
    body = re.search(r'<div id="playground">.*</div>', text, re.DOTALL)[0]
    folder = tmp_path_factory.mktemp("site")
    actuator = dehyst.identify(record_loops()[0], structure="maxwell_slip").actuator
    module = wasm_module(
        Compensator(actuator, (0.0, 200.0), period=1e-3, state=PossibleStart.named(actuator, "bottom").state)
    )
    script = runpy.run_path(str(EXTENSIONS / "playground.py"))["script"](module)
    assert re.search(r"^(import|export) |import\.meta", script, re.MULTILINE) is None
    (folder / "playground.js").write_text(script)
    style = (places.DOCS / "_static" / "playground.css").read_text()
    page = (
        f'<!DOCTYPE html><meta charset="utf-8"><style>{style}</style>{body}<script src="playground.js" defer></script>'
    )
    (folder / "page.html").write_text(page)
    return folder / "page.html"


def percents(page):
    return [float(text.split(", ")[1][:-2]) for text in page.locator("output").all_inner_texts()]


@pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")
@pytest.mark.parametrize("motion", ["reduce", "no-preference"])
def test_dehyst_is_more_accurate_than_a_straight_scale_factor(browser, file, motion):
    page = browser.new_page(reduced_motion=motion)
    complaints = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(file.as_uri())
    page.locator("#playground.ready").wait_for()
    button = page.locator("button")
    assert button.inner_text() == ("Run" if motion == "reduce" else "Pause")
    for shape in ("sine", "triangle", "beat", "stairs"):
        page.locator("select").select_option(shape)
        page.wait_for_timeout(200)
        straight, own = percents(page)
        assert straight > 5 and own < 1, shape
    canvas = page.locator("canvas").last
    if motion != "reduce":
        before = canvas.screenshot()
        page.wait_for_timeout(200)
        assert canvas.screenshot() != before
        button.click()
    # At rest a slider computes its motion at once.
    before = canvas.screenshot()
    page.get_by_label("Frequency (Hz)").fill("3")
    assert canvas.screenshot() != before
    page.close()
    assert complaints == []

"""Journeys of a person at the page, in Debian's chromium, against a real server."""

import re

import numpy as np
import places
import pytest
from coupled_stage import excited
from workbench_client import held, served
from workbench_page import CHROMIUM, visit
from workbench_tour import PICTURES

from dehyst.records import read_table, write_record
from examples import at_night

pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")


@pytest.fixture
def person(browser, bench):
    with visit(browser, bench) as visitor:
        yield visitor
        assert visitor.complaints == []
        assert visitor.elsewhere == []


@pytest.fixture(scope="module")
def bench_with_model(tmp_path_factory, browser, loops):
    """A workbench whose folder has a model already."""
    with served(tmp_path_factory.mktemp("page") / "bench") as running:
        with visit(browser, running) as visitor:
            visitor.drop(loops)
            visitor.identify(structure="maxwell_slip")
        yield running


@pytest.fixture
def owner(browser, bench_with_model):
    with visit(browser, bench_with_model) as visitor:
        visitor.sees("1 ready")
        yield visitor
        assert visitor.complaints == []
        assert visitor.elsewhere == []


def colours(canvas):
    """How many colours the canvases of a figure show."""
    return canvas.evaluate(
        """element => {
            const canvases = element.tagName === "CANVAS" ? [element] : [...element.querySelectorAll("canvas")];
            const seen = new Set();
            for (const one of canvases) {
                if (!one.width || !one.height) continue;
                const pixels = one.getContext("2d").getImageData(0, 0, one.width, one.height).data;
                for (const pixel of new Uint32Array(pixels.buffer)) seen.add(pixel);
            }
            return seen.size;
        }"""
    )


def test_a_dropped_record_is_drawn_and_its_identification_can_be_cancelled(person, bench, loops):
    content = loops.read_text()
    person.page.evaluate(
        """([name, text]) => {
            const transfer = new DataTransfer();
            transfer.items.add(new File([text], name));
            for (const kind of ["dragenter", "dragover", "drop"]) {
                const event = new DragEvent(kind, { dataTransfer: transfer, bubbles: true, cancelable: true });
                document.body.dispatchEvent(event);
            }
        }""",
        ["dropped.csv", content],
    )
    person.sees("dropped", within="#record-list")
    person.sees("0 to 100 V|to 100 V", within="#records")
    person.until("() => document.querySelectorAll('#records canvas').length > 0")
    assert colours(person.page.locator("#records .stage")) > 3
    person.sees("3.000 in", within="#records")
    person.click("button", "Identify a model")
    with held(bench.folder):
        person.sees("elapsed", within="#running")
        person.click("button", "Cancel", within="#running")
    person.sees("Cancelled", within="#running")
    assert person.page.locator("#model-body").is_hidden()


def test_what_the_page_plans_is_what_the_server_writes(owner, bench_with_model):
    """The page computes in WebAssembly, the server by the command: on the path they agree."""
    owner.step("Path")
    owner.page.get_by_label("A scan").check()
    owner.sees("The path can be followed", within="#path")
    planned = owner.page.locator("#plan-words").inner_text()
    low, high = (float(number) for number in re.search(r"([\d.]+) to ([\d.]+) V", planned).groups())
    owner.write_voltage()
    file = max((bench_with_model.folder / "voltages").iterdir(), key=lambda path: path.stat().st_mtime)
    table = {column.name: column.data for column in read_table(file).columns}
    on_path = table["voltage_V"][table["phase"] == table["phase"].max()] if "phase" in table else table["voltage_V"]
    assert float(on_path.max()) == pytest.approx(high, rel=0.02)
    assert float(on_path.min()) == pytest.approx(low, abs=2)


@pytest.mark.parametrize("kind", ["raster", *map(at_night, ["steps", "triangle"])])
def test_each_scan_can_be_followed_as_it_is_suggested(owner, kind):
    owner.step("Path")
    owner.page.get_by_label("A scan").check()
    owner.page.get_by_label("Scan", exact=True).select_option(kind)
    owner.until("(kind) => document.querySelector('#scan-kind').value === kind", kind)
    owner.sees("The path can be followed", within="#plan-words")
    owner.write_voltage()


def test_exports_and_the_script_can_be_downloaded(owner):
    owner.step("Export")
    for name, suffix in (("C99", "-c"), ("FMU", ".fmu"), ("WebAssembly", ".wasm")):
        card = owner.page.locator("#export li").filter(has=owner.page.get_by_role("heading", name=name))
        card.get_by_role("button").first.click()
        owner.page.locator("#files").get_by_text(re.compile(rf"exports/loops.*{suffix.split('.')[0]}")).first.wait_for()
    owner.sees(r"exports/loops\.wasm", within="#files")
    name, content = owner.download("link", "exports/loops.wasm", within="#files")
    assert content[:4] == b"\0asm"
    name, content = owner.download("link", "Model (JSON)")
    assert content.lstrip().startswith(b"{")
    assert "identify records/loops.npz" in owner.page.locator("#script").inner_text()
    assert name == "loops.json"


def test_a_reload_loses_nothing(owner):
    owner.step("Model")
    owner.sees("is the largest error to expect", within="#model")
    owner.page.reload()
    owner.sees("1 ready")
    # The step is in the address, and the browser's history.
    owner.sees("is the largest error to expect", within="#model")
    owner.page.locator("#model canvas").first.wait_for()
    assert colours(owner.page.locator("#model-body")) > 3


def test_coupled_axes_are_read_identified_judged_and_followed(person, bench, tmp_path):
    write_record(tmp_path / "stage.csv", excited()[0])
    person.drop(tmp_path / "stage.csv")
    person.sees("perhaps of coupled axes", within="#records")
    person.click("button", "Read again")
    person.sees("1 ready")
    person.sees("stage, y", within="#records .legend")
    person.identify(structure="maxwell_slip")
    rows = person.page.get_by_role("table", name="Verdict of each axis").locator("tbody tr")
    assert [text[0] for text in rows.all_inner_texts()] == ["x", "y"]
    person.sees(r"Coupling: y moves x by 4 %, x moves y by .3 %", within="#model")
    person.step("Path")
    person.sees("Choose a file first", within="#path")
    (tmp_path / "path.csv").write_text("time_s,y_um,x_um\n0,3,2\n1,8,10\n2,12,4\n")
    person.page.locator("#path-file").set_input_files(tmp_path / "path.csv")
    # Its rate is offered once it is read.
    person.until("() => [...document.querySelectorAll('#path input')].some((field) => field.value === '1')")
    person.sees("Expect x within", within="#plan-words")
    person.fill("Samples a second", 50, within="#path")
    person.write_voltage()
    _, content = person.download("link", "Download CSV", within="#voltage-list")
    (tmp_path / "voltage.csv").write_bytes(content)
    table = {column.name: column.data for column in read_table(tmp_path / "voltage.csv").columns}
    assert {"vx_V", "vy_V", "x_um", "y_um"} <= table.keys()
    assert (table["x_um"][-1], table["y_um"][-1]) == (pytest.approx(4), pytest.approx(12))
    person.step("Model")
    person.click("button", "Assess the model")
    person.sees("Axis y", within="#insight")
    person.step("Export")
    assert person.page.locator("#export .kinds h3").all_inner_texts() == ["C99", "Model and report"]


def test_a_model_is_assessed_checked_by_a_new_record_and_updated(person, loops, tmp_path):
    person.drop(loops)
    person.sees("1 ready")
    person.identify(structure="maxwell_slip")
    person.click("button", "Assess the model")
    person.sees("Where the records turned", within="#insight")
    # The gain of the actuator falls by 7 %.
    table = np.genfromtxt(loops, delimiter=",", names=True)
    rows = np.column_stack([table["time_s"], table["voltage_V"], 0.93 * table["displacement_um"]])
    later = tmp_path / "later.csv"
    np.savetxt(later, rows, fmt="%.6f", delimiter=",", header="time_s,voltage_V,displacement_um", comments="")
    person.step("Records")
    person.drop(later)
    person.sees("2 ready")
    person.click("button", "Check the model by later")
    person.sees("The gain has fallen", within="#check-result")
    person.click("button", "Update the model")
    person.sees("Updated from later", within="#model")


def test_the_card_of_a_rig_has_commands_that_exist(owner):
    owner.step("Export")
    lines = owner.page.locator("#rig pre").inner_text().splitlines()
    assert [line.split()[:2] for line in lines] == [["dehyst", name] for name in ("calibrate", "calibrate", "follow")]


def test_the_tutorial_shows_all_its_pictures():
    text = (places.DOCS / "tutorials" / "workbench.md").read_text()
    assert re.findall(r"\(workbench/(\w+)\.png\)", text) == list(PICTURES)

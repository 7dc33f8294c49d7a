"""The page in Debian's chromium, against a real server: journeys of a person, keys, errors, and accessibility."""

import re
import time
from itertools import pairwise

import numpy as np
import places
import pytest
from coupled_stage import excited
from workbench_client import held, served
from workbench_page import CHROMIUM, colours, visit
from workbench_tour import PICTURES

from dehyst import Actuator
from dehyst.records import read_table, write_record
from examples import at_night

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")

STEPS = ("records", "model", "path", "export")
TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
LONGEST = 60_000


@pytest.fixture(scope="module")
def workbench(tmp_path_factory):
    """A workbench; `opened` is the file in which its browser, a script, writes what it was asked to open."""
    folder = tmp_path_factory.mktemp("page")
    opener, opened = folder / "opener", folder / "opened"
    opener.write_text(f'#!/bin/sh\necho "$1" > {opened}.new\nmv {opened}.new {opened}\n')
    opener.chmod(0o755)
    with served(folder / "bench", browser=str(opener)) as running:
        running.opened = opened
        yield running


@pytest.fixture(scope="module")
def journey(browser, workbench, loops):
    """A page after the shortest way from a record to a voltage: its clicks, the downloaded CSV, and seconds."""
    with visit(browser, workbench) as visitor:
        began = time.monotonic()
        visitor.drop(loops)
        visitor.identify(structure="maxwell_slip")
        visitor.click("button", "Make a voltage")
        visitor.write_voltage()
        _, content = visitor.download("link", "Download CSV")
        yield visitor.page, visitor.clicks, content.decode(), time.monotonic() - began
        assert (visitor.complaints, visitor.elsewhere) == ([], [])


@pytest.fixture
def page(journey):
    return journey[0]


def test_the_private_file_admits_a_browser(browser, workbench):
    deadline = time.monotonic() + 60
    while not workbench.opened.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    argument = workbench.opened.read_text().strip()
    assert argument.startswith("file://") and "token=" not in argument
    page = browser.new_page()
    page.goto(argument)
    sync_api.expect(page.locator("#connection")).to_have_text("Connected", timeout=LONGEST)
    assert page.url.startswith(workbench.base)
    page.close()


def test_an_empty_page_explains_a_record_and_has_an_example(browser, workbench):
    with visit(browser, workbench) as visitor:
        page = visitor.page
        sample = page.locator(".drop pre")
        for width in (1400, 400):
            page.set_viewport_size({"width": width, "height": 900})
            assert "displacement_um" in sample.inner_text()
            assert sample.evaluate("one => one.scrollWidth - one.clientWidth") <= 0
        said = page.inner_text("#drop")
        assert all(name in said for name in ("CSV", "Excel", "LabVIEW", "MATLAB", "HDF5"))
        page.click("#example")
        ready = page.locator("#record-list .card.ready")
        sync_api.expect(ready).to_have_count(1, timeout=LONGEST)
        assert ready.locator("h3").all_inner_texts() == ["virtual-loops"]
        assert page.locator("#identify").is_enabled()
        page.click('[aria-label="Remove virtual-loops from the list"]')
        ready.wait_for(state="detached")


def test_a_voltage_takes_five_clicks_and_two_minutes(journey):
    _, clicks, text, seconds = journey
    assert clicks <= 5 and seconds < 120
    rows = np.genfromtxt(text.splitlines(), delimiter=",", names=True)
    assert rows["voltage_V"].min() >= 0 and rows["voltage_V"].max() <= 100
    assert rows.size > 1000


def test_the_verdict_comes_first(page):
    page.click("#step-model")
    assert "of the stroke" in page.inner_text("#verdict .outcome b")
    assert page.locator("#verdict").bounding_box()["y"] < page.locator("#model .figure >> nth=0").bounding_box()["y"]


def drawn(page):
    """Wait until what was typed or moved is drawn: changes are drawn at the next frame."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def values(page):
    """Read the points of the path, as they are written."""
    drawn(page)
    rows = page.locator("#points").input_value().split("\n")
    return [[float(word) for word in row.split()] for row in rows]


def test_points_are_moved_by_pointer_and_by_text(page):
    page.click("#step-path")
    page.check("input[value=points]")
    page.wait_for_selector("#path .point")
    handles, text = page.locator("#path .point"), page.locator("#points")
    before = values(page)
    box = page.locator("#path .chart").first.bounding_box()
    x, y = box["x"] + 0.6 * box["width"], box["y"] + 30
    page.mouse.dblclick(x, y)
    sync_api.expect(handles).to_have_count(len(before) + 1)
    drawn(page)
    written = text.input_value()
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y + 90, steps=5)
    page.mouse.up()
    sync_api.expect(text).not_to_have_value(written)
    page.mouse.dblclick(x, y + 90)
    sync_api.expect(handles).to_have_count(len(before))
    assert values(page) == before
    text.fill("0 3\n0.5\t6x5\n1 3")
    text.blur()
    sync_api.expect(page.locator("#plan-words .first")).to_contain_text("has no voltage yet")
    text.fill("0 3\n0.5\t6,5\n1 3")
    text.blur()
    sync_api.expect(handles).to_have_count(3)
    assert values(page) == [[0, 3], [0.5, 6.5], [1, 3]]


def test_an_unreachable_path_is_reported_at_once(page):
    page.click("#step-path")
    page.check("input[value=scan]")
    high = page.locator("#path-high")
    high.fill("40")
    page.wait_for_selector("#plan-words.red", timeout=LONGEST)
    assert "are clamped" in page.inner_text("#plan-words")
    high.fill("x")
    page.wait_for_selector("#path .error:not(:empty)")
    assert "need a number" in page.inner_text("#path .error >> nth=0")
    sync_api.expect(page.locator("#plan-words .first")).to_contain_text("has no voltage yet")
    high.fill("100")
    page.wait_for_selector("#plan-words:not(.red)")
    frequency = page.locator("#scan-frequency")
    usual = frequency.input_value()
    frequency.fill("40")
    page.wait_for_selector("#plan-words.amber", timeout=LONGEST)
    sync_api.expect(page.locator("#plan-words .first")).not_to_contain_text("%")
    frequency.fill(usual)
    sync_api.expect(page.locator("#plan-words .first")).to_contain_text("of the stroke")


def test_a_refused_file_gets_a_form_that_corrects_it(page, loops, tmp_path):
    bad = tmp_path / "bad.csv"
    bad.write_text(loops.read_text().replace("time_s,voltage_V,displacement_um", "when,a,a"))
    page.click("#step-records")
    page.set_input_files("#file", bad)
    card = page.locator(".card.refused")
    card.wait_for(timeout=LONGEST)
    assert "when" in card.locator(".error >> nth=0").inner_text()
    columns = ("", "when", "a", "a")
    for at, quantity in enumerate(("time", "voltage", "displacement"), 1):
        choice = card.get_by_label(f"Column of the {quantity}")
        assert choice.evaluate("one => one.options.length") == len(columns)
        choice.select_option(index=at)
    for unit, symbol in zip(card.get_by_label("Unit").all(), ("s", "V", "um"), strict=True):
        unit.select_option(symbol)
    card.get_by_role("button", name="Read again").click()
    sync_api.expect(page.locator("#record-list .card.ready")).to_have_count(2, timeout=LONGEST)
    facts = page.locator("#record-list .facts").all_inner_texts()
    assert facts[0] == facts[1]
    page.click('[aria-label="Remove bad from the list"]')
    page.wait_for_selector("#record-list .card:nth-child(2)", state="detached")


def test_unreadable_files_are_first_in_the_list_without_a_form(page, loops, tmp_path):
    page.click("#step-records")
    contents = {
        "scope.csv": loops.read_bytes().replace(b"time_s", b"when"),
        "zeros.csv": bytes(4000),
        "broken.mat": b"nothing of MATLAB" * 40,
    }
    page.set_viewport_size({"width": 1400, "height": 500})
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
        page.evaluate("() => window.scrollTo(0, document.body.scrollHeight)")
        page.set_input_files("#file", tmp_path / name)
        card = page.locator("#record-list > li").first
        sync_api.expect(card.locator("h3")).to_have_text(name.split(".")[0])
        card.locator(".error").first.wait_for(timeout=LONGEST)
        sync_api.expect(card).to_be_in_viewport()
        assert card.locator("select").count() == (6 if name == "scope.csv" else 0)
        words = card.locator(".error").first.inner_text()
        assert words.startswith(name)
        assert "uploads" not in words
    assert "3 need" in page.inner_text("#step-records")
    for name in contents:
        page.click(f'[aria-label="Remove {name.split(".")[0]} from the list"]')
    page.wait_for_selector("#record-list .card:nth-child(2)", state="detached")
    page.set_viewport_size({"width": 1400, "height": 900})


def test_the_back_button_opens_the_last_step(page, workbench):
    page.click("#step-records")
    for step in ("model", "export"):
        page.click(f"#step-{step}")
    for move, step in ((page.go_back, "model"), (page.go_back, "records"), (page.go_forward, "model")):
        move()
        sync_api.expect(page.locator(f"#{step}")).to_be_visible()
    assert page.url.startswith(workbench.base)


@pytest.fixture(params=[1400, 1000, 400])
def narrow(page, request):
    page.set_viewport_size({"width": request.param, "height": 900})
    yield page
    page.set_viewport_size({"width": 1400, "height": 900})


def test_the_page_fits_the_window_and_has_room_for_all_steps(narrow):
    for step in STEPS:
        narrow.click(f"#step-{step}")
        assert narrow.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0, step
        sync_api.expect(narrow.locator(f"#step-{step}")).to_be_in_viewport(ratio=0.99)
    wide = "tabs => tabs.map(tab => [...tab.children].map(one => one.scrollWidth - one.clientWidth)).flat()"
    assert max(narrow.locator("#steps button").evaluate_all(wide)) <= 0
    boxes = [title.bounding_box() for title in narrow.locator("#steps .title").all()]
    assert all(box["x"] + box["width"] <= after["x"] for box, after in pairwise(boxes))
    narrow.click("#step-records")
    sync_api.expect(narrow.get_by_text("Choose a file")).to_be_visible()
    sync_api.expect(narrow.locator("#identify")).to_be_visible()


@pytest.mark.parametrize("scheme", ["light", at_night("dark")])
def test_the_page_passes_the_accessibility_checks_of_axe(journey, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe-playwright-python").Axe()
    page = journey[0]
    page.emulate_media(color_scheme=scheme)
    for step in STEPS:
        page.click(f"#step-{step}")
        found = axe.run(page, options={"runOnly": TAGS}).response["violations"]
        assert [(finding["id"], [node["html"] for node in finding["nodes"]]) for finding in found] == [], step


@pytest.fixture
def person(browser, bench):
    with visit(browser, bench) as visitor:
        yield visitor
        assert (visitor.complaints, visitor.elsewhere) == ([], [])


@pytest.fixture
def owner(browser, workbench, journey):
    """A second visitor of the workbench, which has a model by now."""
    with visit(browser, workbench) as visitor:
        visitor.sees("1 ready")
        yield visitor
        assert (visitor.complaints, visitor.elsewhere) == ([], [])


def test_a_dropped_record_is_drawn_and_its_identification_can_be_cancelled(person, bench, loops):
    person.page.evaluate(
        """([name, text]) => {
            const transfer = new DataTransfer();
            transfer.items.add(new File([text], name));
            for (const kind of ["dragenter", "dragover", "drop"]) {
                const event = new DragEvent(kind, { dataTransfer: transfer, bubbles: true, cancelable: true });
                document.body.dispatchEvent(event);
            }
        }""",
        ["dropped.csv", loops.read_text()],
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


@pytest.mark.parametrize("kind", ["triangle", "raster", at_night("steps")])
def test_each_scan_can_be_followed_with_the_planned_voltages(owner, workbench, kind):
    """The page computes in WebAssembly, the server by the command: on the path they agree."""
    owner.step("Path")
    owner.page.get_by_label("A scan").check()
    owner.page.get_by_label("Scan", exact=True).select_option(kind)
    owner.until("(kind) => document.querySelector('#scan-kind').value === kind", kind)
    owner.sees("The path can be followed", within="#plan-words")
    planned, rate = owner.page.locator("#plan-words").inner_text(), owner.page.input_value("#path-rate")
    low, high = (float(number) for number in re.search(r"([\d.]+) to ([\d.]+) V", planned).groups())
    owner.write_voltage()
    file = max((workbench.folder / "voltages").iterdir(), key=lambda path: path.stat().st_mtime)
    # The promise in the headline is that of the file, and its card has the values of the form.
    owner.sees(f"promise of the file voltages/{file.name}", within="#plan-words")
    promised = re.search(r"within [\d.]+ nm", owner.page.inner_text("#plan-words .first"))[0]
    named, told = (owner.page.locator(f"#voltage-list li >> nth=0 >> {tag}").all_inner_texts() for tag in ("dt", "dd"))
    card = dict(zip(named, told, strict=True))
    assert (card["Promise"], card["Scan"], card["Samples a second"]) == (promised, kind.capitalize(), f"{rate} Hz")
    owner.page.reload()
    owner.sees(promised, within="#plan-words")
    assert owner.page.input_value("#scan-kind") == kind
    table = {column.name: column.data for column in read_table(file).columns}
    on_path = table["voltage_V"][table["phase"] == table["phase"].max()]
    assert float(on_path.max()) == pytest.approx(high, rel=0.02)
    assert float(on_path.min()) == pytest.approx(low, abs=2)


def test_exports_and_the_script_can_be_downloaded(owner):
    owner.step("Export")
    for name, suffix in (("C99", "-c"), ("FMU", ".fmu"), ("WebAssembly", ".wasm")):
        card = owner.page.locator("#export li").filter(has=owner.page.get_by_role("heading", name=name))
        card.get_by_role("button").first.click()
        owner.page.locator("#files").get_by_text(re.compile(rf"exports/loops.*{suffix.split('.')[0]}")).first.wait_for()
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


def test_coupled_axes_are_read_identified_and_compensated(person, bench, tmp_path):
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


def test_the_card_of_a_rig_has_commands_that_exist(owner, workbench):
    owner.step("Export")
    lines = [line.split() for line in owner.page.inner_text("#rig pre").splitlines()]
    assert [line[:2] for line in lines] == [["dehyst", name] for name in ("calibrate", "calibrate", "follow")]
    limits = Actuator.load(workbench.folder / "models" / "loops.json").limits
    assert tuple(map(float, lines[1][4:6])) == pytest.approx(limits, rel=1e-5)
    # No option breaks at its hyphens.
    owner.page.set_viewport_size({"width": 400, "height": 900})
    options = owner.page.locator("#script .word").filter(has_text=re.compile("^--"))
    assert len({*options.evaluate_all("words => words.map((word) => word.offsetHeight)")}) == 1


def test_the_tutorial_shows_all_its_pictures():
    text = (places.DOCS / "tutorials" / "workbench.md").read_text()
    assert re.findall(r"\(workbench/(\w+)\.png\)", text) == list(PICTURES)

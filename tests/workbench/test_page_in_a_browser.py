"""The page in a real browser: few clicks from a record to a voltage, keys, errors, the stop, and accessibility."""

import json
import shutil

import numpy as np
import pytest
from workbench_client import served

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")

STEPS = ("records", "model", "trust", "path", "export", "rig")
TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
LONGEST = 60_000
RIG = {
    "status": "armed",
    "address": "sim://play",
    "name": "a simulated stage",
    "axis": "1",
    "limits": [0, 100],
    "slew": 1000,
    "safe": 0,
    "voltage": 12.5,
    "displacement_um": 1.5,
    "step": "loops",
    "progress": 0.4,
    "words": [],
    "error": None,
    "plan": None,
    "result": None,
}


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def workbench(tmp_path_factory):
    with served(tmp_path_factory.mktemp("page") / "bench") as running:
        yield running


@pytest.fixture(scope="module")
def start(browser, workbench):
    """A way to open the page; whatever the console writes or leaves this machine fails the test."""
    contexts, complaints, foreign = [], [], []

    def open_page(**options):
        context = browser.new_context(viewport={"width": 1400, "height": 900}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: request.url.startswith(workbench.base) or foreign.append(request.url))
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []
    assert foreign == []


@pytest.fixture(scope="module")
def journey(start, workbench, loops):
    """A page after the shortest way from a record to a voltage: its clicks, and the file that was downloaded."""
    page = start(accept_downloads=True)
    page.goto(workbench.link)
    clicks = []

    def click(selector):
        clicks.append(selector)
        page.click(selector, timeout=LONGEST)

    page.set_input_files("#file", loops)
    clicks.append("drop")
    page.click(".identify summary")
    page.select_option(".identify select >> nth=0", "paper")
    click("#identify:not([disabled])")
    click("text=Make a voltage")
    click("#write")
    with page.expect_download(timeout=LONGEST) as download:
        click("text=Download CSV")
    return page, clicks, download.value.path().read_text()


def test_a_voltage_takes_five_clicks(journey):
    _, clicks, text = journey
    assert len(clicks) <= 5
    rows = np.genfromtxt(text.splitlines(), delimiter=",", names=True)
    assert rows["voltage_V"].min() >= 0 and rows["voltage_V"].max() <= 100
    assert rows.size > 1000


def test_the_verdict_comes_first(journey):
    page = journey[0]
    page.click("#step-model")
    assert "of the stroke" in page.inner_text("#verdict .outcome b")
    assert page.locator("#verdict").bounding_box()["y"] < page.locator("#model .figure >> nth=0").bounding_box()["y"]


def values(page):
    """Read the table of points in one look: the page may be drawing it anew."""
    rows = "rows => rows.map(row => [...row.querySelectorAll('input')].map(one => Number(one.value)))"
    return page.locator(".points tbody tr").evaluate_all(rows)


def test_points_are_moved_by_pointer_and_by_keys(journey):
    page = journey[0]
    page.click("#step-path")
    page.check("input[value=points]")
    page.wait_for_selector(".points tbody tr")
    before = values(page)
    cells = page.locator(".points tbody tr").nth(1).locator("input")
    written = [cell.input_value() for cell in cells.all()]
    canvas = page.locator("#path canvas[role=img]").first
    canvas.focus()
    page.keyboard.press("n")
    page.keyboard.press("n")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Shift+ArrowRight")
    # The table is drawn at the next frame.
    for cell, value in zip(cells.all(), written, strict=True):
        sync_api.expect(cell).not_to_have_value(value)
    after = values(page)
    assert after[1][0] > before[1][0] and after[1][1] > before[1][1]
    assert [after[0], *after[2:]] == [before[0], *before[2:]]
    page.keyboard.press("Insert")
    sync_api.expect(page.locator(".points tbody tr")).to_have_count(len(before) + 1)
    page.keyboard.press("Delete")
    sync_api.expect(page.locator(".points tbody tr")).to_have_count(len(before))
    assert values(page) == after
    box = canvas.bounding_box()
    page.mouse.dblclick(box["x"] + 0.6 * box["width"], box["y"] + 30)
    sync_api.expect(page.locator(".points tbody tr")).to_have_count(len(before) + 1)
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 30)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 120, steps=5)
    page.mouse.up()
    assert "Point" in page.inner_text("#path .readout >> nth=0")


def test_what_cannot_be_reached_is_said_at_once(journey):
    page = journey[0]
    page.click("#step-path")
    page.check("input[value=scan]")
    high = page.get_by_label("Highest voltage (V)")
    high.fill("40")
    page.wait_for_selector("#plan-words.red", timeout=LONGEST)
    assert "cut at a limit" in page.inner_text("#plan-words")
    high.fill("x")
    page.wait_for_selector("#path .error:not(:empty)")
    assert "need a number" in page.inner_text("#path .error >> nth=0")
    high.fill("100")
    page.wait_for_selector("#plan-words:not(.red)")


def test_a_bad_file_brings_the_form_that_mends_it(journey, loops, tmp_path):
    page = journey[0]
    bad = tmp_path / "bad.csv"
    bad.write_text(loops.read_text().replace("time_s,voltage_V,displacement_um", "when,a,b"))
    page.click("#step-records")
    page.set_input_files("#file", bad)
    card = page.locator(".card.refused")
    card.wait_for(timeout=LONGEST)
    assert "when" in card.locator(".error >> nth=0").inner_text()
    card.get_by_label("Or all columns in their order").fill("time:s,voltage:V,displacement:um")
    card.get_by_role("button", name="Read again").click()
    page.wait_for_selector("#record-list .card.ready:nth-child(2)", timeout=LONGEST)
    page.click('[aria-label="Remove bad from the list"]')
    page.wait_for_selector("#record-list .card:nth-child(2)", state="detached")


@pytest.mark.parametrize("width", [1400, 1000, 400])
def test_nothing_is_wider_than_the_window(journey, width):
    page = journey[0]
    page.set_viewport_size({"width": width, "height": 900})
    for step in STEPS:
        if page.is_visible(f"#step-{step}"):
            page.click(f"#step-{step}")
            assert page.evaluate("() => document.documentElement.scrollWidth - innerWidth") <= 0, step
    page.set_viewport_size({"width": 1400, "height": 900})


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(journey, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe-playwright-python").Axe()
    page = journey[0]
    page.emulate_media(color_scheme=scheme)
    for step in STEPS:
        page.click(f"#step-{step}")
        found = axe.run(page, options={"runOnly": TAGS}).response["violations"]
        assert [(one["id"], [node["html"] for node in one["nodes"]]) for one in found] == [], step


def test_escape_and_the_button_stop_a_rig_twice_over(start, workbench, journey):
    page, stopped, sockets = start(storage_state=journey[0].context.storage_state()), [], []

    def news(route):
        server = route.connect_to_server()
        sockets.append(route)

        def with_rig(message):
            news = json.loads(message)
            if news["kind"] == "state":
                news["state"]["rig"] = {**RIG, "stop": {"port": workbench.port, "key": "k"}}
            route.send(json.dumps(news))

        server.on_message(with_rig)

    def stop(route):
        stopped.append((route.request.url, route.request.headers.get("x-dehyst-stop")))
        route.fulfill(status=200, body="{}")

    page.route_web_socket("**/api/events", news)
    page.route("**/stop", stop)
    page.goto(workbench.base)
    page.wait_for_selector("#rig-bar:not([hidden])", timeout=LONGEST)
    page.keyboard.press("Escape")
    page.wait_for_selector(".rig-answer:not(:empty)")
    both = {(f"{workbench.base}/stop", "k"), (f"{workbench.base}/api/rig/stop", None)}
    assert set(stopped) == both
    stopped.clear()
    page.click(".stop")
    page.wait_for_timeout(200)
    assert set(stopped) == both
    assert page.locator(".stop").bounding_box()["height"] >= 60

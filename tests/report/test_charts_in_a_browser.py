"""The charts of a report in a real browser: drawn, enlarged, read out; nothing is loaded."""

import numpy as np
import pytest
from workbench_page import CHROMIUM, colours

from dehyst.identification import Fit, Trace
from dehyst.identification.expectation import Expectation
from dehyst.model import Actuator, MaxwellSlip, Outcome, Promise, Spring
from dehyst.report import write_report

pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")

PROMISE = Promise("any path", 1e-8, 5e-8, {"model": 5e-8}, np.full(1, 5e-8), 2e-5, 0.0)
EXPECTED = Expectation(PROMISE, 1e-8, 1e-9, 1.0, "validation records")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    actuator = Actuator(MaxwellSlip([2e-6, 4e-6, 6e-6], [2e5, 1e5, 5e4]), Spring([0, 5e-6, 20e-6], [0, 6, 20]))
    time = np.arange(4000) * 1e-3
    voltage = 10 - 10 * np.cos(2 * np.pi * time)
    simulated = actuator.simulate(voltage).displacement
    measured = simulated + np.random.default_rng(0).normal(0, 2e-8, time.size)
    trace = Trace("loops", "training", time, voltage, measured, simulated, began=-0.5)
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(path, Fit(actuator, Outcome.IDENTIFIED, EXPECTED, traces=(trace,)))
    return path


@pytest.fixture
def page(browser, file):
    opened = browser.new_page(viewport={"width": 1400, "height": 900})
    complaints, requests = [], []
    opened.on("console", lambda message: complaints.append(message.text))
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    opened.on("request", lambda request: requests.append(request.url))
    opened.goto(file.as_uri())
    yield opened
    opened.close()
    assert complaints == []
    assert requests == [file.as_uri()]


def middle(canvas):
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_every_chart_is_drawn_in_colour(page):
    charts = page.locator(".chart canvas:first-child")
    # Before and after, a loop, two residuals, turning points; slip elements.
    assert charts.count() == 6
    assert all(colours(canvas) > 20 for canvas in charts.all())


def test_a_drag_enlarges_and_a_double_click_shows_all(page):
    canvas = page.locator("canvas[tabindex]").first
    button = page.get_by_role("button", name="Show all").first
    x, y = middle(canvas)
    figure = page.locator(".figure").first
    before = figure.screenshot()
    assert not button.is_visible()
    page.mouse.move(x - 100, y - 60)
    page.mouse.down()
    page.mouse.move(x + 100, y + 60)
    page.mouse.up()
    assert button.is_visible()
    assert figure.screenshot() != before
    button.click()
    assert not button.is_visible()
    canvas.focus()
    page.keyboard.press("+")
    assert button.is_visible()
    page.mouse.dblclick(x, y)
    assert not button.is_visible()


def test_a_click_in_the_legend_hides_a_series(page):
    figure = page.locator(".figure").first
    key = figure.get_by_role("button", name="straight scale factor")
    before = figure.locator(".chart").screenshot()
    key.click()
    assert key.get_attribute("aria-pressed") == "false"
    page.wait_for_timeout(200)
    assert figure.locator(".chart").screenshot() != before


def test_the_pointer_reads_out_a_sample(page):
    canvas = page.locator("canvas[tabindex]").first
    x, y = middle(canvas)
    page.mouse.move(x, y)
    words = page.locator("output").first.inner_text()
    name, place, error = words.split(" · ")
    assert name in ("straight scale factor", "this model")
    assert place.endswith(" µm") and 0 < float(place[:-3]) < 40
    assert "% of stroke (" in error


def test_the_dark_page_has_light_curves(browser, file):
    shown = {}
    for scheme in ("light", "dark"):
        page = browser.new_page(color_scheme=scheme)
        page.goto(file.as_uri())
        page.locator(".chart canvas").first.wait_for()
        page.wait_for_timeout(200)
        shown[scheme] = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert colours(page.locator("canvas").first) > 20
        page.close()
    assert shown == {"light": "rgb(255, 255, 255)", "dark": "rgb(22, 24, 27)"}


def test_a_report_fits_a_telephone(browser, file):
    page = browser.new_page(viewport={"width": 400, "height": 800})
    page.goto(file.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    page.close()

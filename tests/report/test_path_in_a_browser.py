"""The path that a reader of the report drags, in a real browser: voltage, clamps and errors, and nothing is loaded."""

import re
import shutil
from dataclasses import replace

import compiled_exports
import numpy as np
import pytest

from dehyst import Compensator
from dehyst.control import PossibleStart
from dehyst.identification import Fit, Outcome, Trace
from dehyst.model import Actuator, MaxwellSlip, Spring
from dehyst.report import write_report
from dehyst.report.actuator_section import SAMPLES, path_trial
from dehyst.report.report import render
from examples import at_night

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Debian's chromium")

ACTUATOR = Actuator(
    MaxwellSlip([2e-6, 4e-6, 6e-6], [2e5, 1e5, 5e4]), Spring([0, 5e-6, 20e-6], [0, 6, 20]), limits=(0, 20)
)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(path, Fit(ACTUATOR, Outcome.IDENTIFIED))
    return path


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser, file):
    opened = browser.new_page(viewport={"width": 1400, "height": 900})
    complaints, requests = [], []
    opened.on("console", lambda message: complaints.append(message.text))
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    opened.on("request", lambda request: requests.append(request.url))
    opened.goto(file.as_uri())
    opened.locator("#path-trial.ready").wait_for()
    yield opened
    opened.close()
    assert complaints == []
    assert requests == [file.as_uri()]


def words(page):
    return page.locator("#plan-words").inner_text()


def points(page):
    return page.locator("#path-trial [role=slider]")


def charts(page):
    """Pictures of path, voltage and error."""
    return [page.locator("#path-trial .chart").nth(i) for i in range(3)]


def pictures(page):
    # A frame later all is drawn.
    page.wait_for_timeout(100)
    return [chart.screenshot() for chart in charts(page)]


def straight(page):
    """The largest error of a straight gain [um], as the page says it."""
    return float(re.search(r"A straight gain would miss it by up to ([\d.]+) µm", words(page))[1])


def missed(page):
    """The largest error where voltages are clamped [um]."""
    return float(re.search(r"is missed by up to ([\d.]+) µm", words(page))[1])


def test_the_model_follows_and_a_straight_gain_does_not(page):
    assert "can be followed" in words(page)
    assert straight(page) > 0.5


def test_the_page_says_the_errors_that_python_computes(page):
    start = PossibleStart.named(ACTUATOR, "bottom").state
    model = Compensator(ACTUATOR, state=start)
    bottom, top = model.reach
    shares = [0.1, 0.9, 0.1, 0.9, 0.1]
    page.get_by_label("Path", exact=True).select_option("triangle")
    wanted = bottom + (top - bottom) * np.interp(np.linspace(0, 4, SAMPLES), range(5), shares)
    low, high = ACTUATOR.limits
    voltage = low + (wanted - bottom) / (top - bottom) * (high - low)
    moved = ACTUATOR.simulate(voltage, state=model.state).displacement
    assert straight(page) == float(f"{1e6 * np.abs(moved - wanted).max():.3g}")


def test_a_dragged_point_changes_voltage_and_error(page):
    before = pictures(page)
    handle = points(page).nth(1)
    handle.scroll_into_view_if_needed()
    box = handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    place = handle.get_attribute("aria-valuetext")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y + 90, steps=5)
    page.mouse.up()
    page.mouse.move(x + 200, y)
    assert handle.get_attribute("aria-valuetext") != place
    moved = handle.bounding_box()
    assert moved["x"] - box["x"] == pytest.approx(30, abs=2) and moved["y"] - box["y"] == pytest.approx(90, abs=2)
    assert all(now != one for now, one in zip(pictures(page), before, strict=True))
    # The pictures keep to the data: the point is where its numbers are.
    t, y = (float(text.split()[0]) for text in reversed(handle.get_attribute("aria-valuetext").split(" at ")))
    first, last = (
        float(one.get_attribute("aria-valuetext").split()[-2]) for one in (points(page).first, points(page).last)
    )
    assert first < t < last and y < float(place.split()[0])


def test_a_point_beyond_the_reach_is_clamped(page):
    handle = points(page).nth(1)
    handle.scroll_into_view_if_needed()
    box = handle.bounding_box()
    page.mouse.move(box["x"] + 13, box["y"] + 13)
    page.mouse.down()
    page.mouse.move(box["x"] + 13, 0, steps=3)
    page.mouse.up()
    assert re.search(r"^[1-9][\d\u202f]* samples are cut at a limit", words(page))
    assert "clamped" in page.locator("#path-trial .legend").nth(1).inner_text()
    assert float(handle.get_attribute("aria-valuenow")) == float(handle.get_attribute("aria-valuemax"))


def test_a_keyboard_does_all(page):
    page.get_by_label("Path", exact=True).select_option("triangle")
    handle = points(page).nth(2)
    handle.focus()
    before = float(handle.get_attribute("aria-valuenow"))
    page.keyboard.press("Shift+ArrowUp")
    low, high = (1e6 * end for end in Compensator(ACTUATOR).reach)
    assert float(handle.get_attribute("aria-valuenow")) - before == pytest.approx(0.1 * (high - low), abs=2e-3)
    page.keyboard.press("Insert")
    assert points(page).count() == 6
    page.keyboard.press("Delete")
    assert points(page).count() == 5
    # Neighbours are not passed, and the ends keep their times.
    for _ in range(30):
        page.keyboard.press("Shift+ArrowRight")
    times = [float(points(page).nth(i).get_attribute("aria-valuetext").split()[-2]) for i in range(5)]
    assert times == sorted(times) and len(set(times)) == 5
    points(page).nth(0).focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Delete")
    assert points(page).nth(0).get_attribute("aria-valuetext").endswith(" at 0 s")
    assert points(page).count() == 5


def test_a_double_click_adds_a_point_there(page):
    chart = charts(page)[0]
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    page.mouse.dblclick(box["x"] + 0.55 * box["width"], box["y"] + 0.3 * box["height"])
    assert points(page).count() == 9
    page.wait_for_timeout(100)
    found = page.locator("#path-trial [role=slider]:focus").bounding_box()
    assert found["x"] + 13 == pytest.approx(box["x"] + 0.55 * box["width"], abs=2)
    assert found["y"] + 13 == pytest.approx(box["y"] + 0.3 * box["height"], abs=2)


def test_limits_and_slew_rate_clamp(page):
    page.get_by_label("Highest voltage (V)").fill("12")
    assert re.search(r"^[1-9][\d\u202f]* samples are cut at a limit: ", words(page))
    assert missed(page) > 1
    page.get_by_label("Highest voltage (V)").fill("20")
    page.get_by_label("Slew rate (V/s)").fill("20")
    assert re.search(r"^[1-9][\d\u202f]* samples are held back by the slew rate", words(page))
    page.get_by_label("Duration (s)").fill("100")
    assert "can be followed" in words(page)
    page.get_by_label("Lowest voltage (V)").fill("30")
    assert "The lowest voltage is not below the highest one." in words(page)
    page.get_by_label("Lowest voltage (V)").fill("")
    assert "Lowest voltage: got nothing, need a number." in words(page)


def test_it_fits_a_telephone_and_paper(browser, file):
    page = browser.new_page(viewport={"width": 390, "height": 800}, color_scheme="dark")
    page.goto(file.as_uri())
    page.locator("#path-trial.ready").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert all(box["width"] >= 24 for box in (points(page).nth(i).bounding_box() for i in range(3)))
    page.emulate_media(media="print")
    assert not points(page).nth(0).is_visible() and not page.get_by_label("Path", exact=True).is_visible()
    page.close()


def test_the_path_lies_among_the_turning_points_of_the_records(browser, tmp_path):
    time = np.linspace(0, 10, 501)
    voltage = 10 - 10 * np.cos(0.4 * np.pi * time)
    moved = ACTUATOR.simulate(voltage).displacement
    fit = Fit(ACTUATOR, Outcome.IDENTIFIED, traces=(Trace("loops", "training", time, voltage, moved, moved),))
    write_report(tmp_path / "report.html", fit)
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    page.locator("#path-trial.ready").wait_for()
    plane = page.locator("figure", has=page.get_by_role("heading", name="Turning points"))
    assert plane.count() == 1 and page.locator("#path-trial figure").count() == 3
    assert [one.strip() for one in plane.locator(".legend button").all_inner_texts()] == ["records", "your path"]
    assert re.search(r"[1-9] of 7 branches of this path begin where no record turned", words(page))
    page.get_by_label("Path", exact=True).select_option("scan")
    assert "7 of 7 branches" in words(page)
    page.close()


def test_a_dragged_point_is_computed_in_a_frame(page):
    seconds = page.evaluate(
        """() => {
            const handle = document.querySelector("#path-trial [role=slider]");
            const found = [];
            for (let i = 0; i < 21; i++) {
                const begin = performance.now();
                handle.dispatchEvent(new KeyboardEvent("keydown", { key: i % 2 ? "ArrowUp" : "ArrowDown" }));
                found.push(performance.now() - begin);
            }
            return found.sort((a, b) => a - b)[10];
        }"""
    )
    assert seconds < 50


@pytest.mark.parametrize(
    "kind", [kind if kind in ("plain", "creep") else at_night(kind) for kind in compiled_exports.KINDS]
)
def test_every_class_of_model_is_served(browser, tmp_path, kind):
    actuator = compiled_exports.KINDS[kind]().actuator
    assert path_trial(Fit(replace(actuator, limits=None), Outcome.IDENTIFIED)) == ""
    fit = Fit(replace(actuator, limits=compiled_exports.LIMITS), Outcome.IDENTIFIED)
    (tmp_path / "report.html").write_text(render(fit))
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    page.locator("#path-trial.ready").wait_for()
    assert "straight gain" in words(page)
    page.close()

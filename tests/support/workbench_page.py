"""The actions of a person on the page of a workbench, in a real browser: for tests, pictures and measurements."""

import re
import shutil
from contextlib import contextmanager
from pathlib import Path

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    f"--{name}"
    for name in (
        *("no-sandbox", "disable-gpu", "disable-quic", "no-first-run"),
        *("disable-background-networking", "disable-component-update", "disable-sync"),
    )
]
# Longest time [ms] of an action on a loaded machine.
PATIENCE = 180_000


@contextmanager
def chromium():
    """Open a browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


def colours(place):
    """Number of colours of a canvas, or of the canvases in a place."""
    return place.evaluate(
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


class Visitor:
    """A person at the page of a workbench.

    `clicks`: how often the person clicked or dropped. `complaints`: what the page wrote on its console, and its errors.
    `elsewhere`: requests that left this machine's workbench.
    """

    def __init__(self, browser, served, *, width=1400, height=900, dark=False):
        scheme = "dark" if dark else "light"
        self.context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
        self.context.set_default_timeout(PATIENCE)
        self.served, self.clicks, self.complaints, self.elsewhere = served, 0, [], []
        self.page = self.tab()
        self.page.goto(served.link)
        # The page of the link redirects to the workbench; actions before that are lost.
        self.page.wait_for_url(re.compile(re.escape(served.base) + "/(#.*)?$"))

    def tab(self):
        """Open a page of this browser; the cookie is the browser's."""
        page = self.context.new_page()
        page.on("console", lambda message: self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self._note(request.url))
        return page

    def _note(self, url):
        if not url.startswith((self.served.base, "data:", "blob:", "http://127.0.0.1:")):
            self.elsewhere.append(url)

    def close(self):
        self.context.close()

    def click(self, role, name, *, within=None, exact=False):
        """Click the visible element with this role and name."""
        place = self.page if within is None else self.page.locator(within)
        place.get_by_role(role, name=name, exact=exact).locator("visible=true").first.click()
        self.clicks += 1

    def step(self, name):
        """Open a step of the journey."""
        self.click("tab", re.compile(name))

    def drop(self, path):
        """Give the page a file."""
        self.page.locator("#file").set_input_files(str(path))
        self.clicks += 1

    def sees(self, words, *, within="body"):
        """Wait until the page shows these words."""
        self.page.locator(within).get_by_text(re.compile(words)).locator("visible=true").first.wait_for()

    def fill(self, label, value, *, within="body"):
        """Write into a field."""
        self.page.locator(within).get_by_label(label).locator("visible=true").first.fill(str(value))

    def until(self, function, argument=None):
        """Wait until a JavaScript function returns true: by polling, as the page's policy allows no strings."""
        self.page.wait_for_function(function, arg=argument, polling=50)

    def identify(self, *, structure=None):
        """Identify a model from the records, and wait for the promise."""
        if structure is not None:
            self.page.locator("#records").get_by_text("Options", exact=True).click()
            self.page.locator("#records").get_by_label("Structure").select_option(structure)
        self.click("button", "Identify a model")
        self.sees("is the largest error to expect", within="#model")

    def write_voltage(self):
        """Write the voltage for the path that is shown."""
        before = self.page.locator("#voltage-list > li").count()
        self.click("button", "Write voltage")
        self.page.locator("#voltage-list > li").nth(before).wait_for()

    def download(self, role, name, *, within=None):
        """Click a link that downloads; return the file's name and content."""
        with self.page.expect_download() as waiting:
            self.click(role, name, within=within)
        got = waiting.value
        return got.suggested_filename, Path(got.path()).read_bytes()


@contextmanager
def visit(browser, served, **options):
    visitor = Visitor(browser, served, **options)
    try:
        yield visitor
    finally:
        visitor.close()

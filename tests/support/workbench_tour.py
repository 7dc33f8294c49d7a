"""The tutorial of the workbench in a real browser: its steps are a test, and its pictures are written.

`python tests/support/workbench_tour.py FOLDER` writes the pictures there: `make pictures` does so for the tutorial.
"""

import sys
import tempfile
from pathlib import Path

from workbench_client import served
from workbench_page import chromium, visit

from dehyst.operations import demo
from dehyst.records import write_record
from dehyst.virtual import PlayActuator

# Names of the pictures, in the order of the tutorial.
PICTURES = ("record", "verdict", "trust", "path", "export")


def tour(visitor, csv, look):
    """Go through the tutorial; call `look` with the name of each picture when the page shows it."""
    visitor.drop(csv)
    visitor.sees(r"\d in .*Hz", within="#records")
    look("record")
    visitor.identify()
    visitor.page.locator("#model canvas").first.wait_for()
    look("verdict")
    visitor.click("button", "Assess the model")
    visitor.sees("Where the records turned", within="#insight")
    look("trust")
    visitor.step("Path")
    visitor.page.get_by_label("Draw points").check()
    visitor.sees("The path can be followed", within="#path")
    visitor.write_voltage()
    look("path")
    visitor.step("Export")
    visitor.sees("commands.sh", within="#files")
    look("export")


def played(folder, browser):
    """Play the tour with a new workbench; write NAME.png into a folder for each picture; return complaints."""
    with tempfile.TemporaryDirectory() as place:
        loops = Path(place) / "loops.csv"
        write_record(loops, demo.record_loops(PlayActuator())[0])
        with served(Path(place) / "my-stage") as bench, visit(browser, bench, width=1200, height=800) as visitor:

            def shot(name):
                top = "window.scrollTo({ top: 0, behavior: 'instant' })"
                visitor.page.evaluate(f"() => {{ document.activeElement?.blur(); {top}; }}")
                # The next frame has everything drawn.
                visitor.page.wait_for_timeout(300)
                visitor.page.screenshot(path=str(Path(folder) / f"{name}.png"))

            tour(visitor, loops, shot)
            return visitor.complaints + visitor.elsewhere


if __name__ == "__main__":
    Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
    with chromium() as opened:
        sys.exit("\n".join(played(sys.argv[1], opened)) or 0)

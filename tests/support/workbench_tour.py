"""The tutorial of the workbench, played in a real browser: its steps as a test, and its pictures.

`python tests/support/workbench_tour.py FOLDER` writes the pictures there: `make pictures` does so for the tutorial.
"""

import re
import sys
import tempfile
from pathlib import Path

from workbench_client import served
from workbench_page import chromium, emulator, visit

from dehyst.records import write_record
from dehyst.studies import demo
from dehyst.virtual import PlayActuator

# Names of the pictures, in the order of the tutorial.
PICTURES = ("record", "verdict", "trust", "path", "export", "plan", "live")
LIMITS, SLEW = (0, 200), 1000


def tour(visitor, csv, address, look):
    """Go through the tutorial; call `look` with the name of each picture when the page shows it."""
    visitor.drop(csv)
    visitor.sees(r"\d in .*Hz", within="#records")
    look("record")
    visitor.identify()
    visitor.page.locator("#model canvas").first.wait_for()
    look("verdict")
    visitor.click("button", "How far to trust it")
    visitor.click("button", "Assess the model")
    visitor.sees("When the state becomes known", within="#trust-insight")
    visitor.sees("Where the records turned", within="#trust-turns")
    look("trust")
    visitor.step("Path")
    visitor.page.get_by_label("Draw points").check()
    visitor.sees("The path can be followed", within="#path")
    visitor.write_voltage()
    look("path")
    visitor.step("Export")
    visitor.sees("commands.sh", within="#files")
    look("export")
    visitor.connect(address, LIMITS, SLEW)
    visitor.fill(re.compile("^Further rounds"), 0, within="#rig-calibration")
    visitor.click("button", "Show the plan")
    visitor.sees("major loops", within="#rig-plan")
    look("plan")
    visitor.arm(LIMITS, SLEW)
    visitor.click("button", "Calibrate", within="#rig-calibration", exact=True)
    visitor.sees("^calibrating: compensated", within="#rig-bar")
    visitor.until("() => document.querySelector('#rig-bar progress').value > 0.5")
    look("live")
    visitor.sees("^armed", within="#rig-bar")
    visitor.click("button", "Disconnect")
    visitor.page.locator("#rig-bar").wait_for(state="hidden")


def played(folder, browser):
    """Play the tour with a workbench of its own; write NAME.png into a folder for each picture; return complaints."""
    with tempfile.TemporaryDirectory() as place:
        loops = Path(place) / "loops.csv"
        write_record(loops, demo.record_loops(PlayActuator())[0])
        with (
            served(Path(place) / "my-stage") as bench,
            emulator("--speed", "4") as address,
            visit(browser, bench, width=1200, height=800) as visitor,
        ):

            def shot(name):
                top = "window.scrollTo({ top: 0, behavior: 'instant' })"
                visitor.page.evaluate(f"() => {{ document.activeElement?.blur(); {top}; }}")
                # A frame later all is drawn.
                visitor.page.wait_for_timeout(300)
                visitor.page.screenshot(path=str(Path(folder) / f"{name}.png"))

            tour(visitor, loops, address, shot)
            return visitor.complaints + visitor.elsewhere


if __name__ == "__main__":
    Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
    with chromium() as opened:
        sys.exit("\n".join(played(sys.argv[1], opened)) or 0)

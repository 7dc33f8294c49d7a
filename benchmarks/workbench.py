"""What a person waits for at the workbench, in Debian's chromium without a graphics card; writes workbench.json.

Wall-clock times, as a person meets them: run it on an idle machine.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from workbench_client import Served, served  # noqa: E402
from workbench_page import Visitor, chromium, visit  # noqa: E402

from dehyst.operations import demo  # noqa: E402
from dehyst.records import write_record  # noqa: E402
from dehyst.virtual import PlayActuator  # noqa: E402

RESULT = ROOT / "benchmarks" / "workbench.json"
SAMPLES = 1_000_000
RUNS = 5
# Draws a loop of a million samples, then moves and enlarges it at each frame.
DRAWING = """async samples => {
    const { Chart } = await import("/page/chart.js");
    const holder = document.createElement("div");
    Object.assign(holder.style, { position: "fixed", inset: "0", width: "1000px", height: "600px", zIndex: 99 });
    document.body.append(holder);
    const v = new Float32Array(samples);
    const y = new Float32Array(samples);
    let seed = 1;
    const noise = () => ((seed = (seed * 16807) % 2147483647) / 2147483647 - 0.5) * 0.01;
    for (let k = 0; k < samples; k += 1) {
        const phase = (200 * 2 * Math.PI * k) / samples;
        const top = 50 * (1 - (0.8 * k) / samples);
        v[k] = 50 - top * Math.cos(phase);
        y[k] = 0.1 * v[k] + 0.02 * top * Math.sin(phase) + noise();
    }
    const chart = new Chart(holder, { label: "a million samples" });
    const spec = { x: { label: "V" }, y: { label: "um" }, series: [{ name: "loop", x: v, y, colour: "measured" }] };
    chart.set(spec);
    cancelAnimationFrame(chart.asked);
    chart.asked = undefined;
    const first = performance.now();
    chart.draw();
    const firstDraw = performance.now() - first;
    const moving = async (change, seconds) => {
        const began = performance.now();
        let frames = 0;
        while (performance.now() - began < 1000 * seconds) {
            chart.show(change(chart.view, frames));
            await new Promise(requestAnimationFrame);
            await new Promise((done) => setTimeout(done, 0));
            frames += 1;
        }
        return (1000 * frames) / (performance.now() - began);
    };
    const shifted = ([a, b], by) => [a + by * (b - a), b + by * (b - a)];
    const scaled = ([a, b], by) => [a + ((1 - by) * (b - a)) / 2, b - ((1 - by) * (b - a)) / 2];
    const pan = await moving((view, k) => ({ x: shifted(view.x, k % 40 < 20 ? 0.01 : -0.01), y: view.y }), 3);
    const zoom = await moving((view, k) => {
        const by = k % 40 < 20 ? 0.96 : 1 / 0.96;
        return { x: scaled(view.x, by), y: scaled(view.y, by) };
    }, 3);
    holder.remove();
    return { first_draw_ms: firstDraw, pan_frames_per_s: pan, zoom_frames_per_s: zoom };
}"""
# Presses an arrow key at a point of the path, and waits until the plan is drawn.
REPLANNING = """async () => {
    const path = await import("/page/path_step.js");
    return path.lastPlan();
}"""


def main() -> None:
    result: dict[str, Any] = {"samples": SAMPLES, "runs": RUNS}
    with tempfile.TemporaryDirectory() as place, chromium() as browser:
        folder = Path(place)
        loops = folder / "loops.csv"
        write_record(loops, demo.record_loops(PlayActuator())[0])
        result["start_to_page_s"] = statistics.median(started(browser, folder / f"start-{k}") for k in range(RUNS))
        with served(folder / "idle") as bench:
            time.sleep(2)
            result["idle_mb"] = resident(bench)
        with served(folder / "journey") as bench, visit(browser, bench) as person:
            result |= journey(person, loops)
            result |= {"replanned_ms": replanned(person)}
            drawings = [person.page.evaluate(DRAWING, SAMPLES) for _ in range(RUNS)]
            result |= {name: statistics.median(one[name] for one in drawings) for name in drawings[0]}
            result["requests_elsewhere"] = len(person.elsewhere)
        large = folder / "large.csv"
        write_large(large)
        result["large_mb"] = large.stat().st_size / 1e6
        with served(folder / "large") as bench, visit(browser, bench) as person:
            result["large_drop_to_picture_s"] = dropped(person, large)
    RESULT.write_text(json.dumps(result, indent=1) + "\n")
    print(RESULT.read_text())


def started(browser: Any, folder: Path) -> float:
    """Return the seconds from the command to a page that can be used."""
    began = time.perf_counter()
    with served(folder) as bench, visit(browser, bench) as person:
        person.sees("Drop a record here")
        person.sees("Connected")
        return time.perf_counter() - began


def resident(bench: Served) -> float:
    """Return the memory of the server in MB."""
    status = Path(f"/proc/{bench.process.pid}/status").read_text()
    return float(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1e3


def journey(person: Visitor, loops: Path) -> dict[str, float]:
    """Return seconds and clicks from the page to a downloaded voltage, by automatic identification."""
    began = time.perf_counter()
    person.drop(loops)
    person.sees("1 ready")
    person.identify()
    person.click("button", "Make a voltage")
    person.sees("The path can be followed", within="#path")
    person.write_voltage()
    person.download("link", "Download CSV")
    return {"journey_s": time.perf_counter() - began, "journey_clicks": person.clicks}


def replanned(person: Visitor) -> float:
    """Return the median time of a replanned path [ms] while one of its points is moved."""
    person.page.get_by_label("Draw points").check()
    person.sees("The path can be followed", within="#path")
    person.page.locator("#path [role=slider]").nth(1).focus()
    times = []
    for key in ("ArrowUp", "ArrowDown") * 10:
        person.page.keyboard.press(key)
        person.page.wait_for_timeout(100)
        times.append(person.page.evaluate(REPLANNING))
    return statistics.median(times)


def write_large(path: Path) -> None:
    """Write a record of a million samples as CSV."""
    time_s = np.arange(SAMPLES) * 1e-4
    top = np.linspace(1, 0.2, SAMPLES)
    voltage = 50 - 50 * top * np.cos(2 * np.pi * time_s)
    displacement = 0.1 * voltage + top * np.sin(2 * np.pi * time_s)
    displacement += np.random.default_rng(0).normal(0, 2e-3, SAMPLES)
    with path.open("w") as stream:
        stream.write("time_s,voltage_V,displacement_um\n")
        np.savetxt(
            stream, np.column_stack([time_s, voltage, displacement]), fmt=["%.5f", "%.8f", "%.9f"], delimiter=","
        )


def dropped(person: Visitor, path: Path) -> float:
    """Return the seconds from a dropped file to its picture."""
    began = time.perf_counter()
    person.drop(path)
    person.until(
        """() => {
            const canvas = document.querySelector("#records .stage canvas");
            if (!canvas || !canvas.width || !canvas.height) return false;
            const pen = canvas.getContext("2d");
            const row = pen.getImageData(0, Math.floor(canvas.height / 2), canvas.width, 1).data;
            return new Set(new Uint32Array(row.buffer)).size > 4;
        }"""
    )
    return time.perf_counter() - began


if __name__ == "__main__":
    main()

"""How long a step of the WebAssembly module takes in node and in chromium; N = 10, 21 knots, as in `latency.py`.

Nanoseconds a sample by the clock, the median of repeats, on the paths of `latency.py`: `step` called one by one, a
`trajectory` of the whole path, and `simulate` of its voltages. Writes `wasm.json`, with the bytes of the module.
"""

import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from latency import models, paths
from playwright.sync_api import sync_playwright

from dehyst import Compensator
from dehyst.exports import export, wasm_module
from dehyst.exports.naming import shipped, shipped_bytes

OUTPUT = Path(__file__).parent / "wasm.json"
REPEATS = 15
BROWSER = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
# The same program for both; it returns medians.
MEASURE = """
async function measure(Compensator, module, wanted) {
    const compensator = new Compensator(module);
    const median = (work) => {
        const found = [];
        for (let i = 0; i < REPEATS; i++) {
            const begin = performance.now();
            work();
            found.push((1e6 * (performance.now() - begin)) / wanted.length);
        }
        return found.sort((a, b) => a - b)[REPEATS >> 1];
    };
    const { voltage } = compensator.trajectory(wanted);
    let sum = 0;
    return {
        step_ns: median(() => { for (const y of wanted) sum += compensator.step(y); }),
        trajectory_ns: median(() => compensator.trajectory(wanted)),
        simulate_ns: median(() => compensator.simulate(voltage)),
    };
}
""".replace("REPEATS", str(REPEATS))


def in_node(compensator: Compensator, path: np.ndarray) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export(compensator, folder / "stage.wasm")
        program = (
            'import { Compensator, load } from "./stage.js";\n'
            f"{MEASURE}\nconst wanted = Float64Array.from({json.dumps(path.tolist())});\n"
            "console.log(JSON.stringify(await measure(Compensator, await load(), wanted)));\n"
        )
        (folder / "program.mjs").write_text(program)
        done = subprocess.run(["node", "program.mjs"], cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def in_chromium(compensator: Compensator, path: np.ndarray, page: Any) -> dict[str, float]:
    script = shipped("compensator.js").replace("export ", "")
    return page.evaluate(
        f"""async ([bytes, path]) => {{
            {script}
            {MEASURE}
            return measure(Compensator, await load(Uint8Array.from(bytes)), Float64Array.from(path));
        }}""".replace("import.meta.url", "location.href"),
        [list(wasm_module(compensator)), path.tolist()],
    )


def measured(page: Any) -> dict[str, Mapping[str, Mapping[str, Any]]]:
    found: dict[str, Any] = {"node": {}, "chromium": {}}
    for model, one in models().items():
        compensator = Compensator(one, (-10.0, 10.0), period=1e-3)
        for name, path in paths().items():
            found["node"].setdefault(model, {})[name] = in_node(compensator, path)
            found["chromium"].setdefault(model, {})[name] = in_chromium(compensator, path, page)
    return found


def main() -> None:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=BROWSER)
        versions = {
            "chromium": browser.version,
            "node": subprocess.run(["node", "--version"], capture_output=True, text=True, check=True).stdout.strip(),
        }
        result = {
            "bytes": {
                "core": len(shipped_bytes("core.wasm")),
                "plain": len(wasm_module(Compensator(models()["plain"], (-10.0, 10.0)))),
            },
            "versions": versions,
            **measured(browser.new_page()),
        }
        browser.close()
    OUTPUT.write_text(f"{json.dumps(result, indent=1)}\n")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()

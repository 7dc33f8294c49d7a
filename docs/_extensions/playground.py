"""The page that runs a model in the browser: its script, with a model that is identified while the site is built."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

HERE = Path(__file__).parent
PERIOD = 1e-3


def model() -> bytes:
    """Identify a model from loops of the virtual actuator, as anybody would; return it as WebAssembly."""
    from dehyst import Compensator, identify
    from dehyst.control import PossibleStart
    from dehyst.exports import wasm_module
    from dehyst.operations import demo
    from dehyst.virtual import PlayActuator

    record, _ = demo.record_loops(PlayActuator())
    actuator = identify(record).actuator
    start = PossibleStart.named(actuator, "bottom").state
    return wasm_module(Compensator(actuator, (0.0, 200.0), period=PERIOD, state=start))


def script(module: bytes) -> str:
    """Return the page's script, with the model `module` inside."""
    from dehyst.web import files

    own = "\n".join((HERE / name).read_text(encoding="utf-8") for name in ("play_actuator.js", "playground.js"))
    # One classic script, so that the page works from a folder too: a browser loads no module from there.
    source = files.script(own).replace("import.meta.url", "document.baseURI")
    code = base64.b64encode(module).decode("ascii")
    bytes_ = f'const MODULE = Uint8Array.from(atob("{code}"), (letter) => letter.charCodeAt(0));\n'
    return f"(async () => {{\n{bytes_}{source}\n}})();\n"


def write(app: Sphinx, error: Exception | None) -> None:
    """Write the script beside the pages."""
    if error is None and app.builder.name == "html":
        (Path(app.outdir) / "_static" / "playground.js").write_text(script(model()), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""Write `core/tests/golden.h`, results of Python with a model of all parts: ``python tests/support/golden_core.py``.

The C tests of the core then need no Python.
"""

import re
import warnings

import compiled_exports
import numpy as np
import places

SAVED_AT = 120
TARGET = places.CORE / "tests" / "golden.h"


def _bytes(name, block):
    rows = [", ".join(map(str, block[i : i + 24])) for i in range(0, len(block), 24)]
    return f"static const unsigned char {name}[{len(block)}] = {{\n    " + ",\n    ".join(rows) + "};\n"


def _numbers(name, values):
    rows = [", ".join(float(x).hex() for x in values[i : i + 4]) for i in range(0, len(values), 4)]
    return f"static const dehyst_real {name}[{len(values)}] = {{\n    " + ",\n    ".join(rows) + "};\n"


def numbers(name, header):
    """Return an array of numbers as text of a header."""
    found = re.search(rf"{name}\[\d+\] = {{(.*?)}};", header, re.DOTALL)[1]
    return [float.fromhex(word) for word in found.replace(",", " ").split()]


def text():
    """Return the header."""
    compensator = compiled_exports.KINDS["moving"]()
    low, high = compensator.reach
    t = np.arange(240) / 240
    wanted = low + (high - low) * (0.5 + 0.6 * np.sin(11 * t) * np.cos(37 * t))
    block = compensator._axes[0].block()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first = compensator.run(wanted[:SAVED_AT])
        snapshot = compensator.snapshot()
        sent = np.concatenate([first, compensator.run(wanted[SAVED_AT:])])
    return "\n".join(
        [
            "/* Written by tests/support/golden_core.py. Do not edit. */",
            f"#define SAVED_AT {SAVED_AT}",
            _bytes("block", block),
            _bytes("snapshot", snapshot),
            _numbers("wanted", wanted),
            _numbers("sent", sent),
        ]
    )


if __name__ == "__main__":
    TARGET.write_text(text())

"""Programs of JavaScript run by node, first of all compensators in WebAssembly; their answers as numbers."""

import shutil
import subprocess
from functools import cache

import numpy as np
import pytest

from dehyst.exports import export

# Reads and writes columns of numbers as bytes; all decimals of the answers are compared.
HEAD = """
import fs from "node:fs";
import { Compensator, load } from "./stage.js";
const module = await load();
const file = (name) => new URL(name, import.meta.url);
const read = (name) => {
    const bytes = fs.readFileSync(file(name));
    return new Float64Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
};
const write = (name, values) => fs.writeFileSync(file(name), Float64Array.from(values));
"""


@cache
def need_node():
    """Skip the test without node."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed: WebAssembly cannot be run (Debian: nodejs)")


def exported(folder, compensator):
    """The folder with an export."""
    folder.mkdir(exist_ok=True)
    export(compensator, folder / "stage.wasm")
    return folder


def node(folder, program, head=HEAD, kind="<f8", **columns):
    """Run a program after a head in a folder, with columns of numbers of a kind as files; return what it prints."""
    need_node()
    for name, values in columns.items():
        np.asarray(values, dtype=kind).tofile(folder / name)
    (folder / "program.mjs").write_text(head + program)
    done = subprocess.run(["node", "program.mjs"], cwd=folder, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def column(folder, name):
    """A column that a program has written, as bit patterns."""
    return np.fromfile(folder / name, dtype="<f8").view(np.uint64)

"""The public face: what `import dehyst` loads, and the names it offers."""

import ast
import inspect
import json
import subprocess
import sys

import dehyst

HEAVY = {"scipy", "matplotlib", "h5py", "pyarrow", "nptdms", "click", "pandas", "threadpoolctl"}


def loaded_by(statement):
    """Top-level modules in a fresh interpreter after `statement`."""
    program = f"{statement}; import sys, json; print(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    return set(json.loads(done.stdout))


def test_import_loads_no_library_except_numpy():
    ours, bare = loaded_by("import dehyst; dehyst.Compensator, dehyst.identify"), loaded_by("import numpy")
    assert not ours & HEAVY
    outside = {m for m in ours - bare if m not in sys.stdlib_module_names and not m.startswith("_")}
    assert outside == {"dehyst"}


def test_no_room_loads_a_heavy_library_before_it_is_used():
    rooms = ("calibration", "trust", "report", "fleet", "operations.registry")
    assert not loaded_by(f"import {', '.join(f'dehyst.{room}' for room in rooms)}") & HEAVY
    # The page reads its requests by the declarations of commands.
    assert not loaded_by("import dehyst.workbench.server") & (HEAVY - {"click"})


def test_a_room_is_loaded_when_one_of_its_names_is_used():
    program = """
import json, sys, dehyst
rooms = lambda: sorted({m.split(".")[1] for m in sys.modules if m.startswith("dehyst.")})
first = rooms()
dehyst.Compensator
second = rooms()
dehyst.waveforms.descending_tops, dehyst.virtual
print(json.dumps([first, second, rooms()]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    first, second, third = map(set, json.loads(done.stdout))
    assert first == {"_version"}
    assert "control" in second and not {"identification", "virtual"} & second
    assert {"waveforms", "virtual"} <= third


def test_every_public_name_has_a_room():
    """The table that loads a name, the list of names, and what a type checker reads are one."""
    face = ast.parse(inspect.getsource(dehyst))
    block = next(node for node in face.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test))
    checked = {
        alias.name: node.module.removeprefix("dehyst.")
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert checked == dehyst._ROOM_OF
    assert set(dehyst._ROOM_OF) == set(dehyst.__all__) - {"__version__"}

"""The forms of the page as data: labels, units, choices, hints. A label has the name of its option."""

from __future__ import annotations

from typing import Any

from dehyst.waveforms.scans import OPTIONS, SCANS

Field = dict[str, Any]
Form = dict[str, Field]

_STRUCTURES = {
    "auto": "Automatic: select the parts by cross-validation",
    "maxwell_slip": "Maxwell-slip: slip elements and a spring (seconds)",
}
# Numbers of axes that a record's form offers; quantities of an axis; and fields of the form that are no columns.
AXES, QUANTITIES = ("x", "y", "z"), ("voltage", "displacement")
PLAIN = {
    "voltage_scale": {"label": "Scale of the voltage", "hint": "gain of the amplifier whose monitor it is, e.g. 100"},
    "displacement_scale": {"label": "Scale of the displacement", "hint": "e.g. 10 um/V, fringe 316.4 nm"},
    "rate": {"label": "Sample rate in Hz", "hint": "instead of a column of time, e.g. 1000"},
    "decimal": {"label": "Decimal sign", "hint": "comma or point, if the numbers do not show it"},
}
_COLUMNS = {
    "time": ("Column of the time", ("s", "ms", "us", "ns", "min")),
    "voltage": ("Column of the voltage", ("V", "mV", "kV")),
    "displacement": ("Column of the displacement", ("um", "nm", "mm", "m", "pm")),
}


def _reading() -> Form:
    """Return the fields of a record's form; the file gives the choices of columns."""
    counts = [(str(k), f"{k}, coupled" if k > 1 else "1") for k in range(1, len(AXES) + 1)]
    found: Form = {"axes": {"label": "Axes", "choices": counts}}
    columns = ["time", *(f"{quantity}_{k}" for k in range(1, len(AXES) + 1) for quantity in QUANTITIES)]
    for name in columns:
        label, units = _COLUMNS[name.partition("_")[0]]
        found[name] = {"label": label, "column": True}
        found[f"{name}_unit"] = {"label": "Unit", "choices": [("", "by name"), *((unit, unit) for unit in units)]}
    names = {f"name_{k}": {"label": f"Name of axis {k}"} for k in range(1, len(AXES) + 1)}
    return {**found, **names, **PLAIN}


# "above", "least" and "optional" describe the number in a field; "many" means several numbers.
_SLEW = {"label": "Largest slew rate", "unit": "V/s", "placeholder": "none", "optional": True, "above": 0}
FORMS: dict[str, Form] = {
    "excite": {
        "low": {"label": "Lowest voltage", "unit": "V", "value": "0"},
        "high": {"label": "Highest voltage", "unit": "V", "value": "100"},
        "slew": _SLEW,
        "frequency": {
            **{"label": "Frequency", "unit": "Hz", "placeholder": "automatic", "optional": True, "above": 0},
            "hint": "of the large loops, near that of your use",
        },
    },
    "reading": _reading(),
    "identify": {
        "structure": {"label": "Structure", "choices": [*_STRUCTURES.items()], "value": "auto"},
        "goal": {
            **{"label": "Goal", "unit": "% of the stroke", "value": "1", "optional": True, "above": 0},
            "hint": "If the largest error is below it, the model is ready for use.",
        },
        "time_limit": {
            **{"label": "Time limit", "unit": "s", "placeholder": "none", "optional": True, "above": 0},
            "hint": "After this time the best model so far is completed.",
        },
        "sensor_lag": {
            **{"label": "Sensor lag", "unit": "s", "placeholder": "unknown", "optional": True, "least": 0},
            "hint": "Time constant of the sensor's filter; 0 if it has no filter.",
        },
        "name": {"label": "Name of the model", "placeholder": "of the first record", "text": True},
    },
    "path": {
        "low": {"label": "Lowest voltage", "unit": "V"},
        "high": {"label": "Highest voltage", "unit": "V"},
        "slew": _SLEW,
        "rate": {"label": "Samples a second", "unit": "Hz", "value": "1000", "above": 0},
    },
    "export": {
        "rate": {
            **{"label": "Samples a second", "unit": "Hz", "placeholder": "any", "optional": True, "above": 0},
            "hint": "Needed for a model with creep, inertia, a lag or a slew rate.",
        },
    },
    "check": {"record": {"label": "New record"}},
}
# Kinds of exports: title, text and, of a file, its suffix.
EXPORTS = {
    "c": ("C99", "Sources, numbers and a test for firmware; the same code as in Python.", ""),
    "fmu": ("FMU", "For co-simulation in Simulink, Modelica and others (FMI 2.0).", ".fmu"),
    "wasm": ("WebAssembly", "For a browser or node, with a JavaScript module.", ".wasm"),
}
# Shown units of scans, options with several numbers and their hints, and first values.
_UNITS = {"um": "\u00b5m", "um/s": "\u00b5m/s", "um/s2": "\u00b5m/s\u00b2", "share": ""}
_MANY = {"levels": "separated by spaces or semicolons; the scan returns to the first"}
_FIRST = {"lines": "16", "dwell": "0.2"}


def scan_form() -> Form:
    """Return the fields of all named scans, from the options that the library declares."""
    found: Form = {
        "kind": {"label": "Scan", "choices": [(name, name.capitalize()) for name in SCANS], "value": "triangle"},
        "cycles": {"label": "Cycles", "hint": "default: 1", "optional": True},
        "axis": {"label": "Axis that the model moves", "choices": [("", "x"), ("y", "y")]},
    }
    for name, option in OPTIONS.items():
        found[name] = {
            "label": option.help,
            "unit": _UNITS.get(option.unit, option.unit),
            "hint": _MANY.get(name) or (f"default: {option.default}" if option.default else ""),
            "value": _FIRST.get(name, ""),
            "many": name in _MANY,
            "optional": True,
        }
        if isinstance(option.kind, tuple):
            # The first one is the default.
            found[name]["choices"] = [("" if k == 0 else word, word) for k, word in enumerate(option.kind)]
    return found


def scan_kinds() -> dict[str, dict[str, list[str]]]:
    """Return the needed and the optional fields of each named scan."""
    kinds = {}
    for name, scan in SCANS.items():
        played = ["axis"] * ("y_low" in scan.may) + ["cycles"] * (name != "steps")
        kinds[name] = {"needs": [*scan.needs], "may": [*played, *scan.may]}
    return kinds


def declared() -> dict[str, Any]:
    """Return the fields of all forms, and the kinds of scans and exports."""
    return {"forms": {**FORMS, "scan": scan_form()}, "scans": scan_kinds(), "exports": EXPORTS}

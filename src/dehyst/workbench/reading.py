"""How a file is read: the values of its form, by its columns and what was given or suggested, and what they mean."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from dehyst.workbench.data import RequestError
from dehyst.workbench.entries import RecordEntry
from dehyst.workbench.forms import AXES, FORMS, PLAIN, QUANTITIES

_AXIS = re.compile(r"[A-Za-z]\w*")
_COUPLED = "There are {} voltages with displacements, perhaps of coupled axes: check the pairs."
# Marks a guess; one that is taken as it is remains one.
_GUESS = "?"


def form_of(record: RecordEntry) -> dict[str, Any]:
    """Return the values of a record's form: its options, and those that are suggested, whose fields are `marked`.

    `pairs`: columns for coupled axes, if there are some.
    """
    names = [one["name"] for one in record.file_columns]
    voltages, displacements, times = (_of_unit(record, quantity) for quantity in ("voltage", "displacement", "time"))
    found = list(zip(voltages, displacements, strict=False))[: len(AXES)]
    many = record.status == "refused" and not record.options and len(found) > 1
    suggested = {} if many else (record.hint or {}).get("options", {})
    values = _values(record, suggested, names)
    pairs = {"time": str(times[0])} if times else {}
    for k, (voltage, displacement) in enumerate(found, 1):
        pairs |= {f"voltage_{k}": str(voltage), f"displacement_{k}": str(displacement)}
    marked = [_field(name) for name in suggested]
    marked += ["time", "voltage_1", "displacement_1"] * ("columns" in suggested)
    help_ = "Try the marked options." if record.hint else ""
    if many:
        values |= {"axes": str(len(found)), **pairs}
        marked, help_ = ["axes", *pairs], _COUPLED.format(len(found))
    return {"values": values, "marked": marked, "pairs": pairs, "help": help_}


def options_of(record: RecordEntry, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that the values of a record's form mean, keywords of `dehyst.read`.

    Raises
    ------
    RequestError
        If they contradict one another.
    """
    given = {name: str(value).strip() for name, value in values.items()}
    names = [one["name"] for one in record.file_columns]
    guesses = _given(record, (record.hint or {}).get("options", {}), names)
    count = int(given.get("axes", "1")) if given.get("axes", "1") in ("1", "2", "3") else 1
    axes = [_axis_name(given.get(f"name_{k}", ""), k) for k in range(1, count + 1)] if count > 1 else [""]
    options: dict[str, Any] = {}
    used: dict[int, str] = {}
    for field, word in _words(axes).items():
        column, unit = given.get(field, ""), given.get(f"{field}_unit", "")
        if not column:
            continue
        place = int(column) if column.isdigit() else len(names)
        if place >= len(names) or place in used:
            raise RequestError("A column stands in two fields: choose each column once.")
        written = f"{names[place]}{unit and f':{unit}'}"
        guess = _GUESS if guesses.get(field) == written + _GUESS else ""
        options[field.removesuffix("_1")] = written + guess
        used[place] = f"{word}{unit and f':{unit}'}{guess}"
    twice = any(names.count(names[place]) > 1 for place in used)
    if twice and len(used) < 3:
        raise RequestError("Two columns have the same name: choose all three columns.")
    if count > 1 and len(used) < 2 * count + (not given.get("sample_rate")):
        raise RequestError("Several axes: choose all their columns, and that of the time.")
    if twice or count > 1:
        # Columns of the same name differ by their places only.
        options = {"columns": ",".join(used.get(place, "-") for place in range(len(names)))}
    others = {name: given[name] for name in PLAIN if given.get(name)}
    if rate := others.pop("sample_rate", None):
        options["sample_rate"] = _rate(rate)
    return options | others | ({"axes": {name: f"v{name}:{name}" for name in axes}} if count > 1 else {})


def _field(option: str) -> str:
    return f"{option}_1" if option in QUANTITIES else option


def _words(axes: Sequence[str]) -> dict[str, str]:
    """Return how the column of each field is called when all columns get names; one axis has no name."""
    found = {"time": "time"}
    for k, axis in enumerate(axes, 1):
        found |= {f"voltage_{k}": f"v{axis}" if axis else "voltage", f"displacement_{k}": axis or "displacement"}
    return found


def _given(record: RecordEntry, suggested: Mapping[str, Any], names: Sequence[str]) -> dict[str, str]:
    """Return NAME, NAME:UNIT or a guess for each field whose column was given or suggested."""
    given = {**record.options, **suggested}
    found = {_field(name): str(given[name]) for name in ("time", *QUANTITIES) if given.get(name)}
    fields = {word: field for field, word in _words(list(record.options.get("axes") or ("",))).items()}
    for name, entry in zip(names, str(given.get("columns") or "").split(","), strict=False):
        word, colon, unit = entry.partition(":")
        if field := fields.get(word.removesuffix(_GUESS)):
            found[field] = name + colon + unit + _GUESS * word.endswith(_GUESS)
    return found


def _values(record: RecordEntry, suggested: Mapping[str, Any], names: Sequence[str]) -> dict[str, str]:
    values = dict.fromkeys(FORMS["reading"], "")
    for field, written in _given(record, suggested, names).items():
        text = written.removesuffix(_GUESS)
        # A column may have a colon in its name.
        column, unit = (text, "") if text in names or ":" not in text else text.rsplit(":", 1)
        values[field] = str(names.index(column)) if column in names else ""
        values[f"{field}_unit"] = unit
    given = {**record.options, **suggested}
    values |= {name: str(given[name]) for name in PLAIN if given.get(name)}
    axes = list(record.options.get("axes") or ())
    words = [re.match(r"[A-Za-z][A-Za-z0-9]*", names[k]) for k in _of_unit(record, "displacement")[: len(AXES)]]
    usual = [one[0] for one in words if one]
    # Axes have the names of their columns, if these differ.
    own = usual if len({*usual}) == len(words) > 1 else AXES
    values |= {f"name_{k}": name for k, name in enumerate(axes or own, 1)}
    return values | {"axes": str(len(axes) or 1)}


def _of_unit(record: RecordEntry, quantity: str) -> list[int]:
    """Return the places of the columns in a unit of a quantity."""
    units = FORMS["reading"][f"{_field(quantity)}_unit"]["choices"]
    known = {value for value, _ in units if value}
    return [k for k, one in enumerate(record.file_columns) if one.get("unit") in known]


def _axis_name(text: str, k: int) -> str:
    if _AXIS.fullmatch(text):
        return text
    raise RequestError(f"Name of axis {k}: got {text or 'nothing'}, need letters and digits, as in x or y.")


def _rate(text: str) -> float:
    try:
        rate = float(text.replace(",", "."))
    except ValueError:
        rate = 0.0
    if rate > 0:
        return rate
    raise RequestError(f"Sample rate in Hz: got {text}, need a number above 0.")

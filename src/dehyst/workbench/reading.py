"""The form that says how a file is read: its values, and the text of columns that they give."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from dehyst.records.columns import RECORD, columns_of_axis, entries_of, split, text_of
from dehyst.workbench.data import RequestError
from dehyst.workbench.entries import RecordEntry
from dehyst.workbench.forms import AXES, FORMS, PLAIN, QUANTITIES

_AXIS = re.compile(r"[A-Za-z]\w*")
_COUPLED = "The file has {} voltages with displacements, perhaps of coupled axes: check the pairs."
_SIGNS = {".": "point", ",": "comma"}
# Marks a guess; a column that nobody verified stays a guess.
_GUESS = "?"
# The mark after a column or a unit, in a text of columns.
_GUESSES = re.compile(r'\?(?=\s*(?:[*:,"]|$))')
# Placeholder of a number in a suggested scale.
_GAIN = "GAIN"
# A typed decimal comma; in a text of columns a comma would begin the next column.
_COMMA = re.compile(r"(?<=\d),(?=\d)")


def form_of(record: RecordEntry) -> dict[str, Any]:
    """Return the values of a record's form; fields with suggested columns are `marked`.

    `pairs`: columns for coupled axes, if there are any.
    """
    voltages, displacements, times = (_of_unit(record, quantity) for quantity in ("voltage", "displacement", "time"))
    found = list(zip(voltages, displacements, strict=False))[: len(AXES)]
    many = record.status == "refused" and not record.columns and len(found) > 1
    suggested = {} if many else entries_of(record.hint)
    values = _values(record, suggested)
    pairs = {"time": str(times[0])} if times else {}
    for k, (voltage, displacement) in enumerate(found, 1):
        pairs |= {f"voltage_{k}": str(voltage), f"displacement_{k}": str(displacement)}
    marked = [*map(_field, suggested), *(name for name in PLAIN if _GAIN in values[name])]
    gain = f": {_GAIN} stands for a number" * any(_GAIN in values[name] for name in PLAIN)
    help_ = f"Check the marked fields{gain}." if record.hint else ""
    if many:
        values |= {"axes": str(len(found)), **pairs}
        marked, help_ = ["axes", *pairs], _COUPLED.format(len(found))
    return {"values": values, "marked": marked, "pairs": pairs, "help": help_}


def columns_of(record: RecordEntry, values: Mapping[str, Any]) -> str:
    """Return the text of columns for the values of a record's form.

    Raises
    ------
    RequestError
        If they contradict one another.
    """
    given = {name: str(value).strip() for name, value in values.items()}
    names = [column["name"] for column in record.file_columns]
    guesses = {field: text for field, text in _given(record, entries_of(record.hint)).items() if _GUESS in text}
    count = int(given.get("axes", "1")) if given.get("axes", "1") in ("1", "2", "3") else 1
    used: dict[str, str] = {}
    for field in ("time", *(f"{quantity}_{k}" for k in range(1, count + 1) for quantity in QUANTITIES)):
        column, unit = given.get(field, ""), given.get(f"{field}_unit", "")
        scale = _COMMA.sub(".", given.get(f"{field.rpartition('_')[0]}_scale", ""))
        if not column:
            if scale:
                raise RequestError("A scale needs its column: choose the column.")
            continue
        if not column.isdigit() or int(column) >= len(names) or column in [text.split()[0] for text in used.values()]:
            raise RequestError("A column is in two fields: choose each column once.")
        place = int(column)
        # Use the number of a column if its name is not unique, or would be read differently.
        plain = names.count(names[place]) == 1 and split(names[place]) == (names[place], "", "", False)
        text = (names[place] if plain and "=" not in names[place] else str(place + 1)) + (unit and f":{unit}")
        guess = _GUESS if guesses.get(field, "").partition("*")[0] == text + _GUESS else ""
        used[field] = f"{column} {text}{guess}{scale and f'*{scale}'}"
    texts = {field: text.partition(" ")[2] for field, text in used.items()}
    if count > 1 and len(texts) < 2 * count + (not given.get("rate")):
        raise RequestError("Several axes: choose all their columns, and the column of the time.")
    entries = {"time": texts["time"]} if "time" in texts else {}
    for k in range(1, count + 1):
        pair = [texts.get(f"{quantity}_{k}", "") for quantity in QUANTITIES]
        if count > 1:
            entries[_axis_name(given.get(f"name_{k}", ""), k)] = ":".join(pair)
        else:
            entries |= {quantity: text for quantity, text in zip(QUANTITIES, pair, strict=True) if text}
    if rate := given.get("rate"):
        entries["rate"] = _rate(rate)
    if sign := given.get("decimal"):
        entries["decimal"] = _SIGNS.get(sign, sign)
    return text_of(entries)


def verified(columns: str) -> str:
    """Return a text of columns without its marks of guesses."""
    return _GUESSES.sub("", columns)


def _field(key: str) -> str:
    return f"{key}_1" if key in QUANTITIES else key


def _given(record: RecordEntry, suggested: Mapping[str, str]) -> dict[str, str]:
    """Return the entry for each field whose column was given or suggested."""
    given = {**entries_of(record.columns), **suggested}
    found = {_field(name): given[name] for name in ("time", *QUANTITIES) if given.get(name)}
    for k, text in enumerate((text for key, text in given.items() if key not in RECORD), 1):
        found |= {f"{name}_{k}": column for name, column in zip(QUANTITIES, columns_of_axis(text), strict=False)}
    return found


def _values(record: RecordEntry, suggested: Mapping[str, str]) -> dict[str, str]:
    """Return the values of a record's form."""
    names = [column["name"] for column in record.file_columns]
    values = dict.fromkeys(FORMS["reading"], "")
    for field, text in _given(record, suggested).items():
        # A column may have a colon in its name.
        column, unit, scale, _ = (text, "", "", False) if text in names else split(text)
        number = int(column) if column.isdigit() and column not in names else 0
        values[field] = str(names.index(column)) if column in names else str(number - 1) if number else ""
        values[f"{field}_unit"] = unit
        if scale:
            values[f"{field.rpartition('_')[0]}_scale"] = scale
    given = {**entries_of(record.columns), **suggested}
    values |= {name: given[name] for name in PLAIN if given.get(name)}
    signs = {word: sign for sign, word in _SIGNS.items()}
    values["decimal"] = signs.get(values["decimal"], values["decimal"])
    axes = [key for key in given if key not in RECORD]
    words = [re.match(r"[A-Za-z][A-Za-z0-9]*", names[k]) for k in _of_unit(record, "displacement")[: len(AXES)]]
    usual = [word[0] for word in words if word]
    # Axes are named like their columns, if these names differ.
    own = usual if len({*usual}) == len(words) > 1 else AXES
    values |= {f"name_{k}": name for k, name in enumerate(axes or own, 1)}
    return values | {"axes": str(len(axes) or 1)}


def _of_unit(record: RecordEntry, quantity: str) -> list[int]:
    """Return the indices of the columns whose unit measures a quantity."""
    units = FORMS["reading"][f"{_field(quantity)}_unit"]["choices"]
    known = {value for value, _ in units if value}
    return [k for k, column in enumerate(record.file_columns) if column.get("unit") in known]


def _axis_name(text: str, k: int) -> str:
    if _AXIS.fullmatch(text):
        return text
    raise RequestError(f"Name of axis {k}: got {text or 'nothing'}, need letters and digits, as in x or y.")


def _rate(text: str) -> str:
    try:
        rate = float(text.replace(",", "."))
    except ValueError:
        rate = 0.0
    if rate > 0:
        return f"{rate:.12g}"
    raise RequestError(f"Sample rate in Hz: got {text}, need a number above 0.")

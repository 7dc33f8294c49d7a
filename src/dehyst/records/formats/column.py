"""The columns of a file: their names, their units in the words of instruments, and the quantities that names mean."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst._units import COLDEST, FACTORS, HOTTEST, quantity_of, symbol_of
from dehyst.records.formats.notation import Moment

TEXT = (".csv", ".tsv", ".txt", ".dat", ".asc")
# Limit of the bytes of a file and of its numbers, 20 million samples; bytes of a number.
MOST, _DOUBLE = 500_000_000, 8


class ColumnWords(NamedTuple):
    """Words and units by which the columns of a quantity are found.

    `words`: whole names; `more`: names that need a stated unit. For proposals: `parts` and `letters` of names, usual
    `units`, and the `range` of piezo stages in SI units, outside of which there is a remark. The unit of a bare factor
    is the first of `units`; with it, the quantity is a name that is found.
    """

    words: str
    parts: str
    units: tuple[str, ...]
    range: tuple[float, float]
    more: str = ""
    letters: str = ""


QUANTITIES = {
    "time": ColumnWords(
        words="time, t",
        more="timestamp, datetime, date, x_value, x-axis, second, seconds, sec, zeit, temps, tiempo",
        parts="time, zeit, second, temps",
        letters="t",
        units=("s", "ms"),
        range=(0.0, 1e7),
    ),
    "voltage": ColumnWords(
        words="voltage, v, drive",
        more="u, spannung, tension, piezo voltage, drive voltage, output voltage, control voltage",
        parts="volt, spannung, drive, ampl, monitor, command, tension, ao, output, ausgang, current, pressure, dac",
        letters="uv",
        units=("V", "mV"),
        range=(0.05, 1500.0),
    ),
    "displacement": ColumnWords(
        words="displacement, position, y, pos",
        more="disp, gauge, deflection, elongation, extension, weg, auslenkung, verschiebung",
        parts="disp, pos, weg, auslenk, sensor, gauge, strain, stroke, capac, ai, height, angle, encoder, dehnung",
        letters="yxzdw",
        units=("um", "nm", "mm", "m"),
        range=(5e-9, 2e-3),
    ),
    "temperature": ColumnWords(words="temperature, temp", parts="temp", units=("degC",), range=(0.0, 100.0)),
}
# Smallest and largest possible value of a piezo actuator and its instruments, in SI units; units that smaller and
# larger values may have.
_POSSIBLE = {
    "time": ("samples every", "s", 1e-8, 1e4, ("s", "ns, us or ms")),
    "voltage": ("a voltage of", "V", 0.0, 1e5, ("V", "mV")),
    "displacement": ("a stroke of", "m", 1e-9, 0.1, ("m", "um")),
    "temperature": ("a temperature of", "degC", COLDEST, HOTTEST, ("K", "K or degF")),
}
# A stroke of many piezo actuators [m].
_STROKE = 1e-5
# The placeholder for a factor, and the end of a selection that is a guess: "y:um?".
GAIN, GUESS = "GAIN", "?"
# A quantity and its unit: "Time / s", "Pos/nm", "Weg in µm", "Ch1,V"; in the last brackets.
_WRITTEN_OUT = re.compile(r"([^/]*[^/\s])(?:\s*/\s*|\s+in\s+|,\s*)([^/\s\[\]()]+)")
_BRACKETS = re.compile(r"(.*?)[\s_]*[\[(]([^\[\]()]*)[\])]\s*", re.DOTALL)
# Names of outputs, monitors and channels of an oscilloscope: whole words, and parts of words. The range of such
# connectors [V]: 10 V, and the margin of a converter.
_PLUG = re.compile(
    r"(?<![^\W\d_])(?:ai|ao|ausg|c|ch|chan|channel|cmd|ctrl|dac|ext|kanal|mon|out|setpoint|[uv]mon|[uv]out)(?![^\W\d_])|"
    r"analog|ausgang|command|control|monitor|output|regler|salida|sortie|uscita"
)
_PLUG_RANGE = 10.5
# A channel of an oscilloscope or a logger, whose numbers are volts.
_CHANNEL = re.compile(r"(?:(?:ch|chan|channel|kanal|voie|in|ain|ai|input|analog)[\s_.]*[0-9a-d]|[a-d]\d)(?![^\W_])")
# Words for a set point, which is not measured.
_SET_POINT = re.compile(
    r"target|soll|ziel|vorgabe|führungsgr|request|consigne|desired|wanted|nominal|demand|command|reference|(?<![^\W\d_])(?:set|ref|cmd)(?![^\W\d_])|"
    r"set[\s_-]?(?:point|value|pos)"
)
# Names of columns that count samples.
_COUNTS = re.compile(r"(?:index|idx|samples?|points?|count(?:er)?|no|nr|n|sequence|num|number|row)?")
# Units at the end of a name that are not of a voltage, length, time, temperature or load.
_FOREIGN = re.compile(
    r"mA|uA|amps?|%|percent|prozent|pct|ppm|permille|deg|degrees?|m?rad|urad|arcsec|m?bar|psi|[kM]?Pa|counts?|cts|ticks?|steps?|"
    r"codes?|digits|lsb|raw|inch|inches|mils?|kip|lbf|gauss|tesla|u?strain|k?Hz|ohm|[pnu]F|[un]C|rpm|dBm",
    re.IGNORECASE,
)
# Characters of a name that a message shows.
_SHOWN = 60


def shortened(name: str) -> str:
    """Return a name from a file for a message: only its beginning if it is long."""
    return name if len(name) <= _SHOWN else f"{name[:_SHOWN]}..."


def listed(names: tuple[str, ...]) -> str:
    """Quote names for a message, the first twenty of them."""
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return ", ".join(f"'{shortened(name)}'" for name in names[:20]) + more


def is_small(volts: Array) -> bool:
    """Return whether an amplifier's input or monitor can have these voltages [V]."""
    return bool(volts.size and 0 < np.abs(volts).max() <= _PLUG_RANGE)


def plausible_unit(quantity: str, data: Array) -> str:
    """Return the most likely unit in which a column is plausible for a piezo actuator; empty if there is none."""
    with np.errstate(all="ignore"):
        size = float(np.abs(data).max(initial=0.0))
        if quantity == "displacement" and data.size:
            size = float(np.ptp(data))
    known = QUANTITIES[quantity]
    sizes = {unit: size * FACTORS[quantity][unit] for unit in known.units}
    plausible = [unit for unit, value in sizes.items() if known.range[0] <= value <= known.range[1]]
    if quantity != "displacement" or 0.01 * _STROKE <= sizes["um"] <= 100 * _STROKE:
        return plausible[0] if plausible else ""
    return min(plausible, key=lambda unit: abs(np.log10(sizes[unit] / _STROKE)), default="")


def impossible(quantity: str, size: float) -> str:
    """Return an error if a step, voltage, stroke or temperature [s, V, m, degC] cannot be real; or empty."""
    name, unit, least, most, others = _POSSIBLE[quantity]
    if least <= size <= most:
        return ""
    need, other = (f"at most {most:g}", others[1]) if size > most else (f"at least {least:g}", others[0])
    ways = {"time": ", or give the sample rate", "displacement": f', or give units "{other}" in Python'}
    question = f"is the {quantity} in {other}? Correct its unit{ways.get(quantity, '')}"
    return f"got {name} {size:.4g} {unit}, need {need} {unit}: {question}"


class Allowance:
    """The memory [bytes] that is left for the numbers of a file; the file's stem and decimal sign."""

    def __init__(self, most: int, stem: str = "", decimal: str | None = None) -> None:
        self.most, self.left, self.stem, self.decimal = most, most, stem, decimal

    def take(self, numbers: int, what: str) -> None:
        """Reserve memory for a count of `numbers` in `what`; raise FileFormatError if too little is left."""
        self.check(numbers * _DOUBLE, what)
        self.left -= numbers * _DOUBLE

    def check(self, size: int, what: str) -> None:
        """Refuse a `size` [bytes] of `what` that exceeds the remaining memory."""
        if size > self.left:
            raise FileFormatError(
                f"{what} has {size / 1e6:.4g} MB, more than the {self.left / 1e6:.4g} MB left of the "
                f"{self.most / 1e6:.4g} MB that are allowed",
                hint="save every second sample, or several records",
            )


@dataclass(frozen=True, eq=False, slots=True)
class Column:
    """One named column of a file.

    `name`: as in the file. `data` (n,): its numbers, NaN where a cell is empty. `unit`: unit that the file states
    outside of the name. `fault`: why the column cannot be used, and what to try. `unnamed`: whether the file has no
    names, and the name is therefore a number. `guessed`: properties that the file does not state. `began`: the first
    timestamp, of a column that has them. `kept`: whether a record keeps it as a further channel, whatever its name.
    `timing`: what a record file states of its samples: "sample" for a voltage that is held, "events" for a displacement
    that is known at events only. `group`: where it is in the file, with a slash behind each level; a part of the name.
    """

    name: str
    data: Array
    unit: str = ""
    fault: str = ""
    unnamed: bool = False
    guessed: str = ""
    began: Moment | None = None
    kept: bool = False
    timing: str = ""
    group: str = ""

    @property
    def leaf(self) -> str:
        """The name without its group."""
        return self.name.removeprefix(self.group)

    @property
    def _named(self) -> tuple[str, str]:
        """Quantity and unit in the column's name; what follows the last underscore may be another word."""
        text = self.leaf.strip()
        if len(text) <= _SHOWN:
            written = _WRITTEN_OUT.fullmatch(text)
            # "speed um/s" has another unit than s.
            unit = written[2] if written else ""
            known = symbol_of(unit) or unit == "A" or _FOREIGN.fullmatch(unit)
            if written and known and symbol_of(written[1].split()[-1]) in ("", symbol_of(unit)):
                return written[1].strip(), unit
            if bracketed := _BRACKETS.fullmatch(text):
                return bracketed[1].strip(), bracketed[2].strip()
        word, _, unit = (part.strip() for part in text.rpartition("_"))
        if not word or not (symbol_of(unit) or _FOREIGN.fullmatch(unit) or unit.isdigit()):
            return text, ""
        return word, "" if unit.isdigit() else unit

    @property
    def parts(self) -> tuple[str, str]:
        """Quantity and unit of the column: ('drive', 'V') for 'drive_V' or 'drive [V]'."""
        word, unit = self._named
        if any(self.unit in known for known in FACTORS.values()):
            return word, self.unit
        return word, symbol_of(unit) or symbol_of(self.unit) or unit or self.unit

    @property
    def contradiction(self) -> str:
        """The unit in the name if the file states the symbol of another one; words such as "Volts" contradict none."""
        named, known = symbol_of(self._named[1]), FACTORS.get(quantity_of(self.unit), {})
        return named if self.unit in known and known.get(named) != known[self.unit] else ""

    @property
    def words(self) -> set[str]:
        """Its name without groups, with and without the unit, in lower case."""
        return {self.leaf.lower(), self.parts[0].lower()}

    @property
    def role(self) -> str:
        """Role as a further channel of a record: "temperature", by the name and the unit, or "other"."""
        word, unit = self.parts[0].lower(), self.parts[1]
        known = unit in ("degC", "°C", "degF", "°F") or "temp" in word
        return "temperature" if known and quantity_of(unit) == "temperature" else "other"

    @property
    def quantities(self) -> set[str]:
        """The quantities whose words are the column's name; most names have none."""
        return {
            quantity
            for quantity, known in QUANTITIES.items()
            if self.words & {*known.words.split(", "), *known.more.split(", ")}
        }

    @property
    def is_plug(self) -> bool:
        """Whether it has the name of an output, a monitor or a channel."""
        return _PLUG.search(self.name.lower()) is not None

    @property
    def is_channel(self) -> bool:
        """Whether it has the name of a channel of an oscilloscope, and no unit: it holds volts."""
        return not self.parts[1] and _CHANNEL.match(self.leaf.strip().lower()) is not None

    @property
    def is_set_point(self) -> bool:
        """Whether it has the name of a set point."""
        return _SET_POINT.search(self.leaf.lower()) is not None

    @property
    def is_counter(self) -> bool:
        """Whether name and numbers show a counter of samples: they rise by one, or more if samples are left out."""
        word, unit = self.parts
        steps = np.diff(self.data)
        rises = steps.size > 0 and steps.min() == 1 and not (np.any(steps % 1) or self.data[0] % 1)
        # Instruments write a word in the place of a unit, as "Sequence".
        named = unit or self.unnamed or _COUNTS.fullmatch(word.strip(" .#").lower())
        return bool(rises and named and not symbol_of(unit))

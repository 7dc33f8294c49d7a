"""Ways to damage a file: blindly, in its text, and within the parts of an archive."""

from __future__ import annotations

import io
import random
import re
import struct
import zipfile

_INTEGERS = [0, 1, 2, 7, 8, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]
_INTEGERS += [1 << 20, (1 << 27) - 1, 1 << 33, 1 << 40, (1 << 63) - 1, (1 << 64) - 1]
_DOUBLES = [1e308, -1e308, 1e200, -1e155, 1e154, 1e99, float("nan"), float("inf"), 5e-324, 1e-310, 0.0]
_NUMBERS = ["1e308", "-1e308", "1e200", "1e-320", "nan", "inf", "-inf", "", "0", "-0.0", "0x1p3", "1_0", "+5", "1,5"]
_NUMBERS += ["٣", "1e5000", "9" * 400, "abc", '"', '"1', "=1+1", "1763780000000000001", "−5", "1e", "#", "%"]
_PIECES = [b"\0", b"\r", b"\xff\xfe", b"\xef\xbb\xbf", b'"', b",,,,", b";", b"\t", b"#", b"%", b"\x1b[2J", b"\x0b\x0c"]
_PIECES += [piece * 20_000 for piece in (b" ", b"_", b"9", b"a")] + [b"\n" * 500, b"[" * 5000, b"(" * 5000 + b"m"]
_PIECES += [b'"' * 5001, b",1" * 3000, b"e" * 3000, b"\xe2\x80\xa8"]


def mutated(content: bytes, name: str, dice: random.Random) -> bytes:
    """Damage a file by one to four mutations that fit its kind."""
    ways = [_flip, _flip, _cut, _integer, _integer, _double, _repeat]
    if name.endswith((".csv", ".tsv", ".txt", ".dat")):
        ways = [_flip, _cut, _repeat, _cell, _cell, _cell, _insert, _insert, _header, _header, _encode, _rows]
    elif name.endswith((".npz", ".xlsx")):
        ways += [_in_archive] * 10
    for way in [dice.choice(ways) for _ in range(dice.choice((1, 1, 1, 2, 3, 4)))]:
        content = way(content, dice) if content else content
    return content


def _place(content: bytes, dice: random.Random) -> int:
    """Anywhere, but headers more often: they stand first, or last."""
    size, lot = len(content), dice.random()
    if lot < 0.45:
        return dice.randrange(min(size, 1024))
    return size - 1 - dice.randrange(min(size, 1200)) if lot < 0.65 else dice.randrange(size)


def _flip(content: bytes, dice: random.Random) -> bytes:
    found = bytearray(content)
    for _ in range(dice.choice((1, 1, 2, 4, 16))):
        found[_place(content, dice)] ^= 1 << dice.randrange(8)
    return bytes(found)


def _cut(content: bytes, dice: random.Random) -> bytes:
    at = _place(content, dice)
    return content[:at] if dice.random() < 0.6 else content[:at] + content[at + dice.randrange(1, 200) :]


def _repeat(content: bytes, dice: random.Random) -> bytes:
    at = _place(content, dice)
    piece = content[at : at + dice.choice((1, 8, 100, 5000))]
    return content[:at] + piece * dice.choice((2, 3, 50)) + content[at:]


def _integer(content: bytes, dice: random.Random) -> bytes:
    """A number of 1, 2, 4 or 8 bytes, on a boundary as a rule: a size, an offset, a count, a type."""
    width = dice.choice((1, 2, 4, 4, 8, 8))
    at = _place(content, dice)
    at -= at % width if dice.random() < 0.8 else 0
    value, order = dice.choice(_INTEGERS), dice.choice(("little", "little", "big"))
    return content[:at] + (value % (1 << 8 * width)).to_bytes(width, order) + content[at + width :]


def _double(content: bytes, dice: random.Random) -> bytes:
    """Numbers among the samples that are none, or none that can be."""
    found = bytearray(content)
    for _ in range(dice.choice((1, 3, 30))):
        at = dice.randrange(len(content)) & ~7
        found[at : at + 8] = struct.pack("<d", dice.choice(_DOUBLES))
    return bytes(found)


def _cell(content: bytes, dice: random.Random) -> bytes:
    """Another number in cells."""
    cells = list(re.finditer(rb"[-+\d.e]{2,}", content))
    word = dice.choice(_NUMBERS).encode()
    for cell in sorted(dice.sample(cells, min(len(cells), dice.choice((1, 1, 2, 20)))), key=lambda m: -m.start()):
        content = content[: cell.start()] + word + content[cell.end() :]
    return content


def _insert(content: bytes, dice: random.Random) -> bytes:
    piece, at = dice.choice(_PIECES), _place(content, dice)
    return content[:at] + piece * dice.choice((1, 1, 2, 10)) + content[at:]


def _header(content: bytes, dice: random.Random) -> bytes:
    """Another header: a name doubled or replaced, a long run of blanks, brackets or lines in it."""
    head, _, body = content.partition(b"\n")
    run = dice.choice((b" ", b"_", b"[", b"(", b"]", b"\t", b'"', b" _", b"[ ")) * dice.choice((1, 50, 4000, 20000))
    names = (b"time_ns", b"time_min", b"voltage_kV", b"displacement_m", b"displacement_pm", b"voltage_V", b"x", b"")
    words = head.split(b",")
    at = dice.randrange(len(words))
    words[at] = dice.choice((words[at] + run, b"x [" + run + b"y", dice.choice(names), words[0], run + words[at]))
    return b",".join(words) + b"\n" * dice.choice((1, 1, 1, 2, 20000)) + body


def _encode(content: bytes, dice: random.Random) -> bytes:
    return content.decode("latin-1").encode(dice.choice(("utf-16", "utf-32", "utf-8-sig", "utf-7", "cp037")))


def _rows(content: bytes, dice: random.Random) -> bytes:
    """Rows in another order or dropped; separators and line ends exchanged."""
    lines = content.split(b"\n")
    if dice.random() < 0.3:
        dice.shuffle(lines)
    lines = [line for line in lines if dice.random() < dice.choice((0.5, 1.1))]
    old, new = dice.choice(((b",", b";"), (b"\n", b"\r"), (b",", b"\t"), (b".", b","), (b"\n", b"\n\n"), (b",", b", ")))
    return b"\n".join(lines).replace(old, new, dice.choice((1, 20, -1)))


def _in_archive(content: bytes, dice: random.Random) -> bytes:
    """One part damaged, or its shapes, types and places of cells edited, and packed again with right checksums."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # damaged by an earlier mutation
        return content
    if not parts:
        return content
    name = dice.choice([*parts, *(part for part in parts if "sheet" in part)])
    way = dice.choice((_edited, _edited, _edited, _flip, _integer, _cut, _double, _insert))
    parts[name] = way(parts[name], dice) if parts[name] else b""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", dice.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for member, data in parts.items():
            archive.writestr(member, data)
    return packed.getvalue()


def _edited(part: bytes, dice: random.Random) -> bytes:
    """Another shape and type of an array; other places of cells of a sheet."""
    shape = dice.choice((b"(%d,)" % dice.choice(_INTEGERS), b"(-1,)", b"()", b"(240, 1)", b"(0,)", b"(1.5,)"))
    descr = dice.choice((b"'<f8'", b"'>f8'", b"'|O'", b"'<f2'", b"'<i8'", b"'<U9'", b"'<f16'", b"[('a', '<f8')]"))
    if part.startswith(b"\x93NUMPY"):
        part = re.sub(rb"\(\d*,?[^)]*\)", lambda _: shape, part, count=1)
        return re.sub(rb"'[<|>][a-zA-Z]\d*'", lambda _: descr, part, count=dice.choice((0, 1)))
    place = dice.choice((b"A1", b"XFD1", b"A1048576", b"ZZZZ99999999", b"A0", b"", b"A1:A1", b"A1:XFD1048576", b"-1"))
    count = dice.choice((1, 1, 20))
    return re.sub(rb'\br(ef)?="[^"]*"', lambda m: b'r%s="%s"' % (m[1] or b"", place), part, count=count)

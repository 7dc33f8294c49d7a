"""Rigs by their addresses."""

import sys

import pytest

from dehyst._errors import DehystError
from dehyst.instruments import RigError, open_rig
from dehyst.instruments.pi import PiRig
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator


def test_addresses_go_to_their_rigs(monkeypatch):
    seen = []

    def connect(*where, **asked):
        seen.append((where, asked))
        return SimulatedRig(PlayActuator(), limits=asked["limits"])

    monkeypatch.setattr("dehyst.instruments.epics.EpicsRig.connect", connect)
    monkeypatch.setattr(PiRig, "connect", connect)
    limits = {"limits": (0.0, 5.0), "slew_rate": None}
    for address in (
        "epics://XF:11{Ax:1}#2",
        "epics://LAB:",
        "PI://Lab-7.local",
        "pi://[::1]:7/Z",
        "pi://10.0.0.3:50001",
    ):
        open_rig(address, limits=(0.0, 5.0))
    assert seen == [
        (("XF:11{Ax:1}#2",), limits),
        (("LAB:",), limits),
        (("lab-7.local", 50000), {"axis": None, **limits}),
        (("::1", 7), {"axis": ["Z"], **limits}),
        (("10.0.0.3", 50001), {"axis": None, **limits}),
    ]
    with open_rig("sim://", slew_rate=7.0) as rig:
        assert rig.slew_rate == 7.0
    with pytest.raises(DehystError, match="need nothing"):
        open_rig("sim://wobble")


def test_wrong_addresses_are_refused(tmp_path):
    for address, why in [
        ("pi://", "need pi://host:port"),
        ("pi://h:99999", "not the address"),
        ("pi://h:1/a/b", "need pi://host"),
        ("gpib://7", "'gpib'"),
        ("rubbish", "'rubbish'"),
        ("a.py:", "not the address"),
        ("epics://", "need the prefix"),
        ("missing.py:make", "does not exist"),
    ]:
        with pytest.raises(RigError, match=why):
            open_rig(address)
    own = tmp_path / "own_rig_of_mine.py"
    for text, why in [
        ("make = 3", "has no function 'make'"),
        ("def make(**_): return 3", "returned a int"),
        ("def make(): pass", "TypeError"),
        ("1/0", "ZeroDivisionError"),
        ("x y", "SyntaxError"),
    ]:
        own.write_text(text)
        with pytest.raises(RigError, match=why):
            open_rig(f"{own}:make")
    own.write_text(
        "from fake_rig import FakeRig\n"
        "def make(limits, slew_rate):\n    return FakeRig(limits=limits, slew_rate=slew_rate)\n"
    )
    rig = open_rig(f"{own}:make", limits=(1.0, 7.0), slew_rate=3.0)
    assert (rig.limits.low, rig.limits.high, rig.slew_rate) == (1.0, 7.0, 3.0)


OWN = "from dehyst.instruments.simulated import SimulatedRig\nfrom dehyst.virtual import PlayActuator\n"


def own_rig(folder, code, begin=""):
    """The address of a rig of one's own, by the code of its module."""
    path = folder / "rig_of_mine.py"
    path.write_text(f"{begin}\n{OWN}{code}\n")
    return f"{path}:make"


@pytest.mark.parametrize(
    "begin",
    [
        "from plant_of_mine import PLANT",
        "from dataclasses import dataclass\n\n@dataclass\nclass Asked:\n    gain: float",
    ],
)
def test_a_user_defined_rig_is_an_ordinary_module(tmp_path, monkeypatch, begin):
    """It imports from its folder as a script does, and dataclasses find their module."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    (tmp_path / "plant_of_mine.py").write_text("from dehyst.virtual import PlayActuator\nPLANT = PlayActuator()\n")
    code = "def make(**asked):\n    return SimulatedRig(PlayActuator(), limits=asked['limits'])"
    address = own_rig(tmp_path, code, f"from __future__ import annotations\n{begin}")
    with open_rig(address, limits=(0.0, 5.0)) as rig:
        assert rig.limits.high == 5.0


@pytest.mark.parametrize(
    ("asked", "why"),
    [({"limits": (0.0, 20.0)}, "allows 0 to 200 V .* but 0 to 20 V"), ({"slew_rate": 5.0}, "but .* 5 V/s")],
)
def test_a_rig_that_ignores_limits_or_slew_rate_is_refused(tmp_path, asked, why):
    address = own_rig(tmp_path, "def make(**asked):\n    return SimulatedRig(PlayActuator())")
    with pytest.raises(RigError, match=why):
        open_rig(address, **asked)


def test_a_missing_rig_is_reported(tmp_path):
    half = "class Half(SimulatedRig):\n    def __init__(self): pass\ndef make(**asked):\n    return Half()"
    with pytest.raises(RigError, match="its __init__"):
        open_rig(own_rig(tmp_path, half))

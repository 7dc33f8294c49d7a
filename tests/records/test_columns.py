"""What is known of a file's columns: from names, from units, from the text of `Columns`; and what is proposed.

Each case has a header, a text, and what becomes of it: the volts and micrometres of its second row, the proposal of the
error, or the argument that is refused.
"""

from dataclasses import fields

import numpy as np
import pytest
from laboratory_files import UM, T, V, Y, rows

import dehyst
from dehyst import Columns, FileFormatError
from dehyst.records.columns import entries_of
from dehyst.records.tables import ColumnsError


@pytest.mark.parametrize(
    "columns",
    [
        Columns(),
        Columns(time="Time, local:ms", voltage='a "b":mV*100', displacement="3:um?", rate=50.0),
        Columns(displacement="pd*fringe 316.4 nm", join="second.csv", decimal="comma", hold="sample"),
        Columns(axes={"x": "vx_V:x_um", "y": "vy*2:y:nm*-1 um/um"}, temperature="4:C"),
    ],
)
def test_a_printed_text_of_columns_is_read_again(columns, tmp_path):
    assert Columns.parse(str(columns)) == columns
    assert set(columns.entries()) <= {part.name for part in fields(columns)} | {"x", "y"}
    if columns.entries():
        columns.save(tmp_path / "columns.txt")
        assert Columns.parse(f"@{tmp_path / 'columns.txt'}") == columns


# Header, columns, and what is proposed: no text, or its entries.
VOLTS, LOW, FRINGES = V, V / 100, 1 + np.cos(2 * np.pi * UM / 0.3164)
PROPOSED = {
    "other words": ("Zeit,Ansteuerung,Auslenkung", (T, V, UM), "Zeit:s?, Ansteuerung:V?, Auslenkung:um?"),
    "nanometres": ("time_s,voltage_V,y", (T, V, 1e3 * UM), "-, -, y:nm?"),
    "metres": ("time_s,voltage_V,y", (T, V, Y), "-, -, y:m?"),
    "no plausible unit": ("time_s,voltage_V,y", (T, V, 1e9 * UM), ""),
    "a sensor in volts": ("time_s,voltage_V,sensor_V", (T, V, UM / 10), "-, -, sensor_V?*GAIN um/V"),
    "amperes and ppm": (
        "time_s,Current (A),Strain (ppm)",
        (T, V, UM),
        "-, Current (A)?*GAIN V/A, Strain (ppm)?*GAIN um/ppm",
    ),
    "per cent": ("time_s,Voltage (%),Position (%)", (T, V, UM), "-, Voltage (%)*GAIN V/%, Position (%)*GAIN um/%"),
    "channels of an oscilloscope": ("time_s,CH1,CH2", (T, LOW, UM), "-, CH1:V?*GAIN, CH2:V?*GAIN um/V"),
    "a counter is no time": ("No,voltage_V,y_um", (np.arange(T.size), V, UM), "HZ, -, -"),
    "a length is no time": ("Height [nm],voltage_V,y_um", (1e3 * T, V, UM), "HZ, -, -"),
    "the measured one": ("time_s,voltage_V,Soll,Ist", (T, V, UM * 1.01, UM), "-, -, Ist:um?"),
    "not the command": ("time_s,voltage_V,target um,gauge um", (T, V, UM, UM), "-, -, gauge um:um?"),
    "names that stand twice": ("time_s,a,a", (T, V, UM), "-, 2:V?, 3:um?"),
    "fringes": ("time_s,voltage_V,photodiode", (T, V, FRINGES), "-, -, photodiode?*fringe GAIN nm"),
    "fringes in volts": ("time_s,drive,PD (V)", (T, V, FRINGES), "-, drive:V?, PD (V)?*fringe GAIN nm"),
    "fringes of no unit": ("time_s,voltage_V,position", (T, V, FRINGES), "-, -, position?*fringe GAIN nm"),
}


@pytest.mark.parametrize("case", PROPOSED)
def test_a_refusal_proposes_columns(case, tmp_path):
    header, columns, expected = PROPOSED[case]
    (tmp_path / "a.csv").write_text(f"{header}\n{rows(*columns)}")
    with pytest.raises(ColumnsError) as caught:
        dehyst.read(tmp_path / "a.csv")
    found = entries_of(caught.value.proposal)
    given = [entry for entry in expected.split(", ") if entry]
    keys = ("rate" if given[:1] == ["HZ"] else "time", "voltage", "displacement")
    assert found == {key: entry for key, entry in zip(keys, given, strict=False) if entry != "-"}
    assert (caught.value.proposal in str(caught.value), caught.value.change) == (True, ("columns",) if found else ())


def test_a_proposal_keeps_what_was_given(tmp_path):
    (tmp_path / "a.csv").write_text("clock,CH1,CH2\n" + rows(T, LOW, UM))
    with pytest.raises(ColumnsError) as caught:
        dehyst.read(tmp_path / "a.csv", "voltage=*100, displacement=CH2:um, decimal=point")
    proposal = "voltage=CH1:V?*100, displacement=CH2:um, decimal=point, time=clock:s?"
    assert caught.value.proposal == proposal


def test_columns_of_one_length_are_paired(tmp_path):
    np.savez(tmp_path / "a.npz", M1=V, ratio=np.tile([1.0, 2.0], 10), short=UM[:20], angle=UM, clock=T)
    with pytest.raises(ColumnsError) as caught:
        dehyst.read(tmp_path / "a.npz")
    assert entries_of(caught.value.proposal) == {"time": "clock:s?", "voltage": "M1:V?", "displacement": "angle:um?"}


AXES = {
    "x=vx_V:x_um, y=vy_V:y_um": "time_s,vx_V,vy_V,x_um,y_um",
    "x=Vx [V]:x [um], y=Vy:y": "Time [s],Vx [V],Vy [V],x [um],y [um]",
    '"x=Vx, fast [V]:x [um]", y=Vy:y': 'time_s,"Vx, fast [V]",Vy [V],x [um],y [um]',
    "x=a b:V:first one:um, y=second:V:third:um?": "time_s,a b,second,first one,third",
    "time=1:s, x=2:V:4:um, y=3:V:5:um": "",
    "x=vx_V*1:x_um, y=vy:V*-1:y_um*-1": "time_s,vx_V,vy,x_um,y_um",
}


@pytest.mark.parametrize("text", AXES)
def test_columns_of_several_axes_are_read(text, tmp_path):
    body = rows(T, V, -V if "*-1" in text else 2 * V, UM, -UM if "*-1" in text else 2 * UM)
    (tmp_path / "a.csv").write_text(f"{AXES[text]}\n{body}" if AXES[text] else body)
    record = dehyst.read(tmp_path / "a.csv", text)
    factor = 1 if "*-1" in text else 2
    assert record.axes == ("x", "y")
    assert record.voltage == pytest.approx(np.c_[V, factor * V], abs=1e-6)
    assert record.displacement == pytest.approx(np.c_[Y, factor * Y], abs=1e-12)
    # The record keeps a text that is read again, as from a model file.
    assert dict(pair.partition("=")[::2] for pair in record.meta["axes"]) == Columns.parse(text).axes


@pytest.mark.parametrize(
    "text", ["x=vx_V:x_um", "x=vx:um, y=vy:um", "x=a:V:b:um:c, y=d:e", "x=vx_V:x_um, y=vx_V:y_um", "x=:, y=:"]
)
def test_columns_that_are_no_axes_are_refused(text):
    with pytest.raises(FileFormatError) as caught:
        Columns.parse(text).of_axes()
    assert caught.value.argument == "axes"

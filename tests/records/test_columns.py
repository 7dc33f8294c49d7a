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

# Values of the second of two rows: 0.5, 3, 4.
READ = {
    "by their names": ("time_s,voltage_V,displacement_um", "", (3, 4)),
    "in other units": ("t_ms,Drive [mV],Position(nm)", "", (3e-3, 4e-3)),
    "a unit of the text": ("time,voltage,displacement", "time=:s, voltage=:V, displacement=:nm", (3, 4e-3)),
    "by name": ("time_s,piezo_V,gauge 1 (nm)", "voltage=piezo, displacement=gauge 1 (nm)", (3, 4e-3)),
    "by number": ("time_s,a,a", "voltage=2:V, displacement=3:um", (3, 4)),
    "a factor": ("time_s,monitor_mV,y_um", "voltage=monitor*100", (0.3, 4)),
    "a factor without a name": ("time_s,voltage_V,sensor_V", "voltage=*2, displacement=sensor_V*10", (6, 40)),
    "a factor with units": ("time_s,voltage_V,sensor_V", "displacement=sensor_V*10 nm/mV", (3, 40)),
    "amperes and ppm": (
        "time_s,Current (A),Strain (ppm)",
        "voltage=Current (A)*25 V/A, displacement=Strain*0.01 um/ppm",
        (75, 0.04),
    ),
    "inches": ("time_s,Force (kip),Travel (in)", "voltage=2*1 V/kip, displacement=3*0.0254 m/in", (3, 101600)),
    "per cent": ("time_s,Voltage (%),Pos (%)", "voltage=2*1.5 V/%, displacement=3*0.1 um/%", (4.5, 0.4)),
    "counts without a unit": ("time_s,dac,encoder", "voltage=dac*0.5, displacement=encoder*0.1", (1.5, 0.4)),
    "the sign of a sensor": ("time_s,voltage_V,y_um", "displacement=*-1", (3, -4)),
    "the last pair of brackets": ("time_s,voltage_V,Z [bwd] (nm)", "displacement=Z [bwd]", (3, 4e-3)),
    "a comma in a name": ('time_s,"Drive, sent (V)",y_um', '"voltage=Drive, sent (V)"', (3, 4)),
    "marks in a name": ("time_s,drive?_V,a:b*2_um", "voltage=drive?_V, displacement=a:b*2_um", (3, 4)),
    "a rate": ("step,voltage_V,y_um", "rate=2", (3, 4)),
    "a rate in the place of a time": ("time_s,voltage_V,y_um", "rate=2", (3, 4)),
    "one of several axes": ("time_s,voltage_V,x_um,y_um,z_um", "displacement=y_um", (3, 5)),
    "an axis beside the displacement": ("time_s,voltage_V,displacement_um,x_um", "", (3, 4)),
    "a name that ends as a guess does": ("time_s,drive?_V,why?", "voltage=drive?_V, displacement=why?:um", (3, 4)),
    "a set-point beside it": ("time_s,voltage_V,target_um", "displacement=target", (3, 4)),
}


@pytest.mark.parametrize("case", READ)
def test_a_text_of_columns_gives_the_values(case, tmp_path):
    header, text, (volts, micrometres) = READ[case]
    width = header.count(",") + 1 - header.count('"')
    more = ",".join(map(str, range(5, 2 + max(width, 3))))
    tail = f",{more}" if width > 3 else ""
    (tmp_path / "a.csv").write_text(f"{header}\n0,1,2{tail}\n0.5,3,4{tail}\n")
    for columns in (text, Columns.parse(text), str(Columns.parse(text))):
        record = dehyst.read(tmp_path / "a.csv", columns)
        found = np.diff(record.time)[0], record.voltage[1], 1e6 * record.displacement[1]
        assert found == pytest.approx((5e-4 if "t_ms" in header else 0.5, volts, micrometres), rel=1e-12)
        assert "guesses" not in record.meta


REFUSED = {
    "no unit": ("time_s,voltage_V,displacement", ""),
    "no unit of the time": ("time,voltage_V,y_um", ""),
    "unknown unit": ("time_s,voltage_MV,y_um", ""),
    "wrong unit": ("time_s,voltage_um,y_um", ""),
    "twice": ("time_s,voltage_V,voltage_V,y_um", ""),
    "no voltage": ("time_s,y_um", ""),
    "no time": ("voltage_V,y_um", ""),
    "two fit": ("time_s,voltage_V,drive_V,y_um", ""),
    "two axes": ("time_s,voltage_V,x_um,y_um", ""),
    "no such name": ("time_s,voltage_V,y_um", "voltage=absent"),
    "no such number": ("time_s,voltage_V,y_um", "voltage=4"),
    "a known unit against the file": ("time_s,voltage_V,y_um", "displacement=y_um:nm"),
    "volts against micrometres": ("time_s,voltage_V,y_V", "displacement=y_V:um"),
    "amperes against volts": ("time_s,Current (A),y_um", "voltage=Current (A):V"),
    "per cent against micrometres": ("time_s,voltage_V,Position (%)", "displacement=Position (%):um"),
    "counts in a name": ("time_s,voltage_V,encoder_counts", "displacement=encoder_counts:um"),
    "a factor for amperes without units": ("time_s,Current (A),y_um", "voltage=Current*25"),
    "a factor for another unit": ("time_s,Current (A),y_um", "voltage=Current*25 V/Pa"),
    "a factor that gives no length": ("time_s,voltage_V,y_V", "displacement=y_V*15 V/um"),
    "a monitor": ("time_s,AO0 [mV],y_um", "voltage=AO0"),
    "a second unit": ("time_s,voltage_V,y_um", "time=time_s:V"),
    "a rate against a good time": ("time_s,voltage_V,y_um", "rate=500"),
    "a rate and a time": ("time_s,voltage_V,y_um", "rate=2, time=time_s"),
    "a grating of volts": ("time_s,voltage_V,y_um", "voltage=*grating 3 um"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_text_of_columns_that_does_not_fit_is_refused(case, tmp_path):
    header, text = REFUSED[case]
    width = header.count(",") + 1
    body = "".join(",".join(str(k + j) for j in range(width)) + "\n" for k in range(30))
    (tmp_path / "a.csv").write_text(f"{header}\n{body}")
    with pytest.raises(FileFormatError):
        dehyst.read(tmp_path / "a.csv", text)


NO_COLUMNS = {
    "time": "columns",
    "=a": "columns",
    "time=a, time=b": "columns",
    "rate=HZ": "rate",
    "rate=0": "rate",
    "rate=nan": "rate",
    "decimal=;": "decimal",
    "hold=long": "hold",
    "voltage=a*GAIN": "columns",
    "displacement=a*fringe GAIN nm": "columns",
    "voltage=a*0": "columns",
    "voltage=a*1e999": "columns",
    "displacement=a*fringe 3 V": "columns",
    "displacement=a*grating -3 um": "columns",
    "@absent.txt": "",
    3: "columns",
    ("voltage",): "columns",
}


@pytest.mark.parametrize("text", NO_COLUMNS)
def test_a_malformed_text_of_columns_is_refused(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileFormatError) as caught:
        Columns.of(text)
    assert caught.value.argument == NO_COLUMNS[text]


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

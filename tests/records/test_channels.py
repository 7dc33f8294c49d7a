"""Further channels of a record: each way in, through every operation, and each way out; what cannot be one."""

import numpy as np
import pytest

from dehyst import RecordError
from dehyst.identification.preparation import block_means
from dehyst.records import Record, cleaned, read, write_columns

N = 120
T = np.arange(N) * 0.01
V = 50 - 50 * np.cos(2 * np.pi * T / 0.4)
Y = 1e-7 * V
TEMPERATURE = 20 + T
LOAD = 3 - T
HUMIDITY = 40 + 2 * T
OTHERS = {"temperature_C": TEMPERATURE, "load_N": LOAD, "humidity [%]": HUMIDITY}
FILE = {"time_s": T, "voltage_V": V, "displacement_um": Y * 1e6}
RECORD = Record(T, V, Y, "r", others=OTHERS)


def test_channels_have_names_and_roles():
    several = Record(T, np.c_[V, V], np.c_[Y, 2 * Y], others=OTHERS)
    made = Record.from_arrays(T, V, Y * 1e6, units="um", others=OTHERS)
    for record in (RECORD, made, several, several.axis("y")):
        assert [(channel.column, channel.role) for channel in record.others] == [
            ("temperature_C", "temperature"),
            ("load_N", "other"),
            ("humidity [%]", "other"),
        ]
    assert repr(RECORD).endswith("um, temperature, load, humidity>")
    assert repr(several).endswith("axes x, y, temperature, load, humidity>")


@pytest.mark.parametrize(
    ("column", "values", "name", "expected"),
    [
        ("temperature_K", TEMPERATURE + 273.15, "temperature", TEMPERATURE),
        ("Temperature [degC]", TEMPERATURE, "Temperature", TEMPERATURE),
        ("Room [°F]", 32 + 1.8 * TEMPERATURE, "Room", TEMPERATURE),
        ("Room (°C)", TEMPERATURE, "Room", TEMPERATURE),
        # A channel that is no temperature is kept as it is.
        ("charge_C", V, "charge", V),
        ("Force [mN]", LOAD, "Force", LOAD),
        ("flow [l/min]", V, "flow", V),
    ],
)
def test_units_are_those_of_the_quantity(column, values, name, expected):
    (channel,) = Record(T, V, Y, others={column: values}).others
    assert channel.name == name
    assert channel.values == pytest.approx(expected, rel=1e-12)
    assert channel.unit == {"temperature": "degC"}.get(channel.role, channel.unit)
    assert channel.role != "other" or channel.column == column.replace(" [mN]", "_mN")


@pytest.mark.parametrize(
    "others",
    [
        {"temperature_C": T[1:]},
        {"temperature_C": np.where(T[3] == T, np.nan, 20.0)},
        {"temperature_C": T + 1e31},
        {"temperature_C": T + 1000.5},
        {"temperature_K": T - 1},
        *({name: T} for name in ("temperature", "_C", "a,b_C", "a\nb_C", "voltage_V", "time_s")),
        {"temperature_C": ["warm"] * N},
        {"temperature_C": np.ones((N, 2))},
        {"temperature_C": T, "temperature_K": T + 273},
    ],
)
def test_impossible_channels_are_refused(others):
    with pytest.raises(RecordError):
        Record(T, V, Y, others=others)


def test_cleaning_and_averaging_keep_channels_aligned():
    v = V.copy()
    v[30] += 40
    found = cleaned(Record(T, v, Y, others=OTHERS))
    assert len(found.sentences) == 1
    assert np.array_equal(found.record.others[0].values, np.delete(TEMPERATURE, 30))
    assert block_means(RECORD, 4).others[0].values == pytest.approx(TEMPERATURE.reshape(-1, 4).mean(axis=1))


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_temperatures_are_found_in_files_of_others(suffix, tmp_path):
    columns = {**FILE, "Temperature [K]": TEMPERATURE + 273.15, "load_N": LOAD, "spare_V": V, "order_N": V}
    path = tmp_path / f"a{suffix}"
    write_columns(path, columns) if suffix == ".csv" else np.savez(path, **columns)
    record = read(path)
    assert {channel.role for channel in record.others} == {"temperature"}
    assert record.temperature == pytest.approx(TEMPERATURE)


def test_columns_select_channels(tmp_path):
    path = tmp_path / "a.csv"
    rows = np.column_stack([T, V, Y, TEMPERATURE, HUMIDITY]).tolist()
    path.write_text("\n".join(",".join(map(repr, row)) for row in rows))
    record = read(path, "time=1:s, voltage=2:V, displacement=3:m, temperature=4:C?")
    assert [channel.column for channel in record.others] == ["temperature_C"]
    assert record.meta["guesses"] == {"temperature": "column '4' in C"}
    assert any("guessed, verify" in words for words in record.problems())
    write_columns(path, {**FILE, "temperature_C": TEMPERATURE})
    assert len(read(path, "time=1:s, voltage=2:V, displacement=3:um").others) == 1


def test_a_channel_that_cannot_be_read_is_left_out_unless_it_was_asked_for(tmp_path):
    path = tmp_path / "a.csv"
    write_columns(path, {**FILE, "temperature_C": np.where(T > 1, np.nan, 20)})
    record = read(path)
    assert record.others == ()
    assert any(
        "Column 'temperature_C' is left out: temperature holds 19 values not finite" in w for w in record.problems()
    )
    with pytest.raises(RecordError, match="temperature holds 19 values"):
        read(path, "time=1:s, voltage=2:V, displacement=3:um, temperature=4:C")


def test_a_second_file_may_have_the_channels(tmp_path):
    write_columns(tmp_path / "a.csv", FILE)
    slow = np.linspace(-1, 3, 20)
    write_columns(tmp_path / "b.csv", {"time_s": slow, "temperature_C": 20 + slow})
    (channel,) = read(tmp_path / "a.csv", f"join={tmp_path / 'b.csv'}").others
    assert (channel.name, channel.role) == ("temperature", "temperature")
    assert channel.values == pytest.approx(TEMPERATURE)


def test_several_temperatures_are_remarked_because_none_is_used():
    record = Record(T, V, Y, others={"temperature_C": T, "room_degC": T})
    assert record.temperature is None
    assert any("room_degC" in sentence for sentence in record.problems())
    assert not any("temperature" in sentence for sentence in Record(T, V, Y, others={"temperature_C": T}).problems())

"""Records as HDF5: every bit comes back, and what was changed since is not taken for a measurement."""

import hashlib
import sys

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dehyst._errors import FileFormatError, MissingExtraError
from dehyst.records import Record, read
from dehyst.records.files import write_hdf5

words = st.text(st.sampled_from('ab"\\/\n\0é\u2028\ud800\U0001f600 '), max_size=6)
values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats(allow_nan=False, allow_infinity=False) | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)
# As large as a record takes.
finite = st.floats(-1e30, 1e30)


def bits(record):
    return [column.tobytes() for column in (record.time, record.voltage, record.displacement)]


def a_record(n=5, **about):
    t = np.arange(n) / 3
    return Record(t, np.sin(t), 1e-6 * np.cos(t), **about)


@given(arrays(float, st.tuples(st.just(2), st.integers(2, 20)), elements=finite), words, st.dictionaries(words, values))
def test_every_bit_comes_back(tmp_path_factory, columns, name, meta):
    path = tmp_path_factory.mktemp("h") / "a.h5"
    t = 0.1 * np.arange(columns.shape[1]) + 1 / 3
    record = Record(t, columns[0], columns[1], name, meta)
    write_hdf5(path, record)
    back = read(path)
    assert bits(back) == bits(record)
    assert (back.name, back.meta) == (name, meta)
    assert repr(back.meta) == repr(meta)


def test_layout_and_hash_for_other_programs(tmp_path):
    record = a_record(name="tops", meta={"rig": "E-709"})
    write_hdf5(tmp_path / "a.hdf5", record)
    with h5py.File(tmp_path / "a.hdf5") as file:
        assert {name: file[name].attrs["unit"] for name in file} == {
            "time_s": "s",
            "voltage_V": "V",
            "displacement_m": "m",
        }
        assert all(file[name].dtype == "<f8" for name in file)
        stored = b"".join(file[name][()].tobytes() for name in ("time_s", "voltage_V", "displacement_m"))
        assert file.attrs["sha256"] == hashlib.sha256(stored).hexdigest()
        assert file.attrs["dehyst"] == '{"name": "tops", "meta": {"rig": "E-709"}}'


def test_a_meta_of_any_length(tmp_path):
    meta = {"voltages": list(range(100_000))}
    write_hdf5(tmp_path / "a.h5", a_record(meta=meta))
    assert read(tmp_path / "a.h5").meta == meta


def test_a_name_given_when_reading_comes_first(tmp_path):
    write_hdf5(tmp_path / "a.h5", a_record(name="tops"))
    assert read(tmp_path / "a.h5", name="mine").name == "mine"
    assert read(tmp_path / "a.h5").name == "tops"


def test_the_same_record_makes_the_same_file(tmp_path):
    write_hdf5(tmp_path / "a.h5", a_record())
    write_hdf5(tmp_path / "b.h5", a_record())
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_changed_samples_are_refused(tmp_path):
    write_hdf5(tmp_path / "a.h5", a_record())
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["displacement_m"][3] *= 1 + 1e-15
    with pytest.raises(FileFormatError, match=r"a\.h5: its samples"):
        read(tmp_path / "a.h5")


def test_a_file_cut_short_is_refused(tmp_path):
    write_hdf5(tmp_path / "a.h5", a_record(1000))
    whole = (tmp_path / "a.h5").read_bytes()
    for kept in (0, 7, 100, len(whole) // 2, len(whole) - 1):
        (tmp_path / "a.h5").write_bytes(whole[:kept])
        with pytest.raises(FileFormatError, match=r"a\.h5: (not a readable \.h5 file|the file is empty)"):
            read(tmp_path / "a.h5")


def test_refusals(tmp_path, monkeypatch):
    with pytest.raises(FileFormatError, match=r"the suffix \.h5 or \.hdf5"):
        write_hdf5(tmp_path / "a.csv", a_record())
    for bad in (np.nan, np.inf, object(), {1, 2}):
        with pytest.raises(FileFormatError, match="written as JSON"):
            write_hdf5(tmp_path / "a.h5", a_record(meta={"x": bad}))
    with pytest.raises(FileFormatError, match="absent"):
        write_hdf5(tmp_path / "absent" / "a.h5", a_record())
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtraError, match=r"Writing \.h5 files needs h5py.*dehyst\[bench\]"):
        write_hdf5(tmp_path / "a.h5", a_record())
    assert list(tmp_path.iterdir()) == []

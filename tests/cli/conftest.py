"""A model and the files beside it, for commands that read them."""

from dataclasses import replace

import plain_records
import pytest


@pytest.fixture(scope="module")
def model():
    return replace(plain_records.plant(4), limits=(-50.0, 250.0))


@pytest.fixture
def folder(tmp_path, model):
    """A model, a voltage and a path to follow."""
    model.save(tmp_path / "model.json")
    (tmp_path / "voltage.csv").write_text("time_s,voltage_V\n0,1\n0.1,2\n0.2,1\n")
    (tmp_path / "path.csv").write_text("time_s,displacement_um\n0,2\n0.1,5\n0.2,3\n")
    return tmp_path

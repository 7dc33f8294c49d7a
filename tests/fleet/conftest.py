"""Runs over a fleet without workers, for what is not about them."""

import fleet_records
import pytest

import dehyst.fleet.run


@pytest.fixture
def in_this_process(monkeypatch):
    monkeypatch.setattr(dehyst.fleet.run, "run_tasks", fleet_records.inline)

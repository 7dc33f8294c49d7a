"""Records for a workbench, and one that runs."""

import numpy as np
import pytest
from workbench_client import served

from dehyst.model import Actuator, MaxwellSlip, Spring

for needed in ("starlette", "uvicorn", "websockets"):
    pytest.importorskip(needed, reason="needs the extra workbench")


@pytest.fixture(scope="session")
def loops(tmp_path_factory):
    """Write descending loops of an actuator with noise, as CSV."""
    actuator = Actuator(MaxwellSlip([0.5e-6, 1e-6, 2e-6], [3e6, 2e6, 1e6]), Spring([0, 12e-6], [0, 100]))
    time = np.arange(3000) * 2e-3
    tops = np.interp(time, [0, 2, 6], [100, 100, 30])
    voltage = tops * (0.5 - 0.5 * np.cos(2 * np.pi * time))
    measured = actuator.simulate(voltage, extrapolate=True).displacement
    measured = 1e6 * measured + np.random.default_rng(1).normal(0, 2e-3, time.size)
    path = tmp_path_factory.mktemp("records") / "loops.csv"
    table = np.column_stack([time, voltage, measured])
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header="time_s,voltage_V,displacement_um", comments="")
    return path


@pytest.fixture
def bench(tmp_path):
    with served(tmp_path / "bench") as running:
        yield running

"""A runner of an FMU, and compensators that are exported as FMUs."""

import os
import shutil
import sys
import warnings
from dataclasses import replace

import compiled_exports
import numpy as np
import plain_records
import pytest
import structured_records
from compiled_exports import KINDS, LIMITS

import dehyst

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed")
validate_fmu = pytest.importorskip("fmpy.validation", reason="fmpy is not installed").validate_fmu
if not sys.platform.startswith("linux") or os.uname().machine != "x86_64" or shutil.which("cc") is None:
    pytest.skip("an FMU's binary is built by a C compiler on Linux x86-64", allow_module_level=True)

PERIOD = 1 / structured_records.RATE
INPUT, OUTPUT, GAIN, OFFSET, LIMITED, SLEWED = 1, 2, 3, 4, 5, 6
TARGETS = ("compensator", "actuator")
_MOVING = KINDS["moving"]()
# Compensators: plain; without time; all parts with creep; with a mass and a lag; the same with preview.
ALL = {
    "plain": compiled_exports.plain(slew=4e3, period=PERIOD),
    "timeless": compiled_exports.plain(),
    "creep": KINDS["all"](),
    "mass": dehyst.Compensator(replace(_MOVING.actuator, delay=0.0), LIMITS, 4e3, period=PERIOD),
    "preview": _MOVING,
}
MODELS = tuple(ALL)
# A path [m] that leaves the reach on both sides, and random voltages [V], also beyond the limits.
PATH = plain_records.wild_path(1, 400, 0.2, (14, 15))
VOLTAGES = np.clip(PATH / plain_records.STROKE, -0.2, 1.2) * 150 + 10


def voltages(compensator, path):
    """The voltages of Python, from the start of an FMU."""
    fresh = compensator._clone()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dehyst.ClampWarning)
        return fresh.run(path), fresh.clamps


def displacements(model, volts, start=None):
    """The displacement by `Actuator.simulate` from the start state."""
    compensator = ALL[model]
    actuator, start = compensator.actuator, compensator._axes[0].given if start is None else start
    given = np.append(actuator.voltage(start), volts)
    time = np.arange(given.size) * PERIOD if compensator.period else None
    return actuator.simulate(given, time=time, state=start).displacement[1:]


class Slave:
    """An instance; `said` is its log: category and message."""

    def __init__(self, folder, *, token=None, logging=True, begin=True):
        self.description = fmpy.read_model_description(folder)
        self.said = []
        options = {
            "guid": token or self.description.guid,
            "unzipDirectory": str(folder),
            "modelIdentifier": self.description.coSimulation.modelIdentifier,
            "instanceName": "one",
        }
        from fmpy import fmi2

        self.fmu = fmi2.FMU2Slave(**options)
        # The logger is variadic: a call with five arguments is compatible.
        logger = fmi2.fmi2CallbackLoggerTYPE(lambda _, name, status, category, text: self._hear(category, text))
        self.fmu.instantiate(callbacks=fmi2.fmi2CallbackFunctions(logger=logger), loggingOn=logging)
        self.read, self.write, self.count = self.fmu.getReal, self.fmu.setReal, self.fmu.getInteger
        if begin:
            self.begin()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.fmu.freeInstance()

    def _hear(self, category, text):
        self.said.append((category.decode(), text.decode()))

    def begin(self, start=0.0):
        self.time = start
        self.fmu.setupExperiment(startTime=start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def step(self, value=None, by=PERIOD):
        """The output after a step with this input."""
        if value is not None:
            self.write([INPUT], [value])
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=by)
        self.time += by
        return self.read([OUTPUT])[0]

    def run(self, values):
        return np.array([self.step(float(value)) for value in values])

    def counts(self):
        return tuple(self.count([LIMITED, SLEWED]))

    def state(self):
        """The serialised state; its memory is freed."""
        state = self.fmu.getFMUState()
        data = self.fmu.serializeFMUState(state)
        self.fmu.freeFMUState(state)
        return data

    def restore(self, data):
        state = self.fmu.deserializeFMUState(data)
        self.fmu.setFMUState(state)
        self.fmu.freeFMUState(state)

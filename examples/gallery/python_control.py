"""
A loop in python-control
========================

A compensator and its actuator become blocks with all memory in their states, with an integral control around them.
"""

import dataclasses

import control
import matplotlib.pyplot as plt
import numpy as np

import dehyst

# %%
# An actuator with creep has aged: the compensator still has its old model.
knots = np.linspace(0, 16e-6, 5)
slip = dehyst.MaxwellSlip(1e-6 * np.arange(1, 9), np.linspace(8e5, 1e5, 8))
creep = dehyst.DisplacementCreep([0.01, 0.1, 1.0], [0.01, 0.01, 0.01])
actuator = dehyst.Actuator(slip, dehyst.Spring(knots, 8e6 * knots), limits=(-30, 150), displacement_creep=creep)
aged = dataclasses.replace(actuator, spring=dehyst.Spring(knots, 7.6e6 * knots))


# %%
# python-control calls the functions of a block in any order. Therefore each call first restores the memory from the
# state: a snapshot, with one number per byte. The output of a sample depends on its input.
def block(loop, inputs, outputs, advance):
    def numbers():
        return np.frombuffer(loop.snapshot(), np.uint8).astype(float)

    def advanced(x, u):
        loop.restore(x.astype(np.uint8).tobytes())
        return advance(u[0])

    def update(t, x, u, params):
        advanced(x, u)
        return numbers()

    def output(t, x, u, params):
        return advanced(x, u)

    begin = numbers()
    made = control.NonlinearIOSystem(update, output, inputs=inputs, outputs=outputs, states=begin.size, dt=loop.period)
    return made, begin


def played(voltage):
    plant.commit(voltage)
    return plant.displacement


compensator = dehyst.Compensator(actuator, period=1e-3, state=actuator.relaxed(), warns=False)
plant = dehyst.Compensator(aged, (-1000, 1000), period=1e-3, state=aged.relaxed())
inverse, inverse_start = block(compensator, "wanted", "voltage", compensator.step)
stage, stage_start = block(plant, "voltage", "displacement", played)

# %%
# The integral adds the error to the input of the compensator, one sample late.
time = 1e-3 * np.arange(600)
setpoint = 4e-6 * (1 - np.cos(2 * np.pi * 5 * time))
error = control.summing_junction(["setpoint", "-displacement"], "error")
total = control.summing_junction(["setpoint", "correction"], "wanted")
figure, axes = plt.subplots()
for gain, label in ((0.0, "compensator alone"), (0.05, "with an integral")):
    integral = control.ss(1, gain, 1, 0, 1e-3, inputs="error", outputs="correction")
    loop = control.interconnect([integral, inverse, stage, error, total], inputs="setpoint", outputs="displacement")
    answer = control.input_output_response(loop, time, setpoint, [[0.0], inverse_start, stage_start])
    axes.plot(1e3 * time, 1e9 * (answer.outputs - setpoint), label=label)
axes.set(xlabel="time (ms)", ylabel="error (nm)")
axes.legend()
plt.show()

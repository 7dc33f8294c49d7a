"""A simulated rig that warms up, and records its temperature."""

from dehyst.instruments.simulated import SimulatedRig
from truths.ageing import AgeingActuator


class WarmRig(SimulatedRig):
    """It is built around an ageing actuator."""

    def __init__(self, truth: AgeingActuator, **options):
        super().__init__(truth, **options)
        self.truth, self.others = truth, ("temperature_C",)

    def _wave(self, voltage, rate):
        for samples in super()._wave(voltage, rate):
            yield samples._replace(others={"temperature_C": self.truth.temperature(samples.time)})

"""Studies on virtual actuators: the demo, and the experiment of the paper."""

from dehyst.studies import demo

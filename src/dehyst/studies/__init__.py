"""Studies: the demo and the paper, done again with virtual actuators."""

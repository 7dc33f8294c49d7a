"""Identify actuators of other mechanisms from records of other kinds, and track paths with the models.

Truths by mechanisms that no model has (`strangers/truths.py`), protocols, disturbances: each case is identified by
dehyst (structure selected, and the paper's), by published rivals and by a constant ratio; each compensates a path that
is in no record, and the truth is played with the voltage. Also scored: the claimed error, parts that the truth lacks,
and failures without a warning. Writes `strangers.json`.

    python benchmarks/strangers.py [--cases N] [--seed S] [--jobs J] [--only TRUTH/PROTOCOL/DISTURBANCE ...]
"""

import os

# These variables must be set before NumPy loads its BLAS, also in every child process.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from strangers.command import main

if __name__ == "__main__":
    main()

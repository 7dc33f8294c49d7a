"""Random lives through every way by which a voltage leaves: see `tests/support/ways_out.py`, which plays them."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

import sanitized

sanitized.lay_over()

import batches
from ways_out import play

if __name__ == "__main__":
    batches.main(play)

"""Results of the benchmarks, and the cells and tables in which pages show them."""

import json
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LINEAR = "linear ratio"
OURS = ("dehyst", "dehyst, paper's", "dehyst, told the voltage only")
Row = Sequence[str]


@cache
def data(name: str) -> dict:
    """Return the results of a benchmark."""
    return json.loads((ROOT / "benchmarks" / f"{name}.json").read_text())


def table(head: Row, rows: Iterable[Row]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def both(error: dict | None) -> str:
    """Largest and RMS error."""
    return "-" if error is None else f"{error['largest_percent']:.2f}, {error['rms_percent']:.3f}"


def worst(row: dict | None) -> dict | None:
    """Errors of the seed with the largest error."""
    tracked = [] if row is None else row["tracking"].values()
    return max(tracked, key=lambda error: (error["largest_percent"], error["rms_percent"]), default=None)


def held_out(row: dict | None) -> dict | None:
    errors = [] if row is None else [error for error in row["errors"] if error["role"] == "validation"]
    return errors[0] if errors else None

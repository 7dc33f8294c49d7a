"""Fleets: thousands of records identified at once, one table of the results, and what it shows."""

from dehyst.fleet.dataset import Dataset, open_dataset
from dehyst.fleet.drift import Drifts, drifts_of
from dehyst.fleet.findings import findings_of
from dehyst.fleet.run import identify_fleet
from dehyst.fleet.table import Fleet, load
from dehyst.fleet.task import FleetOptions

__all__ = [
    "Dataset",
    "Fleet",
    "drifts_of",
    "findings_of",
    "identify_fleet",
    "load",
    "open_dataset",
]

"""Records: measurements of an actuator, and their files."""

from dehyst.records.cleaning import cleaned
from dehyst.records.columns import Columns
from dehyst.records.events import thinned
from dehyst.records.files import read, read_table, table_of, write_columns, write_record
from dehyst.records.formats.column import impossible
from dehyst.records.formats.loaders import GCS_END, GCS_SEPARATORS, LOADERS, gcs_entries
from dehyst.records.quality import guesses
from dehyst.records.record import Record, of_one_axis, reversals
from dehyst.records.recording import Recording, about_of
from dehyst.records.signals import (
    NOISE_PEAK,
    bandwidth,
    beyond_noise,
    counting,
    gaps,
    interpolate,
    largest,
    noise_span,
    percent,
    recorded_slew_rate,
    resolution,
    rms,
    turning_points,
    usable,
    white_noise,
)
from dehyst.records.tables import Table

__all__ = ["Columns", "Record", "read", "write_record"]

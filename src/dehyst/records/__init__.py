"""Records: measurements of an actuator, and their files."""

from dehyst.records.files import read, read_table, write_columns, write_hdf5, write_record
from dehyst.records.record import Record
from dehyst.records.recording import Recording

__all__ = ["Record", "Recording", "read", "read_table", "write_columns", "write_hdf5", "write_record"]

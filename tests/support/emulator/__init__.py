"""Emulated controllers: a virtual bench (`dehyst.virtual.bench`) behind the protocols of laboratories."""

from emulator.faults import Fault, Rehearsal
from emulator.gcs_controller import Controller
from emulator.gcs_server import Server

__all__ = ["Controller", "Fault", "Rehearsal", "Server"]

"""Emulated controllers: a virtual bench (`dehyst.virtual.bench`) behind the protocols of laboratories."""

from dehyst.virtual.emulator.faults import Fault, Rehearsal
from dehyst.virtual.emulator.gcs_controller import Controller
from dehyst.virtual.emulator.gcs_server import Server

__all__ = [
    "Controller",
    "Fault",
    "Rehearsal",
    "Server",
]

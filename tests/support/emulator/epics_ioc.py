"""A real EPICS input/output controller around a virtual instrument: process variables that any client can use."""

import asyncio
import os
from contextlib import suppress

from dehyst._errors import DehystError

# Seconds between two updates from the instrument; a command also updates.
_TICK = 0.05
_MICRO = 1e6
# Characters of a text, including the terminating null.
_TEXT = 256
# By default only this host is served; variables that are set already take precedence.
_LOOPBACK = {
    "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
}

READINGS = {"VOLTAGE:RBV": "V", "POSITION": "um"}
_running = []


class Ioc:
    """The variables VOLTAGE, VOLTAGE:RBV [V], POSITION [um] and IDN of an `instrument`; `serve_ioc` makes them.

    A put with callback returns when the command is done and the read-only variables, which are output records that are
    set at once, are updated. `lock` is held while the instrument is used.
    """

    def __init__(self, instrument, lock, builder):
        self._instrument, self._lock = instrument, lock
        axis, identity = instrument.axis, f"dehyst virtual controller {instrument.serial}"
        low, high = axis.limits
        # A command that is put twice is done twice, and its callback comes when it is done.
        command = {"on_update": self._put, "always_update": True, "blocking": True, "initial_value": axis.voltage}
        self._voltage = builder.aOut("VOLTAGE", EGU="V", PREC=4, DRVL=low, DRVH=high, **command)
        self._readings = [builder.aOut(name, EGU=unit, PREC=5, DISP=1) for name, unit in READINGS.items()]
        builder.longStringOut("IDN", length=_TEXT, initial_value=identity, DISP=1)
        self._refresh()

    async def serve(self):
        """Update the records from the instrument, without end."""
        while True:
            self._refresh()
            await asyncio.sleep(_TICK)

    def _put(self, voltage):
        """Put out a voltage, or keep the present one if it is refused; update the records."""
        taken, axis = False, self._instrument.axis
        with self._lock, suppress(DehystError):
            taken = axis.set_voltage(voltage)
        if not taken:
            self._voltage.set(axis.voltage, process=False)
        self._refresh()

    def _refresh(self):
        """Read the instrument into the records."""
        with self._lock:
            axis = self._instrument.axis
            values = axis.voltage, _MICRO * axis.displacement()
        for record, value in zip(self._readings, values, strict=True):
            record.set(value)


def serve_ioc(instrument, prefix, lock):
    """Serve an `instrument` by EPICS Channel Access, in threads of its own, until the process ends.

    It listens on the loopback interface only, unless EPICS_CAS_INTF_ADDR_LIST is set, and on the port of
    EPICS_CAS_SERVER_PORT. `prefix`: of the names of all process variables, without the colon that follows it. `lock`:
    held around every use of the instrument. EPICS allows one in a process.
    """
    for name, value in _LOOPBACK.items():
        os.environ.setdefault(name, value)
    from softioc import asyncio_dispatcher, builder, softioc

    builder.SetDeviceName(prefix)
    ioc = Ioc(instrument, lock, builder)
    _running.append(ioc)
    builder.LoadDatabase()
    dispatcher = asyncio_dispatcher.AsyncioDispatcher()
    softioc.iocInit(dispatcher, enable_pva=False)
    asyncio.run_coroutine_threadsafe(ioc.serve(), dispatcher.loop)
    return ioc

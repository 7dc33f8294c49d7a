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

_running = []


class Ioc:
    """The process variables of one `instrument`, all with one `prefix`; `serve_ioc` makes them.

    =========================== =================================================================================
    VOLTAGE, VOLTAGE:RBV        requested and present voltage [V]
    POSITION                    the sensor's reading [um]
    IDN                         text
    =========================== =================================================================================

    A put with callback returns when the command is done and all read-only variables are updated after it. `lock` is
    held while it is used.
    """

    def __init__(self, instrument, prefix, lock):
        self.prefix = prefix
        self._instrument, self._lock = instrument, lock
        self._records = {}

    def build(self, builder):
        """Create the records with softioc's `builder`.

        Read-only variables are output records, which are set at once and not at the next scan.
        """
        bench, axis = self._instrument, self._instrument.axis
        low, high = axis.limits

        def add(make, name, unit="", digits=0, **options):
            self._records[name] = make(name, **({"EGU": unit, "PREC": digits} if unit else {}), **options)

        builder.SetDeviceName(self.prefix)
        # A command that is put twice is done twice, and its callback comes when it is done.
        command = {"always_update": True, "blocking": True}
        handled = {"on_update": self._put, **command}
        add(builder.aOut, "VOLTAGE", "V", 4, DRVL=low, DRVH=high, initial_value=axis.voltage, **handled)
        for name, unit, digits, value in (
            ("VOLTAGE:RBV", "V", 4, axis.voltage),
            ("POSITION", "um", 5, _MICRO * axis.displacement()),
        ):
            add(builder.aOut, name, unit, digits, initial_value=value, DISP=1)
        identity = f"dehyst 0.1.0 virtual controller {bench.serial}"
        add(builder.longStringOut, "IDN", length=_TEXT, initial_value=identity, DISP=1)
        builder.LoadDatabase()

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
            self._records["VOLTAGE"].set(axis.voltage, process=False)
        self._refresh()

    def _refresh(self):
        """Read the instrument into the records."""
        with self._lock:
            axis = self._instrument.axis
            values = axis.voltage, _MICRO * axis.displacement()
        for name, value in zip(("VOLTAGE:RBV", "POSITION"), values, strict=True):
            self._records[name].set(value)


def serve_ioc(instrument, prefix, lock):
    """Serve an `instrument` by EPICS Channel Access, in threads of its own, until the process ends.

    It listens on the loopback interface only, unless EPICS_CAS_INTF_ADDR_LIST is set, and on the port of
    EPICS_CAS_SERVER_PORT. `prefix`: of the names of all process variables, without the colon that follows it. `lock`:
    held around every use of the instrument. EPICS allows one in a process.
    """
    for name, value in _LOOPBACK.items():
        os.environ.setdefault(name, value)
    from softioc import asyncio_dispatcher, builder, softioc

    ioc = Ioc(instrument, prefix, lock)
    _running.append(ioc)
    dispatcher = asyncio_dispatcher.AsyncioDispatcher()
    ioc.build(builder)
    softioc.iocInit(dispatcher, enable_pva=False)
    asyncio.run_coroutine_threadsafe(ioc.serve(), dispatcher.loop)
    return ioc

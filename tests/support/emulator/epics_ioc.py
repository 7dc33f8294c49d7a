"""A real EPICS input/output controller around a virtual instrument: process variables that any client can use."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from dehyst._errors import DehystError, RigError
from dehyst._types import Array
from dehyst.virtual.bench import VirtualBench

# Seconds between two updates from the instrument; a command also updates.
_TICK = 0.05
_MICRO = 1e6
# Characters of a text, including the terminating null.
_TEXT = 256
# Characters that a prefix may contain beside letters and digits, and its greatest length.
_SIGNS, _PREFIX = "_-:[]<>;", 40
# By default only this host is served; variables that are set already take precedence.
_LOOPBACK = {
    "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
}

_running: list[Ioc] = []


class Ioc:
    """The process variables of one `instrument`, all with one `prefix`; `serve_ioc` makes them.

    =========================== =================================================================================
    VOLTAGE, VOLTAGE:RBV        requested and present voltage [V]
    POSITION, TIME              the sensor's reading [um], and the device's time [s]
    IDN, ERROR                  text; the last error stays until it is overwritten
    LIMIT:LOW, LIMIT:HIGH, SLEW limits of the amplifier [V, V, V/s]; a slew rate of 0 means no limit
    WAVE:VOLTAGE, WAVE:PERIOD   wave [V] and seconds a sample, rounded to whole servo periods
    WAVE:START, STOP, BUSY      a 1 starts and stops; 1 while it is played
    REC:COUNT                   samples recorded of the present or last wave
    REC:TIME, VOLTAGE, POSITION the samples [s, V, um]
    =========================== =================================================================================

    A put with callback returns when the command is done and all read-only variables are updated after it. `lock` is
    held while it is used.
    """

    def __init__(self, instrument: VirtualBench, prefix: str, lock: AbstractContextManager[Any]) -> None:
        self.prefix = prefix
        self._instrument, self._lock = instrument, lock
        self._shown, self._playing = -1, False
        self._records: dict[str, Any] = {}

    def build(self, builder: Any) -> None:
        """Create the records with softioc's `builder`.

        Read-only variables are output records, which are set at once and not at the next scan.
        """
        bench, axis = self._instrument, self._instrument.axis
        low, high = axis.limits

        def add(make: Any, name: str, unit: str = "", digits: int = 0, **options: Any) -> None:
            self._records[name] = make(name, **({"EGU": unit, "PREC": digits} if unit else {}), **options)

        builder.SetDeviceName(self.prefix)
        # A command that is put twice is done twice, and its callback comes when it is done.
        command = {"always_update": True, "blocking": True}
        handled = {"on_update": self._handler(self._set_voltage), **command}
        add(builder.aOut, "VOLTAGE", "V", 4, DRVL=low, DRVH=high, initial_value=axis.voltage, **handled)
        add(builder.WaveformOut, "WAVE:VOLTAGE", "V", 4, length=bench.wave_points, datatype=float)
        handled = {"on_update": self._handler(self._set_period), **command}
        add(builder.aOut, "WAVE:PERIOD", "s", 6, initial_value=100 * bench.servo_period, **handled)
        for name, act in (("WAVE:START", self._start), ("WAVE:STOP", self._stop)):
            add(builder.Action, name, on_update=self._handler(act), blocking=True)
        for name, unit, digits, value in (
            ("VOLTAGE:RBV", "V", 4, axis.voltage),
            ("POSITION", "um", 5, _MICRO * axis.displacement()),
            ("TIME", "s", 4, 0.0),
            ("LIMIT:LOW", "V", 4, low),
            ("LIMIT:HIGH", "V", 4, high),
            ("SLEW", "V/s", 4, bench.slew_rate or 0.0),
        ):
            add(builder.aOut, name, unit, digits, initial_value=value, DISP=1)
        for name, unit, digits in (("REC:TIME", "s", 4), ("REC:VOLTAGE", "V", 4), ("REC:POSITION", "um", 5)):
            add(builder.WaveformOut, name, unit, digits, length=bench.record_points, datatype=float, DISP=1)
        add(builder.longOut, "REC:COUNT", initial_value=0, DISP=1)
        add(builder.boolOut, "WAVE:BUSY", ZNAM="idle", ONAM="playing", initial_value=0, DISP=1)
        identity = f"dehyst 0.1.0 virtual controller {bench.serial}"
        add(builder.longStringOut, "IDN", length=_TEXT, initial_value=identity, DISP=1)
        add(builder.longStringOut, "ERROR", length=_TEXT, initial_value="")
        builder.LoadDatabase()

    async def serve(self) -> None:
        """Update the records from the instrument, without end."""
        while True:
            self._refresh()
            await asyncio.sleep(_TICK)

    def _handler(self, act: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return the handler of a put: it acts, latches an error, and updates the records."""

        def update(value: Any) -> None:
            try:
                with self._lock:
                    act(value)
            except DehystError as error:
                self._records["ERROR"].set(str(error)[: _TEXT - 1].encode()[: _TEXT - 1].decode(errors="ignore"))
            finally:
                self._refresh()

        return update

    def _set_voltage(self, voltage: float) -> None:
        accepted = False
        try:
            accepted = self._instrument.axis.set_voltage(voltage)
        finally:
            if not accepted:
                self._show("VOLTAGE", self._instrument.axis.voltage)
        if not accepted:
            raise RigError(f"VOLTAGE: got {voltage:.6g} V, which is outside the amplifier's range; nothing was sent")

    def _set_period(self, period: float) -> None:
        servo = self._instrument.servo_period
        valid = math.isfinite(period) and period > 0
        self._show("WAVE:PERIOD", max(1, round(period / servo)) * servo if valid else servo)
        if not valid:
            raise RigError(f"WAVE:PERIOD: got {period} s, need a positive number of seconds")

    def _start(self, value: int) -> None:
        # A put that is no number fails, but the record is still processed with its old value.
        self._show("WAVE:START", 0)
        if value:
            wave: Array = self._records["WAVE:VOLTAGE"].get()
            periods = round(self._records["WAVE:PERIOD"].get() / self._instrument.servo_period)
            self._shown = -1
            self._instrument.start(wave, max(1, periods))
            self._playing = True

    def _stop(self, value: int) -> None:
        self._show("WAVE:STOP", 0)
        if value:
            self._instrument.stop()

    def _show(self, name: str, value: Any) -> None:
        """Put a value into a record without the handler of a client's put."""
        self._records[name].set(value, process=False)

    def _refresh(self) -> None:
        """Read the instrument into the records: samples before their count, the time last."""
        with self._lock:
            bench = self._instrument
            axis = bench.axis
            now, voltage, position = bench.now, axis.voltage, axis.displacement()
            busy, recorded = bench.playing, bench.recorded
            rows = bench.samples(0, recorded) if recorded != self._shown else None
        if rows is not None:
            self._shown = recorded
            if not recorded:
                self._records["REC:COUNT"].set(0)
            for name, values in zip(("REC:TIME", "REC:VOLTAGE"), rows, strict=False):
                self._records[name].set(values)
            self._records["REC:POSITION"].set(_MICRO * rows[2])
            self._records["REC:COUNT"].set(recorded)
        if self._playing and not busy:
            self._playing = False
            # The voltage requested before the wave no longer applies: processed again, it would make a jump.
            self._show("VOLTAGE", voltage)
        self._records["VOLTAGE:RBV"].set(voltage)
        self._records["POSITION"].set(_MICRO * position)
        self._records["WAVE:BUSY"].set(busy)
        self._records["TIME"].set(now)


def serve_ioc(instrument: VirtualBench, prefix: str, lock: AbstractContextManager[Any]) -> Ioc:
    """Serve an `instrument` by EPICS Channel Access, in threads of its own, until the process ends.

    It listens on the loopback interface only, unless EPICS_CAS_INTF_ADDR_LIST is set, and on the port of
    EPICS_CAS_SERVER_PORT. `prefix`: of the names of all process variables, without the colon that follows it. `lock`:
    held around every use of the instrument. Raise `RigError` if this process already serves an instrument, or the
    prefix cannot begin a name.
    """
    if _running:
        raise RigError(
            f"{prefix}: this process serves {_running[0].prefix} already, and EPICS allows one; start another"
        )
    if not prefix or len(prefix) > _PREFIX or not all(c.isascii() and (c.isalnum() or c in _SIGNS) for c in prefix):
        raise RigError(
            f"prefix: got {prefix!r}, need 1 to {_PREFIX} letters, digits or any of {_SIGNS}, as in BENCH:PIEZO"
        )
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

"""A real EPICS input/output controller around a virtual instrument: process variables that any client can use."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from dehyst._errors import DehystError, MissingExtraError, RigError
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.virtual.bench import VirtualBench

# Seconds between two looks at the instrument, unless a command looks at it before.
_TICK = 0.05
_MICRO = 1e6
# Characters of a text, its end among them.
_TEXT = 256
# What names may have in them, and how long what is put before ours may be.
_SIGNS, _PREFIX = "_-:[]<>;", 40
# One host serves itself, until its user says otherwise by the same names.
_LOOPBACK = {
    "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
    "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
}

_running: list[Ioc] = []


class Ioc:
    """The process variables of one instrument, all of them below a prefix; made by `serve_ioc`.

    =========================== =================================================================================
    VOLTAGE, VOLTAGE:RBV        asked for and put out [V]
    POSITION, TIME              what the sensor reads [um], and the device's time [s]
    IDN, ERROR                  text; the last error stays until it is overwritten
    LIMIT:LOW, LIMIT:HIGH, SLEW what the amplifier allows [V, V, V/s]; a slew rate of 0 is none
    WAVE:VOLTAGE, WAVE:PERIOD   wave [V] and seconds a sample, rounded to whole servo periods
    WAVE:START, STOP, BUSY      a 1 starts and stops; 1 while it is played
    REC:COUNT                   samples recorded of the present or last wave
    REC:TIME, VOLTAGE, POSITION the samples [s, V, um]
    =========================== =================================================================================

    A put with callback comes back when the command is done and all read-only variables are of the time after it.
    """

    def __init__(self, instrument: VirtualBench, prefix: str, lock: AbstractContextManager[Any]) -> None:
        self.prefix = prefix
        self._instrument, self._lock = instrument, lock
        self._shown, self._played = -1, False
        self._records: dict[str, Any] = {}

    def build(self, builder: Any) -> None:
        """Make the records."""
        builder.SetDeviceName(self.prefix)
        self._settable(builder)
        self._readable(builder)
        self._texts(builder)
        builder.LoadDatabase()

    async def serve(self) -> None:
        """Show what the instrument does, for ever."""
        while True:
            self._refresh()
            await asyncio.sleep(_TICK)

    def _settable(self, builder: Any) -> None:
        bench, (low, high) = self._instrument, self._instrument.limits
        # A command given twice is two commands, and its callback comes when it is done.
        command = {"always_update": True, "blocking": True}
        voltage = {"EGU": "V", "PREC": 4}
        self._records |= {
            "VOLTAGE": builder.aOut(
                "VOLTAGE",
                low,
                high,
                **voltage,
                initial_value=bench.voltage,
                on_update=self._does(self._set_voltage),
                **command,
            ),
            "WAVE:VOLTAGE": builder.WaveformOut("WAVE:VOLTAGE", length=bench.wave_points, datatype=float, **voltage),
            "WAVE:PERIOD": builder.aOut(
                "WAVE:PERIOD",
                EGU="s",
                PREC=6,
                initial_value=100 * bench.servo_period,
                on_update=self._does(self._set_period),
                **command,
            ),
            "WAVE:START": builder.Action("WAVE:START", on_update=self._does(self._start), blocking=True),
            "WAVE:STOP": builder.Action("WAVE:STOP", on_update=self._does(self._stop), blocking=True),
        }

    def _readable(self, builder: Any) -> None:
        """Records of the kind for output, which are set at once, not at the next scan; clients cannot write them."""
        bench, fixed = self._instrument, {"DISP": 1}
        for name, unit, digits, value in (
            ("VOLTAGE:RBV", "V", 4, bench.voltage),
            ("POSITION", "um", 5, _MICRO * bench.displacement()),
            ("TIME", "s", 4, 0.0),
            ("LIMIT:LOW", "V", 4, bench.limits[0]),
            ("LIMIT:HIGH", "V", 4, bench.limits[1]),
            ("SLEW", "V/s", 4, bench.slew_rate or 0.0),
        ):
            self._records[name] = builder.aOut(name, EGU=unit, PREC=digits, initial_value=value, **fixed)
        for name, unit, digits in (("REC:TIME", "s", 4), ("REC:VOLTAGE", "V", 4), ("REC:POSITION", "um", 5)):
            self._records[name] = builder.WaveformOut(
                name, length=bench.record_points, datatype=float, EGU=unit, PREC=digits, **fixed
            )
        self._records["REC:COUNT"] = builder.longOut("REC:COUNT", initial_value=0, **fixed)
        self._records["WAVE:BUSY"] = builder.boolOut("WAVE:BUSY", ZNAM="idle", ONAM="playing", initial_value=0, **fixed)

    def _texts(self, builder: Any) -> None:
        said = f"dehyst {__version__} virtual controller {self._instrument.serial}"
        self._records["IDN"] = builder.longStringOut("IDN", length=_TEXT, initial_value=said, DISP=1)
        self._records["ERROR"] = builder.longStringOut("ERROR", length=_TEXT, initial_value="")

    def _does(self, act: Callable[[Any], None]) -> Callable[[Any], None]:
        """What a put leads to: an act, its error latched, and a look at what came of it."""

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
        try:
            sent = self._instrument.set_voltage(voltage)
        except DehystError:
            self._show("VOLTAGE", self._instrument.voltage)
            raise
        if not sent:
            self._show("VOLTAGE", self._instrument.voltage)
            raise RigError(f"VOLTAGE: got {voltage:.6g} V, which is out of the amplifier's range; nothing was sent")

    def _set_period(self, period: float) -> None:
        servo = self._instrument.servo_period
        if not (math.isfinite(period) and period > 0):
            self._show("WAVE:PERIOD", servo)
            raise RigError(f"WAVE:PERIOD: got {period} s, need a positive number of seconds")
        self._show("WAVE:PERIOD", max(1, round(period / servo)) * servo)

    def _start(self, asked: int) -> None:
        # A put that is no number fails, but has the record processed at its old value all the same.
        self._show("WAVE:START", 0)
        if asked:
            wave: Array = self._records["WAVE:VOLTAGE"].get()
            periods = round(self._records["WAVE:PERIOD"].get() / self._instrument.servo_period)
            self._shown = -1
            self._instrument.start(wave, max(1, periods))
            self._played = True

    def _stop(self, asked: int) -> None:
        self._show("WAVE:STOP", 0)
        if asked:
            self._instrument.stop()

    def _show(self, name: str, value: Any) -> None:
        """Put a value into a record without doing what a client's put does."""
        self._records[name].set(value, process=False)

    def _refresh(self) -> None:
        """Read the instrument into the records: samples before their count, the time last."""
        with self._lock:
            bench = self._instrument
            bench.advance()
            now, voltage, position = bench.now, bench.voltage, bench.displacement()
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
        if self._played and not busy:
            self._played = False
            # What was asked for before the wave is over: processed once more, it would be a jump.
            self._show("VOLTAGE", voltage)
        self._records["VOLTAGE:RBV"].set(voltage)
        self._records["POSITION"].set(_MICRO * position)
        self._records["WAVE:BUSY"].set(busy)
        self._records["TIME"].set(now)


def serve_ioc(instrument: VirtualBench, prefix: str, lock: AbstractContextManager[Any]) -> Ioc:
    """Serve an instrument by EPICS Channel Access, in threads of its own, until the process ends.

    It listens on the loopback interface only, unless EPICS_CAS_INTF_ADDR_LIST says otherwise; on the port of
    EPICS_CAS_SERVER_PORT.

    Parameters
    ----------
    instrument : VirtualBench
    prefix : str
        Of the names of all process variables, without the colon that follows it.
    lock : context manager
        Held around every use of the instrument.

    Returns
    -------
    Ioc
        Served already.

    Raises
    ------
    MissingExtraError
        If softioc is not installed.
    RigError
        If there is one in this process already, or the prefix cannot begin a name.
    """
    _refuse(prefix)
    for name, value in _LOOPBACK.items():
        os.environ.setdefault(name, value)
    try:
        from softioc import asyncio_dispatcher, builder, softioc
    except ImportError as error:
        raise MissingExtraError.of("softioc", "epics", "an EPICS server") from error
    ioc = Ioc(instrument, prefix, lock)
    _running.append(ioc)
    dispatcher = asyncio_dispatcher.AsyncioDispatcher()
    ioc.build(builder)
    softioc.iocInit(dispatcher, enable_pva=False)
    asyncio.run_coroutine_threadsafe(ioc.serve(), dispatcher.loop)
    return ioc


def _refuse(prefix: str) -> None:
    if _running:
        raise RigError(
            f"{prefix}: this process serves {_running[0].prefix} already, and EPICS allows one; start another"
        )
    if not prefix or len(prefix) > _PREFIX or not all(c.isascii() and (c.isalnum() or c in _SIGNS) for c in prefix):
        raise RigError(
            f"prefix: got {prefix!r}, need 1 to {_PREFIX} letters, digits or any of {_SIGNS}, as in BENCH:PIEZO"
        )

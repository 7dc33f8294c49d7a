"""A controller and a connected device of our own making, around a virtual bench: for odd controllers and for faults."""

from dehyst.virtual import PlayActuator, VirtualBench

IDENTITY = "Fake Instruments, F-1.CD, 0001, 1.0"
WAVES = ["WAV", "WAV?", "WSL", "WGC", "WTR", "WGO", "WGO?", "DRC", "DRL?", "DRR?", "RTR", "DRT", "SPA?", "TNR?", "HDR?"]
ASKING = ["*IDN?", "HLP?", "CSV?", "SAI?", "SVO", "SVO?", "VMI?", "VMA?", "POS?", "VOL?", "SVA", "ERR?", "TIM?"]


class Clock:
    """Time that only moves when it is told to."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


class FakeController:
    """Answers lines of one axis `1`; `told` replaces what it answers to a query's first word, None by silence."""

    def __init__(self, *, limits=(-20.0, 120.0), clock=None, without=(), told=None, **options):
        options = {"record_points": 4096, "wave_points": 4096} | options
        self.clock = clock or Clock()
        self.bench = VirtualBench(PlayActuator(), limits=limits, clock=self.clock, **options)
        self.known = [word for word in ASKING + WAVES if word not in without]
        self.told = dict(told or {})
        self.error, self.divider, self.table, self.lines = 0, 1, [], []

    def answer(self, line):
        """Return the lines of an answer, or None."""
        self.lines.append(line)
        word, *arguments = line.split() or [""]
        if word in self.told:
            found = self.told[word]
            return found(arguments) if callable(found) else found
        if word not in self.known and word != "HLP?":
            self.error = 2
            return None
        name = "on_" + word.replace("?", "_asked").replace("*", "").lower()
        try:
            return getattr(self, name)(*arguments)
        except (TypeError, ValueError):
            self.error = 24
        except OSError:
            self.error = 5
        return None

    def on_idn_asked(self):
        return [IDENTITY]

    def on_hlp_asked(self):
        return ["The following commands are valid:", *(f"{word} does something" for word in self.known), "end of help"]

    def on_csv_asked(self):
        return ["2.0"]

    def on_sai_asked(self):
        return ["1"]

    def on_svo(self, axis, on):
        self.bench.axis.servo = on == "1"

    def on_svo_asked(self, axis):
        return [f"{axis}={int(self.bench.axis.servo)}"]

    def on_vmi_asked(self, channel):
        return [f"{channel}={self.bench.axis.limits[0]!r}"]

    def on_vma_asked(self, channel):
        return [f"{channel}={self.bench.axis.limits[1]!r}"]

    def on_pos_asked(self, axis):
        return [f"{axis}={1e6 * self.bench.axis.displacement()!r}"]

    def on_vol_asked(self, channel="1"):
        return [f"{channel}={self.bench.axis.voltage!r}"]

    def on_sva(self, axis, voltage):
        if not self.bench.axis.set_voltage(float(voltage)):
            self.error = 7

    def on_err_asked(self):
        number, self.error = self.error, 0
        return [str(number)]

    def on_tim_asked(self, timer="1"):
        return [f"{timer}={1e3 * self.bench.now!r}"]

    def on_wav(self, table, sign, kind, start, count, *points):
        if kind != "PNT" or int(start) != 1 or int(count) != len(points):
            raise ValueError
        self.table = ([] if sign == "X" else self.table) + [float(point) for point in points]

    def on_wav_asked(self, table, parameter):
        return [f"{table} {parameter}={len(self.table)}"]

    def on_wsl(self, channel, table):
        assert (channel, table) == ("1", "1")

    def on_wgc(self, channel, cycles):
        assert (channel, cycles) == ("1", "1")

    def on_wtr(self, channel, divider, interpolation):
        self.divider = int(divider)

    def on_wgo(self, channel, mode):
        if mode == "0":
            self.bench.stop()
        else:
            self.bench.start(self.table, self.divider)

    def on_wgo_asked(self, channel):
        return [f"{channel}={int(self.bench.playing)}"]

    def on_drc(self, table, source, option):
        assert (table, option) in {("1", "2"), ("2", "16")}

    def on_rtr(self, divider):
        assert int(divider) == self.divider

    def on_drt(self, *_):
        pass

    def on_drl_asked(self, *tables):
        self.bench.advance()
        return [f"{table}={self.bench.recorded}" for table in tables]

    def on_drr_asked(self, first, count, *tables):
        _, voltage, displacement = self.bench.samples(int(first) - 1, int(count))
        head = ["# REM fake", "# VERSION = 1", "# TYPE = 1", "# SEPARATOR = 32", "# DIM = 2"]
        head += [f"# SAMPLE_TIME = {self.divider * self.bench.servo_period!r}", f"# NDATA = {voltage.size}"]
        head += ["# NAME0 = Current Position of axis 1", "# NAME1 = Voltage of output chan 1", "# END_HEADER"]
        return head + [f"{1e6 * y!r} {v!r}" for y, v in zip(displacement.tolist(), voltage.tolist(), strict=True)]

    def on_spa_asked(self, item, parameter):
        known = {
            0x0E000200: self.bench.servo_period,
            0x13000004: self.bench.wave_points,
            0x16000200: 2 * self.bench.record_points,
        }
        return [f"{item} {parameter}={known[int(parameter, 16)]!r}"]

    def on_tnr_asked(self):
        return ["2"]

    def on_hdr_asked(self):
        return [
            "#RecordOptions",
            "1=Target Position of axis",
            "2=Current Position of axis",
            "7=Control Voltage of output chan",
            "16=Voltage of output chan",
            "#TriggerOptions",
            "0=default",
            "end of help",
        ]


def text_of(lines):
    """Return an answer as it goes over the wire."""
    return "" if lines is None else " \n".join(lines) + "\n"

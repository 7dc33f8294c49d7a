"""Serve an emulated piezo controller that speaks GCS 2.0 over TCP; at the end, print its output voltages."""

import argparse
import signal
import threading

from emulator import Controller, Fault, Rehearsal, Server
from emulator.epics_ioc import serve_ioc
from emulator.faults import actual_limits
from truths import VIRTUAL

from dehyst.virtual import VirtualBench


def serve(options):
    """Serve until SIGINT or SIGTERM."""
    faults = [Fault.parse(text) for text in options.fault]
    truth = VIRTUAL[options.actuator]()
    reported = tuple(options.limits or (0.0, truth.highest))
    bench = VirtualBench(truth, limits=actual_limits(reported, faults), speed=options.speed)
    lock, rehearsal = threading.Lock(), Rehearsal(faults, report=lambda words: print(f"fault: {words}", flush=True))
    controller = Controller(bench, reported_limits=reported)
    server = Server(controller, port=options.port, lock=lock, rehearsal=rehearsal)
    if options.epics:
        serve_ioc(bench, options.epics, lock)
        print(f"serving epics://{options.epics}", flush=True)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    low, high = reported
    print(f"serving {options.actuator}, {low:g} to {high:g} V, on pi://127.0.0.1:{server.port}", flush=True)
    server.serve()
    log = bench.axis.log
    refused = f", {log.refused} requests refused" if log.refused else ""
    print(
        f"put out {log.lowest:.6g} to {log.highest:.6g} V, largest step {log.largest_step:.4g} V, steepest "
        f"{log.steepest:.6g} V/s, now at {bench.axis.voltage:.6g} V{refused}, {controller.rows_sent} samples reported"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actuator", default="play", choices=VIRTUAL)
    parser.add_argument("--port", type=int, default=50000, help="0: any free port")
    parser.add_argument("--limits", type=float, nargs=2, help="voltages [V]")
    parser.add_argument("--speed", type=float, default=1.0, help="seconds of the instrument in one")
    parser.add_argument("--fault", action="append", default=[], help="NAME, NAME@SAMPLES or NAME@SECONDSs")
    parser.add_argument("--epics", help="serve by Channel Access too, with this prefix")
    serve(parser.parse_args())

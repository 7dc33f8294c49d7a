"""The ways to lose page, server, network or driver while a wave plays; writes `workbench_rehearsal.json`.

Names on the command line select some of them; then nothing is written. `stops 200`: that many times two connects at
once and two emergency stops instead; writes `workbench_stops.json`.
"""

import json
import platform
import re
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

from observed_rig import LIMITS, SLEW
from page_ways import PAGE_WAYS, rehearse_page
from rig_ways import WAYS, Outcome, Way, rehearse
from stop_ways import rehearse_stops

from dehyst._io import write_atomically

HERE = Path(__file__).resolve().parent
# Digits of a number.
_DIGITS = 3


def kept(outcome: Outcome, way: Way) -> bool:
    """Whether the voltage stayed within limits and slew rate, and is safe in time with all samples on disk."""
    within = LIMITS[0] <= outcome.lowest_volts <= outcome.highest_volts <= LIMITS[1]
    within &= outcome.steepest_volts_a_second <= way.slew
    within &= 0 <= outcome.delivered - outcome.on_disk <= way.in_flight
    in_time = outcome.safe_seconds is not None and outcome.safe_seconds <= outcome.allowed_seconds
    return within and (in_time if way.safe else outcome.status == "lost")


def as_dict(way: Way, outcome: Outcome, folder: str) -> dict:
    """Return the JSON values of one way, without names of folders and ports."""
    values = {
        key: round(value, _DIGITS) if isinstance(value, float) else value for key, value in asdict(outcome).items()
    }
    for key in ("words", "errors"):
        values[key] = [
            re.sub(r"(127\.0\.0\.1:)\d+", r"\g<1>50000", one.replace(f"{folder}/", "")) for one in values[key]
        ]
        values[key] = [re.sub(r"and \d+ its port", "and 50000 its port", one) for one in values[key]]
    return {"words": way.words, "slew_V_per_s": way.slew, "kept": kept(outcome, way), "observed": values}


def line(way: Way, outcome: Outcome) -> str:
    safe = "not reached" if outcome.safe_seconds is None else f"{outcome.safe_seconds:.2f} s"
    return (
        f"{way.name:17s} safe {safe} of {outcome.allowed_seconds:.1f} (late {outcome.late_seconds:.2f}), "
        f"{outcome.lowest_volts:.4g} to "
        f"{outcome.highest_volts:.4g} V, {outcome.steepest_volts_a_second:.4g} V/s, {outcome.delivered} delivered, "
        f"{outcome.on_disk} on disk, {outcome.status}{'' if kept(outcome, way) else '   <-- NOT KEPT'}"
    )


def pages() -> tuple[dict, float]:
    """Rehearse the ways with a real page; return their JSON values, and the most seconds until the voltage is safe."""
    plain, told, worst = Way("", "", lambda *_: None), {}, 0.0
    for way in PAGE_WAYS:
        with tempfile.TemporaryDirectory() as folder:
            outcome = rehearse_page(way, Path(folder))
        told[way.name] = as_dict(replace(plain, name=way.name, words=way.words), outcome, folder)
        print(line(replace(plain, name=way.name), outcome), flush=True)
        worst = max(worst, outcome.safe_seconds or float("inf"))
    return told, worst


def main() -> None:
    if sys.argv[1:2] == ["stops"]:
        summary = {"machine": platform.machine(), **rehearse_stops(int(sys.argv[2]))}
        write_atomically(HERE / "workbench_stops.json", (json.dumps(summary, indent=1) + "\n").encode())
        return
    chosen = [way for way in WAYS if len(sys.argv) == 1 or way.name in sys.argv[1:]]
    told = {}
    for way in chosen:
        with tempfile.TemporaryDirectory() as folder:
            outcome = rehearse(way, Path(folder))
        told[way.name] = as_dict(way, outcome, folder)
        print(line(way, outcome), flush=True)
    times = {way.name: told[way.name]["observed"]["safe_seconds"] for way in chosen if way.safe and not way.grace}
    worst = max(times, key=lambda name: times[name] or float("inf"), default=None)
    summary = {
        "machine": platform.machine(),
        "limits_V": LIMITS,
        "slew_V_per_s": SLEW,
        "ways": len(chosen),
        "kept": sum(one["kept"] for one in told.values()),
        "worst_way": worst,
        "worst_seconds_to_safe": times.get(worst),
    }
    print(json.dumps(summary))
    if len(chosen) == len(WAYS):
        with_page, worst_seconds = pages()
        summary["page_ways"], summary["page_kept"] = len(with_page), sum(one["kept"] for one in with_page.values())
        summary["page_worst_seconds_to_safe"] = round(worst_seconds, _DIGITS)
        told |= {f"browser: {name}": one for name, one in with_page.items()}
        write_atomically(
            HERE / "workbench_rehearsal.json", (json.dumps({**summary, "rehearsed": told}, indent=1) + "\n").encode()
        )


if __name__ == "__main__":
    main()

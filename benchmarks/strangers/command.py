"""The program: arguments, processes, the file of results and the table."""

from __future__ import annotations

import argparse
import json
import tempfile
import traceback
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from statistics import median
from typing import Any

from strangers.cases import Case, design, named
from strangers.scores import AUTO, LINEAR, PLAIN, RIGHT, RIVALS, score
from strangers.truths import TRUTHS

OUTPUT = Path(__file__).resolve().parents[1] / "strangers.json"


def arguments(given: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Identify strange actuators from strange records.")
    parser.add_argument("--cases", type=int, help="the first so many of the design; default: all")
    parser.add_argument("--only", action="append", metavar="TRUTH/PROTOCOL/DISTURBANCE", help="may be repeated")
    parser.add_argument("--seed", type=int, default=0, help="of the design and of every case; default: 0")
    parser.add_argument("--jobs", type=int, default=1, help="processes; default: 1")
    parser.add_argument("--output", type=Path, help="default: strangers.json beside the program, without --only")
    parser.add_argument("--table", action="store_true", help="only print the table of a file of results")
    return parser.parse_args(given)


def run(cases: Sequence[Case], jobs: int) -> Iterator[dict[str, Any]]:
    """Yield the results of cases as they come."""
    if jobs == 1:
        yield from (attempted(case.name, case.seed) for case in cases)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for done in as_completed([pool.submit(attempted, case.name, case.seed) for case in cases]):
            yield done.result()


def attempted(name: str, seed: int) -> dict[str, Any]:
    """Run one case; an error of the program that is no refusal is kept with the case."""
    case = named(name, seed)
    try:
        return score(case)
    except Exception:
        return {"case": case.name, "command": case.command, "crashed": traceback.format_exc()}


def main(given: Sequence[str] | None = None) -> None:
    """Run the cases asked for, keep each result at once, and print the table."""
    options = arguments(given)
    output = options.output or (None if options.only else OUTPUT)
    if options.table:
        print(table(json.loads((output or OUTPUT).read_text())["cases"]))
        return
    cases = [named(name, options.seed) for name in options.only or ()] or design(options.seed)[: options.cases]
    results = []
    with tempfile.NamedTemporaryFile("w", suffix=".jsonl", prefix="strangers-", delete=False) as kept:
        print(f"results as they come: {kept.name}")
        for found in run(cases, options.jobs):
            results.append(found)
            kept.write(json.dumps(found) + "\n")
            kept.flush()
            print(line(found, len(results), len(cases)), flush=True)
    order = {case.name: k for k, case in enumerate(cases)}
    results.sort(key=lambda found: order[found["case"]])
    print(table(results))
    if options.only:
        print(json.dumps(results, indent=1))
    if output is not None:
        output.write_text(written(options.seed, results))
    Path(kept.name).unlink(missing_ok=True)


def written(seed: int, results: list[dict[str, Any]]) -> str:
    """Return the file of results, a line a case, numbers to four digits."""
    lines = ",\n".join(json.dumps(_rounded(found)) for found in results)
    return f'{{"seed": {seed}, "cases": [\n{lines}\n]}}\n'


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def line(found: dict[str, Any], k: int, count: int) -> str:
    """Return one line on a case."""
    if "crashed" in found:
        return f"{k}/{count} {found['case']:<34} CRASHED {found['crashed'].splitlines()[-1]}"
    cells = [figures(found["methods"][name]) for name in (AUTO, PLAIN)]
    cells += [figures(best(found)[1]), f"{found['methods'][AUTO]['seconds']:6.1f} s"]
    cells += ["SILENT" if found["silent"] else "refused" if found["refused"] else ",".join(found["failures"])]
    return f"{k}/{count} {found['case']:<34}" + " ".join(cells) + " " + ",".join(found["false_parts"])


def figures(row: dict[str, Any] | None) -> str:
    """Return the largest and RMS error as a cell."""
    return f"{row['largest']:8.2f}{row['rms']:7.3f}" if row and "rms" in row else f"{'-':>15}"


def best(found: dict[str, Any], without: Iterable[str] = ()) -> tuple[str, dict[str, Any] | None]:
    """Return the rival with the least RMS error in a case."""
    rows = [(name, found["methods"][name]) for name in RIVALS if name not in without]
    rows = [(name, row) for name, row in rows if "rms" in row]
    return min(rows, key=lambda pair: pair[1]["rms"], default=("", None))


def share(flags: Sequence[bool]) -> str:
    """Return how many of them are true, in words."""
    return f"{sum(flags)} of {len(flags)} ({100 * sum(flags) / max(len(flags), 1):.0f} %)"


def table(results: list[dict[str, Any]]) -> str:
    """Return medians by truth and method, the shares of right claims and false parts, and the silent failures."""
    ran = [found for found in results if "crashed" not in found]
    scored = [found for found in ran if not found["refused"]]
    titles = (AUTO, PLAIN, "best rival", "of another class", LINEAR)
    lines = ["", "median of largest and RMS error, % of the stroke", f"{'':<12}" + "".join(f"{t:>18}" for t in titles)]
    for truth in [*TRUTHS, "all"]:
        group = [found for found in scored if truth in ("all", found["truth"])]
        lines += [f"{truth:<12}" + "".join(_cell(column) for column in _columns(group))] if group else []
    claims = [1 / RIGHT <= found["claim"] <= RIGHT for found in scored]
    optimistic = [found["claim"] > RIGHT for found in scored]
    seconds = sorted(found["methods"][AUTO]["seconds"] for found in ran)
    lines += [
        "",
        f"claimed RMS error within a factor of {RIGHT} of the tracking error: {share(claims)}; "
        f"too small: {share(optimistic)}",
        f"false parts: {share([bool(found['false_parts']) for found in scored])}",
        f"worse than plain by over 10 %: {share([found.get('worse', False) for found in scored])}, "
        f"of these without a warning: {sum(found.get('worse', False) and not found['named'] for found in scored)}",
        f"failures (over twice plain's or the claimed error): {share([bool(found['failures']) for found in scored])}, "
        f"silent: {sum(found['silent'] for found in scored)}",
        f"seconds of the processor for auto: median {median(seconds):.2f}, most {seconds[-1]:.1f}" if seconds else "",
    ]
    lines += [f"SILENT {_ratios(found)}: {found['command']}" for found in scored if found["silent"]]
    lines += [f"refused {found['case']}: {found['refused']}" for found in ran if found["refused"]]
    lines += [f"CRASHED {found['case']}: {found['crashed']}" for found in results if "crashed" in found]
    return "\n".join(lines)


def _columns(group: list[dict[str, Any]]) -> Iterator[list[dict[str, Any] | None]]:
    yield from ([found["methods"][name] for found in group] for name in (AUTO, PLAIN))
    yield [best(found)[1] for found in group]
    yield [best(found, TRUTHS[found["truth"]].own)[1] for found in group]
    yield [found["methods"][LINEAR] for found in group]


def _cell(rows: list[dict[str, Any] | None]) -> str:
    tracked = [row for row in rows if row and "rms" in row]
    if not tracked:
        return f"{'-':>18}"
    return f"{median(row['largest'] for row in tracked):10.2f}{median(row['rms'] for row in tracked):8.3f}"


def _ratios(found: dict[str, Any]) -> str:
    plain = "{:.2g} and {:.2g} times plain's".format(*found["to_plain"]) if "to_plain" in found else "plain failed"
    parts = f", with {' and '.join(found['false_parts'])}" if found["false_parts"] else ""
    return f"{plain}, {found['claim']:.2g} times the claimed{parts}"

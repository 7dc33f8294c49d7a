"""Put the figures of `fleet.json` into `docs/how_to/fleet.md`, between its markers.

With --check nothing is written; the exit status is 0 if the page contains them already.
"""

import json
import re
import sys
from pathlib import Path

from readme import fill

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "how_to" / "fleet.md"
BLOCK = re.compile(r"(<!-- figures: fleet -->\n).*?(<!-- end of figures -->)", re.DOTALL)
KILLS = {
    "killed_workers": "four workers, one after another",
    "killed_client": "the client, then `--resume`",
    "killed_scheduler": "the scheduler of `dask scheduler`, then another one and `--resume`",
}


def table(result: dict) -> str:
    """Return the figures as text."""
    return "\n".join([*findings(result), "", *kills(result), "", *costs(result), "", *paper(result)]) + "\n"


def findings(result: dict) -> list[str]:
    """Return the table of what is wrong with records, and what plain and automatic identification find."""
    plain, wide = result["found"], result["auto_found"]
    rows = [
        f"| {kind} | {plain['kinds'][kind]} | {words(plain)} | {words(wide)} |"
        for kind, words in {
            "dead": lambda one: f"{one['dead_refused_with_reason']} refused with a reason",
            "noisy": lambda one: f"{one['listed'].get('noisy', 0)} listed",
            "drifting": lambda one: f"{one['listed'].get('drifting', 0)} listed",
            "duplicate": lambda one: f"{one['duplicates_found']} found",
            "healthy": lambda one: f"{one['listed'].get('healthy', 0)} listed: {one['false_alarm_percent']:.2g} %",
        }.items()
    ]
    head = ["| of | number | found by `plain` | by `--structure auto` |", "| --- | --- | --- | --- |"]
    return [*head, *rows, "", *ageing(result)]


def ageing(result: dict) -> list[str]:
    """Return the table of what `dehyst fleet drift` wants to recalibrate."""
    rows = [
        f"| `{name}` | {one['ageing_found']} of {one['ageing_serials']} | "
        f"{one['healthy_to_recalibrate']} of {one['healthy_serials']} |"
        for name, one in (("plain", result["aged"]), ("auto", result["auto_aged"]))
    ]
    return ["| to recalibrate | serials that age | healthy serials |", "| --- | --- | --- |", *rows]


def kills(result: dict) -> list[str]:
    rows = [
        f"| {words} | {'each row once, and the same' if one['exactly_once'] else 'ROWS DIFFER'} |"
        for name, words in KILLS.items()
        if (one := result.get(name))
    ]
    if (one := result.get("rehearsal")) is not None:
        words = f"{len(one['faults'])} tables with a fault"
        rows.append(
            f"| {one['kills']} times at any moment, `--resume` on records that were added, removed or changed, with "
            f"names of any bytes; {one['double_starts']} double starts | {words} |"
        )
    return ["| killed (`kill -9`) | the table |", "| --- | --- |", *rows]


def costs(result: dict) -> list[str]:
    runs = {"processes": "processes", "auto": "processes, `--structure auto`"}
    rows = [
        f"| {words} | {one['records']} | {one['wall_s']:.0f} s | {one['task_cpu_s']['mean']:.2f} s | "
        f"{one['overhead_wall_percent']:.1f} % | {one['overhead_cpu_percent']:.1f} % | {one['worker_MB']:.0f} MB |"
        for name, words in runs.items()
        if (one := result.get(name))
    ]
    head = "| run | records | time | processor time a record | over the sum of tasks | in processor time | a worker |"
    return [head, "|" + " --- |" * 7, *rows]


def paper(result: dict) -> list[str]:
    one = result["paper"]
    return [
        "A million records, calculated from these figures:",
        "",
        f"- {one['plain_core_hours']:.0f} core hours (`plain`), {one['cores_for_a_day']:.1f} cores for a day; "
        f"{one['auto_core_hours']:.0f} core hours (`auto`);",
        f"- {one['dataset_GB']:.0f} GB of records in Parquet, {one['table_GB']:.1f} GB of table; "
        f"the index takes {60 * one['index_minutes']:.0f} s;",
        f"- it breaks first at the footer of a single Parquet file, which every worker holds: "
        f"{one['footer_memory_bytes_a_row_group'] / 1e3:.1f} kB of memory a row group, so about "
        f"{round(one['row_groups_a_file_at_most'], -4):,} records a file within 350 MB a worker. Split a larger "
        "dataset into a folder of Parquet files.",
    ]


if __name__ == "__main__":
    sys.exit(fill(PAGE, BLOCK, table(json.loads((HERE / "fleet.json").read_text()))))

"""Figures on the pages of `docs/how_to`."""

from page_tables import data, table


def learning() -> list[str]:
    """Errors of repetition and feedback, by plant; faulty sensors."""
    found = data("learning")
    head = ("what the stage has", "compensator alone", "repetition, cycle 3", "10", "30", "feedback, cycle 10")
    rows = []
    for name, row in found["plants"].items():
        alone, learnt, fed = (row[how]["rms"] for how in ("frozen", "repetition", "feedback"))
        rows.append([name, *(f"{x:.3f}" for x in (alone[9], learnt[2], learnt[9], learnt[-1], fed[-1]))])
    seen = [[row[how]["of_frozen"] for row in found["lies"].values()] for how in ("repeated", "fed_back")]
    return [
        *table(head, rows),
        "",
        f"{len(found['lies'])} faulty sensors on the stage with the resonance: one cycle after the fault is found, the "
        f"largest error is at most {max(seen[0]):.2f} times that of the compensator alone with a repetition, "
        f"{max(seen[1]):.2f} times with a feedback. At rest a feedback is stable on all {found['stable']['plants']} "
        "combinations of Q factors of 5 to 100, resonances of 1 to 20 kHz, loops of 5 to 20 kHz, and a reading each "
        "period or each seventh, in time or a period late. The resonance is known to 3 %.",
    ]


def temperature() -> list[str]:
    """Errors at temperatures that were held out."""
    keys = {
        "constant": "constant",
        **{f"{t} °C, promised": f"with, {t}" for t in (22, 38)},
        "55 °C, not tested, promised": "with, 55",
        "38 °C, not known, promised": "unknown, 38",
        "no channel: 22 °C": "without, 22",
        "38 °C": "without, 38",
        "promised": "promised without",
    }
    bounds = {"with, 22": "promised, 22", "with, 38": "promised, 38", "with, 55": "promised, 55"}
    bounds["unknown, 38"] = "promised unknown"

    def cell(row: dict[str, float], key: str) -> str:
        return f"{row[key]:.2f}" + (f", {row[bounds[key]]:.2f}" if key in bounds else "")

    rows = [[row["truth"], *(cell(row, key) for key in keys.values())] for row in data("temperature")["rows"]]
    return table(("", *keys), rows)


def updates() -> list[str]:
    """Errors of updated models over those of models identified anew: median and worst."""
    head = ("record", "largest, median", "worst", "RMS, median", "worst")
    aged = data("ageing")
    found = {kind: aged[f"update to anew, {kind}"] for kind in ("2 sines", "4 triangles", "excitation")}
    return [
        *table(head, ([kind, *(f"{row[k]:.2f}" for k in (0, 1) for row in pair)] for kind, pair in found.items())),
        "",
        f"`dehyst check` of {aged['truths']} aged stages: of {aged['stated']} changes stated, {len(aged['false'])} "
        f"were wrong by over twice their error; of {aged['over 2 %']} changes of over 2 % of the stroke, "
        f"{len(aged['missed'])} were missed.",
    ]


def coupled() -> list[str]:
    """Errors of stages of three axes."""
    found = data("coupled_axes")
    words = {
        "truths": "plays, Preisach, relays",
        "set aside": "others: Jiles-Atherton domains, Stribeck slip, relays",
        "with Bouc-Wen": "plays, Preisach, Bouc-Wen",
    }
    rows = []
    for name, title in words.items():
        most = found[name]["summary"]
        single = [max(row["single_axis_largest_percent"]) for row in found[name]["stages"]]
        errors = [most[key] for key in ("largest_percent", "rms_percent", "uncoupled_largest_percent")]
        cells = [f"{most['matrix_error']:.4f}", *(f"{error:.2f}" for error in errors)]
        rows.append([title, *cells, f"{min(single):.1f} to {max(single):.1f}"])
    head = ("mechanisms", "matrix within", "largest", "RMS", "the same axes uncoupled", "models of single axes")
    return [*table(head, rows), "", "The last column has the worst axis of each stage."]


def creep() -> list[str]:
    """Creep that is left in a hold, one number a seed."""
    words = {
        "LaggingSwitches": "relays whose domains switch late, by a continuum of delays",
        "RelaxingPreload": "plays against a preload of rubber that relaxes",
        "ThermalRelays": "relays that switch by thermal activation",
    }
    keys = "creep_percent_of_step", "left_percent"
    rows = []
    for truth, title in words.items():
        seeds = [row for row in data("creep")["rows"] if row["truth"] == truth]
        rows.append([title, *(", ".join(f"{row[key]:.0f}" for row in seeds) for key in keys)])
    return table(("actuator", "creep, % of the step", "left with the voltages of the model"), rows)


def firmware() -> list[str]:
    """Instructions of the steps of an exported compensator."""
    plain, wide = ((row["followed"], row["clamped"]) for row in data("size")["instructions"])
    return [
        "The time of a step is bounded for any past. Instructions of one step in floats (`-O2`, a Cortex-M4F "
        f"emulated by QEMU): {plain[0]} along a path and at most {plain[1]} when a clamped step crosses the whole "
        f"range, with ten plain elements; {wide[0]} and {wide[1]} with all parts.",
    ]

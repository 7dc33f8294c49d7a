"""Figures on the pages of `docs/how_to`."""

from page_tables import both, data, table


def loop() -> list[str]:
    """Followed in three ways: errors on lines and sines, bandwidth, disturbances."""
    found = data("loop")
    head = (
        *("", "lines at 5 Hz, largest, RMS error %", "sines of 0.7 to 17 Hz together, largest, RMS error %"),
        *("bandwidth, sines of 0.5 % of the stroke", "of 20 % of the stroke", "disturbances taken away up to"),
        "gain of the integral",
    )
    names = {"feedback": "integral feedback", "feedforward": "feedforward (dehyst)", "both": "both"}
    rows = []
    for kind, name in names.items():
        cells = [both(found["tracking"][path][kind]) for path in ("triangle", "tones")]
        cells += [bandwidth(found["bandwidth"][size][kind]) for size in ("small", "large")]
        away, gain = found["rejecting_to_Hz"][kind], found["integral"].get(kind)
        cells += [f"{away:.2g} Hz" if away else "none", "-" if gain is None else f"{gain['gain_per_s']:.0f} /s"]
        rows.append([name, *cells])
    model, true = found["identified"], found["stage"]
    alone, together = (pushed(found["larger_gains"][kind]) for kind in ("feedback", "both"))
    return [
        *table(head, rows),
        "",
        f"Identified: {model['resonance_Hz']:.1f} Hz ({true['resonance_Hz']:g}), damping {model['damping']:.4f} "
        f"({true['damping']:g}), delay {1e3 * model['delay_s']:.3f} ms ({1e3 * true['delay_s']:g}), steepest branch "
        f"{model['steepest']:.2f} times the mean slope; the path is known {model['samples_ahead']} samples ahead.",
        "",
        f"On the lines the integral alone swings with {alone[0]} that gain (best before: {alone[1]:.2f} %), both with "
        f"{together[0]} theirs (best before: {together[1]:.2f} %).",
    ]


def pushed(rows: list[dict]) -> tuple[str, float]:
    """How many times its gain a loop swings with, and the least largest error of smaller ones."""
    words = f"{rows[-1]['times']} times" if rows[-1]["swings"] else f"more than {rows[-1]['times']} times"
    return words, min(row["largest_percent"] for row in rows if not row["swings"])


def bandwidth(found: dict) -> str:
    """-3 dB, and where the gain rises above +3 dB before that."""
    down, up = found["down_3_dB_Hz"], found["up_3_dB_Hz"]
    words = f"{down:.3g} Hz" if down is not None else f"above {found['swept_to_Hz']:g} Hz"
    return words if up is None or (down is not None and up > down) else f"{words} (up at {up:.3g} Hz)"


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
    """Errors of aged models on a new path: as they were, updated, and identified from new records."""
    head = ("truth", "old model", "updated by one loop", "and a minor loop", "identified anew")
    keys = ("old", "one loop", "loop and minor loop", "anew")
    rows = data("update")
    return table(head, ((row["truth"], *(f"{row[key][0]:.2f}, {row[key][1]:.2f}" for key in keys)) for row in rows))


def coupled() -> list[str]:
    """Errors of stages of three axes, and how often coupling that is no matrix is found."""
    found = data("coupled_axes")
    words = {
        "truths": "plays, Preisach, relays",
        "set aside": "set aside: Jiles-Atherton domains, Stribeck slip, relays",
        "with Bouc-Wen": "plays, Preisach, Bouc-Wen",
    }
    rows = []
    for name, title in words.items():
        plain = [one for one in found[name]["stages"] if not one["hysteretic_coupling"]]
        most = found[name]["summary"]
        single = [max(one["single_axis_largest_percent"]) for one in plain]
        errors = [most[key] for key in ("largest_percent", "rms_percent", "uncoupled_largest_percent")]
        cells = [f"{most['matrix_error']:.4f}", *(f"{error:.2f}" for error in errors)]
        rows.append([title, *cells, f"{min(single):.1f} to {max(single):.1f}"])
    kinds = [found[name]["summary"] for name in words]
    counts = {key: sum(one[key] for one in kinds) for key in kinds[0] if isinstance(kinds[0][key], int)}
    seen = found["detection"]["summary"]
    open_ = [one["no_number_percent"] for one in found["detection"]["stages"] if one["hysteretic_coupling"]]
    head = ("mechanisms", "matrix within", "largest", "RMS", "the same axes uncoupled", "models of single axes")
    return [
        *table(head, rows),
        "",
        f"The last column is the worst axis of each stage. Of these {counts['of_matrices']} stages, "
        f"{counts['matrices_reported_as_such']} were reported as coupled by a matrix; of {counts['of_hysteretic']} "
        f"more, with two couplings that have hysteresis, {counts['hysteretic_found']} as more than a matrix.",
        "",
        f"With `--set detection`, the axes of {seen['of_hysteretic']} stages of two move each other by 3 %, the first "
        "one by a mechanism of its own that no model is an instance of (domains, relays, an elastic line), hardly "
        f"reversible: no number describes {min(open_):.2f} to {max(open_):.2f} % of the stroke (RMS) of it. It was "
        f"found in {seen['found']} of {seen['of_hysteretic']}, on that side alone. Of {seen['of_linear']} such stages "
        f"without it, {seen['accused']} were accused.",
    ]


def creep() -> list[str]:
    """Creep that is left in a hold, one number a seed."""
    words = {
        "LaggingSwitches": "relays whose domains switch late, by a continuum of delays",
        "RelaxingPreload": "plays against a preload of rubber that relaxes",
        "ThermalRelays": "relays that switch by thermal activation",
    }
    keys = "creep_percent_of_step", "left_percent", "left_as_force_percent"
    rows = []
    for truth, title in words.items():
        seeds = [one for one in data("creep")["rows"] if one["truth"] == truth]
        rows.append([title, *(", ".join(f"{one[key]:.0f}" for one in seeds) for key in keys)])
    return table(("actuator", "creep, % of the step", "left, as chosen", "left with creep as a force"), rows)


def firmware() -> list[str]:
    """Instructions of the steps of an exported compensator."""
    plain, wide = ((one["followed"], one["clamped"]) for one in data("size")["instructions"])
    return [
        "A step takes bounded time, whatever came before. Instructions of one step in floats (`-O2`, a Cortex-M4F "
        f"emulated by QEMU): {plain[0]} along a path and at most {plain[1]} when a clamped step crosses the whole "
        f"range, with ten plain elements; {wide[0]} and {wide[1]} with all parts.",
    ]

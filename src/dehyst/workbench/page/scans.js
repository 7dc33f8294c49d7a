// The form of the named scans: the options of `dehyst compensate --scan`, with their units.
import { choice, field, h, number } from "./dom.js";
import { parsed, short } from "./numbers.js";

const UM = "\u00b5m";
const ROUNDING = [["", "parabola: constant acceleration"], ["cosine", "cosine: no jumps of the acceleration"]];
const OPTIONS = {
  low: ["Lowest displacement", UM],
  high: ["Highest displacement", UM],
  frequency: ["Cycles a second", "Hz"],
  cycles: ["Cycles", "", "default: 1"],
  turns: ["Share of the time spent turning", "", "default: 0.1"],
  rising: ["Share of the time spent rising", "", "default: 0.5"],
  speed: ["Largest speed", "\u00b5m/s"],
  acceleration: ["Largest acceleration", "\u00b5m/s\u00b2"],
  rounding: ["Shape of turns", "", "", ROUNDING],
  y_low: ["First line, along y", UM, "default: as along x"],
  y_high: ["Last line, along y", UM, "default: as along x"],
  lines: ["Lines", ""],
  slow: ["Along y", "", "", [["", "staircase"], ["ramp", "ramp"]]],
  back: ["Lines that y takes back", "", "default: fewest"],
  revolutions: ["Revolutions outwards", "", "1/4 is added"],
  constant: ["Constant speed", "", "", [["", "linear"], ["angular", "angular"]]],
  ratio: ["Ratio of cycles, x and y", "", "two whole numbers, e.g. 3 2"],
  phase: ["Phase of y", "degrees", "default: widest figure"],
  levels: ["Levels", UM, "with spaces or semicolons between them; it returns to the first"],
  dwell: ["Time on each level", "s"],
  edge: ["Time between levels", "s", "default: as the limits allow"],
  shape: ["Shape of a change of level", "", "", [["", "minimum jerk"], ["trapezoid", "trapezoid"]]],
  axis: ["Axis that the model moves", "", "", [["", "x"], ["y", "y"]]],
};
const TURNING = ["turns", "speed", "acceleration", "rounding"];
const PLANE = ["axis", "y_low", "y_high"];
export const SCANS = {
  triangle: { title: "Triangle", needs: ["low", "high", "frequency"], may: ["cycles", "rising", ...TURNING] },
  raster: { title: "Raster", needs: ["low", "high", "frequency", "lines"], may: [...PLANE, "slow", "back", "cycles", "rising", ...TURNING] },
  spiral: { title: "Spiral", needs: ["low", "high", "frequency", "revolutions"], may: [...PLANE, "constant", "cycles", ...TURNING] },
  lissajous: { title: "Lissajous", needs: ["low", "high", "frequency", "ratio"], may: [...PLANE, "phase", "cycles", "speed", "acceleration"] },
  steps: { title: "Steps", needs: ["levels", "dwell"], may: ["edge", "shape", "speed", "acceleration"] },
};

export class ScanForm {
  constructor(changed) {
    this.changed = changed;
    this.values = { frequency: "1", lines: "16", revolutions: "5", ratio: "3 2", dwell: "0.2", edge: "0.05" };
    this.kind = choice(Object.entries(SCANS).map(([name, one]) => [name, one.title]), "triangle", { id: "scan-kind" });
    this.body = h("div", { class: "scan-options" });
    this.element = h("div", {}, field("Scan", this.kind), this.body);
    this.kind.addEventListener("change", () => {
      this.build();
      changed();
    });
    this.build();
  }

  // Fill in displacements that the model reaches, as long as the person gave none.
  suggest([low, high]) {
    const place = (share) => short(low + share * (high - low), 3).replaceAll("\u2212", "-");
    const suggested = { low: place(0.2), high: place(0.8), levels: [0.2, 0.5, 0.8, 0.5].map(place).join(" ") };
    const stamp = JSON.stringify(suggested);
    if (this.suggested === stamp) return;
    this.suggested = stamp;
    Object.assign(this.values, suggested);
    this.build();
  }

  build() {
    const { needs, may } = SCANS[this.kind.value];
    const open = this.body.querySelector("details")?.open ?? false;
    this.body.replaceChildren(
      h("div", { class: "fields" }, needs.map((name) => this.control(name))),
      h("details", { open }, h("summary", {}, "More options"), h("div", { class: "fields" }, may.map((name) => this.control(name)))),
    );
  }

  control(name) {
    const [label, unit, hint, choices] = OPTIONS[name];
    const value = this.values[name] ?? "";
    const input = choices ? choice(choices, value) : number({ value });
    input.id = `scan-${name.replace("_", "-")}`;
    input.addEventListener(choices ? "change" : "input", () => {
      this.values[name] = input.value;
      this.changed();
    });
    return field(label, input, { unit, hint });
  }

  // The options as the server takes them; an Error says which is wrong.
  scan() {
    const kind = this.kind.value;
    const { needs, may } = SCANS[kind];
    const scan = { kind };
    for (const name of [...needs, ...may]) {
      const value = valueOf(name, (this.values[name] ?? "").trim());
      if (value !== null) scan[name] = value;
      else if (needs.includes(name)) throw new Error(`${OPTIONS[name][0]}: is empty, need ${OPTIONS[name][1] || "a number"}.`);
    }
    return scan;
  }
}

function valueOf(name, text) {
  const [label, , , choices] = OPTIONS[name];
  if (text === "") return null;
  if (choices) return text;
  const many = name === "levels" || name === "ratio";
  const numbers = many ? text.split(/[\s;]+/).filter(Boolean).map(parsed) : [parsed(text)];
  if (!numbers.every(Number.isFinite)) throw new Error(`${label}: got ${text}, need ${many ? "numbers" : "a number"}.`);
  return many ? numbers : numbers[0];
}

// The form of the named scans: the options that the library declares, and those of how often and where it is played.
import { h } from "./dom.js";
import { Form, fold } from "./forms.js";
import { parsed, plain, roundDown } from "./numbers.js";
import { DECLARED } from "./declared.js";

const UNITS = { um: "\u00b5m", "um/s": "\u00b5m/s", "um/s2": "\u00b5m/s\u00b2", share: "" };
// The largest speed of the scan that is suggested, in its widths a cycle.
const SPEEDS = { triangle: 2.11, raster: 2.11, spiral: 17.6, lissajous: 9.43 };
const SUGGESTED = [0.2, 0.8]; // of the reachable range
const STEEPEST = 0.5 * 1.875; // widths of a change of level, times its duration
const MANY = ["levels", "ratio"];
const BEGIN = { lines: "16", revolutions: "5", ratio: "3 2", dwell: "0.2" };
const title = (name) => name[0].toUpperCase() + name.slice(1);

function declared() {
  const fields = {
    kind: { label: "Scan", choices: Object.keys(DECLARED.scans).map((name) => [name, title(name)]), value: "triangle" },
    cycles: { label: "Cycles", hint: "default: 1" },
    axis: { label: "Axis that the model moves", choices: ["x", "y"].map((word, k) => [k ? word : "", word]) },
  };
  for (const [name, { kind, unit, help, default: words }] of Object.entries(DECLARED.options)) {
    const choices = kind instanceof Array ? kind.map((word, k) => [k ? word : "", word]) : undefined;
    const hint = words && `default: ${words}`;
    fields[name] = { label: help, unit: UNITS[unit] ?? unit, hint, choices, value: BEGIN[name] ?? "" };
  }
  fields.levels.hint = "with spaces or semicolons between them; it returns to the first";
  fields.ratio.hint = "two whole numbers, e.g. 3 2";
  return fields;
}

// Options of a kind of scan: those that it needs, and those that it may have.
function optionsOf(kind) {
  const { needs, may } = DECLARED.scans[kind];
  const played = [...(may.includes("y_low") ? ["axis"] : []), ...(kind in SPEEDS ? ["cycles"] : [])];
  const shown = may.includes("ratio") ? [...needs, "ratio"] : needs;
  return { needs: shown, may: [...played, ...may].filter((one) => !shown.includes(one)) };
}

export class ScanForm extends Form {
  constructor(changed) {
    super("scan", declared(), (name) => {
      if (name === "kind") this.values.frequency = this.frequencies[this.values.kind] ?? "";
      changed();
    });
    this.frequencies = {};
  }

  // Fill in displacements that the model reaches, and speeds of at most `pace` reachable ranges a second.
  suggest([low, high], pace) {
    const place = (share) => plain(low + share * (high - low), 3);
    const [from, to] = SUGGESTED;
    const widths = pace / (to - from);
    const slow = ([kind, speed]) => [kind, plain(roundDown(Math.min(1, widths / speed)))];
    this.frequencies = Object.fromEntries(Object.entries(SPEEDS).map(slow));
    Object.assign(this.values, {
      low: place(from),
      high: place(to),
      levels: [from, 0.5, to, 0.5].map(place).join(" "),
      edge: plain(1 / roundDown(Math.min(20, widths / STEEPEST))),
      frequency: this.frequencies[this.values.kind] ?? "",
    });
  }

  view() {
    const { needs, may } = optionsOf(this.values.kind);
    const more = fold("More options", this.row(may));
    return [this.field("kind"), h("div.scan-options", this.row(needs), more)];
  }

  // The options as the server takes them; an Error says which is wrong.
  scan() {
    const { kind } = this.values;
    const { needs, may } = optionsOf(kind);
    const scan = { kind };
    for (const name of [...needs, ...may]) {
      const { label, unit, choices } = this.fields[name];
      const text = this.values[name].trim();
      const values = MANY.includes(name) ? text.split(/[\s;]+/).filter(Boolean).map(parsed) : [parsed(text)];
      if (text === "" && needs.includes(name)) throw new Error(`${label}: is empty, need ${unit || "a number"}.`);
      if (text === "") continue;
      if (!choices && !values.every(Number.isFinite)) {
        throw new Error(`${label}: got ${text}, need ${MANY.includes(name) ? "numbers" : "a number"}.`);
      }
      scan[name] = choices ? text : MANY.includes(name) ? values : values[0];
    }
    return scan;
  }
}

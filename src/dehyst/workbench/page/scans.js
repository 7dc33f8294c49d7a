// The form of the named scans: the options that the library declares, and those of how often and where it is played.
import { choice, field, h, number } from "./dom.js";
import { parsed, plain, roundDown } from "./numbers.js";
import { DECLARED } from "./scan_options.js";

const UNITS = { um: "\u00b5m", "um/s": "\u00b5m/s", "um/s2": "\u00b5m/s\u00b2", share: "" };
const label = (unit) => UNITS[unit] ?? unit;
const hint = (words) => (words ? `default: ${words}` : "");
const choices = (kind) => (kind instanceof Array ? kind.map((word, k) => [k ? word : "", word]) : undefined);
const OPTIONS = {
  ...Object.fromEntries(Object.entries(DECLARED.options).map(([name, { kind, unit, help, default: words }]) => [name, [help, label(unit), hint(words), choices(kind)]])),
  cycles: ["Cycles", "", hint("1")],
  axis: ["Axis that the model moves", "", "", choices(["x", "y"])],
};
OPTIONS.levels[2] = "with spaces or semicolons between them; it returns to the first";
OPTIONS.ratio[2] = "two whole numbers, e.g. 3 2";
// The largest speed of the scan that is suggested, in its widths a cycle.
const SPEEDS = { triangle: 2.11, raster: 2.11, spiral: 17.6, lissajous: 9.43 };
export const SCANS = Object.fromEntries(
  Object.entries(DECLARED.scans).map(([name, { needs, may }]) => {
    const played = [...(may.includes("y_low") ? ["axis"] : []), ...(name in SPEEDS ? ["cycles"] : [])];
    const shown = may.includes("ratio") ? [...needs, "ratio"] : needs;
    const more = [...played, ...may].filter((one) => !shown.includes(one));
    return [name, { title: name[0].toUpperCase() + name.slice(1), speed: SPEEDS[name], needs: shown, may: more }];
  }),
);

const SUGGESTED = [0.2, 0.8]; // of the reachable range
const STEEPEST = 0.5 * 1.875; // widths of a change of level, times its duration

export class ScanForm {
  constructor(changed) {
    this.changed = changed;
    this.values = { lines: "16", revolutions: "5", ratio: "3 2", dwell: "0.2" };
    this.frequencies = {};
    this.kind = choice(Object.entries(SCANS).map(([name, one]) => [name, one.title]), "triangle", { id: "scan-kind" });
    this.body = h("div", { class: "scan-options" });
    this.element = h("div", {}, field("Scan", this.kind), this.body);
    this.kind.addEventListener("change", () => {
      this.build();
      changed();
    });
    this.build();
  }

  // Fill in displacements that the model reaches, and speeds of at most `pace` reachable ranges a second.
  suggest([low, high], pace) {
    const place = (share) => plain(low + share * (high - low), 3);
    const [from, to] = SUGGESTED;
    const widths = pace / (to - from);
    const edge = plain(1 / roundDown(Math.min(20, widths / STEEPEST)));
    const suggested = { low: place(from), high: place(to), levels: [from, 0.5, to, 0.5].map(place).join(" "), edge };
    const frequencies = Object.fromEntries(Object.entries(SCANS).map(([kind, { speed }]) => [kind, speed && plain(roundDown(Math.min(1, widths / speed)))]));
    const stamp = JSON.stringify([suggested, frequencies]);
    if (this.suggested === stamp) return;
    this.suggested = stamp;
    this.frequencies = frequencies;
    delete this.values.frequency;
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
    const value = this.text(name);
    const input = choices ? choice(choices, value) : number({ value });
    input.id = `scan-${name.replace("_", "-")}`;
    input.addEventListener(choices ? "change" : "input", () => {
      this.values[name] = input.value;
      this.changed();
    });
    return field(label, input, { unit, hint });
  }

  text(name) {
    return this.values[name] ?? (name === "frequency" ? this.frequencies[this.kind.value] : undefined) ?? "";
  }

  // The options as the server takes them; an Error says which is wrong.
  scan() {
    const kind = this.kind.value;
    const { needs, may } = SCANS[kind];
    const scan = { kind };
    for (const name of [...needs, ...may]) {
      const value = valueOf(name, this.text(name).trim());
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

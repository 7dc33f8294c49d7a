// The last samples of a rig: a strip over time, and the loop.
import { h } from "./dom.js";
import { Figure } from "./figure.js";
import { isOpen } from "./steps.js";

const ROOM = 30_000; // samples that are kept
const STRIP = 20; // seconds of the strip

export class LiveFigures {
  constructor() {
    this.loop = new Figure({ title: "Loop, live" });
    this.voltage = new Figure({ title: `Voltage, last ${STRIP} s` });
    this.displacement = new Figure({ title: `Displacement, last ${STRIP} s` });
    this.element = h("div", { class: "live" }, this.loop.element, h("div", {}, this.voltage.element, this.displacement.element));
    this.clear();
  }

  clear() {
    this.count = 0;
    this.kept = Object.fromEntries(["t", "v", "y", "expected"].map((name) => [name, new Float64Array(ROOM)]));
  }

  add({ t = [], v = [], y = [], expected = [] }) {
    if (this.count > 0 && t.length && t[0] < this.kept.t[this.count - 1]) this.clear();
    if (this.count + t.length > ROOM) this.halve();
    for (let i = 0; i < t.length; i += 1) {
      const row = { t: t[i], v: v[i] ?? NaN, y: y[i] ?? NaN, expected: expected?.[i] ?? NaN };
      for (const name in row) this.kept[name][this.count] = row[name];
      this.count += 1;
    }
    if (t.length && isOpen("rig")) this.draw();
  }

  halve() {
    const half = ROOM / 2;
    for (const values of Object.values(this.kept)) values.copyWithin(0, this.count - half, this.count);
    this.count = half;
  }

  draw() {
    const { t, v, y, expected } = Object.fromEntries(Object.entries(this.kept).map(([name, values]) => [name, values.subarray(0, this.count)]));
    const now = t[this.count - 1] ?? 0;
    const seconds = { label: "Time (s)", unit: "s", range: [Math.max(t[0] ?? 0, now - STRIP), Math.max(now, (t[0] ?? 0) + 1)] };
    const known = expected.some(Number.isFinite);
    const beside = (x, rising) => (known ? [{ name: "expected", colour: "simulated", x, y: expected, rising }] : []);
    const volts = { label: "Voltage (V)", unit: "V" };
    const micrometres = { label: "Displacement (\u00b5m)", unit: "\u00b5m" };
    this.loop.set({ x: volts, y: micrometres, series: [{ name: "measured", colour: "measured", x: v, y }, ...beside(v, false)] }, { keep: true });
    this.voltage.set({ x: seconds, y: volts, series: [{ name: "voltage", colour: "measured", x: t, y: v, rising: true }] }, { keep: true });
    this.displacement.set({ x: seconds, y: micrometres, series: [{ name: "measured", colour: "measured", x: t, y, rising: true }, ...beside(t, true)] }, { keep: true });
  }
}

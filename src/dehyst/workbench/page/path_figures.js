// The two pictures of a plan, path and voltage, and the points of a drawn path as a table.
import { h, number } from "./dom.js";
import { Figure } from "./figure.js";
import { length, parsed, plain, short } from "./numbers.js";
import { KEYS, PathEditor } from "./path_editor.js";
import { inserted, moved, removed } from "./path_points.js";

const SECONDS = { label: "Time (s)", unit: "s" };

export class PathFigures {
  // `edited` is called with the points after each change by the person.
  constructor(edited) {
    this.edited = edited;
    this.path = new Figure({
      title: "Displacement",
      views: [
        ["path", "Path"],
        ["error", "Error"],
      ],
      choose: () => this.last && this.draw(this.last),
      keys: KEYS,
    });
    this.voltage = new Figure({ title: "Voltage" });
    this.editor = new PathEditor(this.path.chart, edited);
    this.table = h("div", { class: "points" });
    this.element = h("div", {}, this.path.element, this.voltage.element);
  }

  draw(last) {
    this.last = last;
    const { path, planned, limits, band, points } = last;
    const errors = this.path.view === "error";
    const axis = { x: SECONDS, y: errors ? { label: "Error (\u00b5m)", unit: "\u00b5m" } : { label: "Displacement (\u00b5m)", unit: "\u00b5m" } };
    this.path.set({ ...axis, ...(errors ? errorCurves : pathCurves)(path, planned, band) }, { keep: this.path.drawn === this.path.view });
    this.path.drawn = this.path.view;
    this.editor.set(points ?? [], Boolean(points) && !errors);
    this.voltage.set(voltageCurves(path, planned, limits), { keep: true });
    this.path.describe("Wanted displacement over time, and what a straight gain would reach.");
    this.voltage.describe("Voltage over time with its limits.");
    this.writeTable(points);
  }

  writeTable(points) {
    if (!points) return;
    const active = this.table.contains(document.activeElement);
    if (active && this.table.querySelectorAll("tbody tr").length === points.length) return;
    const rows = points.map((one, k) => this.row(points, one, k));
    const add = () => this.edited(inserted(points, [points.at(-1)[0] + (points.at(-1)[0] - points[0][0]) / (points.length - 1), points.at(-1)[1]], 0).points);
    this.table.replaceChildren(
      h("p", { class: "muted" }, "Drag the points in the picture, or type here."),
      h("table", {}, h("caption", { class: "unseen" }, "Points of the path"), h("thead", {}, h("tr", {}, ["No.", "Time (s)", "Displacement (\u00b5m)", ""].map((one) => h(one ? "th" : "td", one ? { scope: "col" } : {}, one)))), h("tbody", {}, rows)),
      h("button", { type: "button", onclick: add }, "Add a point"),
    );
  }

  row(points, [time, displacement], k) {
    const inputs = [number({ value: plain(time, 5), "aria-label": `Time of point ${k + 1} in s`, disabled: k === 0 }), number({ value: plain(displacement, 5), "aria-label": `Displacement of point ${k + 1} in \u00b5m` })];
    const change = () => {
      const values = inputs.map((one) => parsed(one.value));
      if (values.every(Number.isFinite)) this.edited(moved(this.editor.points, k, values, 1e-6));
    };
    for (const input of inputs) input.addEventListener("change", change);
    const drop = h("button", { type: "button", class: "quiet", disabled: k === 0 || points.length <= 2, "aria-label": `Delete point ${k + 1}`, onclick: () => this.edited(removed(points, k)) }, "\u00d7");
    return h("tr", {}, h("th", { scope: "row" }, String(k + 1)), h("td", {}, inputs[0]), h("td", {}, inputs[1]), h("td", {}, drop));
  }
}

function pathCurves({ time, wanted }, planned, band) {
  const missed = planned.clamps.limited + planned.clamps.slewed > 0;
  return {
    series: [
      { name: "straight gain", colour: "without", x: time, y: planned.straightReached, rising: true, dash: [5, 4] },
      { name: "wanted", colour: "measured", x: time, y: wanted, rising: true, around: band, width: 1.8 },
      ...(missed ? [{ name: "reached", colour: "simulated", x: time, y: planned.expected, rising: true, width: 1.8 }] : []),
    ],
    notes: [["band", `trust band, \u00b1${length(band)}`]],
  };
}

function errorCurves({ time, wanted }, planned, band) {
  const less = (values) => Float32Array.from(values, (value, i) => value - wanted[i]);
  return {
    zero: true,
    band: [-band, band],
    series: [
      { name: "straight gain", colour: "without", x: time, y: less(planned.straightReached), rising: true },
      { name: "dehyst, without the model's error", colour: "measured", x: time, y: less(planned.expected), rising: true, width: 1.8 },
    ],
    notes: [["band", `trust band, \u00b1${length(band)}`]],
  };
}

function voltageCurves({ time }, planned, [low, high]) {
  const places = [];
  for (let i = 0; i < planned.clamped.length; i += 1) if (planned.clamped[i]) places.push(i);
  const pick = (values) => Float32Array.from(places, (i) => values[i]);
  return {
    x: SECONDS,
    y: { label: "Voltage (V)", unit: "V" },
    levels: [
      { value: high, name: `limit ${short(high, 4)} V` },
      { value: low, name: `limit ${short(low, 4)} V` },
    ],
    marks: places.length ? { x: pick(time), y: pick(planned.voltage) } : null,
    series: [
      { name: "straight gain", colour: "without", x: time, y: planned.straight, rising: true, dash: [5, 4] },
      { name: "dehyst", colour: "simulated", x: time, y: planned.voltage, rising: true, width: 1.8 },
    ],
    notes: places.length ? [["limit", "clamped"]] : [],
  };
}

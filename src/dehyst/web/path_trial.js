// A path in a report, whose points a reader drags: module and numbers lie inside the page.
import { Compensator, load } from "./dehyst.js";
import { fill } from "./dom.js";
import { Form } from "./forms.js";
import { limitsFrom, parsed, plain, short } from "./numbers.js";
import { plan, sampled } from "./path.js";
import { MORE, PathFigures, judged, turnsOf, verdict } from "./path_figures.js";
import { isPlane, pageFigures } from "./report.js";

const SHAPES = {
  "shrinking loops": [0.02, 0.92, 0.2, 0.75, 0.34, 0.6, 0.46, 0.5],
  triangle: [0.1, 0.9, 0.1, 0.9, 0.1],
  staircase: [0.05, 0.05, 0.3, 0.3, 0.55, 0.55, 0.8, 0.8, 0.95],
  scan: [0.2, 0.8, 0.2, 0.8, 0.2, 0.8, 0.2, 0.8, 0.2],
};
const MOST_PLANNED = 20_000; // samples of a model that needs its own period

class PathTrial {
  // `turns`: the figure with where records turned, if there is one.
  constructor(root, module, { samples, duration, band }, turns) {
    Object.assign(this, { root, module, samples, band: band ?? 0, plane: turns?.spec, model: new Compensator(module) });
    const { limits, reach, needsPeriod } = this.model.about;
    this.reach = reach.map((one) => 1e6 * one);
    this.needsPeriod = needsPeriod;
    const [low, high] = limits.map((one) => plain(one, 6));
    const shapes = Object.keys(SHAPES).map((one) => [one, one]);
    const fields = {
      shape: { label: "Path", choices: shapes, value: shapes[0][0] },
      low: { label: "Lowest voltage", unit: "V", value: low },
      high: { label: "Highest voltage", unit: "V", value: high },
      slew: { label: "Slew rate", unit: "V/s", placeholder: "any", above: 0, optional: true },
      duration: { label: "Duration", unit: "s", value: plain(duration), above: 0 },
    };
    this.form = new Form("trial", fields, (name) => (name === "shape" ? this.begin() : this.show(name)));
    this.figures = new PathFigures((points) => {
      this.points = points;
      this.form.values.duration = plain(points.at(-1)[0]);
      this.show();
    }, turns);
    this.begin();
    root.classList.add("ready");
  }

  // Take the points of the chosen shape.
  begin() {
    const [bottom, top] = this.reach;
    const shares = SHAPES[this.form.values.shape];
    const seconds = parsed(this.form.values.duration) || 1;
    this.points = shares.map((share, i) => [(i / (shares.length - 1)) * seconds, bottom + share * (top - bottom)]);
    this.show();
  }

  show(changed) {
    let said;
    try {
      said = this.plan(changed === "duration");
    } catch (error) {
      said = { light: "amber", first: `This path has no voltage yet. ${error.message}`, facts: [] };
    }
    fill(this.root, this.form.row(Object.keys(this.form.fields), "controls"), verdict(said), this.figures.element);
  }

  // Compute the voltage and draw, the points in proportion to a typed duration; return what to expect. An Error says
  // which number cannot be.
  plan(stretched) {
    const { form, band, reach, plane } = this;
    const limits = limitsFrom(form.values.low, form.values.high);
    const slewRate = form.value("slew");
    const seconds = form.value("duration");
    const period = this.needsPeriod ? this.model.about.period : seconds / (this.samples - 1);
    if (seconds / period > MOST_PLANNED) throw new Error(`Duration: need ${plain(MOST_PLANNED * period)} s at most.`);
    const times = stretched ? seconds / this.points.at(-1)[0] : 1;
    this.points = this.points.map(([t, y]) => [t * times, y]);
    this.model = new Compensator(this.module, { limits, slewRate, period });
    const path = sampled(this.points, 1 / period);
    const planned = plan(this.model, path.wanted);
    const turned = turnsOf(plane, path.time, planned.voltage);
    this.figures.draw({ path, planned, limits, reach, band, points: this.points, turned });
    const faster = plane && planned.steepest > MORE * plane.about.fastest;
    const speed = faster ? ` (the records: up to ${short(plane.about.fastest)} V/s)` : "";
    return judged(planned, { stroke: reach[1] - reach[0], band, turned, speed });
  }
}

const root = document.getElementById("path-trial");
const given = JSON.parse(document.getElementById("path-data").textContent);
const code = Uint8Array.from(atob(given.module), (letter) => letter.charCodeAt(0));
new PathTrial(root, await load(code), given, pageFigures.find(isPlane));

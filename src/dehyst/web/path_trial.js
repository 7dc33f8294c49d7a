// A path in a report, whose points a reader drags: module and numbers lie inside the page.
import { Compensator, load } from "./dehyst.js";
import { fill, h } from "./dom.js";
import { limitsFrom, numberFrom, parsed, plain } from "./numbers.js";
import { plan, sampled } from "./path.js";
import { PathFigures, judged, verdict } from "./path_figures.js";

const SHAPES = {
  "shrinking loops": [0.02, 0.92, 0.2, 0.75, 0.34, 0.6, 0.46, 0.5],
  triangle: [0.1, 0.9, 0.1, 0.9, 0.1],
  staircase: [0.05, 0.05, 0.3, 0.3, 0.55, 0.55, 0.8, 0.8, 0.95],
  scan: [0.2, 0.8, 0.2, 0.8, 0.2, 0.8, 0.2, 0.8, 0.2],
};
const MOST_PLANNED = 20_000; // samples of a model that needs its own period

class PathTrial {
  constructor(root, module, { samples, duration, band, tested }) {
    Object.assign(this, { root, module, samples, band: band ?? 0, tested, model: new Compensator(module) });
    const { limits, reach, needsPeriod } = this.model.about;
    this.reach = reach.map((one) => 1e6 * one);
    this.needsPeriod = needsPeriod;
    const [low, high] = limits.map((one) => plain(one, 6));
    this.values = { shape: "shrinking loops", low, high, slew: "", duration: plain(duration) };
    this.figures = new PathFigures((points) => {
      this.points = points;
      this.values.duration = plain(points.at(-1)[0]);
      this.show();
    });
    this.take();
    root.classList.add("ready");
  }

  // Begin with the points of the chosen shape.
  take() {
    const [bottom, top] = this.reach;
    const shares = SHAPES[this.values.shape];
    const seconds = parsed(this.values.duration) || 1;
    this.points = shares.map((share, i) => [(i / (shares.length - 1)) * seconds, bottom + share * (top - bottom)]);
    this.show();
  }

  // Points in proportion to a duration that was typed.
  stretch() {
    const times = parsed(this.values.duration) / this.points.at(-1)[0];
    if (times > 0) this.points = this.points.map(([t, y]) => [t * times, y]);
    this.show();
  }

  show() {
    let said;
    try {
      said = this.plan();
    } catch (error) {
      said = { light: "amber", first: `This path has no voltage yet. ${error.message}`, facts: [] };
    }
    fill(
      this.root,
      h("div", { class: "controls" }, this.controls()),
      verdict(said),
      this.figures.element,
    );
  }

  controls() {
    const { values } = this;
    const input = (name, label, act, more) => {
      const oninput = (event) => {
        values[name] = event.target.value;
        act.call(this);
      };
      return h("label", {}, label, h("input", { name, inputmode: "decimal", value: values[name], oninput, ...more }));
    };
    const onchange = (event) => {
      values.shape = event.target.value;
      this.take();
    };
    const shapes = Object.keys(SHAPES).map((one) => h("option", { value: one }, one));
    return [
      h("label", {}, "Path", h("select", { name: "shape", value: values.shape, onchange }, shapes)),
      input("low", "Lowest voltage (V)", this.show),
      input("high", "Highest voltage (V)", this.show),
      input("slew", "Slew rate (V/s)", this.show, { placeholder: "any" }),
      input("duration", "Duration (s)", this.stretch),
    ];
  }

  // Compute the voltage and draw; return what to expect. An Error says which number cannot be.
  plan() {
    const { low, high, slew, duration } = this.values;
    const limits = limitsFrom(low, high);
    const slewRate = numberFrom(slew, "Slew rate", { above: 0, optional: true });
    const seconds = numberFrom(duration, "Duration", { above: 0 });
    const period = this.needsPeriod ? this.model.about.period : seconds / (this.samples - 1);
    if (seconds / period > MOST_PLANNED) throw new Error(`Duration: need ${plain(MOST_PLANNED * period)} s at most.`);
    this.model = new Compensator(this.module, { limits, slewRate, period });
    const path = sampled(this.points, 1 / period);
    const planned = plan(this.model, path.wanted);
    const { band, reach, tested, points } = this;
    this.figures.draw({ path, planned, limits, reach, band, points, tested });
    return judged(planned, { stroke: reach[1] - reach[0], band, tested });
  }
}

const root = document.getElementById("path-trial");
const given = JSON.parse(document.getElementById("path-data").textContent);
new PathTrial(root, await load(Uint8Array.from(atob(given.module), (letter) => letter.charCodeAt(0))), given);

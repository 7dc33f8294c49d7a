// A path whose points are dragged: the voltage of the compensator, its clamps, and the error of a straight scale
// factor beside it, with the model as the actuator. Loads nothing: module and numbers lie inside the page.
import { Compensator, load } from "./dehyst.js";
import { Plot, extent, short, written } from "./plot.js";

const SHAPES = {
  shrinking: [0.02, 0.92, 0.2, 0.75, 0.34, 0.6, 0.46, 0.5],
  triangle: [0.1, 0.9, 0.1, 0.9, 0.1],
  staircase: [0.05, 0.05, 0.3, 0.3, 0.55, 0.55, 0.8, 0.8, 0.95],
  scan: [0.2, 0.8, 0.2, 0.8, 0.2, 0.8, 0.2, 0.8, 0.2],
};
const MOST_POINTS = 16;
const BEYOND = 0.1; // how far a point may lie outside the reach, of the reach
const NEAREST = 0.01; // between the times of two points, of the duration

class Trial {
  constructor(root, module, { samples, duration, band }) {
    this.root = root;
    this.module = module;
    this.samples = samples;
    this.band = band;
    this.model = new Compensator(module);
    const { about } = this.model;
    const [bottom, top] = about.reach;
    this.straight = (y) => about.limits[0] + ((y - bottom) / (top - bottom)) * (about.limits[1] - about.limits[0]);
    [this.factor, this.unit] = top - bottom < 1e-6 ? [1e9, "nm"] : [1e6, "\u00b5m"];
    const find = (name) => root.querySelector(`[name="${name}"]`);
    this.inputs = Object.fromEntries(["shape", "low", "high", "slew", "duration"].map((name) => [name, find(name)]));
    [this.inputs.low.value, this.inputs.high.value] = about.limits.map((volts) => Number(volts.toPrecision(6)));
    this.inputs.duration.value = duration;
    this.inputs.duration.disabled = about.needsPeriod;
    this.duration = duration;
    this.field = root.querySelector(".field");
    const canvases = root.querySelectorAll("canvas");
    this.plots = {
      path: new Plot(canvases[0], "time (s)", `displacement (${this.unit})`),
      voltage: new Plot(canvases[1], "time (s)", "voltage (V)"),
      error: new Plot(canvases[2], "time (s)", `error (${this.unit})`),
    };
    this.inputs.shape.addEventListener("change", () => this.take(SHAPES[this.inputs.shape.value]));
    for (const name of ["low", "high", "slew", "duration"]) {
      this.inputs[name].addEventListener("input", () => this.set());
    }
    find("add").addEventListener("click", () => this.insert(this.active ?? 0, true));
    find("remove").addEventListener("click", () => this.remove(this.active ?? this.points.length - 2, true));
    this.plots.path.canvas.addEventListener("dblclick", (event) => this.put(this.under(event), true));
    this.set();
    this.take(SHAPES.shrinking);
  }

  // Read limits, slew rate and duration; what cannot be is named and leaves the page as it was.
  set() {
    const { low, high, slew, duration } = this.inputs;
    const seconds = Number(duration.value);
    try {
      if (!(seconds > 0)) throw new RangeError("duration: need seconds above 0");
      const period = duration.disabled ? this.model.about.period : seconds / (this.samples - 1);
      const options = { limits: [Number(low.value), Number(high.value)], period };
      options.slewRate = slew.value === "" ? null : Number(slew.value);
      this.model = new Compensator(this.module, options);
      this.wrong = "";
    } catch (error) {
      this.wrong = `These limits cannot be: need low < high, and a slew rate and a duration above 0.`;
    }
    for (const point of this.points ?? []) point.t *= (seconds > 0 ? seconds : this.duration) / this.duration;
    if (seconds > 0) this.duration = seconds;
    if (this.points) this.show();
  }

  take(shares) {
    const [bottom, top] = this.model.about.reach;
    this.points = shares.map((share, i) => ({
      t: (i / (shares.length - 1)) * this.duration,
      y: bottom + share * (top - bottom),
    }));
    this.active = null;
    this.rebuild();
  }

  // Points are elements of the page, so that a keyboard and a screen reader find them.
  rebuild(focus = null) {
    for (const handle of this.field.querySelectorAll(".point")) handle.remove();
    this.handles = this.points.map((_, i) => {
      const handle = document.createElement("div");
      handle.className = "point";
      handle.tabIndex = 0;
      handle.setAttribute("role", "slider");
      handle.setAttribute("aria-orientation", "vertical");
      handle.addEventListener("pointerdown", (event) => this.grab(event, i));
      handle.addEventListener("keydown", (event) => this.key(event, i));
      handle.addEventListener("focus", () => (this.active = i));
      this.field.append(handle);
      return handle;
    });
    this.show();
    if (focus !== null) this.handles[focus].focus();
  }

  grab(event, i) {
    if (event.button !== 0) return;
    const handle = this.handles[i];
    const move = (to) => {
      const { t, y } = this.under(to);
      this.move(i, t, y);
    };
    event.preventDefault();
    handle.focus({ preventScroll: true });
    handle.setPointerCapture(event.pointerId);
    handle.addEventListener("pointermove", move);
    for (const end of ["pointerup", "pointercancel"]) {
      handle.addEventListener(end, () => handle.removeEventListener("pointermove", move), { once: true });
    }
  }

  // Time and displacement [m] under the pointer.
  under(event) {
    const { path } = this.plots;
    const box = path.canvas.getBoundingClientRect();
    return { t: path.vx(event.clientX - box.left), y: path.vy(event.clientY - box.top) / this.factor };
  }

  key(event, i) {
    const { t, y } = this.points[i];
    const [bottom, top] = this.model.about.reach;
    const step = (event.shiftKey ? 0.1 : 0.01) * (top - bottom);
    const wait = (event.shiftKey ? 0.1 : 0.01) * this.duration;
    const act = {
      ArrowUp: () => this.move(i, t, y + step),
      ArrowDown: () => this.move(i, t, y - step),
      PageUp: () => this.move(i, t, y + 10 * step),
      PageDown: () => this.move(i, t, y - 10 * step),
      Home: () => this.move(i, t, bottom),
      End: () => this.move(i, t, top),
      ArrowLeft: () => this.move(i, t - wait, y),
      ArrowRight: () => this.move(i, t + wait, y),
      Insert: () => this.insert(i, true),
      "+": () => this.insert(i, true),
      Delete: () => this.remove(i, true),
      "-": () => this.remove(i, true),
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  }

  // First and last point keep their times; others stay between their neighbours.
  move(i, t, y) {
    const [bottom, top] = this.model.about.reach;
    const beyond = BEYOND * (top - bottom);
    const gap = NEAREST * this.duration;
    const last = this.points.length - 1;
    const point = this.points[i];
    point.y = Math.min(Math.max(y, bottom - beyond), top + beyond);
    if (i > 0 && i < last) point.t = Math.min(Math.max(t, this.points[i - 1].t + gap), this.points[i + 1].t - gap);
    this.show();
  }

  insert(i, focus) {
    const from = this.points[Math.min(i, this.points.length - 2)];
    const to = this.points[Math.min(i, this.points.length - 2) + 1];
    this.put({ t: (from.t + to.t) / 2, y: (from.y + to.y) / 2 }, focus);
  }


  put(point, focus) {
    const at = this.points.findIndex((one) => one.t > point.t);
    const gap = NEAREST * this.duration;
    const full = this.points.length >= MOST_POINTS;
    if (full || at < 1 || point.t - this.points[at - 1].t < gap || this.points[at].t - point.t < gap) return;
    this.points.splice(at, 0, point);
    this.rebuild(focus ? at : null);
  }

  remove(i, focus) {
    if (i < 1 || i >= this.points.length - 1) return;
    this.points.splice(i, 1);
    this.rebuild(focus ? Math.min(i, this.points.length - 1) : null);
  }

  // The wanted displacements: straight lines between the points.
  wanted() {
    const { points, samples } = this;
    const y = new Float64Array(samples);
    for (let i = 0, k = 0; i < samples; i += 1) {
      const t = (i / (samples - 1)) * this.duration;
      while (k < points.length - 2 && t > points[k + 1].t) k += 1;
      const [a, b] = [points[k], points[k + 1]];
      y[i] = a.y + ((t - a.t) / (b.t - a.t)) * (b.y - a.y);
    }
    return y;
  }

  // The voltage of a straight scale factor, within the same limits.
  byScale(wanted) {
    const { limits, slewRate, period } = this.model;
    const change = slewRate === null ? Infinity : slewRate * period;
    let before = this.straight(wanted[0]);
    return wanted.map((y) => {
      const v = Math.min(Math.max(this.straight(y), before - change), before + change);
      return (before = Math.min(Math.max(v, limits[0]), limits[1]));
    });
  }

  show() {
    const wanted = this.wanted();
    this.model.reset();
    try {
      this.model.lead(wanted[0]);
    } catch {
      this.model.reset(); // too slow to get there: the path shows it
    }
    const own = this.model.trajectory(wanted);
    const scaled = this.byScale(wanted);
    const moved = this.model.simulate(scaled);
    const reached = this.model.simulate(own.voltage);
    const { factor } = this;
    const um = (values) => values.map((value) => value * factor);
    const off = (values) => values.map((value, i) => (value - wanted[i]) * factor);
    const time = wanted.map((_, i) => (i / (this.samples - 1)) * this.duration);
    const x = [-0.02 * this.duration, 1.02 * this.duration];
    const band = this.band && [-this.band * factor, this.band * factor];
    const errors = { scaled: off(moved), own: off(reached) };
    this.plots.path.draw({
      x,
      y: extent([this.model.about.reach.map((one) => one * factor)], 0.12),
      lines: [
        { x: time, y: um(moved), colour: "without" },
        { x: time, y: um(reached), colour: "simulated", width: 2.4 },
        { x: time, y: um(wanted), colour: "ink", width: 1, dash: [4, 4] },
      ],
    });
    this.plots.voltage.draw({
      x,
      y: extent([own.voltage, scaled, this.model.limits]),
      levels: this.model.limits,
      lines: [
        { x: time, y: scaled, colour: "without" },
        { x: time, y: own.voltage, colour: "simulated", width: 1.8 },
        { x: time, y: own.voltage, colour: "measured", width: 2.4, dots: own.clamped },
      ],
    });
    this.plots.error.draw({
      x,
      y: extent([errors.scaled, errors.own, band ?? [0]]),
      band,
      levels: [0],
      lines: [
        { x: time, y: errors.scaled, colour: "without" },
        { x: time, y: errors.own, colour: "simulated", width: 1.8 },
      ],
    });
    this.place();
    this.say(errors, own.clamped);
  }

  // Put the points where the picture has them, and say where they are.
  place() {
    const { path } = this.plots;
    const [bottom, top] = this.model.about.reach.map((one) => one * this.factor);
    const beyond = BEYOND * (top - bottom);
    this.handles.forEach((handle, i) => {
      const { t, y } = this.points[i];
      const value = y * this.factor;
      handle.style.left = `${path.px(t)}px`;
      handle.style.top = `${path.py(value)}px`;
      handle.setAttribute("aria-label", `Point ${i + 1} of ${this.handles.length}`);
      handle.setAttribute("aria-valuemin", (bottom - beyond).toFixed(3));
      handle.setAttribute("aria-valuemax", (top + beyond).toFixed(3));
      handle.setAttribute("aria-valuenow", value.toFixed(3));
      handle.setAttribute("aria-valuetext", `${short(value)} ${this.unit} at ${short(t)} s`);
    });
  }

  say({ scaled, own }, clamped) {
    const largest = (values) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    const [bottom, top] = this.model.about.reach;
    const words = (values) => {
      const most = largest(values);
      const share = (100 * most) / ((top - bottom) * this.factor);
      const tiny = share < 5e-4;
      return tiny ? `0.000 ${this.unit}` : `${short(most)} ${this.unit} (${short(share)} % of the reach)`;
    };
    const count = (code) => clamped.reduce((sum, one) => sum + (one === code), 0);
    const [limited, slewed] = [count(1), count(2)];
    const cut = limited + slewed
      ? ` ${written(limited, 0)} samples are cut at a limit, ${written(slewed, 0)} held back by the slew rate.`
      : " No voltage is clamped.";
    const errors = `Largest error: straight scale factor ${words(scaled)}, dehyst ${words(own)}.${cut}`;
    this.root.querySelector("output").textContent = this.wrong || errors;
  }
}

const stored = JSON.parse(document.getElementById("path-data").textContent);
const bytes = Uint8Array.from(atob(stored.module), (letter) => letter.charCodeAt(0));
const root = document.getElementById("path-trial");
const trial = new Trial(root, await load(bytes), stored);
root.classList.add("ready");
const paper = (on) => () => {
  document.documentElement.classList.toggle("paper", on);
  trial.show();
};
window.addEventListener("resize", () => trial.show());
window.addEventListener("beforeprint", paper(true));
window.addEventListener("afterprint", paper(false));
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => trial.show());

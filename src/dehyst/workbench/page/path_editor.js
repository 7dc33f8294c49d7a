// Points of a path on a chart: drag, add by double-click, select and move by keys, delete.
import { announce } from "./dom.js";
import { short } from "./numbers.js";
import { inserted, moved, removed } from "./path_points.js";

const GRASP = 14; // pixels
export const KEYS =
  "Drag a point; double-click adds one. Keys: N and P select the next and the previous point, arrows move it (with " +
  "Shift ten times as far), Insert adds one behind it, Delete takes it away, Escape leaves it. Without a selected " +
  "point arrows move the view, plus and minus zoom, 0 shows all. Drag beside a point to zoom, with Shift to move.";

export class PathEditor {
  constructor(chart, changed) {
    this.chart = chart;
    this.changed = changed;
    this.points = [];
    this.selected = -1;
    this.active = false;
    this.held = -1;
    chart.editor = this;
    chart.overlays.push((pen) => this.draw(pen));
  }

  set(points, active) {
    this.points = points;
    this.active = active;
    if (this.selected >= points.length || !active) this.selected = -1;
    this.chart.requestTop();
  }

  // The least time between two points: a thousandth of the path.
  get gap() {
    return 1e-3 * (this.points.at(-1)[0] - this.points[0][0]);
  }

  use(points) {
    if (points === this.points) return;
    this.points = points;
    this.changed(points);
    this.chart.requestTop();
  }

  hit(event) {
    const at = this.chart.place(event);
    let best = GRASP;
    let found = -1;
    this.points.forEach(([t, y], k) => {
      const away = Math.hypot(this.chart.px(t) - at.x, this.chart.py(y) - at.y);
      if (away < best) [best, found] = [away, k];
    });
    return found;
  }

  value(event) {
    const at = this.chart.place(event);
    return [this.chart.vx(at.x), this.chart.vy(at.y)];
  }

  begin(event) {
    if (!this.active) return false;
    this.held = this.hit(event);
    if (this.held < 0) return false;
    this.select(this.held);
    return true;
  }

  move(event) {
    if (!this.active) return false;
    if (this.held >= 0) {
      this.use(moved(this.points, this.held, this.value(event), this.gap));
      this.chart.readout(this.sentence(this.held));
      return true;
    }
    this.chart.top.style.cursor = this.hit(event) >= 0 ? "grab" : "";
    return false;
  }

  end() {
    const was = this.held;
    this.held = -1;
    return was >= 0;
  }

  double(event) {
    if (!this.active) return false;
    if (this.hit(event) < 0) this.add(this.value(event));
    return true;
  }

  add(point) {
    const { points, index } = inserted(this.points, point, this.gap);
    this.use(points);
    if (index >= 0) this.select(index);
  }

  select(index) {
    this.selected = index;
    if (index >= 0) announce(this.sentence(index));
    this.chart.requestTop();
  }

  sentence(index) {
    const [t, y] = this.points[index];
    return `Point ${index + 1} of ${this.points.length}: ${short(t, 5)} s, ${short(y, 5)} \u00b5m`;
  }

  key(event) {
    if (!this.active) return false;
    const handled = this.keyed(event);
    if (handled) event.preventDefault();
    return handled;
  }

  keyed({ key, shiftKey }) {
    const count = this.points.length;
    if (key === "n" || key === "N") return this.select((this.selected + 1) % count), true;
    if (key === "p" || key === "P") return this.select((Math.max(this.selected, 0) + count - 1) % count), true;
    const index = this.selected;
    if (index < 0) return false;
    if (key === "Escape") return this.select(-1), true;
    if (key === "Delete" || key === "Backspace") {
      this.use(removed(this.points, index));
      this.select(Math.min(index, this.points.length - 1));
      return true;
    }
    if (key === "Insert") {
      const [a, b] = [this.points[index], this.points[index + 1] ?? [2 * this.points[index][0] - this.points[index - 1][0], this.points[index][1]]];
      this.add([(a[0] + b[0]) / 2, (a[1] + b[1]) / 2]);
      return true;
    }
    return this.nudged(key, shiftKey ? 10 : 1);
  }

  nudged(key, times) {
    const { x, y } = this.chart.home;
    const step = { x: (times * (x[1] - x[0])) / 400, y: (times * (y[1] - y[0])) / 400 };
    const by = { ArrowLeft: [-step.x, 0], ArrowRight: [step.x, 0], ArrowUp: [0, step.y], ArrowDown: [0, -step.y] }[key];
    if (!by) return false;
    const [t, u] = this.points[this.selected];
    this.use(moved(this.points, this.selected, [t + by[0], u + by[1]], this.gap));
    announce(this.sentence(this.selected));
    return true;
  }

  draw(pen) {
    if (!this.active) return;
    this.points.forEach(([t, y], k) => {
      pen.beginPath();
      pen.arc(this.chart.px(t), this.chart.py(y), k === this.selected ? 7 : 5, 0, 2 * Math.PI);
      pen.fillStyle = this.chart.colour(k === this.selected ? "simulated" : "paper");
      pen.fill();
      pen.lineWidth = 2;
      pen.strokeStyle = this.chart.colour("ink");
      pen.stroke();
    });
  }
}

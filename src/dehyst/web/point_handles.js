// The points of a path as handles on a chart: drag a point, double-click on the chart to add one, on a point to remove
// it. With the keyboard, edit the text of the points.
import { fill, h } from "./dom.js";
import { extent } from "./numbers.js";
import { inserted, moved, removed } from "./path.js";

export const HANDLE_HELP = "Points: drag a point to move it. A double click adds a point, or removes the one under the pointer.";
const BEYOND = 0.1; // largest distance of a point outside the reach, as a part of the reach
const NEAREST = 0.002; // least time between two points, as a part of the duration

export class PointHandles {
  // `changed` is called with the points (s, um) after each change by the user.
  constructor(chart, changed) {
    Object.assign(this, { chart, changed, points: [] });
    this.layer = document.createElement("div");
    this.layer.setAttribute("aria-hidden", "true");
    chart.holder.append(this.layer);
    chart.drawn = () => this.place();
    chart.double = (event) => this.points.length > 0 && this.insert(this.under(event));
  }

  // Show the points of a path between `low` and `high`; no points if the path is not drawn by hand.
  set(points, [low, high]) {
    const beyond = BEYOND * (high - low);
    Object.assign(this, { points, ends: [low - beyond, high + beyond] });
    this.place();
  }

  // Ranges of a picture with these points. While a point is dragged, the picture does not move.
  ranges() {
    const x = this.held ? this.chart.home.x : undefined;
    return { x, y: this.points.length > 0 ? extent([this.ends], 0.02) : undefined };
  }

  get gap() {
    return NEAREST * (this.points.at(-1)[0] - this.points[0][0]);
  }

  place() {
    const { chart, points } = this;
    if (!chart.area) return;
    const { left, top, width, height } = chart.area;
    const outside = (x, y) => x < left - 1 || x > left + width + 1 || y < top - 1 || y > top + height + 1;
    const handle = ([t, y], k) => {
      const [px, py] = [chart.px(t), chart.py(y)];
      return h("div.point", {
        hidden: outside(px, py),
        style: `left:${px}px;top:${py}px`,
        onpointerdown: (event) => this.grab(event, k),
        ondblclick: () => this.use(removed(this.points, k)),
      });
    };
    fill(this.layer, points.map(handle));
  }

  under(event) {
    const at = this.chart.place(event);
    return [this.chart.vx(at.x), this.chart.vy(at.y)];
  }

  grab(event, k) {
    if (event.button !== 0) return;
    const handle = event.currentTarget;
    event.preventDefault();
    handle.setPointerCapture(event.pointerId);
    this.held = true;
    handle.onpointermove = (to) => this.move(k, this.under(to));
    handle.onpointerup = handle.onpointercancel = () => {
      handle.onpointermove = null;
      this.held = false;
      this.changed(this.points);
    };
  }

  move(k, [t, y]) {
    const within = Math.min(Math.max(y, this.ends[0]), this.ends[1]);
    this.use(moved(this.points, k, [t, within], this.gap));
  }

  insert(point) {
    this.use(inserted(this.points, point, this.gap));
    return true;
  }

  use(points) {
    this.points = points;
    this.changed(points);
    this.place();
  }
}

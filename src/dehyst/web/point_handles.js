// The points of a path as handles on a chart: elements of the page, so that pointer, keyboard and screen reader reach
// them. A double click on the chart adds one.
import { fill, h } from "./dom.js";
import { extent, short } from "./numbers.js";
import { inserted, moved, removed } from "./path.js";

export const HANDLE_KEYS =
  "Points: drag, or Tab to one and use the arrow keys (with Shift ten times as far), Page up and down, Home and End, " +
  "Insert and Delete. A double click adds one.";
const BEYOND = 0.1; // how far a point may lie outside the reach, of the reach
const NEAREST = 0.002; // between the times of two points, of the duration

export class PointHandles {
  // `changed` is called with the points (s, um) after each change by the person.
  constructor(chart, changed) {
    Object.assign(this, { chart, changed, points: [] });
    this.layer = document.createElement("div");
    this.layer.className = "handles";
    chart.holder.append(this.layer);
    chart.drawn = () => this.place();
    chart.double = (event) => this.points.length > 0 && this.insert(this.under(event));
  }

  // Show points of a path that goes from `low` to `high` at most; none of a path that is not drawn by hand.
  set(points, [low, high]) {
    const beyond = BEYOND * (high - low);
    Object.assign(this, { points, reach: [low, high], ends: [low - beyond, high + beyond] });
    this.place();
  }

  // Ranges of a picture with these points: while one is dragged, the picture stays where it is.
  ranges() {
    const x = this.held ? this.chart.home.x : undefined;
    return { x, y: this.points.length > 0 ? extent([this.ends], 0.02) : undefined };
  }

  get duration() {
    return this.points.at(-1)[0] - this.points[0][0];
  }

  place() {
    const { chart, points, ends } = this;
    if (!chart.area) return;
    const { left, top, width, height } = chart.area;
    const outside = (x, y) => x < left - 1 || x > left + width + 1 || y < top - 1 || y > top + height + 1;
    const handle = ([t, y], k) => {
      const [px, py] = [chart.px(t), chart.py(y)];
      return h("div.point", {
        role: "slider",
        tabindex: "0",
        hidden: outside(px, py),
        style: `left:${px}px;top:${py}px`,
        "aria-orientation": "vertical",
        "aria-label": `Point ${k + 1} of ${points.length}`,
        "aria-valuemin": ends[0].toFixed(3),
        "aria-valuemax": ends[1].toFixed(3),
        "aria-valuenow": y.toFixed(3),
        "aria-valuetext": `${short(y, 5)} \u00b5m at ${short(t, 5)} s`,
        onpointerdown: (event) => this.grab(event, k),
        onkeydown: (event) => this.key(event, k),
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
    handle.focus({ preventScroll: true });
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
    this.use(moved(this.points, k, [t, within], NEAREST * this.duration));
  }

  insert(point) {
    const { points, index } = inserted(this.points, point, NEAREST * this.duration);
    if (index >= 0) this.use(points, index);
    return true;
  }

  remove(k) {
    const points = removed(this.points, k);
    if (points !== this.points) this.use(points, Math.min(k, points.length - 1));
  }

  use(points, focus) {
    this.points = points;
    this.changed(points);
    this.place();
    if (focus !== undefined) this.layer.childNodes[focus].focus({ preventScroll: true });
  }

  key(event, k) {
    const [t, y] = this.points[k];
    const far = event.shiftKey ? 0.1 : 0.01;
    const [rise, wait] = [far * (this.reach[1] - this.reach[0]), far * this.duration];
    const next = this.points[k + 1] ?? this.points[k - 1];
    const to = {
      ArrowUp: [t, y + rise],
      ArrowDown: [t, y - rise],
      ArrowLeft: [t - wait, y],
      ArrowRight: [t + wait, y],
      PageUp: [t, y + 10 * rise],
      PageDown: [t, y - 10 * rise],
      Home: [t, this.reach[0]],
      End: [t, this.reach[1]],
    }[event.key];
    const [inserts, removes] = [["Insert", "+"], ["Delete", "-"]].map((keys) => keys.includes(event.key));
    if (!(to || inserts || removes) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    if (to) this.move(k, to);
    else if (removes) this.remove(k);
    else this.insert([(t + next[0]) / 2, (y + next[1]) / 2]);
  }
}

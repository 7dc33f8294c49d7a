// A chart on two canvases: one for the curves, and one above it for marks that follow the pointer.
import { make, h } from "./dom.js";
import { bindGestures } from "./gestures.js";
import { digits, extent, short, ticks, written } from "./numbers.js";
import { nearest, pixels, steps } from "./thinning.js";

const MARGIN = { left: 48, right: 16, top: 10, bottom: 40 };
const TITLE = 32; // pixels for the title of a vertical axis, and the gap beside its numbers
const REACH = 40; // largest distance in pixels of the pointer from the sample that is read out
const MANY = 3000; // a curve with more vertices is drawn step by step

// The content of a chart:
//     x, y    { label, unit, range, log }: with `log` the numbers are exponents of ten
//     right   { factor, label, unit }: a second axis, of the numbers of y times a factor
//     series  [{ name, colour, x, y, kind, ... }], each of a kind
//             "line"    width, dash, opacity; `rising` if x rises
//             "points"  width, opacity, and the `names` of single points
//             "area"    from y to `top`
//             "cells"   `values` on a grid with the edges x and y, row by row: the larger, the darker, up to `darkest`
//     shaded  [[from, to], ...] of x;  band: [low, high] of y;  levels: [{ value, name, colour }]
// A `silent` series is neither in the legend nor read out. Colours are names of variables in style.css.
export class Chart {
  // `readout` is called with a sentence about the sample under the pointer, or ""; `moved` when the view moves.
  constructor(holder, { label, readout = () => {}, moved = () => {} }) {
    Object.assign(this, { holder, readout, moved });
    this.base = make(h("canvas", { "aria-hidden": "true" }));
    this.top = make(h("canvas", { tabindex: "0", role: "img", "aria-label": label }));
    holder.append(this.base, this.top);
    this.drawn = () => {}; // called after each drawing
    this.double = () => false; // called first at a double click; true: the view stays
    this.spec = { x: {}, y: {}, series: [] };
    this.home = { x: [0, 1], y: [0, 1] };
    this.view = this.home;
    bindGestures(this);
    new ResizeObserver(() => this.request()).observe(holder);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.request());
  }

  // Show other curves. With `keep`, a view that the user has moved stays.
  set(spec, { keep = false } = {}) {
    const moved = this.view !== this.home;
    this.spec = spec;
    const visible = spec.series.filter((series) => !series.hidden);
    const levels = (spec.levels ?? []).map((level) => level.value);
    const heights = visible.flatMap((series) => (series.top ? [series.y, series.top] : [series.y]));
    this.home = {
      x: spec.x.range ?? extent(visible.map((series) => series.x), 0.02),
      y: spec.y.range ?? extent([...heights, levels, spec.band ?? []], 0.06),
    };
    if (!(keep && moved)) this.view = this.home;
    this.nearest = null;
    this.request();
  }

  show(view) {
    const wide = ([low, high]) => high - low > 1e-9 * Math.max(Math.abs(low), Math.abs(high), 1e-12);
    if (!wide(view.x) || !wide(view.y)) return;
    this.view = view;
    this.moved(view !== this.home);
    this.request();
  }

  // Draw at the next frame: all, or only the marks that follow the pointer.
  request(all = true) {
    this.whole ||= all;
    this.asked ??= requestAnimationFrame(() => {
      this.asked = undefined;
      if (this.whole) this.draw();
      else this.drawTop();
    });
  }

  draw() {
    this.whole = false;
    if (this.holder.clientWidth === 0 || !this.spec.x.label) return;
    this.measure();
    const pen = this.pen(this.base);
    this.axes(pen);
    this.within(pen, () => {
      pen.translate(this.area.left, this.area.top);
      this.backdrop(pen);
      for (const series of this.spec.series) if (!series.hidden) KINDS[series.kind ?? "line"](this, pen, series);
      this.levels(pen);
    });
    this.drawTop();
    this.drawn();
  }

  measure() {
    const { clientWidth, clientHeight } = this.holder;
    const style = getComputedStyle(this.holder);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim() || "#888";
    this.font = `12px ${style.fontFamily}`;
    this.scale = window.devicePixelRatio || 1;
    for (const canvas of [this.base, this.top]) {
      const [width, height] = [Math.round(clientWidth * this.scale), Math.round(clientHeight * this.scale)];
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    }
    const height = Math.max(clientHeight - MARGIN.top - MARGIN.bottom, 20);
    const { y, right } = this.spec;
    this.up = ticks(this.view.y, height / 45, y);
    this.upRight = right ? ticks(this.view.y.map((end) => end * right.factor), height / 45) : [];
    const pen = this.pen(this.base);
    const room = (values) => Math.max(0, ...values.map(([, text]) => pen.measureText(text).width)) + TITLE;
    const left = Math.max(MARGIN.left, room(this.up));
    const width = Math.max(clientWidth - left - (right ? room(this.upRight) : MARGIN.right), 20);
    this.area = { left, top: MARGIN.top, width, height };
    this.across = ticks(this.view.x, width / 80, this.spec.x);
  }

  pen(canvas) {
    const pen = canvas.getContext("2d");
    pen.setTransform(this.scale, 0, 0, this.scale, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.font = this.font;
    return pen;
  }

  within(pen, draw) {
    pen.save();
    pen.beginPath();
    pen.rect(this.area.left, this.area.top, this.area.width, this.area.height);
    pen.clip();
    draw();
    pen.restore();
  }

  // Coefficients from values to pixels of the area.
  frame() {
    const { x, y } = this.view;
    const { width, height } = this.area;
    return { x0: x[0], kx: width / (x[1] - x[0]), y0: y[1], ky: -height / (y[1] - y[0]), width, height };
  }

  // From values to pixels of the canvas, and back.
  px = (value) => this.area.left + (value - this.view.x[0]) * this.frame().kx;
  py = (value) => this.area.top + (value - this.view.y[1]) * this.frame().ky;
  vx = (pixel) => this.view.x[0] + (pixel - this.area.left) / this.frame().kx;
  vy = (pixel) => this.view.y[1] + (pixel - this.area.top) / this.frame().ky;

  axes(pen) {
    const { left, top, width, height } = this.area;
    const { x, y, right } = this.spec;
    const text = (words, at, up, align, line) => {
      Object.assign(pen, { textAlign: align, textBaseline: line, fillStyle: this.colour("ink") });
      pen.fillText(words, at, up);
    };
    const upright = (words, at) => {
      pen.save();
      pen.translate(at, top + height / 2);
      pen.rotate(-Math.PI / 2);
      text(words, 0, 0, "center", "middle");
      pen.restore();
    };
    pen.lineWidth = 1;
    for (const [value, words] of this.across) {
      const at = Math.round(this.px(value)) + 0.5;
      this.rule(pen, at, top, at, top + height);
      text(words, at, top + height + 6, "center", "top");
    }
    for (const [value, words] of this.up) {
      const at = Math.round(this.py(value)) + 0.5;
      this.rule(pen, left, at, left + width, at);
      text(words, left - 6, at, "right", "middle");
    }
    text(x.label, left + width / 2, top + height + 23, "center", "top");
    upright(y.label, 12);
    if (!right) return;
    const beside = left + width + 6;
    for (const [value, words] of this.upRight) text(words, beside, this.py(value / right.factor), "left", "middle");
    upright(right.label, this.holder.clientWidth - 8);
  }

  rule(pen, x0, y0, x1, y1, colour = "grid") {
    pen.strokeStyle = this.colour(colour);
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  }

  backdrop(pen) {
    const { shaded = [], band } = this.spec;
    const { x0, kx, y0, ky, width, height } = this.frame();
    pen.fillStyle = this.colour("shade");
    for (const [from, to] of shaded) pen.fillRect((from - x0) * kx, 0, Math.max((to - from) * kx, 1), height);
    if (!band) return;
    pen.fillStyle = this.colour("band");
    pen.fillRect(0, (band[1] - y0) * ky, width, (band[0] - band[1]) * ky);
  }

  // Horizontal lines. Lines with a colour, such as limits, are dashed.
  levels(pen) {
    const { y0, ky, width } = this.frame();
    pen.textAlign = "right";
    for (const { value, name, colour = "ink" } of this.spec.levels ?? []) {
      const y = Math.round((value - y0) * ky) + 0.5;
      pen.lineWidth = colour === "ink" ? 1 : 1.5;
      pen.setLineDash(colour === "ink" ? [] : [6, 4]);
      this.rule(pen, 0, y, width, y, colour);
      pen.setLineDash([]);
      pen.textBaseline = y < 18 ? "top" : "bottom";
      pen.fillStyle = this.colour(colour);
      if (name) pen.fillText(name, width - 4, y < 18 ? y + 3 : y - 2);
    }
  }

  drawTop() {
    if (!this.area) return;
    const pen = this.pen(this.top);
    this.within(pen, () => {
      pen.strokeStyle = this.colour("ink");
      pen.fillStyle = this.colour("band");
      if (this.nearest) {
        pen.lineWidth = 1.5;
        pen.beginPath();
        pen.arc(this.px(this.nearest.x), this.py(this.nearest.y), 5, 0, 2 * Math.PI);
        pen.stroke();
      }
      if (this.box) {
        const { left, top, right, bottom } = this.box;
        pen.lineWidth = 1;
        pen.fillRect(left, top, right - left, bottom - top);
        pen.strokeRect(left, top, right - left, bottom - top);
      }
    });
  }

  place(event) {
    const box = this.top.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  // Read out the sample nearest to a place on the canvas.
  read(at) {
    const frame = this.frame();
    const spot = { x: at.x - this.area.left, y: at.y - this.area.top };
    let best = null;
    for (const series of this.spec.series) {
      if (series.hidden || series.silent || series.kind === "cells") continue;
      const hit = nearest(series, frame, spot, REACH);
      if (hit && (best === null || hit.away < best.away)) best = { ...hit, series };
    }
    this.nearest = best && { x: best.series.x[best.index], y: best.series.y[best.index] };
    this.readout(best ? this.sentence(this.nearest, best.series.names?.[best.index] ?? best.series.name) : "");
    this.request(false);
  }

  sentence({ x, y }, name) {
    const { spec, view } = this;
    const value = (number, [low, high], { unit = "", log }) =>
      `${log ? short(10 ** number) : written(number, digits((high - low) / 2000))} ${unit}`.trim();
    const parts = [name, value(x, view.x, spec.x), value(y, view.y, spec.y)];
    const { factor } = spec.right ?? {};
    const second = factor ? ` (${value(y * factor, view.y.map((end) => end * factor), spec.right)})` : "";
    return parts.filter(Boolean).join(" \u00b7 ") + second;
  }
}

// The drawing functions of each kind of series; the pen's origin is the corner of the area.
const KINDS = { line: drawLine, points: drawPoints, area: drawArea, cells: drawCells };

function drawLine(chart, pen, series) {
  const curve = pixels(series, chart.frame());
  const { px, py } = curve;
  pen.strokeStyle = chart.colour(series.colour);
  pen.lineWidth = series.width ?? 1.4;
  pen.globalAlpha = series.opacity ?? 1;
  pen.lineJoin = "round";
  pen.setLineDash(series.dash ?? []);
  pen.beginPath();
  if (px.length > MANY && !series.dash) {
    for (const [from, to] of steps(curve, chart.frame())) {
      pen.moveTo(px[from], py[from]);
      pen.lineTo(px[to], py[to]);
    }
  } else {
    let down = false;
    for (let i = 0; i < px.length; i += 1) {
      const there = Number.isFinite(px[i] + py[i]);
      if (there && down) pen.lineTo(px[i], py[i]);
      else if (there) pen.moveTo(px[i], py[i]);
      down = there;
    }
  }
  pen.stroke();
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

function drawPoints(chart, pen, series) {
  const size = series.width ?? 3;
  pen.fillStyle = chart.colour(series.colour);
  pen.globalAlpha = series.opacity ?? 1;
  const { px, py } = pixels({ x: series.x, y: series.y }, chart.frame());
  const drawn = new Set(); // pixels
  for (let i = 0; i < px.length; i += 1) {
    const place = Math.round(py[i]) * 1e5 + Math.round(px[i]);
    if (drawn.has(place) || !Number.isFinite(place)) continue;
    drawn.add(place);
    pen.beginPath();
    if (size <= 4) pen.rect(px[i] - size / 2, py[i] - size / 2, size, size);
    else pen.arc(px[i], py[i], size / 2, 0, 2 * Math.PI);
    pen.fill();
  }
  pen.globalAlpha = 1;
}

function drawArea(chart, pen, { x, y, top, colour, opacity = 1 }) {
  const { x0, kx, y0, ky } = chart.frame();
  pen.fillStyle = chart.colour(colour);
  pen.globalAlpha = opacity;
  pen.beginPath();
  for (let i = 0; i < x.length; i += 1) pen.lineTo((x[i] - x0) * kx, (y[i] - y0) * ky);
  for (let i = x.length - 1; i >= 0; i -= 1) pen.lineTo((x[i] - x0) * kx, (top[i] - y0) * ky);
  pen.fill();
  pen.globalAlpha = 1;
}

function drawCells(chart, pen, { x, y, values, colour, darkest }) {
  const { x0, kx, y0, ky } = chart.frame();
  const largest = darkest ?? values.reduce((most, value) => Math.max(most, value), 0);
  pen.fillStyle = chart.colour(colour);
  values.forEach((value, k) => {
    const [i, j] = [k % (x.length - 1), Math.floor(k / (x.length - 1))];
    if (!(value > 0)) return;
    // Edges on whole pixels, so that no seams are visible.
    const [left, right] = [i, i + 1].map((k) => Math.round((x[k] - x0) * kx));
    const [bottom, top] = [j, j + 1].map((k) => Math.round((y[k] - y0) * ky));
    pen.globalAlpha = value / largest;
    pen.fillRect(left, top, right - left, bottom - top);
  });
  pen.globalAlpha = 1;
}

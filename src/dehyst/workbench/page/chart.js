// A chart on two canvases: curves below, what follows the pointer above. Twin of the report's charts.js for live data.
import { bindGestures } from "./gestures.js";
import { drawBackdrop, drawLevels, drawMarks, drawSeries } from "./layers.js";
import { digits, extent, ticks, written } from "./numbers.js";
import { nearest } from "./thinning.js";

const MARGIN = { left: 62, right: 16, top: 10, bottom: 40 };
const TITLE = 32; // pixels for the title of the upright axis, and the gap beside its numbers
const REST = 150; // milliseconds after the last movement until all is drawn finely
const REACH = 40; // pixels from the pointer to a sample that is read out

export class Chart {
  // `readout` is called with a sentence about the sample under the pointer, or "".
  constructor(holder, { label, readout = () => {}, moved = () => {} }) {
    this.holder = holder;
    this.base = canvasIn(holder, { "aria-hidden": "true" });
    this.top = canvasIn(holder, { tabindex: "0", role: "img", "aria-label": label });
    this.readout = readout;
    this.moved = moved;
    this.overlays = [];
    this.spec = { x: {}, y: {}, series: [] };
    this.home = { x: [0, 1], y: [0, 1] };
    this.view = this.home;
    this.frames = 0;
    this.nearest = null;
    this.drag = null;
    bindGestures(this);
    new ResizeObserver(() => this.request()).observe(holder);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.request());
  }

  // Show other curves. The view stays if the person moved it and `keep` is set.
  set(spec, { keep = false } = {}) {
    const moved = this.view !== this.home;
    this.spec = spec;
    const visible = spec.series.filter((one) => !one.hidden);
    this.home = {
      x: spec.x.range ?? extent(visible.map((one) => one.x), 0.02),
      y: spec.y.range ?? extent([...visible.map((one) => one.y), ...(spec.levels ?? []).map((one) => [one.value]), spec.band ?? []], 0.06),
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
    this.moving = true;
    clearTimeout(this.rest);
    this.rest = setTimeout(() => {
      this.moving = false;
      this.request();
    }, REST);
    this.request();
  }

  request() {
    this.asked ??= requestAnimationFrame(() => {
      this.asked = undefined;
      this.draw();
    });
  }

  requestTop() {
    this.askedTop ??= requestAnimationFrame(() => {
      this.askedTop = undefined;
      this.drawTop();
    });
  }

  measure() {
    const box = { width: this.holder.clientWidth, height: this.holder.clientHeight };
    this.area = {
      left: MARGIN.left,
      top: MARGIN.top,
      width: Math.max(box.width - MARGIN.left - MARGIN.right, 20),
      height: Math.max(box.height - MARGIN.top - MARGIN.bottom, 20),
    };
    this.scale = window.devicePixelRatio || 1;
    for (const canvas of [this.base, this.top]) {
      const [width, height] = [Math.round(box.width * this.scale), Math.round(box.height * this.scale)];
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    }
    const style = getComputedStyle(this.holder);
    this.font = `12px ${style.fontFamily}`;
    const wide = this.widest() + TITLE;
    if (wide > MARGIN.left) {
      this.area.left = wide;
      this.area.width = Math.max(box.width - wide - MARGIN.right, 20);
    }
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim() || "#888";
  }

  // Pixels that the widest number of the upright axis takes.
  widest() {
    const pen = this.base.getContext("2d");
    pen.font = this.font;
    const up = ticks(...this.view.y, this.area.height / 45);
    return Math.max(0, ...up.values.map((value) => pen.measureText(written(value, up.decimals)).width));
  }

  pen(canvas) {
    const pen = canvas.getContext("2d");
    pen.setTransform(this.scale, 0, 0, this.scale, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.font = this.font;
    return pen;
  }

  // Values to pixels of the area.
  frame() {
    const { x, y } = this.view;
    const { width, height } = this.area;
    return { x0: x[0], kx: width / (x[1] - x[0]), y0: y[1], ky: -height / (y[1] - y[0]), width, height };
  }

  px(value) {
    const frame = this.frame();
    return this.area.left + (value - frame.x0) * frame.kx;
  }

  py(value) {
    const frame = this.frame();
    return this.area.top + (value - frame.y0) * frame.ky;
  }

  vx(pixel) {
    const frame = this.frame();
    return frame.x0 + (pixel - this.area.left) / frame.kx;
  }

  vy(pixel) {
    const frame = this.frame();
    return frame.y0 + (pixel - this.area.top) / frame.ky;
  }

  draw() {
    if (this.holder.clientWidth === 0) return;
    const began = performance.now();
    this.measure();
    const pen = this.pen(this.base);
    if (!this.spec.x.label) return;
    this.axes(pen);
    pen.save();
    pen.beginPath();
    pen.rect(this.area.left, this.area.top, this.area.width, this.area.height);
    pen.clip();
    pen.translate(this.area.left, this.area.top);
    drawBackdrop(this, pen);
    for (const one of this.spec.series) if (!one.hidden) drawSeries(this, pen, one);
    drawMarks(this, pen);
    drawLevels(this, pen);
    pen.restore();
    this.frames += 1;
    this.took = performance.now() - began;
    this.drawTop();
  }

  drawTop() {
    if (!this.area) return;
    const pen = this.pen(this.top);
    const { left, top, width, height } = this.area;
    pen.save();
    pen.beginPath();
    pen.rect(left, top, width, height);
    pen.clip();
    for (const overlay of this.overlays) overlay(pen);
    if (this.nearest) {
      pen.strokeStyle = this.colour("ink");
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.arc(this.px(this.nearest.x), this.py(this.nearest.y), 5, 0, 2 * Math.PI);
      pen.stroke();
    }
    if (this.box) {
      pen.fillStyle = this.colour("band");
      pen.strokeStyle = this.colour("ink");
      pen.lineWidth = 1;
      const sides = [this.box.left, this.box.top, this.box.right - this.box.left, this.box.bottom - this.box.top];
      pen.fillRect(...sides);
      pen.strokeRect(...sides);
    }
    pen.restore();
  }

  axes(pen) {
    const { area, spec, view } = this;
    const across = ticks(...view.x, area.width / 80);
    const up = ticks(...view.y, area.height / 45);
    pen.lineWidth = 1;
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const value of across.values) {
      const x = Math.round(this.px(value)) + 0.5;
      this.rule(pen, x, area.top, x, area.top + area.height);
      this.text(pen, written(value, across.decimals), x, area.top + area.height + 6);
    }
    this.text(pen, spec.x.label ?? "", area.left + area.width / 2, area.top + area.height + 23);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of up.values) {
      const y = Math.round(this.py(value)) + 0.5;
      this.rule(pen, area.left, y, area.left + area.width, y);
      this.text(pen, written(value, up.decimals), area.left - 6, y);
    }
    pen.save();
    pen.translate(12, area.top + area.height / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    this.text(pen, spec.y.label ?? "", 0, 0);
    pen.restore();
  }

  rule(pen, x0, y0, x1, y1, colour = "grid") {
    pen.strokeStyle = this.colour(colour);
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  }

  text(pen, words, x, y) {
    pen.fillStyle = this.colour("ink");
    pen.fillText(words, x, y);
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
    for (const one of this.spec.series) {
      if (one.hidden || one.silent) continue;
      const hit = nearest(one.x, one.y, frame, spot, REACH, one.rising);
      if (hit && (best === null || hit.away < best.away)) best = { ...hit, one };
    }
    this.nearest = best && { x: best.one.x[best.index], y: best.one.y[best.index], name: best.one.name };
    this.readout(this.nearest ? this.sentence(this.nearest) : "");
    this.requestTop();
  }

  sentence({ x, y, name }) {
    const value = (number, [low, high], unit) => `${written(number, digits((high - low) / 2000))} ${unit}`;
    const { spec, view } = this;
    return [name, value(x, view.x, spec.x.unit), value(y, view.y, spec.y.unit)].filter(Boolean).join(" \u00b7 ");
  }
}

function canvasIn(holder, attributes) {
  const canvas = document.createElement("canvas");
  for (const [name, value] of Object.entries(attributes)) canvas.setAttribute(name, value);
  holder.append(canvas);
  return canvas;
}

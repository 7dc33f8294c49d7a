// Draws the charts of a page on canvases: zoom by dragging, read-out under the pointer. Loads nothing.
(() => {
  "use strict";
  const MARGIN = { left: 58, right: 14, top: 10, bottom: 38 };
  const RIGHT_AXIS = 60;
  const NEAR = 40; // pixels from the pointer to a sample that is read out
  const LEAST_DRAG = 6;
  const MINUS = "\u2212";

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;

  // A column is 32-bit floats, or 16-bit steps from its lowest value with one code for a missing value.
  function column(stored) {
    if (stored.floats !== undefined) return new Float32Array(bytes(stored.floats));
    const codes = new Uint16Array(bytes(stored.steps));
    return Float64Array.from(codes, (code) => (code === 65535 ? NaN : stored.low + stored.step * code));
  }

  function digits(step, more = 0) {
    return Math.max(0, Math.min(12, more - Math.floor(Math.log10(step) + 1e-9)));
  }

  function written(value, decimals) {
    const text = Math.abs(value) >= 1e6 ? value.toExponential(3) : value.toFixed(decimals);
    return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text.replaceAll("-", MINUS);
  }

  function ticks(low, high, most) {
    const rough = (high - low) / Math.max(most, 1);
    const power = 10 ** Math.floor(Math.log10(rough));
    const factor = [1, 2, 2.5, 5, 10].find((one) => one * power >= rough * (1 - 1e-9)) ?? 10;
    const step = factor * power;
    const values = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) values.push(k * step);
    return { values, decimals: digits(step, factor === 2.5 ? 1 : 0) };
  }

  function extent(columns, pad) {
    let low = Infinity;
    let high = -Infinity;
    for (const values of columns) {
      for (const value of values) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (!(low < high)) {
      const middle = Number.isFinite(low) ? low : 0;
      return [middle - 1, middle + 1];
    }
    return [low - pad * (high - low), high + pad * (high - low)];
  }

  class Chart {
    constructor(canvas, spec, columns) {
      this.canvas = canvas;
      this.spec = spec;
      this.series = spec.series.map((one) => ({ ...one, x: columns[one.x], y: columns[one.y] }));
      this.readout = canvas.parentElement.querySelector("output");
      this.reset = canvas.parentElement.querySelector("button");
      this.home = {
        x: spec.x.range ?? extent(this.series.map((one) => one.x), 0.02),
        y: spec.y.range ?? extent(this.series.map((one) => one.y), 0.06),
      };
      this.view = this.home;
      this.drag = null;
      this.nearest = null;
      canvas.addEventListener("pointerdown", (event) => this.begin(event));
      canvas.addEventListener("pointermove", (event) => this.move(event));
      canvas.addEventListener("pointerup", (event) => this.end(event));
      canvas.addEventListener("pointercancel", () => this.cancel());
      canvas.addEventListener("pointerleave", () => this.leave());
      canvas.addEventListener("dblclick", () => this.show(this.home));
      canvas.addEventListener("keydown", (event) => this.key(event));
      this.reset.addEventListener("click", () => this.show(this.home));
    }

    show(view) {
      const wide = ([low, high]) => high - low > 1e-9 * Math.max(Math.abs(low), Math.abs(high), 1e-12);
      if (!wide(view.x) || !wide(view.y)) return;
      this.view = view;
      this.reset.hidden = view === this.home;
      this.draw();
    }

    measure() {
      const box = this.canvas.getBoundingClientRect();
      const right = this.spec.y2 ? RIGHT_AXIS : MARGIN.right;
      this.area = {
        left: MARGIN.left,
        top: MARGIN.top,
        width: Math.max(box.width - MARGIN.left - right, 20),
        height: Math.max(box.height - MARGIN.top - MARGIN.bottom, 20),
      };
      const scale = Math.max(window.devicePixelRatio || 1, 2);
      this.canvas.width = Math.round(box.width * scale);
      this.canvas.height = Math.round(box.height * scale);
      this.pen = this.canvas.getContext("2d");
      this.pen.setTransform(scale, 0, 0, scale, 0, 0);
      this.pen.clearRect(0, 0, box.width, box.height);
    }

    px(value) {
      const [low, high] = this.view.x;
      return this.area.left + ((value - low) / (high - low)) * this.area.width;
    }

    py(value) {
      const [low, high] = this.view.y;
      return this.area.top + ((high - value) / (high - low)) * this.area.height;
    }

    vx(pixel) {
      const [low, high] = this.view.x;
      return low + ((pixel - this.area.left) / this.area.width) * (high - low);
    }

    vy(pixel) {
      const [low, high] = this.view.y;
      return high - ((pixel - this.area.top) / this.area.height) * (high - low);
    }

    draw() {
      this.measure();
      const style = getComputedStyle(this.canvas);
      this.colour = (name) => style.getPropertyValue(`--${name}`).trim() || "#888";
      const { pen, area } = this;
      pen.font = `12px ${style.fontFamily}`;
      this.axes();
      pen.save();
      pen.beginPath();
      pen.rect(area.left, area.top, area.width, area.height);
      pen.clip();
      this.backdrop();
      for (const one of this.series) (one.kind === "points" ? this.points : this.line).call(this, one);
      this.foreground();
      pen.restore();
    }

    axes() {
      const { pen, area, spec } = this;
      pen.lineWidth = 1;
      const across = ticks(...this.view.x, area.width / 80);
      const up = ticks(...this.view.y, area.height / 45);
      pen.textAlign = "center";
      pen.textBaseline = "top";
      for (const value of across.values) {
        this.rule(this.px(value), area.top, this.px(value), area.top + area.height);
        this.text(written(value, across.decimals), this.px(value), area.top + area.height + 5);
      }
      this.text(spec.x.label, area.left + area.width / 2, area.top + area.height + 21);
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      for (const value of up.values) {
        this.rule(area.left, this.py(value), area.left + area.width, this.py(value));
        this.text(written(value, up.decimals), area.left - 6, this.py(value));
      }
      this.upright(spec.y.label, 11);
      if (!spec.y2) return;
      const { factor, label } = spec.y2;
      const right = ticks(factor * this.view.y[0], factor * this.view.y[1], area.height / 45);
      pen.textAlign = "left";
      for (const value of right.values) {
        this.text(written(value, right.decimals), area.left + area.width + 6, this.py(value / factor));
      }
      this.upright(label, area.left + area.width + RIGHT_AXIS - 11);
    }

    rule(x0, y0, x1, y1, colour = "grid") {
      this.pen.strokeStyle = this.colour(colour);
      this.pen.beginPath();
      this.pen.moveTo(x0, y0);
      this.pen.lineTo(x1, y1);
      this.pen.stroke();
    }

    text(words, x, y) {
      this.pen.fillStyle = this.colour("ink");
      this.pen.fillText(words, x, y);
    }

    upright(words, x) {
      const { pen, area } = this;
      pen.save();
      pen.translate(x, area.top + area.height / 2);
      pen.rotate(-Math.PI / 2);
      pen.textAlign = "center";
      pen.textBaseline = "middle";
      this.text(words, 0, 0);
      pen.restore();
    }

    backdrop() {
      const { pen, area, spec } = this;
      pen.fillStyle = this.colour("shade");
      for (const [from, to] of spec.shaded ?? []) {
        const width = Math.max(this.px(to) - this.px(from), 1);
        pen.fillRect(this.px(from), area.top, width, area.height);
      }
      if (spec.band) {
        pen.fillStyle = this.colour("band");
        const [low, high] = spec.band;
        pen.fillRect(area.left, this.py(high), area.width, this.py(low) - this.py(high));
      }
      if (spec.zero) this.rule(area.left, this.py(0), area.left + area.width, this.py(0), "ink");
    }

    line(one) {
      const { pen } = this;
      pen.strokeStyle = this.colour(one.colour);
      pen.globalAlpha = one.opacity ?? 1;
      pen.lineWidth = one.width ?? 1.4;
      pen.lineJoin = "round";
      pen.beginPath();
      let drawing = false;
      for (let i = 0; i < one.x.length; i += 1) {
        const there = Number.isFinite(one.x[i]) && Number.isFinite(one.y[i]);
        if (there && drawing) pen.lineTo(this.px(one.x[i]), this.py(one.y[i]));
        else if (there) pen.moveTo(this.px(one.x[i]), this.py(one.y[i]));
        drawing = there;
      }
      pen.stroke();
      pen.globalAlpha = 1;
    }

    points(one) {
      const { pen } = this;
      const size = one.width ?? 1.6;
      pen.fillStyle = this.colour(one.colour);
      pen.globalAlpha = one.opacity ?? 1;
      for (let i = 0; i < one.x.length; i += 1) {
        if (size > 4) {
          pen.beginPath();
          pen.arc(this.px(one.x[i]), this.py(one.y[i]), size / 2, 0, 2 * Math.PI);
          pen.fill();
        } else {
          pen.fillRect(this.px(one.x[i]) - size / 2, this.py(one.y[i]) - size / 2, size, size);
        }
      }
      pen.globalAlpha = 1;
    }

    foreground() {
      const { pen } = this;
      if (this.nearest) {
        pen.strokeStyle = this.colour("ink");
        pen.lineWidth = 1.5;
        pen.beginPath();
        pen.arc(this.px(this.nearest.x), this.py(this.nearest.y), 5, 0, 2 * Math.PI);
        pen.stroke();
      }
      if (this.drag?.to) {
        const box = this.box();
        pen.fillStyle = this.colour("band");
        pen.fillRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
        pen.strokeStyle = this.colour("ink");
        pen.lineWidth = 1;
        pen.strokeRect(box.left, box.top, box.right - box.left, box.bottom - box.top);
      }
    }

    // What a drag marks: all heights if it is nearly level, all of the abscissa if it is nearly upright.
    box() {
      const { from, to } = this.drag;
      const { left, top, width, height } = this.area;
      const within = (value, low, size) => Math.min(Math.max(value, low), low + size);
      const xs = [from.x, to.x].map((x) => within(x, left, width)).sort((a, b) => a - b);
      const ys = [from.y, to.y].map((y) => within(y, top, height)).sort((a, b) => a - b);
      const level = ys[1] - ys[0] < 2 * LEAST_DRAG;
      const steep = xs[1] - xs[0] < 2 * LEAST_DRAG;
      return {
        left: steep && !level ? left : xs[0],
        right: steep && !level ? left + width : xs[1],
        top: level ? top : ys[0],
        bottom: level ? top + height : ys[1],
      };
    }

    place(event) {
      const box = this.canvas.getBoundingClientRect();
      return { x: event.clientX - box.left, y: event.clientY - box.top };
    }

    begin(event) {
      if (event.button !== 0) return;
      this.canvas.setPointerCapture(event.pointerId);
      this.drag = { from: this.place(event), to: null };
    }

    move(event) {
      const at = this.place(event);
      if (this.drag) {
        const { from } = this.drag;
        this.drag.to = Math.hypot(at.x - from.x, at.y - from.y) > LEAST_DRAG ? at : null;
        this.nearest = null;
      } else {
        this.read(at);
      }
      this.draw();
    }

    end() {
      const marked = this.drag?.to ? this.box() : null;
      this.drag = null;
      if (marked === null) return;
      this.show({
        x: [this.vx(marked.left), this.vx(marked.right)],
        y: [this.vy(marked.bottom), this.vy(marked.top)],
      });
    }

    cancel() {
      this.drag = null;
      this.draw();
    }

    leave() {
      if (this.drag) return;
      this.nearest = null;
      this.readout.textContent = "";
      this.draw();
    }

    key(event) {
      const { x, y } = this.view;
      const centred = ([low, high], factor) => {
        const middle = (low + high) / 2;
        return [middle - (factor * (high - low)) / 2, middle + (factor * (high - low)) / 2];
      };
      const moved = ([low, high], share) => [low + share * (high - low), high + share * (high - low)];
      const views = {
        "+": { x: centred(x, 0.7), y: centred(y, 0.7) },
        "-": { x: centred(x, 1 / 0.7), y: centred(y, 1 / 0.7) },
        ArrowLeft: { x: moved(x, -0.1), y },
        ArrowRight: { x: moved(x, 0.1), y },
        ArrowUp: { x, y: moved(y, 0.1) },
        ArrowDown: { x, y: moved(y, -0.1) },
        Escape: this.home,
      };
      if (!(event.key in views) || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      this.show(views[event.key]);
    }

    read(at) {
      let best = NEAR * NEAR;
      this.nearest = null;
      for (const one of this.series) {
        for (let i = 0; i < one.x.length; i += 1) {
          const away = (this.px(one.x[i]) - at.x) ** 2 + (this.py(one.y[i]) - at.y) ** 2;
          if (away < best) {
            best = away;
            this.nearest = { x: one.x[i], y: one.y[i], name: one.names?.[i] ?? one.name };
          }
        }
      }
      this.readout.textContent = this.nearest ? this.sentence(this.nearest) : "";
    }

    sentence({ x, y, name }) {
      const { spec, view } = this;
      const value = (number, [low, high], unit) => `${written(number, digits((high - low) / 2000))} ${unit}`;
      const parts = [name, value(x, view.x, spec.x.unit), value(y, view.y, spec.y.unit)];
      const second = spec.y2 && value(y * spec.y2.factor, view.y.map((one) => one * spec.y2.factor), spec.y2.unit);
      return parts.filter(Boolean).join(" \u00b7 ") + (second ? ` (${second})` : "");
    }
  }

  const { columns, charts } = JSON.parse(document.getElementById("chart-data").textContent);
  const decoded = columns.map(column);
  const drawn = [...document.querySelectorAll("canvas[data-chart]")].map(
    (canvas) => new Chart(canvas, charts[Number(canvas.dataset.chart)], decoded),
  );
  const redraw = () => drawn.forEach((chart) => chart.draw());
  const paper = (on) => () => {
    document.documentElement.classList.toggle("paper", on);
    redraw();
  };
  redraw();
  window.addEventListener("resize", redraw);
  window.addEventListener("beforeprint", paper(true));
  window.addEventListener("afterprint", paper(false));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
})();

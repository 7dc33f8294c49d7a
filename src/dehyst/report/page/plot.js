// Draws lines on a canvas, in the colours of the page; for charts that change while somebody drags.
const MARGIN = { left: 58, right: 14, top: 10, bottom: 38 };

/** Return a number as text, with so many decimals and a minus sign. */
export function written(value, decimals) {
  const text = value.toFixed(Math.max(0, Math.min(12, decimals)));
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text.replaceAll("-", "\u2212");
}

/** Return a number as text with three significant digits. */
export function short(value) {
  return value === 0 ? "0" : written(value, 2 - Math.floor(Math.log10(Math.abs(value)) + 1e-9));
}

function ticks([low, high], most) {
  const rough = (high - low) / Math.max(most, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const factor = [1, 2, 2.5, 5, 10].find((one) => one * power >= rough * (1 - 1e-9)) ?? 10;
  const step = factor * power;
  const values = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) values.push(k * step);
  return { values, decimals: (factor === 2.5 ? 1 : 0) - Math.floor(Math.log10(step) + 1e-9) };
}

/** Return the range of columns of numbers, a little wider. */
export function extent(columns, pad = 0.06) {
  let low = Infinity;
  let high = -Infinity;
  for (const column of columns) {
    for (const value of column) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  const more = high > low ? pad * (high - low) : Math.max(Math.abs(high), 1) * 1e-3;
  return [low - more, high + more];
}

/** A canvas with two axes. */
export class Plot {
  constructor(canvas, across, up) {
    this.canvas = canvas;
    this.labels = { across, up };
    this.x = this.y = [0, 1];
  }

  /** Return the pixel of a value, and the value of a pixel. */
  px(value) {
    return this.area.left + ((value - this.x[0]) / (this.x[1] - this.x[0])) * this.area.width;
  }

  py(value) {
    return this.area.top + ((this.y[1] - value) / (this.y[1] - this.y[0])) * this.area.height;
  }

  vx(pixel) {
    return this.x[0] + ((pixel - this.area.left) / this.area.width) * (this.x[1] - this.x[0]);
  }

  vy(pixel) {
    return this.y[1] - ((pixel - this.area.top) / this.area.height) * (this.y[1] - this.y[0]);
  }

  /** Draw ranges, a band [low, high], levels and lines {x, y, colour, width, dash, dots}; only samples with dots are marked. */
  draw({ x, y, band = null, levels = [], lines }) {
    Object.assign(this, { x, y });
    this.#measure();
    this.#axes();
    const { pen, area } = this;
    pen.save();
    pen.beginPath();
    pen.rect(area.left, area.top, area.width, area.height);
    pen.clip();
    if (band) {
      pen.fillStyle = this.colour("band");
      pen.fillRect(area.left, this.py(band[1]), area.width, this.py(band[0]) - this.py(band[1]));
    }
    for (const level of levels) this.#rule(area.left, this.py(level), area.left + area.width, this.py(level), "line");
    for (const line of lines) this.#line(line);
    pen.restore();
  }

  #measure() {
    const box = this.canvas.getBoundingClientRect();
    const style = getComputedStyle(this.canvas);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim() || "#888";
    this.area = {
      left: MARGIN.left,
      top: MARGIN.top,
      width: Math.max(box.width - MARGIN.left - MARGIN.right, 20),
      height: Math.max(box.height - MARGIN.top - MARGIN.bottom, 20),
    };
    const scale = Math.max(window.devicePixelRatio || 1, 2);
    this.canvas.width = Math.round(box.width * scale);
    this.canvas.height = Math.round(box.height * scale);
    this.pen = this.canvas.getContext("2d");
    this.pen.setTransform(scale, 0, 0, scale, 0, 0);
    this.pen.font = `12px ${style.fontFamily}`;
    this.pen.lineJoin = "round";
  }

  #axes() {
    const { pen, area } = this;
    const across = ticks(this.x, area.width / 80);
    const up = ticks(this.y, area.height / 40);
    const bottom = area.top + area.height;
    pen.lineWidth = 1;
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const value of across.values) {
      this.#rule(this.px(value), area.top, this.px(value), bottom, "grid");
      this.#text(written(value, across.decimals), this.px(value), bottom + 5);
    }
    this.#text(this.labels.across, area.left + area.width / 2, bottom + 21);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of up.values) {
      this.#rule(area.left, this.py(value), area.left + area.width, this.py(value), "grid");
      this.#text(written(value, up.decimals), area.left - 6, this.py(value));
    }
    pen.save();
    pen.translate(11, area.top + area.height / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    this.#text(this.labels.up, 0, 0);
    pen.restore();
  }

  #rule(x0, y0, x1, y1, colour) {
    this.pen.strokeStyle = this.colour(colour);
    this.pen.beginPath();
    this.pen.moveTo(x0, y0);
    this.pen.lineTo(x1, y1);
    this.pen.stroke();
  }

  #text(words, x, y) {
    this.pen.fillStyle = this.colour("ink");
    this.pen.fillText(words, x, y);
  }

  #line({ x, y, colour, width = 1.6, dash = [], dots = null }) {
    const { pen } = this;
    pen.strokeStyle = pen.fillStyle = this.colour(colour);
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.beginPath();
    for (let i = 0; i < x.length; i += 1) pen.lineTo(this.px(x[i]), this.py(y[i]));
    if (!dots) pen.stroke();
    pen.setLineDash([]);
    for (let i = 0; dots && i < x.length; i += 1) {
      if (dots[i]) pen.fillRect(this.px(x[i]) - width, this.py(y[i]) - width, 2 * width, 2 * width);
    }
  }
}

// Thins a curve to what a raster of pixels can show, in the order of the path, and inks it.
//
// `frame` maps values to pixels, px = (x - x0) kx and py = (y - y0) ky, on an area of width x height pixels. The result
// is a list of vertices; one whose `pen` is 0 begins a new stroke.
const NEAR = 8; // cells: a step this short is left out where both of its ends are inked already
const FULL = 2; // visits after which a cell counts as inked
const TABLE = 1 << 17;

class Vertices {
  px = [];
  py = [];
  pen = [];

  add(x, y, pen) {
    this.px.push(x);
    this.py.push(y);
    this.pen.push(pen);
  }

  get count() {
    return this.px.length;
  }
}

// Where a point lies of an area: 0 inside, otherwise bits for left, right, above and below.
const side = (x, y, width, height) =>
  (x < 0 ? 1 : x > width ? 2 : 0) | (y < 0 ? 4 : y > height ? 8 : 0);

let inked = new Uint8Array(0);
const drawn = new Int32Array(TABLE);

// A loop or any other path: one vertex a pixel cell that it enters; a step that is drawn already is left out.
export function thinPath(x, y, frame) {
  const { x0, kx, y0, ky, width, height } = frame;
  const across = Math.ceil(width) + 1;
  const cells = across * (Math.ceil(height) + 1);
  if (inked.length < cells) inked = new Uint8Array(cells);
  else inked.fill(0, 0, cells);
  drawn.fill(-1);
  const out = new Vertices();
  let held = false; // is there a previous point?
  let px = 0;
  let py = 0;
  let cell = -1;
  let where = 0;
  let down = false; // is the previous point the last vertex?
  for (let i = 0; i < x.length; i += 1) {
    const nx = (x[i] - x0) * kx;
    const ny = (y[i] - y0) * ky;
    if (!(nx - nx === 0 && ny - ny === 0)) {
      held = false;
      down = false;
      continue;
    }
    const there = side(nx, ny, width, height);
    const at = there === 0 ? (ny | 0) * across + (nx | 0) : -1;
    if (held && at >= 0 && at === cell) continue;
    if (held && (where & there) === 0 && !known(cell, at, across)) {
      if (!down) out.add(px, py, 0);
      out.add(nx, ny, 1);
      down = true;
    } else {
      down = false;
      if (!held && there === 0) {
        out.add(nx, ny, 0);
        down = true;
      }
    }
    if (at >= 0 && inked[at] < 255) inked[at] += 1;
    px = nx;
    py = ny;
    cell = at;
    where = there;
    held = true;
  }
  return out;
}

// Is the step between two cells on the canvas already?
function known(from, to, across) {
  if (from < 0 || to < 0) return false;
  if (inked[from] > FULL && inked[to] > FULL) {
    const level = Math.abs((from % across) - (to % across));
    const upright = Math.abs(((from / across) | 0) - ((to / across) | 0));
    if (level <= NEAR && upright <= NEAR) return true;
  }
  const low = from < to ? from : to;
  const high = from < to ? to : from;
  const key = (Math.imul(low, 0x9e3779b1) ^ Math.imul(high, 0x85ebca6b)) | 0;
  const slot = (key ^ (key >>> 15)) & (TABLE - 1);
  if (drawn[slot] === key) return true;
  drawn[slot] = key;
  return false;
}

// A curve over a rising abscissa: first, lowest, highest and last of each column of pixels.
export function thinTime(x, y, frame) {
  const { x0, kx, y0, ky, width } = frame;
  const from = Math.max(0, before(x, x0) - 1);
  const to = Math.min(x.length, before(x, x0 + width / kx) + 1);
  const out = new Vertices();
  let pen = 0;
  for (let i = from; i < to; ) {
    const column = Math.floor((x[i] - x0) * kx);
    let [low, high, end] = [i, i, i];
    let next = i + 1;
    for (; next < to && (x[next] - x0) * kx < column + 1; next += 1) {
      if (!(y[low] <= y[next])) low = next;
      if (!(y[high] >= y[next])) high = next;
      end = next;
    }
    const picks = low < high ? [i, low, high, end] : [i, high, low, end];
    for (let k = 0; k < 4; k += 1) {
      const one = picks[k];
      if (k > 0 && one === picks[k - 1]) continue;
      const ny = (y[one] - y0) * ky;
      if (ny - ny === 0) {
        out.add((x[one] - x0) * kx, ny, pen);
        pen = 1;
      } else {
        pen = 0;
      }
    }
    i = next;
  }
  return out;
}

// The number of the first of rising values that is not below `value`.
export function before(values, value) {
  let [low, high] = [0, values.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}

// The sample nearest to a pixel within `reach` pixels, or -1; over a rising abscissa only near columns are searched.
export function nearest(x, y, frame, at, reach, rising) {
  const { x0, kx, y0, ky } = frame;
  const from = rising ? before(x, x0 + (at.x - reach) / kx) : 0;
  const to = rising ? before(x, x0 + (at.x + reach) / kx) : x.length;
  let best = reach * reach;
  let found = -1;
  for (let i = from; i < to; i += 1) {
    const dx = (x[i] - x0) * kx - at.x;
    const dy = (y[i] - y0) * ky - at.y;
    const away = dx * dx + dy * dy;
    if (away < best) {
      best = away;
      found = i;
    }
  }
  return found < 0 ? null : { index: found, away: best };
}

// Long curves are inked here: the browser's path machinery takes seconds for 1e5 vertices without a graphics card.
let ink = new Uint8Array(0);
let plane = null; // a canvas on which the inked pixels get their colour

// Ink the strokes of `vertices` on columns x rows pixels: 0 to 255 a pixel, the coverage by a line `width` wide.
export function inkLines(vertices, columns, rows, scale, width) {
  if (ink.length < columns * rows) ink = new Uint8Array(columns * rows);
  else ink.fill(0, 0, columns * rows);
  const { px, py, pen, count } = vertices;
  const half = Math.max(0.5, 0.5 * scale * width);
  for (let i = 1; i < count; i += 1) {
    if (pen[i]) {
      const [x0, y0, x1, y1] = [px[i - 1] * scale, py[i - 1] * scale, px[i] * scale, py[i] * scale];
      if (Math.abs(x1 - x0) >= Math.abs(y1 - y0)) inkSegment(x0, y0, x1, y1, columns, rows, 1, columns, half);
      else inkSegment(y0, x0, y1, x1, rows, columns, columns, 1, half);
    }
  }
  return ink;
}

// One segment, with its longer axis as u: pixel (u, v) is at u * stepU + v * stepV.
function inkSegment(u0, v0, u1, v1, us, vs, stepU, stepV, half) {
  const slope = u1 === u0 ? 0 : (v1 - v0) / (u1 - u0);
  const reach = half * Math.sqrt(1 + slope * slope) + 0.5;
  const low = u0 < u1 ? u0 : u1;
  const high = u0 < u1 ? u1 : u0;
  const first = low > 0 ? low | 0 : 0;
  const last = high < us - 1 ? high | 0 : us - 1;
  for (let u = first; u <= last && high >= 0; u += 1) {
    const middle = u + 0.5 < low ? low : u + 0.5 > high ? high : u + 0.5;
    const centre = v0 + slope * (middle - u0);
    let from = Math.floor(centre - reach + 0.5);
    let to = Math.floor(centre + reach - 0.5);
    if (from < 0) from = 0;
    if (to > vs - 1) to = vs - 1;
    for (let v = from; v <= to; v += 1) {
      const away = v + 0.5 > centre ? v + 0.5 - centre : centre - v - 0.5;
      const cover = reach - away;
      const value = cover >= 1 ? 255 : cover > 0 ? (255 * cover) | 0 : 0;
      const at = u * stepU + v * stepV;
      if (ink[at] < value) ink[at] = value;
    }
  }
}

// Draw strokes of an area on a canvas whose origin is the area's corner, in a colour such as "#0072b2".
export function paintLines(context, vertices, area, scale, width, colour) {
  const columns = Math.ceil(area.width * scale);
  const rows = Math.ceil(area.height * scale);
  const cover = inkLines(vertices, columns, rows, scale, width);
  if (plane?.width !== columns || plane?.height !== rows) plane = new OffscreenCanvas(columns, rows);
  const picture = new ImageData(columns, rows);
  const pixels = new Uint32Array(picture.data.buffer);
  const base = packed(colour);
  for (let i = 0; i < pixels.length; i += 1) if (cover[i]) pixels[i] = base | (cover[i] << 24);
  plane.getContext("2d").putImageData(picture, 0, 0);
  context.drawImage(plane, 0, 0, columns / scale, rows / scale);
}

// Red, green and blue of a colour in hexadecimal, in the order of the bytes of a picture.
function packed(colour) {
  const hex = colour.length === 4 ? [...colour.slice(1)].map((digit) => digit + digit).join("") : colour.slice(1, 7);
  const number = Number.parseInt(hex, 16);
  return ((number & 255) << 16) | (number & 0xff00) | (number >> 16);
}

// Curves of millions of samples on a raster of pixels.
//
// `frame` maps values to pixels, px = (x - x0) kx and py = (y - y0) ky, on an area of width x height pixels.

// The pixels of a curve as columns px and py; of one whose x is `rising` only what the columns of pixels can show.
export function pixels({ x, y, rising }, frame) {
  const { x0, kx, y0, ky } = frame;
  const picked = rising ? picks(x, y, frame) : null;
  const count = picked ? picked.length : x.length;
  const [px, py] = [new Float64Array(count), new Float64Array(count)];
  for (let k = 0; k < count; k += 1) {
    const i = picked ? picked[k] : k;
    px[k] = (x[i] - x0) * kx;
    py[k] = (y[i] - y0) * ky;
  }
  return { px, py };
}

// First, lowest, highest and last sample of each column of pixels in view, and one neighbour on each side of the view.
function picks(x, y, { x0, kx, width }) {
  const from = Math.max(0, before(x, x0) - 1);
  const to = Math.min(x.length, before(x, x0 + width / kx) + 1);
  const picked = [];
  for (let i = from; i < to; ) {
    const column = Math.floor((x[i] - x0) * kx);
    let [low, high, next] = [i, i, i + 1];
    for (; next < to && (x[next] - x0) * kx < column + 1; next += 1) {
      if (!(y[low] <= y[next])) low = next;
      if (!(y[high] >= y[next])) high = next;
    }
    picked.push(...new Set([i, Math.min(low, high), Math.max(low, high), next - 1]));
    i = next;
  }
  return picked;
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

// The sample nearest to a pixel within `reach` pixels, or null; over a rising abscissa only near columns are searched.
export function nearest({ x, y, rising }, { x0, kx, y0, ky }, at, reach) {
  const from = rising ? before(x, x0 + (at.x - reach) / kx) : 0;
  const to = rising ? before(x, x0 + (at.x + reach) / kx) : x.length;
  let [best, found] = [reach * reach, -1];
  for (let i = from; i < to; i += 1) {
    const dx = (x[i] - x0) * kx - at.x;
    const dy = (y[i] - y0) * ky - at.y;
    const away = dx * dx + dy * dy;
    if (away < best) [best, found] = [away, i];
  }
  return found < 0 ? null : { index: found, away: best };
}

// Long curves are inked here: the browser's path machinery takes seconds for 1e5 vertices without a graphics card.
const [NEAR, SHORT] = [0.75, 3]; // pixels: shorter steps are joined, or left out between pixels that are inked

// Ink a curve, cut where it is not finite, on columns x rows pixels, `scale` of them for one of the frame: 0 to 255 for
// each, the coverage by a line `width` wide.
export function inked({ px, py }, columns, rows, scale, width) {
  const ink = new Uint8Array(columns * rows);
  const half = Math.max(0.5, 0.5 * scale * width);
  let [x0, y0, before] = [NaN, NaN, false];
  for (let i = 0; i < px.length; i += 1) {
    const x1 = px[i] * scale;
    const y1 = py[i] * scale;
    const level = Math.abs(x1 - x0);
    const upright = Math.abs(y1 - y0);
    if (level + upright < NEAR) continue;
    const full = ink[(y1 | 0) * columns + (x1 | 0)] === 255;
    // A short step between two pixels that are inked changes nothing.
    if (level + upright > SHORT || !full || !before) {
      if (level >= upright) inkStep(ink, x0, y0, x1, y1, columns, rows, 1, columns, half);
      else if (upright > level) inkStep(ink, y0, x0, y1, x1, rows, columns, columns, 1, half);
    }
    x0 = x1;
    y0 = y1;
    before = full;
  }
  return ink;
}

// One step, with its longer axis as u: pixel (u, v) is at u * stepU + v * stepV.
function inkStep(ink, u0, v0, u1, v1, us, vs, stepU, stepV, half) {
  const slope = u1 === u0 ? 0 : (v1 - v0) / (u1 - u0);
  const reach = half * Math.sqrt(1 + slope * slope) + 0.5;
  const [low, high] = u0 < u1 ? [u0, u1] : [u1, u0];
  const last = Math.min(Math.floor(high), us - 1);
  for (let u = Math.max(Math.floor(low), 0); u <= last; u += 1) {
    const middle = Math.min(Math.max(u + 0.5, low), high);
    const centre = v0 + slope * (middle - u0);
    const to = Math.min(Math.floor(centre + reach - 0.5), vs - 1);
    for (let v = Math.max(Math.floor(centre - reach + 0.5), 0); v <= to; v += 1) {
      const cover = Math.min(255, 255 * (reach - Math.abs(v + 0.5 - centre)));
      const at = u * stepU + v * stepV;
      if (ink[at] < cover) ink[at] = cover;
    }
  }
}

let plane = null; // a canvas on which the inked pixels get their colour

// Draw a curve on a canvas whose origin is the area's corner, in the colour of its pen.
export function paintCurve(pen, curve, area, scale) {
  const [columns, rows] = [area.width, area.height].map((size) => Math.ceil(size * scale));
  const cover = inked(curve, columns, rows, scale, pen.lineWidth);
  if (plane?.width !== columns || plane?.height !== rows) plane = new OffscreenCanvas(columns, rows);
  const picture = new ImageData(columns, rows);
  const words = new Uint32Array(picture.data.buffer);
  const [red, green, blue] = [1, 3, 5].map((at) => Number.parseInt(pen.strokeStyle.slice(at, at + 2), 16));
  const colour = (blue << 16) | (green << 8) | red;
  for (let i = 0; i < words.length; i += 1) if (cover[i]) words[i] = (cover[i] << 24) | colour;
  plane.getContext("2d").putImageData(picture, 0, 0);
  pen.drawImage(plane, 0, 0, columns / scale, rows / scale);
}

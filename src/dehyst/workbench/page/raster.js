// Inks long curves without the browser's path machinery, which takes seconds for 1e5 vertices without a graphics card.
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

// Draw the curve on a canvas whose origin is the area's corner, in a colour such as "#0072b2". The vertices are those of
// an area that is `shrink` times as large; a pixel of it has `scale` squared device pixels.
export function paintLines(context, vertices, { area, width, scale, shrink }, colour) {
  const columns = Math.ceil(area.width * scale * shrink);
  const rows = Math.ceil(area.height * scale * shrink);
  const cover = inkLines(vertices, columns, rows, scale, width);
  if (plane?.width !== columns || plane?.height !== rows) plane = new OffscreenCanvas(columns, rows);
  const picture = new ImageData(columns, rows);
  const pixels = new Uint32Array(picture.data.buffer);
  const base = packed(colour);
  for (let i = 0; i < pixels.length; i += 1) if (cover[i]) pixels[i] = base | (cover[i] << 24);
  plane.getContext("2d").putImageData(picture, 0, 0);
  context.drawImage(plane, 0, 0, columns / scale / shrink, rows / scale / shrink);
}

// Red, green and blue of a colour in hexadecimal, in the order of the bytes of a picture.
function packed(colour) {
  const hex = colour.length === 4 ? [...colour.slice(1)].map((digit) => digit + digit).join("") : colour.slice(1, 7);
  const number = Number.parseInt(hex, 16);
  return ((number & 255) << 16) | (number & 0xff00) | (number >> 16);
}

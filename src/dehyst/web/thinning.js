// Draws curves of millions of samples on a raster of pixels.
// `frame` maps values to pixels, px = (x - x0) kx and py = (y - y0) ky, on an area of width x height pixels.

// The pixels of a curve as arrays px and py. If its x is `rising`, only samples that change the picture are taken.
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

// The first, lowest, highest and last sample of each visible column of pixels, and one sample on each side of the view.
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

// The index of the first of some rising values that is not below `value`.
export function before(values, value) {
  let [low, high] = [0, values.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low;
}

// The sample nearest to a pixel, within `reach` pixels, or null. If x is rising, only near columns are searched.
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

// The visible steps of a curve, as pairs of vertices. Each pair of pixels comes once, steps within a pixel are joined,
// and a curve is interrupted where it is not finite.
export function steps({ px, py }, { width, height }) {
  const [seen, found] = [new Set(), []];
  const [columns, cells] = [Math.ceil(width), Math.ceil(width) * Math.ceil(height)];
  const cellOf = (x, y) => (x >= 0 && x < width && y >= 0 && y < height ? (y | 0) * columns + (x | 0) : -1);
  const beyond = (some, other, most) => (some < 0 && other < 0) || (some > most && other > most);
  let [from, cell] = [0, px.length ? cellOf(px[0], py[0]) : -1];
  for (let to = 1; to < px.length; to += 1) {
    const next = cellOf(px[to], py[to]);
    if (next === cell && next >= 0) continue;
    const hidden = beyond(px[from], px[to], width) || beyond(py[from], py[to], height);
    const key = cell < 0 || next < 0 ? -1 : Math.min(cell, next) * cells + Math.max(cell, next);
    if (!hidden && !seen.has(key) && Number.isFinite(px[from] + py[from] + px[to] + py[to])) {
      found.push([from, to]);
      if (key >= 0) seen.add(key);
    }
    [from, cell] = [to, next];
  }
  return found;
}

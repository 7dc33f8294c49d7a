// What a chart draws inside its axes: curves, shaded times, bands and levels. The pen's origin is the area's corner.
import { paintLines } from "./raster.js";
import { thinPath, thinTime } from "./thinning.js";

const MANY = 3000; // vertices from which on a curve is inked pixel by pixel

const LONG = 200_000; // samples from which on a path is drawn coarsely while the view moves
const MOST = 500_000; // samples that are looked at then
const COARSE = 0.5;

const thin = (chart, one) => (one.rising ? thinTime : thinPath)(one.x, one.y, chart.frame());

// A frame of fewer pixels.
const coarser = ({ x0, kx, y0, ky, width, height }) => ({
  x0,
  kx: COARSE * kx,
  y0,
  ky: COARSE * ky,
  width: COARSE * width,
  height: COARSE * height,
});

export function drawSeries(chart, pen, one) {
  if (one.around > 0) drawAround(chart, pen, one);
  pen.strokeStyle = chart.colour(one.colour);
  pen.fillStyle = pen.strokeStyle;
  if (one.points) return drawPoints(chart, pen, one);
  const width = one.width ?? 1.4;
  if (chart.moving && one.x.length > LONG && !one.rising) {
    const vertices = thinPath(one.x, one.y, coarser(chart.frame()), Math.ceil(one.x.length / MOST));
    return paintLines(pen, vertices, { area: chart.area, width: 1, scale: 1, shrink: COARSE }, pen.strokeStyle);
  }
  const vertices = thin(chart, one);
  if (vertices.count > MANY && !one.dash) {
    return paintLines(pen, vertices, { area: chart.area, width, scale: chart.scale, shrink: 1 }, pen.strokeStyle);
  }
  pen.lineWidth = width;
  pen.lineJoin = "round";
  pen.setLineDash(one.dash ?? []);
  stroke(pen, vertices);
  pen.setLineDash([]);
  return undefined;
}

function stroke(pen, { px, py, pen: down, count }) {
  pen.beginPath();
  for (let i = 0; i < count; i += 1) {
    if (down[i]) pen.lineTo(px[i], py[i]);
    else pen.moveTo(px[i], py[i]);
  }
  pen.stroke();
  if (count === 1) pen.fillRect(px[0] - 1, py[0] - 1, 2, 2);
}

function drawPoints(chart, pen, one) {
  const { px, py, count } = thinPath(one.x, one.y, chart.frame());
  const size = one.width ?? 3;
  for (let i = 0; i < count; i += 1) pen.fillRect(px[i] - size / 2, py[i] - size / 2, size, size);
}

// The band of `around` above and below a curve: parallelograms of one sense of rotation, so that none cuts a hole.
function drawAround(chart, pen, one) {
  const { px, py, pen: down, count } = thin(chart, one);
  const half = Math.abs(one.around * chart.frame().ky);
  if (half < 0.5) return;
  pen.fillStyle = chart.colour(one.bandColour ?? "band");
  pen.beginPath();
  for (let i = 1; i < count; i += 1) {
    if (!down[i]) continue;
    const [a, b] = px[i - 1] <= px[i] ? [i - 1, i] : [i, i - 1];
    const wide = Math.max(px[b] - px[a], 0.7);
    pen.moveTo(px[a], py[a] - half);
    pen.lineTo(px[a] + wide, py[b] - half);
    pen.lineTo(px[a] + wide, py[b] + half);
    pen.lineTo(px[a], py[a] + half);
    pen.closePath();
  }
  pen.fill("nonzero");
}

export function drawBackdrop(chart, pen) {
  const { spec } = chart;
  const { width, height } = chart.area;
  const frame = chart.frame();
  pen.fillStyle = chart.colour("shade");
  for (const [from, to] of spec.shaded ?? []) {
    const left = (from - frame.x0) * frame.kx;
    pen.fillRect(left, 0, Math.max((to - from) * frame.kx, 1), height);
  }
  if (spec.band) {
    pen.fillStyle = chart.colour("band");
    const [low, high] = spec.band;
    pen.fillRect(0, (high - frame.y0) * frame.ky, width, (low - high) * frame.ky);
  }
  if (spec.zero) {
    pen.lineWidth = 1;
    const y = -frame.y0 * frame.ky;
    chart.rule(pen, 0, y, width, y, "ink");
  }
}

// Horizontal lines with a name, such as limits.
export function drawLevels(chart, pen) {
  const frame = chart.frame();
  pen.textAlign = "right";
  for (const { value, name, colour = "limit" } of chart.spec.levels ?? []) {
    const y = Math.round((value - frame.y0) * frame.ky) + 0.5;
    pen.lineWidth = 1.5;
    pen.setLineDash([6, 4]);
    chart.rule(pen, 0, y, frame.width, y, colour);
    pen.setLineDash([]);
    pen.textBaseline = y < 18 ? "top" : "bottom";
    pen.fillStyle = chart.colour(colour);
    pen.fillText(name, frame.width - 4, y < 18 ? y + 3 : y - 2);
  }
}

// Samples that need attention, such as clamped voltages.
export function drawMarks(chart, pen) {
  const { marks } = chart.spec;
  if (!marks) return;
  const { px, py, count } = thinPath(marks.x, marks.y, chart.frame());
  pen.fillStyle = chart.colour(marks.colour ?? "limit");
  for (let i = 0; i < count; i += 1) pen.fillRect(px[i] - 2.5, py[i] - 2.5, 5, 5);
}

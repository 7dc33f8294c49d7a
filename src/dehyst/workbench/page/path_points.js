// A path through points (time in s, displacement in um): sampled, edited, and read from a text file. No page here.
export const MOST_SAMPLES = 2_000_000;

// Straight lines between points, sampled at `rate` (Hz) as the server does it.
export function sampled(points, rate) {
  const begin = points[0][0];
  const count = Math.round((points.at(-1)[0] - begin) * rate) + 1;
  if (!(count >= 2)) throw new Error(`${rate} Hz gives fewer than two samples; give a higher rate.`);
  if (count > MOST_SAMPLES) throw new Error(`${rate} Hz gives ${count} samples, and at most ${MOST_SAMPLES} are drawn; give a lower rate.`);
  const time = new Float64Array(count);
  const wanted = new Float64Array(count);
  let k = 0;
  for (let i = 0; i < count; i += 1) {
    const t = begin + i / rate;
    while (k < points.length - 2 && points[k + 1][0] <= t) k += 1;
    const [[t0, y0], [t1, y1]] = [points[k], points[k + 1]];
    time[i] = t;
    wanted[i] = t >= t1 ? y1 : y0 + ((y1 - y0) * (t - t0)) / (t1 - t0);
  }
  return { time, wanted };
}

// Points with one moved: it stays between its neighbours in time, `gap` seconds away at least; the first stays at 0.
export function moved(points, index, [time, displacement], gap) {
  const low = index === 0 ? points[0][0] : points[index - 1][0] + gap;
  const high = index === 0 ? points[0][0] : (points[index + 1]?.[0] ?? Infinity) - gap;
  const at = Math.min(Math.max(time, low), Math.max(low, high));
  return points.map((one, k) => (k === index ? [at, displacement] : one));
}

// Points with one more, and its place among them; no change if it lies closer than `gap` seconds to another.
export function inserted(points, [time, displacement], gap) {
  if (points.some((one) => Math.abs(one[0] - time) < gap) || time < points[0][0]) return { points, index: -1 };
  const index = points.filter((one) => one[0] < time).length;
  return { points: [...points.slice(0, index), [time, displacement], ...points.slice(index)], index };
}

// Points without one; two stay at least, and the first does not go.
export function removed(points, index) {
  return points.length <= 2 || index <= 0 ? points : points.filter((_, k) => k !== index);
}

const TIMES = { s: 1, ms: 1e-3, us: 1e-6, "\u00b5s": 1e-6, "\u03bcs": 1e-6, ns: 1e-9, min: 60 };
const LENGTHS = { m: 1e6, mm: 1e3, um: 1, "\u00b5m": 1, "\u03bcm": 1, nm: 1e-3, pm: 1e-6 };

// A table of time and displacement as text: two columns, or more with names that say which. Units come from the names.
export function parsedPath(text) {
  const lines = text.split(/\r?\n/).filter((line) => line.trim() && !/^\s*[#%]/.test(line));
  if (!lines.length) throw new Error("The file is empty; need two columns, time and displacement.");
  const separator = [";", "\t", ","].find((one) => lines[0].includes(one)) ?? /\s+/;
  const cells = (line) => line.trim().split(separator).map((cell) => cell.trim().replace(/^"(.*)"$/, "$1"));
  const value = (cell) => Number(separator === ";" ? cell.replace(",", ".") : cell || NaN);
  const head = cells(lines[0]);
  const named = head.some((cell) => !Number.isFinite(value(cell)));
  const { t, y } = chosenColumns(named ? head : ["time_s", "displacement_um"], head.length);
  const points = lines.slice(named ? 1 : 0).map((line, k) => {
    const row = cells(line);
    const point = [t.unit * value(row[t.column] ?? ""), y.unit * value(row[y.column] ?? "")];
    if (!point.every(Number.isFinite)) throw new Error(`Row ${k + 1}: got ${line.slice(0, 60)}, need a number for time and displacement.`);
    return point;
  });
  return rising(points);
}

function chosenColumns(names, count) {
  const find = (words) => names.findIndex((name) => words.test(name));
  const t = find(/^(t|time|zeit|temps)\b|^(t|time)_/i);
  const y = find(/displ|pos|path|weg|^(y|x|z)\b|^(y|x|z)_/i);
  if (t < 0 || y < 0 || t === y || count < 2) {
    throw new Error(`Got the columns ${names.join(", ")}; need one of time and one of displacement, such as time_s,displacement_um.`);
  }
  return { t: { column: t, unit: unitOf(names[t], TIMES) }, y: { column: y, unit: unitOf(names[y], LENGTHS) } };
}

function unitOf(name, units) {
  const found = /[_\s([]+([^\s_()[\]]+)[\])]?$/.exec(name)?.[1];
  return units[found] ?? 1;
}

function rising(points) {
  if (points.length < 2) throw new Error("The file has one row; need two at least.");
  for (let k = 1; k < points.length; k += 1) {
    if (!(points[k][0] > points[k - 1][0])) throw new Error(`Row ${k + 1}: the time ${points[k][0]} s does not rise; need rising times.`);
  }
  const begin = points[0][0];
  return points.map(([time, displacement]) => [time - begin, displacement]);
}

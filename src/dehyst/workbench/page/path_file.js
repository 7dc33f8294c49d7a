// A path from a text file: points of time (s) and displacement (um). No page here.
const TIMES = { s: 1, ms: 1e-3, us: 1e-6, "\u00b5s": 1e-6, "\u03bcs": 1e-6, ns: 1e-9, min: 60 };
const LENGTHS = { m: 1e6, mm: 1e3, um: 1, "\u00b5m": 1, "\u03bcm": 1, nm: 1e-3, pm: 1e-6 };

// A table of time and displacement: two columns, or more with names that say which. Units come from the names.
export function parsedPath(text) {
  const lines = text.split(/\r?\n/).filter((line) => line.trim() && !/^\s*[#%]/.test(line));
  if (!lines.length) throw new Error("The file is empty; need two columns, time and displacement.");
  const separator = [";", "\t", ","].find((one) => lines[0].includes(one)) ?? /\s+/;
  const cells = (line) => line.trim().split(separator).map((cell) => cell.trim().replace(/^"(.*)"$/, "$1"));
  const value = (cell) => Number(separator === ";" ? cell.replace(",", ".") : cell || NaN);
  const head = cells(lines[0]);
  const named = head.some((cell) => !Number.isFinite(value(cell)));
  const [t, y] = chosenColumns(named ? head : ["time_s", "displacement_um"], head.length);
  const points = lines.slice(named ? 1 : 0).map((line, k) => {
    const row = cells(line);
    const point = [t, y].map(({ column, unit }) => unit * value(row[column] ?? ""));
    if (point.every(Number.isFinite)) return point;
    throw new Error(`Row ${k + 1}: got ${line.slice(0, 60)}, need a number for time and displacement.`);
  });
  return rising(points);
}

function chosenColumns(names, count) {
  const find = (words) => names.findIndex((name) => words.test(name));
  const t = find(/^(t|time|zeit|temps)\b|^(t|time)_/i);
  const y = find(/displ|pos|path|weg|^(y|x|z)\b|^(y|x|z)_/i);
  if (t < 0 || y < 0 || t === y || count < 2) {
    const need = "need one of time and one of displacement, such as time_s,displacement_um";
    throw new Error(`Got the columns ${names.join(", ")}; ${need}.`);
  }
  const unit = (column, units) => units[/[_\s([]+([^\s_()[\]]+)[\])]?$/.exec(names[column])?.[1]] ?? 1;
  return [
    { column: t, unit: unit(t, TIMES) },
    { column: y, unit: unit(y, LENGTHS) },
  ];
}

function rising(points) {
  if (points.length < 2) throw new Error("The file has one row; need two at least.");
  const k = points.findIndex(([time], i) => i > 0 && !(time > points[i - 1][0]));
  if (k > 0) throw new Error(`Row ${k + 1}: the time ${points[k][0]} s does not rise; need rising times.`);
  return points.map(([time, displacement]) => [time - points[0][0], displacement]);
}

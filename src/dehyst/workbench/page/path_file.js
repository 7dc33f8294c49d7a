// A path from a text file: points of time (s) and displacement (um). No page here.
const TIMES = { s: 1, ms: 1e-3, us: 1e-6, "\u00b5s": 1e-6, "\u03bcs": 1e-6, ns: 1e-9, min: 60 };
const LENGTHS = { m: 1e6, mm: 1e3, um: 1, "\u00b5m": 1, "\u03bcm": 1, nm: 1e-3, pm: 1e-6 };

// Points of each of the axes, or of the only one in an array of one. A table of time and displacement has two columns,
// or more with names that say which; those of several axes have their names. Units come from the names.
export function parsedPaths(text, axes = [""]) {
  const lines = text.split(/\r?\n/).filter((line) => line.trim() && !/^\s*[#%]/.test(line));
  if (!lines.length) throw new Error("The file is empty; need two columns, time and displacement.");
  const separator = [";", "\t", ","].find((one) => lines[0].includes(one)) ?? /\s+/;
  const cells = (line) => line.trim().split(separator).map((cell) => cell.trim().replace(/^"(.*)"$/, "$1"));
  const value = (cell) => Number(separator === ";" ? cell.replace(",", ".") : cell || NaN);
  const head = cells(lines[0]);
  const named = head.some((cell) => !Number.isFinite(value(cell)));
  const columns = chosenColumns(named ? head : expected(axes), head.length, axes);
  const rows = lines.slice(named ? 1 : 0).map((line, k) => {
    const row = cells(line);
    const point = columns.map(({ column, unit }) => unit * value(row[column] ?? ""));
    if (point.every(Number.isFinite)) return point;
    throw new Error(`Row ${k + 1}: got ${line.slice(0, 60)}, need a number for time and displacement.`);
  });
  return axes.map((_, k) => rising(rows.map((row) => [row[0], row[k + 1]])));
}

export const expected = (axes) => ["time_s", ...axes.map((axis) => `${axis || "displacement"}_um`)];

function chosenColumns(names, count, axes) {
  const find = (words) => names.findIndex((name) => words.test(name));
  const t = find(/^(t|time|zeit|temps)\b|^(t|time)_/i);
  const usual = /displ|pos|path|weg|^(y|x|z)\b|^(y|x|z)_/i;
  const found = axes.map((axis) => find(axis ? new RegExp(`^${axis}(\\b|_)`, "i") : usual));
  if (t < 0 || found.includes(-1) || found.includes(t) || count < 2) {
    const moved = axes[0] ? "each axis" : "displacement";
    const need = `need one of time and one of ${moved}, such as ${expected(axes).join(",")}`;
    throw new Error(`Got the columns ${names.join(", ")}; ${need}.`);
  }
  const unit = (column, units) => units[/[_\s([]+([^\s_()[\]]+)[\])]?$/.exec(names[column])?.[1]] ?? 1;
  return [{ column: t, unit: unit(t, TIMES) }, ...found.map((column) => ({ column, unit: unit(column, LENGTHS) }))];
}

function rising(points) {
  if (points.length < 2) throw new Error("The file has one row; need two at least.");
  const k = points.findIndex(([time], i) => i > 0 && !(time > points[i - 1][0]));
  if (k > 0) throw new Error(`Row ${k + 1}: the time ${points[k][0]} s does not rise; need rising times.`);
  return points.map(([time, displacement]) => [time - points[0][0], displacement]);
}

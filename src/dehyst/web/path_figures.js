// The pictures of a plan: the wanted path with its points, the voltage, the error, and where the voltage turns.
import { h, make } from "./dom.js";
import { Figure } from "./figure.js";
import { extent, length, percent, range, short, whole } from "./numbers.js";
import { turningPoints } from "./path.js";
import { HANDLE_KEYS, PointHandles } from "./point_handles.js";

const SECONDS = { label: "Time (s)", unit: "s" };
const TURN = 0.01; // how far a voltage goes back at a turning point, of the range

export class PathFigures {
  // `edited` is called with the points (s, um) after each change by the person.
  constructor(edited) {
    this.path = new Figure({ title: "Displacement", keys: HANDLE_KEYS });
    this.voltage = new Figure({ title: "Voltage", help: false });
    this.error = new Figure({ title: "Error", help: false });
    this.turns = new Figure({ title: "Where the voltage turns", help: false });
    this.handles = new PointHandles(this.path.chart, edited);
    const all = [this.path, this.voltage, this.error, this.turns];
    this.element = make(h("div", { class: "figures steady" }, all.map((one) => one.element)));
  }

  // `reach` and `band`, half the height of the trust band, in um; `band` is 0 if it is not known, and without `tested`,
  // the turning points of the records, there is no picture of those of this voltage.
  draw({ path, planned, limits, reach, band, points, tested }) {
    const { clamps, clamped } = planned;
    const cut = clamps.limited + clamps.slewed > 0;
    const note = band ? [["band", `trust band, \u00b1${length(band)}`]] : [];
    const curve = (name, colour, y, more) => ({ name, colour, x: path.time, y, rising: true, ...more });
    const straight = (y) => curve("straight gain", "without", y, { dash: [5, 4] });
    const off = (values) => Float32Array.from(values, (value, i) => value - path.wanted[i]);
    this.handles.set(points ?? [], reach);
    // While a point is dragged, the picture stays where it is.
    const x = this.handles.held ? this.path.chart.home.x : undefined;
    const y = points && extent([this.handles.ends], 0.02);
    this.path.set(
      {
        x: { ...SECONDS, range: x },
        y: { label: "Displacement (\u00b5m)", unit: "\u00b5m", range: y },
        series: [
          straight(planned.straightReached),
          curve("wanted", "measured", path.wanted, { around: band, width: 1.8 }),
          ...(cut ? [curve("reached", "simulated", planned.reached, { width: 1.8 })] : []),
        ],
        notes: note,
      },
      { keep: true, spoken: "Wanted displacement over time, and what a straight gain would reach." },
    );
    const at = [...clamped.keys()].filter((i) => clamped[i]);
    const [when, volts] = [path.time, planned.voltage].map((values) => Float32Array.from(at, (i) => values[i]));
    this.voltage.set(
      {
        x: SECONDS,
        y: { label: "Voltage (V)", unit: "V" },
        levels: limits.map((value) => ({ value, name: `limit ${short(value, 4)} V`, colour: "limit" })),
        series: [
          straight(planned.straight),
          curve("dehyst", "simulated", planned.voltage, { width: 1.8 }),
          ...(cut ? [{ name: "clamped", colour: "limit", kind: "points", width: 5, x: when, y: volts }] : []),
        ],
      },
      { keep: true, spoken: "Voltage over time with its limits." },
    );
    this.error.set(
      {
        x: SECONDS,
        y: { label: "Error (\u00b5m)", unit: "\u00b5m" },
        levels: [{ value: 0 }],
        band: band ? [-band, band] : undefined,
        series: [
          straight(off(planned.straightReached)),
          curve("dehyst, without the model's error", "simulated", off(planned.reached), { width: 1.8 }),
        ],
        notes: note,
      },
      { keep: true, spoken: "Error over time of a straight gain, and of dehyst where the model is the actuator." },
    );
    this.turns.element.hidden = !tested;
    if (tested) this.turns.set(...turnsPicture(tested, planned.voltage));
  }
}

// Do records test a rise or fall between two voltages? Of a grid with these edges (V), its cells row by row: 1 for a
// rising branch that is tested, 2 for a falling one, 3 for both.
function isTested({ edges_V: edges, cells }, [begin, end]) {
  const columns = edges.length - 1;
  const cell = (value) => Math.min(Math.max(edges.findLastIndex((edge) => edge <= value), 0), columns - 1);
  const [i, j] = [Math.min(begin, end), Math.max(begin, end)].map(cell);
  return (cells[j * columns + i] & (end > begin ? 1 : 2)) > 0;
}

// The branches of a voltage, from turning point to turning point, and how many of them records do not test.
function untested(tested, voltage) {
  const { edges_V: edges } = tested;
  const turns = voltage ? turningPoints(voltage, TURN * (edges.at(-1) - edges[0])) : [];
  const branches = turns.slice(1).map((end, k) => [turns[k], end]);
  const open = branches.filter((one) => !isTested(tested, one)).length;
  const sentence = `${open} of ${branches.length} branches of this path begin where no record turned`;
  return { branches, open, sentence: open ? sentence : "This path turns where records turned" };
}

// The plane of turning points: where records turned, and where a voltage does. Returns what `Figure.set` takes.
export function turnsPicture(tested, voltage) {
  const { edges_V: edges, cells, lower_V: lower, upper_V: upper, names } = tested;
  const { branches, sentence } = untested(tested, voltage);
  const range = extent([edges], 0.03);
  const x = branches.map((one) => Math.min(...one));
  const y = branches.map((one) => Math.max(...one));
  return [
    {
      x: { label: "Lower turning point (V)", unit: "V", range },
      y: { label: "Upper turning point (V)", unit: "V", range },
      series: [
        { colour: "tested", kind: "cells", x: edges, y: edges, values: [...cells].map((one) => [0, 0.5, 0.5, 1][one]) },
        { colour: "edge", x: range, y: range, silent: true, width: 1 },
        { name: "records", colour: "measured", kind: "points", width: 5, x: lower, y: upper, names },
        ...(branches.length ? [{ name: "this path", colour: "simulated", kind: "points", width: 8, x, y }] : []),
      ],
      notes: [["tested", "tested, paler: one branch of the loop only"], ...(branches.length ? [["", sentence]] : [])],
    },
    { keep: true, spoken: `Plane of turning points. ${branches.length ? sentence : ""}` },
  ];
}

// What to expect of a plan: a light and a sentence, then facts. `stroke` and `band` in um.
export function judged(planned, { stroke, band, tested, light = "green", speed = "" }) {
  const { voltage, steepest, missed, straightMissed, clamps } = planned;
  const share = (um) => `${length(um)} (${percent((100 * um) / stroke)} of the stroke)`;
  const cut = [
    clamps.limited && `${whole(clamps.limited)} samples are cut at a limit`,
    clamps.slewed && `${whole(clamps.slewed)} samples are held back by the slew rate`,
  ].filter(Boolean);
  const pace = Number.isFinite(steepest) ? `, at most ${short(steepest)} V/s${speed}` : "";
  const followed = `The path can be followed${band ? `: expect it within ${share(band)}` : ""}.`;
  const { open, sentence } = tested ? untested(tested, voltage) : {};
  const usual = open && light === "green" ? "amber" : light;
  return {
    light: cut.length ? "red" : usual,
    first: cut.length ? `${cut.join(" and ")}: the path is missed by up to ${length(missed)}.` : followed,
    facts: [
      `${range(extent([voltage]), "V", 3)}${pace}, ${whole(voltage.length)} samples.`,
      `A straight gain would miss it by up to ${share(straightMissed)}.`,
      // Always a line, so that the pictures below stay in their places.
      ...(tested ? [open ? `${sentence}: there the error was not tested, and may be larger.` : `${sentence}.`] : []),
    ],
  };
}

export const verdict = ({ light, first, facts }, ...more) =>
  h(
    "div",
    { class: `plan outcome ${light}`, id: "plan-words", role: "status" },
    h("p", { class: "first" }, first),
    facts.map((one) => h("p", {}, one)),
    more,
  );

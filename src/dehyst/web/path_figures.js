// The pictures of a plan: the wanted path with its points, the voltage, the error, and where the voltage turns.
import { h, make } from "./dom.js";
import { Figure, MICROMETRES, SECONDS, VOLTS } from "./figure.js";
import { APART, duration, extent, length, percent, range, short, whole } from "./numbers.js";
import { branches } from "./path.js";
import { HANDLE_KEYS, PointHandles } from "./point_handles.js";

const MORE = 1.05; // by how much holds may exceed those of records without a word

// A curve over time.
export const curve = (name, colour, x, y, more) => ({ name, colour, x, y, rising: true, width: 1.8, ...more });

export class PathFigures {
  // `edited` is called with the points (s, um) after each change by the person.
  constructor(edited) {
    this.path = new Figure({ title: "Displacement", keys: HANDLE_KEYS });
    this.voltage = new Figure({ title: "Voltage", help: false });
    this.error = new Figure({ title: "Error", help: false });
    this.turns = new Figure({ title: "Where the voltage turns", help: false });
    this.handles = new PointHandles(this.path.chart, edited);
    const all = [this.path, this.voltage, this.error, this.turns];
    this.element = make(h("div.figures.steady", all.map((one) => one.element)));
  }

  // `reach` and `band`, half the height of the trust band, in um; `band` is 0 if it is not known. `turned` is what
  // `turnsOf` returns; without it there is no picture of where the voltage turns.
  draw({ path, planned, limits, reach, band, points, turned }) {
    const { clamps, clamped } = planned;
    const cut = clamps.limited + clamps.slewed > 0;
    const notes = band ? [["band", `trust band, \u00b1${length(band)}`]] : [];
    const straight = (y) => curve("straight gain", "without", path.time, y, { dash: [5, 4], width: 1.4 });
    const off = (values) => Float32Array.from(values, (value, i) => value - path.wanted[i]);
    this.handles.set(points ?? [], reach);
    const { x, y } = this.handles.ranges();
    const show = (figure, spoken, spec) => figure.set({ x: SECONDS, ...spec }, { keep: true, spoken });
    show(this.path, "Wanted displacement over time, and what a straight gain would reach.", {
      x: { ...SECONDS, range: x },
      y: { ...MICROMETRES, range: y },
      series: [straight(planned.straightReached), ...wantedCurves({ path, planned, band })],
      notes,
    });
    const at = [...clamped.keys()].filter((i) => clamped[i]);
    const [when, volts] = [path.time, planned.voltage].map((values) => Float32Array.from(at, (i) => values[i]));
    show(this.voltage, "Voltage over time with its limits.", {
      y: VOLTS,
      levels: limits.map((value) => ({ value, name: `limit ${short(value, 4)} V`, colour: "limit" })),
      series: [
        straight(planned.straight),
        curve("dehyst", "simulated", path.time, planned.voltage),
        ...(cut ? [{ name: "clamped", colour: "limit", kind: "points", width: 5, x: when, y: volts }] : []),
      ],
    });
    show(this.error, "Error over time of a straight gain, and of dehyst where the model is the actuator.", {
      y: { label: "Error (\u00b5m)", unit: "\u00b5m" },
      levels: [{ value: 0 }],
      band: band ? [-band, band] : undefined,
      series: [
        straight(off(planned.straightReached)),
        curve("dehyst, without the model's error", "simulated", path.time, off(planned.reached)),
      ],
      notes,
    });
    this.show(["path", "voltage", "error", turned && "turns"]);
    if (turned) this.turns.set(...turnsPicture(turned));
  }

  // Show these pictures alone.
  show(names) {
    for (const name of ["path", "voltage", "error", "turns"]) this[name].element.hidden = !names.includes(name);
  }
}

// The wanted displacement of a plan with its band, and what is reached if voltages are clamped.
function wantedCurves({ path: { time, wanted }, planned: { clamps, reached }, band }) {
  const all = [curve("wanted", "measured", time, wanted, { around: band })];
  if (clamps.limited + clamps.slewed > 0) all.push(curve("reached", "simulated", time, reached));
  return all;
}

// What records test of a voltage. `plane` is the chart of a report with where they turned, whose cells are 1 where a
// falling branch is tested, 2 for a rising one, 3 for both; nothing without it.
export function turnsOf(plane, time, voltage) {
  if (!plane) return null;
  const { x: edges, values: cells } = plane.series.find((one) => one.kind === "cells");
  const { held } = plane.about;
  const columns = edges.length - 1;
  const cell = (value) => Math.min(Math.max(edges.findLastIndex((edge) => edge <= value), 0), columns - 1);
  const isTested = ({ begin, end }) => {
    const [lower, upper] = [Math.min(begin, end), Math.max(begin, end)].map(cell);
    return (Math.round(cells[upper * columns + lower]) & (end > begin ? 2 : 1)) > 0;
  };
  const all = branches(time, voltage, edges.at(-1) - edges[0]);
  const open = all.filter((one) => !isTested(one)).length;
  const longest = Math.max(0, ...all.map((one) => one.held));
  const said = [
    open
      ? `${open} of ${all.length} branches of this path begin where no record turned: there the error was not ` +
        "tested, and may be larger."
      : "This path turns where records turned.",
  ];
  if (longest > MORE * held) {
    const before = held ? `the records for ${duration(held)}` : "the records do not";
    said.push(`It holds for up to ${duration(longest)}, ${before}.`);
  }
  return { plane, branches: all, open, sentence: said.join(" ") };
}

// The plane of turning points with the branches of a path on it. Returns what `Figure.set` takes.
function turnsPicture({ plane, branches: all, sentence }) {
  const dots = (some, width, hollow) => ({
    name: "your path",
    colour: "simulated",
    kind: "points",
    width,
    hollow,
    x: some.map((one) => Math.min(one.begin, one.end)),
    y: some.map((one) => Math.max(one.begin, one.end)),
    names: some.map(({ begin, end, speed, held }) => {
      const ends = `from ${short(begin)} to ${short(end)} V`;
      return `your path: ${ends} at ${short(speed)} V/s${held ? `, held ${duration(held)}` : ""}`;
    }),
  });
  const rings = all.filter((one) => one.held);
  const series = [...plane.series, ...(rings.length ? [dots(rings, 12, true)] : []), dots(all, 8, false)];
  return [{ ...plane, series }, { keep: true, spoken: `Plane of turning points. ${sentence}` }];
}

// What to expect of a plan: a light and a sentence, then facts. `stroke` and `band` in um.
export function judged(planned, { stroke, band, turned, light, speed }) {
  const { voltage, steepest, missed, straightMissed, clamps } = planned;
  const share = (um) => `${length(um)} (${percent((100 * um) / stroke)} of the stroke)`;
  const cut = [
    clamps.limited && `${whole(clamps.limited)} samples are cut at a limit`,
    clamps.slewed && `${whole(clamps.slewed)} samples are held back by the slew rate`,
  ].filter(Boolean);
  const pace = Number.isFinite(steepest) ? `, at most ${short(steepest)} V/s${speed}` : "";
  const tested = turned?.open ? " where records turned" : "";
  const followed = `The path can be followed${band ? `: expect it within ${share(band)}${tested}` : ""}.`;
  const usual = turned?.open && light === "green" ? "amber" : light;
  return {
    light: cut.length ? "red" : usual,
    first: cut.length ? `${cut.join(" and ")}: the path is missed by up to ${length(missed)}.` : followed,
    facts: [
      `${range(extent([voltage]), "V", 3)}${pace}, ${whole(voltage.length)} samples.`,
      `A straight gain would miss it by up to ${share(straightMissed)}.`,
      ...(band ? [`The error to expect is given ${APART}.`] : []),
      ...(turned ? [turned.sentence] : []),
    ],
  };
}

export const verdict = ({ light, first, facts }, ...more) =>
  h("div", { class: `plan outcome ${light}`, id: "plan-words", role: "status" },
    h("p.first", first),
    facts.map((one) => h("p", one)),
    more,
  );

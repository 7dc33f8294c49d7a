// The pictures of a plan: the wanted path with its points, the voltage, and the error.
import { h, make } from "./dom.js";
import { Figure, MICROMETRES, SECONDS, VOLTS } from "./figure.js";
import { extent, length, percent, range, short, whole } from "./numbers.js";
import { HANDLE_KEYS, PointHandles } from "./point_handles.js";

const NM = 1e3; // nanometres of a micrometre
const FEW_LINES = 4; // that are shown together

// A curve over time.
export const curve = (name, colour, x, y, more) => ({ name, colour, x, y, rising: true, width: 1.8, ...more });

export class PathFigures {
  // `edited` is called with the points (s, um) after each change by the person.
  constructor(edited) {
    const views = [["line", "One line"], ["all", "All"]];
    this.path = new Figure({ title: "Displacement", keys: HANDLE_KEYS, views, choose: () => this.draw(this.last) });
    this.voltage = new Figure({ title: "Voltage", help: false });
    this.error = new Figure({ title: "Error", help: false });
    this.views = views;
    this.handles = new PointHandles(this.path.chart, edited);
    const all = [this.path, this.voltage, this.error];
    this.element = make(h("div.figures.steady", all.map((one) => one.element)));
  }

  // `reach` and `band`, half the height of the promise, in um; `band` is 0 if it is not known.
  // `line` is the time of a line of a scan (s): of many, one is shown.
  draw(last) {
    this.last = last;
    const { path, planned, limits, reach, band, points, line } = last;
    const { clamps, clamped } = planned;
    const many = path.time.at(-1) > FEW_LINES * line;
    this.path.views = many ? this.views : [];
    // The second one: the first begins at the start.
    const shown = many && this.path.view === "line" ? [line, 2 * line] : undefined;
    const cut = clamps.limited + clamps.slewed > 0;
    const notes = band ? [["band", `promise, \u00b1${length(band)}`]] : [];
    const straight = (y) => curve("straight gain", "without", path.time, y, { dash: [5, 4], width: 1.4 });
    const off = (values) => Float32Array.from(values, (value, i) => NM * (value - path.wanted[i]));
    const most = NM * Math.max(band ?? 0, planned.missed);
    this.handles.set(points ?? [], reach);
    const { x = shown, y } = this.handles.ranges();
    const seconds = { ...SECONDS, range: x };
    const show = (figure, spoken, spec) => figure.set({ x: seconds, ...spec }, { keep: true, spoken });
    show(this.path, "Wanted displacement over time, and what a straight gain would reach.", {
      y: { ...MICROMETRES, range: y },
      series: [straight(planned.straightReached), ...wantedCurves({ path, planned })],
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
      // Of the promise: a straight gain leaves the picture.
      y: { label: "Error (nm)", unit: "nm", range: most ? [-1.6 * most, 1.6 * most] : undefined },
      levels: [{ value: 0 }],
      band: band ? [-NM * band, NM * band] : undefined,
      series: [
        straight(off(planned.straightReached)),
        curve("dehyst, without the model's error", "simulated", path.time, off(planned.reached)),
      ],
      notes,
    });
    this.show(["path", "voltage", "error"]);
  }

  // Show these pictures alone.
  show(names) {
    for (const name of ["path", "voltage", "error"]) this[name].element.hidden = !names.includes(name);
  }
}

// The wanted displacement of a plan, and what is reached if voltages are clamped.
function wantedCurves({ path: { time, wanted }, planned: { clamps, reached } }) {
  const all = [curve("wanted", "measured", time, wanted)];
  if (clamps.limited + clamps.slewed > 0) all.push(curve("reached", "simulated", time, reached));
  return all;
}

// What to expect of a plan: a light and a sentence, then facts. `stroke` and `band` in um.
export function judged(planned, { stroke, band, light, speed, apart }) {
  const { voltage, steepest, missed, straightMissed, clamps } = planned;
  const share = (um) => `${length(um)} (${percent((100 * um) / stroke)} of the stroke)`;
  const cut = [
    clamps.limited && `${whole(clamps.limited)} samples are clamped`,
    clamps.slewed && `${whole(clamps.slewed)} samples are slewed`,
  ].filter(Boolean);
  const pace = Number.isFinite(steepest) ? `, at most ${short(steepest)} V/s${speed}` : "";
  const followed = `The path can be followed${band ? `: expect it within ${share(band)}` : ""}.`;
  return {
    light: cut.length ? "red" : light,
    first: cut.length ? `${cut.join(" and ")}: the path is missed by up to ${length(missed)}.` : followed,
    facts: [
      `${range(extent([voltage]), "V", 3)}${pace}, ${whole(voltage.length)} samples.`,
      `A straight gain would miss it by up to ${share(straightMissed)}.`,
      ...(band ? [`The promise is that of any path, ${apart}; a written file has its own.`] : []),
    ],
  };
}

export const verdict = ({ light, first, facts }, ...more) =>
  h("div", { class: `plan outcome ${light}`, id: "plan-words", role: "status" },
    h("p.first", first),
    facts.map((one) => h("p", one)),
    more,
  );

// The pictures of a plan: the wanted path with its points, the voltage, and the error.
import { h, make } from "./dom.js";
import { Figure, MICROMETRES, SECONDS, VOLTS } from "./figure.js";
import { extent, length, percent, range, short, whole } from "./numbers.js";
import { HANDLE_HELP, PointHandles } from "./point_handles.js";

const NM = 1e3; // nanometres in a micrometre
const FEW_LINES = 4; // a scan with more lines is shown line by line

export const curve = (name, colour, x, y) => ({ name, colour, x, y, rising: true, width: 1.8 });

export class PathFigures {
  // `edited` is called with the points (s, um) after each change by the user.
  constructor(edited) {
    this.views = [["line", "One line"], ["all", "All"]];
    const { views } = this;
    this.path = new Figure({ title: "Displacement", keys: HANDLE_HELP, views, choose: () => this.draw(this.last) });
    this.error = new Figure({ title: "Error" });
    this.voltage = new Figure({ title: "Voltage" });
    this.handles = new PointHandles(this.path.chart, edited);
    const all = [this.path, this.error, this.voltage];
    this.element = make(h("div.figures.steady", all.map((figure) => figure.element)));
  }

  // `reach` and `band`, half the height of the promise, are in um; `band` is 0 without a promise.
  // `line` is the duration of a line of a scan (s); of many lines, one is shown.
  draw(last) {
    this.last = last;
    const { path: { time, wanted }, planned, limits, reach, band, points, line } = last;
    const { clamped, reached, voltage, missed } = planned;
    const many = time.at(-1) > FEW_LINES * line;
    this.path.views = many ? this.views : [];
    // The second line is shown: the first contains the start.
    const shown = many && this.path.view === "line" ? [line, 2 * line] : undefined;
    this.handles.set(points ?? [], reach);
    const { x = shown, y } = this.handles.ranges();
    const show = (figure, spoken, spec) => figure.set({ x: { ...SECONDS, range: x }, ...spec }, { keep: true, spoken });
    const at = [...clamped.keys()].filter((i) => clamped[i]);
    const [when, volts] = [time, voltage].map((values) => Float32Array.from(at, (i) => values[i]));
    const cut = at.length > 0;
    show(this.path, "Wanted displacement over time.", {
      y: { ...MICROMETRES, range: y },
      series: [curve("wanted", "measured", time, wanted), ...(cut ? [curve("reached", "simulated", time, reached)] : [])],
    });
    const most = NM * Math.max(band, missed);
    const promise = { value: NM * band, name: `promise \u00b1${length(band)}`, colour: "measured" };
    show(this.error, "Error over time of the model, within the promise.", {
      y: { label: "Error (nm)", unit: "nm", range: most ? [-1.4 * most, 1.4 * most] : undefined },
      levels: [{ value: 0 }, ...(band ? [promise, { value: -NM * band, colour: "measured" }] : [])],
      band: band ? [-NM * band, NM * band] : undefined,
      series: [curve("as planned", "simulated", time, Float32Array.from(wanted, (y, i) => NM * (reached[i] - y)))],
    });
    show(this.voltage, "Voltage over time with its limits.", {
      y: VOLTS,
      levels: limits.map((value) => ({ value, name: `limit ${short(value, 4)} V`, colour: "limit" })),
      series: [
        curve("voltage", "simulated", time, voltage),
        ...(cut ? [{ name: "clamped", colour: "limit", kind: "points", width: 5, x: when, y: volts }] : []),
      ],
    });
    this.show(["path", "voltage", "error"]);
  }

  // Show these pictures alone.
  show(names) {
    for (const name of ["path", "voltage", "error"]) this[name].element.hidden = !names.includes(name);
  }
}

// Sentences about a model that a check found wrong, and about a path much faster than the records.
export const NO_PROMISE =
  "There is no promise: the last check found that the model no longer holds. Update it, or identify again.";
export const TOO_FAST = "There is no promise: no record is as fast as this path. The written file has its own promise.";

// The verdict on a plan. `band` (um) is the promise of its `file`, or of any path; if it is 0, `why` is the reason.
export function judged(planned, { largest_percent: share, band, why, light, speed, apart, file }) {
  const { voltage, steepest, missed, clamps } = planned;
  const counts = [["clamped", clamps.limited], ["slewed", clamps.slewed]].filter(([, count]) => count > 0);
  const cut = counts.map(([word, count]) => `${whole(count)} samples are ${word}`);
  const pace = Number.isFinite(steepest) ? `, at most ${short(steepest)} V/s${speed}` : "";
  const expected = band && (file || !cut.length) ? `expect it within ${length(band)} (${percent(share)} of the stroke)` : "";
  const whose = file ? `of the file ${file}, ${apart}` : `for any path, ${apart}; a written file has its own promise`;
  return {
    light: cut.length ? "red" : light,
    first: cut.length
      ? `${cut.join(" and ")}: the path is missed by up to ${length(missed)}${expected && `; ${expected}`}.`
      : `The path can be followed${expected && `: ${expected}`}.`,
    facts: [
      `${range(extent([voltage]), "V", 3)}${pace}, ${whole(voltage.length)} samples.`,
      expected ? `This is the promise ${whose}.` : why || "The written file has its own promise.",
    ],
  };
}

export const verdict = ({ light, first, facts }) =>
  h("div", { class: `plan outcome ${light}`, id: "plan-words", role: "status" },
    h("p.first", first),
    facts.map((fact) => h("p", fact)),
  );

// Measured and simulated displacement of a model's records, and what lies between them; models side by side.
import { traceColumns, tracesOf } from "./api.js";
import { h, table } from "./dom.js";
import { Figure } from "./figure.js";
import { options } from "./forms.js";
import { duration, length, percent } from "./numbers.js";
import { COLOURS, MICROMETRES, SECONDS_AXIS, VOLTS } from "./records.js";
import { readyModels } from "./state.js";
import { before } from "./thinning.js";
import { bandOf, lightOf } from "./verdict.js";

const RESIDUAL = { label: "Measured \u2212 simulated (nm)", unit: "nm" };

const residualsOf = ({ measured, simulated }) => measured.map((one, i) => 1e3 * (one - simulated[i]));

// A curve over time that is not drawn across the times that were set aside.
function withGaps(values, time, shaded = []) {
  const out = Float32Array.from(values);
  for (const [, to] of shaded) {
    const first = before(time, to - 1e-6 * Math.abs(to));
    if (first > 0 && first < out.length) out[first] = NaN;
  }
  return out;
}

// Displacements less the straight line through the measured ones over voltage: it makes room for the hysteresis.
function offLine({ voltage, measured, simulated }) {
  const known = [...voltage.keys()].filter((i) => Number.isFinite(voltage[i] + measured[i]));
  const mean = (of) => known.reduce((sum, i) => sum + of(i), 0) / Math.max(known.length, 1);
  const [x, y] = [mean((i) => voltage[i]), mean((i) => measured[i])];
  const slope = mean((i) => (voltage[i] - x) * measured[i]) / (mean((i) => (voltage[i] - x) ** 2) || 1);
  const less = (values) => values.map((value, i) => value - y - slope * (voltage[i] - x));
  return { voltage, measured: less(measured), simulated: less(simulated) };
}

const LESS_LINE = { ...MICROMETRES, label: "Displacement \u2212 straight line (\u00b5m)" };
const loops = ({ voltage, measured, simulated }, half, y) => ({
  x: VOLTS,
  y,
  series: [
    { name: "measured", colour: "measured", x: voltage, y: measured, width: 1.6 },
    { name: "simulated", colour: "simulated", x: voltage, y: simulated, around: half, width: 1.2 },
  ],
});
const residual = (half, more) => ({ y: RESIDUAL, levels: [{ value: 0 }], band: [-1e3 * half, 1e3 * half], ...more });

// What each view shows of the columns of a trace; `half` is half the height of the trust band.
const VIEWS = {
  loops: ["Loops", (data, half) => loops(data, half, MICROMETRES)],
  deviation: ["Off a straight line", (data, half) => loops(offLine(data), half, LESS_LINE)],
  time: [
    "Over time",
    ({ time, ...data }, half, shaded) => {
      const curve = (name) => ({ name, colour: name, x: time, y: withGaps(data[name], time, shaded), rising: true });
      const series = [{ ...curve("measured"), width: 2.4 }, { ...curve("simulated"), around: half }];
      return { x: SECONDS_AXIS, y: MICROMETRES, shaded, series };
    },
  ],
  residual: [
    "Residuals over time",
    (data, half, shaded) => {
      const series = [residualSeries("residual", "measured", data, shaded)];
      return residual(half, { x: SECONDS_AXIS, shaded, series });
    },
  ],
  against: ["Residuals over displacement", (data, half) => residual(half, { x: MICROMETRES, series: branches(data) })],
};

function residualSeries(name, colour, data, shaded) {
  return { name, colour, x: data.time, y: withGaps(residualsOf(data), data.time, shaded), rising: true };
}

// Residuals of rising and of falling branches of the simulated displacement.
function branches(data) {
  const residuals = residualsOf(data);
  const parts = { rising: residuals.map(() => NaN), falling: residuals.map(() => NaN) };
  let name = "rising";
  for (let i = 1; i < residuals.length; i += 1) {
    const step = data.simulated[i] - data.simulated[i - 1];
    if (step !== 0) name = step > 0 ? "rising" : "falling";
    parts[name][i] = residuals[i];
  }
  const points = { kind: "points", width: 2, x: data.simulated };
  return Object.entries(parts).map(([one, y]) => ({ name: `${one} branches`, colour: one, y, ...points }));
}

// The records of a model, in the order of its traces: training first.
const uses = (model) => [...model.train, ...model.validate];

export class FitFigure extends Figure {
  constructor() {
    const views = Object.entries(VIEWS).map(([name, [title]]) => [name, title]);
    super({ title: "Measured and simulated", views, choose: () => this.draw(), tall: true });
  }

  // The figure of a model, drawn if it is not yet.
  show(model) {
    const known = this.model?.id === model.id;
    this.model = model;
    if (!known) {
      Object.assign(this, { number: 0, traces: [] });
      this.draw();
    }
    return this.element;
  }

  async draw() {
    const { model, view, number } = this;
    try {
      this.traces = (await tracesOf(model)).records;
      const trace = this.traces[number];
      const data = trace && (await traceColumns(model, number));
      const others = view === "residual" ? await this.others() : [];
      if (this.model.id !== model.id || this.view !== view || this.number !== number) return;
      this.element.hidden = !trace;
      if (trace) this.plot(trace, data, others);
    } catch (error) {
      this.model = null;
      this.output.textContent = error.message;
    }
  }

  // Residuals of the other models of this record.
  others() {
    const record = uses(this.model)[this.number];
    const models = readyModels().filter((one) => one.id !== this.model.id && uses(one).includes(record));
    const series = async (one, k) => {
      const number = uses(one).indexOf(record);
      const { shaded } = (await tracesOf(one)).records[number];
      return residualSeries(one.name, COLOURS[1 + (k % (COLOURS.length - 1))], await traceColumns(one, number), shaded);
    };
    return Promise.all(models.map(series));
  }

  plot({ name, role, shaded = [] }, data, others) {
    const half = bandOf(this.model);
    const notes = [["band", `expected largest error, \u00b1${length(half)}`]];
    if (shaded.length && ["time", "residual"].includes(this.view)) notes.push(["shade", "samples set aside"]);
    const onchange = (event) => {
      this.number = Number(event.target.value);
      this.draw();
    };
    const choices = options(this.traces.map((one, k) => [String(k), `${one.name} (${one.role})`]));
    const about = { "aria-label": "Record", value: String(this.number), onchange };
    this.more = this.traces.length > 1 && h("select", about, choices);
    const spec = VIEWS[this.view][1](data, half, shaded);
    if (others.length) spec.series[0].name = this.model.name;
    const largest = residualsOf(data).reduce((most, one) => Math.max(most, Math.abs(one)), 0) / 1e3;
    const differ = `they differ by at most ${length(largest)}`;
    const spoken = `Measured and simulated displacement of ${name} (${role}); ${differ}.`;
    this.set({ ...spec, series: [...spec.series, ...others], notes }, { spoken });
  }
}

// Models of the record on which the chosen one is judged, held out if there is one; nothing if there is none but it.
export function comparison(all, chosen) {
  const record = chosen.validate[0] ?? chosen.train[0];
  const models = all.filter((one) => uses(one).includes(record));
  if (models.length < 2) return null;
  // A smaller error is a better one only on the same records.
  const records = models.map((one) => `${[...one.train].sort()} ${[...one.validate].sort()}`);
  const same = new Set(records).size === 1;
  const error = (name) => {
    const best = same ? Math.min(...models.map((one) => one.verdict[name])) : NaN;
    const mark = h("span", { class: "unseen" }, " (best)");
    return ({ verdict }) =>
      verdict[name] === best ? h("td", { class: "best" }, percent(best), mark) : h("td", {}, percent(verdict[name]));
  };
  const [largest, rms] = [error("largest_percent"), error("rms_percent")];
  const light = ({ verdict }) => {
    const [colour, words] = lightOf(verdict);
    return h("td", { class: "text" }, h("span", { class: `light ${colour}` }, words));
  };
  const heads = [
    "Model",
    { text: "Verdict", class: "text" },
    ...["Largest error", "Largest error", "RMS error", "Structure", "Time taken", "From"],
  ];
  const rows = models.map((one) => [
    one.name,
    light(one),
    largest(one),
    length(one.verdict.largest_um),
    rms(one),
    one.options?.structure ?? "auto",
    duration(one.seconds),
    one.verdict.basis ?? "",
  ]);
  return h(
    "section",
    { class: "comparison", "aria-labelledby": "comparison", key: "comparison" },
    h("h2", { id: "comparison" }, "Models side by side"),
    table("Error, verdict and time of each model", heads, rows),
    h("p", { class: "muted" }, "Their residuals stand in one picture above: Residuals over time."),
  );
}

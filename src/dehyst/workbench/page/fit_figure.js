// Measured and simulated displacement of a model's records, and what lies between them.
import { getColumns, getJson } from "./api.js";
import { Figure } from "./figure.js";
import { choice, h } from "./dom.js";
import { length } from "./numbers.js";
import { isOpen } from "./steps.js";
import { before } from "./thinning.js";
import { bandOf } from "./verdict.js";

const VOLTS = { label: "Voltage (V)", unit: "V" };
const MICROMETRES = { label: "Displacement (\u00b5m)", unit: "\u00b5m" };
const SECONDS = { label: "Time (s)", unit: "s" };
const RESIDUAL = { label: "Measured \u2212 simulated (nm)", unit: "nm" };

// The traces of a model: name, role and samples, with the address of the data.
export async function tracesOf(model) {
  const { records } = await getJson(`/api/models/${model.id}/traces`);
  return records.map((one, k) => ({ ...one, path: `/api/models/${model.id}/traces/${k}` }));
}

export async function traceColumns(trace) {
  const [time, voltage, measured, simulated] = await getColumns(trace.path, 4, "");
  return { time, voltage, measured, simulated };
}

export function residualsOf({ measured, simulated }) {
  const out = new Float32Array(measured.length);
  for (let i = 0; i < out.length; i += 1) out[i] = 1e3 * (measured[i] - simulated[i]);
  return out;
}

// A curve over time that is not drawn across the times that were set aside.
export function withGaps(values, time, shaded) {
  if (!shaded?.length) return values;
  const out = Float32Array.from(values);
  for (const [, to] of shaded) {
    const first = before(time, to - 1e-6 * Math.abs(to));
    if (first > 0 && first < out.length) out[first] = NaN;
  }
  return out;
}

export class FitFigure {
  constructor() {
    this.figure = new Figure({
      title: "Measured and simulated",
      views: [
        ["loops", "Loops"],
        ["deviation", "Off a straight line"],
        ["time", "Over time"],
        ["residual", "Residuals over time"],
        ["against", "Residuals over displacement"],
      ],
      choose: () => this.draw(this.model, true),
      tall: true,
    });
    this.select = choice([], "", { "aria-label": "Record" });
    this.select.addEventListener("change", () => this.draw(this.model, true));
    this.figure.heading.after(this.select);
    this.element = this.figure.element;
  }

  async draw(model, again = false) {
    this.model = model;
    const stamp = `${model.id} ${this.figure.view} ${this.select.value}`;
    if ((!again && stamp.startsWith(this.stamp ?? "\n")) || !isOpen("model")) return;
    this.stamp = model.id;
    try {
      const traces = await tracesOf(model);
      if (this.model !== model) return;
      this.element.hidden = !traces.length;
      this.offer(traces);
      const trace = traces[Number(this.select.value) || 0];
      const data = trace && (await traceColumns(trace));
      if (data && this.model === model) this.plot(trace, data);
    } catch (error) {
      this.stamp = null;
      this.figure.output.textContent = error.message;
    }
  }

  offer(traces) {
    const stamp = JSON.stringify(traces);
    if (this.offered === stamp) return;
    this.offered = stamp;
    this.select.replaceChildren(...traces.map((one, k) => h("option", { value: String(k) }, `${one.name} (${one.role})`)));
    this.select.hidden = traces.length < 2;
  }

  plot(trace, data) {
    const half = bandOf(this.model);
    const shaded = trace.shaded ?? [];
    const notes = [["band", `expected largest error, \u00b1${length(half)}`]];
    if (shaded.length && ["time", "residual"].includes(this.figure.view)) notes.push(["shade", "samples set aside"]);
    this.figure.set({ ...SPECS[this.figure.view](data, half, shaded), notes });
    const largest = residualsOf(data).reduce((most, one) => Math.max(most, Math.abs(one)), 0);
    this.figure.describe(`Measured and simulated displacement of ${trace.name} (${trace.role}); they differ by at most ${length(largest / 1e3)}.`);
  }
}

// The straight line through displacement over voltage, by least squares: it makes room for the hysteresis.
export function straightLine(x, y) {
  let [n, sx, sy, sxx, sxy] = [0, 0, 0, 0, 0];
  for (let i = 0; i < x.length; i += 1) {
    if (!Number.isFinite(x[i] + y[i])) continue;
    n += 1;
    sx += x[i];
    sy += y[i];
    sxx += x[i] * x[i];
    sxy += x[i] * y[i];
  }
  const slope = (n * sxy - sx * sy) / (n * sxx - sx * sx || 1);
  return { slope, offset: (sy - slope * sx) / Math.max(n, 1) };
}

function offLine({ voltage, measured, simulated }) {
  const { slope, offset } = straightLine(voltage, measured);
  const less = (values) => Float32Array.from(values, (value, i) => value - offset - slope * voltage[i]);
  return { voltage, measured: less(measured), simulated: less(simulated) };
}

const loops = (data, half, y) => ({
  x: VOLTS,
  y,
  series: [
    { name: "measured", colour: "measured", x: data.voltage, y: data.measured, width: 1.6 },
    { name: "simulated", colour: "simulated", x: data.voltage, y: data.simulated, around: half, width: 1.2 },
  ],
});

const SPECS = {
  loops: (data, half) => loops(data, half, MICROMETRES),
  deviation: (data, half) => loops(offLine(data), half, { label: "Displacement \u2212 straight line (\u00b5m)", unit: "\u00b5m" }),
  time: (data, half, shaded) => ({
    x: SECONDS,
    y: MICROMETRES,
    shaded,
    series: [
      { name: "measured", colour: "measured", x: data.time, y: withGaps(data.measured, data.time, shaded), rising: true, width: 2.4 },
      { name: "simulated", colour: "simulated", x: data.time, y: withGaps(data.simulated, data.time, shaded), rising: true, around: half },
    ],
  }),
  residual: (data, half, shaded) => ({
    x: SECONDS,
    y: RESIDUAL,
    shaded,
    zero: true,
    band: [-1e3 * half, 1e3 * half],
    series: [{ name: "residual", colour: "measured", x: data.time, y: withGaps(residualsOf(data), data.time, shaded), rising: true }],
  }),
  against: (data, half) => {
    const { rising, falling } = branches(data);
    return { x: MICROMETRES, y: RESIDUAL, zero: true, band: [-1e3 * half, 1e3 * half], series: [rising, falling] };
  },
};

// Residuals of rising and of falling branches of the simulated displacement, each a curve over the displacement.
function branches(data) {
  const residuals = residualsOf(data);
  const parts = { rising: new Float32Array(residuals.length).fill(NaN), falling: new Float32Array(residuals.length).fill(NaN) };
  let name = "rising";
  for (let i = 1; i < residuals.length; i += 1) {
    const step = data.simulated[i] - data.simulated[i - 1];
    if (step !== 0) name = step > 0 ? "rising" : "falling";
    parts[name][i] = residuals[i];
  }
  const series = (one) => ({ name: `${one} branches`, colour: one, x: data.simulated, y: parts[one], points: true, width: 2 });
  return { rising: series("rising"), falling: series("falling") };
}

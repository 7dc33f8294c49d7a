// The voltage for a path, computed in the page by the model's WebAssembly. Displacements here are micrometres.
import { Compensator, load } from "/page/dehyst.js";

const MICRO = 1e-6;
const modules = new Map(); // by model and period: compiled modules
const compensators = new Map(); // by model, period, limits and slew rate
const MOST = 6;

function remembered(map, key, create) {
  const value = map.get(key) ?? create();
  map.delete(key);
  map.set(key, value);
  if (map.size > MOST) map.delete(map.keys().next().value);
  return value;
}

// A compensator of a model for samples one `period` (s) apart. `limits` in V, `slew` in V/s or null.
export async function compensatorOf(model, { limits, slew, period }) {
  const address = `/api/models/${model.id}/wasm?period=${period}`;
  const pending = remembered(modules, `${model.id} ${period}`, () => load(address));
  pending.catch(() => modules.delete(`${model.id} ${period}`));
  const module = await pending;
  const key = JSON.stringify([model.id, period, limits, slew]);
  return remembered(compensators, key, () => new Compensator(module, { limits, slewRate: slew, period }));
}

// Voltages for wanted displacements (um), and what they would reach; a straight gain beside it.
export function plan(compensator, wanted) {
  const began = performance.now();
  const metres = new Float64Array(wanted.length);
  for (let i = 0; i < metres.length; i += 1) metres[i] = MICRO * wanted[i];
  compensator.reset();
  const way = compensator.lead(metres[0]);
  const { voltage, displacement, clamped } = compensator.trajectory(metres);
  const straight = straightGain(compensator, metres);
  const reached = compensator.simulate(straight);
  const result = {
    voltage: Float32Array.from(voltage),
    expected: scaled(displacement, 1 / MICRO),
    clamped,
    straight: Float32Array.from(straight),
    straightReached: scaled(reached, 1 / MICRO),
    ...largest(wanted, displacement, reached),
    clamps: counts(clamped),
    range: ends(voltage),
    steepest: steepest(voltage, compensator.period),
    way: way * compensator.period, // seconds from the model's start to the first sample, within the slew rate
  };
  result.took = performance.now() - began;
  return result;
}

// One gain and one offset: the ends of the voltage's range belong to the ends of the model's reach.
export function straightGain(compensator, metres) {
  const { limits, reach } = compensator.about;
  const gain = (limits[1] - limits[0]) / (reach[1] - reach[0]);
  const [low, high] = compensator.limits;
  return metres.map((y) => Math.min(high, Math.max(low, limits[0] + gain * (y - reach[0]))));
}

function scaled(values, factor) {
  const out = new Float32Array(values.length);
  for (let i = 0; i < out.length; i += 1) out[i] = factor * values[i];
  return out;
}

// Largest errors in micrometres: of the plan itself (its clamps), and of the straight gain.
function largest(wanted, planned, straight) {
  let missed = 0;
  let straightMissed = 0;
  for (let i = 0; i < wanted.length; i += 1) {
    missed = Math.max(missed, Math.abs(planned[i] / MICRO - wanted[i]));
    straightMissed = Math.max(straightMissed, Math.abs(straight[i] / MICRO - wanted[i]));
  }
  return { missed, straightMissed };
}

function counts(clamped) {
  const found = { limited: 0, slewed: 0 };
  for (const one of clamped) {
    if (one === 1) found.limited += 1;
    if (one === 2) found.slewed += 1;
  }
  return found;
}

function ends(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}

function steepest(voltage, period) {
  let most = 0;
  for (let i = 1; i < voltage.length; i += 1) most = Math.max(most, Math.abs(voltage[i] - voltage[i - 1]));
  return period ? most / period : NaN;
}

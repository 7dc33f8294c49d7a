// Numbers as text, text as numbers, and the ticks of an axis.
const MINUS = "\u2212";
const DASH = "\u2013";

// The number of decimals that shows a step of this size.
export function digits(step, more = 0) {
  return Math.max(0, Math.min(12, more - Math.floor(Math.log10(step) + 1e-9)));
}

export function written(value, decimals) {
  const text = Math.abs(value) >= 1e6 ? value.toExponential(3) : value.toFixed(decimals);
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text.replaceAll("-", MINUS);
}

// Round values of a range, about `most` at most, as [value, text]. With `log`, values are exponents of ten.
export function ticks([low, high], most, { log } = {}) {
  const values = [];
  if (log) {
    const every = Math.ceil((high - low) / Math.max(most, 1));
    const steps = high - low < 2 ? [1, 2, 5] : [1];
    for (let power = Math.floor(low); power <= high; power += Math.max(every, 1)) {
      for (const step of steps) values.push([power + Math.log10(step), short(step * 10 ** power, 1)]);
    }
    return values.filter(([value]) => value >= low - 1e-9 && value <= high + 1e-9);
  }
  const rough = (high - low) / Math.max(most, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const factor = [1, 2, 2.5, 5, 10].find((digit) => digit * power >= rough * (1 - 1e-9)) ?? 10;
  const step = factor * power;
  const decimals = digits(step, factor === 2.5 ? 1 : 0);
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
    values.push([k * step, written(k * step, decimals)]);
  }
  return values;
}

// The lowest and the highest finite value of arrays, with a margin of `pad` times their difference.
export function extent(columns, pad = 0) {
  let low = Infinity;
  let high = -Infinity;
  for (const values of columns) {
    for (let i = 0; i < values.length; i += 1) {
      const value = values[i];
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  if (!(low < high)) {
    const middle = Number.isFinite(low) ? low : 0;
    const half = Math.max(1e-3 * Math.abs(middle), 1);
    return [middle - half, middle + half];
  }
  return [low - pad * (high - low), high + pad * (high - low)];
}

// A number with three significant digits. Only very large and very small numbers have an exponent.
export function short(value, significant = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return DASH;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-4) return value.toExponential(significant - 1).replaceAll("-", MINUS);
  const decimals = Math.max(0, significant - 1 - Math.floor(Math.log10(size)));
  const text = value.toFixed(decimals);
  return (text.includes(".") ? text.replace(/\.?0+$/, "") : text).replaceAll("-", MINUS);
}

// The same text for an input field, with an ASCII minus.
export const plain = (value, significant) => short(value, significant).replaceAll(MINUS, "-");

// The largest of 1, 2 and 5 times a power of ten that is not above a positive value.
export function roundDown(value) {
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return power * [5, 2, 1].find((digit) => digit * power <= value * (1 + 1e-9));
}

// A range as text. An end that is negligible beside the other one is written as 0.
export function range(pair, unit, significant = 4) {
  if (pair?.length !== 2) return `${DASH} ${unit}`;
  const [low, high] = pair.map((end) => short(Math.abs(end) < 5e-4 * (pair[1] - pair[0]) ? 0 : end, significant));
  return `${low} to ${high} ${unit}`;
}

export const percent = (value) => `${short(value, value >= 10 ? 3 : 2)} %`;

// A length, given in micrometres, as text in nm or um.
export function length(um) {
  if (!Number.isFinite(um)) return DASH;
  return Math.abs(um) < 1 ? `${short(um * 1e3)} nm` : `${short(um)} \u00b5m`;
}

export const whole = (value) => Math.round(value).toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");

export function duration(seconds) {
  if (!Number.isFinite(seconds)) return DASH;
  if (seconds < 100) return `${short(seconds)} s`;
  const rounded = Math.round(seconds);
  return `${Math.floor(rounded / 60)} min ${rounded % 60} s`;
}

export function bytes(count) {
  if (!Number.isFinite(count)) return DASH;
  if (count < 1000) return `${count} bytes`;
  return count < 1e6 ? `${short(count / 1e3)} kB` : `${short(count / 1e6)} MB`;
}

// The number in a typed text, also with a decimal comma; null if the text is empty, NaN if it is no number.
export function parsed(text) {
  const clean = text.trim().replaceAll(MINUS, "-").replaceAll("\u202f", "");
  if (clean === "") return null;
  const number = Number(/^[-+]?\d*,\d+(e[-+]?\d+)?$/i.test(clean) ? clean.replace(",", ".") : clean);
  return Number.isFinite(number) ? number : NaN;
}

// A typed number, or null if it is `optional` and empty; an Error names the field.
export function numberFrom(text, label, { above = -Infinity, least = -Infinity, optional = false } = {}) {
  const value = parsed(text);
  if (value === null && optional) return null;
  if (value !== null && value > above && value >= least) return value;
  let need = "a number";
  if (above > -Infinity) need = `a number above ${above}`;
  if (least > -Infinity) need = `a number, ${least} or more`;
  throw new Error(`${label}: got ${text.trim() || "nothing"}, need ${need}.`);
}

export function limitsFrom(low, high) {
  const limits = [numberFrom(low, "Lowest voltage"), numberFrom(high, "Highest voltage")];
  if (!(limits[0] < limits[1])) throw new Error("The lowest voltage is not below the highest one.");
  return limits;
}

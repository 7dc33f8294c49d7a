// The form that reads a file again with other options: columns, units, scales, sample rate.
import { post } from "./api.js";
import { action, choice, errorPlace, field, h } from "./dom.js";
import { LABELS } from "./labels.js";
import { parsed } from "./numbers.js";

const UNITS = { time: ["s", "ms", "us", "ns", "min"], voltage: ["V", "mV", "kV"], displacement: ["um", "nm", "mm", "m", "pm"] };
const OTHERS = {
  voltage_scale: "of an amplifier's monitor, e.g. 100 V/V",
  displacement_scale: "of a sensor's voltage, e.g. 10 um/V",
  sample_rate: "instead of a column of time, e.g. 1000",
  decimal: "a comma or a point, if the numbers do not show it",
};
// Marks what is guessed.
const GUESS = /\?$/;

// Column and unit of an option such as "CH1:V"; a column may have a colon in its name.
function taken(option, columns) {
  const at = option.lastIndexOf(":");
  return columns.includes(option) || at < 0 ? [option, ""] : [option.slice(0, at), option.slice(at + 1)];
}

// A form for one record, filled with its options and those that the server suggests; empty if the file is no table.
export function readingForm(record) {
  const suggested = record.hint?.options ?? {};
  const values = { ...record.options, ...suggested };
  const names = record.columns ?? [];
  // Options for all columns in their order name each by its quantity.
  (values.columns ?? "").split(",").forEach((entry, k) => {
    const [quantity, ...unit] = entry.split(":");
    if (quantity in UNITS) values[quantity] = [names[k], ...unit].join(":");
  });
  const marked = (name) => (name in suggested || (name in UNITS && "columns" in suggested) ? "suggested" : undefined);
  const inputs = {};
  const rows = Object.keys(names.length ? UNITS : {}).map((quantity) => {
    const given = values[quantity] ?? "";
    const [column, unit] = taken(given.replace(GUESS, ""), names);
    const about = { class: marked(quantity), "data-name": `${record.id}-${quantity}` };
    const options = names.map((name, k) => [String(k), /^\d+$/.test(name) ? `No. ${name}` : name]);
    inputs[quantity] = [choice([["", "by its name"], ...options], String(names.indexOf(column)), about), choice([["", "in its name"], ...UNITS[quantity].map((one) => [one, one])], unit, { class: marked(quantity) })];
    // A guess that is taken as it is remains one.
    if (GUESS.test(given)) inputs[quantity].guess = inputs[quantity].map((one) => one.value).join();
    return h("div", { class: "column" }, field(LABELS[quantity], inputs[quantity][0]), field("Unit", inputs[quantity][1]));
  });
  for (const [name, hint] of Object.entries(names.length ? OTHERS : {})) {
    inputs[name] = h("input", { type: "text", autocomplete: "off", spellcheck: "false", value: values[name] ?? "", class: marked(name), "data-name": `${record.id}-${name}` });
    rows.push(field(LABELS[name], inputs[name], { hint }));
  }
  const problem = errorPlace();
  const button = action(h("button", { type: "button", class: names.length ? "main" : "quiet" }, "Read again"), problem, () =>
    post(`/api/records/${record.id}/read`, { options: chosen(inputs, names) }),
  );
  const form = h("form", { class: "reading", "aria-label": `How to read ${record.name}` }, rows, problem, button);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    button.click();
  });
  return form;
}

function chosen(inputs, names) {
  const options = {};
  const order = names.map(() => "-");
  for (const quantity of Object.keys(UNITS)) {
    const [column, unit] = (inputs[quantity] ?? []).map((one) => one.value);
    if (!column) continue;
    const suffix = (unit && `:${unit}`) + (inputs[quantity].guess === `${column},${unit}` ? "?" : "");
    options[quantity] = names[column] + suffix;
    order[column] = quantity + suffix;
  }
  // Only its place tells a column from another of the same name.
  const used = order.flatMap((entry, k) => (entry === "-" ? [] : [names[k]]));
  if (used.some((name) => names.indexOf(name) !== names.lastIndexOf(name))) {
    if (used.length < 3) throw new Error("Two columns have the same name: choose all three columns.");
    for (const quantity of Object.keys(UNITS)) delete options[quantity];
    options.columns = order.join(",");
  }
  for (const name of Object.keys(OTHERS)) {
    const text = inputs[name]?.value.trim();
    if (text) options[name] = text;
  }
  if (options.sample_rate) {
    const hertz = parsed(options.sample_rate);
    if (!(hertz > 0)) throw new Error(`Sample rate: got ${options.sample_rate}, need a number above 0 in Hz, such as 1000.`);
    options.sample_rate = hertz;
  }
  return options;
}

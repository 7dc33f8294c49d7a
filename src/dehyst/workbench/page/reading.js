// The form that reads a file again with other options: columns, units, scales, sample rate.
import { button, problem } from "./acts.js";
import { readRecord } from "./api.js";
import { h } from "./dom.js";
import { Form } from "./forms.js";
import { LABELS } from "./labels.js";
import { numberFrom } from "./numbers.js";

const UNITS = {
  time: ["s", "ms", "us", "ns", "min"],
  voltage: ["V", "mV", "kV"],
  displacement: ["um", "nm", "mm", "m", "pm"],
};
const QUANTITIES = Object.keys(UNITS);
const OTHERS = {
  voltage_scale: "of an amplifier's monitor, e.g. 100 V/V",
  displacement_scale: "of a sensor's voltage, e.g. 10 um/V",
  sample_rate: "instead of a column of time, e.g. 1000",
  decimal: "a comma or a point, if the numbers do not show it",
};
// Marks what is guessed.
const GUESS = /\?$/;
const forms = new Map(); // by record, with the options that they were made from

// Column and unit of an option such as "CH1:V"; a column may have a colon in its name.
function taken(option, columns) {
  const at = option.lastIndexOf(":");
  return columns.includes(option) || at < 0 ? [option, ""] : [option.slice(0, at), option.slice(at + 1)];
}

// A form for one record, filled with its options and those that the server suggests.
export function readingForm(record) {
  const { id, name, options, hint, columns: names = [] } = record;
  const stamp = JSON.stringify([options, hint, names]);
  if (forms.get(id)?.stamp !== stamp) forms.set(id, { stamp, ...filled(record) });
  const { form, marked, guesses } = forms.get(id);
  const field = (one, option = one) => form.field(one, { class: marked(option) && "suggested" });
  const place = `reading ${id}`;
  const read = () => readRecord(id, chosen(form, names, guesses));
  return h(
    "form",
    { class: "reading", "aria-label": `How to read ${name}`, onsubmit: (event) => event.preventDefault() },
    QUANTITIES.map((one) => h("div", { class: "column" }, field(one), field(`${one}_unit`, one))),
    Object.keys(OTHERS).map((one) => field(one)),
    problem(place),
    button("Read again", place, read, { class: "main", type: "submit" }),
  );
}

function filled({ id, options, hint, columns: names = [] }) {
  const suggested = hint?.options ?? {};
  const values = { ...options, ...suggested };
  // Options for all columns in their order name each by its quantity.
  (values.columns ?? "").split(",").forEach((entry, k) => {
    const [quantity, ...unit] = entry.split(":");
    if (quantity in UNITS) values[quantity] = [names[k], ...unit].join(":");
  });
  const columns = [["", "by its name"], ...names.map((one, k) => [String(k), /^\d+$/.test(one) ? `No. ${one}` : one])];
  const fields = {};
  const guesses = {};
  for (const quantity of QUANTITIES) {
    const given = values[quantity] ?? "";
    const [column, unit] = taken(given.replace(GUESS, ""), names);
    const units = [["", "in its name"], ...UNITS[quantity].map((one) => [one, one])];
    const value = names.includes(column) ? String(names.indexOf(column)) : "";
    fields[quantity] = { label: LABELS[quantity], choices: columns, value };
    fields[`${quantity}_unit`] = { label: "Unit", choices: units, value: unit };
    // A guess that is taken as it is remains one.
    if (GUESS.test(given)) guesses[quantity] = `${value},${unit}`;
  }
  for (const [name, help] of Object.entries(OTHERS)) {
    fields[name] = { label: LABELS[name], hint: help, value: String(values[name] ?? "") };
  }
  const marked = (name) => name in suggested || (name in UNITS && "columns" in suggested);
  return { form: new Form(`reading-${id}`, fields), marked, guesses };
}

function chosen({ values }, names, guesses) {
  const options = {};
  const order = names.map(() => "-");
  for (const quantity of QUANTITIES) {
    const [column, unit] = [values[quantity], values[`${quantity}_unit`]];
    if (!column) continue;
    const suffix = (unit && `:${unit}`) + (guesses[quantity] === `${column},${unit}` ? "?" : "");
    options[quantity] = names[column] + suffix;
    order[column] = quantity + suffix;
  }
  // Only its place tells a column from another of the same name.
  const used = order.flatMap((entry, k) => (entry === "-" ? [] : [names[k]]));
  if (used.some((name) => names.indexOf(name) !== names.lastIndexOf(name))) {
    if (used.length < 3) throw new Error("Two columns have the same name: choose all three columns.");
    for (const quantity of QUANTITIES) delete options[quantity];
    options.columns = order.join(",");
  }
  for (const name of Object.keys(OTHERS)) if (values[name].trim()) options[name] = values[name].trim();
  if (options.sample_rate) options.sample_rate = numberFrom(options.sample_rate, LABELS.sample_rate, { above: 0 });
  return options;
}

// The form that reads a file again with other options: columns, units, scales, sample rate, and coupled axes.
import { DECLARED } from "./declared.js";
import { h } from "./dom.js";
import { Form, fold } from "./forms.js";
import { numberFrom, range } from "./numbers.js";
import { button, problem, readRecord } from "./server.js";

const FIELDS = DECLARED.forms.reading;
const UNITS = Object.fromEntries(Object.entries(FIELDS).flatMap(([name, { units }]) => (units ? [[name, units]] : [])));
const OTHERS = Object.keys(FIELDS).filter((name) => !(name in UNITS));
const NAMES = ["x", "y", "z"]; // of axes, of which a form offers as many
// Marks what is guessed.
const GUESS = /\?$/;
const forms = new Map(); // by record, with the options that they were made from

// Fields of the columns of an axis; those of the first one are those of the only one.
const voltageOf = (k) => (k ? `voltage_${k + 1}` : "voltage");
const displacementOf = (k) => (k ? `displacement_${k + 1}` : "displacement");
const quantityOf = (field) => field.split("_")[0];
const fieldsOf = (count) => [
  "time",
  ...Array.from({ length: count }, (_, k) => [voltageOf(k), displacementOf(k)]).flat(),
];

// What each field of a column is called when all columns get names, for axes of these names, or one without a name.
const wordsOf = (axes) =>
  Object.fromEntries([
    ["time", "time"],
    ...axes.flatMap((name, k) => [
      [voltageOf(k), name ? `v${name}` : "voltage"],
      [displacementOf(k), name || "displacement"],
    ]),
  ]);

// Column and unit of an option such as "CH1:V"; a column may have a colon in its name.
function taken(option, columns) {
  const at = option.lastIndexOf(":");
  return columns.includes(option) || at < 0 ? [option, ""] : [option.slice(0, at), option.slice(at + 1)];
}

// A form for one record, filled with its options and those that the server suggests.
export function readingForm(record) {
  const { id, name, options, hint, file_columns: columns = [] } = record;
  const stamp = JSON.stringify([options, hint, columns]);
  if (forms.get(id)?.stamp !== stamp) forms.set(id, { stamp, ...filled(record) });
  const { form, marked, guesses, help, known } = forms.get(id);
  const count = Number(form.values.axes);
  const field = (one, option = one) => form.field(one, { class: marked(option) && "suggested" });
  const column = (one) => h("div.column", field(one), field(`${one}_unit`, one));
  const axis = (_, k) => [count > 1 && field(`name_${k + 1}`), column(voltageOf(k)), column(displacementOf(k))];
  const others = OTHERS.map((one) => field(one));
  const place = `reading ${id}`;
  const read = () => readRecord(id, chosen(form, columns, guesses));
  return h("form.reading", { "aria-label": `How to read ${name}`, onsubmit: (event) => event.preventDefault() },
    help && h("p", help),
    columns.length > 3 && field("axes"),
    column("time"),
    Array.from({ length: count }, axis),
    known ? others : fold("Scales, sample rate, decimal sign", others),
    problem(place),
    button("Read again", place, read, { class: "main", type: "submit" }),
  );
}

function filled({ id, status, options, hint, file_columns: columns = [] }) {
  const names = columns.map((one) => one.name);
  const pairs = pairsOf(columns);
  const many = status === "refused" && Object.keys(options).length === 0 && pairs.length > 1;
  const suggested = many ? {} : hint?.options ?? {};
  const axes = Object.keys(options.axes ?? {});
  const values = { axes: "1", ...options, ...suggested };
  if (axes.length) values.axes = String(axes.length);
  // Options for all columns in their order name each by its word.
  const words = Object.entries(wordsOf(axes.length ? axes : [""]));
  (values.columns ?? "").split(",").forEach((entry, k) => {
    const [word, ...unit] = entry.split(":");
    const found = words.find((one) => one[1] === word.replace(GUESS, ""));
    if (found) values[found[0]] = [names[k], ...unit].join(":") + (unit.length ? "" : word.match(GUESS)?.[0] ?? "");
  });
  const counts = NAMES.map((_, k) => [String(k + 1), k ? `${k + 1}, coupled` : "1"]);
  const fields = { axes: { label: "Axes", choices: counts, value: values.axes } };
  const labels = columns.map(({ name, unit, range: ends }) =>
    ends?.length === 2 ? `${/^\d+$/.test(name) ? `No. ${name}` : name}: ${range(ends, unit)}` : name,
  );
  const choices = [["", "by its name"], ...labels.map((text, k) => [String(k), text])];
  const guesses = {};
  for (const field of fieldsOf(NAMES.length)) {
    const given = values[field] ?? "";
    const [column, unit] = taken(given.replace(GUESS, ""), names);
    const units = [["", "as named"], ...UNITS[quantityOf(field)].map((one) => [one, one])];
    const value = names.includes(column) ? String(names.indexOf(column)) : "";
    fields[field] = { label: FIELDS[quantityOf(field)].label, choices, value };
    fields[`${field}_unit`] = { label: "Unit", choices: units, value: unit };
    // A guess that is taken as it is remains one.
    if (GUESS.test(given)) guesses[field] = `${value},${unit}`;
  }
  NAMES.forEach((name, k) => {
    fields[`name_${k + 1}`] = { label: `Name of axis ${k + 1}`, value: axes[k] ?? name };
  });
  for (const name of OTHERS) fields[name] = { ...FIELDS[name], value: String(values[name] ?? "") };
  const form = new Form(`reading-${id}`, fields, (name) => name === "axes" && pair(form, columns, pairs));
  if (many) {
    form.values.axes = String(Math.min(pairs.length, NAMES.length));
    pair(form, columns, pairs);
  }
  const marked = (name) =>
    name in suggested ||
    (name in UNITS && "columns" in suggested) ||
    (many && (name === "axes" || (quantityOf(name) in UNITS && form.values[name] !== "")));
  const coupled = `There are ${pairs.length} voltages with displacements, perhaps of coupled axes: check the pairs.`;
  const known = OTHERS.some((name) => values[name]);
  return { form, marked, guesses, known, help: many ? coupled : hint && "Try the marked options." };
}

// Columns of a voltage and a displacement that may belong together: in their order, by their units.
function pairsOf(columns) {
  const of = (quantity) => columns.flatMap(({ unit }, k) => (UNITS[quantity].includes(unit) ? [k] : []));
  const displacements = of("displacement");
  return of("voltage").slice(0, displacements.length).map((voltage, k) => [voltage, displacements[k]]);
}

// Fill in the columns of several axes where none was chosen, and the axes' names by those of the columns.
function pair({ values }, columns, pairs) {
  const count = Number(values.axes);
  if (count < 2) return;
  const time = columns.findIndex(({ unit }) => UNITS.time.includes(unit));
  if (!values.time && time >= 0) values.time = String(time);
  const words = pairs.slice(0, count).map(([, k]) => /^[A-Za-z][A-Za-z0-9]*/.exec(columns[k].name)?.[0] ?? "");
  const differ = words.every(Boolean) && new Set(words).size === words.length;
  pairs.slice(0, count).forEach(([voltage, displacement], k) => {
    values[voltageOf(k)] ||= String(voltage);
    values[displacementOf(k)] ||= String(displacement);
    if (differ) values[`name_${k + 1}`] = words[k];
  });
}

function chosen({ values }, columns, guesses) {
  const names = columns.map((one) => one.name);
  const count = Number(values.axes);
  const axes = count > 1 ? NAMES.slice(0, count).map((_, k) => axisName(values[`name_${k + 1}`], k)) : [""];
  const options = {};
  const order = names.map(() => "-");
  const used = [];
  for (const [field, word] of Object.entries(wordsOf(axes))) {
    const [column, unit] = [values[field], values[`${field}_unit`]];
    if (!column) continue;
    const suffix = (unit && `:${unit}`) + (guesses[field] === `${column},${unit}` ? "?" : "");
    options[field] = names[column] + suffix;
    order[column] = word + suffix;
    used.push(column);
  }
  if (new Set(used).size < used.length) throw new Error("A column stands in two fields: choose each column once.");
  const needed = 2 * count + (values.sample_rate.trim() ? 0 : 1);
  const twice = used.some((at) => names.indexOf(names[at]) !== names.lastIndexOf(names[at]));
  // Only its place tells a column from another of the same name.
  if (twice && used.length < 3) throw new Error("Two columns have the same name: choose all three columns.");
  if (count > 1 && used.length < needed) {
    throw new Error("Several axes: choose all their columns, and that of the time.");
  }
  if (twice || count > 1) {
    for (const field of fieldsOf(count)) delete options[field];
    options.columns = order.join(",");
  }
  if (count > 1) options.axes = Object.fromEntries(axes.map((name) => [name, `v${name}:${name}`]));
  for (const name of OTHERS) if (values[name].trim()) options[name] = values[name].trim();
  if (options.sample_rate) options.sample_rate = numberFrom(options.sample_rate, FIELDS.sample_rate.label, { above: 0 });
  return options;
}

function axisName(text, k) {
  if (/^[A-Za-z]\w*$/.test(text.trim())) return text.trim();
  throw new Error(`Name of axis ${k + 1}: got ${text.trim() || "nothing"}, need letters and digits, as in x or y.`);
}

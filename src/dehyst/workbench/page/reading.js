// The form to read a file again with other columns, units, scales, sample rate, or coupled axes.
import { DECLARED } from "./declared.js";
import { h } from "./dom.js";
import { Form, fold } from "./forms.js";
import { range } from "./numbers.js";
import { button, problem, readRecord, redraw } from "./server.js";

const OTHERS = ["voltage_scale", "displacement_scale", "rate", "decimal"];
const forms = new Map(); // by record, each with the contents that it was made from

// The form of a record, filled with its options and with the suggestions of the server.
export function readingForm(record) {
  const { id, name, file_columns: columns, form: given } = record;
  const stamp = JSON.stringify([given, columns]);
  if (forms.get(id)?.stamp !== stamp) forms.set(id, { stamp, form: filled(record) });
  const { form } = forms.get(id);
  const field = (name, option = name) => form.field(name, { class: given.marked.includes(option) && "suggested" });
  const column = (name) => h("div.column", field(name), field(`${name}_unit`, name));
  const axes = Array.from({ length: Number(form.values.axes) }, (_, k) => k + 1);
  const axis = (k) => [axes.length > 1 && field(`name_${k}`), column(`voltage_${k}`), column(`displacement_${k}`)];
  const others = OTHERS.map((name) => field(name));
  const place = `reading ${id}`;
  return h("form.reading", { "aria-label": `How to read ${name}`, onsubmit: (event) => event.preventDefault() },
    given.help && h("p", given.help),
    columns.length > 3 && field("axes"),
    column("time"),
    axes.map(axis),
    OTHERS.some((name) => given.values[name]) ? others : fold("Scales, sample rate, decimal sign", others),
    problem(place),
    button("Read again", place, () => readRecord(id, { form: form.values }), { class: "main", type: "submit" }),
  );
}

function filled({ id, file_columns: columns, form: { values, pairs } }) {
  const labels = columns.map(({ name, unit, range: ends }) =>
    ends?.length === 2 ? `${/^\d+$/.test(name) ? `No. ${name}` : name}: ${range(ends, unit)}` : name,
  );
  const choices = [["", "by its name"], ...labels.map((text, k) => [String(k), text])];
  const fields = Object.entries(DECLARED.forms.reading);
  const own = Object.fromEntries(fields.map(([name, field]) => [name, field.column ? { ...field, choices } : field]));
  const form = new Form(`reading-${id}`, own, (name) => {
    // Fill in the columns that may belong to each axis.
    if (name === "axes") for (const [field, column] of Object.entries(pairs)) form.values[field] ||= column;
    redraw();
  });
  Object.assign(form.values, values);
  return form;
}

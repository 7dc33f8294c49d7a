// The form that reads a file again with other options: columns, units, scales, sample rate.
import { post } from "./api.js";
import { action, errorPlace, field, h } from "./dom.js";
import { parsed } from "./numbers.js";

const OPTIONS = [
  ["time", "Column of the time", "its name, e.g. time_s, or name:unit, e.g. t:ms"],
  ["voltage", "Column of the voltage", "its name, e.g. drive_V, or name:unit, e.g. CH1:V"],
  ["displacement", "Column of the displacement", "its name, e.g. displacement_um, or name:unit, e.g. CH2:um"],
  ["columns", "Or all columns in their order", "e.g. time:s,voltage:V,-,displacement:um; a - leaves one out"],
  ["voltage_scale", "Scale of the voltage", "of an amplifier's monitor, e.g. 100 V/V"],
  ["displacement_scale", "Scale of the displacement", "of a sensor's voltage, e.g. 10 um/V"],
  ["sample_rate", "Sample rate in Hz", "instead of a column of time, e.g. 1000"],
];

// The reader's sentence in the words of this form.
const LABELS = OPTIONS.map(([name, label]) => [new RegExp(`--${name.replace("_", "-")}\\b( "NAME"| NAMES?| HZ| SCALE)?`, "g"), `\u201c${label}\u201d`]);
export const inForm = (sentence) => LABELS.reduce((text, [flag, label]) => text.replaceAll(flag, label), sentence);

// The names of the file's columns, as far as the reader's sentence lists them: to choose from.
const columnsIn = (sentence) => [...(/file holds ((?:'[^']*'(?:, )?)+)/.exec(sentence ?? "")?.[1] ?? "").matchAll(/'([^']*)'/g)].map((one) => one[1]);

// A form for one record, filled with its options and those that the server suggests.
export function readingForm(record) {
  const suggested = record.hint?.options ?? {};
  const values = { ...record.options, ...suggested };
  const list = h("datalist", { id: `columns-${record.id}` }, columnsIn(record.error).map((value) => h("option", { value })));
  const inputs = OPTIONS.map(([name, label, hint]) => {
    const input = h("input", {
      type: "text",
      autocomplete: "off",
      spellcheck: "false",
      value: values[name] ?? "",
      list: ["time", "voltage", "displacement"].includes(name) ? list.id : undefined,
      class: name in suggested ? "suggested" : undefined,
      "data-name": `${record.id}-${name}`,
    });
    return [name, input, field(label, input, { hint: name in suggested ? `suggested; ${hint}` : hint })];
  });
  const problem = errorPlace();
  const button = action(h("button", { type: "button", class: "main" }, "Read again"), problem, () =>
    post(`/api/records/${record.id}/read`, { options: chosen(inputs) }),
  );
  const form = h("form", { class: "reading", "aria-label": `How to read ${record.name}` }, list, h("div", { class: "fields" }, inputs.map(([, , row]) => row)), problem, button);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    button.click();
  });
  return form;
}

function chosen(inputs) {
  const options = {};
  for (const [name, input] of inputs) {
    const text = input.value.trim();
    if (!text) continue;
    if (name === "sample_rate") {
      const hertz = parsed(text);
      if (!(hertz > 0)) throw new Error(`Sample rate: got ${text}, need a number above 0 in Hz, such as 1000.`);
      options[name] = hertz;
    } else {
      options[name] = text;
    }
  }
  // All columns in their order are the whole answer; single names beside them would contradict it.
  if (options.columns) for (const name of ["time", "voltage", "displacement"]) delete options[name];
  return options;
}
